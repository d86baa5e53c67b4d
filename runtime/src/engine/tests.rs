//! The engine against each layer's definition in real numbers, against tract's own operator chain, and against itself.
#![expect(clippy::unwrap_used, reason = "tests")]

use tract_onnx::pb::tensor_proto::DataType;
use tract_onnx::pb::tensor_shape_proto::{Dimension, dimension::Value};
use tract_onnx::pb::{
    AttributeProto, GraphProto, ModelProto, NodeProto, OperatorSetIdProto, TensorProto,
    TensorShapeProto, TypeProto, ValueInfoProto, attribute_proto::AttributeType, type_proto,
};
use tract_onnx::prelude::*;

use super::island::ISLAND;
use super::kernels::{Dense, Depthwise, Row, ToBytes};
use super::layer::{Coordinates, Nearest, Quantization, Resize, Target};
use super::{Engine, Kernel, register, to_qdq};
use crate::model::{Model, Network};

mod blocks;
mod layers;
mod tools;

/// Reproducible numbers.
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> u64 {
        self.0 = self
            .0
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        self.0 >> 33
    }

    fn below(&mut self, bound: usize) -> usize {
        self.next() as usize % bound
    }

    fn from(&mut self, range: std::ops::RangeInclusive<usize>) -> usize {
        range.start() + self.below(range.end() - range.start() + 1)
    }

    fn real(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * (self.next() as f32 / (1u64 << 31) as f32)
    }
}

/// Scale and zero point of a byte tensor; `int8` or `uint8`.
#[derive(Clone, Copy, Debug)]
struct Steps {
    scale: f32,
    zero: i32,
    signed: bool,
}

impl Steps {
    fn random(numbers: &mut Numbers, scale: f32) -> Self {
        let signed = numbers.below(3) == 0;
        let zero = numbers.below(256) as i32 - if signed { 128 } else { 0 };
        Self {
            scale: scale * numbers.real(0.5, 2.0),
            zero,
            signed,
        }
    }

    fn least(self) -> i32 {
        if self.signed { -128 } else { 0 }
    }
}

/// A model under construction, from one f32 input `x`.
struct Builder {
    graph: GraphProto,
    count: usize,
}

impl Builder {
    /// An input of a graph, f32.
    fn input(name: &str, shape: &[usize]) -> ValueInfoProto {
        let dim = |n: &usize| Dimension {
            value: Some(Value::DimValue(*n as i64)),
            ..Dimension::default()
        };
        let shape = TensorShapeProto {
            dim: shape.iter().map(dim).collect(),
        };
        let tensor = type_proto::Tensor {
            elem_type: DataType::Float as i32,
            shape: Some(shape),
        };
        ValueInfoProto {
            name: name.into(),
            r#type: Some(TypeProto {
                value: Some(type_proto::Value::TensorType(tensor)),
                ..TypeProto::default()
            }),
            ..ValueInfoProto::default()
        }
    }

    fn new(shape: [usize; 3]) -> Self {
        let input = Self::input("x", &[1, shape[0], shape[1], shape[2]]);
        Self {
            graph: GraphProto {
                input: vec![input],
                ..GraphProto::default()
            },
            count: 0,
        }
    }

    fn name(&mut self) -> String {
        self.count += 1;
        format!("t{}", self.count)
    }

    fn constant(&mut self, data_type: DataType, dims: &[usize], raw_data: Vec<u8>) -> String {
        let name = self.name();
        let dims = dims.iter().map(|&d| d as i64).collect();
        let tensor = TensorProto {
            name: name.clone(),
            data_type: data_type as i32,
            dims,
            raw_data,
            ..TensorProto::default()
        };
        self.graph.initializer.push(tensor);
        name
    }

    fn floats(&mut self, dims: &[usize], values: &[f32]) -> String {
        self.constant(
            DataType::Float,
            dims,
            values.iter().flat_map(|v| v.to_le_bytes()).collect(),
        )
    }

    fn node(&mut self, op: &str, inputs: &[&str], attributes: Vec<AttributeProto>) -> String {
        let name = self.name();
        self.graph.node.push(NodeProto {
            op_type: op.into(),
            input: inputs.iter().map(|&i| i.into()).collect(),
            output: vec![name.clone()],
            attribute: attributes,
            ..NodeProto::default()
        });
        name
    }

    fn steps(&mut self, steps: Steps) -> [String; 2] {
        let kind = if steps.signed {
            DataType::Int8
        } else {
            DataType::Uint8
        };
        [
            self.floats(&[], &[steps.scale]),
            self.constant(kind, &[], vec![steps.zero as u8]),
        ]
    }

    fn quantized(&mut self, name: &str, steps: Steps) -> String {
        let [scale, zero] = self.steps(steps);
        let bytes = self.node("QuantizeLinear", &[name, &scale, &zero], vec![]);
        self.node("DequantizeLinear", &[&bytes, &scale, &zero], vec![])
    }

    fn finish(mut self, outputs: &[&str]) -> ModelProto {
        let output = |name: &&str| ValueInfoProto {
            name: (*name).into(),
            ..ValueInfoProto::default()
        };
        self.graph.output = outputs.iter().map(output).collect();
        let opset_import = vec![OperatorSetIdProto {
            version: 17,
            ..OperatorSetIdProto::default()
        }];
        ModelProto {
            graph: Some(self.graph),
            opset_import,
            ir_version: 8,
            ..ModelProto::default()
        }
    }
}

fn ints(name: &str, ints: &[usize]) -> AttributeProto {
    let ints = ints.iter().map(|&i| i as i64).collect();
    AttributeProto {
        name: name.into(),
        ints,
        r#type: AttributeType::Ints as i32,
        ..AttributeProto::default()
    }
}

fn int(name: &str, i: usize) -> AttributeProto {
    AttributeProto {
        name: name.into(),
        i: i as i64,
        r#type: AttributeType::Int as i32,
        ..AttributeProto::default()
    }
}

fn text(name: &str, s: &str) -> AttributeProto {
    let s = s.as_bytes().to_vec();
    AttributeProto {
        name: name.into(),
        s,
        r#type: AttributeType::String as i32,
        ..AttributeProto::default()
    }
}

