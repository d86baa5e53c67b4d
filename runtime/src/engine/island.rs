//! Islands: the layers of a graph, gathered so that each gathering can run in one go.
//!
//! Layers are in one island when the same number of detours through tract lies on their way from the inputs. No way
//! out of an island can then come back into it.

use std::collections::{HashMap, HashSet};

use tract_onnx::pb::tensor_shape_proto::Dimension;
use tract_onnx::pb::{
    AttributeProto, GraphProto, ModelProto, NodeProto, TensorShapeProto, TypeProto, ValueInfoProto,
    type_proto,
};

use super::functions::merge;
use super::layer::{Form, Layer, Operand, Shape};
use super::recognize::graph::Reader;
use super::recognize::{Recognized, Survey, survey};
use super::tidy::tidy;

/// The operator that an island becomes; its attribute [`BODY`] holds the island's graph.
pub(crate) const ISLAND: &str = "GedepthQuantizedIsland";
/// Name of the attribute of an [`ISLAND`] node.
pub(crate) const BODY: &str = "body";

/// Layers that run in one go.
#[derive(Debug)]
pub(crate) struct Island {
    /// Names of the f32 tensors that it reads.
    pub(crate) inputs: Vec<String>,
    /// Names of the f32 tensors that it writes.
    pub(crate) outputs: Vec<String>,
    /// Those of them that have two dimensions, `[1, channels]`, instead of four.
    pub(crate) flat: HashSet<String>,
    /// Each after those that it reads from.
    pub(crate) layers: Vec<Layer>,
}

impl Island {
    /// The island of a graph that [`replace_islands`] made.
    pub(crate) fn from_body(body: &GraphProto) -> Self {
        let names = |values: &[ValueInfoProto]| -> Vec<String> {
            values.iter().map(|value| value.name.clone()).collect()
        };
        let (inputs, outputs) = (names(&body.input), names(&body.output));
        let reader = Reader::new(body);
        let flat = |name: &&String| reader.rank(name) == Some(2);
        Self {
            flat: inputs
                .iter()
                .chain(&outputs)
                .filter(flat)
                .cloned()
                .collect(),
            inputs,
            outputs,
            layers: merge(
                survey(body, true)
                    .layers
                    .into_iter()
                    .flat_map(|found| found.first.into_iter().chain([found.layer]))
                    .collect(),
            ),
        }
    }

    /// Shapes of the tensors that the layers write, by name, given those of the inputs.
    pub(crate) fn shapes(&self, inputs: &[Shape]) -> Result<HashMap<&str, Shape>, String> {
        let mut shapes: HashMap<&str, Shape> = self
            .inputs
            .iter()
            .map(String::as_str)
            .zip(inputs.iter().copied())
            .collect();
        for layer in &self.layers {
            let read = layer.inputs.iter().map(|input| {
                shapes
                    .get(input.name.as_str())
                    .copied()
                    .ok_or_else(|| format!("`{}` is not made", input.name))
            });
            let read: Vec<Shape> = read.collect::<Result<_, _>>()?;
            let shape = layer
                .shape(&read)
                .map_err(|reason| format!("`{}`: {reason}", layer.output))?;
            shapes.insert(&layer.output, shape);
        }
        Ok(shapes)
    }
}

/// A graph made ready for the engine, and which of its nodes go where.
#[derive(Debug)]
pub(crate) struct Division {
    /// The graph, rewritten ([`tidy`]) without a change of meaning.
    pub(crate) graph: GraphProto,
    /// The layers in it, and why other nodes are none.
    pub(crate) survey: Survey,
    /// The number of each layer's island.
    pub(crate) levels: Vec<usize>,
}

/// Divides a model between the engine and tract; `None` where it cannot be.
pub(crate) fn divide(model: &ModelProto) -> Option<Division> {
    let graph = model.graph.as_ref()?;
    // Graphs within graphs read names that no node's inputs show.
    if graph
        .node
        .iter()
        .flat_map(|node| &node.attribute)
        .any(|a| a.g.is_some() || !a.graphs.is_empty())
    {
        return None;
    }
    let graph = tidy(model, graph);
    let mut survey = survey(&graph, false);
    if survey.layers.iter().all(|f| f.layer.operation.is_border()) {
        survey.layers.clear();
    }
    let levels = levels(&graph, &survey.layers);
    Some(Division {
        graph,
        survey,
        levels,
    })
}

/// The model with each island as one node; `None` where there is none.
pub(crate) fn replace_islands(model: &ModelProto) -> Option<ModelProto> {
    let Division {
        mut graph,
        survey: Survey { layers: found, .. },
        levels,
    } = divide(model)?;
    // What else they stood for goes with the sweep, unless somebody else reads it too.
    let replaced: HashSet<usize> = found
        .iter()
        .filter_map(|f| f.nodes.last().copied())
        .collect();
    let outside = outside(&graph, &found, &replaced);
    let islands: Vec<NodeProto> = (0..=levels.iter().copied().max()?)
        .filter(|level| levels.contains(level))
        .map(|level| island_node(&graph, &found, &levels, level, &outside))
        .collect();
    let mut index = 0;
    graph.node.retain(|_| {
        index += 1;
        !replaced.contains(&(index - 1))
    });
    graph.node.extend(islands);
    sweep(&mut graph);
    Some(ModelProto {
        graph: Some(graph),
        ..model.clone()
    })
}

