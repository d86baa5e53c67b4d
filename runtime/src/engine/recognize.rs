//! Finds layers in an ONNX graph: QDQ as ONNX Runtime's, PyTorch's and TensorRT's tools write it.
//!
//! A layer is what stands between DequantizeLinear and QuantizeLinear. What is not recognized is not an error: it stays
//! where it is, and [`super::island`] leaves it to tract.

use std::collections::{HashMap, HashSet};
use std::ops::RangeInclusive;

use tract_onnx::data_resolver::MmapDataResolver;
use tract_onnx::pb::{AttributeProto, GraphProto, NodeProto, TensorProto};
use tract_onnx::prelude::*;

use super::layer::{
    Convolution, Coordinates, Form, Layer, Nearest, Operand, Operation, Padding, Quantization,
    Resize, Target, Window,
};

/// A layer and the nodes that it stands for.
#[derive(Debug)]
pub(crate) struct Recognized {
    pub(crate) layer: Layer,
    /// Its nodes, constants' included, in the graph's order. The last is the one that makes the output.
    pub(crate) nodes: Vec<usize>,
}

/// The layers of a graph, in the graph's order. Every byte tensor that one of them reads is written by another.
pub(crate) fn layers(graph: &GraphProto) -> Vec<Recognized> {
    let reader = Reader::new(graph);
    let mut found: Vec<Recognized> = (0..graph.node.len())
        .filter_map(|node| match graph.node[node].op_type.as_str() {
            "QuantizeLinear" => reader.bytes_layer(node),
            "Conv" => reader.floats_layer(node),
            _ => None,
        })
        .collect();
    // Bytes from elsewhere, and bytes that nobody here reads, are no business of an island.
    loop {
        let before = found.len();
        let made: HashSet<String> = found.iter().map(|f| f.layer.output.clone()).collect();
        found.retain(|f| {
            matches!(f.layer.operation, Operation::Quantize)
                || f.layer
                    .inputs
                    .iter()
                    .all(|input| made.contains(&input.name))
        });
        let read: HashSet<String> = found
            .iter()
            .flat_map(|f| &f.layer.inputs)
            .map(|i| i.name.clone())
            .collect();
        found.retain(|f| {
            !matches!(f.layer.operation, Operation::Quantize) || read.contains(&f.layer.output)
        });
        if found.len() == before {
            break;
        }
    }
    // Whoever is outside, and reads what is made inside, reads f32.
    let made: HashSet<String> = found.iter().map(|f| f.layer.output.clone()).collect();
    let inside: HashSet<usize> = found.iter().flat_map(|f| f.nodes.iter().copied()).collect();
    for (node, proto) in graph.node.iter().enumerate() {
        let Some(quantization) = (proto.op_type == "DequantizeLinear")
            .then(|| proto.input.first().filter(|name| made.contains(*name)))
            .flatten()
            .and_then(|_| reader.quantization(proto))
        else {
            continue;
        };
        let outside = |name: &String| {
            reader.outputs.contains(name.as_str())
                || reader
                    .readers(name)
                    .iter()
                    .any(|reader| !inside.contains(reader))
        };
        if proto.output.iter().any(outside) {
            found.push(Recognized {
                layer: Layer {
                    operation: Operation::Dequantize,
                    inputs: vec![Operand {
                        name: proto.input[0].clone(),
                        quantization,
                    }],
                    output: proto.output[0].clone(),
                    form: Form::Floats,
                },
                nodes: vec![node],
            });
        }
    }
    found.sort_by_key(|f| f.nodes.last().copied());
    found
}

/// An attribute of a node.
pub(crate) fn attribute<'a>(node: &'a NodeProto, name: &str) -> Option<&'a AttributeProto> {
    node.attribute.iter().find(|a| a.name == name)
}

fn integer(node: &NodeProto, name: &str, default: i64) -> i64 {
    attribute(node, name).map_or(default, |a| a.i)
}

fn text<'a>(node: &'a NodeProto, name: &str, default: &'a str) -> Option<&'a str> {
    attribute(node, name).map_or(Some(default), |a| std::str::from_utf8(&a.s).ok())
}

