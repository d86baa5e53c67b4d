//! A graph with its names looked up: who makes a tensor, who reads it, which are constant, how many dimensions they have.

use std::collections::{HashMap, HashSet};

use tract_onnx::data_resolver::MmapDataResolver;
use tract_onnx::pb::{
    AttributeProto, GraphProto, NodeProto, TensorProto, ValueInfoProto, type_proto,
};
use tract_onnx::prelude::*;

/// An attribute of a node.
pub(crate) fn attribute<'a>(node: &'a NodeProto, name: &str) -> Option<&'a AttributeProto> {
    node.attribute.iter().find(|a| a.name == name)
}

pub(crate) fn integer(node: &NodeProto, name: &str, default: i64) -> i64 {
    attribute(node, name).map_or(default, |a| a.i)
}

pub(crate) fn text<'a>(node: &'a NodeProto, name: &str, default: &'a str) -> Option<&'a str> {
    attribute(node, name).map_or(Some(default), |a| std::str::from_utf8(&a.s).ok())
}

pub(crate) fn float(node: &NodeProto, name: &str, default: f32) -> f32 {
    attribute(node, name).map_or(default, |a| a.f)
}

/// `N` numbers, none negative.
pub(super) fn sizes<const N: usize>(
    node: &NodeProto,
    name: &str,
    default: [usize; N],
) -> Option<[usize; N]> {
    match attribute(node, name) {
        None => Some(default),
        Some(a) => {
            let sizes: Option<Vec<usize>> =
                a.ints.iter().map(|&i| usize::try_from(i).ok()).collect();
            sizes?.try_into().ok()
        }
    }
}

/// An input of a node that is there.
pub(crate) fn input(node: &NodeProto, number: usize) -> Option<&String> {
    node.input.get(number).filter(|name| !name.is_empty())
}

/// Outputs have as many dimensions as the first input.
const KEEP_RANK: &[&str] = &[
    "AveragePool",
    "BatchNormalization",
    "Cast",
    "Ceil",
    "Clip",
    "Conv",
    "ConvTranspose",
    "Cos",
    "CumSum",
    "DepthToSpace",
    "DequantizeLinear",
    "Dropout",
    "Floor",
    "GatherElements",
    "GlobalAveragePool",
    "GlobalMaxPool",
    "GridSample",
    "GroupNormalization",
    "Identity",
    "InstanceNormalization",
    "LayerNormalization",
    "LogSoftmax",
    "LRN",
    "MaxPool",
    "Not",
    "Pad",
    "QuantizeLinear",
    "Resize",
    "Round",
    "ScatterElements",
    "ScatterND",
    "Sign",
    "Sin",
    "Slice",
    "Softmax",
    "SpaceToDepth",
    "Split",
    "Tile",
    "Transpose",
    "Upsample",
];

/// Outputs have as many dimensions as the input that has most.
const BROADCAST: &[&str] = &[
    "And",
    "Concat",
    "Equal",
    "Greater",
    "GreaterOrEqual",
    "Less",
    "LessOrEqual",
    "MatMul",
    "Mean",
    "Mod",
    "Or",
    "Sum",
    "Where",
    "Xor",
];

/// A graph with its names looked up.
pub(crate) struct Reader<'a> {
    pub(super) graph: &'a GraphProto,
    made_by: HashMap<&'a str, usize>,
    read_by: HashMap<&'a str, Vec<usize>>,
    constants: HashMap<&'a str, &'a TensorProto>,
    outputs: HashSet<&'a str>,
    ranks: HashMap<&'a str, usize>,
    /// Whether elementwise operators are layers whatever they read.
    pub(super) takes_all: bool,
}

impl<'a> Reader<'a> {
    pub(crate) fn new(graph: &'a GraphProto) -> Self {
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
        let mut reader = Self {
            graph,
            made_by,
            read_by,
            constants,
            outputs,
            ranks: HashMap::new(),
            takes_all: false,
        };
        reader.find_ranks();
        reader
    }

