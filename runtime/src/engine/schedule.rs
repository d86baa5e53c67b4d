//! An island made ready for one size of picture: weights packed, memory laid out, work shared out.
//!
//! Every byte tensor has its place in one arena; places are given again once the last reader is done. A layer's rows are
//! shared out among the threads, which meet after each layer. A run allocates nothing.

use std::collections::HashMap;
use std::ops::Range;
use std::sync::{Mutex, PoisonError};

use super::arena::{Arena, Shared};
use super::island::Island;
use super::kernels::{
    Addition, Dense, Depthwise, Halves, Kernel, Row, ToBytes, average_row, concat_row, copy_row,
    dequantize_row, max_row, multiply_row, quantize_row, resize_row, table_row,
};
use super::layer::{
    Between, Convolution, Form, Layer, Operand, Operation, Quantization, Shape, Window,
};
use super::threads::{Member, Team};

/// Widest convolution that shares one block with its siblings.
const SIBLING_LANES: usize = 16;
/// Most bytes of an arena.
const MAX_ARENA: usize = 1 << 31;

/// A byte tensor's place in the arena; see [`super::kernels`] for the layout.
#[derive(Clone, Copy, Debug)]
struct Buffer {
    offset: usize,
    channels: usize,
    height: usize,
    width: usize,
    pitch: usize,
    /// Pixels of border on each side.
    border: usize,
    /// What the border holds.
    zero: u8,
}

impl Buffer {
    fn row_bytes(&self) -> usize {
        (self.width + 2 * self.border) * self.pitch
    }

    fn len(&self) -> usize {
        (self.height + 2 * self.border) * self.row_bytes()
    }

    fn all(&self) -> Range<usize> {
        self.offset..self.offset + self.len()
    }

    /// A row with its border.
    fn whole_row(&self, y: usize) -> Range<usize> {
        let start = self.offset + (y + self.border) * self.row_bytes();
        start..start + self.row_bytes()
    }

    /// A row without.
    fn row(&self, y: usize) -> Range<usize> {
        let start = self.whole_row(y).start + self.border * self.pitch;
        start..start + self.width * self.pitch
    }
}

/// A convolution's geometry in bytes of its input.
#[derive(Debug)]
struct Taps {
    /// From the first output pixel's first tap to each run or tap.
    runs: Vec<usize>,
    /// The first output pixel's first tap, from the tensor's start.
    base: usize,
    /// From output row to output row, and from output pixel to output pixel.
    steps: [usize; 2],
}

impl Taps {
    fn new(window: &Window, input: &Buffer, runs: Vec<usize>) -> Result<Self, String> {
        let ([top, left], _) = window.place([input.height, input.width])?;
        Ok(Self {
            runs,
            base: (input.border - top) * input.row_bytes() + (input.border - left) * input.pitch,
            steps: [
                window.strides[0] * input.row_bytes(),
                window.strides[1] * input.pitch,
            ],
        })
    }

    fn row<'a>(&'a self, input: &'a [u8], y: usize, pixels: usize) -> Row<'a> {
        Row {
            input,
            base: self.base + y * self.steps[0],
            runs: &self.runs,
            step: self.steps[1],
            pixels,
        }
    }
}

#[derive(Debug)]
enum Work {
    Quantize {
        input: usize,
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
        outputs: Vec<(usize, usize)>,
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
    MaxPool {
        window: Window,
        before: [usize; 2],
        table: Box<[u8; 256]>,
    },
    Average {
        window: Window,
        before: [usize; 2],
        counts_padding: bool,
        zero: u8,
        factor: f32,
        to: ToBytes,
    },
    Dequantize {
        quantization: Quantization,
        output: usize,
    },
}

#[derive(Debug)]
struct Step {
    work: Work,
    reads: Vec<Buffer>,
    /// `None` where the result leaves the island.
    writes: Option<Buffer>,
    rows: usize,
}

/// An island ready to run.
#[derive(Debug)]
pub(crate) struct Schedule {
    kernel: Kernel,
    steps: Vec<Step>,
    /// What the first step writes, where bytes can be written instead of quantizing the only input.
    entrance: Option<(Buffer, Quantization)>,
    arena: Arena,
    team: Team,
    /// A row of f32 for each member.
    scratch: Vec<Mutex<Vec<f32>>>,
    inputs: Vec<Shape>,
    outputs: Vec<Shape>,
}

/// What a schedule runs on.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Inputs<'a> {
    /// The island's f32 tensors, planar.
    Planes(&'a [&'a [f32]]),
    /// What [`Schedule::enter`] wrote.
    Entered,
}

