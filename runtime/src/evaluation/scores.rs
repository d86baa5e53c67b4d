//! What is kept of scored pictures: sums, so that memory does not grow with their number.

use std::time::Duration;

use gedepth_core::metrics::{
    ByDistance, ByRegion, CloudMatches, CloudMetrics, DepthErrors, DepthMetrics,
};
use serde::Serialize;

use crate::estimator::StageTimes;

/// Upper limits of the distance intervals (the paper's Figure 6), metres of true depth: from 0 up to but without 10,
/// and so on.
pub const DISTANCE_LIMITS_M: [f32; 8] = [10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0];

/// The metrics of depth; p is the predicted depth and t the true one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Metrics {
    /// Mean of |p - t| / t.
    pub abs_rel: f64,
    /// Mean of (p - t)^2 / t, metres.
    pub sq_rel_m: f64,
    /// Root of the mean of (p - t)^2, metres.
    pub rmse_m: f64,
    /// Root of the mean of (ln p - ln t)^2.
    pub rmse_log: f64,
    /// 100 times the standard deviation of ln p - ln t.
    pub silog: f64,
    /// Share of pixels with max(p / t, t / p) below 1.25.
    pub delta_1: f64,
    /// Below 1.25^2.
    pub delta_2: f64,
    /// Below 1.25^3.
    pub delta_3: f64,
}

impl From<[f64; 8]> for Metrics {
    fn from(values: [f64; 8]) -> Self {
        let [
            abs_rel,
            sq_rel_m,
            rmse_m,
            rmse_log,
            silog,
            delta_1,
            delta_2,
            delta_3,
        ] = values;
        Self {
            abs_rel,
            sq_rel_m,
            rmse_m,
            rmse_log,
            silog,
            delta_1,
            delta_2,
            delta_3,
        }
    }
}

/// In the order of [`Metrics`].
fn values(metrics: &DepthMetrics) -> [f64; 8] {
    let [delta_1, delta_2, delta_3] = metrics.delta;
    [
        metrics.abs_rel,
        metrics.sq_rel,
        metrics.rmse,
        metrics.rmse_log,
        metrics.silog,
        delta_1,
        delta_2,
        delta_3,
    ]
}

/// A sum of one `[f64; N]` a picture.
#[derive(Clone, Copy, Debug)]
struct Sums<const N: usize> {
    pictures: u64,
    sums: [f64; N],
}

impl<const N: usize> Sums<N> {
    fn of_picture(values: Option<[f64; N]>) -> Self {
        Self {
            pictures: u64::from(values.is_some()),
            sums: values.unwrap_or([0.0; N]),
        }
    }

    fn merge(&mut self, other: &Self) {
        self.pictures += other.pictures;
        for (sum, more) in self.sums.iter_mut().zip(other.sums) {
            *sum += more;
        }
    }

    fn mean(&self) -> Option<[f64; N]> {
        (self.pictures > 0).then(|| self.sums.map(|sum| sum / self.pictures as f64))
    }
}

impl<const N: usize> Default for Sums<N> {
    fn default() -> Self {
        Self::of_picture(None)
    }
}

/// Depth errors over pictures.
#[derive(Clone, Copy, Debug, Default)]
pub struct ErrorScores {
    pooled: DepthErrors,
    of_pictures: Sums<8>,
}

impl ErrorScores {
    fn of_picture(errors: &DepthErrors) -> Self {
        Self {
            pooled: *errors,
            of_pictures: Sums::of_picture(errors.metrics().as_ref().map(values)),
        }
    }

    fn merge(&mut self, other: &Self) {
        self.pooled.merge(&other.pooled);
        self.of_pictures.merge(&other.of_pictures);
    }

    /// Pictures with at least one pixel that counted.
    pub fn pictures(&self) -> u64 {
        self.of_pictures.pictures
    }

    /// Pixels that counted.
    pub fn pixels(&self) -> u64 {
        self.pooled.metrics().map_or(0, |metrics| metrics.count)
    }

    /// The mean over pictures of each picture's metrics.
    pub fn mean(&self) -> Option<Metrics> {
        self.of_pictures.mean().map(Metrics::from)
    }

    /// The metrics over all pixels together.
    pub fn pooled(&self) -> Option<Metrics> {
        self.pooled
            .metrics()
            .as_ref()
            .map(values)
            .map(Metrics::from)
    }
}

/// Point clouds over pictures.
#[derive(Clone, Copy, Debug, Default)]
pub struct CloudScores {
    pooled: CloudMatches,
    of_pictures: Sums<4>,
}