/// The nodes that stay with tract; some of a layer's own may, too, where what they make is read outside.
fn outside(graph: &GraphProto, found: &[Recognized], replaced: &HashSet<usize>) -> HashSet<usize> {
    let reader = Reader::new(graph);
    let floats = found.iter().flat_map(Recognized::inputs);
    let mut open: Vec<&str> = floats
        .filter(|input| input.quantization.is_none())
        .map(|input| input.name.as_str())
        .chain(graph.output.iter().map(|output| output.name.as_str()))
        .collect();
    let mut outside = HashSet::new();
    while let Some(name) = open.pop() {
        if let Some((index, node)) = reader.maker(name)
            && !replaced.contains(&index)
            && outside.insert(index)
        {
            open.extend(node.input.iter().map(String::as_str));
        }
    }
    outside
}

/// How many detours through tract lie before each layer.
fn levels(graph: &GraphProto, found: &[Recognized]) -> Vec<usize> {
    let by_node: HashMap<usize, usize> = found
        .iter()
        .enumerate()
        .filter_map(|(index, f)| Some((*f.nodes.last()?, index)))
        .collect();
    // Of tensors: what a reader outside has behind it.
    let mut level: HashMap<&str, usize> = HashMap::new();
    let mut levels = vec![0; found.len()];
    // Of tensors made by a layer: what another layer has behind it.
    let mut inside: HashMap<&str, usize> = HashMap::new();
    for (index, node) in graph.node.iter().enumerate() {
        let greatest =
            |levels: &mut dyn Iterator<Item = Option<usize>>| levels.flatten().max().unwrap_or(0);
        match by_node.get(&index) {
            Some(&layer) => {
                let name = found[layer].layer.output.as_str();
                let at = greatest(&mut found[layer].inputs().iter().map(|input| {
                    let name = input.name.as_str();
                    inside.get(name).or_else(|| level.get(name)).copied()
                }));
                levels[layer] = at;
                inside.insert(name, at);
                let leaves = usize::from(matches!(found[layer].layer.form, Form::Floats));
                level.insert(name, at + leaves);
            }
            None => {
                let at = greatest(
                    &mut node
                        .input
                        .iter()
                        .map(|name| level.get(name.as_str()).copied()),
                );
                level.extend(node.output.iter().map(|name| (name.as_str(), at)));
            }
        }
    }
    levels
}

