//! Fusion against the formulas in f64, pixel by pixel.
#![allow(clippy::unwrap_used)]

use gedepth_core::Angle;
use gedepth_core::Error;
use gedepth_core::camera::ImageSize;
use gedepth_core::fusion::{
    AttentionHead, AttentionUnit, DecodeAt, DepthRange, FusedMaps, Fusion, Head, HeadMap,
    ResidualHead, ResidualUnit, Samples, SlopeHead, Upsampling, scratch_len,
};
use gedepth_core::slope::{SlopeClasses, SlopeSign};
use gedepth_core::table::{GroundRows, GroundView};
use proptest::prelude::*;

const HEIGHT: f64 = 1.6;
const MIN: f64 = 0.1;
const MAX: f64 = 80.0;
const LIMIT: f64 = 150.0;

/// Bilinear upsampling, by its definition.
fn upsampled(map: &[f64], from: ImageSize, to: ImageSize, how: Upsampling, u: u32, v: u32) -> f64 {
    let place = |i: u32, n: u32, m: u32| {
        let (i, n, m) = (f64::from(i), f64::from(n), f64::from(m));
        let place = match how {
            Upsampling::HalfPixel => (i + 0.5) * n / m - 0.5,
            Upsampling::AlignCorners => {
                if m > 1.0 {
                    i * (n - 1.0) / (m - 1.0)
                } else {
                    0.0
                }
            }
        };
        place.clamp(0.0, n - 1.0)
    };
    let (x, y) = (
        place(u, from.width(), to.width()),
        place(v, from.height(), to.height()),
    );
    let at = |column: f64, row: f64| {
        let column = column.min(f64::from(from.width() - 1)) as usize;
        let row = row.min(f64::from(from.height() - 1)) as usize;
        map[row * from.width() as usize + column]
    };
    let mix = |a: f64, b: f64, share: f64| a * (1.0 - share) + b * share;
    let row = |y: f64| mix(at(x.floor(), y), at(x.floor() + 1.0, y), x.fract());
    mix(row(y.floor()), row(y.floor() + 1.0), y.fract())
}

/// Decoded before or after upsampling.
fn plane(
    map: &[f32],
    from: ImageSize,
    to: ImageSize,
    how: Upsampling,
    at: DecodeAt,
    decode: impl Fn(f64) -> f64,
) -> Vec<f64> {
    let raw: Vec<f64> = map.iter().map(|value| f64::from(*value)).collect();
    let decoded: Vec<f64> = raw.iter().copied().map(&decode).collect();
    pixels(to)
        .map(|(u, v)| match at {
            DecodeAt::HeadSize => upsampled(&decoded, from, to, how, u, v),
            DecodeAt::OutputSize => decode(upsampled(&raw, from, to, how, u, v)),
        })
        .collect()
}

fn pixels(size: ImageSize) -> impl Iterator<Item = (u32, u32)> {
    (0..size.height()).flat_map(move |v| (0..size.width()).map(move |u| (u, v)))
}

fn tangent(logits: &[f64], classes: &SlopeClasses<8>) -> f64 {
    let largest = logits.iter().copied().fold(f64::MIN, f64::max);
    let weights: Vec<f64> = logits.iter().map(|l| (l - largest).exp()).collect();
    let mean = weights
        .iter()
        .zip(classes.radians())
        .map(|(w, a)| w * f64::from(*a))
        .sum::<f64>();
    (mean / weights.iter().sum::<f64>()).tan()
}

fn tangents(
    map: &[f32],
    from: ImageSize,
    to: ImageSize,
    how: Upsampling,
    at: DecodeAt,
    classes: &SlopeClasses<8>,
) -> Vec<f64> {
    let planes: Vec<Vec<f64>> = map
        .chunks_exact(from.pixels())
        .map(|plane| plane.iter().map(|v| f64::from(*v)).collect())
        .collect();
    let decoded: Vec<f64> = (0..from.pixels())
        .map(|i| tangent(&planes.iter().map(|p| p[i]).collect::<Vec<_>>(), classes))
        .collect();
    pixels(to)
        .map(|(u, v)| match at {
            DecodeAt::HeadSize => upsampled(&decoded, from, to, how, u, v),
            DecodeAt::OutputSize => tangent(
                &planes
                    .iter()
                    .map(|p| upsampled(p, from, to, how, u, v))
                    .collect::<Vec<_>>(),
                classes,
            ),
        })
        .collect()
}

fn size() -> impl Strategy<Value = ImageSize> {
    (1_u32..40, 1_u32..9).prop_map(|(w, h)| ImageSize::new(w, h).unwrap())
}

/// Sizes of output and head: a quarter, a half, the same, or anything.
fn sizes() -> impl Strategy<Value = (ImageSize, ImageSize)> {
    (size(), size(), 0..6).prop_map(|(a, b, kind)| {
        let times = |s| ImageSize::new(a.width() * s, a.height() * s).unwrap();
        match kind {
            0 => (times(4), a),
            1 => (times(2), a),
            2 => (a, a),
            3 => (a, times(2)),
            _ => (b, a),
        }
    })
}

