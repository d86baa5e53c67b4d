//! Finds layers in an ONNX graph: QDQ as ONNX Runtime's, PyTorch's and TensorRT's tools write it.
//!
//! A layer is what stands between DequantizeLinear and QuantizeLinear, a layer with weights that leaves as f32, or what
//! goes element by element between such. What is not recognized is not an error: it stays where it is, with the reason, and
//! [`super::island`] leaves it to tract.

use std::borrow::Cow;
use std::collections::{HashMap, HashSet};
use std::fmt;
use std::ops::RangeInclusive;

use tract_onnx::pb::GraphProto;

use super::layer::{Form, Layer, Operand, Operation, Quantization};

mod constants;
pub(crate) mod convolution;
mod function;
pub(crate) mod graph;
mod window;

use graph::{Reader, input, integer};

/// Why something is not run by the engine; what it is about stands elsewhere.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Reason(Cow<'static, str>);

impl From<&'static str> for Reason {
    fn from(reason: &'static str) -> Self {
        Self(reason.into())
    }
}

impl From<String> for Reason {
    fn from(reason: String) -> Self {
        Self(reason.into())
    }
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

pub(crate) type Found<T> = Result<T, Reason>;

/// A layer and the nodes that it stands for.
#[derive(Debug)]
pub(crate) struct Recognized {
    pub(crate) layer: Layer,
    /// What has to become of its input first, as a layer of its own.
    pub(crate) first: Option<Layer>,
    /// Its nodes, constants' included, in the graph's order. The last is the one that makes the output.
    pub(crate) nodes: Vec<usize>,
}

impl Recognized {
    fn new(layer: Layer, mut nodes: Vec<usize>) -> Self {
        nodes.sort_unstable();
        nodes.dedup();
        Self {
            layer,
            first: None,
            nodes,
        }
    }

    /// What it reads of the graph.
    pub(crate) fn inputs(&self) -> &[Operand] {
        &self.first.as_ref().unwrap_or(&self.layer).inputs
    }
}

/// What there is for the engine in a graph.
#[derive(Debug)]
pub(crate) struct Survey {
    /// The layers, in the graph's order. Every byte tensor that one of them reads is written by another.
    pub(crate) layers: Vec<Recognized>,
    /// Why nodes that might have been layers are none.
    pub(crate) reasons: HashMap<usize, Reason>,
}

/// What the engine can do with a graph, and why not more. `all`: it is an island's body, of which nothing may be left.
pub(crate) fn survey(graph: &GraphProto, all: bool) -> Survey {
    let mut reader = Reader::new(graph);
    reader.takes_all = all;
    let mut reasons = HashMap::new();
    let mut found: Vec<Recognized> = Vec::new();
    for (index, node) in graph.node.iter().enumerate() {
        if node.op_type == "QuantizeLinear"
            && !input(node, 0).is_some_and(|name| reader.is_constant(name))
        {
            match reader.bytes_layer(index, &mut reasons) {
                Ok(layer) => found.push(layer),
                Err(reason) => _ = reasons.insert(index, reason),
            }
        }
    }
    let absorbed: HashSet<usize> = found.iter().flat_map(|f| f.nodes.iter().copied()).collect();
    for (index, node) in graph.node.iter().enumerate() {
        if convolution::has_weights(&node.op_type) && !absorbed.contains(&index) {
            match reader.floats_layer(index) {
                Ok(layer) => found.push(layer),
                Err(reason) => _ = reasons.insert(index, reason),
            }
        }
    }
    reader.add_shared_expressions(&mut found, &mut reasons);
    keep_connected(&mut found, all);
    reader.add_exits(&mut found);
    found.sort_by_key(|f| f.nodes.last().copied());
    Survey {
        layers: found,
        reasons,
    }
}

/// Takes out layers that read bytes from elsewhere, and those that only prepare for layers that are not there; but of an island's body
/// (`all`), which may have them for another island.
fn keep_connected(found: &mut Vec<Recognized>, all: bool) {
    loop {
        let before = found.len();
        let made: HashSet<String> = found.iter().map(|f| f.layer.output.clone()).collect();
        found.retain(|f| {
            let inside =
                |input: &Operand| input.quantization.is_none() || made.contains(&input.name);
            f.inputs().iter().all(inside)
        });
        let read: HashSet<String> = found
            .iter()
            .flat_map(|f| f.inputs().iter().map(|input| input.name.clone()))
            .collect();
        found.retain(|f| {
            let prepares = matches!(
                (&f.layer.operation, &f.layer.form),
                (Operation::Quantize, _) | (Operation::Elementwise(_), Form::Floats)
            );
            all || !prepares || read.contains(&f.layer.output)
        });
        if found.len() == before {
            return;
        }
    }
}

impl<'a> Reader<'a> {
    /// Tensors have four dimensions, or two, and all of a layer's as many.
    fn check_ranks<'b>(&self, names: impl IntoIterator<Item = &'b str>) -> Found<()> {
        let mut ranks = names.into_iter().map(|name| match self.rank(name) {
            Some(rank @ (2 | 4)) => Ok(rank),
            Some(rank) => Err(Reason::from(format!(
                "`{name}` has {rank} dimensions, not 4 or 2"
            ))),
            None => Err(format!("nothing says how many dimensions `{name}` has").into()),
        });
        let first = ranks.next().unwrap_or(Ok(4))?;
        for rank in ranks {
            if rank? != first {
                return Err("its inputs have different numbers of dimensions".into());
            }
        }
        Ok(())
    }

