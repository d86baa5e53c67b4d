//! What the threads do between two meetings: the work of a layer, and of those that are made row by row for it.

use super::super::expression::Expression;
use super::super::kernels::{Addition, Dense, Depthwise, ToBytes};
use super::super::layer::{Between, Placed, Quantization, Shape, Window};
use super::buffer::{Buffer, Taps};
use super::memory::Planes;

/// What an elementwise layer reads.
#[derive(Debug)]
pub(super) enum Source {
    Bytes(Buffer, Quantization),
    Floats(Planes, Shape),
}

/// What makes a row of the result.
#[derive(Debug)]
pub(super) enum Work {
    Quantize {
        input: Planes,
        shape: Shape,
        quantization: Quantization,
    },
    Dense {
        dense: Dense,
        taps: Taps,
        to: ToBytes,
    },
    /// Outputs, their channels, and planes of `height x width` f32.
    DenseFloats {
        dense: Dense,
        taps: Taps,
        outputs: Vec<(Planes, usize)>,
        size: [usize; 2],
    },
    Depthwise {
        depthwise: Depthwise,
        taps: Taps,
        to: ToBytes,
    },
    Add(Addition),
    Multiply {
        zeros: [u8; 2],
        factor: f32,
        to: ToBytes,
    },
    Table(Box<[u8; 256]>),
    Concat(Vec<[u8; 256]>),
    Resize {
        rows: Vec<Between>,
        columns: Vec<Between>,
        to: ToBytes,
        zero: u8,
        factor: f32,
        same: bool,
    },
    Pad {
        rows: Vec<Option<usize>>,
        columns: Vec<Option<usize>>,
        fill: u8,
        table: Box<[u8; 256]>,
    },
    Flatten(Box<[u8; 256]>),
    DepthToSpace {
        block: usize,
        sources: Vec<usize>,
        table: Box<[u8; 256]>,
    },
    /// To bytes, or where there is no such buffer to planes of f32.
    Elementwise {
        expression: Expression,
        sources: Vec<Source>,
        shape: Shape,
        quantization: Option<Quantization>,
        output: Option<Planes>,
    },
    MaxPool {
        window: Window,
        placed: Placed,
        table: Box<[u8; 256]>,
    },
    Average {
        window: Window,
        placed: Placed,
        counts_padding: bool,
        zero: u8,
        factor: f32,
        to: ToBytes,
    },
    Dequantize {
        quantization: Quantization,
        output: Planes,
    },
}

/// A stage, ready to run row by row.
#[derive(Debug)]
pub(super) struct Step {
    pub(super) work: Work,
    pub(super) reads: Vec<Buffer>,
    /// Which of them are not there, and how each of their rows is made.
    pub(super) inlined: Vec<Option<Step>>,
    /// `None` where the result leaves the island.
    pub(super) writes: Option<Buffer>,
    pub(super) rows: usize,
}

impl Step {
    /// Bytes that the rows of all inlined steps take at once.
    pub(super) fn inlined_bytes(&self) -> usize {
        let inlined = self.inlined.iter().flatten();
        inlined
            .map(|step| self.kept_bytes(step) + step.inlined_bytes())
            .sum()
    }

    /// Numbers of a row of f32 that it needs.
    pub(super) fn scratch(&self) -> usize {
        let own = match &self.work {
            Work::DenseFloats { dense, size, .. } => dense.lanes() * size[1],
            Work::Dense { dense, .. } => {
                dense.row_of_few(self.writes.map_or(0, |buffer| buffer.width))
            }
            Work::Elementwise {
                expression, shape, ..
            } => (1 + expression.scratch()) * shape[2],
            _ => 0,
        };
        let inlined = self.inlined.iter().flatten().map(Step::scratch);
        inlined.fold(own, usize::max)
    }

    /// Bytes of the rows of an inlined step that are there at once; each begins where a cache line does.
    pub(super) fn kept_bytes(&self, inlined: &Step) -> usize {
        let bytes = match (&self.work, &inlined.writes) {
            (Work::Dense { taps, .. } | Work::Depthwise { taps, .. }, Some(buffer)) => {
                taps.band.bytes(buffer)
            }
            (_, Some(buffer)) => buffer.width * buffer.pitch,
            (_, None) => 0,
        };
        bytes.next_multiple_of(64)
    }
}