    fn find_ranks(&mut self) {
        let graph = self.graph;
        for value in graph.input.iter().chain(&graph.value_info) {
            if let Some(rank) = stated_rank(value) {
                self.ranks.insert(&value.name, rank);
            }
        }
        for (name, tensor) in &self.constants {
            self.ranks.insert(name, tensor.dims.len());
        }
        for node in &graph.node {
            let Some(rank) = self.rank_made_by(node) else {
                continue;
            };
            for output in &node.output {
                self.ranks.entry(output).or_insert(rank);
            }
        }
    }

    fn rank_made_by(&self, node: &NodeProto) -> Option<usize> {
        let ranks: Vec<Option<usize>> = node.input.iter().map(|name| self.rank(name)).collect();
        let first = ranks.first().copied().flatten();
        match node.op_type.as_str() {
            "Flatten" | "Gemm" => Some(2),
            "Reshape" => self.length(input(node, 1)?),
            "Shape" => Some(1),
            "ConstantOfShape" => self.length(input(node, 0)?),
            "Expand" => Some(first?.max(self.length(input(node, 1)?)?)),
            op if op.starts_with("Reduce") || op.starts_with("Arg") => {
                first.filter(|_| integer(node, "keepdims", 1) != 0)
            }
            "Gather" => (first? + ranks.get(1).copied().flatten()?).checked_sub(1),
            "Squeeze" => first?.checked_sub(self.axes(node)?.len()),
            "Unsqueeze" => Some(first? + self.axes(node)?.len()),
            op if super::function::is_function(op) || KEEP_RANK.contains(&op) => first,
            op if super::function::is_binary(op) || BROADCAST.contains(&op) => ranks
                .into_iter()
                .collect::<Option<Vec<_>>>()?
                .into_iter()
                .max(),
            _ => None,
        }
    }

    /// How many sizes a list of sizes has.
    fn length(&self, name: &str) -> Option<usize> {
        match self.maker(name) {
            Some((_, node)) if node.op_type == "Shape" && node.attribute.is_empty() => {
                self.rank(input(node, 0)?)
            }
            _ => Some(self.integers(name)?.0.len()),
        }
    }

    /// Axes of a Squeeze, Unsqueeze or reduction, as an attribute or as an input.
    pub(crate) fn axes(&self, node: &NodeProto) -> Option<Vec<i64>> {
        match attribute(node, "axes") {
            Some(axes) => Some(axes.ints.clone()),
            None => Some(self.integers(input(node, 1)?)?.0),
        }
    }

    /// How many dimensions a tensor has, where that can be told.
    pub(crate) fn rank(&self, name: &str) -> Option<usize> {
        self.ranks.get(name).copied()
    }

    pub(crate) fn readers(&self, name: &str) -> &[usize] {
        self.read_by.get(name).map_or(&[], Vec::as_slice)
    }

    pub(crate) fn maker(&self, name: &str) -> Option<(usize, &'a NodeProto)> {
        self.made_by
            .get(name)
            .map(|&index| (index, &self.graph.node[index]))
    }

    /// The nodes that make these tensors.
    pub(super) fn makers<'b>(
        &'b self,
        names: impl IntoIterator<Item = &'b String>,
    ) -> impl Iterator<Item = usize> {
        names
            .into_iter()
            .filter_map(|name| self.made_by.get(name.as_str()).copied())
    }

    pub(crate) fn is_output(&self, name: &str) -> bool {
        self.outputs.contains(name)
    }

    /// Exactly one node reads it, and it is no output of the graph.
    pub(crate) fn is_private(&self, name: &str) -> bool {
        self.readers(name).len() == 1 && !self.is_output(name)
    }

    pub(crate) fn is_constant(&self, name: &str) -> bool {
        self.constants.contains_key(name)
    }

    pub(super) fn constant(&self, name: &str) -> Option<Tensor> {
        let proto = *self.constants.get(name)?;
        // Weights in other files stay with tract.
        if proto.data_location.is_some_and(|location| location != 0) {
            return None;
        }
        tract_onnx::tensor::load_tensor(&MmapDataResolver, proto, None).ok()
    }

    /// The shape of a constant.
    pub(crate) fn shape(&self, name: &str) -> Option<Vec<usize>> {
        Some(self.constant(name)?.shape().to_vec())
    }

    /// The element type of a constant.
    pub(crate) fn constant_type(&self, name: &str) -> Option<i32> {
        Some(self.constants.get(name)?.data_type)
    }

    pub(crate) fn floats(&self, name: &str) -> Option<Vec<f32>> {
        let tensor = self.constant(name)?;
        let plain = tensor.try_as_plain_ram().ok()?;
        Some(plain.as_slice::<f32>().ok()?.to_vec())
    }

    /// Integers of any type, their shape and their type.
    pub(crate) fn integers(&self, name: &str) -> Option<(Vec<i64>, Vec<usize>, DatumType)> {
        let tensor = self.constant(name)?;
        let shape = tensor.shape().to_vec();
        let plain = tensor.try_as_plain_ram().ok()?;
        fn wide<T: Copy + Into<i64>>(values: &[T]) -> Vec<i64> {
            values.iter().map(|&value| value.into()).collect()
        }
        let values = match tensor.datum_type() {
            DatumType::U8 => wide(plain.as_slice::<u8>().ok()?),
            DatumType::I8 => wide(plain.as_slice::<i8>().ok()?),
            DatumType::I32 => wide(plain.as_slice::<i32>().ok()?),
            DatumType::I64 => plain.as_slice::<i64>().ok()?.to_vec(),
            _ => return None,
        };
        Some((values, shape, tensor.datum_type()))
    }
}

