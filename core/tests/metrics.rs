//! Metrics against their definitions, by hand and by brute force.
#![allow(clippy::unwrap_used)]

use gedepth_core::camera::ImageSize;
use gedepth_core::fusion::DepthRange;
use gedepth_core::metrics::{
    ByDistance, ByRegion, CloudMatches, Crop, DepthErrors, Evaluation, cloud_scratch_len,
};
use gedepth_core::{CameraFrame, Error, Point};
use proptest::prelude::*;

fn errors(pairs: &[(f32, f32)]) -> DepthErrors {
    let mut errors = DepthErrors::new();
    for (predicted, truth) in pairs {
        errors.add(*predicted, *truth);
    }
    errors
}

/// Three pixels by hand: p = 10, 8, 3; t = 8, 10, 2.
#[test]
fn depth_metrics_by_hand() {
    let m = errors(&[(10.0, 8.0), (8.0, 10.0), (3.0, 2.0)])
        .metrics()
        .unwrap();
    let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-12, "{a} instead of {b}");
    assert_eq!(m.count, 3);
    close(m.abs_rel, (0.25 + 0.2 + 0.5) / 3.0);
    close(m.sq_rel, (0.5 + 0.4 + 0.5) / 3.0);
    close(m.rmse, 3_f64.sqrt());
    let (a, b) = (1.25_f64.ln(), 1.5_f64.ln());
    close(m.rmse_log, ((2.0 * a * a + b * b) / 3.0).sqrt());
    // Mean of the logs: (a - a + b) / 3.
    close(
        m.silog,
        100.0 * ((2.0 * a * a + b * b) / 3.0 - b * b / 9.0).sqrt(),
    );
    // Ratios 1.25, 1.25 and 1.5: "below" leaves 1.25 itself out.
    assert_eq!(m.delta, [0.0, 1.0, 1.0]);
    // A common factor costs nothing in SILog.
    let scaled = errors(&[(2.0, 1.0), (6.0, 3.0), (80.0, 40.0)])
        .metrics()
        .unwrap();
    assert!(scaled.silog < 1e-5 && (scaled.abs_rel - 1.0).abs() < 1e-12);
    assert_eq!(scaled.delta, [0.0, 0.0, 0.0]);
    // 1.25^3 = 1.953125.
    assert_eq!(
        errors(&[(1.95, 1.0)]).metrics().unwrap().delta,
        [0.0, 0.0, 1.0]
    );
}