fn float(node: &NodeProto, name: &str, default: f32) -> f32 {
    attribute(node, name).map_or(default, |a| a.f)
}

/// `N` numbers, none negative.
fn sizes<const N: usize>(node: &NodeProto, name: &str, default: [usize; N]) -> Option<[usize; N]> {
    match attribute(node, name) {
        None => Some(default),
        Some(a) => {
            let sizes: Option<Vec<usize>> =
                a.ints.iter().map(|&i| usize::try_from(i).ok()).collect();
            sizes?.try_into().ok()
        }
    }
}

/// A graph with its names looked up.
struct Reader<'a> {
    graph: &'a GraphProto,
    made_by: HashMap<&'a str, usize>,
    read_by: HashMap<&'a str, Vec<usize>>,
    constants: HashMap<&'a str, &'a TensorProto>,
    outputs: HashSet<&'a str>,
}

/// Numbers of a quantized constant along its first axis: integers less their zero points, and scales.
struct Integers {
    values: Vec<i64>,
    shape: Vec<usize>,
    /// One, or one per index of the first axis.
    scales: Vec<f32>,
}

impl<'a> Reader<'a> {
    fn new(graph: &'a GraphProto) -> Self {
        let mut read_by: HashMap<&str, Vec<usize>> = HashMap::new();
        let mut made_by = HashMap::new();
        let mut constants: HashMap<&str, &TensorProto> = graph
            .initializer
            .iter()
            .map(|tensor| (tensor.name.as_str(), tensor))
            .collect();
        for (index, node) in graph.node.iter().enumerate() {
            for input in &node.input {
                read_by.entry(input).or_default().push(index);
            }
            for output in &node.output {
                made_by.insert(output.as_str(), index);
            }
            if node.op_type == "Constant"
                && let (Some(tensor), [output]) = (
                    attribute(node, "value").and_then(|a| a.t.as_ref()),
                    &node.output[..],
                )
            {
                constants.insert(output, tensor);
            }
        }
        let outputs = graph
            .output
            .iter()
            .map(|output| output.name.as_str())
            .collect();
        Self {
            graph,
            made_by,
            read_by,
            constants,
            outputs,
        }
    }

    fn readers(&self, name: &str) -> &[usize] {
        self.read_by.get(name).map_or(&[], Vec::as_slice)
    }

    fn maker(&self, name: &str) -> Option<(usize, &'a NodeProto)> {
        self.made_by
            .get(name)
            .map(|&index| (index, &self.graph.node[index]))
    }

    /// Exactly one node reads it, and it is no output of the graph.
    fn is_private(&self, name: &str) -> bool {
        self.readers(name).len() == 1 && !self.outputs.contains(name)
    }

    fn constant(&self, name: &str) -> Option<Tensor> {
        let proto = *self.constants.get(name)?;
        // Weights in other files stay with tract.
        if proto.data_location.is_some_and(|location| location != 0) {
            return None;
        }
        tract_onnx::tensor::load_tensor(&MmapDataResolver, proto, None).ok()
    }

    fn floats(&self, name: &str) -> Option<Vec<f32>> {
        let tensor = self.constant(name)?;
        Some(
            tensor
                .try_as_plain_ram()
                .ok()?
                .as_slice::<f32>()
                .ok()?
                .to_vec(),
        )
    }

    /// Integers of any type, their shape and their type.
    fn integers(&self, name: &str) -> Option<(Vec<i64>, Vec<usize>, DatumType)> {
        let tensor = self.constant(name)?;
        let shape = tensor.shape().to_vec();
        let plain = tensor.try_as_plain_ram().ok()?;
        let values = match tensor.datum_type() {
            DatumType::U8 => plain
                .as_slice::<u8>()
                .ok()?
                .iter()
                .map(|&v| i64::from(v))
                .collect(),
            DatumType::I8 => plain
                .as_slice::<i8>()
                .ok()?
                .iter()
                .map(|&v| i64::from(v))
                .collect(),
            DatumType::I32 => plain
                .as_slice::<i32>()
                .ok()?
                .iter()
                .map(|&v| i64::from(v))
                .collect(),
            DatumType::I64 => plain.as_slice::<i64>().ok()?.to_vec(),
            _ => return None,
        };
        Some((values, shape, tensor.datum_type()))
    }