impl Schedule {
    /// Plans `island` for inputs of these shapes. The error says what about the model cannot be done.
    pub(crate) fn new(
        island: &Island,
        inputs: &[Shape],
        kernel: Kernel,
        threads: usize,
    ) -> Result<Self, String> {
        if !kernel.is_supported() {
            return Err(format!("this processor has no {kernel:?}"));
        }
        let shapes = island.shapes(inputs)?;
        let shape = |name: &String| {
            shapes
                .get(name.as_str())
                .copied()
                .ok_or_else(|| format!("`{name}` is not made"))
        };
        let outputs: Vec<Shape> = island.outputs.iter().map(shape).collect::<Result<_, _>>()?;
        let order = with_siblings_together(&island.layers);
        let (buffers, arena) = place(&order, &shapes)?;
        let steps = order
            .iter()
            .map(|siblings| step(island, siblings, &buffers, &shapes, kernel))
            .collect::<Result<Vec<_>, _>>()?;
        let team = Team::new(threads);
        let widest = steps.iter().map(scratch).max().unwrap_or(0);
        let scratch = (0..threads.max(1))
            .map(|_| Mutex::new(vec![0.0; widest]))
            .collect();
        Ok(Self {
            kernel,
            entrance: entrance(&steps),
            steps,
            arena: Arena::new(arena),
            team,
            scratch,
            inputs: inputs.to_vec(),
            outputs,
        })
    }

    /// Shapes of the f32 tensors that it writes.
    pub(crate) fn output_shapes(&self) -> &[Shape] {
        &self.outputs
    }

    /// How the bytes that [`Schedule::enter`] writes stand for real numbers; `None` where it cannot be called.
    pub(crate) fn entrance_quantization(&self) -> Option<Quantization> {
        self.entrance.map(|(_, quantization)| quantization)
    }

    /// Number of threads that run it.
    pub(crate) fn members(&self) -> usize {
        self.scratch.len()
    }

    /// Writes the only input's bytes, four a pixel: `row(member, y, bytes)` for each of its rows.
    pub(crate) fn enter(
        &mut self,
        row: &(dyn Fn(usize, usize, &mut [u8]) + Sync),
    ) -> Result<(), String> {
        let (buffer, _) = self.entrance.ok_or("the island takes f32")?;
        let arena = Shared::new(self.arena.bytes());
        let whole = self.team.run(&|member: &Member<'_>| {
            write_rows(&arena, &buffer, member.share(buffer.height), |y, out| {
                row(member.number, y, out)
            });
        });
        whole.then_some(()).ok_or_else(panicked)
    }

    /// Runs the island; planar f32 out.
    pub(crate) fn run(
        &mut self,
        inputs: Inputs<'_>,
        outputs: &[Shared<'_, f32>],
    ) -> Result<(), String> {
        let fits = |planes: &[&[f32]]| {
            let mut pairs = self.inputs.iter().zip(planes);
            self.inputs.len() == planes.len()
                && pairs.all(|(shape, plane)| shape.iter().product::<usize>() == plane.len())
        };
        let (inputs, steps) = match inputs {
            Inputs::Planes(planes) if !fits(planes) => {
                return Err(
                    "the island's inputs are not of the sizes that it was planned for".to_owned(),
                );
            }
            Inputs::Planes(planes) => (planes, &self.steps[..]),
            Inputs::Entered => (&[][..], &self.steps[1..]),
        };
        let run = Run {
            kernel: self.kernel,
            arena: Shared::new(self.arena.bytes()),
            scratch: &self.scratch,
            inputs,
            shapes: &self.inputs,
            outputs,
        };
        let whole = self.team.run(&|member: &Member<'_>| {
            for step in steps {
                run.step(step, member);
                if !member.wait() {
                    return;
                }
            }
        });
        whole.then_some(()).ok_or_else(panicked)
    }
}

