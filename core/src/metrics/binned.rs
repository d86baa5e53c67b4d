//! One accumulator for each interval of distance, or each region of a picture.

use super::DepthErrors;
use crate::Error;

/// Errors by interval of the true depth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ByDistance<const N: usize> {
    upper: [f32; N],
    bins: [DepthErrors; N],
}

impl<const N: usize> ByDistance<N> {
    /// `N` intervals: from 0 up to but without `upper[0]`, from there up to but without `upper[1]`, and so on, metres.
    ///
    /// # Errors
    /// [`Error::DistanceIntervals`] unless the limits are positive and ascend.
    pub fn new(upper: [f32; N]) -> Result<Self, Error> {
        let mut before = 0.0;
        for (index, limit) in upper.iter().enumerate() {
            if limit.is_nan() || *limit <= before {
                return Err(Error::DistanceIntervals {
                    index,
                    limit: *limit,
                });
            }
            before = *limit;
        }
        Ok(Self {
            upper,
            bins: [DepthErrors::new(); N],
        })
    }

    /// Adds a pixel to the interval of its true depth; beyond the last one it is ignored.
    pub fn add(&mut self, predicted: f32, truth: f32) {
        let bins = self.upper.iter().zip(&mut self.bins);
        // A NaN is below no limit.
        if let Some((_, bin)) = bins.into_iter().find(|(upper, _)| truth < **upper) {
            bin.add(predicted, truth);
        }
    }

    /// Adds what another accumulator with the same intervals has seen.
    ///
    /// # Errors
    /// [`Error::DistanceIntervals`], naming the first limit that differs; nothing is added then.
    pub fn merge(&mut self, other: &Self) -> Result<(), Error> {
        for (index, (ours, theirs)) in self.upper.iter().zip(&other.upper).enumerate() {
            if ours != theirs {
                return Err(Error::DistanceIntervals {
                    index,
                    limit: *theirs,
                });
            }
        }
        for (bin, more) in self.bins.iter_mut().zip(&other.bins) {
            bin.merge(more);
        }
        Ok(())
    }

    /// The upper limits and the errors below them.
    pub fn intervals(&self) -> impl Iterator<Item = (f32, &DepthErrors)> {
        self.upper.iter().copied().zip(&self.bins)
    }
}

/// Errors by region: whatever a label from 0 to `N - 1` stands for, ground and not ground, say.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ByRegion<const N: usize> {
    bins: [DepthErrors; N],
}

impl<const N: usize> ByRegion<N> {
    /// No pixel yet.
    pub const fn new() -> Self {
        Self {
            bins: [DepthErrors::new(); N],
        }
    }

    /// Adds a pixel to its region; labels of `N` and more are ignored.
    pub fn add(&mut self, region: usize, predicted: f32, truth: f32) {
        if let Some(bin) = self.bins.get_mut(region) {
            bin.add(predicted, truth);
        }
    }

    /// Adds what another accumulator has seen.
    pub fn merge(&mut self, other: &Self) {
        for (bin, more) in self.bins.iter_mut().zip(&other.bins) {
            bin.merge(more);
        }
    }

    /// The errors of each region.
    pub const fn regions(&self) -> &[DepthErrors; N] {
        &self.bins
    }
}

impl<const N: usize> Default for ByRegion<N> {
    fn default() -> Self {
        Self::new()
    }
}
