//! What the core costs on one core: ground tables against a constant fill of the same memory, and fusion.
//!
//! `cargo bench -p gedepth-benches --bench core`. Limits, at 1216x352: pinhole table 1.5 fills, rebuild 3 fills,
//! Kannala-Brandt table 40 ns a pixel (17.1 ms), adaptive fusion 1.0 ms, vanilla 0.5 ms.

#![allow(missing_docs, clippy::expect_used)]

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use gedepth_core::camera::{BrownConrady, ImageSize, Intrinsics, KannalaBrandt, Pinhole};
use gedepth_core::fusion::{
    AttentionHead, AttentionUnit, DecodeAt, DepthRange, FusedMaps, Fusion, HeadMap, ResidualHead,
    ResidualUnit, Samples, SlopeHead, Upsampling, scratch_len,
};
use gedepth_core::slope::{SlopeClasses, SlopeSign, adaptive_inverse_depth, slope_from_depth};
use gedepth_core::table::{
    FixedView, GroundCoefficients, GroundRows, GroundView, RayView, RowTolerance, RowView,
};
use gedepth_core::{Angle, Error, Ground};

const WIDTH: u32 = 1216;
const HEIGHT: u32 = 352;

fn scene() -> Result<(ImageSize, Intrinsics, Ground), Error> {
    let size = ImageSize::new(WIDTH, HEIGHT)?;
    let intrinsics = Intrinsics::new(size, 721.5, 721.5, 596.6, 149.9)?;
    let ground = Ground::from_mounting(1.65, Angle::from_degrees(0.6), Angle::from_degrees(-0.5))?;
    Ok((size, intrinsics, ground))
}

fn tables(c: &mut Criterion) {
    let (size, intrinsics, ground) = scene().expect("a valid scene");
    let mut memory = vec![0.0_f32; size.pixels()];
    let mut group = c.benchmark_group("table_1216x352");
    group.bench_function("constant_fill", |b| {
        b.iter(|| black_box(&mut memory).fill(black_box(1.5)));
    });
    let pinhole = Pinhole::new(intrinsics);
    group.bench_function("pinhole", |b| {
        b.iter(|| {
            GroundView::build(black_box(&mut memory), black_box(&pinhole), &ground).map(|_| ())
        });
    });
    // It sees 92 degrees to the sides.
    let wide = Intrinsics::centred(size, 350.0).expect("valid intrinsics");
    let fisheye =
        KannalaBrandt::new(wide, [0.02, -0.01, 0.004, -0.0008]).expect("valid coefficients");
    group.bench_function("kannala_brandt", |b| {
        b.iter(|| {
            GroundView::build(black_box(&mut memory), black_box(&fisheye), &ground).map(|_| ())
        });
    });
    let distorted = BrownConrady::new(intrinsics, [-0.3, 0.12, 0.0005, -0.0004, -0.02])
        .expect("valid coefficients");
    group.bench_function("brown_conrady", |b| {
        b.iter(|| {
            GroundView::build(black_box(&mut memory), black_box(&distorted), &ground).map(|_| ())
        });
    });
    let mut ray_memory = vec![0.0; RayView::len(size)];
    let rays = RayView::build(&mut ray_memory, &fisheye).expect("enough memory");
    group.bench_function("rebuild", |b| {
        b.iter(|| {
            GroundView::rebuild(black_box(&mut memory), black_box(&rays), &ground).map(|_| ())
        });
    });
    let mut steps = vec![0_u16; size.pixels()];
    group.bench_function("pinhole_fixed_point", |b| {
        b.iter(|| {
            FixedView::<256, 255>::build(black_box(&mut steps), black_box(&pinhole), &ground)
                .map(|_| ())
        });
    });
    let coefficients = GroundCoefficients::new(&intrinsics, &ground);
    group.bench_function("pinhole_coefficients_every_row", |b| {
        b.iter(|| {
            let rows = black_box(&mut memory).chunks_exact_mut(WIDTH as usize);
            (0..)
                .zip(rows)
                .try_for_each(|(v, row)| black_box(&coefficients).write_row(v, row))
        });
    });
    let level = Ground::from_mounting(1.65, Angle::from_degrees(0.6), Angle::from_degrees(0.0))
        .expect("a camera above its ground");
    let level = GroundCoefficients::new(&intrinsics, &level);
    let tolerance = RowTolerance {
        relative_error: 1e-3,
        up_to: 80.0,
    };
    group.bench_function("pinhole_per_row", |b| {
        b.iter(|| RowView::build(black_box(&mut memory), black_box(&level), tolerance).map(|_| ()));
    });
    group.finish();
}

fn slopes(c: &mut Criterion) {
    let (_, _, ground) = scene().expect("a valid scene");
    let heads = Heads::new(8).expect("valid heads");
    let logits = wave(11, 3.0, 0.0);
    let mut group = c.benchmark_group("slope");
    group.bench_function("expected_angle_11_classes", |b| {
        b.iter(|| heads.classes.expected_angle(black_box(&logits)));
    });
    group.bench_function("adaptive_inverse_depth", |b| {
        b.iter(|| adaptive_inverse_depth(black_box(0.05), black_box(0.02), &ground));
    });
    group.bench_function("slope_from_depth", |b| {
        b.iter(|| slope_from_depth(black_box(0.05), black_box(19.0), &ground));
    });
    group.finish();
}

/// Smooth, bounded values that differ from pixel to pixel.
fn wave(count: usize, scale: f32, offset: f32) -> Vec<f32> {
    (0..count)
        .map(|i| (i as f32 * 0.37).sin() * scale + offset)
        .collect()
}