/// The first step's output and quantization, if it quantizes the only input, to four bytes a pixel.
fn entrance(steps: &[Step]) -> Option<(Buffer, Quantization)> {
    let (first, rest) = steps.split_first()?;
    let quantizes = |step: &Step| matches!(step.work, Work::Quantize { .. });
    match (&first.work, first.writes) {
        (&Work::Quantize { quantization, .. }, Some(buffer))
            if buffer.pitch == 4 && !rest.iter().any(quantizes) =>
        {
            Some((buffer, quantization))
        }
        _ => None,
    }
}

fn panicked() -> String {
    "the engine panicked on it; please report the model".to_owned()
}

/// Writes a member's share of a buffer's rows, and the border beside them.
fn write_rows(
    arena: &Shared<'_, u8>,
    buffer: &Buffer,
    rows: Range<usize>,
    row: impl Fn(usize, &mut [u8]),
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
        let whole = write(buffer.whole_row(y));
        let side = buffer.border * buffer.pitch;
        let (left, rest) = whole.split_at_mut(side);
        let (pixels, right) = rest.split_at_mut(buffer.width * buffer.pitch);
        left.fill(buffer.zero);
        right.fill(buffer.zero);
        row(y, pixels);
    }
}

/// Layers in order, with convolutions together whose f32 results fit one block and come from the same pixels.
fn with_siblings_together(layers: &[Layer]) -> Vec<Vec<&Layer>> {
    let mut order: Vec<Vec<&Layer>> = Vec::new();
    let dense = |layer: &Layer| match (&layer.operation, &layer.form) {
        (Operation::Convolution(c), Form::Floats) if !c.depthwise => {
            Some((c.outputs, c.window.clone()))
        }
        _ => None,
    };
    for layer in layers {
        if let Some((outputs, window)) = dense(layer) {
            let joins = |siblings: &&mut Vec<&Layer>| {
                let together: Option<Vec<_>> =
                    siblings.iter().map(|sibling| dense(sibling)).collect();
                together.is_some_and(|together| {
                    together.iter().map(|(outputs, _)| outputs).sum::<usize>() + outputs
                        <= SIBLING_LANES
                        && together[0].1 == window
                        && siblings[0].inputs[0].name == layer.inputs[0].name
                        && siblings[0].inputs[0].quantization == layer.inputs[0].quantization
                })
            };
            if let Some(siblings) = order.iter_mut().find(joins) {
                siblings.push(layer);
                continue;
            }
        }
        order.push(vec![layer]);
    }
    order
}

fn pitch(layer: &Layer, channels: usize) -> usize {
    match layer.operation {
        Operation::Quantize if channels <= 4 => 4,
        _ => channels.next_multiple_of(16),
    }
}

