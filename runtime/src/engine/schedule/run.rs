//! What one of the threads does of each step: its rows.

use std::ops::Range;
use std::sync::{Mutex, PoisonError};

use super::super::arena::{Arena, Shared};
use super::super::expression::Expression;
use super::super::kernels::{
    Halves, Kernel, Part, Row, average_row, channel_row, copy_row, dequantize_row, flatten,
    max_row, multiply_row, pad_row, quantize_row, resize_row, saturate_channel, spread_row,
    store_channel,
};
use super::super::layer::{Between, Shape, Window};
use super::super::threads::Member;
use super::buffer::{Buffer, Taps, between_borders};
use super::memory::Planes;
use super::step::{Source, Step, Work};

/// Which row a member makes.
#[derive(Clone, Copy, Debug)]
struct Turn {
    y: usize,
    /// Whether it is the first one of its share, so that none before it left anything.
    first: bool,
    member: usize,
}

/// What a run's members share.
pub(super) struct Run<'a> {
    pub(super) kernel: Kernel,
    pub(super) arena: Shared<'a, u8>,
    pub(super) floats: Shared<'a, f32>,
    pub(super) scratch: &'a [Mutex<Vec<f32>>],
    pub(super) rows: &'a [Mutex<Arena>],
    pub(super) inputs: &'a [&'a [f32]],
    pub(super) outputs: &'a [Shared<'a, f32>],
}

