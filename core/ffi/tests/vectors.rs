//! `firmware/expected.txt`, which C programs print on every processor, is what the Rust interface gives.
#![allow(clippy::unwrap_used)]

use std::fmt::Write;

use gedepth_core::camera::{
    BrownConrady, CameraModel, ImageSize, Intrinsics, KannalaBrandt, Pinhole, Pixel,
};
use gedepth_core::fusion::{
    AttentionHead, AttentionUnit, DecodeAt, DepthRange, FusedMaps, Fusion, HeadMap, ResidualHead,
    ResidualUnit, Samples, SlopeHead, Upsampling, scratch_len,
};
use gedepth_core::slope::{SlopeClasses, SlopeSign, adaptive_inverse_depth, slope_from_depth};
use gedepth_core::table::{
    Coverage, FixedView, GroundCoefficients, GroundRows, GroundView, RayView, RowTolerance,
    RowView, write_depth,
};
use gedepth_core::{Angle, Extrinsics, Ground, GroundPlane};

/// The lines so far.
#[derive(Default)]
struct Lines(String);

impl Lines {
    fn byte(&mut self, name: &str, value: u8) {
        writeln!(self.0, "{name} {value:02x}").unwrap();
    }

    fn double(&mut self, name: &str, value: f64) {
        writeln!(self.0, "{name} {:016x}", value.to_bits()).unwrap();
    }

    fn float(&mut self, name: &str, value: f32) {
        writeln!(self.0, "{name} {:08x}", value.to_bits()).unwrap();
    }

    /// FNV-1a.
    fn sum(&mut self, name: &str, bytes: impl Iterator<Item = u8>) {
        let sum = bytes.fold(0x811c_9dc5_u32, |sum, byte| {
            (sum ^ u32::from(byte)).wrapping_mul(0x0100_0193)
        });
        writeln!(self.0, "{name} {sum:08x}").unwrap();
    }

    fn floats(&mut self, name: &str, values: &[f32]) {
        self.sum(name, values.iter().flat_map(|value| value.to_le_bytes()));
    }

    fn ground(&mut self, name: &str, camera: &dyn CameraModel, ground: &Ground) {
        for value in ground.down().vector().to_array() {
            self.double(name, value);
        }
        self.double(name, ground.height());
        let line = ground.vanishing_line(camera);
        self.byte(name, if line.is_some() { 0 } else { 10 });
        for Pixel { u, v } in line.unwrap_or([Pixel::new(0.0, 0.0); 2]) {
            self.double(name, u);
            self.double(name, v);
        }
    }

    fn depth(&mut self, name: &str, table: &dyn GroundRows) {
        let mut metres = vec![0.0; table.size().pixels()];
        write_depth(table, 80.0, &mut metres).unwrap();
        self.floats(name, &metres);
        let coverage = Coverage::of(table, &mut metres).unwrap();
        self.double(name, coverage.share);
        self.float(name, coverage.nearest.unwrap_or(0.0));
    }
}

fn intrinsics(width: u32, height: u32, f: [f64; 2], c: [f64; 2], skew: f64) -> Intrinsics {
    let size = ImageSize::new(width, height).unwrap();
    let intrinsics = Intrinsics::new(size, f[0], f[1], c[0], c[1]).unwrap();
    intrinsics.with_skew(skew).unwrap()
}

fn mounted(height: f64, pitch: f64, roll: f64) -> Ground {
    let (pitch, roll) = (Angle::from_radians(pitch), Angle::from_radians(roll));
    Ground::from_mounting(height, pitch, roll).unwrap()
}