/// Gives every byte tensor a place; returns the arena's length too.
fn place<'a>(
    order: &[Vec<&'a Layer>],
    shapes: &HashMap<&str, Shape>,
) -> Result<(HashMap<&'a str, Buffer>, usize), String> {
    let mut buffers: HashMap<&str, Buffer> = HashMap::new();
    let mut live: HashMap<&str, [usize; 2]> = HashMap::new();
    let mut border_of: HashMap<&str, u8> = HashMap::new();
    for (time, layer) in order
        .iter()
        .enumerate()
        .flat_map(|(time, layers)| layers.iter().map(move |l| (time, *l)))
    {
        if let Form::Bytes { quantization, .. } = layer.form {
            let [channels, height, width] = shapes[layer.output.as_str()];
            let pitch = pitch(layer, channels);
            let zero = quantization.zero;
            let buffer = Buffer {
                offset: 0,
                channels,
                height,
                width,
                pitch,
                border: 0,
                zero,
            };
            buffers.insert(&layer.output, buffer);
            live.insert(&layer.output, [time, time]);
        }
        for input in &layer.inputs {
            let (Some(live), Some(buffer)) = (
                live.get_mut(input.name.as_str()),
                buffers.get_mut(input.name.as_str()),
            ) else {
                continue;
            };
            live[1] = time;
            let Operation::Convolution(Convolution { window, .. }) = &layer.operation else {
                continue;
            };
            let size = [buffer.height, buffer.width];
            let (before, outputs) = window.place(size)?;
            let border = (0..2).map(|axis| {
                let end = (outputs[axis] - 1) * window.strides[axis]
                    + (window.kernel[axis] - 1) * window.dilations[axis]
                    + 1;
                before[axis].max(end.saturating_sub(before[axis] + size[axis]))
            });
            let border = border.max().unwrap_or(0);
            if border > 0 {
                let zero = *border_of
                    .entry(&input.name)
                    .or_insert(input.quantization.zero);
                if zero != input.quantization.zero {
                    return Err(format!("`{}` is read with two zero points", input.name));
                }
                buffer.zero = zero;
                buffer.border = buffer.border.max(border);
            }
        }
    }
    // The largest first, each at the lowest place that is free for as long as it lives.
    let mut names: Vec<&str> = buffers.keys().copied().collect();
    names.sort_by_key(|name| (std::cmp::Reverse(buffers[name].len()), live[name], *name));
    let mut placed: Vec<(Range<usize>, [usize; 2])> = Vec::new();
    let mut end = 0;
    for name in names {
        let [first, last] = live[name];
        let Some(buffer) = buffers.get_mut(name) else {
            continue;
        };
        let length = buffer.len().next_multiple_of(64);
        let mut taken: Vec<&Range<usize>> = placed
            .iter()
            .filter(|(_, [f, l])| *f <= last && first <= *l)
            .map(|(range, _)| range)
            .collect();
        taken.sort_by_key(|range| range.start);
        let mut offset = 0;
        for range in taken {
            if offset + length <= range.start {
                break;
            }
            offset = offset.max(range.end);
        }
        buffer.offset = offset;
        end = end.max(offset + length);
        placed.push((offset..offset + length, [first, last]));
    }
    if end > MAX_ARENA {
        return Err(format!("it would need {end} bytes"));
    }
    Ok((buffers, end))
}

/// What a change of scale makes of each byte.
fn rescale(
    from: Quantization,
    to: Quantization,
    range: &std::ops::RangeInclusive<u8>,
) -> [u8; 256] {
    let mut table = [0; 256];
    for (byte, out) in (0..=255).zip(&mut table) {
        *out = to.byte(from.real(byte)).clamp(*range.start(), *range.end());
    }
    table
}

