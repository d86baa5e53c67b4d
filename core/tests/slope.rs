//! Slope classes, their expectation, labels and the adaptive depth.
#![allow(clippy::unwrap_used)]

use gedepth_core::camera::{CameraModel, ImageSize, Intrinsics, Pinhole, Pixel};
use gedepth_core::slope::{SlopeClasses, SlopeSign, adaptive_inverse_depth, slope_from_depth};
use gedepth_core::{Angle, Error, Ground};
use proptest::prelude::*;

fn paper(sign: SlopeSign) -> SlopeClasses {
    SlopeClasses::uniform(
        Angle::from_degrees(-5.0),
        Angle::from_degrees(5.0),
        11,
        sign,
    )
    .unwrap()
}

/// The paper's 11 classes, both signs; inside, downhill is positive.
#[test]
fn classes_and_signs() {
    let downhill = paper(SlopeSign::DownhillPositive);
    let uphill = paper(SlopeSign::UphillPositive);
    assert_eq!(downhill.radians().len(), 11);
    for (i, (down, up)) in downhill.radians().iter().zip(uphill.radians()).enumerate() {
        let degrees = i as f32 - 5.0;
        assert!((down.to_degrees() - degrees).abs() < 1e-5);
        assert!((up.to_degrees() + degrees).abs() < 1e-5);
    }
    // Given angles need not be equidistant.
    let given = [-5.0, -1.0, 0.0, 30.0].map(Angle::from_degrees);
    let classes = SlopeClasses::<4>::new(&given, SlopeSign::DownhillPositive).unwrap();
    assert!((classes.radians()[3] - 30_f32.to_radians()).abs() < 1e-6);
    let one = SlopeClasses::<4>::uniform(Angle::ZERO, Angle::ZERO, 1, SlopeSign::UphillPositive);
    assert_eq!(one.unwrap().radians(), [0.0]);
}

/// What the steepest class climbs, whatever its place and the network's sign; nothing where all fall away.
#[test]
fn steepest_climb() {
    use SlopeSign::{DownhillPositive, UphillPositive};
    for (degrees, sign, climb) in [
        ([-3.0, 0.0, 7.0], DownhillPositive, 3_f64),
        ([-3.0, 0.0, 7.0], UphillPositive, 7.0),
        ([1.0, 2.0, 7.0], DownhillPositive, 0.0),
        ([1.0, 2.0, 7.0], UphillPositive, 7.0),
    ] {
        let classes = SlopeClasses::<3>::new(&degrees.map(Angle::from_degrees), sign).unwrap();
        let expected = climb.to_radians().tan() as f32;
        assert!(
            (classes.steepest_climb() - expected).abs() < 1e-6,
            "{degrees:?}, {sign:?}"
        );
    }
}

#[test]
fn classes_that_are_refused() {
    let make = |degrees: &[f64]| {
        let angles: Vec<_> = degrees.iter().copied().map(Angle::from_degrees).collect();
        SlopeClasses::<3>::new(&angles, SlopeSign::DownhillPositive).unwrap_err()
    };
    assert_eq!(
        make(&[]),
        Error::SlopeClassCount {
            given: 0,
            capacity: 3
        }
    );
    assert_eq!(
        make(&[1.0, 2.0, 3.0, 4.0]),
        Error::SlopeClassCount {
            given: 4,
            capacity: 3
        }
    );
    assert!(matches!(
        make(&[0.0, 31.0]),
        Error::SlopeAngle { index: 1, .. }
    ));
    assert!(matches!(make(&[-30.1]), Error::SlopeAngle { index: 0, .. }));
    assert!(matches!(
        make(&[f64::NAN]),
        Error::SlopeAngle { index: 0, .. }
    ));
    assert!(matches!(
        make(&[1.0, 1.0]),
        Error::SlopeAngle { index: 1, .. }
    ));
    assert!(matches!(
        make(&[1.0, 2.0, -2.0]),
        Error::SlopeAngle { index: 2, .. }
    ));
    let many = SlopeClasses::<3>::uniform(
        Angle::ZERO,
        Angle::from_degrees(3.0),
        4,
        SlopeSign::UphillPositive,
    );
    assert_eq!(
        many.unwrap_err(),
        Error::SlopeClassCount {
            given: 4,
            capacity: 3
        }
    );
    let none = SlopeClasses::<3>::uniform(
        Angle::ZERO,
        Angle::from_degrees(3.0),
        0,
        SlopeSign::UphillPositive,
    );
    assert_eq!(
        none.unwrap_err(),
        Error::SlopeClassCount {
            given: 0,
            capacity: 3
        }
    );
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 512, failure_persistence: None, ..ProptestConfig::default() })]

    /// Softmax and expectation against f64, for logits of ordinary and of absurd size.
    #[test]
    fn expectation(logits in prop::array::uniform11(-1.0..1.0_f32), scale in prop_oneof![Just(1.0_f32), Just(30.0), Just(1e4), Just(3e38)]) {
        let classes = paper(SlopeSign::DownhillPositive);
        let logits = logits.map(|l| l * scale);
        let largest = logits.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let weights = logits.map(|l| (f64::from(l) - f64::from(largest)).exp());
        let sum: f64 = weights.iter().sum();
        let expected: f64 = weights.iter().enumerate().map(|(i, w)| w / sum * (i as f64 - 5.0).to_radians()).sum();
        let angle = classes.expected_angle(&logits).unwrap();
        prop_assert!((f64::from(angle) - expected).abs() < 2e-7, "{} instead of {}", angle, expected);
    }

    /// Depth on a sloped road, measured, gives the slope back; and its class.
    #[test]
    fn label_from_depth(slope in -20.0..20.0_f64, plane in 0.001..0.5_f64, height in 0.5..3.0, class in 0_usize..11) {
        let ground = Ground::from_mounting(height, Angle::ZERO, Angle::ZERO).unwrap();
        let inverse = adaptive_inverse_depth(plane, slope.to_radians(), &ground);
        prop_assume!(inverse > 1e-4);
        let label = slope_from_depth(plane, 1.0 / inverse, &ground).unwrap();
        prop_assert!((label.degrees() - slope).abs() < 1e-9);
        let classes = paper(SlopeSign::UphillPositive);
        // 0.4 degrees off is still this class; its own sign is uphill.
        for off in [-0.4, 0.0, 0.4] {
            let near = -(class as f32 - 5.0 + off).to_radians();
            prop_assert_eq!(classes.nearest_class(near), Some(class));
        }
    }
}