    /// The one scale and zero point of a QuantizeLinear or DequantizeLinear of an activation.
    fn quantization(&self, node: &NodeProto) -> Option<Quantization> {
        let scale = match self.floats(node.input.get(1)?)?[..] {
            [scale] if scale.is_finite() && scale > 0.0 => scale,
            _ => return None,
        };
        let zero = match node.input.get(2).filter(|name| !name.is_empty()) {
            None if integer(node, "output_dtype", 0) == 0 => 0,
            None => return None,
            Some(name) => match self.integers(name)? {
                (values, _, DatumType::U8) if values.len() == 1 => values[0],
                (values, _, DatumType::I8) if values.len() == 1 => values[0] + 128,
                _ => return None,
            },
        };
        Some(Quantization {
            scale,
            zero: u8::try_from(zero).ok()?,
        })
    }

    /// The byte tensor behind an f32 name, and the node that dequantizes it.
    fn operand(&self, name: &str) -> Option<Operand> {
        let (_, node) = self
            .maker(name)
            .filter(|(_, node)| node.op_type == "DequantizeLinear")?;
        let bytes = node.input.first()?;
        if self.constants.contains_key(bytes.as_str()) {
            return None;
        }
        Some(Operand {
            name: bytes.clone(),
            quantization: self.quantization(node)?,
        })
    }

    /// A constant that is stored quantized (DequantizeLinear of integers), or that is quantized on the spot
    /// (DequantizeLinear of QuantizeLinear of f32).
    fn quantized_constant(&self, name: &str, nodes: &mut Vec<usize>) -> Option<Integers> {
        let (index, node) = self
            .maker(name)
            .filter(|(_, node)| node.op_type == "DequantizeLinear")?;
        nodes.push(index);
        let scales = self.floats(node.input.get(1)?)?;
        if scales
            .iter()
            .any(|scale| !scale.is_finite() || *scale <= 0.0)
        {
            return None;
        }
        nodes.extend(
            node.input
                .iter()
                .filter_map(|input| self.made_by.get(input.as_str())),
        );
        let zeros = match node.input.get(2).filter(|name| !name.is_empty()) {
            None => None,
            Some(zeros) => Some(self.integers(zeros)?),
        };
        let axis = integer(node, "axis", 1);
        let source = node.input.first()?;
        let (mut values, shape) = match self.integers(source) {
            Some((values, shape, _)) => (values, shape),
            None => {
                let (_, quantize) = self
                    .maker(source)
                    .filter(|(_, node)| node.op_type == "QuantizeLinear")?;
                let tensor = self.constant(quantize.input.first()?)?;
                let floats = self.floats(quantize.input.first()?)?;
                let same = quantize.input.get(1) == node.input.get(1)
                    && quantize.input.get(2) == node.input.get(2);
                let shape = tensor.shape().to_vec();
                let per = floats.len() / shape.first().copied().unwrap_or(1).max(1);
                if !same || (scales.len() > 1 && integer(quantize, "axis", 1) != 0) {
                    return None;
                }
                nodes.extend(
                    quantize
                        .input
                        .iter()
                        .filter_map(|input| self.made_by.get(input.as_str())),
                );
                let (low, high) = match zeros.as_ref() {
                    Some((_, _, DatumType::I8)) => (-128, 127),
                    None | Some((_, _, DatumType::U8)) => (0, 255),
                    _ => return None,
                };
                let quantized = |(index, value): (usize, &f32)| {
                    let row = index / per.max(1);
                    let scale = *scales.get(row).or(scales.first())?;
                    let zero = zeros
                        .as_ref()
                        .map_or(Some(0), |(z, ..)| z.get(row).or(z.first()).copied())?;
                    Some(((value / scale).round_ties_even() as i64 + zero).clamp(low, high))
                };
                let values: Option<Vec<i64>> = floats.iter().enumerate().map(quantized).collect();
                (values?, shape)
            }
        };
        let rows = shape.first().copied().unwrap_or(1);
        if scales.len() != 1 && (scales.len() != rows || axis != 0) {
            return None;
        }
        if let Some((zeros, ..)) = zeros {
            if zeros.len() != scales.len() {
                return None;
            }
            let per = (values.len() / zeros.len()).max(1);
            for (index, value) in values.iter_mut().enumerate() {
                *value -= zeros[index / per];
            }
        }
        Some(Integers {
            values,
            shape,
            scales,
        })
    }

