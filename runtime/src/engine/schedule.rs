//! An island made ready for one size of picture: weights packed, memory laid out, work shared out.
//!
//! Every byte tensor has its place in one arena; places are given again once the last reader is done. A layer's rows are
//! shared out among the threads, which meet after each layer. A run allocates nothing.

use std::collections::HashMap;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering::SeqCst};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::arena::{Arena, Shared};
use super::expression::{Binary, Expression};
use super::island::Island;
use super::kernels::{
    Addition, Dense, Depthwise, Halves, Kernel, Part, Row, ToBytes, average_row, channel_row,
    copy_row, dequantize_row, flatten, max_row, multiply_row, pad_row, quantize_row, resize_row,
    store_channel,
};
use super::layer::{
    Between, Convolution, Fill, Form, Layer, Operand, Operation, Placed, Quantization, Shape,
    Window,
};
use super::profile::{LayerTime, Times};
use super::stages::{Stage, stages};
use super::threads::{Member, Team, stay_on};

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
    /// The same where the input is inlined.
    band: Band,
}

impl Taps {
    fn new(window: &Window, input: &Buffer, runs: Vec<usize>) -> Result<Self, String> {
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

/// The rows of an inlined input that a row of output takes, in memory of the thread's own: row `y` is number
/// `(y + above) % rows` of them, so that the next row of output finds those that it shares with the last one in place.
#[derive(Debug)]
struct Band {
    rows: usize,
    /// Rows above the input that the first row of output takes.
    above: usize,
    /// Rows from one row of output to the next.
    stride: usize,
    /// From the first pixel of the band to each tap, for each place that the topmost row may be in.
    runs: Vec<Vec<usize>>,
    /// The first output pixel's first tap, from the start of a row.
    base: usize,
}

impl Band {
    fn bytes(&self, input: &Buffer) -> usize {
        self.rows * input.row_bytes()
    }
}

/// Where a planar f32 tensor is.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Planes {
    /// Among the island's inputs.
    Input(usize),
    /// Among its outputs.
    Output(usize),
    /// In the island's own memory, from this number on.
    Inner(usize),
}

/// What an elementwise layer reads.
#[derive(Debug)]
enum Source {
    Bytes(Buffer, Quantization),
    Floats(Planes, Shape),
}

#[derive(Debug)]
enum Work {
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

#[derive(Debug)]
struct Step {
    work: Work,
    reads: Vec<Buffer>,
    /// Which of them are not there, and how each of their rows is made.
    inlined: Vec<Option<Step>>,
    /// `None` where the result leaves the island.
    writes: Option<Buffer>,
    rows: usize,
}

impl Step {
    /// Bytes that the rows of all inlined steps take at once.
    fn inlined_bytes(&self) -> usize {
        let inlined = self.inlined.iter().flatten();
        inlined
            .map(|step| self.kept_bytes(step) + step.inlined_bytes())
            .sum()
    }