#[test]
fn what_cannot_be_compared_is_rejected() {
    let bad = [
        (0.0, 1.0),
        (1.0, 0.0),
        (-1.0, 1.0),
        (1.0, f32::NAN),
        (f32::INFINITY, 1.0),
    ];
    let mut all = errors(&bad);
    assert_eq!((all.metrics(), all.rejected()), (None, 5));
    all.merge(&errors(&[(2.0, 2.0), (f32::NAN, 1.0)]));
    assert_eq!((all.metrics().unwrap().count, all.rejected()), (1, 6));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 128, failure_persistence: None, ..ProptestConfig::default() })]

    /// Parts merged are the whole, by distance and by region too.
    #[test]
    fn merging(pairs in prop::collection::vec((0.5..90.0_f32, 0.5..90.0_f32), 1..60), cut in any::<prop::sample::Index>()) {
        let cut = cut.index(pairs.len());
        let (first, second) = pairs.split_at(cut);
        let whole = errors(&pairs).metrics().unwrap();
        let mut merged = errors(first);
        merged.merge(&errors(second));
        let merged = merged.metrics().unwrap();
        prop_assert_eq!((merged.count, merged.delta), (whole.count, whole.delta));
        for (a, b) in [
            (merged.abs_rel, whole.abs_rel), (merged.sq_rel, whole.sq_rel), (merged.rmse, whole.rmse),
            (merged.rmse_log, whole.rmse_log), (merged.silog, whole.silog),
        ] {
            prop_assert!((a - b).abs() < 1e-9 * (1.0 + b), "{} instead of {}", a, b);
        }

        let limits = [20.0, 40.0, 60.0];
        let collect = |pairs: &[(f32, f32)]| {
            let mut by_distance = ByDistance::new(limits).unwrap();
            let mut by_region = ByRegion::<2>::default();
            for (p, t) in pairs {
                by_distance.add(*p, *t);
                by_region.add(usize::from(p > t), *p, *t);
                by_region.add(2, *p, *t);
            }
            (by_distance, by_region)
        };
        let (mut distance, mut region) = collect(first);
        let (more_distance, more_region) = collect(second);
        distance.merge(&more_distance).unwrap();
        region.merge(&more_region);
        let mut from = 0.0;
        for (to, bin) in distance.intervals() {
            let inside: Vec<_> = pairs.iter().copied().filter(|(_, t)| from <= *t && *t < to).collect();
            prop_assert_eq!(bin.metrics().map(|m| m.count), errors(&inside).metrics().map(|m| m.count));
            if let (Some(a), Some(b)) = (bin.metrics(), errors(&inside).metrics()) {
                prop_assert!((a.abs_rel - b.abs_rel).abs() < 1e-9);
            }
            from = to;
        }
        prop_assert_eq!(from, 60.0);
        for (label, bin) in region.regions().iter().enumerate() {
            let inside = pairs.iter().filter(|(p, t)| usize::from(p > t) == label).count();
            prop_assert_eq!(bin.metrics().map_or(0, |m| m.count), inside as u64);
        }
    }

    /// Matches against brute force, in clouds from sparse to dense.
    #[test]
    fn clouds(
        predicted in prop::collection::vec(prop::array::uniform3(-3.0..3.0), 0..80),
        truth in prop::collection::vec(prop::array::uniform3(-3.0..3.0), 0..80), threshold in 0.05..3.0_f64,
    ) {
        let cloud = |points: &[[f64; 3]]| points.iter().map(|p| Point::<CameraFrame>::new(p[0], p[1], p[2])).collect::<Vec<_>>();
        let near = |p: &[f64; 3], others: &[[f64; 3]]| others.iter().any(|o| {
            p.iter().zip(o).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt() <= threshold
        });
        let hits = |from: &[[f64; 3]], to: &[[f64; 3]]| from.iter().filter(|p| near(p, to)).count() as f64;
        let mut matches = CloudMatches::new();
        let mut scratch = vec![7; cloud_scratch_len(predicted.len(), truth.len())];
        matches.add(&cloud(&predicted), &cloud(&truth), threshold, &mut scratch).unwrap();
        let metrics = matches.metrics();
        if predicted.is_empty() || truth.is_empty() {
            prop_assert_eq!(metrics, None);
        } else {
            let p = hits(&predicted, &truth) / predicted.len() as f64;
            let r = hits(&truth, &predicted) / truth.len() as f64;
            let m = metrics.unwrap();
            prop_assert_eq!((m.precision, m.recall), (p, r));
            if p > 0.0 {
                prop_assert!((m.f_score - 2.0 / (1.0 / p + 1.0 / r)).abs() < 1e-12);
                prop_assert!((m.iou - 1.0 / (1.0 / p + 1.0 / r - 1.0)).abs() < 1e-12);
            } else {
                prop_assert_eq!((m.f_score, m.iou), (0.0, 0.0));
            }
            let mut twice = matches;
            twice.merge(&matches);
            prop_assert_eq!(twice.metrics().unwrap(), m);
        }
    }
}

#[test]
fn clouds_that_are_refused_and_odd_points() {
    let cloud = [Point::<CameraFrame>::new(1.0, 2.0, 3.0); 4];
    let odd = [
        Point::new(f64::NAN, 0.0, 0.0),
        Point::new(f64::INFINITY, 0.0, 0.0),
        Point::new(1e300, 1e300, -1e300),
        Point::new(1.0, 2.0, 3.05),
    ];
    let mut matches = CloudMatches::new();
    for threshold in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let refused = matches
            .add(&cloud, &odd, threshold, &mut [0; 9])
            .unwrap_err();
        assert!(matches!(refused, Error::CloudThreshold(t) if t.to_bits() == threshold.to_bits()));
    }
    let short = matches.add(&cloud, &odd[..1], 0.1, &mut [0; 8]);
    assert_eq!(
        short,
        Err(Error::ScratchLength {
            needed: 9,
            given: 8
        })
    );
    assert_eq!(matches, CloudMatches::default());
    #[cfg(target_pointer_width = "64")]
    assert_eq!(cloud_scratch_len(1, u32::MAX as usize), usize::MAX);
    matches.add(&cloud, &odd, 0.1, &mut [0; 9]).unwrap();
    let m = matches.metrics().unwrap();
    assert_eq!((m.precision, m.recall), (1.0, 0.25));
    // Clouds of depth maps with many pixels that are none; were each compared with each, this would not end.
    let mut many = vec![Point::<CameraFrame>::new(f64::NAN, f64::NAN, f64::NAN); 1_000_000];
    many.push(Point::new(0.0, 0.0, 0.01));
    let endless = Point::new(f64::INFINITY, f64::INFINITY, f64::INFINITY);
    many.resize(many.len() + 1_000_000, endless);
    let mut matches = CloudMatches::new();
    let mut scratch = vec![0; cloud_scratch_len(many.len(), many.len())];
    matches.add(&many, &many, 0.1, &mut scratch).unwrap();
    let m = matches.metrics().unwrap();
    assert_eq!(
        (m.precision, m.recall),
        (1.0 / 2_000_001.0, 1.0 / 2_000_001.0)
    );
    // The same of a threshold by which no point's cube could be counted.
    let row: Vec<Point<CameraFrame>> = (0..300_000)
        .map(|i| Point::new(f64::from(i) * 0.01, 2.0, 9.0))
        .collect();
    for threshold in [1e-18, 1e-150, f64::MIN_POSITIVE] {
        let mut matches = CloudMatches::new();
        matches.add(&row, &row, threshold, &mut scratch).unwrap();
        assert_eq!(matches.metrics().unwrap().f_score, 1.0);
    }
}