/// Runs a model; also says how many nodes tract was left with besides islands.
fn run(
    model: &ModelProto,
    engine: Engine,
    shape: [usize; 3],
    input: &[f32],
) -> (Vec<Vec<f32>>, usize) {
    let split = engine.split(model);
    let model = split.as_ref().unwrap_or(model);
    let rest = model
        .graph
        .as_ref()
        .unwrap()
        .node
        .iter()
        .filter(|node| node.op_type != ISLAND)
        .count();
    let mut onnx = tract_onnx::onnx();
    register(&mut onnx);
    let shape = [1, shape[0], shape[1], shape[2]];
    let plan = onnx
        .model_for_proto_model(model)
        .unwrap()
        .with_input_fact(0, f32::fact(shape).into())
        .unwrap()
        .into_optimized()
        .unwrap()
        .into_runnable()
        .unwrap();
    let outputs = plan
        .run(tvec!(
            Tensor::from_shape(&shape, input).unwrap().into_tvalue()
        ))
        .unwrap();
    let floats = |value: &TValue| {
        value
            .try_as_plain_ram()
            .unwrap()
            .as_slice::<f32>()
            .unwrap()
            .to_vec()
    };
    (outputs.iter().map(floats).collect(), rest)
}

fn fastest() -> Engine {
    Engine::Quantized {
        kernel: Kernel::best(),
        threads: 2,
    }
}

fn kernels() -> impl Iterator<Item = Kernel> {
    Kernel::ALL
        .into_iter()
        .filter(|kernel| kernel.is_supported())
}

/// Values that `steps` represents exactly.
fn on_grid(numbers: &mut Numbers, steps: Steps, length: usize) -> Vec<f32> {
    (0..length)
        .map(|_| (numbers.below(256) as i32 + steps.least() - steps.zero) as f32 * steps.scale)
        .collect()
}

/// Holds every kernel's result, and tract's, against real numbers: the nearest step, or either of two where the real
/// number is as good as half way between them.
fn check(
    model: &ModelProto,
    shape: [usize; 3],
    input: &[f32],
    out: Steps,
    real: &[f64],
    case: &str,
) {
    let tract = run(model, Engine::Tract, shape, input).0;
    check_results(&[("tract".to_owned(), tract)], out, real, case);
    check_engine(model, shape, input, out, real, case);
}

/// The same without tract.
fn check_engine(
    model: &ModelProto,
    shape: [usize; 3],
    input: &[f32],
    out: Steps,
    real: &[f64],
    case: &str,
) {
    let mut results = Vec::new();
    for kernel in kernels() {
        for threads in [1, 2] {
            let (outputs, rest) = run(model, Engine::Quantized { kernel, threads }, shape, input);
            assert_eq!(rest, 0, "{case}: the engine left nodes to tract");
            results.push((format!("{kernel:?} on {threads}"), outputs));
        }
    }
    check_results(&results, out, real, case);
}

fn check_results(results: &[(String, Vec<Vec<f32>>)], out: Steps, real: &[f64], case: &str) {
    for (who, outputs) in results {
        assert_eq!(outputs[0].len(), real.len(), "{who}, {case}");
        for (index, (&got, &real)) in outputs[0].iter().zip(real).enumerate() {
            let step = f64::from(got / out.scale).round();
            let least = f64::from(out.least() - out.zero);
            let exact = (real / f64::from(out.scale)).clamp(least, least + 255.0);
            assert!(
                (step - exact).abs() <= 0.5 + 2e-3,
                "{who}, {case}, {index}: {step} steps instead of {exact}"
            );
        }
    }
}

