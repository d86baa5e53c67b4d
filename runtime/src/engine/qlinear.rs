//! QLinear operators, ONNX's and those that ONNX Runtime adds, rewritten as what they mean: DequantizeLinear, the operator
//! itself, QuantizeLinear. After that everyone who reads the model sees QDQ only, and tract loads it. Signed bytes without a zero point get
//! one, which tells their type: opset 21 has it in an attribute, which tract does not read.
//!
//! So are operators that move bytes about without a change of scale (MaxPool, Reshape, ...) where QLinear operators meet
//! them; a linear Resize then rounds to the nearest step, where ONNX's own for bytes cuts off. What has parameters that are
//! not constant stays as it is.

use std::collections::{HashMap, HashSet};

use tract_onnx::pb::tensor_proto::DataType;
use tract_onnx::pb::{AttributeProto, GraphProto, ModelProto, NodeProto, TensorProto};

use super::recognize::graph::{Reader, float, input, integer, text};

/// Operators that take bytes and give them back in other places.
const MOVES: &[&str] = &[
    "DepthToSpace",
    "Flatten",
    "MaxPool",
    "Pad",
    "Reshape",
    "Resize",
    "Slice",
    "Squeeze",
    "Transpose",
    "Unsqueeze",
];

/// The attribute of QuantizeLinear that says the type of bytes without a zero point.
const TYPE: &str = "output_dtype";

/// Rewrites a model's QLinear operators, and gives signed bytes zero points.
pub(crate) fn to_qdq(model: &mut ModelProto) {
    if let Some(graph) = model.graph.as_mut() {
        rewrite(graph);
        say_zero_points(graph);
    }
}

fn rewrite(graph: &mut GraphProto) {
    let is_qlinear =
        |node: &NodeProto| node.op_type.starts_with("QLinear") || node.op_type == "QGemm";
    if !graph.node.iter().any(is_qlinear) {
        return;
    }
    let reader = Reader::new(graph);
    let mut rewriting = Rewriting {
        reader: &reader,
        nodes: Vec::new(),
        constants: Vec::new(),
        quantizations: HashMap::new(),
    };
    for node in &graph.node {
        if rewriting.rewrite(node).is_none() {
            if node.op_type == "QuantizeLinear"
                && let (Some(output), Some(scale)) = (node.output.first(), input(node, 1))
            {
                let quantization = Quantization {
                    scale: scale.clone(),
                    zero: input(node, 2).cloned().unwrap_or_default(),
                    signed: makes_signed(&reader, node),
                };
                rewriting.quantizations.insert(output.clone(), quantization);
            }
            rewriting.nodes.push(node.clone());
        }
    }
    let Rewriting {
        nodes, constants, ..
    } = rewriting;
    graph.node = nodes;
    graph.initializer.extend(constants);
}

struct Rewriting<'a> {
    reader: &'a Reader<'a>,
    nodes: Vec<NodeProto>,
    constants: Vec<TensorProto>,
    /// Of byte tensors, by name.
    quantizations: HashMap<String, Quantization>,
}

#[derive(Clone)]
struct Quantization {
    scale: String,
    /// Empty: none, which is 0.
    zero: String,
    signed: bool,
}

/// Whether a QuantizeLinear makes signed bytes.
fn makes_signed(reader: &Reader<'_>, node: &NodeProto) -> bool {
    let kind = match input(node, 2) {
        Some(zero) => reader.constant_type(zero).map(i64::from),
        None => Some(integer(node, TYPE, 0)),
    };
    kind == Some(DataType::Int8 as i64)
}

