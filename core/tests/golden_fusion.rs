//! The reference implementation's fusion: its own numbers at edge cases, and a small case computed with PyTorch from the
//! description in `fusion/reference.rs`.
#![allow(clippy::unwrap_used, clippy::excessive_precision)]

use gedepth_core::camera::ImageSize;
use gedepth_core::fusion::{
    DecodeAt, DepthRange, HeadMap, ReferenceFusion, Samples, SlopeHead, reference_scratch_len,
};
use gedepth_core::slope::{SlopeClasses, SlopeSign};
use gedepth_core::table::GroundView;
use gedepth_core::{Angle, Error};

fn settings() -> ReferenceFusion {
    ReferenceFusion::new(1.65, 200.0, DepthRange::new(1e-3, 80.0).unwrap()).unwrap()
}

/// `count` values (i a + b) mod c / c.
fn sequence(count: u32, a: u32, b: u32, c: u32) -> Vec<f32> {
    (0..count)
        .map(|i| ((i * a + b) % c) as f32 / c as f32)
        .collect()
}

const VANILLA: [f32; 48] = [
    1.088912, 2.33224, 3.575568, 2.850293, 1.140717, 0.2176404, 0.867562, 1.517484, 19.82518,
    16.88389, 13.9426, 15.69938, 19.80519, 19.5492, 10.56961, 1.590011, 38.56144, 31.43554,
    24.30963, 28.54846, 38.46966, 38.88076, 20.27165, 1.662539, 39.97243, 32.01199, 24.05155,
    28.59807, 39.39808, 40.65438, 22.8233, 4.99221, 24.05814, 18.61324, 13.16835, 15.8482,
    22.59043, 24.87008, 18.22455, 11.57902, 8.143858, 5.214501, 2.285145, 3.098331, 5.78279,
    9.085773, 13.6258, 18.16584,
];
const ADAPTIVE: [f32; 48] = [
    1.088912, 2.33224, 3.575568, 2.850293, 1.140717, 0.2176404, 0.867562, 1.517484, 7.704375,
    6.471807, 5.239238, 8.175156, 13.19532, 14.40324, 7.986704, 1.570163, 14.31984, 10.61137,
    6.902908, 13.50002, 25.24992, 28.58885, 15.10585, 1.622843, 15.74759, 11.19617, 6.644757,
    13.5459, 26.17333, 30.35688, 17.65267, 4.948466, 11.98763, 8.226207, 4.464785, 8.312814,
    15.96557, 19.70735, 15.62719, 11.54703, 8.227672, 5.256242, 2.284812, 3.079724, 5.757806,
    9.057823, 13.60171, 18.1456,
];

/// Input 8x6 with ground depths of -20, -60, 200, 12, 6 and 3 m by row, decoder 4x3, slope head 4x2 of three classes.
#[test]
fn small_case_from_pytorch() -> Result<(), Error> {
    let (input, decoder) = (ImageSize::new(8, 6)?, ImageSize::new(4, 3)?);
    let inverse: Vec<f32> = [-20.0_f32, -60.0, 200.0, 12.0, 6.0, 3.0]
        .iter()
        .flat_map(|depth| [1.0 / depth; 8])
        .collect();
    let ground = GroundView::from_values(&inverse, input, 1.578)?;
    let residual: Vec<f32> = sequence(12, 3, 1, 7)
        .iter()
        .map(|x| x * 30.0 - 3.0)
        .collect();
    let attention = sequence(48, 5, 2, 13);
    let logits: Vec<f32> = sequence(24, 7, 3, 11)
        .iter()
        .map(|x| x * 4.0 - 2.0)
        .collect();
    let residual = HeadMap::new(Samples::F32(&residual), 1, decoder)?;
    let attention = HeadMap::new(Samples::F32(&attention), 1, input)?;
    let angles = [-4.0, 0.0, 4.0].map(Angle::from_degrees);
    let classes = SlopeClasses::<3>::new(&angles, SlopeSign::UphillPositive)?;
    let slope = SlopeHead {
        map: HeadMap::new(Samples::F32(&logits), 3, ImageSize::new(4, 2)?)?,
        classes: &classes,
        decode_at: DecodeAt::HeadSize,
    };
    let mut depth = [0.0; 48];
    let close = |depth: &[f32], expected: &[f32]| {
        for (i, (a, b)) in depth.iter().zip(expected).enumerate() {
            assert!(
                (a - b).abs() <= 2e-6 * b + 2e-6,
                "pixel {i}: {a}, reference {b}"
            );
        }
    };
    let mut scratch = vec![0.0; reference_scratch_len(input, 4, 4, 0)];
    settings().vanilla(&ground, &residual, &attention, &mut scratch, &mut depth)?;
    close(&depth, &VANILLA);
    let mut scratch = vec![0.0; reference_scratch_len(input, 4, 4, 3)];
    settings().adaptive(
        &ground,
        &residual,
        &attention,
        &slope,
        &mut scratch,
        &mut depth,
    )?;
    close(&depth, &ADAPTIVE);
    Ok(())
}