    /// The layer that ends in a QuantizeLinear.
    fn bytes_layer(&self, node: usize) -> Option<Recognized> {
        let quantize = &self.graph.node[node];
        let quantization = self.quantization(quantize)?;
        let float = quantize.input.first()?;
        if self.constants.contains_key(float.as_str()) {
            return None;
        }
        let found = |operation, inputs, range, mut nodes: Vec<usize>| {
            nodes.push(node);
            nodes.sort_unstable();
            nodes.dedup();
            Some(Recognized {
                layer: Layer {
                    operation,
                    inputs,
                    output: quantize.output.first()?.clone(),
                    form: Form::Bytes {
                        quantization,
                        range,
                    },
                },
                nodes,
            })
        };
        if let Some((operand, table, nodes)) = self.function_of_a_byte(float, quantization) {
            return found(
                Operation::Table(Box::new(table)),
                vec![operand],
                0..=255,
                nodes,
            );
        }
        let mut nodes = Vec::new();
        let range = self.clamps(float, quantization, &mut nodes);
        if let Some((operation, inputs)) = range.as_ref().and_then(|(before, range)| {
            self.operation(
                before,
                &Form::Bytes {
                    quantization,
                    range: range.clone(),
                },
                &mut nodes,
            )
        }) {
            return found(operation, inputs, range?.1, nodes);
        }
        let input = Operand {
            name: float.clone(),
            quantization,
        };
        found(Operation::Quantize, vec![input], 0..=255, Vec::new())
    }

    /// A convolution whose result leaves as f32.
    fn floats_layer(&self, node: usize) -> Option<Recognized> {
        let name = self.graph.node[node].output.first()?;
        let mut nodes = Vec::new();
        // Where one QuantizeLinear takes it, perhaps behind ReLU and Clip, it is that one's layer.
        let mut reader = name;
        while self.is_private(reader) {
            let next = &self.graph.node[self.readers(reader)[0]];
            match next.op_type.as_str() {
                "QuantizeLinear"
                    if self
                        .bytes_layer(self.readers(reader)[0])?
                        .nodes
                        .contains(&node) =>
                {
                    return None;
                }
                "Relu" | "Clip" => reader = next.output.first()?,
                _ => break,
            }
        }
        let (operation, inputs) = self.operation(name, &Form::Floats, &mut nodes)?;
        if matches!(&operation, Operation::Convolution(convolution) if convolution.depthwise) {
            return None;
        }
        nodes.sort_unstable();
        nodes.dedup();
        Some(Recognized {
            layer: Layer {
                operation,
                inputs,
                output: name.clone(),
                form: Form::Floats,
            },
            nodes,
        })
    }

    /// The name in front of ReLU and Clip, and what they leave of the bytes.
    fn clamps(
        &self,
        name: &'a str,
        quantization: Quantization,
        nodes: &mut Vec<usize>,
    ) -> Option<(&'a str, RangeInclusive<u8>)> {
        let mut name = name;
        let (mut low, mut high) = (0, 255);
        while let Some((index, node)) = self.maker(name)
            && let Some([least, most]) = self.bounds(node)
        {
            if !self.is_private(name) {
                return None;
            }
            // Later bounds were met first: Clip(Clip(x)).
            (low, high) = (
                quantization.byte(least).clamp(low, high),
                quantization.byte(most).clamp(low, high),
            );
            nodes.push(index);
            nodes.extend(
                node.input
                    .iter()
                    .skip(1)
                    .filter_map(|input| self.made_by.get(input.as_str())),
            );
            name = node.input.first()?;
        }
        (self.is_private(name) && low <= high).then_some((name, low..=high))
    }

