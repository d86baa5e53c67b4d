//! A byte tensor's geometry, and that of the windows over it, in bytes.

use std::ops::Range;

use super::super::kernels::Row;
use super::super::layer::{Placed, Window};

/// A byte tensor's place in the arena; see [`kernels`](super::super::kernels) for the layout.
#[derive(Clone, Copy, Debug)]
pub(super) struct Buffer {
    pub(super) offset: usize,
    pub(super) channels: usize,
    pub(super) height: usize,
    pub(super) width: usize,
    pub(super) pitch: usize,
    /// Pixels of border on each side.
    pub(super) border: usize,
    /// What the border holds.
    pub(super) zero: u8,
}

impl Buffer {
    pub(super) fn row_bytes(&self) -> usize {
        (self.width + 2 * self.border) * self.pitch
    }

    pub(super) fn len(&self) -> usize {
        (self.height + 2 * self.border) * self.row_bytes()
    }

    pub(super) fn all(&self) -> Range<usize> {
        self.offset..self.offset + self.len()
    }

    /// A row with its border.
    pub(super) fn whole_row(&self, y: usize) -> Range<usize> {
        let start = self.offset + (y + self.border) * self.row_bytes();
        start..start + self.row_bytes()
    }

    /// A row without.
    pub(super) fn row(&self, y: usize) -> Range<usize> {
        let start = self.whole_row(y).start + self.border * self.pitch;
        start..start + self.width * self.pitch
    }
}

/// A row's pixels; its border is written.
pub(super) fn between_borders<'a>(buffer: &Buffer, whole: &'a mut [u8]) -> &'a mut [u8] {
    let (left, rest) = whole.split_at_mut(buffer.border * buffer.pitch);
    let (pixels, right) = rest.split_at_mut(buffer.width * buffer.pitch);
    left.fill(buffer.zero);
    right.fill(buffer.zero);
    pixels
}

/// A convolution's geometry in bytes of its input.
#[derive(Debug)]
pub(super) struct Taps {
    /// From the first output pixel's first tap to each run or tap.
    pub(super) runs: Vec<usize>,
    /// The first output pixel's first tap, from the tensor's start.
    pub(super) base: usize,
    /// From output row to output row, and from output pixel to output pixel.
    pub(super) steps: [usize; 2],
    /// The same where the input is inlined.
    pub(super) band: Band,
}

impl Taps {
    pub(super) fn new(window: &Window, input: &Buffer, runs: Vec<usize>) -> Result<Self, String> {
        let Placed {
            before: [top, left],
            ..
        } = window.place([input.height, input.width])?;
        let rows = (window.kernel[0] - 1) * window.dilations[0] + 1;
        let in_band = |topmost: usize, run: &usize| {
            (topmost + run / input.row_bytes()) % rows * input.row_bytes() + run % input.row_bytes()
        };
        let band = Band {
            rows,
            above: top,
            stride: window.strides[0],
            runs: (0..rows)
                .map(|topmost| runs.iter().map(|run| in_band(topmost, run)).collect())
                .collect(),
            base: (input.border - left) * input.pitch,
        };
        Ok(Self {
            runs,
            band,
            base: (input.border - top) * input.row_bytes() + (input.border - left) * input.pitch,
            steps: [
                window.strides[0] * input.row_bytes(),
                window.strides[1] * input.pitch,
            ],
        })
    }

    pub(super) fn row<'a>(&'a self, input: &'a [u8], y: usize, pixels: usize) -> Row<'a> {
        Row {
            input,
            base: self.base + y * self.steps[0],
            runs: &self.runs,
            step: self.steps[1],
            pixels,
        }
    }
}

/// The rows of an inlined input that a row of output takes, in memory of the thread's own: row `y` is number
/// `(y + above) % rows` of them, so that the next row of output finds those that it shares with the last one in place.
#[derive(Debug)]
pub(super) struct Band {
    pub(super) rows: usize,
    /// Rows above the input that the first row of output takes.
    pub(super) above: usize,
    /// Rows from one row of output to the next.
    pub(super) stride: usize,
    /// From the first pixel of the band to each tap, for each place that the topmost row may be in.
    pub(super) runs: Vec<Vec<usize>>,
    /// The first output pixel's first tap, from the start of a row.
    pub(super) base: usize,
}

impl Band {
    pub(super) fn bytes(&self, input: &Buffer) -> usize {
        self.rows * input.row_bytes()
    }
}