fn values(count: usize, low: f32, high: f32) -> impl Strategy<Value = Vec<f32>> {
    prop::collection::vec(low..high, count)
}

#[derive(Debug, Clone)]
struct Case {
    output: ImageSize,
    head: ImageSize,
    ground: Vec<f32>,
    residual: Vec<f32>,
    attention: Vec<f32>,
    slope: Vec<f32>,
    upsampling: Upsampling,
    at: DecodeAt,
    units: (ResidualUnit, AttentionUnit),
}

fn residual_units() -> impl Strategy<Value = ResidualUnit> {
    prop_oneof![
        Just(ResidualUnit::Metres),
        Just(ResidualUnit::LogMetres),
        (50.0_f32..2000.0)
            .prop_map(|focal_length| ResidualUnit::LogMetresPerPixel { focal_length }),
    ]
}

fn case() -> impl Strategy<Value = Case> {
    let upsampling = prop_oneof![Just(Upsampling::HalfPixel), Just(Upsampling::AlignCorners)];
    let at = prop_oneof![Just(DecodeAt::HeadSize), Just(DecodeAt::OutputSize)];
    (
        sizes(),
        upsampling,
        at,
        any::<(bool, bool)>(),
        residual_units(),
    )
        .prop_flat_map(
            |((output, head), upsampling, at, (logit, large), residual_unit)| {
                // Softmax must not overflow, whatever the logits' size; upsampling large ones would round them.
                let size = match (at, large) {
                    (DecodeAt::HeadSize, true) => 400.0,
                    _ => 6.0,
                };
                let n = head.pixels();
                let residual = match residual_unit {
                    ResidualUnit::Metres => values(n, -5.0, 120.0),
                    ResidualUnit::LogMetres => values(n, -3.0, 5.0),
                    ResidualUnit::LogMetresPerPixel { .. } => values(n, -8.0, 0.0),
                };
                let attention = if logit {
                    values(n, -6.0, 6.0)
                } else {
                    values(n, -0.2, 1.2)
                };
                (
                    values(output.pixels(), -0.3, 0.5),
                    residual,
                    attention,
                    values(8 * n, -size, size),
                )
                    .prop_map(move |(ground, residual, attention, slope)| Case {
                        output,
                        head,
                        ground,
                        residual,
                        attention,
                        slope,
                        upsampling,
                        at,
                        units: (
                            residual_unit,
                            if logit {
                                AttentionUnit::Logit
                            } else {
                                AttentionUnit::Probability
                            },
                        ),
                    })
            },
        )
}

fn classes() -> SlopeClasses<8> {
    SlopeClasses::uniform(
        Angle::from_degrees(-6.0),
        Angle::from_degrees(8.0),
        8,
        SlopeSign::UphillPositive,
    )
    .unwrap()
}

fn fusion(upsampling: Upsampling) -> Fusion {
    Fusion::new(
        upsampling,
        DepthRange::new(MIN as f32, MAX as f32).unwrap(),
        LIMIT as f32,
    )
    .unwrap()
}

/// Depth, attention and ground of a mode: baseline without attention, vanilla without slope.
struct Fused {
    depth: Vec<f32>,
    attention: Vec<f32>,
    ground: Vec<f32>,
}

#[derive(Clone, Copy, PartialEq)]
enum Mode {
    Baseline,
    Vanilla,
    Adaptive,
}

fn fuse(case: &Case, mode: Mode, samples: [Samples<'_>; 3]) -> Result<Fused, Error> {
    fuse_rows(case, mode, samples, 0..case.output.height())
}

fn fuse_rows(
    case: &Case,
    mode: Mode,
    samples: [Samples<'_>; 3],
    rows: std::ops::Range<u32>,
) -> Result<Fused, Error> {
    let ground = GroundView::from_values(&case.ground, case.output, HEIGHT as f32)?;
    fuse_on(&Bounded(ground), case, mode, samples, rows)
}

/// A source that knows the largest value of each row.
struct Bounded<'a>(GroundView<'a>);

impl GroundRows for Bounded<'_> {
    fn size(&self) -> ImageSize {
        self.0.size()
    }

    fn camera_height(&self) -> f32 {
        self.0.camera_height()
    }

    fn write_row(&self, v: u32, row: &mut [f32]) -> Result<(), Error> {
        self.0.write_row(v, row)
    }

    fn row_bound(&self, v: u32) -> f32 {
        let mut row = vec![0.0; self.size().width() as usize];
        self.write_row(v, &mut row).unwrap();
        row.into_iter().fold(f32::MIN, f32::max)
    }
}

