//! How long the last runs took: percentiles in memory that is made once.

/// Of a stage, nanoseconds.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct gedepth_percentiles {
    /// At least half of the runs took at most this.
    pub p50_ns: u64,
    /// At least 99 of 100 runs took at most this.
    pub p99_ns: u64,
    /// No run took longer.
    pub max_ns: u64,
}

/// The times of a camera's last runs; all 0 before the first.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct gedepth_statistics {
    /// Runs since the camera was opened that gave depth, late or not.
    pub runs: u64,
    /// Those of them that took longer than their deadline.
    pub late: u64,
    /// How many of the last runs the percentiles are of.
    pub window: u64,
    /// Resampling of the picture.
    pub preprocess: gedepth_percentiles,
    /// The network.
    pub network: gedepth_percentiles,
    /// From the network's outputs to depth.
    pub fusion: gedepth_percentiles,
    /// Copies into the caller's maps.
    pub copy: gedepth_percentiles,
    /// The call, from its start to when its maps were written.
    pub total: gedepth_percentiles,
}

/// Preprocess, network, fusion, copy, total; nanoseconds.
pub(crate) type Times = [u64; 5];

/// The last runs, in a ring.
pub(crate) struct Statistics {
    /// As many as are kept at most; those not yet run are 0.
    ring: Vec<Times>,
    sorted: Vec<u64>,
    runs: u64,
    late: u64,
}

impl Statistics {
    /// Keeps the last `runs`, at least 1.
    pub(crate) fn new(runs: usize) -> Self {
        let runs = runs.max(1);
        // Not zeros, so that the memory is there, not promised.
        Self {
            ring: vec![[1; 5]; runs],
            sorted: vec![1; runs],
            runs: 0,
            late: 0,
        }
    }

    pub(crate) fn add(&mut self, times: Times, late: bool) {
        let at = (self.runs % self.ring.len() as u64) as usize;
        self.ring[at] = times;
        self.runs += 1;
        self.late += u64::from(late);
    }

    /// Allocates nothing.
    pub(crate) fn summary(&mut self) -> gedepth_statistics {
        let window = self.runs.min(self.ring.len() as u64) as usize;
        let mut percentiles = |stage: usize| {
            let sorted = &mut self.sorted[..window];
            for (value, times) in sorted.iter_mut().zip(&self.ring) {
                *value = times[stage];
            }
            sorted.sort_unstable();
            // The nearest rank.
            let at = |percent: usize| {
                let rank = (window * percent).div_ceil(100);
                sorted.get(rank.saturating_sub(1)).copied().unwrap_or(0)
            };
            gedepth_percentiles {
                p50_ns: at(50),
                p99_ns: at(99),
                max_ns: at(100),
            }
        };
        gedepth_statistics {
            preprocess: percentiles(0),
            network: percentiles(1),
            fusion: percentiles(2),
            copy: percentiles(3),
            total: percentiles(4),
            runs: self.runs,
            late: self.late,
            window: window as u64,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_the_nearest_ranks_of_the_last_runs() {
        let mut statistics = Statistics::new(200);
        assert_eq!(statistics.summary(), gedepth_statistics::default());
        statistics.add([7, 8, 9, 10, 34], false);
        let one = statistics.summary();
        assert_eq!((one.runs, one.window, one.late), (1, 1, 0));
        let same = |ns| gedepth_percentiles {
            p50_ns: ns,
            p99_ns: ns,
            max_ns: ns,
        };
        assert_eq!((one.preprocess, one.total), (same(7), same(34)));
        // 1000 runs in an order without pattern, of which the last 200 are 801 to 1000 of `total`.
        for block in 0..5_u64 {
            for i in 0..200_u64 {
                let total = block * 200 + i * 77 % 200 + 1;
                statistics.add([total * 2, 0, 0, 0, total], block == 4);
            }
        }
        let last = statistics.summary();
        assert_eq!((last.runs, last.window, last.late), (1001, 200, 200));
        assert_eq!(
            last.total,
            gedepth_percentiles {
                p50_ns: 900,
                p99_ns: 998,
                max_ns: 1000
            }
        );
        assert_eq!(last.preprocess.p99_ns, 2 * 998);
        assert_eq!(last.network, same(0));
    }
}