#[test]
fn convolutions_are_the_nearest_step() {
    let mut numbers = Numbers(1);
    for case in 0..60 {
        let kernel = [[1, 1], [3, 3], [3, 3], [5, 5], [2, 3]][numbers.below(5)];
        let stride = numbers.from(1..=2);
        let dilation = if numbers.below(5) == 0 { 2 } else { 1 };
        let (groups, ins, outs) = match numbers.below(3) {
            0 => {
                let channels = numbers.from(2..=150);
                (channels, channels, channels)
            }
            1 => (1, numbers.from(1..=70), numbers.from(1..=150)),
            _ => (2, 2 * numbers.from(1..=9), 2 * numbers.from(1..=20)),
        };
        let pads = [0, 1, 2, 3].map(|axis| numbers.below(kernel[axis % 2]));
        let reach = kernel.map(|k| (k - 1) * dilation + 1);
        let shape = [
            ins,
            reach[0] + numbers.below(6),
            reach[1] + numbers.below(23),
        ];
        let per_group = ins / groups;
        let taps = kernel[0] * kernel[1];
        let steps = Steps::random(&mut numbers, 0.02);
        let out = Steps::random(&mut numbers, 0.01 * ((per_group * taps) as f32).sqrt());
        let mut weights: Vec<i8> = (0..outs * per_group * taps)
            .map(|_| numbers.next() as i8)
            .collect();
        let mut scales: Vec<f32> = (0..outs).map(|_| numbers.real(0.001, 0.01)).collect();
        let mut bias: Vec<i32> = (0..outs)
            .map(|_| numbers.below(4001) as i32 - 2000)
            .collect();
        if case % 4 == 0 {
            // A channel that never fires, as ONNX Runtime's quantizer writes it.
            scales[0] = 1e-9 / steps.scale;
            bias[0] = 200_000 - i32::MAX;
            for weight in &mut weights[..per_group * taps] {
                *weight %= 2;
            }
        }
        let clip = numbers.below(3);

        let mut b = Builder::new(shape);
        let x = b.quantized("x", steps);
        let raw = b.constant(
            DataType::Int8,
            &[outs, per_group, kernel[0], kernel[1]],
            weights.iter().map(|&w| w as u8).collect(),
        );
        let scale = b.floats(&[outs], &scales);
        let zero = b.constant(DataType::Int8, &[outs], vec![0; outs]);
        let w = b.node(
            "DequantizeLinear",
            &[&raw, &scale, &zero],
            vec![int("axis", 0)],
        );
        let units: Vec<f32> = scales.iter().map(|scale| steps.scale * scale).collect();
        let raw = b.constant(
            DataType::Int32,
            &[outs],
            bias.iter().flat_map(|v| v.to_le_bytes()).collect(),
        );
        let scale = b.floats(&[outs], &units);
        let bias_name = b.node("DequantizeLinear", &[&raw, &scale], vec![int("axis", 0)]);
        let attributes = vec![
            ints("kernel_shape", &kernel),
            ints("strides", &[stride, stride]),
            ints("dilations", &[dilation, dilation]),
            ints("pads", &pads),
            int("group", groups),
        ];
        let mut y = b.node("Conv", &[&x, &w, &bias_name], attributes);
        if clip == 1 {
            y = b.node("Relu", &[&y], vec![]);
        } else if clip == 2 {
            let (least, most) = (b.floats(&[], &[-0.1]), b.floats(&[], &[0.2]));
            y = b.node("Clip", &[&y, &least, &most], vec![]);
        }
        let y = b.quantized(&y, out);
        let model = b.finish(&[&y]);

        let input = on_grid(&mut numbers, steps, shape.iter().product());
        let size = [0, 1]
            .map(|axis| (shape[axis + 1] + pads[axis] + pads[axis + 2] - reach[axis]) / stride + 1);
        let mut real = Vec::new();
        for o in 0..outs {
            let first = o / (outs / groups) * per_group;
            for y in 0..size[0] {
                for x in 0..size[1] {
                    let mut sum = f64::from(bias[o]) * f64::from(units[o]);
                    for c in 0..per_group {
                        for tap in 0..taps {
                            let row =
                                (y * stride + tap / kernel[1] * dilation).wrapping_sub(pads[0]);
                            let column =
                                (x * stride + tap % kernel[1] * dilation).wrapping_sub(pads[1]);
                            if row < shape[1] && column < shape[2] {
                                let value =
                                    input[((first + c) * shape[1] + row) * shape[2] + column];
                                let weight = f64::from(weights[(o * per_group + c) * taps + tap])
                                    * f64::from(scales[o]);
                                sum += f64::from(value) * weight;
                            }
                        }
                    }
                    real.push(match clip {
                        0 => sum,
                        1 => sum.max(0.0),
                        _ => sum.clamp(f64::from(-0.1f32), f64::from(0.2f32)),
                    });
                }
            }
        }
        // Bounds fall on a step or between two; the step nearest to the bound is what both chains give.
        check(
            &model,
            shape,
            &input,
            out,
            &real,
            &format!("case {case}: {ins}->{outs} {kernel:?} /{stride} g{groups}"),
        );
    }
}

#[test]
fn sums_products_concatenations_and_functions_are_the_nearest_step() {
    let mut numbers = Numbers(2);
    for case in 0..40 {
        let shape = [
            numbers.from(5..=40),
            numbers.from(1..=4),
            numbers.from(1..=40),
        ];
        let length: usize = shape.iter().product();
        let (one, other) = (
            Steps::random(&mut numbers, 0.02),
            Steps::random(&mut numbers, 0.02),
        );
        // tract refuses a function from one type of byte to the other.
        let out = Steps {
            signed: one.signed,
            zero: one.zero,
            ..Steps::random(&mut numbers, 0.04)
        };
        let mut b = Builder::new(shape);
        let x = b.quantized("x", one);
        let z = b.quantized(&x, other);
        let operations = [
            "Add",
            "Mul",
            "Concat",
            "Sigmoid",
            "LeakyRelu",
            "HardSwish",
            "Relu",
        ];
        let operation = operations[case % operations.len()];
        let y = match operation {
            "Add" | "Mul" => b.node(operation, &[&x, &z], vec![]),
            "Concat" => b.node(operation, &[&x, &z, &x], vec![int("axis", 1)]),
            _ => b.node(operation, &[&x], vec![]),
        };
        let y = b.quantized(&y, out);
        let model = b.finish(&[&y]);
        let input = on_grid(&mut numbers, one, length);
        let first: Vec<f64> = input.iter().map(|&v| f64::from(v)).collect();
        let second: Vec<f64> = input
            .iter()
            .map(|v| {
                let step = (v / other.scale).round_ties_even() as i32 + other.zero;
                f64::from(
                    (step.clamp(other.least(), other.least() + 255) - other.zero) as f32
                        * other.scale,
                )
            })
            .collect();
        let both = first.iter().zip(&second);
        let real: Vec<f64> = match operation {
            "Add" => both.map(|(a, b)| a + b).collect(),
            "Mul" => both.map(|(a, b)| a * b).collect(),
            "Concat" => [&first[..], &second, &first].concat(),
            "Sigmoid" => first.iter().map(|v| 1.0 / (1.0 + (-v).exp())).collect(),
            "LeakyRelu" => first
                .iter()
                .map(|v| if *v < 0.0 { 0.01 * v } else { *v })
                .collect(),
            "HardSwish" => first
                .iter()
                .map(|v| v * (v / 6.0 + 0.5).clamp(0.0, 1.0))
                .collect(),
            _ => first.iter().map(|v| v.max(0.0)).collect(),
        };
        check(
            &model,
            shape,
            &input,
            out,
            &real,
            &format!("{operation} {case}"),
        );
    }
}

