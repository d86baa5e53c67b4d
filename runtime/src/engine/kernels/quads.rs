//! Depthwise weights for instructions that multiply the four bytes of a lane: four rows of taps at a time.
//!
//! A quad of weights is a column of four rows of taps (of three, and one that weighs nothing). A fifth row is its first four taps as
//! one quad; its last tap is the fourth byte of the quad of the next output pixel, or, with a stride of 2, the third: two more.

use super::Depthwise;

/// Rows of taps that one multiplication takes.
pub(super) const TALL: usize = 4;

/// Whether a kernel has quads: 3x3 and 5x5.
pub(super) fn has(rows: usize, columns: usize) -> bool {
    rows == columns && matches!(rows, 3 | 5)
}

/// Quads of a channel; kernels are square.
pub(super) const fn quads(side: usize) -> usize {
    if side > TALL { side + 3 } else { side }
}

impl Depthwise {
    /// The weight that multiplies a byte of a quad.
    pub(super) fn in_quad(&self, channel: usize, quad: usize, byte: usize) -> i8 {
        let (row, column) = match quad.checked_sub(self.columns) {
            None => (byte, quad),
            Some(0) => (TALL, byte),
            Some(stride) if byte + stride == TALL => (TALL, TALL),
            Some(_) => return 0,
        };
        if row < self.rows {
            self.weights[(row * self.columns + column) * self.pitch + channel]
        } else {
            0
        }
    }

    /// Whether neighbouring taps of a row of them are neighbouring pixels: there is no dilation.
    pub(super) fn is_close(&self, runs: &[usize]) -> bool {
        let close = |line: &[usize]| line.windows(2).all(|taps| taps[0] + self.pitch == taps[1]);
        runs.chunks(self.columns).all(close)
    }
}
