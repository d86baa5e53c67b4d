//! Point clouds compared (Ornek et al., "From 2D to 3D: re-thinking benchmarking of monocular depth prediction").
//!
//! A point is matched if the other cloud has a point within a threshold of it. Precision is the matched share of predicted
//! points, recall that of true points.

use glam::DVec3;

use crate::{Error, Frame, Point};

/// Counts of points and of matched points.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct CloudMatches {
    predicted: u64,
    matched_predicted: u64,
    truth: u64,
    matched_truth: u64,
}

/// The metrics over all clouds that were added.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CloudMetrics {
    /// P: the matched share of predicted points.
    pub precision: f64,
    /// R: the matched share of true points.
    pub recall: f64,
    /// 2 P R / (P + R); 0 if nothing matches.
    pub f_score: f64,
    /// P R / (P + R - P R); 0 if nothing matches.
    pub iou: f64,
}

/// Scratch values that comparing clouds of so many points needs; for 2^32 - 1 points and more, which are not supported,
/// more than there can be.
pub const fn cloud_scratch_len(predicted: usize, truth: usize) -> usize {
    let larger = if predicted > truth { predicted } else { truth };
    if larger >= u32::MAX as usize {
        return usize::MAX;
    }
    larger.saturating_mul(2).saturating_add(1)
}

impl CloudMatches {
    /// No cloud yet.
    pub const fn new() -> Self {
        Self {
            predicted: 0,
            matched_predicted: 0,
            truth: 0,
            matched_truth: 0,
        }
    }

    /// Compares the cloud of a predicted depth map with the true one, in the same frame; points match within `threshold`
    /// metres. Points that are not finite never match. `scratch` has at least [`cloud_scratch_len`] values.
    ///
    /// Takes time in proportion to the number of points, as long as clouds are not far denser than the threshold.
    ///
    /// # Errors
    /// [`Error::CloudThreshold`] if `threshold` is not positive and finite, [`Error::ScratchLength`]. Nothing is counted
    /// then.
    pub fn add<F: Frame>(
        &mut self,
        predicted: &[Point<F>],
        truth: &[Point<F>],
        threshold: f64,
        scratch: &mut [u32],
    ) -> Result<(), Error> {
        if !(threshold > 0.0 && threshold.is_finite()) {
            return Err(Error::CloudThreshold(threshold));
        }
        let needed = cloud_scratch_len(predicted.len(), truth.len());
        if scratch.len() < needed {
            return Err(Error::ScratchLength {
                needed,
                given: scratch.len(),
            });
        }
        let matched_predicted = matches(predicted, truth, threshold, scratch);
        let matched_truth = matches(truth, predicted, threshold, scratch);
        self.merge(&Self {
            predicted: predicted.len() as u64,
            matched_predicted,
            truth: truth.len() as u64,
            matched_truth,
        });
        Ok(())
    }

    /// Adds what another accumulator has counted.
    pub fn merge(&mut self, other: &Self) {
        self.predicted = self.predicted.saturating_add(other.predicted);
        self.matched_predicted = self
            .matched_predicted
            .saturating_add(other.matched_predicted);
        self.truth = self.truth.saturating_add(other.truth);
        self.matched_truth = self.matched_truth.saturating_add(other.matched_truth);
    }

    /// The metrics; `None` if a side has no point.
    pub fn metrics(&self) -> Option<CloudMetrics> {
        if self.predicted == 0 || self.truth == 0 {
            return None;
        }
        let precision = self.matched_predicted as f64 / self.predicted as f64;
        let recall = self.matched_truth as f64 / self.truth as f64;
        let both = precision * recall;
        let sum = precision + recall;
        let share = |part: f64, whole: f64| if part > 0.0 { part / whole } else { 0.0 };
        Some(CloudMetrics {
            precision,
            recall,
            f_score: share(2.0 * both, sum),
            iou: share(both, sum - both),
        })
    }
}