    /// Bounds of a ReLU or Clip.
    fn bounds(&self, node: &NodeProto) -> Option<[f32; 2]> {
        match node.op_type.as_str() {
            "Relu" => Some([0.0, f32::INFINITY]),
            "Clip" => {
                let bound = |input: usize, name: &str, default: f32| match node.input.get(input) {
                    Some(constant) if !constant.is_empty() => {
                        self.floats(constant)?.first().copied()
                    }
                    _ => Some(float(node, name, default)),
                };
                let bounds = [
                    bound(1, "min", f32::NEG_INFINITY)?,
                    bound(2, "max", f32::INFINITY)?,
                ];
                (bounds[0] <= bounds[1]).then_some(bounds)
            }
            _ => None,
        }
    }

    /// A chain of functions of one number between a DequantizeLinear and `name`, as a table of bytes.
    fn function_of_a_byte(
        &self,
        name: &str,
        output: Quantization,
    ) -> Option<(Operand, [u8; 256], Vec<usize>)> {
        let mut chain = Vec::new();
        let mut nodes = Vec::new();
        let mut name = name;
        let operand = loop {
            if let Some(operand) = self.operand(name) {
                break operand;
            }
            let (index, node) = self.maker(name).filter(|_| self.is_private(name))?;
            chain.push(self.function(node)?);
            nodes.push(index);
            nodes.extend(
                node.input
                    .iter()
                    .skip(1)
                    .filter_map(|input| self.made_by.get(input.as_str())),
            );
            name = node.input.first()?;
        };
        let mut table = [0; 256];
        for (byte, out) in (0..=255).zip(&mut table) {
            let real = operand.quantization.real(byte);
            *out = output.byte(chain.iter().rev().fold(real, |x, f| f(x)));
        }
        Some((operand, table, nodes))
    }

    /// A function of one number.
    fn function(&self, node: &NodeProto) -> Option<Box<dyn Fn(f32) -> f32>> {
        let sigmoid = |x: f32| 1.0 / (1.0 + (-x).exp());
        Some(match node.op_type.as_str() {
            "Relu" | "Clip" => {
                let [least, most] = self.bounds(node)?;
                Box::new(move |x: f32| x.clamp(least, most))
            }
            "LeakyRelu" => {
                let alpha = float(node, "alpha", 0.01);
                Box::new(move |x| if x < 0.0 { alpha * x } else { x })
            }
            "Elu" => {
                let alpha = float(node, "alpha", 1.0);
                Box::new(move |x| if x < 0.0 { alpha * x.exp_m1() } else { x })
            }
            "HardSigmoid" => {
                let (alpha, beta) = (float(node, "alpha", 0.2), float(node, "beta", 0.5));
                Box::new(move |x| (alpha * x + beta).clamp(0.0, 1.0))
            }
            "HardSwish" => Box::new(|x| x * (x / 6.0 + 0.5).clamp(0.0, 1.0)),
            "Sigmoid" => Box::new(sigmoid),
            "Softplus" => Box::new(|x: f32| x.exp().ln_1p()),
            "Tanh" => Box::new(f32::tanh),
            "Exp" => Box::new(f32::exp),
            "Abs" => Box::new(f32::abs),
            "Neg" => Box::new(|x: f32| -x),
            _ => return None,
        })
    }