/// The work of one layer, or of several siblings.
fn step(
    island: &Island,
    siblings: &[&Layer],
    buffers: &HashMap<&str, Buffer>,
    shapes: &HashMap<&str, Shape>,
    kernel: Kernel,
) -> Result<Step, String> {
    let layer = siblings[0];
    let unknown = |name: &str| format!("`{name}` is not made");
    let buffer = |operand: &Operand| {
        buffers
            .get(operand.name.as_str())
            .copied()
            .ok_or_else(|| unknown(&operand.name))
    };
    let output = |layer: &Layer| {
        island
            .outputs
            .iter()
            .position(|name| *name == layer.output)
            .ok_or_else(|| unknown(&layer.output))
    };
    let [_, rows, width] = shapes[layer.output.as_str()];
    let writes = buffers.get(layer.output.as_str()).copied();
    if let Operation::Quantize = layer.operation {
        let name = &layer.inputs[0].name;
        let input = island
            .inputs
            .iter()
            .position(|input| input == name)
            .ok_or_else(|| unknown(name))?;
        let work = Work::Quantize {
            input,
            quantization: layer.inputs[0].quantization,
        };
        return Ok(Step {
            work,
            reads: Vec::new(),
            writes,
            rows,
        });
    }
    let reads: Vec<Buffer> = layer.inputs.iter().map(buffer).collect::<Result<_, _>>()?;
    let from: Vec<Quantization> = layer
        .inputs
        .iter()
        .map(|input| input.quantization)
        .collect();
    let work = match (&layer.operation, &layer.form) {
        (Operation::Quantize, _) => return Err(unknown(&layer.output)),
        (Operation::Dequantize, _) => Work::Dequantize {
            quantization: from[0],
            output: output(layer)?,
        },
        (Operation::Convolution(convolution), Form::Floats) => {
            let convolutions: Vec<&Convolution> = siblings
                .iter()
                .filter_map(|layer| match &layer.operation {
                    Operation::Convolution(convolution) => Some(convolution),
                    _ => None,
                })
                .collect();
            let (dense, runs) = dense(kernel, &convolutions, from[0], &layer.form, &reads[0]);
            let outputs: Result<Vec<usize>, String> =
                siblings.iter().map(|layer| output(layer)).collect();
            let channels = convolutions.iter().map(|convolution| convolution.outputs);
            Work::DenseFloats {
                dense,
                taps: Taps::new(&convolution.window, &reads[0], runs)?,
                outputs: outputs?.into_iter().zip(channels).collect(),
                size: [rows, width],
            }
        }
        (
            Operation::Convolution(convolution),
            Form::Bytes {
                quantization,
                range,
            },
        ) => {
            let to = ToBytes {
                zero: quantization.zero,
                range: range.clone(),
            };
            let window = &convolution.window;
            if convolution.depthwise {
                let input = &reads[0];
                let runs = (0..window.kernel[0]).flat_map(|row| {
                    (0..window.kernel[1]).map(move |column| {
                        row * window.dilations[0] * input.row_bytes()
                            + column * window.dilations[1] * input.pitch
                    })
                });
                let depthwise = Depthwise::new(
                    kernel,
                    input.pitch,
                    window.kernel,
                    &convolution.weights,
                    &convolution.starts(from[0]),
                    &convolution.factors(from[0], &layer.form),
                );
                Work::Depthwise {
                    depthwise,
                    taps: Taps::new(window, input, runs.collect())?,
                    to,
                }
            } else {
                let (dense, runs) = dense(kernel, &[convolution], from[0], &layer.form, &reads[0]);
                Work::Dense {
                    dense,
                    taps: Taps::new(window, &reads[0], runs)?,
                    to,
                }
            }
        }
        (_, Form::Floats) => return Err(format!("`{}` leaves the island as f32", layer.output)),
        (
            operation,
            Form::Bytes {
                quantization,
                range,
            },
        ) => {
            let to = ToBytes {
                zero: quantization.zero,
                range: range.clone(),
            };
            let factor = from[0].scale / quantization.scale;
            let zero = from[0].zero;
            let pitches: Vec<usize> = reads.iter().map(|read| read.pitch).collect();
            let out_pitch = writes.map_or(0, |buffer| buffer.pitch);
            if !matches!(operation, Operation::Concat)
                && pitches.iter().any(|&pitch| pitch != out_pitch)
            {
                return Err(format!(
                    "`{}` has an input of four channels or fewer",
                    layer.output
                ));
            }
            let size = [reads[0].height, reads[0].width];
            match operation {
                Operation::Add => Work::Add(Addition {
                    zeros: [from[0].zero, from[1].zero],
                    factors: [
                        from[0].scale / quantization.scale,
                        from[1].scale / quantization.scale,
                    ],
                    to,
                }),
                Operation::Multiply => Work::Multiply {
                    zeros: [from[0].zero, from[1].zero],
                    factor: from[0].scale * from[1].scale / quantization.scale,
                    to,
                },
                Operation::Table(table) => Work::Table(table.clone()),
                Operation::Concat => Work::Concat(
                    from.iter()
                        .map(|from| rescale(*from, *quantization, range))
                        .collect(),
                ),
                Operation::Resize(resize) => Work::Resize {
                    rows: resize.axis(0, size),
                    columns: resize.axis(1, size),
                    to,
                    zero,
                    factor,
                    same: !resize.linear && from[0] == *quantization && *range == (0..=255),
                },
                Operation::MaxPool(window) => Work::MaxPool {
                    window: window.clone(),
                    before: window.place(size)?.0,
                    table: Box::new(rescale(from[0], *quantization, range)),
                },
                Operation::AveragePool(window, counts_padding) => Work::Average {
                    window: window.clone(),
                    before: window.place(size)?.0,
                    counts_padding: *counts_padding,
                    zero,
                    factor,
                    to,
                },
                Operation::GlobalAveragePool => {
                    let window = Window {
                        kernel: size,
                        strides: [1; 2],
                        dilations: [1; 2],
                        padding: super::layer::Padding::Explicit([0; 4]),
                    };
                    Work::Average {
                        window,
                        before: [0; 2],
                        counts_padding: false,
                        zero,
                        factor,
                        to,
                    }
                }
                Operation::Quantize | Operation::Dequantize | Operation::Convolution(_) => {
                    return Err(unknown(&layer.output));
                }
            }
        }
    };
    Ok(Step {
        work,
        reads,
        writes,
        rows,
    })
}