/// Gives signed bytes that have no zero point one of 0.
fn say_zero_points(graph: &mut GraphProto) {
    let reader = Reader::new(graph);
    let mut signed: HashSet<&str> = HashSet::new();
    // The nodes that get one, by place, and the zero points by name.
    let (mut nodes, mut zeros) = (Vec::new(), HashMap::new());
    for (place, node) in graph.node.iter().enumerate() {
        let reads_signed = input(node, 0).is_some_and(|bytes| signed.contains(bytes.as_str()));
        let is_signed = match node.op_type.as_str() {
            "QuantizeLinear" => makes_signed(&reader, node),
            "DequantizeLinear" => reads_signed,
            op => {
                if reads_signed && MOVES.contains(&op) {
                    signed.extend(node.output.iter().map(String::as_str));
                }
                continue;
            }
        };
        if !is_signed {
            continue;
        }
        if node.op_type == "QuantizeLinear" {
            signed.extend(node.output.iter().map(String::as_str));
        }
        if input(node, 2).is_none()
            && let Some(scale) = input(node, 1)
            && let Some(shape) = reader.shape(scale)
        {
            let zero = format!("signed zero point of {scale}");
            zeros.entry(zero.clone()).or_insert(shape);
            nodes.push((place, zero));
        }
    }
    for (place, zero) in nodes {
        let node = &mut graph.node[place];
        node.attribute.retain(|a| a.name != TYPE);
        node.input.resize(2, String::new());
        node.input.push(zero);
    }
    graph
        .initializer
        .extend(zeros.into_iter().map(|(name, shape)| TensorProto {
            name,
            data_type: DataType::Int8 as i32,
            raw_data: vec![0; shape.iter().product()],
            dims: shape.into_iter().map(|size| size as i64).collect(),
            ..TensorProto::default()
        }));
}

