//! Convolutions, transposed convolutions and linear layers with quantized constant weights.

use tract_onnx::pb::NodeProto;

use super::Found;
use super::constants::Integers;
use super::graph::{Reader, attribute, float, input, integer, sizes};
use super::window::{moving_window, window};
use crate::engine::layer::{
    Convolution, Fill, Form, Layer, Operand, Operation, Pad, Padding, Quantization, Window,
};

/// Whether an operator multiplies by weights.
pub(crate) fn has_weights(op: &str) -> bool {
    matches!(op, "Conv" | "ConvTranspose" | "Gemm" | "MatMul")
}

/// A convolution, the bytes that it reads, and what has to become of them first.
pub(super) struct Weighted {
    pub(super) convolution: Convolution,
    pub(super) input: Operand,
    /// Of a transposed convolution: the layer that spreads its input.
    pub(super) first: Option<Layer>,
}

/// One tap: linear layers, and transposed convolutions, whose input is padded already.
fn plain_window(kernel: [usize; 2], dilations: [usize; 2]) -> Window {
    Window {
        kernel,
        strides: [1; 2],
        dilations,
        padding: Padding::Explicit([0; 4]),
        ceil: false,
    }
}

impl Reader<'_> {
    pub(super) fn weighted(
        &self,
        node: &NodeProto,
        form: &Form,
        nodes: &mut Vec<usize>,
    ) -> Found<Weighted> {
        let activation = input(node, 0).ok_or("it has no input")?;
        let operand = self
            .operand(activation)
            .ok_or("its input is not quantized")??;
        let quantization = operand.quantization.ok_or("its input is not quantized")?;
        let weights_name = input(node, 1).ok_or("it has no weights")?;
        self.check_weight_type(weights_name)?;
        let weights = self.quantized_constant(weights_name, nodes)?;
        let mut first = None;
        let mut read = operand.clone();
        let mut convolution = match node.op_type.as_str() {
            "Conv" => grouped(node, &weights)?,
            "ConvTranspose" => {
                let (pad, convolution) = transposed(node, &weights)?;
                let output = node.output.first().ok_or("it has no output")?;
                read.name = format!("{} spread for {output}", operand.name);
                first = Some(Layer {
                    operation: Operation::Pad(pad),
                    inputs: vec![operand],
                    output: read.name.clone(),
                    form: Form::Bytes {
                        quantization,
                        range: 0..=255,
                    },
                });
                convolution
            }
            _ => {
                if self.rank(activation) != Some(2) {
                    return Err("its input is not a matrix [1, channels]".into());
                }
                linear(node, &weights)?
            }
        };
        if let Some(bias) = input(node, 2) {
            convolution.bias = self.bias(bias, quantization, &convolution.scales, nodes)?;
        }
        if !convolution.fit_32_bits(quantization, form) {
            return Err("its sums may leave 32 bits".into());
        }
        Ok(Weighted {
            convolution,
            input: read,
            first,
        })
    }

    /// The bias in units of `s_i s_w`.
    fn bias(
        &self,
        name: &str,
        input: Quantization,
        scales: &[f32],
        nodes: &mut Vec<usize>,
    ) -> Found<Vec<i32>> {
        let reals: Vec<f64> = match self.floats(name) {
            Some(floats) => {
                nodes.extend(self.maker(name).map(|(index, _)| index));
                floats.into_iter().map(f64::from).collect()
            }
            None => {
                let integers = self
                    .quantized_constant(name, nodes)
                    .map_err(|_| "its bias is not a constant")?;
                let real = |(value, scale)| value as f64 * f64::from(scale);
                integers.scaled().map(real).collect()
            }
        };
        if reals.len() != scales.len() {
            return Err("its bias is not one number per output channel".into());
        }
        let steps = |(real, &scale): (&f64, &f32)| {
            // The unit in f32, as the file's own bias scale was made.
            let steps = (real / f64::from(input.scale * scale)).round_ties_even();
            (steps.abs() < f64::from(i32::MAX)).then_some(steps as i32)
        };
        let bias: Option<Vec<i32>> = reals.iter().zip(scales).map(steps).collect();
        Ok(bias.ok_or("its bias leaves 32 bits")?)
    }
}

fn groups(node: &NodeProto) -> Found<usize> {
    match usize::try_from(integer(node, "group", 1)) {
        Ok(groups @ 1..) => Ok(groups),
        _ => Err("its number of groups is not positive".into()),
    }
}

/// One scale for each of `outputs` channels, which are the weights' axis `axis` of `shape` (for groups, repeated).
fn scales(weights: &Integers, axis: usize, outputs: usize) -> Found<Vec<f32>> {
    match weights.scales.len() {
        1 => Ok(vec![weights.scales[0]; outputs]),
        n if weights.axis == axis && outputs.is_multiple_of(n) => Ok((0..outputs)
            .map(|output| weights.scales[output % n])
            .collect()),
        _ => Err("its weights have scales along another axis than their outputs".into()),
    }
}