    /// The layer that ends in a QuantizeLinear. Why what stands before it is none goes to `reasons`.
    fn bytes_layer(&self, index: usize, reasons: &mut HashMap<usize, Reason>) -> Found<Recognized> {
        let node = &self.graph.node[index];
        let quantization = self.quantization(node)?;
        let float = input(node, 0).ok_or("it has no input")?;
        let output = node.output.first().ok_or("it has no output")?;
        self.check_ranks([float.as_str()])?;
        for &reader in self.readers(output) {
            let reader = &self.graph.node[reader];
            if reader.op_type != "DequantizeLinear" {
                return Err(format!("its bytes are read by a {}", reader.op_type).into());
            }
            self.quantization(reader)?;
        }
        if self.is_output(output) {
            return Err("its bytes leave the model".into());
        }
        let whole = 0..=255;
        let recognized = |operation, inputs, range, mut nodes: Vec<usize>| {
            nodes.push(index);
            let form = Form::Bytes {
                quantization,
                range,
            };
            let layer = Layer {
                operation,
                inputs,
                output: output.clone(),
                form,
            };
            Recognized::new(layer, nodes)
        };
        // A function of one byte is a table, whoever else reads what is in it.
        if let Ok(gathered) = self.expression(float, false)
            && let [operand] = &gathered.inputs[..]
            && let Some(from) = operand.quantization
            && gathered.expression.channels() == Ok(1)
            // A constant may add dimensions.
            && self.rank(&operand.name).is_none_or(|rank| Some(rank) == self.rank(float))
        {
            let table = gathered.expression.table(from, quantization);
            return Ok(recognized(
                Operation::Table(table),
                gathered.inputs,
                whole,
                gathered.nodes,
            ));
        }
        // Somebody else reads it as f32, or quantizes it otherwise: it is made in f32, for all of them.
        if self.is_private(float) {
            let (reason, maker) = match self.operation_behind(float, quantization) {
                Ok(Behind {
                    operation,
                    inputs,
                    first,
                    range,
                    nodes,
                }) => {
                    let layer = recognized(operation, inputs, range, nodes);
                    return Ok(Recognized { first, ..layer });
                }
                Err(unfit) => unfit,
            };
            match self.expression(float, true) {
                Ok(gathered)
                    if self.is_elementwise(float)
                        && (self.belongs(&gathered) || gathered.expression.is_clip()) =>
                {
                    let inputs = gathered.inputs.iter().map(|i| i.name.as_str());
                    match self.check_ranks(inputs.chain([float.as_str()])) {
                        Ok(()) => {
                            let operation = Operation::Elementwise(gathered.expression);
                            return Ok(recognized(
                                operation,
                                gathered.inputs,
                                whole,
                                gathered.nodes,
                            ));
                        }
                        Err(reason) => _ = reasons.insert(maker.unwrap_or(index), reason),
                    }
                }
                Err(reason) if self.is_elementwise(float) => {
                    reasons.insert(maker.unwrap_or(index), reason);
                }
                _ => {
                    if let Some(maker) = maker {
                        reasons.insert(maker, reason);
                    }
                }
            }
        }
        let operand = Operand {
            name: float.clone(),
            quantization: None,
        };
        Ok(recognized(
            Operation::Quantize,
            vec![operand],
            whole,
            Vec::new(),
        ))
    }

    /// The operation that makes `name`, behind ReLU and Clip; or why there is none, and the node that this is about.
    fn operation_behind(
        &self,
        name: &'a str,
        quantization: Quantization,
    ) -> Result<Behind, (Reason, Option<usize>)> {
        let mut nodes = Vec::new();
        let maker = |name: &str| self.maker(name).map(|(index, _)| index);
        let (name, range) = self
            .clamps(name, quantization, &mut nodes)
            .map_err(|reason| (reason, maker(name)))?;
        let (index, _) = self.maker(name).ok_or(("no node makes it".into(), None))?;
        let form = Form::Bytes {
            quantization,
            range: range.clone(),
        };
        let (operation, inputs, first) = self
            .operation(index, &form, &mut nodes)
            .map_err(|reason| (reason, Some(index)))?;
        Ok(Behind {
            operation,
            inputs,
            first,
            range,
            nodes,
        })
    }

