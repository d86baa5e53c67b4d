//! Which nodes of a model the engine runs, and why not the others.

use std::collections::HashMap;

use serde::Serialize;
use tract_onnx::pb::{ModelProto, NodeProto};

use super::island::{Division, divide};
use super::layer::{Layer, Operation};
use super::recognize::graph::{Reader, input};
use super::{Engine, Kernel};

/// A node of a model, constants aside, and who runs it.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct InspectedNode {
    /// Its ONNX operator.
    pub operator: String,
    /// Its first output.
    pub output: String,
    /// Who runs it.
    #[serde(flatten)]
    pub place: Place,
}

/// Who runs a node.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "runs_in", rename_all = "snake_case")]
#[non_exhaustive]
pub enum Place {
    /// The engine.
    #[non_exhaustive]
    Engine {
        /// Number of the island, from 0; what runs in one go has the same.
        island: usize,
        /// The layer that the node belongs to.
        layer: &'static str,
        /// The instruction set of its inner loop.
        kernel: String,
    },
    /// tract.
    #[non_exhaustive]
    Tract {
        /// Why not the engine.
        reason: String,
    },
}

impl Engine {
    /// The nodes of a model, QLinear operators rewritten, as this engine divides them.
    pub(crate) fn inspect(self, model: &ModelProto) -> Vec<InspectedNode> {
        let all_in_tract = |reason: &str| {
            let nodes = model.graph.iter().flat_map(|graph| &graph.node);
            let node = |node| inspected(node, in_tract(reason));
            nodes
                .filter(|n| n.op_type != "Constant")
                .map(node)
                .collect()
        };
        let Engine::Quantized { kernel, .. } = self else {
            return all_in_tract("the engine has no kernels for this processor");
        };
        let Some(Division {
            graph,
            survey,
            levels,
        }) = divide(model)
        else {
            return all_in_tract("the model has graphs within its graph");
        };
        let mut places: HashMap<usize, Place> = HashMap::new();
        for (found, &island) in survey.layers.iter().zip(&levels) {
            let place = Place::Engine {
                island,
                layer: name(&found.layer),
                kernel: format!("{:?}", kernel_of(&found.layer, kernel)),
            };
            places.extend(found.nodes.iter().map(|&node| (node, place.clone())));
        }
        let reader = Reader::new(&graph);
        let dequantizes_for = |node: &NodeProto| {
            // A DequantizeLinear within an island belongs to whoever reads it.
            let readers = node.output.iter().flat_map(|output| reader.readers(output));
            readers
                .filter_map(|reader| places.get(reader))
                .next()
                .cloned()
        };
        graph
            .node
            .iter()
            .enumerate()
            .filter(|(_, node)| node.op_type != "Constant")
            .map(|(index, node)| {
                let place = places
                    .get(&index)
                    .cloned()
                    .or_else(|| match node.op_type.as_str() {
                        "DequantizeLinear" => dequantizes_for(node),
                        _ => None,
                    });
                let place = place.unwrap_or_else(|| match survey.reasons.get(&index) {
                    Some(reason) => in_tract(&reason.to_string()),
                    None => in_tract(why_not(&reader, node)),
                });
                inspected(node, place)
            })
            .collect()
    }
}

fn inspected(node: &NodeProto, place: Place) -> InspectedNode {
    InspectedNode {
        operator: node.op_type.clone(),
        output: node.output.first().cloned().unwrap_or_default(),
        place,
    }
}

fn in_tract(reason: &str) -> Place {
    Place::Tract {
        reason: reason.to_owned(),
    }
}

/// Why a node is in no layer that might have been.
fn why_not(reader: &Reader<'_>, node: &NodeProto) -> &'static str {
    let quantized = |name: &String| {
        reader
            .maker(name)
            .is_some_and(|(_, maker)| maker.op_type == "DequantizeLinear")
    };
    match node.op_type.as_str() {
        "QuantizeLinear" => "nothing in the engine reads its bytes",
        "DequantizeLinear" if input(node, 0).is_some_and(|name| reader.is_constant(name)) => {
            "its constant is read by tract"
        }
        "DequantizeLinear" => "its bytes are not made in the engine",
        _ if !node.input.iter().any(quantized) => "none of its inputs is quantized",
        _ => "its result is not quantized, or others read it too",
    }
}

fn name(layer: &Layer) -> &'static str {
    match &layer.operation {
        Operation::Quantize => "quantize",
        Operation::Dequantize => "dequantize",
        Operation::Convolution(convolution) if convolution.depthwise => "depthwise convolution",
        Operation::Convolution(_) => "convolution",
        Operation::Add => "add",
        Operation::Multiply => "multiply",
        Operation::Concat => "concat",
        Operation::Table(_) => "table",
        Operation::Resize(_) => "resize",
        Operation::MaxPool(_) => "max pool",
        Operation::AveragePool(..) => "average pool",
        Operation::GlobalAveragePool => "global average pool",
        Operation::Pad(_) => "pad",
        Operation::Flatten => "flatten",
        Operation::DepthToSpace(_) => "depth to space",
        Operation::Elementwise(_) => "elementwise, f32",
    }
}

/// The instruction set of a layer's inner loop.
fn kernel_of(layer: &Layer, kernel: Kernel) -> Kernel {
    match layer.operation {
        Operation::Quantize | Operation::Convolution(_) | Operation::Add => kernel,
        _ => Kernel::Portable,
    }
}