fn kitti(lines: &mut Lines) {
    let k = intrinsics(1242, 375, [721.5377, 721.5377], [609.5593, 172.854], 0.0);
    let camera = Pinhole::new(k);
    let pose = Extrinsics::world_to_camera(
        [
            [
                2.3477369814704142e-4,
                -9.999441545437641e-1,
                -1.0563477811052201e-2,
            ],
            [
                1.0449407416592844e-2,
                1.056535364137932e-2,
                -9.99889574117649e-1,
            ],
            [
                9.999453885620024e-1,
                1.2436537838650679e-4,
                1.0451302995668946e-2,
            ],
        ],
        [
            0.05705244785953045,
            -0.07546671853346003,
            -0.2693869124058732,
        ],
    );
    let ground = Ground::seen_by(&pose.unwrap(), &GroundPlane::z_up(-1.65).unwrap()).unwrap();
    lines.ground("kitti.ground", &camera, &ground);
    let places = [
        (0, 0),
        (374, 0),
        (374, 1236),
        (180, 600),
        (176, 1200),
        (172, 0),
        (173, 0),
        (175, 0),
        (250, 618),
    ];
    for (v, u) in places {
        let ray = camera.forward_ray(Pixel::new(f64::from(u), f64::from(v)));
        lines.double("kitti.at", ground.inverse_depth(ray.unwrap()));
    }
    let mut memory = vec![0.0; 1242 * 375];
    let table = GroundView::build(&mut memory, &camera, &ground).unwrap();
    lines.floats("kitti.table", table.values());
    lines.depth("kitti.depth", &table);
    let mut metres = vec![0; 1242 * 375];
    let table = FixedView::<256, 255>::build(&mut metres, &camera, &ground).unwrap();
    let bytes = table.values().iter().flat_map(|value| value.to_le_bytes());
    lines.sum("kitti.metres", bytes);
    lines.depth("kitti.metres", &table);
    let coefficients = GroundCoefficients::new(&k, &ground);
    for value in coefficients.coefficients() {
        lines.double("kitti.coefficients", value);
    }
    lines.depth("kitti.coefficients", &coefficients);
    let ground = mounted(1.65, 0.01, 0.0);
    lines.ground("kitti.mounting", &camera, &ground);
    let coefficients = GroundCoefficients::new(&k, &ground);
    let tolerance = RowTolerance {
        relative_error: 1e-3,
        up_to: 80.0,
    };
    let table = RowView::build(&mut memory, &coefficients, tolerance).unwrap();
    lines.floats("kitti.rows", table.values());
    lines.depth("kitti.rows", &table);
}

fn lenses(lines: &mut Lines) {
    let [k, unskewed] = [0.75, 0.0].map(|s| intrinsics(160, 120, [150.0, 149.0], [80.5, 58.25], s));
    let wide = intrinsics(160, 120, [60.0, 59.5], [80.5, 58.25], 0.0);
    let narrow = BrownConrady::new(k, [-0.28, 0.09, 1e-3, -5e-4, -0.012]).unwrap();
    let rational = [0.5, -0.02, 1e-3, -5e-4, 1e-3, 0.8, 0.05, -1e-3];
    let rational = BrownConrady::rational(unskewed, rational).unwrap();
    let fisheye = KannalaBrandt::new(wide, [-0.02, 4e-3, -1e-3, 1e-4]).unwrap();
    let cameras: [(&str, &dyn CameraModel); 4] = [
        ("pinhole", &Pinhole::new(k)),
        ("brown-conrady", &narrow),
        ("rational", &rational),
        ("kannala-brandt", &fisheye),
    ];
    let mut memory = vec![0.0; 160 * 120];
    let mut rays = vec![0.0; 2 * 160 * 120];
    for (name, camera) in cameras {
        let ground = mounted(1.5, 0.05, 0.03);
        lines.ground(name, camera, &ground);
        let table = GroundView::build(&mut memory, camera, &ground).unwrap();
        lines.floats(name, table.values());
        RayView::build(&mut rays, camera).unwrap();
        lines.floats(name, &rays);
        let rays = RayView::build(&mut rays, camera).unwrap();
        let table = GroundView::rebuild(&mut memory, &rays, &mounted(1.45, 0.035, 0.025)).unwrap();
        lines.floats(name, table.values());
        lines.depth(name, &table);
    }
}

fn noise(count: usize, mut seed: u32, scale: f32, offset: f32) -> Vec<f32> {
    let mut next = || {
        seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (seed >> 8) as f32 * (1.0 / 16_777_216.0) * scale + offset
    };
    (0..count).map(|_| next()).collect()
}