#[test]
fn resizes_and_pools_are_the_nearest_step() {
    let mut numbers = Numbers(3);
    for case in 0..48 {
        let shape = [
            numbers.from(5..=40),
            numbers.from(3..=9),
            numbers.from(3..=11),
        ];
        let [channels, height, width] = shape;
        let from = Steps::random(&mut numbers, 0.02);
        let out = if numbers.below(2) == 0 {
            from
        } else {
            Steps::random(&mut numbers, 0.02)
        };
        let input = on_grid(&mut numbers, from, shape.iter().product());
        let at = |c: usize, y: usize, x: usize| f64::from(input[(c * height + y) * width + x]);
        let mut b = Builder::new(shape);
        let x = b.quantized("x", from);
        let mut real = Vec::new();
        let operation = [
            "nearest",
            "half_pixel",
            "align_corners",
            "MaxPool",
            "AveragePool",
            "GlobalAveragePool",
        ][case % 6];
        let y = match operation {
            "nearest" | "half_pixel" | "align_corners" => {
                let scales = b.floats(&[4], &[1.0, 1.0, 2.0, 2.0]);
                let (mode, coordinates) = if operation == "nearest" {
                    ("nearest", "asymmetric")
                } else {
                    ("linear", operation)
                };
                let attributes = vec![
                    text("mode", mode),
                    text("coordinate_transformation_mode", coordinates),
                    text("nearest_mode", "floor"),
                ];
                let source = |at: usize, length: usize| {
                    let at = at as f64;
                    match operation {
                        "nearest" => (at / 2.0).floor(),
                        "half_pixel" => ((at + 0.5) / 2.0 - 0.5).clamp(0.0, length as f64 - 1.0),
                        _ => at * (length as f64 - 1.0) / (2.0 * length as f64 - 1.0),
                    }
                };
                for c in 0..channels {
                    for y in 0..2 * height {
                        for x in 0..2 * width {
                            let (v, u) = (source(y, height), source(x, width));
                            let (top, left) = (v as usize, u as usize);
                            let (bottom, right) =
                                ((top + 1).min(height - 1), (left + 1).min(width - 1));
                            let (v, u) = (v - top as f64, u - left as f64);
                            let row = |y: usize| at(c, y, left) * (1.0 - u) + at(c, y, right) * u;
                            real.push(row(top) * (1.0 - v) + row(bottom) * v);
                        }
                    }
                }
                b.node("Resize", &[&x, "", &scales], attributes)
            }
            "GlobalAveragePool" => {
                let area = (height * width) as f64;
                real.extend((0..channels).map(|c| {
                    (0..height * width)
                        .map(|i| at(c, i / width, i % width))
                        .sum::<f64>()
                        / area
                }));
                b.node(operation, &[&x], vec![])
            }
            _ => {
                let padded = numbers.below(2);
                let size = [height, width].map(|length| (length + 1 - 3) / 2 + 1);
                for c in 0..channels {
                    for (y, x) in (0..size[0]).flat_map(|y| (0..size[1]).map(move |x| (y, x))) {
                        let taps = (0..9).map(|tap| {
                            (
                                (2 * y + tap / 3).wrapping_sub(1),
                                (2 * x + tap % 3).wrapping_sub(1),
                            )
                        });
                        let values: Vec<f64> = taps
                            .filter(|&(y, x)| y < height && x < width)
                            .map(|(y, x)| at(c, y, x))
                            .collect();
                        let count = if padded == 1 {
                            9.0
                        } else {
                            values.len() as f64
                        };
                        real.push(match operation {
                            "MaxPool" => values.iter().copied().fold(f64::MIN, f64::max),
                            _ => values.iter().sum::<f64>() / count,
                        });
                    }
                }
                let mut attributes = vec![
                    ints("kernel_shape", &[3, 3]),
                    ints("strides", &[2, 2]),
                    ints("pads", &[1, 1, 0, 0]),
                ];
                if operation == "AveragePool" {
                    attributes.push(int("count_include_pad", padded));
                }
                b.node(operation, &[&x], attributes)
            }
        };
        let y = b.quantized(&y, out);
        check(
            &b.finish(&[&y]),
            shape,
            &input,
            out,
            &real,
            &format!("{operation} {case}"),
        );
    }
}

/// Also where the processor's own conversions differ: NaN, infinities, and what does not fit an integer.
#[test]
fn every_kernel_quantizes_any_real_as_the_definition_says() {
    let mut reals = vec![
        f32::NAN,
        f32::INFINITY,
        f32::NEG_INFINITY,
        f32::MAX,
        f32::MIN,
    ];
    reals.extend([f32::MIN_POSITIVE, -0.0, 3e9, -3e9, 0.05, -0.05, 0.15, 0.25]);
    reals.extend((-300..300).map(|half| half as f32 / 2.0 * 0.1));
    for kernel in kernels() {
        for zero in [0, 77, 255] {
            let quantization = Quantization { scale: 0.1, zero };
            let backwards: Vec<f32> = reals.iter().rev().copied().collect();
            let mut bytes = vec![1; 4 * reals.len()];
            kernel.quantize_four(&[&reals, &backwards, &reals], 0.1, zero, &mut bytes);
            for (pixel, (&real, &other)) in bytes.chunks(4).zip(reals.iter().zip(&backwards)) {
                let [real_byte, other_byte] = [real, other].map(|v| quantization.byte(v));
                let expected = [real_byte, other_byte, real_byte, zero];
                assert_eq!(pixel, expected, "{kernel:?}, {real}, {other}, {zero}");
            }
        }
    }
}