fn dimensions(weights: &Integers) -> Found<[usize; 4]> {
    match weights.shape[..] {
        [a, b, rows, columns] if a * b * rows * columns > 0 => Ok([a, b, rows, columns]),
        _ => Err(format!(
            "its weights have the shape {:?}, not four dimensions",
            weights.shape
        )
        .into()),
    }
}

fn grouped(node: &NodeProto, weights: &Integers) -> Found<Convolution> {
    let [outputs, per_group, rows, columns] = dimensions(weights)?;
    let window = moving_window(node, Some([rows, columns]))?;
    let groups = groups(node)?;
    if outputs % groups != 0 {
        return Err("its outputs do not divide into its groups".into());
    }
    let inputs = per_group * groups;
    let mut values: Vec<i16> = weights.values.iter().map(|&v| v as i16).collect();
    // Pixels of four channels or fewer may be packed too tightly for the depthwise kernel.
    let depthwise = per_group == 1 && groups == outputs && groups > 4;
    if !depthwise && groups > 1 {
        let taps = rows * columns;
        let length = outputs
            .checked_mul(inputs)
            .and_then(|n| n.checked_mul(taps));
        let mut dense = vec![0; length.ok_or("its weights are too many")?];
        for (output, filter) in values.chunks_exact(per_group * taps).enumerate() {
            let group = output / (outputs / groups);
            let start = (output * inputs + group * per_group) * taps;
            dense[start..][..filter.len()].copy_from_slice(filter);
        }
        values = dense;
    }
    Ok(Convolution {
        depthwise,
        inputs,
        outputs,
        weights: values,
        scales: scales(weights, 0, outputs)?,
        bias: vec![0; outputs],
        window,
    })
}

/// A convolution over the spread input, with mirrored taps.
fn transposed(node: &NodeProto, weights: &Integers) -> Found<(Pad, Convolution)> {
    let [inputs, per_group, rows, columns] = dimensions(weights)?;
    let Window {
        kernel,
        strides,
        dilations,
        padding,
        ..
    } = window(node, Some([rows, columns]))?;
    let Padding::Explicit(pads) = padding else {
        return Err("its padding is automatic".into());
    };
    if attribute(node, "output_shape").is_some_and(|a| !a.ints.is_empty()) {
        return Err("it states its output's shape instead of its padding".into());
    }
    let more: [usize; 2] =
        sizes(node, "output_padding", [0; 2]).ok_or("its output_padding is not two numbers")?;
    let groups = groups(node)?;
    let outputs = per_group * groups;
    if inputs % groups != 0 {
        return Err("its inputs do not divide into its groups".into());
    }
    let taps = rows * columns;
    let length = outputs
        .checked_mul(inputs)
        .and_then(|n| n.checked_mul(taps));
    let mut mirrored = vec![0; length.ok_or("its weights are too many")?];
    for (index, &value) in weights.values.iter().enumerate() {
        let (pair, tap) = (index / taps, index % taps);
        let (input, within) = (pair / per_group, pair % per_group);
        let output = input / (inputs / groups) * per_group + within;
        mirrored[(output * inputs + input) * taps + taps - 1 - tap] = value as i16;
    }
    let reach = |axis: usize| ((kernel[axis] - 1) * dilations[axis]) as i64;
    let pad = Pad {
        before: [0, 1].map(|axis| reach(axis) - pads[axis] as i64),
        after: [0, 1].map(|axis| reach(axis) - pads[axis + 2] as i64 + more[axis] as i64),
        apart: strides,
        fill: Fill::Constant(0.0),
    };
    let convolution = Convolution {
        depthwise: false,
        inputs,
        outputs,
        weights: mirrored,
        scales: scales(weights, 1, outputs)?,
        bias: vec![0; outputs],
        window: plain_window(kernel, dilations),
    };
    Ok((pad, convolution))
}

fn linear(node: &NodeProto, weights: &Integers) -> Found<Convolution> {
    let &[rows, columns] = &weights.shape[..] else {
        return Err("its weights are not a matrix".into());
    };
    if float(node, "alpha", 1.0) != 1.0
        || float(node, "beta", 1.0) != 1.0
        || integer(node, "transA", 0) != 0
    {
        return Err("its alpha, beta or transA is not the usual one".into());
    }
    let by_output = integer(node, "transB", 0) != 0;
    let (inputs, outputs) = if by_output {
        (columns, rows)
    } else {
        (rows, columns)
    };
    if inputs * outputs == 0 {
        return Err("its weights are empty".into());
    }
    let weight = |index: usize| {
        let (output, input) = (index / inputs, index % inputs);
        weights.values[if by_output {
            index
        } else {
            input * outputs + output
        }] as i16
    };
    Ok(Convolution {
        depthwise: false,
        inputs,
        outputs,
        weights: (0..inputs * outputs).map(weight).collect(),
        scales: scales(weights, usize::from(!by_output), outputs)?,
        bias: vec![0; outputs],
        window: plain_window([1; 2], [1; 2]),
    })
}