/// One pixel that is all ground, with one slope class.
fn ground_alone(plane: f32, uphill_degrees: f64) -> Result<f32, Error> {
    let one = ImageSize::new(1, 1)?;
    let inverse = [1.0 / plane];
    let ground = GroundView::from_values(&inverse, one, 1.578)?;
    let map = |value| HeadMap::new(Samples::F32(value), 1, one);
    let angles = [Angle::from_degrees(uphill_degrees)];
    let classes = SlopeClasses::<1>::new(&angles, SlopeSign::UphillPositive)?;
    let slope = SlopeHead {
        map: map(&[0.5])?,
        classes: &classes,
        decode_at: DecodeAt::OutputSize,
    };
    let mut depth = [0.0];
    let mut scratch = vec![0.0; reference_scratch_len(one, 1, 1, 1)];
    let range = DepthRange::new(1e-6, 1e3)?;
    ReferenceFusion::new(1.65, 200.0, range)?.adaptive(
        &ground,
        &map(&[7.0])?,
        &map(&[1.0])?,
        &slope,
        &mut scratch,
        &mut depth,
    )?;
    Ok(depth[0] - 1e-6)
}

/// (plane depth, degrees uphill, the reference's adaptive depth), recorded from the reference's own functions.
const EDGES: [(f32, f64, f32); 26] = [
    (1.65, -5.0, 1.80819666),
    (-1.65, -5.0, 0.0),
    (5.0, -5.0, 6.80380535),
    (18.0, -5.0, 0.0),
    (1e6, -5.0, 0.0),
    (1.65, -2.0, 1.70970404),
    (18.0, -2.0, 29.0769978),
    (18.86, -2.0, 31.3891335),
    (20.0, -2.0, 34.6790047),
    (150.0, -2.0, 0.0),
    (1.65, 0.0, 1.64999998),
    (18.0, 0.0, 18.0000019),
    (150.0, 0.0, 150.000137),
    (199.99, 0.0, 199.990234),
    (250.0, 0.0, 0.0),
    (1e6, 0.0, 0.0),
    (-5.0, 0.0, 0.0),
    (1.65, 2.0, 1.59432483),
    (20.0, 2.0, 14.0520287),
    (250.0, 2.0, 39.7391548),
    (1e6, 2.0, 47.2475967),
    (-1e6, 2.0, 47.2520638),
    (-5.0, 2.0, 0.0),
    (f32::INFINITY, 2.0, 47.2498283),
    (1e-3, 0.0, 0.00100001006),
    (-1e6, 5.0, 18.8599434),
];

#[test]
fn edge_cases_of_the_reference() -> Result<(), Error> {
    for (plane, degrees, reference) in EDGES {
        let depth = ground_alone(plane, degrees)?;
        assert!(
            (depth - reference).abs() <= 1e-6 * reference + 2e-6,
            "{plane} m, {degrees} degrees: {depth} m, reference {reference} m"
        );
    }
    Ok(())
}