    /// The name in front of ReLU and Clip, and what they leave of the bytes.
    fn clamps(
        &self,
        name: &'a str,
        quantization: Quantization,
        nodes: &mut Vec<usize>,
    ) -> Found<(&'a str, RangeInclusive<u8>)> {
        let mut name = name;
        let (mut low, mut high) = (0, 255);
        while let Some((index, node)) = self.maker(name)
            && let Some([least, most]) = self.bounds(node)?
        {
            // Later bounds were met first: Clip(Clip(x)).
            (low, high) = (
                quantization.byte(least).clamp(low, high),
                quantization.byte(most).clamp(low, high),
            );
            nodes.push(index);
            nodes.extend(self.makers(node.input.iter().skip(1)));
            name = input(node, 0).ok_or("it has no input")?;
            if !self.is_private(name) {
                return Err("others read its input too".into());
            }
        }
        Ok((name, low..=high))
    }

    /// What a node computes from bytes: the operation, its inputs, and what has to become of them first.
    fn operation(
        &self,
        index: usize,
        form: &Form,
        nodes: &mut Vec<usize>,
    ) -> Found<(Operation, Vec<Operand>, Option<Layer>)> {
        let node = &self.graph.node[index];
        nodes.push(index);
        let operand = |number: usize| {
            let name = input(node, number).ok_or("an input is missing")?;
            self.operand(name)
                .unwrap_or_else(|| Err(format!("its input `{name}` is not quantized").into()))
        };
        let first = |operation: Operation| -> Found<_> { Ok((operation, vec![operand(0)?], None)) };
        let (operation, inputs, first) = match node.op_type.as_str() {
            op if convolution::has_weights(op) => {
                let weighted = self.weighted(node, form, nodes)?;
                let operation = Operation::Convolution(weighted.convolution);
                (operation, vec![weighted.input], weighted.first)
            }
            "Add" => (Operation::Add, vec![operand(0)?, operand(1)?], None),
            "Mul" => (Operation::Multiply, vec![operand(0)?, operand(1)?], None),
            "Concat" => {
                let rank = node.output.first().and_then(|output| self.rank(output));
                let axis = integer(node, "axis", 0);
                if axis != 1 && rank.is_none_or(|rank| axis + rank as i64 != 1) {
                    return Err(format!("it joins along axis {axis}, not channels").into());
                }
                let inputs = (0..node.input.len()).map(operand).collect::<Found<_>>()?;
                (Operation::Concat, inputs, None)
            }
            "Resize" => first(Operation::Resize(self.resize(node, nodes)?))?,
            "Pad" => first(Operation::Pad(self.pad(node, nodes)?))?,
            "DepthToSpace" => first(Operation::DepthToSpace(window::depth_to_space(node)?))?,
            "MaxPool" => first(Operation::MaxPool(window::pool(node)?))?,
            "AveragePool" => {
                let counts_padding = integer(node, "count_include_pad", 0) != 0;
                first(Operation::AveragePool(window::pool(node)?, counts_padding))?
            }
            "GlobalAveragePool" => first(Operation::GlobalAveragePool)?,
            "Flatten" | "Reshape" | "Squeeze" | "Unsqueeze" => {
                nodes.extend(self.makers(node.input.iter().skip(1)));
                self.check_flattens(node)?;
                first(Operation::Flatten)?
            }
            op if function::is_function(op) || function::is_binary(op) => {
                return Err("it reads nothing that the engine makes".into());
            }
            op => return Err(format!("the engine has no {op}").into()),
        };
        let reads = first.as_ref().map_or(&inputs, |first| &first.inputs);
        self.check_ranks(reads.iter().map(|input| input.name.as_str()))?;
        Ok((operation, inputs, first))
    }

    /// Whether a change of shape puts channels, rows and columns in one row: `[1, n]` or `[1, n, 1, 1]`.
    pub(crate) fn check_flattens(&self, node: &tract_onnx::pb::NodeProto) -> Found<()> {
        let flattens = match node.op_type.as_str() {
            "Flatten" => integer(node, "axis", 1) == 1,
            "Reshape" => {
                let name = input(node, 1).ok_or("it has no shape")?;
                let shape = self.integers(name).ok_or("its shape is not constant")?.0;
                let plain = integer(node, "allowzero", 0) == 0;
                plain && matches!(shape[..], [0 | 1, -1 | 1..] | [0 | 1, -1 | 1.., 1, 1])
            }
            // What is taken away or put in has length 1.
            _ => {
                let mut axes = self.axes(node).ok_or("its axes are not constant")?;
                axes.sort_unstable();
                matches!(axes[..], [2, 3] | [-2, -1])
            }
        };
        if flattens {
            Ok(())
        } else {
            Err("it shapes otherwise than to [1, channels] or [1, channels, 1, 1]".into())
        }
    }