/// Heads: outputs that leave as f32, few or not, from pixels of any channels, in rows of any length.
#[test]
fn few_outputs_are_the_sums_that_they_should_be() {
    let mut numbers = Numbers(11);
    // Rows of three pixels beside each other, of strides and dilations, of four bytes.
    for (outputs, run, step, pixels) in [
        (1, 48, 16, 40),
        (2, 48, 16, 16),
        (3, 48, 16, 19),
        (4, 48, 16, 33),
        (5, 48, 16, 20),
        (2, 48, 16, 7),
        (2, 96, 32, 21),
        (1, 144, 48, 16),
        (3, 12, 4, 30),
        (2, 16, 4, 18),
        (3, 16, 32, 17),
        (4, 48, 32, 25),
        (1, 96, 64, 31),
        (13, 48, 16, 35),
        (30, 60, 20, 13),
        (45, 60, 20, 22),
    ] {
        let row_bytes = (pixels - 1) * step + run;
        let input: Vec<u8> = (0..3 * row_bytes)
            .map(|_| numbers.below(256) as u8)
            .collect();
        let weights: Vec<i8> = (0..outputs * 3 * run)
            .map(|_| (numbers.below(255) as i32 - 127) as i8)
            .collect();
        let starts: Vec<i32> = (0..outputs as i32).map(|o| 1000 * o - 1500).collect();
        let factors: Vec<f32> = (0..outputs).map(|o| 0.125 + o as f32).collect();
        let row = Row {
            input: &input,
            base: 0,
            runs: &[0, row_bytes, 2 * row_bytes],
            step,
            pixels,
        };
        let expected = |output: usize, pixel: usize| {
            let products = (0..3 * run).map(|at| {
                let x = input[at / run * row_bytes + pixel * step + at % run];
                i32::from(x) * i32::from(weights[output * 3 * run + at])
            });
            (products.sum::<i32>() + starts[output]) as f32 * factors[output]
        };
        for kernel in kernels() {
            let dense = Dense::new(kernel, [3, run], &starts, &factors, &weights);
            let few = outputs <= 4 && run % 16 == 0 && pixels >= 16;
            let knows_few = !matches!(kernel, Kernel::Portable | Kernel::Avx2);
            assert_eq!(dense.has_few_outputs(&row), few && knows_few, "{kernel:?}");
            let mut out = vec![f32::NAN; dense.lanes() * pixels];
            kernel.dense_floats(&dense, &row, &mut out);
            for (output, values) in out.chunks_exact(pixels).take(outputs).enumerate() {
                for (pixel, value) in values.iter().enumerate() {
                    assert_eq!(
                        *value,
                        expected(output, pixel),
                        "{kernel:?}, {outputs} outputs, {run} bytes by {step}, output {output}, pixel {pixel}"
                    );
                }
            }
        }
    }
}

/// What clipped layers mostly have, or a zero point, or bounds, or both.
fn to_bytes(numbers: &mut Numbers) -> ToBytes {
    let zero = [0, 77][numbers.below(2)];
    let range = [0..=255, 5..=250][numbers.below(2)].clone();
    ToBytes { zero, range }
}

fn byte_of(real: f32, to: &ToBytes) -> u8 {
    let step = real.round_ties_even() + f32::from(to.zero);
    step.clamp(f32::from(*to.range.start()), f32::from(*to.range.end())) as u8
}

/// Powers of two as factors: products are exact, so that there is one right byte.
fn starts_and_factors(outputs: usize) -> (Vec<i32>, Vec<f32>) {
    let outputs = 0..outputs as i32;
    outputs
        .map(|output| (100 * output - 1500, 0.25_f32.powi(3 + output % 3)))
        .unzip()
}

/// Blocks of 16 outputs go into registers and memory in groups; nothing is written behind the last.
#[test]
fn dense_of_any_outputs_in_rows_of_any_length() {
    let mut numbers = Numbers(13);
    for outputs in [3_usize, 16, 20, 40, 48, 64, 72, 96, 112] {
        // Runs beside each other, or of three pixels, two of them the next output's too.
        for (pixels, taps) in [1_usize, 2, 3, 4, 7, 8, 15, 16, 37]
            .into_iter()
            .flat_map(|pixels| [(pixels, 1), (pixels, 3)])
        {
            let runs = numbers.from(1..=3);
            let step = 4 * numbers.from(1..=9);
            let run = step * taps;
            let row_bytes = (pixels - 1) * step + run;
            let input: Vec<u8> = (0..runs * row_bytes)
                .map(|_| numbers.below(256) as u8)
                .collect();
            let mut weights: Vec<i8> = (0..outputs * runs * run)
                .map(|_| (numbers.below(255) as i32 - 127) as i8)
                .collect();
            // Blocks without weights, which kernels may leave out: none, some, most, all.
            let share = numbers.below(7).saturating_sub(3);
            for output in (0..outputs).step_by(16) {
                for byte in (0..runs * run).step_by(4) {
                    if numbers.below(3) < share {
                        for output in output..outputs.min(output + 16) {
                            weights[output * runs * run + byte..][..4].fill(0);
                        }
                    }
                }
            }
            let weight = |output, number, byte| weights[(output * runs + number) * run + byte];
            let places: Vec<_> = (0..runs).map(|number| number * row_bytes).collect();
            let (starts, factors) = starts_and_factors(outputs);
            let row = Row {
                input: &input,
                base: 0,
                runs: &places,
                step,
                pixels,
            };
            let to = to_bytes(&mut numbers);
            let expected = |output: usize, pixel: usize| {
                let products = (0..runs * run).map(|at| {
                    let (number, byte) = (at / run, at % run);
                    let input = input[number * row_bytes + pixel * step + byte];
                    i32::from(input) * i32::from(weight(output, number, byte))
                });
                byte_of(
                    (products.sum::<i32>() + starts[output]) as f32 * factors[output],
                    &to,
                )
            };
            for kernel in kernels() {
                let dense = Dense::new(kernel, [runs, run], &starts, &factors, &weights);
                let pitch = dense.lanes();
                let mut out = vec![199; pitch * pixels + 64];
                kernel.dense_bytes(&dense, &row, &to, &mut out[..pitch * pixels], pitch);
                assert_eq!(
                    out[pitch * pixels..],
                    [199; 64],
                    "{kernel:?}, {outputs} outputs"
                );
                for (pixel, bytes) in out.chunks_exact(pitch).take(pixels).enumerate() {
                    for (output, byte) in bytes.iter().take(outputs).enumerate() {
                        assert_eq!(
                            *byte,
                            expected(output, pixel),
                            "{kernel:?}, {outputs} outputs, {pixels} pixels, output {output}, pixel {pixel}"
                        );
                    }
                }
            }
        }
    }
}

/// Four blocks of outputs for eight times four bytes: with how many of the 32 blocks of weights zero, how many are multiplied.
#[test]
fn blocks_of_zeros_take_no_multiplication_where_that_pays() {
    let (starts, factors) = starts_and_factors(64);
    for kernel in kernels() {
        let multiplied = |zeros: usize| {
            let weight = |at: usize| {
                let (output, byte) = (at / 32, at % 32);
                i8::from(output / 16 * 8 + byte / 4 >= zeros && (output + byte).is_multiple_of(3))
            };
            let weights: Vec<i8> = (0..64 * 32).map(weight).collect();
            Dense::new(kernel, [1, 32], &starts, &factors, &weights).blocks_of_weights()
        };
        let [few, many, all] = [6, 7, 32].map(multiplied);
        let expected = match kernel {
            // Where blocks share what is loaded, one that is alone loads more.
            Kernel::Avx512Vnni => [32, 25, 0],
            Kernel::Avx2 | Kernel::AvxVnni | Kernel::Portable => [26, 25, 0],
            Kernel::NeonDotprod => [32; 3],
            Kernel::NeonI8mm => [16; 3],
            Kernel::Neon => [8; 3],
        };
        assert_eq!([few, many, all], expected, "{kernel:?}");
    }
}