/// The number of dimensions that the file itself states.
fn stated_rank(value: &ValueInfoProto) -> Option<usize> {
    match value.r#type.as_ref()?.value.as_ref()? {
        type_proto::Value::TensorType(tensor) => Some(tensor.shape.as_ref()?.dim.len()),
        #[allow(unreachable_patterns, reason = "tract's protobuf knows tensors only")]
        _ => None,
    }
}

#[cfg(test)]
#[allow(clippy::expect_used)]
mod tests {
    use tract_onnx::pb::tensor_proto::DataType;
    use tract_onnx::pb::{TensorShapeProto, TypeProto, tensor_shape_proto::Dimension};

    use super::*;

    /// Graphs whose tools left out the shapes between nodes.
    #[test]
    fn ranks_follow_from_the_nodes() {
        let input = ValueInfoProto {
            name: "x".to_owned(),
            r#type: Some(TypeProto {
                value: Some(type_proto::Value::TensorType(type_proto::Tensor {
                    elem_type: DataType::Float as i32,
                    shape: Some(TensorShapeProto {
                        dim: vec![Dimension::default(); 4],
                    }),
                })),
                ..Default::default()
            }),
            ..Default::default()
        };
        let list = |name: &str, numbers: &[i64], dims: &[i64]| TensorProto {
            name: name.to_owned(),
            dims: dims.to_vec(),
            data_type: DataType::Int64 as i32,
            int64_data: numbers.to_vec(),
            ..Default::default()
        };
        let nodes = [
            ("Gather", &["x", "two"][..], "channels", Some(4)),
            ("Gather", &["x", "one"], "channel", Some(3)),
            ("Slice", &["x"], "part", Some(4)),
            ("Shape", &["part"], "shape", Some(1)),
            ("ConstantOfShape", &["shape"], "zeros", Some(4)),
            ("Greater", &["part", "one"], "nearer", Some(4)),
            ("Where", &["nearer", "zeros", "one"], "chosen", Some(4)),
            ("Expand", &["one", "two"], "wide", Some(2)),
            ("Reshape", &["x", "two"], "flat", Some(2)),
            ("ReduceMax", &["chosen"], "greatest", Some(4)),
            // More axes than there are: the file is wrong, and nothing is known.
            ("Squeeze", &["one", "two"], "less", None),
            ("NoSuchOperator", &["x"], "what", None),
        ];
        let node = |&(op, inputs, output, _): &(&str, &[&str], &str, Option<usize>)| NodeProto {
            op_type: op.to_owned(),
            input: inputs.iter().map(|&name| name.to_owned()).collect(),
            output: vec![output.to_owned()],
            ..Default::default()
        };
        let graph = GraphProto {
            input: vec![input],
            initializer: vec![list("one", &[0], &[]), list("two", &[0, 2], &[2])],
            node: nodes.iter().map(node).collect(),
            ..Default::default()
        };
        let reader = Reader::new(&graph);
        for (op, _, output, rank) in nodes {
            assert_eq!(reader.rank(output), rank, "{op}");
        }
    }
}