impl Run<'_> {
    /// Bytes that an earlier step wrote.
    fn read(&self, range: Range<usize>) -> &[u8] {
        // SAFETY: `place` gave what this step reads a place that this step does not write, and all members finished
        // the steps that wrote it.
        unsafe { self.arena.read(range) }
    }

    /// A row of one plane.
    fn plane(&self, planes: Planes, [_, height, width]: Shape, channel: usize, y: usize) -> &[f32] {
        let start = (channel * height + y) * width;
        let row = start..start + width;
        match planes {
            Planes::Input(number) => &self.inputs[number][row],
            // SAFETY: this step does not write what it reads, and all members finished the steps that wrote it.
            Planes::Output(number) => unsafe { self.outputs[number].read(row) },
            // SAFETY: as above, and `place_floats` gave it a place of its own.
            Planes::Inner(at) => unsafe { self.floats.read(at + row.start..at + row.end) },
        }
    }

    /// The same to write; nothing where it is an input.
    #[expect(clippy::mut_from_ref, reason = "rows are shared out among the members")]
    fn plane_to_write(
        &self,
        planes: Planes,
        [_, height, width]: Shape,
        channel: usize,
        y: usize,
    ) -> &mut [f32] {
        let start = (channel * height + y) * width;
        match planes {
            Planes::Input(_) => &mut [],
            // SAFETY: each row of an output is one member's, and its output one step's.
            Planes::Output(number) => unsafe { self.outputs[number].write(start..start + width) },
            // SAFETY: as above, and `place_floats` gave it a place that nothing else is in as long as it is read.
            Planes::Inner(at) => unsafe { self.floats.write(at + start..at + start + width) },
        }
    }

    /// A row of one channel of an elementwise layer.
    fn evaluate(
        &self,
        work: (&Expression, &[Source]),
        channel: usize,
        y: usize,
        out: &mut [f32],
        scratch: &mut [f32],
    ) {
        let (expression, sources) = work;
        let source = |number: usize, row: &mut [f32]| match &sources[number] {
            Source::Bytes(buffer, quantization) => {
                let y = y.min(buffer.height - 1);
                let channel = channel.min(buffer.channels - 1);
                channel_row(
                    self.read(buffer.row(y)),
                    channel,
                    buffer.pitch,
                    *quantization,
                    row,
                );
            }
            Source::Floats(planes, shape) => {
                let plane = self.plane(
                    *planes,
                    *shape,
                    channel.min(shape[0] - 1),
                    y.min(shape[1] - 1),
                );
                match plane {
                    [one] => row.fill(*one),
                    plane => row.copy_from_slice(plane),
                }
            }
        };
        expression.row(&source, channel, out, scratch);
    }

    /// One member's share of a step.
    pub(super) fn step(&self, step: &Step, member: &Member<'_>) {
        let rows = member.share(step.rows);
        let first = rows.start;
        match &step.writes {
            Some(buffer) => {
                let memory = self.rows[member.number].lock();
                let mut memory = memory.unwrap_or_else(PoisonError::into_inner);
                write_rows(&self.arena, buffer, rows, |y, row| {
                    let turn = Turn {
                        y,
                        first: y == first,
                        member: member.number,
                    };
                    self.row(step, buffer, turn, row, memory.bytes())
                });
            }
            None => rows.for_each(|y| self.leave(step, y, member.number)),
        }
    }

    /// A row of an inlined step, in the first of the bytes that are free.
    fn inlined<'a>(&self, of: &Step, step: &Step, turn: Turn, free: &mut &'a mut [u8]) -> &'a [u8] {
        let Some(buffer) = &step.writes else {
            return &[];
        };
        let kept = free
            .split_off_mut(..of.kept_bytes(step))
            .unwrap_or_default();
        let below = free
            .split_off_mut(..step.inlined_bytes())
            .unwrap_or_default();
        let row = &mut kept[..buffer.width * buffer.pitch];
        self.row(step, buffer, turn, row, below);
        row
    }

    /// The input of a convolution's row of output. Of an inlined one it makes the rows that the row before did not take.
    fn window<'a>(
        &'a self,
        step: &'a Step,
        taps: &'a Taps,
        turn: Turn,
        free: &'a mut [u8],
        pixels: usize,
    ) -> Row<'a> {
        let (Some(inner), buffer) = (&step.inlined[0], &step.reads[0]) else {
            return taps.row(self.read(step.reads[0].all()), turn.y, pixels);
        };
        let band = &taps.band;
        let (kept, below) = free.split_at_mut(step.kept_bytes(inner));
        let topmost = turn.y * band.stride;
        let new = if turn.first {
            band.rows
        } else {
            band.rows.min(band.stride)
        };
        for number in band.rows - new..band.rows {
            let at = (topmost + number) % band.rows * buffer.row_bytes();
            let whole = &mut kept[at..at + buffer.row_bytes()];
            match (topmost + number).checked_sub(band.above) {
                Some(y) if y < buffer.height => {
                    let pixels = between_borders(buffer, whole);
                    self.row(inner, buffer, Turn { y, ..turn }, pixels, below);
                }
                _ => whole.fill(buffer.zero),
            }
        }
        Row {
            input: kept,
            base: band.base,
            runs: &band.runs[topmost % band.rows],
            step: taps.steps[1],
            pixels,
        }
    }

    /// One row of bytes; `free` is memory for the rows of inlined steps.
    fn row(&self, step: &Step, buffer: &Buffer, turn: Turn, out: &mut [u8], mut free: &mut [u8]) {
        let kernel = self.kernel;
        let Turn { y, member, .. } = turn;
        // Of a tensor of one pixel, that one.
        let mut input = |number: usize| match step.inlined.get(number) {
            Some(Some(inner)) => self.inlined(step, inner, turn, &mut free),
            _ => {
                let read = &step.reads[number];
                self.read(read.row(y.min(read.height - 1)))
            }
        };
        match &step.work {
            Work::Quantize {
                input,
                shape,
                quantization,
            } => {
                let channels = shape[0];
                let plane = |channel: usize| self.plane(*input, *shape, channel, y);
                if buffer.pitch == 4 {
                    let mut planes: [&[f32]; 4] = [&[]; 4];
                    for (channel, place) in planes.iter_mut().enumerate().take(channels) {
                        *place = plane(channel);
                    }
                    kernel.quantize_four(
                        &planes[..channels],
                        quantization.scale,
                        quantization.zero,
                        out,
                    );
                } else {
                    quantize_row(plane, channels, *quantization, out, buffer.pitch);
                }
            }
            Work::Dense { dense, taps, to } => {
                let row = self.window(step, taps, turn, free, buffer.width);
                if !dense.has_few_outputs(&row) {
                    return kernel.dense_bytes(dense, &row, to, out, buffer.pitch);
                }
                let mut steps = self.scratch[member]
                    .lock()
                    .unwrap_or_else(PoisonError::into_inner);
                let steps = &mut steps[..dense.lanes() * buffer.width];
                kernel.dense_floats(dense, &row, steps);
                out.fill(to.zero);
                let lanes = steps.chunks_exact(buffer.width).take(buffer.channels);
                for (channel, lane) in lanes.enumerate() {
                    saturate_channel(lane, channel, buffer.pitch, to, out);
                }
            }
            Work::Depthwise {
                depthwise,
                taps,
                to,
            } => {
                let row = self.window(step, taps, turn, free, buffer.width);
                kernel.depthwise(depthwise, &row, to, out);
            }
            Work::Add(addition) => {
                for (one, other, out) in pixels(&step.reads, [0, 1].map(&mut input), out) {
                    kernel.add(addition, one, other, out);
                }
            }
            Work::Multiply { zeros, factor, to } => {
                for (one, other, out) in pixels(&step.reads, [0, 1].map(&mut input), out) {
                    multiply_row(*zeros, *factor, to, one, other, out);
                }
            }
            Work::Pad {
                rows,
                columns,
                fill,
                table,
            } => match rows[y] {
                None => out.fill(*fill),
                Some(y) => {
                    let input = self.read(step.reads[0].row(y));
                    pad_row(input, columns, buffer.pitch, *fill, table, out);
                }
            },
            Work::Flatten(table) => {
                let read = &step.reads[0];
                out.fill(buffer.zero);
                for y in 0..read.height {
                    let input = self.read(read.row(y));
                    flatten(
                        table,
                        input,
                        [read.channels, read.height, read.pitch],
                        y,
                        out,
                    );
                }
            }
            Work::DepthToSpace {
                block,
                sources,
                table,
            } => {
                let read = &step.reads[0];
                let of_row = sources.chunks_exact(block * buffer.channels).nth(y % block);
                out.fill(buffer.zero);
                spread_row(
                    self.read(read.row(y / block)),
                    of_row.unwrap_or_default(),
                    buffer.channels,
                    [read.pitch, buffer.pitch],
                    table,
                    out,
                );
            }
            Work::Elementwise {
                expression,
                sources,
                shape,
                quantization,
                ..
            } => {
                let Some(quantization) = quantization else {
                    return;
                };
                let mut scratch = self.scratch[member]
                    .lock()
                    .unwrap_or_else(PoisonError::into_inner);
                let (values, scratch) = scratch.split_at_mut(shape[2]);
                out.fill(buffer.zero);
                for channel in 0..shape[0] {
                    self.evaluate((expression, sources), channel, y, values, scratch);
                    store_channel(values, channel, buffer.pitch, *quantization, out);
                }
            }
            Work::Table(table) => {
                let part = Part {
                    pixels: buffer.width,
                    channels: buffer.pitch,
                    pitches: [buffer.pitch; 2],
                    first: 0,
                };
                kernel.place(table, part, input(0), out);
            }
            Work::Concat(tables) => {
                let mut first = 0;
                for (number, (table, read)) in tables.iter().zip(&step.reads).enumerate() {
                    let part = Part {
                        pixels: buffer.width,
                        channels: read.channels,
                        pitches: [read.pitch, buffer.pitch],
                        first,
                    };
                    kernel.place(table, part, input(number), out);
                    first += read.channels;
                }
            }
            Work::Resize {
                rows,
                columns,
                to,
                zero,
                factor,
                same,
            } => {
                let Between {
                    first,
                    second,
                    weight,
                } = rows[y];
                let row = |y: usize| self.read(step.reads[0].row(y));
                if *same {
                    let input = row(first);
                    copy_row(input, columns, buffer.pitch, out);
                } else {
                    let halves = Halves {
                        rows: [row(first), row(second)],
                        weight,
                    };
                    resize_row(halves, columns, buffer.pitch, *zero, *factor, to, out);
                }
            }
            Work::MaxPool {
                window,
                placed,
                table,
            } => {
                for (x, out) in out.chunks_exact_mut(buffer.pitch).enumerate() {
                    max_row(
                        self.taps(&step.reads[0], window, placed.before, [y, x]),
                        table,
                        out,
                    );
                }
            }
            Work::Average {
                window,
                placed,
                counts_padding,
                zero,
                factor,
                to,
            } => {
                for (x, out) in out.chunks_exact_mut(buffer.pitch).enumerate() {
                    let taps = self.taps(&step.reads[0], window, placed.before, [y, x]);
                    let count = if *counts_padding {
                        placed.taps(window, [y, x])
                    } else {
                        taps.clone().count()
                    };
                    average_row(taps, *zero, factor / count as f32, to, out);
                }
            }
            Work::DenseFloats { .. } | Work::Dequantize { .. } => {}
        }
    }

    /// The pixels under a window that lie in the picture.
    fn taps<'a>(
        &'a self,
        read: &'a Buffer,
        window: &'a Window,
        before: [usize; 2],
        [y, x]: [usize; 2],
    ) -> impl Iterator<Item = &'a [u8]> + Clone {
        let along = move |axis: usize, at: usize, length: usize| {
            (0..window.kernel[axis])
                .filter_map(move |tap| {
                    (at * window.strides[axis] + tap * window.dilations[axis])
                        .checked_sub(before[axis])
                })
                .filter(move |&at| at < length)
        };
        along(0, y, read.height).flat_map(move |y| {
            let row = self.read(read.row(y));
            along(1, x, read.width).map(move |x| &row[x * read.pitch..][..read.pitch])
        })
    }

    /// One row that leaves as f32.
    fn leave(&self, step: &Step, y: usize, member: usize) {
        match &step.work {
            Work::DenseFloats {
                dense,
                taps,
                outputs,
                size,
            } => {
                let row = taps.row(self.read(step.reads[0].all()), y, size[1]);
                let mut scratch = self.scratch[member]
                    .lock()
                    .unwrap_or_else(PoisonError::into_inner);
                let scratch = &mut scratch[..dense.lanes() * size[1]];
                self.kernel.dense_floats(dense, &row, scratch);
                let mut lanes = scratch.chunks_exact(size[1]);
                for &(output, channels) in outputs {
                    let shape = [channels, size[0], size[1]];
                    for (channel, lane) in lanes.by_ref().take(channels).enumerate() {
                        self.plane_to_write(output, shape, channel, y)
                            .copy_from_slice(lane);
                    }
                }
            }
            Work::Dequantize {
                quantization,
                output,
            } => {
                let Buffer {
                    channels,
                    height,
                    width,
                    pitch,
                    ..
                } = step.reads[0];
                for channel in 0..channels {
                    let out = self.plane_to_write(*output, [channels, height, width], channel, y);
                    dequantize_row(
                        self.read(step.reads[0].row(y)),
                        channel,
                        pitch,
                        *quantization,
                        out,
                    );
                }
            }
            Work::Elementwise {
                expression,
                sources,
                shape,
                output: Some(output),
                ..
            } => {
                let mut scratch = self.scratch[member]
                    .lock()
                    .unwrap_or_else(PoisonError::into_inner);
                for channel in 0..shape[0] {
                    let out = self.plane_to_write(*output, *shape, channel, y);
                    self.evaluate((expression, sources), channel, y, out, &mut scratch);
                }
            }
            _ => {}
        }
    }
}