impl Rewriting<'_> {
    /// Puts what `node` means in its place; `None`: it stays.
    fn rewrite(&mut self, node: &NodeProto) -> Option<()> {
        // Where each operand's tensor is among the inputs, followed by scale and zero point, and the output's scale.
        let (operator, operands, output) = match node.op_type.as_str() {
            "QLinearConv" => ("Conv", vec![0, 3], 6),
            "QLinearMatMul" => ("MatMul", vec![0, 3], 6),
            "QGemm" => ("Gemm", vec![0, 3], 7),
            "QLinearAdd" => ("Add", vec![0, 3], 6),
            "QLinearMul" => ("Mul", vec![0, 3], 6),
            "QLinearConcat" => ("Concat", (2..node.input.len()).step_by(3).collect(), 0),
            "QLinearSigmoid" => ("Sigmoid", vec![0], 3),
            "QLinearLeakyRelu" => ("LeakyRelu", vec![0], 3),
            "QLinearAveragePool" => ("AveragePool", vec![0], 3),
            "QLinearGlobalAveragePool" => ("GlobalAveragePool", vec![0], 3),
            op if MOVES.contains(&op) => return self.rewrite_move(node),
            _ => return None,
        };
        if integer(node, "channels_last", 0) != 0
            || float(node, "alpha", 1.0) != 1.0 && operator == "Gemm"
        {
            return None;
        }
        let transposed = integer(node, "transB", 0) != 0;
        let mut operator = NodeProto {
            name: node.name.clone(),
            op_type: operator.to_owned(),
            attribute: node.attribute.clone(),
            ..NodeProto::default()
        };
        operator.attribute.retain(|a| a.name != "channels_last");
        let bias = match node.op_type.as_str() {
            "QLinearConv" => input(node, 8),
            "QGemm" => input(node, 6),
            _ => None,
        };
        // First all that may fail.
        let [scale, zero] = [output, output + 1].map(|at| input(node, at).cloned());
        let result = node.output.first()?;
        let bias_scale = match bias {
            None => None,
            Some(_) => {
                let [one, other] = [1, 4].map(|at| self.reader.floats(input(node, at)?));
                let (one, other) = (*one?.first()?, other?);
                Some(
                    other
                        .into_iter()
                        .map(|other| one * other)
                        .collect::<Vec<f32>>(),
                )
            }
        };
        // The output is of the first operand's type.
        let mut signed = false;
        for (number, &at) in operands.iter().enumerate() {
            let [tensor, scale] = [at, at + 1].map(|at| input(node, at).cloned());
            let zero = input(node, at + 2).cloned();
            if number == 0 {
                signed = self.is_signed(tensor.as_deref()?, zero.as_deref());
            }
            // Of weights, the axis of the outputs.
            let axis = match (number, operator.op_type.as_str()) {
                (1, "Conv") => 0,
                (1, "Gemm") => i64::from(!transposed),
                _ => 1,
            };
            let name = self.dequantized(&tensor?, scale?, zero, axis, result);
            operator.input.push(name);
        }
        if let (Some(bias), Some(scales)) = (bias, bias_scale) {
            let scale = format!("{bias} scale for {result}");
            self.constants.push(floats(&scale, &scales));
            let name = self.dequantized(bias, scale, None, 0, result);
            operator.input.push(name);
        }
        match scale {
            Some(scale) => {
                let zero = zero.unwrap_or_default();
                let quantization = Quantization {
                    scale,
                    zero,
                    signed,
                };
                self.quantized(operator, result, quantization);
            }
            // QGemm without an output scale gives f32.
            None => {
                operator.output.push(result.clone());
                self.nodes.push(operator);
            }
        }
        Some(())
    }

    fn rewrite_move(&mut self, node: &NodeProto) -> Option<()> {
        let bytes = input(node, 0)?;
        let quantization = self.quantizations.get(bytes)?.clone();
        let Quantization { scale, zero, .. } = &quantization;
        let result = node.output.first()?;
        let mut operator = node.clone();
        operator.output.clear();
        // The value to pad with is a byte.
        if node.op_type == "Pad" && text(node, "mode", "constant") == Some("constant") {
            let number = |name: &String| Some(*self.reader.integers(name)?.0.first()?);
            let zero = if zero.is_empty() { 0 } else { number(zero)? };
            let byte = input(node, 2).map_or(Some(0), number)?;
            let value = (byte - zero) as f32 * *self.reader.floats(scale)?.first()?;
            let name = format!("padding of {result}");
            self.constants.push(floats(&name, &[value]));
            operator
                .input
                .resize(operator.input.len().max(3), String::new());
            operator.input[2] = name;
        }
        let some_zero = Some(zero.clone()).filter(|zero| !zero.is_empty());
        operator.input[0] = self.dequantized(bytes, scale.clone(), some_zero, 1, result);
        self.quantized(operator, result, quantization);
        Some(())
    }

    /// Whether these bytes are signed, with this zero point or none.
    fn is_signed(&self, tensor: &str, zero: Option<&str>) -> bool {
        match zero {
            Some(zero) => self.reader.constant_type(zero) == Some(DataType::Int8 as i32),
            None => self.quantizations.get(tensor).is_some_and(|q| q.signed),
        }
    }

    /// A new DequantizeLinear of `tensor` for the operator that makes `result`; its output's name.
    fn dequantized(
        &mut self,
        tensor: &str,
        scale: String,
        zero: Option<String>,
        axis: i64,
        result: &str,
    ) -> String {
        let name = format!("{tensor} in f32, {} for {result}", self.nodes.len());
        let mut node = NodeProto {
            op_type: "DequantizeLinear".to_owned(),
            input: vec![tensor.to_owned(), scale],
            output: vec![name.clone()],
            ..NodeProto::default()
        };
        node.input.extend(zero);
        if axis != 1 {
            node.attribute.push(number("axis", axis));
        }
        self.nodes.push(node);
        name
    }

    /// `operator`, and a QuantizeLinear of what it gives.
    fn quantized(&mut self, mut operator: NodeProto, result: &str, quantization: Quantization) {
        let real = format!("{result} in f32");
        operator.output.push(real.clone());
        operator.domain.clear();
        self.nodes.push(operator);
        let mut node = NodeProto {
            op_type: "QuantizeLinear".to_owned(),
            input: vec![real, quantization.scale.clone()],
            output: vec![result.to_owned()],
            ..NodeProto::default()
        };
        if !quantization.zero.is_empty() {
            node.input.push(quantization.zero.clone());
        } else if quantization.signed {
            node.attribute.push(number(TYPE, DataType::Int8 as i64));
        }
        self.nodes.push(node);
        self.quantizations.insert(result.to_owned(), quantization);
    }
}

fn number(name: &str, i: i64) -> AttributeProto {
    AttributeProto {
        name: name.to_owned(),
        i,
        r#type: tract_onnx::pb::attribute_proto::AttributeType::Int as i32,
        ..AttributeProto::default()
    }
}

/// One number, or a constant of one axis.
pub(super) fn floats(name: &str, values: &[f32]) -> TensorProto {
    TensorProto {
        name: name.to_owned(),
        data_type: DataType::Float as i32,
        dims: (values.len() != 1)
            .then_some(values.len() as i64)
            .into_iter()
            .collect(),
        raw_data: values
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect(),
        ..TensorProto::default()
    }
}