/// A road that falls away by alpha, as geometry: the ray meets y = h + tan(alpha) z (Eq. 6).
#[test]
fn adaptive_depth_is_equation_6() {
    let (height, focal) = (1.65, 700.0);
    let camera = Pinhole::new(
        Intrinsics::new(
            ImageSize::new(1200, 400).unwrap(),
            focal,
            focal,
            600.0,
            180.0,
        )
        .unwrap(),
    );
    let ground = Ground::from_mounting(height, Angle::ZERO, Angle::ZERO).unwrap();
    for v in [190.0, 250.0, 399.0] {
        let point = camera.forward_ray(Pixel::new(10.0, v)).unwrap();
        let plane = ground.inverse_depth(point);
        for degrees in [-5.0_f64, -1.0, 0.0, 0.5] {
            let tan = degrees.to_radians().tan();
            // y = y' z = h + tan z
            let z = height / ((v - 180.0) / focal - tan);
            let inverse = adaptive_inverse_depth(plane, degrees.to_radians(), &ground);
            assert!(
                (inverse - 1.0 / z).abs() < 1e-12,
                "row {v}, {degrees} degrees"
            );
        }
    }
    // Uphill brings ground above the plane's vanishing line.
    let above = ground.inverse_depth(camera.forward_ray(Pixel::new(10.0, 170.0)).unwrap());
    assert!(above < 0.0 && adaptive_inverse_depth(above, (-2_f64).to_radians(), &ground) > 0.0);
}

#[test]
fn logits_that_are_refused_and_ties() {
    let classes = paper(SlopeSign::DownhillPositive);
    assert_eq!(
        classes.expected_angle(&[0.0; 10]),
        Err(Error::SlopeLogitCount {
            classes: 11,
            given: 10
        })
    );
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut logits = [0.0; 11];
        logits[7] = bad;
        assert_eq!(
            classes.expected_angle(&logits),
            Err(Error::SlopeLogitNotFinite { index: 7 })
        );
    }
    // Equal logits give the mean angle, whatever their size.
    for level in [0.0, 5.0, f32::MAX, f32::MIN] {
        assert!(classes.expected_angle(&[level; 11]).unwrap().abs() < 1e-8);
    }
    // Beyond the last class it is the last; NaN is none.
    for far in [1.0, 1e6, 1e7, f32::MAX, f32::INFINITY] {
        assert_eq!(classes.nearest_class(far), Some(10));
        assert_eq!(classes.nearest_class(-far), Some(0));
    }
    assert_eq!(classes.nearest_class(f32::NAN), None);
}

#[test]
fn depths_without_a_slope() {
    let ground = Ground::from_mounting(1.5, Angle::ZERO, Angle::ZERO).unwrap();
    for measured in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert_eq!(slope_from_depth(0.1, measured, &ground), None);
    }
    assert_eq!(slope_from_depth(f64::NAN, 10.0, &ground), None);
    assert_eq!(
        slope_from_depth(0.1, 10.0, &ground).map(Angle::degrees),
        Some(0.0)
    );
}