fn fusion(lines: &mut Lines) {
    let (size, head) = (
        ImageSize::new(148, 36).unwrap(),
        ImageSize::new(37, 9).unwrap(),
    );
    let residual = noise(head.pixels(), 1, 4.0, 0.5);
    let attention = noise(head.pixels(), 2, 12.0, -6.0);
    let logits = noise(11 * head.pixels(), 3, 8.0, -4.0);
    let residual_u8: Vec<u8> = residual.iter().map(|value| (value * 50.0) as u8).collect();
    let logits_i8: Vec<i8> = logits.iter().map(|value| (value * 30.0) as i8).collect();
    let angles: Vec<Angle> = (-5..=5)
        .map(|i| Angle::from_radians(f64::from(i) * 0.017453292519943295))
        .collect();
    let classes: SlopeClasses = SlopeClasses::new(&angles, SlopeSign::UphillPositive).unwrap();
    let k = intrinsics(148, 36, [86.0, 86.0], [73.5, 17.5], 0.0);
    let ground = mounted(1.65, 0.02, 0.0);
    let camera = BrownConrady::new(k, [-0.1, 0.01, 0.0, 0.0, 0.0]).unwrap();
    let (mut values, mut metres) = (vec![0.0; size.pixels()], vec![0; size.pixels()]);
    let mut rows = vec![0.0; 36];
    let coefficients = GroundCoefficients::new(&k, &ground);
    let tolerance = RowTolerance {
        relative_error: 1e-6,
        up_to: 80.0,
    };
    let tables: [&dyn GroundRows; 4] = [
        &GroundView::build(&mut values, &camera, &ground).unwrap(),
        &FixedView::<256, 255>::build(&mut metres, &camera, &ground).unwrap(),
        &RowView::build(&mut rows, &coefficients, tolerance).unwrap(),
        &coefficients,
    ];
    let map = |samples, channels| HeadMap::new(samples, channels, head).unwrap();
    let mut scratch = vec![0.0; scratch_len(size, 37, 11)];
    let mut maps = vec![0.0; 3 * size.pixels()];
    for decode_at in [DecodeAt::HeadSize, DecodeAt::OutputSize] {
        for upsampling in [Upsampling::HalfPixel, Upsampling::AlignCorners] {
            let range = DepthRange::new(0.1, 80.0).unwrap();
            let fusion = Fusion::new(upsampling, range, 150.0).unwrap();
            let residual = ResidualHead {
                map: map(Samples::F32(&residual), 1),
                unit: ResidualUnit::LogMetres,
                decode_at,
            };
            let residual_u8 = ResidualHead {
                map: map(
                    Samples::U8 {
                        values: &residual_u8,
                        scale: 0.3,
                        zero_point: 7,
                    },
                    1,
                ),
                unit: ResidualUnit::Metres,
                decode_at,
            };
            let per_pixel = ResidualHead {
                unit: ResidualUnit::LogMetresPerPixel { focal_length: 5.5 },
                ..residual
            };
            let attention = AttentionHead {
                map: map(Samples::F32(&attention), 1),
                unit: AttentionUnit::Logit,
                decode_at,
            };
            let slope = SlopeHead {
                map: map(Samples::F32(&logits), 11),
                classes: &classes,
                decode_at,
            };
            let slope_i8 = SlopeHead {
                map: map(
                    Samples::I8 {
                        values: &logits_i8,
                        scale: 0.033,
                        zero_point: -3,
                    },
                    11,
                ),
                classes: &classes,
                decode_at,
            };
            for (name, residual) in [
                ("baseline", &residual),
                ("baseline.u8", &residual_u8),
                ("baseline.per_pixel", &per_pixel),
            ] {
                let depth = &mut maps[..size.pixels()];
                fusion
                    .baseline(size, residual, &mut scratch, depth)
                    .unwrap();
                lines.floats(name, depth);
            }
            for table in tables {
                fusion
                    .vanilla(table, &residual, &attention, &mut scratch, all(&mut maps))
                    .unwrap();
                lines.floats("vanilla", &maps);
                fusion
                    .adaptive(
                        table,
                        &residual,
                        &attention,
                        &slope,
                        &mut scratch,
                        all(&mut maps),
                    )
                    .unwrap();
                lines.floats("adaptive", &maps);
            }
            let depth = FusedMaps {
                depth: &mut maps[..size.pixels()],
                attention: None,
                ground: None,
            };
            fusion
                .adaptive(
                    tables[0],
                    &residual_u8,
                    &attention,
                    &slope_i8,
                    &mut scratch,
                    depth,
                )
                .unwrap();
            lines.floats("adaptive.i8", &maps[..size.pixels()]);
        }
    }
    let expected = classes.expected_angle(&logits[..11]).unwrap();
    lines.float("slope.expected", expected);
    lines.byte(
        "slope.nearest",
        classes.nearest_class(expected).unwrap() as u8,
    );
    let slope = slope_from_depth(0.05, 21.0, &ground).unwrap().radians();
    lines.double("slope.from-depth", slope);
    lines.double(
        "slope.inverse",
        adaptive_inverse_depth(0.05, slope, &ground),
    );
}

/// Depth, attention and ground, one after the other.
fn all(maps: &mut [f32]) -> FusedMaps<'_> {
    let (depth, rest) = maps.split_at_mut(maps.len() / 3);
    let (attention, ground) = rest.split_at_mut(depth.len());
    FusedMaps {
        depth,
        attention: Some(attention),
        ground: Some(ground),
    }
}

#[test]
fn the_same_numbers_as_from_c() {
    let mut lines = Lines::default();
    kitti(&mut lines);
    lenses(&mut lines);
    fusion(&mut lines);
    let expected = include_str!("../firmware/expected.txt");
    for (number, (line, expected)) in lines.0.lines().zip(expected.lines()).enumerate() {
        assert_eq!(line, expected, "line {}", number + 1);
    }
    assert_eq!(lines.0.lines().count(), expected.lines().count());
}
