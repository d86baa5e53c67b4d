//! Dense convolutions of few outputs: the heads. Each output is summed up over a register of a pixel's channels, instead of sixteen
//! outputs of which most do not exist.

use super::{Dense, Row};

/// Outputs that leave three quarters of a block of lanes empty.
pub(super) const FEW: usize = 4;
/// Bytes of a 128-bit lane.
pub(super) const LANE: usize = 16;

/// Weights of up to [`FEW`] outputs, `[run][16 bytes of it][output]`; empty where they are more, or runs no multiple of 16.
#[derive(Clone, Debug, Default)]
pub(super) struct Few(Vec<[i8; LANE]>);

impl Few {
    /// Of `weights`, `[output][run][byte]`.
    pub(super) fn new([outputs, runs, run]: [usize; 3], weights: &[i8]) -> Self {
        if outputs > FEW || !run.is_multiple_of(LANE) {
            return Self::default();
        }
        let lanes = weights.as_chunks::<LANE>().0;
        let of_output = runs * run / LANE;
        let order = (0..of_output).flat_map(|at| (0..outputs).map(move |o| o * of_output + at));
        Self(order.map(|at| lanes[at]).collect())
    }

    /// Whether the outputs are few.
    pub(super) fn is_some(&self) -> bool {
        !self.0.is_empty()
    }
}

impl Dense {
    /// The weights of few outputs, where it has them and the row has `least` pixels or more.
    pub(super) fn few(&self, row: &Row<'_>, least: usize) -> Option<&[[i8; LANE]]> {
        let fits = self.few.is_some() && row.pixels >= least;
        fits.then_some(&self.few.0)
    }
}