struct Heads {
    residual: Vec<f32>,
    attention: Vec<f32>,
    slope: Vec<f32>,
    size: ImageSize,
    classes: SlopeClasses,
}

impl Heads {
    fn new(stride: u32) -> Result<Self, Error> {
        let size = ImageSize::new(WIDTH / stride, HEIGHT / stride)?;
        let degrees = Angle::from_degrees;
        Ok(Self {
            residual: wave(size.pixels(), 1.0, 2.5),
            attention: wave(size.pixels(), 4.0, 0.0),
            slope: wave(size.pixels() * 11, 3.0, 0.0),
            size,
            classes: SlopeClasses::uniform(
                degrees(-5.0),
                degrees(5.0),
                11,
                SlopeSign::DownhillPositive,
            )?,
        })
    }

    #[inline(always)]
    fn fuse(
        &self,
        fusion: &Fusion,
        ground: &GroundView<'_>,
        mode: Mode,
        at: DecodeAt,
        scratch: &mut [f32],
        depth: &mut [f32],
    ) -> Result<(), Error> {
        let residual = ResidualHead {
            map: HeadMap::new(Samples::F32(&self.residual), 1, self.size)?,
            unit: ResidualUnit::LogMetres,
            decode_at: at,
        };
        let attention = AttentionHead {
            map: HeadMap::new(Samples::F32(&self.attention), 1, self.size)?,
            unit: AttentionUnit::Logit,
            decode_at: at,
        };
        let slope = SlopeHead {
            map: HeadMap::new(Samples::F32(&self.slope), 11, self.size)?,
            classes: &self.classes,
            decode_at: at,
        };
        let maps = FusedMaps {
            depth,
            attention: None,
            ground: None,
        };
        match mode {
            Mode::Vanilla => fusion.vanilla(ground, &residual, &attention, scratch, maps),
            Mode::Adaptive => fusion.adaptive(ground, &residual, &attention, &slope, scratch, maps),
        }
    }
}

#[derive(Clone, Copy)]
enum Mode {
    Vanilla,
    Adaptive,
}

type Fuse = fn(
    &Heads,
    &Fusion,
    &GroundView<'_>,
    Mode,
    DecodeAt,
    &mut [f32],
    &mut [f32],
) -> Result<(), Error>;

fn fuse_plain(
    heads: &Heads,
    fusion: &Fusion,
    ground: &GroundView<'_>,
    mode: Mode,
    at: DecodeAt,
    scratch: &mut [f32],
    depth: &mut [f32],
) -> Result<(), Error> {
    heads.fuse(fusion, ground, mode, at, scratch, depth)
}

/// How the runtime gets vectors out of the core's plain loops.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn avx2(
    heads: &Heads,
    fusion: &Fusion,
    ground: &GroundView<'_>,
    mode: Mode,
    at: DecodeAt,
    scratch: &mut [f32],
    depth: &mut [f32],
) -> Result<(), Error> {
    heads.fuse(fusion, ground, mode, at, scratch, depth)
}

#[cfg(target_arch = "x86_64")]
fn fuse_avx2(
    heads: &Heads,
    fusion: &Fusion,
    ground: &GroundView<'_>,
    mode: Mode,
    at: DecodeAt,
    scratch: &mut [f32],
    depth: &mut [f32],
) -> Result<(), Error> {
    // SAFETY: listed only where the processor has these features.
    unsafe { avx2(heads, fusion, ground, mode, at, scratch, depth) }
}

fn fusion(c: &mut Criterion) {
    let (size, intrinsics, ground) = scene().expect("a valid scene");
    let mut memory = vec![0.0_f32; size.pixels()];
    let table =
        GroundView::build(&mut memory, &Pinhole::new(intrinsics), &ground).expect("enough memory");
    let range = DepthRange::new(1e-3, 80.0).expect("a valid range");
    let mut scratch = vec![0.0; scratch_len(size, WIDTH, 11)];
    let mut depth = vec![0.0; size.pixels()];
    let mut kinds: Vec<(&str, Fuse)> = vec![("baseline_isa", fuse_plain)];
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
        kinds.push(("avx2", fuse_avx2));
    }
    let mut group = c.benchmark_group("fusion_1216x352");
    let half = Upsampling::HalfPixel;
    for (name, mode, stride, at, upsampling) in [
        (
            "vanilla_quarter",
            Mode::Vanilla,
            4,
            DecodeAt::HeadSize,
            half,
        ),
        (
            "adaptive_quarter",
            Mode::Adaptive,
            4,
            DecodeAt::HeadSize,
            half,
        ),
        ("adaptive_half", Mode::Adaptive, 2, DecodeAt::HeadSize, half),
        ("adaptive_full", Mode::Adaptive, 1, DecodeAt::HeadSize, half),
        (
            "adaptive_quarter_align_corners",
            Mode::Adaptive,
            4,
            DecodeAt::HeadSize,
            Upsampling::AlignCorners,
        ),
        (
            "adaptive_quarter_decoded_at_output",
            Mode::Adaptive,
            4,
            DecodeAt::OutputSize,
            half,
        ),
    ] {
        let heads = Heads::new(stride).expect("valid heads");
        let fusion = Fusion::new(upsampling, range, 200.0).expect("a valid limit");
        for (isa, fuse) in &kinds {
            group.bench_function(format!("{name}/{isa}"), |b| {
                b.iter(|| {
                    fuse(
                        black_box(&heads),
                        &fusion,
                        &table,
                        mode,
                        at,
                        &mut scratch,
                        black_box(&mut depth),
                    )
                    .expect("valid fusion");
                });
            });
        }
    }
    group.finish();
}

criterion_group!(benches, tables, slopes, fusion);
criterion_main!(benches);