/// Writes a member's share of a buffer's rows, and the border beside them.
pub(super) fn write_rows(
    arena: &Shared<'_, u8>,
    buffer: &Buffer,
    rows: Range<usize>,
    mut row: impl FnMut(usize, &mut [u8]),
) {
    // SAFETY: `place` gave what is written a place that nothing else is in as long as it is read; each row is one
    // member's, with the border on its sides, and so is the border above the first and below the last.
    let write = |range: Range<usize>| unsafe { arena.write(range) };
    for y in rows {
        let border = buffer.border * buffer.row_bytes();
        if y == 0 {
            write(buffer.offset..buffer.offset + border).fill(buffer.zero);
        }
        if y + 1 == buffer.height {
            let end = buffer.offset + buffer.len();
            write(end - border..end).fill(buffer.zero);
        }
        row(y, between_borders(buffer, write(buffer.whole_row(y))));
    }
}

/// Rows to work on together: the whole rows, or where the second is one pixel for all, pixel by pixel.
fn pixels<'a>(
    reads: &[Buffer],
    [one, other]: [&'a [u8]; 2],
    out: &'a mut [u8],
) -> impl Iterator<Item = (&'a [u8], &'a [u8], &'a mut [u8])> {
    let length = match reads {
        [one, other] if one.width != other.width || one.height != other.height => other.pitch,
        _ => out.len(),
    };
    one.chunks(length.max(1))
        .zip(out.chunks_mut(length.max(1)))
        .map(move |(one, out)| (one, other, out))
}
