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
    /// Multiply-adds of its weights, padding not counted.
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
        let multiply_adds = |layer: &Layer| {
            let [_, height, width] = shapes[layer.output.as_str()];
            weights(layer) * (height * width) as u64
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