#[test]
fn intervals_that_are_refused() {
    for bad in [[0.0, 1.0], [1.0, 1.0], [2.0, 1.0], [1.0, f32::NAN]] {
        assert!(
            matches!(ByDistance::new(bad), Err(Error::DistanceIntervals { .. })),
            "{bad:?}"
        );
    }
    assert_eq!(
        ByDistance::new([-1.0]),
        Err(Error::DistanceIntervals {
            index: 0,
            limit: -1.0
        })
    );
    let mut a = ByDistance::new([1.0, 2.0]).unwrap();
    let mut b = ByDistance::new([1.0, 3.0]).unwrap();
    b.add(1.0, 1.5);
    assert_eq!(
        a.merge(&b),
        Err(Error::DistanceIntervals {
            index: 1,
            limit: 3.0
        })
    );
    assert!(a.intervals().all(|(_, bin)| bin.metrics().is_none()));
    // A limit belongs to the interval that begins there, and the last to none.
    a.add(1.0, 1.0);
    a.add(1.0, 2.0);
    let counts = a
        .intervals()
        .map(|(_, bin)| bin.metrics().map_or(0, |m| m.count));
    assert_eq!(counts.collect::<Vec<_>>(), [0, 1]);
}

/// Garg's crop on KITTI, with the numbers that NumPy gives for its fractions; and the rules of what counts.
#[test]
fn crops_and_caps() {
    let kitti = ImageSize::new(1242, 375).unwrap();
    let garg = Crop::garg(kitti);
    assert_eq!(
        (garg.top, garg.bottom, garg.left, garg.right),
        (153, 371, 44, 1197)
    );
    assert!(garg.contains(44, 153) && garg.contains(1196, 370));
    assert!(!garg.contains(43, 153) && !garg.contains(44, 152));
    assert!(!garg.contains(1197, 370) && !garg.contains(1196, 371));

    let size = ImageSize::new(3, 2).unwrap();
    let predicted = [5.0, f32::NAN, 500.0, 5.0, 0.0, 5.0];
    let truth = [1.0, 80.0, 10.0, 81.0, 20.0, 0.0];
    let mut evaluation = Evaluation {
        crop: Crop::whole(size),
        range: DepthRange::new(1.0, 80.0).unwrap(),
    };
    let collect = |evaluation: &Evaluation| {
        let mut seen = Vec::new();
        evaluation
            .pixels(size, &predicted, &truth, |i, p, t| seen.push((i, p, t)))
            .unwrap();
        seen
    };
    assert_eq!(
        collect(&evaluation),
        [
            (0, 5.0, 1.0),
            (1, 1.0, 80.0),
            (2, 80.0, 10.0),
            (4, 1.0, 20.0)
        ]
    );
    evaluation.crop.left = 1;
    evaluation.crop.bottom = 1;
    assert_eq!(collect(&evaluation), [(1, 1.0, 80.0), (2, 80.0, 10.0)]);
    let short = evaluation.pixels(size, &predicted[1..], &truth, |_, _, _| ());
    assert_eq!(
        short,
        Err(Error::OutputLength {
            needed: 6,
            given: 5
        })
    );
    let short = evaluation.pixels(size, &predicted, &truth[1..], |_, _, _| ());
    assert_eq!(
        short,
        Err(Error::OutputLength {
            needed: 6,
            given: 5
        })
    );
}
