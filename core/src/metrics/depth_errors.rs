//! The depth metrics of Eigen et al., as GEDepth reports them.

use glam::DVec2;

use crate::scalar::sqrt;

/// Sums over pixels, from which [`DepthMetrics`] follow.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct DepthErrors {
    count: u64,
    rejected: u64,
    relative: f64,
    squared_relative: f64,
    squared: f64,
    log: f64,
    squared_log: f64,
    within: [u64; 3],
}

/// The metrics over all pixels that were added; p is the predicted depth and t the true one, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthMetrics {
    /// Pixels.
    pub count: u64,
    /// Abs Rel: mean of |p - t| / t.
    pub abs_rel: f64,
    /// Sq Rel: mean of (p - t)^2 / t, metres.
    pub sq_rel: f64,
    /// RMSE: root of the mean of (p - t)^2, metres.
    pub rmse: f64,
    /// RMSE log: root of the mean of (ln p - ln t)^2.
    pub rmse_log: f64,
    /// SILog: 100 times the standard deviation of ln p - ln t.
    pub silog: f64,
    /// delta 1.25^k, k = 1, 2, 3: the share of pixels with max(p / t, t / p) below it.
    pub delta: [f64; 3],
}

impl DepthErrors {
    /// No pixel yet.
    pub const fn new() -> Self {
        Self {
            count: 0,
            rejected: 0,
            relative: 0.0,
            squared_relative: 0.0,
            squared: 0.0,
            log: 0.0,
            squared_log: 0.0,
            within: [0; 3],
        }
    }

    /// Adds a pixel. Unless both depths are positive and finite it is only counted as rejected.
    pub fn add(&mut self, predicted: f32, truth: f32) {
        let valid = |depth: f32| depth > 0.0 && depth.is_finite();
        if !valid(predicted) || !valid(truth) {
            self.rejected = self.rejected.saturating_add(1);
            return;
        }
        let (p, t) = (f64::from(predicted), f64::from(truth));
        let difference = p - t;
        let logs = DVec2::new(p, t).ln();
        let log = logs.x - logs.y;
        self.count = self.count.saturating_add(1);
        self.relative += difference.abs() / t;
        self.squared_relative += difference * difference / t;
        self.squared += difference * difference;
        self.log += log;
        self.squared_log += log * log;
        let ratio = (p / t).max(t / p);
        let mut limit = 1.0;
        for within in &mut self.within {
            limit *= 1.25;
            *within = within.saturating_add(u64::from(ratio < limit));
        }
    }

    /// Adds what another accumulator has seen.
    pub fn merge(&mut self, other: &Self) {
        self.count = self.count.saturating_add(other.count);
        self.rejected = self.rejected.saturating_add(other.rejected);
        self.relative += other.relative;
        self.squared_relative += other.squared_relative;
        self.squared += other.squared;
        self.log += other.log;
        self.squared_log += other.squared_log;
        for (within, more) in self.within.iter_mut().zip(other.within) {
            *within = within.saturating_add(more);
        }
    }

    /// Pixels that were left out because a depth was not positive and finite.
    pub const fn rejected(&self) -> u64 {
        self.rejected
    }

    /// The metrics; `None` if no pixel was added.
    pub fn metrics(&self) -> Option<DepthMetrics> {
        if self.count == 0 {
            return None;
        }
        let n = self.count as f64;
        let mean_log = self.log / n;
        let variance = self.squared_log / n - mean_log * mean_log;
        Some(DepthMetrics {
            count: self.count,
            abs_rel: self.relative / n,
            sq_rel: self.squared_relative / n,
            rmse: sqrt(self.squared / n),
            rmse_log: sqrt(self.squared_log / n),
            // Rounding may leave a variance just below 0.
            silog: 100.0 * sqrt(variance.max(0.0)),
            delta: self.within.map(|within| within as f64 / n),
        })
    }
}