/// The layers of one level as a node.
fn island_node(
    graph: &GraphProto,
    found: &[Recognized],
    levels: &[usize],
    level: usize,
    outside: &HashSet<usize>,
) -> NodeProto {
    let mut nodes = HashSet::new();
    let (mut inputs, mut outputs): (Vec<String>, Vec<String>) = Default::default();
    let mut crossing = Vec::new();
    let makers: HashMap<&str, usize> = found
        .iter()
        .enumerate()
        .map(|(index, f)| (f.layer.output.as_str(), index))
        .collect();
    let reader = Reader::new(graph);
    // Dimensions of what comes from an earlier island.
    let mut crossed: HashMap<String, usize> = HashMap::new();
    let member_nodes: HashSet<usize> = found
        .iter()
        .zip(levels)
        .filter(|(_, l)| **l == level)
        .flat_map(|(member, _)| member.nodes.iter().copied())
        .collect();
    for (member, _) in found.iter().zip(levels).filter(|(_, l)| **l == level) {
        nodes.extend(member.nodes.iter().copied());
        for input in member.inputs() {
            let maker = makers.get(input.name.as_str()).copied();
            let here = maker.is_some_and(|maker| levels[maker] == level);
            if input.quantization.is_some() {
                nodes.extend(dequantizers(graph, &input.name));
                // Bytes of an earlier island come in as f32, which they survive unchanged.
                if let Some(maker) = maker.filter(|_| !here) {
                    let (_, quantize) = crossers(graph, &found[maker]);
                    let rank = reader.rank(&input.name).unwrap_or(4);
                    crossed.insert(quantize.input[0].clone(), rank);
                    inputs.push(quantize.input[0].clone());
                    crossing.push(quantize);
                }
            } else if !here {
                inputs.push(input.name.clone());
            }
        }
        let name = &member.layer.output;
        if let Form::Floats = member.layer.form {
            // Read by layers of this island alone, it stays inside.
            let inside = |index: &usize| member_nodes.contains(index) && !outside.contains(index);
            let readers = reader.readers(name);
            if readers.is_empty() || reader.is_output(name) || !readers.iter().all(inside) {
                outputs.push(name.clone());
            }
        }
        let leaves = |(reader, l): (&Recognized, &usize)| {
            let reads = |input: &Operand| input.quantization.is_some() && input.name == *name;
            *l > level && reader.inputs().iter().any(reads)
        };
        if found.iter().zip(levels).any(leaves) {
            let (dequantize, _) = crossers(graph, member);
            outputs.push(dequantize.output[0].clone());
            crossing.push(dequantize);
        }
    }
    inputs.sort_unstable();
    inputs.dedup();
    crossing.sort_by(|a, b| a.output.cmp(&b.output));
    crossing.dedup();
    let (quantize, dequantize): (Vec<_>, Vec<_>) = crossing
        .into_iter()
        .partition(|n| n.op_type == "QuantizeLinear");
    let own = graph
        .node
        .iter()
        .enumerate()
        .filter(|(index, _)| nodes.contains(index))
        .map(|(_, node)| node.clone());
    let mut node: Vec<NodeProto> = quantize.into_iter().chain(own).chain(dequantize).collect();
    let constants: Vec<NodeProto> = graph
        .node
        .iter()
        .filter(|constant| constant.op_type == "Constant" && !node.contains(constant))
        .filter(|constant| {
            node.iter()
                .flat_map(|node| &node.input)
                .any(|name| constant.output.contains(name))
        })
        .cloned()
        .collect();
    node.splice(0..0, constants);
    let named = |name: &String| ValueInfoProto {
        name: name.clone(),
        r#type: reader
            .rank(name)
            .or(crossed.get(name).copied())
            .map(f32_of_rank),
        ..ValueInfoProto::default()
    };
    let read: HashSet<&str> = node
        .iter()
        .flat_map(|node| &node.input)
        .map(String::as_str)
        .collect();
    let body = GraphProto {
        initializer: graph
            .initializer
            .iter()
            .filter(|t| read.contains(t.name.as_str()))
            .cloned()
            .collect(),
        input: inputs.iter().map(named).collect(),
        output: outputs.iter().map(named).collect(),
        node,
        ..GraphProto::default()
    };
    NodeProto {
        name: format!("quantized island {level}"),
        op_type: ISLAND.to_owned(),
        input: inputs,
        output: outputs,
        attribute: vec![AttributeProto {
            name: BODY.to_owned(),
            g: Some(body),
            ..AttributeProto::default()
        }],
        ..NodeProto::default()
    }
}

/// The type of an f32 tensor of so many dimensions of any length.
fn f32_of_rank(rank: usize) -> TypeProto {
    let tensor = type_proto::Tensor {
        elem_type: tract_onnx::pb::tensor_proto::DataType::Float as i32,
        shape: Some(TensorShapeProto {
            dim: vec![Dimension::default(); rank],
        }),
    };
    TypeProto {
        value: Some(type_proto::Value::TensorType(tensor)),
        ..TypeProto::default()
    }
}

/// The nodes that dequantize a byte tensor.
fn dequantizers(graph: &GraphProto, name: &str) -> impl Iterator<Item = usize> {
    let reads = move |node: &NodeProto| {
        node.op_type == "DequantizeLinear" && node.input.first().is_some_and(|n| n == name)
    };
    graph
        .node
        .iter()
        .enumerate()
        .filter(move |(_, node)| reads(node))
        .map(|(index, _)| index)
}

/// The nodes that take a layer's bytes out of its island, as f32, and into another.
fn crossers(graph: &GraphProto, maker: &Recognized) -> (NodeProto, NodeProto) {
    let bytes = maker.layer.output.clone();
    let real = format!("{bytes} between islands");
    let quantize = maker.nodes.last().map(|&node| &graph.node[node]);
    let node = |op_type: &str, from: &str, to: &str| {
        let mut node = quantize.cloned().unwrap_or_default();
        node.name.clear();
        node.op_type = op_type.to_owned();
        node.input[0] = from.to_owned();
        node.output = vec![to.to_owned()];
        node.attribute.clear();
        node
    };
    (
        node("DequantizeLinear", &bytes, &real),
        node("QuantizeLinear", &real, &bytes),
    )
}

/// Takes out nodes and weights that nothing reads any more.
fn sweep(graph: &mut GraphProto) {
    loop {
        let read: HashSet<String> = graph
            .node
            .iter()
            .flat_map(|node| &node.input)
            .chain(graph.output.iter().map(|output| &output.name))
            .cloned()
            .collect();
        let nodes = graph.node.len();
        graph
            .node
            .retain(|node| node.output.iter().any(|name| read.contains(name)));
        if graph.node.len() == nodes {
            graph
                .initializer
                .retain(|tensor| read.contains(&tensor.name));
            let made: HashSet<&String> = graph.node.iter().flat_map(|node| &node.output).collect();
            graph.value_info.retain(|value| made.contains(&value.name));
            return;
        }
    }
}