    /// A layer with weights whose result leaves as f32.
    fn floats_layer(&self, index: usize) -> Found<Recognized> {
        let name = self.graph.node[index]
            .output
            .first()
            .ok_or("it has no output")?;
        let mut nodes = Vec::new();
        let form = Form::Floats;
        let (operation, inputs, first) = self.operation(index, &form, &mut nodes)?;
        let operation = match operation {
            Operation::Convolution(convolution) => Operation::Convolution(convolution.into_dense()),
            other => other,
        };
        let layer = Layer {
            operation,
            inputs,
            output: name.clone(),
            form,
        };
        Ok(Recognized {
            first,
            ..Recognized::new(layer, nodes)
        })
    }

    /// Adds the expressions whose f32 results several layers read, and those that these read in turn.
    fn add_shared_expressions(
        &self,
        found: &mut Vec<Recognized>,
        reasons: &mut HashMap<usize, Reason>,
    ) {
        let mut made: HashSet<String> = found.iter().map(|f| f.layer.output.clone()).collect();
        let floats = |f: &Recognized| -> Vec<String> {
            let floats = f
                .inputs()
                .iter()
                .filter(|input| input.quantization.is_none());
            floats.map(|input| input.name.clone()).collect()
        };
        let mut wanted: Vec<String> = found.iter().flat_map(floats).collect();
        while let Some(name) = wanted.pop() {
            let Some((index, node)) = self
                .maker(&name)
                .filter(|_| self.is_elementwise(&name) && !made.contains(&name))
            else {
                continue;
            };
            let gathered = node
                .output
                .first()
                .ok_or_else(|| "it has no output".into())
                .and_then(|name| self.expression(name, true))
                .and_then(|gathered| {
                    let inputs = gathered.inputs.iter().map(|i| i.name.as_str());
                    self.check_ranks(inputs.chain([name.as_str()]))?;
                    if self.belongs(&gathered) {
                        Ok(gathered)
                    } else {
                        Err("it reads nothing that the engine makes".into())
                    }
                });
            match gathered {
                Ok(gathered) => {
                    let layer = Layer {
                        operation: Operation::Elementwise(gathered.expression),
                        inputs: gathered.inputs,
                        output: name.clone(),
                        form: Form::Floats,
                    };
                    let layer = Recognized::new(layer, gathered.nodes);
                    wanted.extend(floats(&layer));
                    made.insert(name);
                    found.push(layer);
                }
                Err(reason) => _ = reasons.insert(index, reason),
            }
        }
    }

    /// Adds what turns bytes into the f32 that somebody outside reads.
    fn add_exits(&self, found: &mut Vec<Recognized>) {
        let made: HashSet<String> = found.iter().map(|f| f.layer.output.clone()).collect();
        let replaced: HashSet<usize> = found
            .iter()
            .filter_map(|f| f.nodes.last().copied())
            .collect();
        let enters = |f: &Recognized| -> Vec<String> {
            let names = f.inputs().iter().map(|input| &input.name);
            names
                .filter(|name| !made.contains(*name))
                .cloned()
                .collect()
        };
        // Backwards from all that is read outside, past nodes that stay there.
        let mut open: Vec<String> = self.graph.output.iter().map(|o| o.name.clone()).collect();
        open.extend(found.iter().flat_map(enters));
        let mut seen = HashSet::new();
        while let Some(name) = open.pop() {
            let Some((index, node)) = self
                .maker(&name)
                .filter(|(index, _)| !replaced.contains(index) && seen.insert(*index))
            else {
                continue;
            };
            match input(node, 0).filter(|bytes| made.contains(*bytes)) {
                Some(bytes) if node.op_type == "DequantizeLinear" => {
                    let Ok(quantization) = self.quantization(node) else {
                        continue;
                    };
                    let layer = Layer {
                        operation: Operation::Dequantize,
                        inputs: vec![Operand {
                            name: bytes.clone(),
                            quantization: Some(quantization),
                        }],
                        output: name,
                        form: Form::Floats,
                    };
                    found.push(Recognized::new(layer, vec![index]));
                }
                _ => open.extend(node.input.iter().cloned()),
            }
        }
    }
}

/// An operation and what stands between it and QuantizeLinear.
struct Behind {
    operation: Operation,
    inputs: Vec<Operand>,
    first: Option<Layer>,
    range: RangeInclusive<u8>,
    nodes: Vec<usize>,
}
