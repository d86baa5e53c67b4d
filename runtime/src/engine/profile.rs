//! How long each layer takes, for whoever asks.

use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::time::{Duration, Instant};

use super::layer::{Convolution, Form, Layer, Operand, Operation, Shape};
use super::stages::Stage;

/// One layer, or several that run as one, and how long it took.
#[derive(Clone, Debug)]
pub struct LayerTime {
    /// Name of the tensor that it writes.
    pub output: String,
    /// What it does, with kernel and stride.
    pub operation: String,
    /// Channels, height and width of its output.
    pub shape: [usize; 3],
    /// Multiply-adds of its weights, padding not counted, and of those blocks (16 outputs, 4 inputs) that are not all zero: kernels may leave
    /// out the others.
    pub multiply_adds: u64,
    /// Bytes that it moves at least: inputs and weights read once, its output written once.
    pub bytes: u64,
    /// Time until all threads were done with it, summed over the runs measured.
    pub time: Duration,
}

impl LayerTime {
    pub(super) fn new(stage: &Stage<'_>, shapes: &HashMap<&str, Shape>) -> Self {
        let layer = stage.siblings[0];
        let shape = shapes[layer.output.as_str()];
        let weights = |layer: &Layer| match &layer.operation {
            Operation::Convolution(convolution) => convolution.weights.len() as u64,
            _ => 0,
        };
        let multiply_adds = |layer: &Layer| match &layer.operation {
            Operation::Convolution(convolution) => {
                let [_, height, width] = shapes[layer.output.as_str()];
                weights_of_filled_blocks(convolution) as u64 * (height * width) as u64
            }
            _ => 0,
        };
        let bytes = |name: &str, value: usize| {
            let values = shapes.get(name).map_or(0, |shape| shape.iter().product());
            (values * value) as u64
        };
        let is_inlined = |input: &Operand| {
            let mut inlined = stage.inlined.iter();
            inlined.any(|inlined| inlined.output == input.name)
        };
        let read = |input: &Operand| {
            let value = input.quantization.map_or(size_of::<f32>(), |_| 1);
            bytes(&input.name, value)
        };
        let read: u64 = (stage.inlined.iter().chain([&layer]))
            .flat_map(|layer| &layer.inputs)
            .filter(|input| !is_inlined(input))
            .map(read)
            .sum();
        let written = |layer: &&Layer| match layer.form {
            Form::Bytes { .. } => bytes(&layer.output, 1),
            Form::Floats => bytes(&layer.output, size_of::<f32>()),
        };
        let operations = stage.inlined.iter().chain([&layer]);
        let operations: Vec<String> = operations.map(|l| describe(&l.operation)).collect();
        Self {
            output: layer.output.clone(),
            operation: operations.join(" + "),
            shape: [
                stage
                    .siblings
                    .iter()
                    .map(channels)
                    .sum::<usize>()
                    .max(shape[0]),
                shape[1],
                shape[2],
            ],
            multiply_adds: stage.layers().map(multiply_adds).sum(),
            bytes: read
                + stage.layers().map(weights).sum::<u64>()
                + stage.siblings.iter().map(written).sum::<u64>(),
            time: Duration::ZERO,
        }
    }
}

fn weights_of_filled_blocks(convolution: &Convolution) -> usize {
    if convolution.depthwise {
        return convolution.weights.len();
    }
    let [rows, columns] = convolution.window.kernel;
    let taps = rows * columns;
    let parts = |all: usize, size: usize| {
        let starts = (0..all).step_by(size);
        starts.map(move |start| start..all.min(start + size))
    };
    let mut weights = 0;
    for outputs in parts(convolution.outputs, 16) {
        for inputs in parts(convolution.inputs, 4) {
            let is_filled = |tap: &usize| {
                outputs.clone().any(|output| {
                    let filter = convolution.filter(output);
                    (inputs.clone()).any(|input| filter[input * taps + tap] != 0)
                })
            };
            weights += (0..taps).filter(is_filled).count() * outputs.len() * inputs.len();
        }
    }
    weights
}

fn channels(layer: &&Layer) -> usize {
    match &layer.operation {
        Operation::Convolution(convolution) => convolution.outputs,
        _ => 0,
    }
}

fn describe(operation: &Operation) -> String {
    let name = match operation {
        Operation::Quantize => "quantize",
        Operation::Dequantize => "dequantize",
        Operation::Convolution(Convolution {
            depthwise, window, ..
        }) => {
            let name = if *depthwise {
                "depthwise"
            } else {
                "convolution"
            };
            let ([rows, columns], stride) = (window.kernel, window.strides[0]);
            return format!("{name} {rows}x{columns} / {stride}");
        }
        Operation::Add => "add",
        Operation::Multiply => "multiply",
        Operation::Concat => "concat",
        Operation::Pad(_) => "pad",
        Operation::Flatten => "flatten",
        Operation::DepthToSpace(_) => "depth to space",
        Operation::Elementwise(_) => "elementwise",
        Operation::Table(_) => "table",
        Operation::Resize(_) => "resize",
        Operation::MaxPool(_) => "max pool",
        Operation::AveragePool(..) | Operation::GlobalAveragePool => "average pool",
    };
    name.to_owned()
}

/// Nanoseconds of each step.
#[derive(Debug)]
pub(super) struct Times(Vec<AtomicU64>);

impl Times {
    pub(super) fn new(steps: usize) -> Self {
        Self((0..steps).map(|_| AtomicU64::new(0)).collect())
    }

    pub(super) fn add(&self, step: usize, since: Instant) -> Instant {
        let now = Instant::now();
        self.0[step].fetch_add((now - since).as_nanos() as u64, Relaxed);
        now
    }

    pub(super) fn of(&self, step: usize) -> Duration {
        Duration::from_nanos(self.0[step].load(Relaxed))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::layer::{Padding, Window};

    #[test]
    fn blocks_of_zeros_are_no_multiply_adds() {
        // Two blocks of outputs, the second of eight, two of inputs, the second of two, nine taps.
        let (outputs, inputs, taps) = (24, 6, 9);
        let weights = |value: &dyn Fn(usize, usize, usize) -> i16| {
            let values = (0..outputs).flat_map(|output| {
                (0..inputs).flat_map(move |input| (0..taps).map(move |tap| (output, input, tap)))
            });
            weights_of_filled_blocks(&Convolution {
                depthwise: false,
                inputs,
                outputs,
                weights: values.map(|(o, i, t)| value(o, i, t)).collect(),
                scales: vec![1.0; outputs],
                bias: vec![0; outputs],
                window: Window {
                    kernel: [3; 2],
                    strides: [1; 2],
                    dilations: [1; 2],
                    padding: Padding::Explicit([1; 4]),
                    ceil: false,
                },
            })
        };
        assert_eq!(weights(&|_, _, _| 1), 24 * 6 * 9);
        assert_eq!(weights(&|_, _, _| 0), 0);
        let one = |at: (usize, usize, usize)| weights(&|o, i, t| i16::from((o, i, t) == at));
        assert_eq!([one((15, 3, 8)), one((16, 3, 0))], [16 * 4, 8 * 4]);
        assert_eq!([one((15, 4, 8)), one((16, 5, 0))], [16 * 2, 8 * 2]);
    }
}