/// Kernels take 64 channels at a time; of what is left over, or is all there is, several pixels at once.
#[test]
fn depthwise_of_any_channels_in_rows_of_any_length() {
    let mut numbers = Numbers(12);
    for (channels, pitch) in [
        (3_usize, 16_usize),
        (16, 16),
        (20, 32),
        (32, 32),
        (40, 48),
        (48, 48),
        (64, 64),
        (80, 80),
        (96, 96),
        (112, 112),
        (144, 144),
        (144, 192),
    ] {
        let sides = [(3, 1), (3, 2), (5, 1), (5, 2)];
        let pixels = [1_usize, 2, 3, 4, 7, 8, 9, 15, 16, 37];
        for ((side, stride), pixels) in sides.into_iter().flat_map(|s| pixels.map(|p| (s, p))) {
            let row_bytes = pitch * ((pixels - 1) * stride + side);
            let input: Vec<u8> = (0..side * row_bytes)
                .map(|_| numbers.below(256) as u8)
                .collect();
            let filters: Vec<i8> = (0..channels * side * side)
                .map(|_| (numbers.below(255) as i32 - 127) as i8)
                .collect();
            let (starts, factors) = starts_and_factors(channels);
            let runs: Vec<usize> = (0..side * side)
                .map(|tap| tap / side * row_bytes + tap % side * pitch)
                .collect();
            let row = Row {
                input: &input,
                base: 0,
                runs: &runs,
                step: stride * pitch,
                pixels,
            };
            let to = to_bytes(&mut numbers);
            let expected = |channel: usize, pixel: usize| {
                let products = (0..side * side).map(|tap| {
                    let x = input[runs[tap] + pixel * stride * pitch + channel];
                    i32::from(x) * i32::from(filters[channel * side * side + tap])
                });
                let sum = (products.sum::<i32>() + starts[channel]) as f32;
                byte_of(sum * factors[channel], &to)
            };
            for kernel in kernels() {
                let depthwise =
                    Depthwise::new(kernel, pitch, [side; 2], &filters, &starts, &factors);
                let mut out = vec![0; pitch * pixels];
                kernel.depthwise(&depthwise, &row, &to, &mut out);
                for (pixel, bytes) in out.chunks_exact(pitch).enumerate() {
                    for (channel, byte) in bytes.iter().take(channels).enumerate() {
                        assert_eq!(
                            *byte,
                            expected(channel, pixel),
                            "{kernel:?}, {channels} channels, {side}x{side} / {stride}, {pixels} pixels, \
                             channel {channel}, pixel {pixel}"
                        );
                    }
                }
            }
        }
    }
}

/// What the engine does not know stays with tract, and bytes get past it from one island to the next.
#[test]
fn an_unknown_operator_parts_two_islands() {
    let mut numbers = Numbers(4);
    let shape = [20, 3, 7];
    let steps = Steps {
        scale: 0.02,
        zero: 100,
        signed: false,
    };
    let mut b = Builder::new(shape);
    let x = b.quantized("x", steps);
    let x = b.node("Sigmoid", &[&x], vec![]);
    let x = b.quantized(&x, steps);
    let outside = b.node("Floor", &[&x], vec![]);
    let outside = b.quantized(&outside, steps);
    let sum = b.node("Add", &[&x, &outside], vec![]);
    let sum = b.quantized(&sum, steps);
    let model = b.finish(&[&sum]);
    let split = fastest().split(&model).unwrap();
    let operators: Vec<&str> = split
        .graph
        .as_ref()
        .unwrap()
        .node
        .iter()
        .map(|n| n.op_type.as_str())
        .collect();
    assert_eq!(operators, ["Floor", ISLAND, ISLAND]);

    let input = on_grid(&mut numbers, steps, shape.iter().product());
    let (ours, _) = run(&model, fastest(), shape, &input);
    let (tracts, _) = run(&model, Engine::Tract, shape, &input);
    let same = ours[0]
        .iter()
        .zip(&tracts[0])
        .filter(|(a, b)| (*a - *b).abs() < 1e-4)
        .count();
    assert_eq!(same, ours[0].len());
}

/// Each of these once made a graph that tract refused, so that tract ran all of it: a tensor within a layer that is an output, too; an island that
/// does nothing but quantize for the next; a convolution that sees padding alone at its border.
#[test]
fn tensors_of_two_readers_and_wide_padding_cost_no_more_than_they_must() {
    let shape = [2, 5, 7];
    const STEPS: Steps = Steps {
        scale: 0.02,
        zero: 100,
        signed: false,
    };
    let inside = |b: &mut Builder| {
        let x = b.quantized("x", STEPS);
        let within = b.node("HardSigmoid", &[&x], vec![]);
        let y = b.quantized(&within, STEPS);
        [y, within]
    };
    let quantizes = |b: &mut Builder| {
        let x = b.quantized("x", STEPS);
        let y = b.node("Floor", &[&x], vec![]);
        let y = b.node("Elu", &[&y], vec![]);
        let y = b.quantized(&y, STEPS);
        let both = b.node("Concat", &[&y, &x], vec![int("axis", 1)]);
        let both = b.quantized(&both, STEPS);
        [both, y]
    };
    let pads = |b: &mut Builder| {
        let x = b.quantized("x", STEPS);
        let x = b.node("Sigmoid", &[&x], vec![]);
        let x = b.quantized(&x, STEPS);
        let weights = b.floats(&[2, 2, 1, 1], &[0.5, -0.25, 0.125, 0.5]);
        let weights = b.quantized(&weights, STEPS);
        let y = b.node(
            "Conv",
            &[&x, &weights],
            vec![ints("kernel_shape", &[1, 1]), ints("pads", &[1, 1, 1, 1])],
        );
        let y = b.quantized(&y, STEPS);
        let z = b.node("Sigmoid", &[&y], vec![]);
        [b.quantized(&z, STEPS), x]
    };
    let graphs: [fn(&mut Builder) -> [String; 2]; 3] = [inside, quantizes, pads];
    let mut numbers = Numbers(6);
    let input = on_grid(&mut numbers, STEPS, shape.iter().product());
    for (case, graph) in graphs.iter().enumerate() {
        let mut b = Builder::new(shape);
        let outputs = graph(&mut b);
        let model = b.finish(&[&outputs[0], &outputs[1]]);
        let split = fastest().split(&model).unwrap();
        let nodes = &split.graph.as_ref().unwrap().node;
        assert!(nodes.iter().any(|n| n.op_type == ISLAND), "{case}");
        let (ours, _) = run(&model, fastest(), shape, &input);
        let (tracts, _) = run(&model, Engine::Tract, shape, &input);
        for (ours, tracts) in ours.iter().zip(&tracts) {
            let steps_off = |(a, b): (&f32, &f32)| (a - b).abs() / STEPS.scale;
            let most = ours.iter().zip(tracts).map(steps_off).fold(0.0, f32::max);
            assert!(most < 1.01, "{case}: {most} steps");
        }
    }
}