/// Packs convolutions that read the same pixels, one after the other, and says where their runs are.
fn dense(
    kernel: Kernel,
    convolutions: &[&Convolution],
    from: Quantization,
    form: &Form,
    input: &Buffer,
) -> (Dense, Vec<usize>) {
    let Convolution { window, inputs, .. } = convolutions[0];
    let (starts, factors): (Vec<_>, Vec<_>) = convolutions
        .iter()
        .map(|c| (c.starts(from), c.factors(from, form)))
        .unzip();
    let [rows, columns] = window.kernel;
    let channels = inputs.next_multiple_of(4);
    // Neighbouring taps of a row are neighbours in memory: one run.
    let (runs, run): (Vec<usize>, usize) = if window.dilations[1] == 1 {
        let starts = (0..rows).map(|row| row * window.dilations[0] * input.row_bytes());
        (starts.collect(), (columns - 1) * input.pitch + channels)
    } else {
        let starts = (0..rows * columns).map(|tap| {
            tap / columns * window.dilations[0] * input.row_bytes()
                + tap % columns * window.dilations[1] * input.pitch
        });
        (starts.collect(), channels)
    };
    let weight = |output: usize, number: usize, byte: usize| {
        let (row, column, channel) = if window.dilations[1] == 1 {
            (number, byte / input.pitch, byte % input.pitch)
        } else {
            (number / columns, number % columns, byte)
        };
        let mut output = output;
        for convolution in convolutions {
            if output < convolution.outputs {
                let at = (channel * rows + row) * columns + column;
                return if channel < *inputs {
                    convolution.filter(output)[at]
                } else {
                    0
                };
            }
            output -= convolution.outputs;
        }
        0
    };
    let outputs = convolutions
        .iter()
        .map(|convolution| convolution.outputs)
        .sum();
    (
        Dense::new(
            kernel,
            outputs,
            runs.len(),
            run,
            &starts.concat(),
            &factors.concat(),
            weight,
        ),
        runs,
    )
}