/// How many of `points` have a point of `others` within `threshold`.
///
/// `others` are sorted into buckets by the cube of side `threshold` (at least a micrometre) that they lie in; whatever is near
/// a point then lies in its cube or one of the 26 around it.
fn matches<F: Frame>(
    points: &[Point<F>],
    others: &[Point<F>],
    threshold: f64,
    scratch: &mut [u32],
) -> u64 {
    let buckets = others.len();
    let Some((ends, sorted)) = scratch.split_at_mut_checked(buckets + 1) else {
        return 0;
    };
    // Casts saturate: points at absurd distances share a cube, and are still compared exactly. Cubes much smaller than any
    // point's rounding would have all points do that.
    let side = threshold.max(1e-6);
    let cube = |point: &Point<F>| {
        let [x, y, z] = (point.vector() / side).floor().to_array();
        [x as i64, y as i64, z as i64]
    };
    let bucket = |cube: [i64; 3]| hash(cube) as usize % buckets.max(1);
    // Counting sort: the ends of buckets, then, filling from the back, their starts. Without what never matches, which would
    // all fall into a few buckets.
    ends.fill(0);
    for other in others.iter().filter(|other| other.vector().is_finite()) {
        if let Some(end) = ends.get_mut(bucket(cube(other))) {
            *end += 1;
        }
    }
    let mut total = 0;
    for end in ends.iter_mut() {
        total += *end;
        *end = total;
    }
    for (index, other) in (0..).zip(others) {
        if !other.vector().is_finite() {
            continue;
        }
        if let Some(end) = ends.get_mut(bucket(cube(other))) {
            *end -= 1;
            if let Some(place) = sorted.get_mut(*end as usize) {
                *place = index;
            }
        }
    }
    // Finite, so that infinitely far is never near.
    let reach = (threshold * threshold).min(f64::MAX);
    let near = |point: &Point<F>, cube: [i64; 3]| {
        let bucket = bucket(cube);
        let start = ends.get(bucket).copied().unwrap_or(0) as usize;
        let end = ends.get(bucket + 1).copied().unwrap_or(0) as usize;
        let found = sorted.get(start..end).unwrap_or_default();
        found.iter().any(|index| {
            others
                .get(*index as usize)
                .is_some_and(|other| squared_distance(point, other) <= reach)
        })
    };
    let mut matched = 0;
    for point in points {
        let [x, y, z] = cube(point);
        // The own cube first: what matches mostly matches there.
        let around = |k: i64| [k, k.saturating_sub(1), k.saturating_add(1)].into_iter();
        let hit = around(x).any(|x| around(y).any(|y| around(z).any(|z| near(point, [x, y, z]))));
        matched += u64::from(hit);
    }
    matched
}

fn squared_distance<F: Frame>(a: &Point<F>, b: &Point<F>) -> f64 {
    let difference: DVec3 = a.vector() - b.vector();
    difference.length_squared()
}

/// Spreads neighbouring cubes over buckets.
fn hash(cube: [i64; 3]) -> u64 {
    let mix = |h: u64, k: i64| {
        (h ^ k as u64)
            .wrapping_mul(0x9e37_79b9_7f4a_7c15)
            .rotate_left(29)
    };
    cube.into_iter().fold(0, mix) >> 7
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::collections::BTreeSet;

    use super::hash;

    /// What keeps the time in proportion to the number of points: cubes of a block, as many as buckets, fill
    /// 1 - 1/e = 63 % of these, as if thrown at random; so do those of a thin, wide sheet, which a road is.
    #[test]
    fn neighbours_spread_over_buckets() {
        for (sides, buckets) in [([16, 16, 16], 4096), ([97, 2, 31], 6014)] {
            let mut used = BTreeSet::new();
            for i in 0..sides[0] {
                for j in 0..sides[1] {
                    for k in 0..sides[2] {
                        used.insert(hash([i - 5, j - 1, k - 3]) % buckets);
                    }
                }
            }
            let share = used.len() as f64 / buckets as f64;
            assert!(share > 0.6, "{sides:?}: {share}");
        }
    }
}