    /// The operation that makes the f32 tensor `name` from bytes.
    fn operation(
        &self,
        name: &str,
        form: &Form,
        nodes: &mut Vec<usize>,
    ) -> Option<(Operation, Vec<Operand>)> {
        let (index, node) = self.maker(name)?;
        nodes.push(index);
        let input = |number: usize| self.operand(node.input.get(number)?);
        let first = |operation: Operation| Some((operation, vec![input(0)?]));
        match node.op_type.as_str() {
            "Conv" => {
                let operand = input(0)?;
                let mut convolution = self.convolution(node, operand.quantization, nodes)?;
                convolution
                    .fit_32_bits(operand.quantization, form)
                    .then_some((Operation::Convolution(convolution), vec![operand]))
            }
            "Add" => Some((Operation::Add, vec![input(0)?, input(1)?])),
            "Mul" => Some((Operation::Multiply, vec![input(0)?, input(1)?])),
            "Concat" if integer(node, "axis", 0) == 1 => {
                let inputs: Option<Vec<Operand>> = (0..node.input.len()).map(input).collect();
                Some((Operation::Concat, inputs?))
            }
            "Resize" => {
                nodes.extend(
                    node.input
                        .iter()
                        .skip(1)
                        .filter_map(|input| self.made_by.get(input.as_str())),
                );
                first(Operation::Resize(self.resize(node)?))
            }
            "MaxPool" if node.output.len() == 1 => first(Operation::MaxPool(pool(node)?)),
            "AveragePool" => {
                let counts_padding = integer(node, "count_include_pad", 0) != 0;
                first(Operation::AveragePool(pool(node)?, counts_padding))
            }
            "GlobalAveragePool" => first(Operation::GlobalAveragePool),
            _ => None,
        }
    }

    fn convolution(
        &self,
        node: &NodeProto,
        input: Quantization,
        nodes: &mut Vec<usize>,
    ) -> Option<Convolution> {
        let weights = self.quantized_constant(node.input.get(1)?, nodes)?;
        let &[outputs, per_group, rows, columns] = &weights.shape[..] else {
            return None;
        };
        let window = window(node, Some([rows, columns]))?;
        let groups = usize::try_from(integer(node, "group", 1))
            .ok()
            .filter(|&groups| groups > 0)?;
        if outputs == 0 || per_group == 0 || rows == 0 || columns == 0 || outputs % groups != 0 {
            return None;
        }
        let inputs = per_group * groups;
        let values: Option<Vec<i8>> = weights
            .values
            .iter()
            .map(|&v| i8::try_from(v).ok())
            .collect();
        let mut values = values?;
        // Pixels of four channels or fewer may be packed too tightly for the depthwise kernel.
        let depthwise = per_group == 1 && groups == outputs && groups > 4;
        if !depthwise && groups > 1 {
            let taps = rows * columns;
            let mut dense = vec![0; outputs.checked_mul(inputs)?.checked_mul(taps)?];
            for (output, filter) in values.chunks_exact(per_group * taps).enumerate() {
                let group = output / (outputs / groups);
                let start = (output * inputs + group * per_group) * taps;
                dense[start..][..filter.len()].copy_from_slice(filter);
            }
            values = dense;
        }
        let scales = match weights.scales.len() {
            1 => vec![weights.scales[0]; outputs],
            _ => weights.scales,
        };
        let bias = match node.input.get(2).filter(|name| !name.is_empty()) {
            None => vec![0; outputs],
            Some(name) => self.bias(name, input, &scales, nodes)?,
        };
        Some(Convolution {
            depthwise,
            inputs,
            outputs,
            weights: values,
            scales,
            bias,
            window,
        })
    }

    /// The bias in units of `s_i s_w`.
    fn bias(
        &self,
        name: &str,
        input: Quantization,
        scales: &[f32],
        nodes: &mut Vec<usize>,
    ) -> Option<Vec<i32>> {
        let reals: Vec<f64> = match self.floats(name) {
            Some(floats) => {
                nodes.extend(self.made_by.get(name));
                floats.into_iter().map(f64::from).collect()
            }
            None => {
                let integers = self.quantized_constant(name, nodes)?;
                let scale = |index: usize| {
                    integers
                        .scales
                        .get(index)
                        .or(integers.scales.first())
                        .copied()
                };
                let real =
                    |(index, &value): (usize, &i64)| Some(value as f64 * f64::from(scale(index)?));
                integers
                    .values
                    .iter()
                    .enumerate()
                    .map(real)
                    .collect::<Option<_>>()?
            }
        };
        if reals.len() != scales.len() {
            return None;
        }
        let steps = |(real, &scale): (&f64, &f32)| {
            // The unit in f32, as the file's own bias scale was made.
            let steps = (real / f64::from(input.scale * scale)).round_ties_even();
            (steps.abs() < f64::from(i32::MAX)).then_some(steps as i32)
        };
        reals.iter().zip(scales).map(steps).collect()
    }