impl CloudScores {
    fn of_picture(matches: &CloudMatches) -> Self {
        let values = |m: CloudMetrics| [m.precision, m.recall, m.f_score, m.iou];
        Self {
            pooled: *matches,
            of_pictures: Sums::of_picture(matches.metrics().map(values)),
        }
    }

    fn merge(&mut self, other: &Self) {
        self.pooled.merge(&other.pooled);
        self.of_pictures.merge(&other.of_pictures);
    }

    /// Pictures with at least one point.
    pub fn pictures(&self) -> u64 {
        self.of_pictures.pictures
    }

    /// The mean over pictures of each picture's metrics.
    pub fn mean(&self) -> Option<CloudMetrics> {
        let [precision, recall, f_score, iou] = self.of_pictures.mean()?;
        Some(CloudMetrics {
            precision,
            recall,
            f_score,
            iou,
        })
    }

    /// The metrics over all points together.
    pub fn pooled(&self) -> Option<CloudMetrics> {
        self.pooled.metrics()
    }
}

/// How long one stage took.
#[derive(Clone, Copy, Debug)]
pub struct StageScores {
    least: Duration,
    sum: Duration,
    pictures: u32,
}

impl Default for StageScores {
    fn default() -> Self {
        Self {
            least: Duration::MAX,
            sum: Duration::ZERO,
            pictures: 0,
        }
    }
}

impl StageScores {
    fn of_picture(time: Duration) -> Self {
        Self {
            least: time,
            sum: time,
            pictures: 1,
        }
    }

    fn merge(&mut self, other: &Self) {
        self.least = self.least.min(other.least);
        self.sum += other.sum;
        self.pictures += other.pictures;
    }

    /// Of the quickest picture; `None` without pictures.
    pub fn least(&self) -> Option<Duration> {
        (self.pictures > 0).then_some(self.least)
    }

    /// Mean over pictures; `None` without pictures.
    pub fn mean(&self) -> Option<Duration> {
        self.sum.checked_div(self.pictures)
    }
}

/// How long the stages took.
#[derive(Clone, Copy, Debug, Default)]
pub struct TimeScores {
    /// Crop, resampling, normalisation.
    pub preprocess: StageScores,
    /// The network.
    pub network: StageScores,
    /// Upsampling of the heads, slope, fusion.
    pub fusion: StageScores,
}

/// All scores of one picture, or of many merged.
#[derive(Clone, Copy, Debug, Default)]
pub struct Scores {
    /// All pixels that count.
    pub whole: ErrorScores,
    /// By interval of the true depth, up to [`DISTANCE_LIMITS_M`].
    pub by_distance: [ErrorScores; DISTANCE_LIMITS_M.len()],
    /// Pixels on the ground.
    pub ground: ErrorScores,
    /// The others.
    pub not_ground: ErrorScores,
    /// The predicted cloud of points against the measured one.
    pub cloud: CloudScores,
    /// Times of the stages.
    pub times: TimeScores,
}

impl Scores {
    pub(super) fn of_picture(
        whole: &DepthErrors,
        by_distance: &ByDistance<{ DISTANCE_LIMITS_M.len() }>,
        by_region: &ByRegion<2>,
        cloud: &CloudMatches,
        times: StageTimes,
    ) -> Self {
        let [ground, not_ground] = by_region.regions();
        let mut intervals = [ErrorScores::default(); DISTANCE_LIMITS_M.len()];
        for (scores, (_, errors)) in intervals.iter_mut().zip(by_distance.intervals()) {
            *scores = ErrorScores::of_picture(errors);
        }
        Self {
            whole: ErrorScores::of_picture(whole),
            by_distance: intervals,
            ground: ErrorScores::of_picture(ground),
            not_ground: ErrorScores::of_picture(not_ground),
            cloud: CloudScores::of_picture(cloud),
            times: TimeScores {
                preprocess: StageScores::of_picture(times.preprocess),
                network: StageScores::of_picture(times.network),
                fusion: StageScores::of_picture(times.fusion),
            },
        }
    }

    /// Adds the scores of other pictures.
    pub fn merge(&mut self, other: &Self) {
        self.whole.merge(&other.whole);
        for (interval, more) in self.by_distance.iter_mut().zip(&other.by_distance) {
            interval.merge(more);
        }
        self.ground.merge(&other.ground);
        self.not_ground.merge(&other.not_ground);
        self.cloud.merge(&other.cloud);
        self.times.preprocess.merge(&other.times.preprocess);
        self.times.network.merge(&other.times.network);
        self.times.fusion.merge(&other.times.fusion);
    }
}