fn fuse_on(
    ground: &impl GroundRows,
    case: &Case,
    mode: Mode,
    samples: [Samples<'_>; 3],
    rows: std::ops::Range<u32>,
) -> Result<Fused, Error> {
    let classes = classes();
    let residual = ResidualHead {
        map: HeadMap::new(samples[0], 1, case.head)?,
        unit: case.units.0,
        decode_at: case.at,
    };
    let attention = AttentionHead {
        map: HeadMap::new(samples[1], 1, case.head)?,
        unit: case.units.1,
        decode_at: case.at,
    };
    let slope = SlopeHead {
        map: HeadMap::new(samples[2], 8, case.head)?,
        classes: &classes,
        decode_at: case.at,
    };
    let pixels = rows.len() * case.output.width() as usize;
    let mut fused = Fused {
        depth: vec![f32::NAN; pixels],
        attention: vec![f32::NAN; pixels],
        ground: vec![f32::NAN; pixels],
    };
    let slope_classes = if mode == Mode::Adaptive { 8 } else { 0 };
    let mut scratch = vec![f32::NAN; scratch_len(case.output, case.head.width(), slope_classes)];
    let fusion = fusion(case.upsampling).rows(rows);
    let maps = FusedMaps {
        depth: &mut fused.depth,
        attention: Some(&mut fused.attention),
        ground: Some(&mut fused.ground),
    };
    match mode {
        Mode::Baseline => {
            fusion.baseline(case.output, &residual, &mut scratch, maps.depth)?;
            // A program of all modes gives the same.
            let mut depth = vec![f32::NAN; pixels];
            let maps = FusedMaps {
                depth: &mut depth,
                attention: Some(&mut fused.attention),
                ground: Some(&mut fused.ground),
            };
            let (scratch, slope) = (&mut scratch, None::<&SlopeHead<'_, 8>>);
            fusion.any_mode(ground, &residual, None, slope, scratch, maps)?;
            assert_eq!(depth, fused.depth);
            assert!(
                [&fused.attention, &fused.ground]
                    .into_iter()
                    .flatten()
                    .all(|m| *m == 0.0)
            );
        }
        Mode::Vanilla => fusion.vanilla(ground, &residual, &attention, &mut scratch, maps)?,
        Mode::Adaptive => {
            fusion.adaptive(ground, &residual, &attention, &slope, &mut scratch, maps)?
        }
    }
    Ok(fused)
}

fn floats(case: &Case) -> [Samples<'_>; 3] {
    [
        Samples::F32(&case.residual),
        Samples::F32(&case.attention),
        Samples::F32(&case.slope),
    ]
}

fn agrees(case: &Case, mode: Mode) -> Result<(), TestCaseError> {
    let fused = fuse(case, mode, floats(case)).unwrap();
    let spread = |map: &[f32], decode: &dyn Fn(f64) -> f64| {
        plane(
            map,
            case.head,
            case.output,
            case.upsampling,
            case.at,
            decode,
        )
    };
    let residual = spread(&case.residual, &|x| match case.units.0 {
        ResidualUnit::Metres => x,
        ResidualUnit::LogMetres => x.exp(),
        ResidualUnit::LogMetresPerPixel { focal_length } => f64::from(focal_length) * x.exp(),
    });
    let attention = spread(&case.attention, &|x| match case.units.1 {
        AttentionUnit::Logit => 1.0 / (1.0 + (-x).exp()),
        AttentionUnit::Probability => x.clamp(0.0, 1.0),
    });
    let tangents = tangents(
        &case.slope,
        case.head,
        case.output,
        case.upsampling,
        case.at,
        &classes(),
    );
    for i in 0..case.output.pixels() {
        let mut expected = residual[i];
        if mode != Mode::Baseline {
            let mut inverse = f64::from(case.ground[i]);
            if mode == Mode::Adaptive {
                inverse -= tangents[i] / HEIGHT;
            }
            let z = if inverse >= 1.0 / LIMIT {
                1.0 / inverse
            } else {
                0.0
            };
            // Rounding at the cut decides between 150 m and none.
            if (inverse * LIMIT - 1.0).abs() < 1e-4 {
                continue;
            }
            // 1/z suffers most from rounding of its two parts.
            let tolerance = 1e-5 * (1.0 + z);
            prop_assert!(
                (f64::from(fused.ground[i]) - z).abs() < tolerance,
                "pixel {}: ground {} instead of {}",
                i,
                fused.ground[i],
                z
            );
            let m = attention[i];
            prop_assert!(
                (f64::from(fused.attention[i]) - m).abs() < 2e-6,
                "pixel {}: M {} instead of {}",
                i,
                fused.attention[i],
                m
            );
            expected = m * z + (1.0 - m) * expected;
        }
        let expected = expected.clamp(MIN, MAX);
        let error = (f64::from(fused.depth[i]) - expected).abs();
        prop_assert!(
            error < 1e-3 + 1e-5 * expected,
            "pixel {}: {} instead of {}",
            i,
            fused.depth[i],
            expected
        );
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 256, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn baseline(case in case()) {
        agrees(&case, Mode::Baseline)?;
    }

    #[test]
    fn vanilla(case in case()) {
        agrees(&case, Mode::Vanilla)?;
    }

    #[test]
    fn adaptive(case in case()) {
        agrees(&case, Mode::Adaptive)?;
    }

    /// Stripes of rows, each made on its own, are the very bytes of the whole.
    #[test]
    fn rows(case in case(), at in any::<prop::sample::Index>()) {
        let height = case.output.height();
        let at = at.index(height as usize + 1) as u32;
        for mode in [Mode::Baseline, Mode::Vanilla, Mode::Adaptive] {
            let whole = fuse(&case, mode, floats(&case)).unwrap();
            let stripes = [0..at, at..height].map(|r| fuse_rows(&case, mode, floats(&case), r).unwrap());
            let bits = |maps: [&[f32]; 2]| maps.concat().into_iter().map(f32::to_bits).collect::<Vec<_>>();
            prop_assert_eq!(bits([&stripes[0].depth, &stripes[1].depth]), bits([&whole.depth, &[]]));
            prop_assert_eq!(bits([&stripes[0].ground, &stripes[1].ground]), bits([&whole.ground, &[]]));
            prop_assert_eq!(
                bits([&stripes[0].attention, &stripes[1].attention]), bits([&whole.attention, &[]])
            );
        }
    }

    /// A source that knows which rows lie above all ground gives the very bytes of one that does not.
    #[test]
    fn bounds_of_rows_change_nothing(case in case(), lowered in 0.0..0.5_f32) {
        let mut case = case;
        for (i, inverse) in case.ground.iter_mut().enumerate() {
            *inverse -= lowered * (i / case.output.width() as usize % 2) as f32;
        }
        let ground = GroundView::from_values(&case.ground, case.output, HEIGHT as f32).unwrap();
        for mode in [Mode::Vanilla, Mode::Adaptive] {
            let rows = 0..case.output.height();
            let known = fuse(&case, mode, floats(&case)).unwrap();
            let unknown = fuse_on(&ground, &case, mode, floats(&case), rows).unwrap();
            prop_assert_eq!((known.depth, known.ground), (unknown.depth, unknown.ground));
            prop_assert_eq!(known.attention, unknown.attention);
        }
    }

    /// 8-bit heads are what they stand for, to the last bit.
    #[test]
    fn quantized_heads(
        case in case(), bytes in prop::collection::vec(any::<u8>(), 40 * 2 * 9 * 2 * 8),
        signed in any::<bool>(), zero in any::<u8>(), scale in 0.001..0.2_f32,
    ) {
        let n = case.head.pixels();
        let unsigned = &bytes[..8 * n];
        let signed_bytes: Vec<i8> = unsigned.iter().map(|b| *b as i8).collect();
        let number = |b: &u8| if signed {
            (i32::from(*b as i8) - i32::from(zero as i8)) as f32 * scale
        } else {
            (i32::from(*b) - i32::from(zero)) as f32 * scale
        };
        let numbers: Vec<f32> = unsigned.iter().map(number).collect();
        let pick = |count: usize| if signed {
            Samples::I8 { values: &signed_bytes[..count], scale, zero_point: zero as i8 }
        } else {
            Samples::U8 { values: &unsigned[..count], scale, zero_point: zero }
        };
        let quantized = fuse(&case, Mode::Adaptive, [pick(n), pick(n), pick(8 * n)]).unwrap();
        let plain = fuse(&case, Mode::Adaptive, [
            Samples::F32(&numbers[..n]), Samples::F32(&numbers[..n]), Samples::F32(&numbers),
        ]).unwrap();
        prop_assert_eq!(quantized.depth, plain.depth);
        prop_assert_eq!(quantized.ground, plain.ground);
    }

    /// No input within +-1e37, however absurd, gives a depth out of range; NaN and what is beyond are reported.
    #[test]
    fn absurd_numbers(
        case in case(), place in any::<prop::sample::Index>(), head in 0..3,
        value in prop_oneof![
            Just(f32::MAX), Just(f32::MIN), Just(1e37), Just(-1e37), Just(1e-42), Just(0.0), Just(f32::NAN), Just(f32::INFINITY), Just(f32::NEG_INFINITY),
        ],
    ) {
        // Rows that are left out when a head is made smaller are not looked at.
        prop_assume!(case.output.height() >= case.head.height());
        let mut case = case;
        let (values, name) = match head {
            0 => (&mut case.residual, Head::Residual),
            1 => (&mut case.attention, Head::Attention),
            _ => (&mut case.slope, Head::Slope),
        };
        let within = value.abs() <= 1e37;
        let i = place.index(values.len());
        values[i] = value;
        for mode in [Mode::Vanilla, Mode::Adaptive] {
            match fuse(&case, mode, floats(&case)) {
                Ok(fused) => {
                    // Slopes are not looked at where there is no ground, nor without a slope head.
                    prop_assert!(within || head == 2);
                    if !within {
                        let mut without = case.clone();
                        without.slope[i] = 0.0;
                        let without = fuse(&without, mode, floats(&without)).unwrap();
                        prop_assert_eq!((&fused.depth, &fused.ground), (&without.depth, &without.ground));
                    }
                    prop_assert!(fused.depth.iter().all(|d| (MIN as f32..=MAX as f32).contains(d)));
                    prop_assert!(fused.attention.iter().all(|m| (-1e-6..=1.0 + 1e-6).contains(m)));
                }
                Err(error) => {
                    prop_assert!(!within);
                    prop_assert_eq!(error, Error::HeadNotFinite(name));
                }
            }
        }
    }
}

fn row(count: u32) -> ImageSize {
    ImageSize::new(count, 1).unwrap()
}

/// Known values of both conventions, from PyTorch's `interpolate` of [0, 10, 20] to six columns.
#[test]
fn upsampling_conventions() {
    let map = [1.0_f32, 11.0, 21.0];
    for (how, expected) in [
        (Upsampling::HalfPixel, [1.0, 3.5, 8.5, 13.5, 18.5, 21.0]),
        (Upsampling::AlignCorners, [1.0, 5.0, 9.0, 13.0, 17.0, 21.0]),
    ] {
        let residual = ResidualHead {
            map: HeadMap::new(Samples::F32(&map), 1, row(3)).unwrap(),
            unit: ResidualUnit::Metres,
            decode_at: DecodeAt::HeadSize,
        };
        let mut depth = [0.0; 6];
        let mut scratch = vec![0.0; scratch_len(row(6), 3, 0)];
        fusion(how)
            .baseline(row(6), &residual, &mut scratch, &mut depth)
            .unwrap();
        for (value, expected) in depth.iter().zip(expected) {
            assert!((value - expected).abs() < 1e-5, "{how:?}: {depth:?}");
        }
    }
}

/// Where the ground is trusted wholly its depth is what comes out, whatever the residual head says there, which nothing teaches.
#[test]
fn trusted_ground_is_the_depth() {
    let (size, inverse) = (row(1), [1.0 / 3.3_f32]);
    let ground = GroundView::from_values(&inverse, size, 1.65).unwrap();
    fn head(values: &[f32]) -> HeadMap<'_> {
        HeadMap::new(Samples::F32(values), 1, row(1)).unwrap()
    }
    for (value, unit) in [
        (1e6, ResidualUnit::Metres),
        (-1e6, ResidualUnit::Metres),
        (
            14.0,
            ResidualUnit::LogMetresPerPixel {
                focal_length: 700.0,
            },
        ),
    ] {
        for (m, truth) in [(1.0, 3.3), (0.0, if value < 0.0 { MIN } else { MAX })] {
            let mut depth = [0.0];
            let at = DecodeAt::HeadSize;
            fusion(Upsampling::HalfPixel)
                .vanilla(
                    &ground,
                    &ResidualHead {
                        map: head(&[value]),
                        unit,
                        decode_at: at,
                    },
                    &AttentionHead {
                        map: head(&[m]),
                        unit: AttentionUnit::Probability,
                        decode_at: at,
                    },
                    &mut vec![0.0; scratch_len(size, 1, 1)],
                    FusedMaps {
                        depth: &mut depth,
                        attention: None,
                        ground: None,
                    },
                )
                .unwrap();
            assert!(
                (f64::from(depth[0]) - truth).abs() < 1e-6,
                "{value}, M = {m}: {}",
                depth[0]
            );
        }
    }
}

/// Raw values at the ends of what is accepted, upsampled between each other, are on the right side.
#[test]
fn opposite_extremes_side_by_side() {
    let (head, output) = (row(2), row(4));
    let values = [1e37, -1e37];
    let mut depth = [0.0; 4];
    fusion(Upsampling::AlignCorners)
        .baseline(
            output,
            &ResidualHead {
                map: HeadMap::new(Samples::F32(&values), 1, head).unwrap(),
                unit: ResidualUnit::Metres,
                decode_at: DecodeAt::OutputSize,
            },
            &mut vec![0.0; scratch_len(output, 2, 1)],
            &mut depth,
        )
        .unwrap();
    assert_eq!(
        depth.map(f64::from),
        [MAX, MAX, MIN, MIN].map(|z| f64::from(z as f32))
    );
}

/// The uphill sign raises the road: the same logits, read both ways.
#[test]
fn slope_signs_reach_the_depth() {
    let size = row(1);
    let ground = [0.1_f32];
    let ground = GroundView::from_values(&ground, size, 2.0).unwrap();
    let expect = |sign, degrees: f64| {
        let angles = [degrees].map(Angle::from_degrees);
        let classes = SlopeClasses::<8>::new(&angles, sign).unwrap();
        let head = |values| HeadMap::new(Samples::F32(values), 1, size).unwrap();
        let mut depth = [0.0];
        let at = DecodeAt::HeadSize;
        fusion(Upsampling::HalfPixel)
            .adaptive(
                &ground,
                &ResidualHead {
                    map: head(&[5.0]),
                    unit: ResidualUnit::Metres,
                    decode_at: at,
                },
                &AttentionHead {
                    map: head(&[1.0]),
                    unit: AttentionUnit::Probability,
                    decode_at: at,
                },
                &SlopeHead {
                    map: head(&[0.3]),
                    classes: &classes,
                    decode_at: at,
                },
                &mut vec![0.0; scratch_len(size, 1, 1)],
                FusedMaps {
                    depth: &mut depth,
                    attention: None,
                    ground: None,
                },
            )
            .unwrap();
        depth[0]
    };
    // 1 / (0.1 - tan(2 deg) / 2): farther downhill, nearer uphill.
    let tan = 2_f32.to_radians().tan() / 2.0;
    assert!((expect(SlopeSign::DownhillPositive, 2.0) - 1.0 / (0.1 - tan)).abs() < 1e-4);
    assert!((expect(SlopeSign::UphillPositive, 2.0) - 1.0 / (0.1 + tan)).abs() < 1e-4);
}

/// Rows that lie above all ground, whatever the slope, are told from those where the steepest climb just brings some.
#[test]
fn ground_begins_where_the_steepest_climb_brings_it() {
    let size = row(3);
    let climb = 8_f64.to_radians().tan() / HEIGHT;
    let least =
        fusion(Upsampling::HalfPixel).least_ground(HEIGHT as f32, classes().steepest_climb());
    for (slack, any) in [(1e-3, true), (-1e-3, false)] {
        let inverse = 1.0 / LIMIT * (1.0 + slack) - climb;
        if any {
            assert!(
                inverse >= f64::from(least),
                "what may be ground is not below {least}"
            );
        }
        let mut slope = vec![-40.0; 8 * 3];
        slope[3 * 7..].fill(40.0); // the last class: 8 degrees uphill
        let case = Case {
            output: size,
            head: size,
            ground: vec![-0.5, inverse as f32, -0.5],
            residual: vec![30.0; 3],
            attention: vec![0.5; 3],
            slope,
            upsampling: Upsampling::HalfPixel,
            at: DecodeAt::HeadSize,
            units: (ResidualUnit::Metres, AttentionUnit::Probability),
        };
        let fused = fuse(&case, Mode::Adaptive, floats(&case)).unwrap();
        let ground = if any { LIMIT / (1.0 + slack) } else { 0.0 };
        assert!(
            (f64::from(fused.ground[1]) - ground).abs() < 0.1,
            "{:?}",
            fused.ground
        );
        assert_eq!((fused.ground[0], fused.ground[2]), (0.0, 0.0));
        assert!((f64::from(fused.depth[1]) - (15.0 + ground / 2.0).min(MAX)).abs() < 0.1);
        agrees(&case, Mode::Adaptive).unwrap();
    }
}

/// Whether the source knows a bound of the row or not, slopes above all ground are not looked at; beside ground they are.
#[test]
fn slopes_above_all_ground_are_not_looked_at() {
    let size = row(2);
    let mut slope = vec![0.0; 8 * 2];
    slope[0] = f32::NAN;
    let least =
        fusion(Upsampling::HalfPixel).least_ground(HEIGHT as f32, classes().steepest_climb());
    let mut case = Case {
        output: size,
        head: size,
        ground: vec![-0.5, -0.5],
        residual: vec![30.0; 2],
        attention: vec![0.5; 2],
        slope,
        upsampling: Upsampling::HalfPixel,
        at: DecodeAt::HeadSize,
        units: (ResidualUnit::Metres, AttentionUnit::Probability),
    };
    for (last, looked_at) in [
        (-0.5, false),
        (least - 1e-5, false),
        (least, true),
        (0.1, true),
    ] {
        case.ground[1] = last;
        let unknown = GroundView::from_values(&case.ground, size, HEIGHT as f32).unwrap();
        let known = Bounded(GroundView::from_values(&case.ground, size, HEIGHT as f32).unwrap());
        for fused in [
            fuse_on(&unknown, &case, Mode::Adaptive, floats(&case), 0..1),
            fuse_on(&known, &case, Mode::Adaptive, floats(&case), 0..1),
        ] {
            let expected = looked_at.then_some(Error::HeadNotFinite(Head::Slope));
            assert_eq!(fused.err(), expected, "ground {:?}", case.ground);
        }
    }
}

/// Classes that all fall away leave ground where the flattest of them does, to within rounding.
#[test]
fn ground_ends_where_the_flattest_fall_leaves_none() {
    let size = row(1);
    let angles = [5.0, 8.0].map(Angle::from_degrees);
    let classes = SlopeClasses::<8>::new(&angles, SlopeSign::DownhillPositive).unwrap();
    let fall = 5_f64.to_radians().tan() / HEIGHT;
    for (above, any) in [(2e-6, true), (-2e-6, false)] {
        let inverse = [(1.0 / LIMIT + fall + above) as f32];
        let ground = Bounded(GroundView::from_values(&inverse, size, HEIGHT as f32).unwrap());
        let head = |values, channels| HeadMap::new(Samples::F32(values), channels, size).unwrap();
        let at = DecodeAt::HeadSize;
        let residual = ResidualHead {
            map: head(&[5.0], 1),
            unit: ResidualUnit::Metres,
            decode_at: at,
        };
        let attention = AttentionHead {
            map: head(&[1.0], 1),
            unit: AttentionUnit::Probability,
            decode_at: at,
        };
        let slope = SlopeHead {
            map: head(&[40.0, -40.0], 2),
            classes: &classes,
            decode_at: at,
        };
        let (mut depth, mut made) = ([0.0], [f32::NAN]);
        let maps = FusedMaps {
            depth: &mut depth,
            attention: None,
            ground: Some(&mut made),
        };
        let mut scratch = vec![0.0; scratch_len(size, 1, 2)];
        fusion(Upsampling::HalfPixel)
            .adaptive(&ground, &residual, &attention, &slope, &mut scratch, maps)
            .unwrap();
        let expected = if any {
            1.0 / (1.0 / LIMIT + above)
        } else {
            0.0
        };
        assert!(
            (f64::from(made[0]) - expected).abs() < 0.01,
            "{made:?}, not {expected}"
        );
    }
}

/// Fusion of every pixel's own numbers does not depend on what other pixels hold, nor on leaving maps out.
#[test]
fn maps_may_be_left_out() {
    let size = row(4);
    let ground = [0.1_f32, 0.2, -0.1, 0.0];
    let ground = GroundView::from_values(&ground, size, 2.0).unwrap();
    let residual = [5.0, 6.0, 7.0, 8.0];
    let attention = [0.0, 1.0, 0.5, 0.25];
    let head = |values| HeadMap::new(Samples::F32(values), 1, size).unwrap();
    let at = DecodeAt::HeadSize;
    let residual = ResidualHead {
        map: head(&residual),
        unit: ResidualUnit::Metres,
        decode_at: at,
    };
    let attention = AttentionHead {
        map: head(&attention),
        unit: AttentionUnit::Probability,
        decode_at: at,
    };
    let mut scratch = vec![0.0; scratch_len(size, 4, 0)];
    let mut depth = [0.0; 4];
    let maps = FusedMaps {
        depth: &mut depth,
        attention: None,
        ground: None,
    };
    fusion(Upsampling::HalfPixel)
        .vanilla(&ground, &residual, &attention, &mut scratch, maps)
        .unwrap();
    // No ground is a depth of 0 that M still weighs in, as in training.
    assert_eq!(depth, [5.0, 5.0, 3.5, 6.0]);
}

/// What is refused, and that the numbers in errors are right.
/// Each refusal says how much would have been enough to get farther, and `scratch_len` is enough, with nothing to spare
/// where heads are upsampled by any factor.
#[test]
fn scratch_is_as_long_as_needed() {
    let output = ImageSize::new(12, 3).unwrap();
    let inverse = [0.1; 36];
    let ground = GroundView::from_values(&inverse, output, 1.5).unwrap();
    let asked = |head_width: u32, count: usize, at: DecodeAt| {
        let head = ImageSize::new(head_width, 2).unwrap();
        let values = vec![0.5; count.max(1) * head.pixels()];
        let map = |channels: usize| {
            HeadMap::new(
                Samples::F32(&values[..channels * head.pixels()]),
                channels,
                head,
            )
        };
        let residual = ResidualHead {
            map: map(1).unwrap(),
            unit: ResidualUnit::Metres,
            decode_at: at,
        };
        let attention = AttentionHead {
            map: map(1).unwrap(),
            unit: AttentionUnit::Logit,
            decode_at: at,
        };
        let degrees = (0..count).map(|i| Angle::from_degrees(i as f64));
        let angles: Vec<Angle> = degrees.collect();
        // Not 0: what a refusal says has to count what is left.
        let mut length = 1;
        loop {
            let mut depth = [0.0; 36];
            let maps = FusedMaps {
                depth: &mut depth,
                ..FusedMaps::default()
            };
            let (fusion, mut scratch) = (fusion(Upsampling::AlignCorners), vec![0.0; length]);
            let result = if count > 0 {
                let slope = SlopeHead {
                    map: map(count).unwrap(),
                    classes: &SlopeClasses::<8>::new(&angles, SlopeSign::DownhillPositive).unwrap(),
                    decode_at: at,
                };
                fusion.adaptive(&ground, &residual, &attention, &slope, &mut scratch, maps)
            } else {
                fusion.vanilla(&ground, &residual, &attention, &mut scratch, maps)
            };
            match result {
                Err(Error::ScratchLength { needed, given }) => {
                    assert!(given == length && needed > length);
                    length = needed;
                }
                other => {
                    other.unwrap();
                    return length;
                }
            }
        }
    };
    for count in [0, 1, 3] {
        let needed = asked(5, count, DecodeAt::OutputSize);
        assert_eq!(needed, scratch_len(output, 5, count), "{count} classes");
        for width in [1, 2, 5, 12, 13, 40] {
            let enough = scratch_len(output, width, count);
            assert!(asked(width, count, DecodeAt::OutputSize) <= enough);
            let enough = scratch_len(output, width, count.min(1));
            assert!(asked(width, count, DecodeAt::HeadSize) <= enough);
        }
    }
}

#[test]
fn refusals() {
    let size = ImageSize::new(8, 4).unwrap();
    let values = [0.5_f32; 32];
    let map = HeadMap::new(Samples::F32(&values), 1, size).unwrap();
    assert_eq!((map.channels(), map.size()), (1, size));
    assert_eq!(
        HeadMap::new(Samples::F32(&values[1..]), 1, size).unwrap_err(),
        Error::HeadLength {
            needed: 32,
            given: 31
        }
    );
    assert_eq!(
        HeadMap::new(
            Samples::U8 {
                values: &[0; 65],
                scale: 1.0,
                zero_point: 0
            },
            2,
            size
        )
        .unwrap_err(),
        Error::HeadLength {
            needed: 64,
            given: 65
        }
    );
    for scale in [0.0, -1.0, 4e34, f32::MAX, f32::INFINITY] {
        let samples = Samples::I8 {
            values: &[0; 32],
            scale,
            zero_point: 0,
        };
        assert_eq!(
            HeadMap::new(samples, 1, size).unwrap_err(),
            Error::QuantizationScale(scale)
        );
    }
    let huge = HeadMap::new(Samples::F32(&[f32::MAX; 32]), 1, size).unwrap();

    for (min, max) in [
        (0.0, 1.0),
        (1.0, 1.0),
        (-1.0, 1.0),
        (1.0, f32::INFINITY),
        (f32::NAN, 1.0),
    ] {
        assert!(matches!(
            DepthRange::new(min, max),
            Err(Error::DepthRange { .. })
        ));
    }
    let range = DepthRange::new(0.1, 80.0).unwrap();
    assert_eq!((range.min(), range.max()), (0.1, 80.0));
    for limit in [0.0, -1.0, f32::INFINITY, 1e-45] {
        assert_eq!(
            Fusion::new(Upsampling::HalfPixel, range, limit),
            Err(Error::GroundLimit(limit))
        );
    }

    let at = DecodeAt::HeadSize;
    let residual = |map| ResidualHead {
        map,
        unit: ResidualUnit::Metres,
        decode_at: at,
    };
    let attention = |map| AttentionHead {
        map,
        unit: AttentionUnit::Logit,
        decode_at: at,
    };
    let classes = classes();
    let slope = |map| SlopeHead {
        map,
        classes: &classes,
        decode_at: at,
    };
    let two = HeadMap::new(Samples::F32(&values), 2, ImageSize::new(8, 2).unwrap()).unwrap();
    let table = [0.1_f32; 32];
    let ground = GroundView::from_values(&table, size, 1.5).unwrap();
    let fusion = fusion(Upsampling::HalfPixel);
    let need = scratch_len(size, 8, 8);
    let run = |r, a, s, scratch: usize, lengths: [usize; 3]| {
        let (mut depth, mut m, mut z) = (
            vec![0.0; lengths[0]],
            vec![0.0; lengths[1]],
            vec![0.0; lengths[2]],
        );
        let maps = FusedMaps {
            depth: &mut depth,
            attention: Some(&mut m),
            ground: Some(&mut z),
        };
        fusion
            .adaptive(
                &ground,
                &residual(r),
                &attention(a),
                &slope(s),
                &mut vec![0.0; scratch],
                maps,
            )
            .unwrap_err()
    };
    let logits = vec![0.0; 8 * 32];
    let eight = HeadMap::new(Samples::F32(&logits), 8, size).unwrap();
    let all = [32; 3];
    assert_eq!(
        run(two, map, eight, need, all),
        Error::HeadChannels { given: 2 }
    );
    assert_eq!(
        run(map, two, eight, need, all),
        Error::HeadChannels { given: 2 }
    );
    assert_eq!(
        run(map, map, map, need, all),
        Error::SlopeLogitCount {
            classes: 8,
            given: 1
        }
    );
    assert_eq!(
        run(huge, map, eight, need, all),
        Error::HeadNotFinite(Head::Residual)
    );
    for k in 0..3 {
        let mut lengths = all;
        lengths[k] = 31;
        assert_eq!(
            run(map, map, eight, need, lengths),
            Error::OutputLength {
                needed: 32,
                given: 31
            }
        );
    }
    assert!(matches!(
        run(map, map, eight, 10, all),
        Error::ScratchLength { given: 10, .. }
    ));
    assert_eq!(
        fusion.baseline(size, &residual(map), &mut vec![0.0; need], &mut [0.0; 33]),
        Err(Error::OutputLength {
            needed: 32,
            given: 33
        })
    );
}

/// A ground source whose rows are not there.
#[test]
fn ground_sources_that_fail() {
    struct Short;
    impl gedepth_core::table::GroundRows for Short {
        fn size(&self) -> ImageSize {
            row(2)
        }
        fn camera_height(&self) -> f32 {
            1.0
        }
        fn write_row(&self, v: u32, _: &mut [f32]) -> Result<(), Error> {
            Err(Error::GroundRow { row: v })
        }
    }
    let values = [1.0, 1.0];
    let map = HeadMap::new(Samples::F32(&values), 1, row(2)).unwrap();
    let at = DecodeAt::HeadSize;
    let result = fusion(Upsampling::HalfPixel).vanilla(
        &Short,
        &ResidualHead {
            map,
            unit: ResidualUnit::Metres,
            decode_at: at,
        },
        &AttentionHead {
            map,
            unit: AttentionUnit::Probability,
            decode_at: at,
        },
        &mut [0.0; 100],
        FusedMaps {
            depth: &mut [0.0; 2],
            attention: None,
            ground: None,
        },
    );
    assert_eq!(result, Err(Error::GroundRow { row: 0 }));
}