    fn resize(&self, node: &NodeProto) -> Option<Resize> {
        let linear = match text(node, "mode", "nearest")? {
            "nearest" => false,
            "linear" => true,
            _ => return None,
        };
        let coordinates = match text(node, "coordinate_transformation_mode", "half_pixel")? {
            "half_pixel" => Coordinates::HalfPixel,
            "pytorch_half_pixel" => Coordinates::PytorchHalfPixel,
            "asymmetric" => Coordinates::Asymmetric,
            "align_corners" => Coordinates::AlignCorners,
            _ => return None,
        };
        let nearest = match text(node, "nearest_mode", "round_prefer_floor")? {
            "round_prefer_floor" => Nearest::RoundPreferFloor,
            "round_prefer_ceil" => Nearest::RoundPreferCeil,
            "floor" => Nearest::Floor,
            "ceil" => Nearest::Ceil,
            _ => return None,
        };
        let other = [
            "antialias",
            "exclude_outside",
            "keep_aspect_ratio_policy",
            "axes",
        ];
        if other.iter().any(|name| {
            attribute(node, name).is_some_and(|a| a.i != 0 || !a.s.is_empty() || !a.ints.is_empty())
        }) {
            return None;
        }
        let given = |number: usize| node.input.get(number).filter(|name| !name.is_empty());
        let target = match (given(2), given(3)) {
            (_, Some(sizes)) => match self.integers(sizes)?.0[..] {
                [1, _, height, width] => {
                    Target::Sizes([height.try_into().ok()?, width.try_into().ok()?])
                }
                _ => return None,
            },
            (Some(scales), None) => match self.floats(scales)?[..] {
                [1.0, 1.0, height, width]
                    if (0.01..=100.0).contains(&height) && (0.01..=100.0).contains(&width) =>
                {
                    Target::Scales([height, width])
                }
                _ => return None,
            },
            (None, None) => return None,
        };
        // With sizes the number of channels is not checked here; the layer keeps it, and tract would too.
        Some(Resize {
            linear,
            coordinates,
            nearest,
            target,
        })
    }
}

fn pool(node: &NodeProto) -> Option<Window> {
    if integer(node, "ceil_mode", 0) != 0 || integer(node, "storage_order", 0) != 0 {
        return None;
    }
    window(node, None)
}

fn window(node: &NodeProto, kernel: Option<[usize; 2]>) -> Option<Window> {
    let kernel = match (kernel, attribute(node, "kernel_shape").is_some()) {
        (kernel, true) => Some(sizes(node, "kernel_shape", [0; 2])?)
            .filter(|k| kernel.is_none_or(|kernel| kernel == *k)),
        (kernel, false) => kernel,
    }?;
    let strides = sizes(node, "strides", [1; 2])?;
    let dilations = sizes(node, "dilations", [1; 2])?;
    let padding = match text(node, "auto_pad", "NOTSET")? {
        "NOTSET" | "" => Padding::Explicit(sizes(node, "pads", [0; 4])?),
        "VALID" => Padding::Explicit([0; 4]),
        "SAME_UPPER" => Padding::Same(false),
        "SAME_LOWER" => Padding::Same(true),
        _ => return None,
    };
    let positive = [kernel, strides, dilations]
        .iter()
        .flatten()
        .all(|&n| (1..=1024).contains(&n));
    positive.then_some(Window {
        kernel,
        strides,
        dilations,
        padding,
    })
}