/// Where the exact place is half way between two pixels, which f32 may miss, the one that ONNX Runtime 1.31 takes.
#[test]
fn nearest_pixels_at_ties_are_onnx_runtimes() {
    let resize = |coordinates, nearest, outputs| Resize {
        target: Target::Sizes([1, outputs]),
        coordinates,
        nearest,
        linear: false,
    };
    for (coordinates, nearest, [from, to], at, expected) in [
        (
            Coordinates::PytorchHalfPixel,
            Nearest::RoundPreferFloor,
            [20, 26],
            19,
            14,
        ),
        (
            Coordinates::HalfPixel,
            Nearest::RoundPreferFloor,
            [20, 26],
            19,
            14,
        ),
        (
            Coordinates::HalfPixel,
            Nearest::RoundPreferCeil,
            [20, 26],
            19,
            15,
        ),
        (
            Coordinates::Asymmetric,
            Nearest::RoundPreferCeil,
            [7, 2],
            1,
            4,
        ),
        (
            Coordinates::Asymmetric,
            Nearest::RoundPreferFloor,
            [7, 2],
            1,
            3,
        ),
    ] {
        let places = resize(coordinates, nearest, to).axis(1, [1, from]);
        assert_eq!(
            places[at].first, expected,
            "{coordinates:?}, {nearest:?}, {from} to {to}"
        );
    }
}

/// What follows tensors back to bytes needs no more stack for longer ways.
#[test]
fn a_long_chain_of_shared_functions_fits_a_small_stack() {
    let mut b = Builder::new([1, 2, 2]);
    let mut outputs = Vec::new();
    let mut x = b.node("Floor", &["x"], vec![]);
    for _ in 0..1500 {
        outputs.push(b.node("Floor", &[&x], vec![]));
        x = b.node("Neg", &[&x], vec![]);
    }
    outputs.push(b.quantized(
        &x,
        Steps {
            scale: 0.1,
            zero: 100,
            signed: false,
        },
    ));
    let model = b.finish(&outputs.iter().map(String::as_str).collect::<Vec<_>>());
    let split = std::thread::Builder::new()
        .stack_size(256 << 10)
        .spawn(move || fastest().split(&model).is_none());
    assert!(split.unwrap().join().unwrap());
}

/// Bytes without a zero point are what `output_dtype` says (opset 21), on either side of what the engine does not know, and in weights that
/// the graph quantizes; with the engine and without.
#[test]
fn signed_bytes_without_a_zero_point_stay_signed() {
    let shape @ [channels, height, width] = [2, 3, 7];
    let signed = || vec![int("output_dtype", DataType::Int8 as usize)];
    let quantized = |b: &mut Builder, name: &str, scale: f32| {
        let scale = b.floats(&[], &[scale]);
        let bytes = b.node("QuantizeLinear", &[name, &scale], signed());
        b.node("DequantizeLinear", &[&bytes, &scale], vec![])
    };
    let mut numbers = Numbers(5);
    let steps = Steps {
        scale: 0.02,
        zero: 0,
        signed: true,
    };
    let input = on_grid(&mut numbers, steps, shape.iter().product());

    let mut b = Builder::new(shape);
    let x = quantized(&mut b, "x", 0.02);
    let x = b.node("Neg", &[&x], vec![]);
    let x = quantized(&mut b, &x, 0.02);
    let outside = b.node("Floor", &[&x], vec![]);
    let outside = b.quantized(&outside, steps);
    let sum = b.node("Add", &[&x, &outside], vec![]);
    let sum = b.quantized(&sum, steps);
    let mut model = b.finish(&[&sum]);
    to_qdq(&mut model);
    for engine in [fastest(), Engine::Tract] {
        let (made, _) = run(&model, engine, shape, &input);
        for (x, made) in input.iter().zip(&made[0]) {
            let real = (-x).clamp(-2.56, 2.54);
            let real = (real + real.floor().clamp(-2.56, 2.54)).clamp(-2.56, 2.54);
            assert!((real - made).abs() < 0.011, "{x}: {made} instead of {real}");
        }
    }

    let mut b = Builder::new(shape);
    let x = b.quantized("x", steps);
    let weights = b.floats(&[1, channels, 1, 1], &[-0.5, 0.25]);
    let weights = quantized(&mut b, &weights, 0.01);
    let y = b.node("Conv", &[&x, &weights], vec![ints("kernel_shape", &[1, 1])]);
    let y = b.quantized(&y, steps);
    let area = height * width;
    let real: Vec<f64> = (0..area)
        .map(|i| -0.5 * f64::from(input[i]) + 0.25 * f64::from(input[i + area]))
        .collect();
    let mut model = b.finish(&[&y]);
    to_qdq(&mut model);
    check_engine(&model, shape, &input, steps, &real, "weights");

    // What QLinear operators give is of their operands' type. (Their zero points may be left out, in bytes that are moved as well.)
    let mut b = Builder::new(shape);
    let scale = b.floats(&[], &[0.02]);
    let twice = b.floats(&[], &[0.04]);
    let bytes = b.node("QuantizeLinear", &["x", &scale], signed());
    let bytes = b.node("MaxPool", &[&bytes], vec![ints("kernel_shape", &[1, 1])]);
    let sum = b.node(
        "QLinearAdd",
        &[&bytes, &scale, "", &bytes, &scale, "", &twice],
        vec![],
    );
    let sum = b.node("DequantizeLinear", &[&sum, &twice], vec![]);
    let mut model = b.finish(&[&sum]);
    to_qdq(&mut model);
    for engine in [fastest(), Engine::Tract] {
        let (made, _) = run(&model, engine, shape, &input);
        for (x, made) in input.iter().zip(&made[0]) {
            assert!((2.0 * x - made).abs() < 1e-5, "{x}: {made}");
        }
    }
}

