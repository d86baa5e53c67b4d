//! Where each tensor lies: one arena for those of bytes, one for those of f32 that stay inside.

use std::collections::HashMap;
use std::ops::Range;

use super::super::island::Island;
use super::super::kernels::Kernel;
use super::super::layer::{Convolution, Form, Layer, Operand, Operation, Placed, Shape};
use super::super::stages::Stage;
use super::buffer::Buffer;

/// Most bytes of an arena.
const MAX_ARENA: usize = 1 << 31;

/// Where a planar f32 tensor is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Planes {
    /// Among the island's inputs.
    Input(usize),
    /// Among its outputs.
    Output(usize),
    /// In the island's own memory, from this number on.
    Inner(usize),
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
pub(super) fn place<'a>(
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
pub(super) fn place_floats<'a>(
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