/// As for the other modes in tests/fusion.rs.
#[test]
fn scratch_is_as_long_as_needed() -> Result<(), Error> {
    let (input, decoder) = (ImageSize::new(12, 3)?, ImageSize::new(7, 2)?);
    let (inverse, values) = ([0.1; 36], [0.5; 45]);
    let ground = GroundView::from_values(&inverse, input, 1.5)?;
    let residual = HeadMap::new(Samples::F32(&values[..14]), 1, decoder)?;
    let attention = HeadMap::new(Samples::F32(&values[..36]), 1, input)?;
    let angles = [-4.0, 0.0, 4.0].map(Angle::from_degrees);
    let classes = SlopeClasses::<3>::new(&angles, SlopeSign::UphillPositive)?;
    let slope = SlopeHead {
        map: HeadMap::new(Samples::F32(&values), 3, ImageSize::new(5, 3)?)?,
        classes: &classes,
        decode_at: DecodeAt::OutputSize,
    };
    for count in [0, 3] {
        let mut length = 0;
        loop {
            let (mut scratch, mut depth) = (vec![0.0; length], [0.0; 36]);
            let result = if count > 0 {
                settings().adaptive(
                    &ground,
                    &residual,
                    &attention,
                    &slope,
                    &mut scratch,
                    &mut depth,
                )
            } else {
                settings().vanilla(&ground, &residual, &attention, &mut scratch, &mut depth)
            };
            let Err(Error::ScratchLength { needed, given }) = result else {
                result?;
                break;
            };
            assert!(given == length && needed > length);
            length = needed;
        }
        assert_eq!(length, reference_scratch_len(input, 7, 5, count));
    }
    Ok(())
}

#[test]
fn refusals() -> Result<(), Error> {
    let range = DepthRange::new(1e-3, 80.0)?;
    for bad in [0.0, -1.0, f32::INFINITY] {
        assert!(matches!(
            ReferenceFusion::new(bad, 200.0, range),
            Err(Error::CameraNotAboveGround { .. })
        ));
        assert_eq!(
            ReferenceFusion::new(1.65, bad, range),
            Err(Error::GroundLimit(bad))
        );
    }
    let (four, two) = (ImageSize::new(4, 1)?, ImageSize::new(2, 2)?);
    let inverse = [0.1; 4];
    let ground = GroundView::from_values(&inverse, four, 1.5)?;
    let good = HeadMap::new(Samples::F32(&[0.5; 4]), 1, four)?;
    let other = HeadMap::new(Samples::F32(&[0.5; 4]), 1, two)?;
    let double = HeadMap::new(Samples::F32(&[0.5; 4]), 2, ImageSize::new(2, 1)?)?;
    let infinite = HeadMap::new(Samples::F32(&[f32::INFINITY; 4]), 1, four)?;
    let run = |residual, attention, scratch: usize, depth: usize| {
        let (mut scratch, mut depth) = (vec![0.0; scratch], vec![0.0; depth]);
        settings().vanilla(&ground, residual, attention, &mut scratch, &mut depth)
    };
    assert_eq!(
        run(&good, &other, 99, 4),
        Err(Error::HeadSize {
            needed: four,
            given: two
        })
    );
    assert_eq!(
        run(&double, &good, 99, 4),
        Err(Error::HeadChannels { given: 2 })
    );
    assert_eq!(
        run(&good, &double, 99, 4),
        Err(Error::HeadChannels { given: 2 })
    );
    assert_eq!(
        run(&good, &good, 99, 5),
        Err(Error::OutputLength {
            needed: 4,
            given: 5
        })
    );
    assert!(matches!(
        run(&good, &good, 3, 4),
        Err(Error::ScratchLength { given: 3, .. })
    ));
    assert!(matches!(
        run(&infinite, &good, 99, 4),
        Err(Error::HeadNotFinite(_))
    ));
    assert!(matches!(
        run(&good, &infinite, 99, 4),
        Err(Error::HeadNotFinite(_))
    ));
    assert_eq!(run(&good, &good, 99, 4), Ok(()));
    Ok(())
}