/// Row of f32 that a step needs.
fn scratch(step: &Step) -> usize {
    match &step.work {
        Work::DenseFloats { dense, size, .. } => dense.lanes() * size[1],
        _ => 0,
    }
}

/// What a run's members share.
struct Run<'a> {
    kernel: Kernel,
    arena: Shared<'a, u8>,
    scratch: &'a [Mutex<Vec<f32>>],
    inputs: &'a [&'a [f32]],
    shapes: &'a [Shape],
    outputs: &'a [Shared<'a, f32>],
}

impl Run<'_> {
    /// Bytes that an earlier step wrote.
    fn read(&self, range: Range<usize>) -> &[u8] {
        // SAFETY: `place` gave what this step reads a place that this step does not write, and all members finished
        // the steps that wrote it.
        unsafe { self.arena.read(range) }
    }

    /// One member's share of a step.
    fn step(&self, step: &Step, member: &Member<'_>) {
        let rows = member.share(step.rows);
        match &step.writes {
            Some(buffer) => write_rows(&self.arena, buffer, rows, |y, row| {
                self.row(step, buffer, y, row)
            }),
            None => rows.for_each(|y| self.leave(step, y, member.number)),
        }
    }

    /// One row of bytes.
    fn row(&self, step: &Step, buffer: &Buffer, y: usize, out: &mut [u8]) {
        let kernel = self.kernel;
        let input = |number: usize| self.read(step.reads[number].row(y));
        match &step.work {
            Work::Quantize {
                input,
                quantization,
            } => {
                let [channels, height, width] = self.shapes[*input];
                let plane = |channel: usize| {
                    &self.inputs[*input][(channel * height + y) * width..][..width]
                };
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
                let row = taps.row(self.read(step.reads[0].all()), y, buffer.width);
                kernel.dense_bytes(dense, &row, to, out, buffer.pitch);
            }
            Work::Depthwise {
                depthwise,
                taps,
                to,
            } => {
                let row = taps.row(self.read(step.reads[0].all()), y, buffer.width);
                kernel.depthwise(depthwise, &row, to, out);
            }
            Work::Add(addition) => kernel.add(addition, input(0), input(1), out),
            Work::Multiply { zeros, factor, to } => {
                multiply_row(*zeros, *factor, to, input(0), input(1), out)
            }
            Work::Table(table) => table_row(table, input(0), out),
            Work::Concat(tables) => {
                let mut first = 0;
                for (number, (table, read)) in tables.iter().zip(&step.reads).enumerate() {
                    concat_row(
                        table,
                        input(number),
                        read.channels,
                        [read.pitch, buffer.pitch],
                        first,
                        out,
                    );
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
                before,
                table,
            } => {
                for (x, out) in out.chunks_exact_mut(buffer.pitch).enumerate() {
                    max_row(
                        self.taps(&step.reads[0], window, *before, [y, x]),
                        table,
                        out,
                    );
                }
            }
            Work::Average {
                window,
                before,
                counts_padding,
                zero,
                factor,
                to,
            } => {
                for (x, out) in out.chunks_exact_mut(buffer.pitch).enumerate() {
                    let taps = self.taps(&step.reads[0], window, *before, [y, x]);
                    let all = window.kernel[0] * window.kernel[1];
                    let count = if *counts_padding {
                        all
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
        let plane = |output: usize, channel: usize, [height, width]: [usize; 2]| {
            let start = (channel * height + y) * width;
            // SAFETY: each row of an output is one member's, and its output one step's.
            unsafe { self.outputs[output].write(start..start + width) }
        };
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
                    for (channel, lane) in lanes.by_ref().take(channels).enumerate() {
                        plane(output, channel, *size).copy_from_slice(lane);
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
                    let out = plane(*output, channel, [height, width]);
                    dequantize_row(
                        self.read(step.reads[0].row(y)),
                        channel,
                        pitch,
                        *quantization,
                        out,
                    );
                }
            }
            _ => {}
        }
    }
}