const EMBEDDED: &str = concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/../fixtures/models/adaptive-int8.onnx"
);

/// The embedded model's file, and the same with every other block of weights (16 outputs, 4 inputs) zero, which kernels may leave out.
fn dense_and_sparse() -> [Vec<u8>; 2] {
    let dense = std::fs::read(EMBEDDED).unwrap();
    let proto = tract_onnx::onnx()
        .proto_model_for_read(&mut dense.as_slice())
        .unwrap();
    let mut sparse = dense.clone();
    let mut numbers = Numbers(21);
    for tensor in &proto.graph.as_ref().unwrap().initializer {
        let &[outputs, inputs, rows, columns] = tensor.dims.as_slice() else {
            continue;
        };
        let [outputs, inputs, taps] = [outputs, inputs, rows * columns].map(|n| n as usize);
        if inputs < 16 || outputs < 16 {
            continue;
        }
        let weights = tensor.raw_data.as_slice();
        let start = dense.windows(weights.len()).position(|at| at == weights);
        let weights = &mut sparse[start.unwrap()..][..weights.len()];
        for first in (0..outputs).step_by(16) {
            for four in (0..inputs).step_by(4) {
                for tap in 0..taps {
                    if numbers.below(2) == 0 {
                        continue;
                    }
                    for output in first..outputs.min(first + 16) {
                        for input in four..inputs.min(four + 4) {
                            weights[(output * inputs + input) * taps + tap] = 0;
                        }
                    }
                }
            }
        }
    }
    [dense, sparse]
}

/// A model's heads for a smooth input.
fn heads(model: &[u8], engine: Engine, size: (u32, u32)) -> Vec<Vec<f32>> {
    let model = Model::from_bytes(EMBEDDED.as_ref(), model)
        .unwrap()
        .with_engine(engine);
    let mut network = Network::new(&model, size, &["residual", "attention", "slope"]).unwrap();
    let (width, height) = (size.0 as usize, size.1 as usize);
    let wave = |index: usize| {
        let (x, y) = (index % width, index / width);
        (x as f32 / 9.0).sin() + (y as f32 / 13.0).cos()
    };
    let planes: Vec<f32> = (0..4 * width * height).map(wave).collect();
    network
        .fill_input(|entrance| entrance.write_planes(&planes))
        .unwrap();
    network.run().unwrap();
    let (outputs, _) = network.outputs();
    (0..3)
        .map(|head| outputs.head(head).unwrap().0.to_vec())
        .collect()
}

#[test]
fn every_kernel_and_number_of_threads_gives_the_same_bytes() {
    for (model, which) in dense_and_sparse().iter().zip(["dense", "sparse"]) {
        // Of the smaller one the deepest layers have one pixel, less than any tile.
        for size in [(160, 96), (32, 32)] {
            let heads = |kernel, threads| heads(model, Engine::Quantized { kernel, threads }, size);
            let reference = heads(Kernel::Portable, 1);
            for kernel in kernels() {
                for threads in 1..=3 {
                    assert!(
                        heads(kernel, threads) == reference,
                        "{which} {size:?} {kernel:?} {threads}"
                    );
                }
            }
        }
    }
}

#[test]
fn the_embedded_model_is_one_island() {
    let bytes = std::fs::read(EMBEDDED).unwrap();
    let model = tract_onnx::onnx()
        .proto_model_for_read(&mut bytes.as_slice())
        .unwrap();
    let split = fastest().split(&model).unwrap();
    let operators: Vec<&str> = split
        .graph
        .as_ref()
        .unwrap()
        .node
        .iter()
        .map(|n| n.op_type.as_str())
        .collect();
    assert_eq!(operators, [ISLAND]);
}

/// The system's allocator, with a count of what each thread asked it for.
struct Counting;

thread_local! {
    static ALLOCATIONS: std::cell::Cell<usize> = const { std::cell::Cell::new(0) };
}

// SAFETY: every call goes to the system's allocator, unchanged.
unsafe impl std::alloc::GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: std::alloc::Layout) -> *mut u8 {
        // A thread that ends allocates too, when its count is gone.
        let _ = ALLOCATIONS.try_with(|count| count.set(count.get() + 1));
        // SAFETY: the caller's promises are passed on.
        unsafe { std::alloc::System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: std::alloc::Layout) {
        // SAFETY: the caller's promises are passed on.
        unsafe { std::alloc::System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static COUNTING: Counting = Counting;

#[test]
fn a_run_allocates_nothing() {
    // Each member of a team does the same on its own rows; here this thread does all of them.
    for kernel in kernels() {
        let engine = Engine::Quantized { kernel, threads: 1 };
        let model = Model::embedded().unwrap().with_engine(engine);
        let mut network = Network::new(&model, (96, 64), &["residual"]).unwrap();
        let before = ALLOCATIONS.get();
        for _ in 0..3 {
            network.run().unwrap();
            network.outputs().0.head(0).unwrap();
        }
        assert_eq!(ALLOCATIONS.get() - before, 0, "{kernel:?}");
    }
}