    /// Bytes of the rows of an inlined step that are there at once; each begins where a cache line does.
    fn kept_bytes(&self, inlined: &Step) -> usize {
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

/// An island ready to run.
#[derive(Debug)]
pub(crate) struct Schedule {
    kernel: Kernel,
    steps: Vec<Step>,
    /// What the first step writes, where bytes can be written instead of quantizing the only input.
    entrance: Option<(Buffer, Quantization)>,
    arena: Arena,
    /// f32 tensors that do not leave the island.
    floats: Vec<f32>,
    team: Team,
    /// What each step is.
    layers: Vec<LayerTime>,
    /// Where somebody measures.
    times: Option<Times>,
    /// A row of f32 for each member.
    scratch: Vec<Mutex<Vec<f32>>>,
    /// Rows of inlined steps, for each member.
    rows: Vec<Mutex<Arena>>,
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
        let order = stages(&island.layers, &shapes, threads);
        let (buffers, arena) = place(&order, &shapes, kernel)?;
        let (planes, floats) = place_floats(island, &order, &shapes)?;
        let steps = order
            .iter()
            .map(|stage| with_inlined(stage, &buffers, &planes, &shapes, kernel))
            .collect::<Result<Vec<_>, _>>()?;
        let layers = order
            .iter()
            .map(|stage| LayerTime::new(stage, &shapes))
            .collect();
        let team = Team::new(threads);
        let widest = steps.iter().map(scratch).max().unwrap_or(0);
        let longest = steps.iter().map(Step::inlined_bytes).max().unwrap_or(0);
        let members = 0..threads.max(1);
        let scratch = members
            .clone()
            .map(|_| Mutex::new(vec![0.0; widest]))
            .collect();
        let rows = members.map(|_| Mutex::new(Arena::new(longest))).collect();
        Ok(Self {
            kernel,
            entrance: entrance(&steps),
            steps,
            arena: Arena::new(arena),
            floats: vec![0.0; floats],
            team,
            layers,
            times: None,
            scratch,
            rows,
            inputs: inputs.to_vec(),
            outputs,
        })
    }

    /// Shapes of the f32 tensors that it writes; those of two dimensions have height and width 1.
    pub(crate) fn output_shapes(&self) -> &[Shape] {
        &self.outputs
    }

    /// How the bytes that [`Schedule::enter`] writes stand for real numbers; `None` where it cannot be called.
    pub(crate) fn entrance_quantization(&self) -> Option<Quantization> {
        self.entrance.map(|(_, quantization)| quantization)
    }

    /// Runs `job(thread)` once on every thread, 0 the caller's.
    pub(crate) fn share(&mut self, job: &(dyn Fn(usize) + Sync)) -> Result<(), String> {
        let whole = self.team.run(&|member: &Member<'_>| job(member.number));
        whole.then_some(()).ok_or_else(panicked)
    }

    /// Keeps each thread on one of `cores`, in order, the caller's on the first.
    pub(crate) fn pin(&mut self, cores: &[usize]) -> Result<(), String> {
        let refused = AtomicBool::new(false);
        self.share(&|thread| {
            let core = cores.get(thread % cores.len().max(1));
            if core.is_some_and(|&core| !stay_on(core)) {
                refused.store(true, SeqCst);
            }
        })?;
        match refused.into_inner() {
            true => Err("the system refuses; give cores that this process may use".to_owned()),
            false => Ok(()),
        }
    }

    /// From now on measures how long each step takes.
    pub(crate) fn measure(&mut self) {
        self.times = Some(Times::new(self.steps.len()));
    }

    /// Times of the steps in all runs since [`Schedule::measure`].
    pub(crate) fn times(&self) -> Vec<LayerTime> {
        let time = |(number, layer): (usize, &LayerTime)| LayerTime {
            time: self
                .times
                .as_ref()
                .map_or(Duration::ZERO, |times| times.of(number)),
            ..layer.clone()
        };
        self.layers.iter().enumerate().map(time).collect()
    }

    /// Number of threads that run it.
    pub(crate) fn members(&self) -> usize {
        self.team.members()
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
            floats: Shared::new(&mut self.floats),
            scratch: &self.scratch,
            rows: &self.rows,
            inputs,
            outputs,
        };
        let first = self.steps.len() - steps.len();
        let times = self.times.as_ref();
        let whole = self.team.run(&|member: &Member<'_>| {
            let times = times.filter(|_| member.number == 0);
            let mut since = times.map(|_| Instant::now());
            for (number, step) in steps.iter().enumerate() {
                run.step(step, member);
                if !member.wait() {
                    return;
                }
                if let (Some(times), Some(since)) = (times, &mut since) {
                    *since = times.add(first + number, *since);
                }
            }
        });
        whole.then_some(()).ok_or_else(panicked)
    }
}

/// The first step's output and quantization, if it quantizes the only input, to four bytes a pixel.
fn entrance(steps: &[Step]) -> Option<(Buffer, Quantization)> {
    let (first, rest) = steps.split_first()?;
    let takes_f32 = |step: &Step| match &step.work {
        Work::Quantize { input, .. } => matches!(input, Planes::Input(_)),
        Work::Elementwise { sources, .. } => {
            let is_input = |source: &Source| matches!(source, Source::Floats(Planes::Input(_), _));
            sources.iter().any(is_input)
        }
        _ => false,
    };
    match (&first.work, first.writes) {
        (&Work::Quantize { quantization, .. }, Some(buffer))
            if buffer.pitch == 4 && takes_f32(first) && !rest.iter().any(takes_f32) =>
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

/// A row's pixels; its border is written.
fn between_borders<'a>(buffer: &Buffer, whole: &'a mut [u8]) -> &'a mut [u8] {
    let (left, rest) = whole.split_at_mut(buffer.border * buffer.pitch);
    let (pixels, right) = rest.split_at_mut(buffer.width * buffer.pitch);
    left.fill(buffer.zero);
    right.fill(buffer.zero);
    pixels
}

/// With more channels depthwise convolutions, which read each pixel several times, gain more by whole lines than their bytes cost.
const WIDE: usize = 128;

/// Bytes from pixel to pixel: four for what enters for dense convolutions alone; of more than [`WIDE`] channels whole lines, of others
/// whole vectors.
fn pitch(layer: &Layer, channels: usize, order: &[Stage<'_>], kernel: Kernel) -> usize {
    let reads = |reader: &&Layer| {
        let named = |input: &Operand| input.name == layer.output;
        reader.inputs.iter().any(named)
    };
    let takes_four = |reader: &Layer| match &reader.operation {
        Operation::Convolution(convolution) => !convolution.depthwise,
        operation => matches!(operation, Operation::Dequantize),
    };
    let mut readers = order.iter().flat_map(Stage::layers).filter(reads);
    match layer.operation {
        Operation::Quantize if channels <= 4 && readers.all(takes_four) => 4,
        _ => {
            let whole = if channels > WIDE { kernel.line() } else { 16 };
            channels.next_multiple_of(whole)
        }
    }
}

/// Gives every byte tensor that is not inlined a place; returns the arena's length too.
fn place<'a>(
    order: &[Stage<'a>],
    shapes: &HashMap<&str, Shape>,
    kernel: Kernel,
) -> Result<(HashMap<&'a str, Buffer>, usize), String> {
    let mut buffers: HashMap<&str, Buffer> = HashMap::new();
    let mut live: HashMap<&str, [usize; 2]> = HashMap::new();
    let mut border_of: HashMap<&str, u8> = HashMap::new();
    for (time, layer) in order
        .iter()
        .enumerate()
        .flat_map(|(time, stage)| stage.layers().map(move |l| (time, l)))
    {
        if let Form::Bytes { quantization, .. } = layer.form {
            let [channels, height, width] = shapes[layer.output.as_str()];
            let pitch = pitch(layer, channels, order, kernel);
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
            let Placed {
                before,
                output: outputs,
                ..
            } = window.place(size)?;
            let Some(quantization) = input.quantization else {
                continue;
            };
            let border = (0..2).map(|axis| {
                let end = (outputs[axis] - 1) * window.strides[axis]
                    + (window.kernel[axis] - 1) * window.dilations[axis]
                    + 1;
                before[axis].max(end.saturating_sub(before[axis] + size[axis]))
            });
            let border = border.max().unwrap_or(0);
            if border > 0 {
                let zero = *border_of.entry(&input.name).or_insert(quantization.zero);
                if zero != quantization.zero {
                    return Err(format!("`{}` is read with two zero points", input.name));
                }
                buffer.zero = zero;
                buffer.border = buffer.border.max(border);
            }
        }
    }
    let inlined: Vec<&str> = (order.iter())
        .flat_map(|stage| stage.inlined.iter().map(|layer| layer.output.as_str()))
        .collect();
    let sizes: Vec<_> = buffers
        .iter()
        .filter(|(name, _)| !inlined.contains(name))
        .map(|(name, buffer)| (*name, buffer.len().next_multiple_of(64), live[name]))
        .collect();
    let (places, end) = pack(sizes);
    if end > MAX_ARENA {
        return Err(format!("it would need {end} bytes"));
    }
    for (name, buffer) in &mut buffers {
        // Those without are inlined.
        buffer.offset = places.get(name).copied().unwrap_or(0);
    }
    Ok((buffers, end))
}

/// Where each f32 tensor is, and how many numbers those that stay inside take.
fn place_floats<'a>(
    island: &'a Island,
    order: &[Stage<'a>],
    shapes: &HashMap<&str, Shape>,
) -> Result<(HashMap<&'a str, Planes>, usize), String> {
    let mut planes: HashMap<&str, Planes> = HashMap::new();
    for (number, name) in island.inputs.iter().enumerate() {
        planes.insert(name, Planes::Input(number));
    }
    for (number, name) in island.outputs.iter().enumerate() {
        planes.insert(name, Planes::Output(number));
    }
    let mut live: HashMap<&str, [usize; 2]> = HashMap::new();
    for (time, layer) in order
        .iter()
        .enumerate()
        .flat_map(|(time, stage)| stage.layers().map(move |l| (time, l)))
    {
        for input in &layer.inputs {
            if let Some(live) = live.get_mut(input.name.as_str()) {
                live[1] = time;
            }
        }
        if matches!(layer.form, Form::Floats) && !planes.contains_key(layer.output.as_str()) {
            live.insert(&layer.output, [time, time]);
        }
    }
    let length = |name: &str| shapes[name].iter().product::<usize>();
    let (places, end) = pack(
        live.iter()
            .map(|(name, live)| (*name, length(name), *live))
            .collect(),
    );
    if end > MAX_ARENA / size_of::<f32>() {
        return Err(format!("it would need {end} numbers"));
    }
    planes.extend(
        places
            .into_iter()
            .map(|(name, at)| (name, Planes::Inner(at))),
    );
    Ok((planes, end))
}

/// Gives tensors (name, length, first and last time) places that those alive at the same time do not share: the largest
/// first, each at the lowest place that is free for as long as it lives. Returns the end of the last, too.
fn pack(mut tensors: Vec<(&str, usize, [usize; 2])>) -> (HashMap<&str, usize>, usize) {
    tensors.sort_by_key(|&(name, length, live)| (std::cmp::Reverse(length), live, name));
    let mut placed: Vec<(Range<usize>, [usize; 2])> = Vec::new();
    let mut places = HashMap::new();
    let mut end = 0;
    for (name, length, [first, last]) in tensors {
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
        places.insert(name, offset);
        end = end.max(offset + length);
        placed.push((offset..offset + length, [first, last]));
    }
    (places, end)
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

/// The work of a stage.
fn with_inlined(
    stage: &Stage<'_>,
    buffers: &HashMap<&str, Buffer>,
    planes: &HashMap<&str, Planes>,
    shapes: &HashMap<&str, Shape>,
    kernel: Kernel,
) -> Result<Step, String> {
    with_inputs(&stage.siblings, &stage.inlined, &|siblings| {
        step(siblings, buffers, planes, shapes, kernel)
    })
}

/// The work of siblings, with that of the inlined layers that make their inputs, and so on.
fn with_inputs(
    siblings: &[&Layer],
    inlined: &[&Layer],
    step: &dyn Fn(&[&Layer]) -> Result<Step, String>,
) -> Result<Step, String> {
    let mut whole = step(siblings)?;
    let named = |operand: &Operand| {
        let layer = inlined.iter().find(|layer| layer.output == operand.name);
        layer
            .map(|layer| with_inputs(&[layer], inlined, step))
            .transpose()
    };
    let inputs = siblings[0].inputs.iter().map(named);
    whole.inlined = inputs.collect::<Result<_, _>>()?;
    Ok(whole)
}

/// The work of one layer, or of several siblings.
fn step(
    siblings: &[&Layer],
    buffers: &HashMap<&str, Buffer>,
    planes: &HashMap<&str, Planes>,
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
    let floats = |name: &String| {
        planes
            .get(name.as_str())
            .copied()
            .ok_or_else(|| unknown(name))
    };
    let output = |layer: &Layer| floats(&layer.output);
    let shape @ [_, rows, width] = shapes[layer.output.as_str()];
    let writes = buffers.get(layer.output.as_str()).copied();
    let elementwise = |expression: Expression| {
        let source = |operand: &Operand| match operand.quantization {
            Some(quantization) => Ok(Source::Bytes(buffer(operand)?, quantization)),
            None => Ok(Source::Floats(
                floats(&operand.name)?,
                shapes[operand.name.as_str()],
            )),
        };
        let (quantization, output) = match &layer.form {
            Form::Bytes { quantization, .. } => (Some(*quantization), None),
            Form::Floats => (None, Some(output(layer)?)),
        };
        let work = Work::Elementwise {
            expression,
            sources: layer
                .inputs
                .iter()
                .map(source)
                .collect::<Result<_, String>>()?,
            shape,
            quantization,
            output,
        };
        Ok(Step {
            work,
            reads: Vec::new(),
            inlined: Vec::new(),
            writes,
            rows,
        })
    };
    match &layer.operation {
        Operation::Quantize => {
            let Form::Bytes { quantization, .. } = layer.form else {
                return Err(unknown(&layer.output));
            };
            let name = &layer.inputs[0].name;
            let work = Work::Quantize {
                input: floats(name)?,
                shape: shapes[name.as_str()],
                quantization,
            };
            return Ok(Step {
                work,
                reads: Vec::new(),
                inlined: Vec::new(),
                writes,
                rows,
            });
        }
        Operation::Elementwise(expression) => return elementwise(expression.clone()),
        _ => {}
    }
    let mut reads: Vec<Buffer> = layer.inputs.iter().map(buffer).collect::<Result<_, _>>()?;
    let mut from = layer
        .inputs
        .iter()
        .map(|input| input.quantization.ok_or_else(|| unknown(&input.name)))
        .collect::<Result<Vec<Quantization>, _>>()?;
    if let Operation::Add | Operation::Multiply = layer.operation {
        let pixel = |buffer: &Buffer| [buffer.height, buffer.width] == [1, 1];
        // One pixel for all comes second. Other repetition is rare.
        if pixel(&reads[0]) {
            reads.swap(0, 1);
            from.swap(0, 1);
        }
        let whole = |buffer: &Buffer| [buffer.channels, buffer.height, buffer.width] == shape;
        let repeats = pixel(&reads[1]) && reads[1].channels == shape[0];
        if !whole(&reads[0]) || !(whole(&reads[1]) || repeats) {
            let binary = match layer.operation {
                Operation::Add => Binary::Add,
                _ => Binary::Mul,
            };
            let inputs = [0, 1].map(|number| Box::new(Expression::Input(number)));
            let [one, other] = inputs;
            return elementwise(Expression::Binary(binary, one, other));
        }
    }
    let work = match (&layer.operation, &layer.form) {
        (Operation::Quantize | Operation::Elementwise(_), _) => {
            return Err(unknown(&layer.output));
        }
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
            let outputs: Result<Vec<Planes>, String> =
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
                let parts = parts(convolution);
                let [rows, columns] = window.kernel;
                let runs = (0..parts * rows).flat_map(|row| {
                    (0..columns).map(move |column| {
                        row % rows * window.dilations[0] * input.row_bytes()
                            + column * window.dilations[1] * input.pitch
                    })
                });
                // A part's filter follows the other's, as more rows of taps.
                let filters: Vec<i8> = (0..convolution.outputs)
                    .flat_map(|output| {
                        (0..parts).flat_map(move |number| {
                            let filter = convolution.filter(output);
                            filter.iter().map(move |&weight| part(weight, number))
                        })
                    })
                    .collect();
                let depthwise = Depthwise::new(
                    kernel,
                    input.pitch,
                    [parts * rows, columns],
                    &filters,
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
            if !matches!(operation, Operation::Concat | Operation::Flatten)
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
                Operation::Pad(pad) => Work::Pad {
                    rows: pad.axis(0, size[0])?,
                    columns: pad.axis(1, size[1])?,
                    fill: match pad.fill {
                        Fill::Constant(real) => {
                            quantization.byte(real).clamp(*range.start(), *range.end())
                        }
                        Fill::Edge | Fill::Reflect => quantization.zero,
                    },
                    table: Box::new(rescale(from[0], *quantization, range)),
                },
                Operation::Flatten => {
                    Work::Flatten(Box::new(rescale(from[0], *quantization, range)))
                }
                Operation::MaxPool(window) => Work::MaxPool {
                    window: window.clone(),
                    placed: window.place(size)?,
                    table: Box::new(rescale(from[0], *quantization, range)),
                },
                Operation::AveragePool(window, counts_padding) => Work::Average {
                    window: window.clone(),
                    placed: window.place(size)?,
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
                        ceil: false,
                    };
                    Work::Average {
                        placed: window.place(size)?,
                        window,
                        counts_padding: false,
                        zero,
                        factor,
                        to,
                    }
                }
                Operation::Quantize
                | Operation::Dequantize
                | Operation::Convolution(_)
                | Operation::Elementwise(_) => {
                    return Err(unknown(&layer.output));
                }
            }
        }
    };
    Ok(Step {
        work,
        reads,
        inlined: Vec::new(),
        writes,
        rows,
    })
}

/// Weights of two's complement bytes that make up each weight: two where one is not enough.
fn parts(convolution: &Convolution) -> usize {
    let fits = |&weight: &i16| i8::try_from(weight).is_ok();
    if convolution.weights.iter().all(fits) {
        1
    } else {
        2
    }
}

/// One of the weights that make up `weight`, which is from -255 to 255.
fn part(weight: i16, number: usize) -> i8 {
    let first = weight.clamp(-128, 127);
    match number {
        0 => first as i8,
        _ => (weight - first) as i8,
    }
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
    let parts = convolutions.iter().map(|c| parts(c)).max().unwrap_or(1);
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
    // What is too large for one weight is read again, with the rest of it.
    let once = runs.len();
    let runs = runs.repeat(parts);
    let weight = |output: usize, number: usize, byte: usize| {
        let (again, number) = (number / once, number % once);
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
                    part(convolution.filter(output)[at], again)
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
        Work::Elementwise {
            expression, shape, ..
        } => (1 + expression.scratch()) * shape[2],
        _ => 0,
    }
}

/// Which row a member makes.
#[derive(Clone, Copy, Debug)]
struct Turn {
    y: usize,
    /// Whether it is the first one of its share, so that none before it left anything.
    first: bool,
    member: usize,
}

/// What a run's members share.
struct Run<'a> {
    kernel: Kernel,
    arena: Shared<'a, u8>,
    floats: Shared<'a, f32>,
    scratch: &'a [Mutex<Vec<f32>>],
    rows: &'a [Mutex<Arena>],
    inputs: &'a [&'a [f32]],
    outputs: &'a [Shared<'a, f32>],
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
    fn step(&self, step: &Step, member: &Member<'_>) {
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
                kernel.dense_bytes(dense, &row, to, out, buffer.pitch);
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
