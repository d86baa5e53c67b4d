//! Brings what different tools write into the one form that [`super::recognize`] looks for, without a change of meaning:
//! constants computed in the graph are folded, copies and casts that change nothing are dropped, and quantization is moved
//! past operators that only select numbers, to where a layer can end or begin with it.

use std::collections::{HashMap, HashSet};
use std::panic::{AssertUnwindSafe, catch_unwind};

use tract_onnx::pb::tensor_proto::DataType;
use tract_onnx::pb::{GraphProto, ModelProto, NodeProto, TensorProto, ValueInfoProto};
use tract_onnx::prelude::*;

use super::qlinear::floats;
use super::recognize::convolution::has_weights;
use super::recognize::graph::{Reader, attribute, input, integer, text};

/// The graph of `model` in that form.
pub(crate) fn tidy(model: &ModelProto, graph: &GraphProto) -> GraphProto {
    let mut graph = graph.clone();
    if graph
        .node
        .iter()
        .any(|node| node.op_type == "QuantizeLinear")
    {
        fold_constants(model, &mut graph);
        simplify(&mut graph);
        while move_quantization(&mut graph) {}
    }
    graph
}

/// Nodes whose inputs are all constant become constants, those aside that quantize or dequantize weights.
fn fold_constants(model: &ModelProto, graph: &mut GraphProto) {
    // So that no order of nodes has to be kept for them.
    for node in &mut graph.node {
        let value = node.attribute.iter_mut().find(|a| a.name == "value");
        if node.op_type == "Constant"
            && let (Some(tensor), [output]) = (value.and_then(|a| a.t.take()), &node.output[..])
        {
            graph.initializer.push(TensorProto {
                name: output.clone(),
                ..tensor
            });
            node.output.clear();
        }
    }
    graph.node.retain(|node| !node.output.is_empty());
    let mut constant: HashSet<String> = graph.initializer.iter().map(|t| t.name.clone()).collect();
    let mut folded = Vec::new();
    for node in &graph.node {
        match node.op_type.as_str() {
            "QuantizeLinear" | "DequantizeLinear" => {}
            op if node.output.len() != 1 || (node.input.is_empty() && op != "Constant") => {}
            _ if node
                .input
                .iter()
                .all(|name| name.is_empty() || constant.contains(name)) =>
            {
                constant.extend(node.output.iter().cloned());
                folded.push(node.clone());
            }
            _ => {}
        }
    }
    let names: Vec<String> = folded.iter().map(|node| node.output[0].clone()).collect();
    if names.is_empty() {
        return;
    }
    let read: HashSet<&String> = folded.iter().flat_map(|node| &node.input).collect();
    let initializer = graph
        .initializer
        .iter()
        .filter(|t| read.contains(&t.name))
        .cloned()
        .collect();
    let part = ModelProto {
        graph: Some(GraphProto {
            node: folded,
            initializer,
            output: names
                .iter()
                .map(|name| ValueInfoProto {
                    name: name.clone(),
                    ..ValueInfoProto::default()
                })
                .collect(),
            ..GraphProto::default()
        }),
        ..model.clone()
    };
    // What tract cannot compute stays.
    let compute = || {
        tract_onnx::onnx()
            .model_for_proto_model(&part)?
            .into_optimized()?
            .into_runnable()?
            .run(tvec!())
    };
    let Ok(Ok(values)) = catch_unwind(AssertUnwindSafe(compute)) else {
        return;
    };
    let mut done = HashSet::new();
    for (name, value) in names.into_iter().zip(values) {
        if let Some(tensor) = proto(&name, &value) {
            graph.initializer.push(tensor);
            done.insert(name);
        }
    }
    graph
        .node
        .retain(|node| !node.output.iter().any(|name| done.contains(name)));
}

fn proto(name: &str, tensor: &Tensor) -> Option<TensorProto> {
    let plain = tensor.try_as_plain_ram().ok()?;
    fn bytes<T: Copy, const N: usize>(values: &[T], to_bytes: impl Fn(T) -> [u8; N]) -> Vec<u8> {
        values.iter().flat_map(|&value| to_bytes(value)).collect()
    }
    let (data_type, raw_data) = match tensor.datum_type() {
        DatumType::F32 => (
            DataType::Float,
            bytes(plain.as_slice::<f32>().ok()?, f32::to_le_bytes),
        ),
        DatumType::I64 => (
            DataType::Int64,
            bytes(plain.as_slice::<i64>().ok()?, i64::to_le_bytes),
        ),
        DatumType::I32 => (
            DataType::Int32,
            bytes(plain.as_slice::<i32>().ok()?, i32::to_le_bytes),
        ),
        DatumType::I8 => (
            DataType::Int8,
            bytes(plain.as_slice::<i8>().ok()?, i8::to_le_bytes),
        ),
        DatumType::U8 => (DataType::Uint8, plain.as_slice::<u8>().ok()?.to_vec()),
        _ => return None,
    };
    Some(TensorProto {
        name: name.to_owned(),
        data_type: data_type as i32,
        dims: tensor.shape().iter().map(|&n| n as i64).collect(),
        raw_data,
        ..TensorProto::default()
    })
}

/// Drops what changes nothing, and writes some operators as others.
fn simplify(graph: &mut GraphProto) {
    let reader = Reader::new(graph);
    let mut renamed: HashMap<String, String> = HashMap::new();
    let mut nodes: Vec<NodeProto> = Vec::new();
    let mut constants = Vec::new();
    for node in &graph.node {
        let mut node = node.clone();
        for name in &mut node.input {
            if let Some(same) = renamed.get(name) {
                name.clone_from(same);
            }
        }
        let kept = node
            .output
            .first()
            .is_some_and(|name| reader.is_output(name));
        let quantize = |name: Option<&String>| {
            let made = |maker: &&NodeProto| maker.output.first() == name;
            nodes
                .iter()
                .rposition(|n| made(&n))
                .filter(|&at| nodes[at].op_type == "QuantizeLinear")
        };
        let same = match node.op_type.as_str() {
            "Identity" | "Dropout" => node.output.len() == 1,
            // A cast of bytes to the type that they have.
            "Cast" => quantize(node.input.first()).is_some_and(|at| {
                let zero = input(&nodes[at], 2).and_then(|zero| reader.integers(zero));
                let kind = zero.map_or(DatumType::U8, |(_, _, kind)| kind);
                let to = integer(&node, "to", 0);
                (kind == DatumType::U8 && to == DataType::Uint8 as i64)
                    || (kind == DatumType::I8 && to == DataType::Int8 as i64)
            }),
            _ => false,
        };
        if let (true, false, [output], Some(from)) =
            (same, kept, &node.output[..], node.input.first())
        {
            renamed.insert(output.clone(), from.clone());
            continue;
        }
        match node.op_type.as_str() {
            // The mean over height and width.
            "ReduceMean" => {
                let mut axes = reader.axes(&node).unwrap_or_default();
                axes.sort_unstable();
                let whole = matches!(axes[..], [2, 3] | [-2, -1]);
                if whole && input(&node, 0).and_then(|name| reader.rank(name)) == Some(4) {
                    let flat = integer(&node, "keepdims", 1) == 0;
                    let output = node.output.clone();
                    node.op_type = "GlobalAveragePool".to_owned();
                    node.attribute.clear();
                    node.input.truncate(1);
                    if flat {
                        node.output[0].push_str(" in four dimensions");
                        let flatten = NodeProto {
                            op_type: "Flatten".to_owned(),
                            input: node.output.clone(),
                            output,
                            ..NodeProto::default()
                        };
                        nodes.extend([node, flatten]);
                        continue;
                    }
                }
            }
            // Bytes that are clipped: their numbers are, before.
            "Clip" => {
                if let Some((clip, at)) = quantize(node.input.first())
                    .filter(|_| {
                        node.input
                            .first()
                            .is_some_and(|name| reader.is_private(name))
                    })
                    .and_then(|at| Some((real_bounds(&reader, &node, &nodes[at])?, at)))
                {
                    let mut quantize = nodes.remove(at);
                    let output = &node.output[0];
                    let names = ["least", "most"].map(|end| format!("{end} of {output}"));
                    constants.extend(
                        names
                            .iter()
                            .zip(clip)
                            .map(|(name, value)| floats(name, &[value])),
                    );
                    let [least, most] = names;
                    let real = format!("{output} in f32");
                    let from = std::mem::replace(&mut quantize.input[0], real.clone());
                    quantize.output.clone_from(&node.output);
                    node.input = vec![from, least, most];
                    node.output = vec![real];
                    nodes.extend([node, quantize]);
                    continue;
                }
            }
            _ => {}
        }
        nodes.push(node);
    }
    graph.node = nodes;
    graph.initializer.extend(constants);
}

/// The scale of a node that quantizes or dequantizes, where there is one for all channels.
fn one_scale(reader: &Reader<'_>, node: &NodeProto) -> Option<f32> {
    match reader.floats(input(node, 1)?)?[..] {
        [scale] => Some(scale),
        _ => None,
    }
}

/// What a Clip of bytes means for the numbers that they stand for.
fn real_bounds(reader: &Reader<'_>, clip: &NodeProto, quantize: &NodeProto) -> Option<[f32; 2]> {
    let scale = one_scale(reader, quantize)?;
    let zero = match input(quantize, 2) {
        Some(zero) => *reader.integers(zero)?.0.first()?,
        None => 0,
    };
    let bound = |number: usize, none: f32| match input(clip, number) {
        Some(name) => Some((*reader.integers(name)?.0.first()? - zero) as f32 * scale),
        None => Some(none),
    };
    Some([bound(1, f32::NEG_INFINITY)?, bound(2, f32::INFINITY)?])
}

/// Whether a node's outputs are some of its inputs' numbers (or 0), so that they may be quantized before as well as after;
/// and it is one that the engine has.
fn selects(reader: &Reader<'_>, node: &NodeProto) -> bool {
    match node.op_type.as_str() {
        "MaxPool" => node.output.len() == 1,
        "Resize" => text(node, "mode", "nearest") == Some("nearest"),
        "Concat" => integer(node, "axis", 0) == 1,
        "Pad" => {
            let zero = |name: &String| {
                reader
                    .floats(name)
                    .is_some_and(|v| v.iter().all(|&v| v == 0.0))
            };
            text(node, "mode", "constant") != Some("constant")
                || input(node, 2).is_none_or(zero) && attribute(node, "value").is_none()
        }
        "Flatten" | "Reshape" | "Squeeze" | "Unsqueeze" => reader.check_flattens(node).is_ok(),
        _ => false,
    }
}

/// Moves quantization past nodes that select; false where there is nothing left to move.
fn move_quantization(graph: &mut GraphProto) -> bool {
    let reader = Reader::new(graph);
    let made_by = |name: &String| reader.maker(name).map(|(_, node)| node);
    let dequantize =
        |name: &String| made_by(name).filter(|node| node.op_type == "DequantizeLinear");
    let mut nodes: Vec<NodeProto> = Vec::new();
    let mut moved = false;
    for node in &graph.node {
        let data = match node.op_type.as_str() {
            "Concat" => node.input.len(),
            _ => 1,
        };
        let ([output], true) = (
            &node.output[..],
            selects(&reader, node) && node.input.len() >= data,
        ) else {
            nodes.push(node.clone());
            continue;
        };
        let readers_of = |name: &String| -> Vec<&NodeProto> {
            let nodes = reader.readers(name).iter().map(|&at| &graph.node[at]);
            nodes.collect()
        };
        let readers = readers_of(output);
        // Before: all readers quantize in the same way, perhaps behind the same limits.
        let clip = match readers[..] {
            [clip] if clip.op_type == "Clip" && clip.input.len() == 3 => Some(clip),
            _ => None,
        };
        let quantizers: Vec<&NodeProto> = match clip {
            Some(clip) => readers_of(&clip.output[0]),
            None => readers.clone(),
        };
        let stays = |name: &String| reader.is_output(name);
        let quantize = quantizers.first().filter(|first| {
            let same =
                |r: &&NodeProto| r.op_type == "QuantizeLinear" && r.input[1..] == first.input[1..];
            // An axis is another one before the node and behind it.
            one_scale(&reader, first).is_some()
                && !stays(output)
                && !clip.is_some_and(|clip| stays(&clip.output[0]))
                && quantizers.iter().all(same)
        });
        if let Some(quantize) = quantize
            && node.input[..data]
                .iter()
                .any(|name| dequantize(name).is_none())
        {
            let mut node = node.clone();
            for name in &mut node.input[..data] {
                if dequantize(name).is_none() {
                    let mut parts = Vec::from(pair(quantize, name, output));
                    if let Some(clip) = clip {
                        let mut clip = clip.clone();
                        clip.name.clear();
                        clip.output[0] = format!("{name} limited for {output}");
                        clip.input[0] =
                            std::mem::replace(&mut parts[0].input[0], clip.output[0].clone());
                        parts.insert(0, clip);
                    }
                    name.clone_from(&parts[parts.len() - 1].output[0]);
                    // The same tensor may be joined to itself.
                    if !nodes.contains(&parts[0]) {
                        nodes.extend(parts);
                    }
                }
            }
            nodes.push(node);
            moved = true;
            continue;
        }
        // After: it reads bytes of one scale, and who reads it wants bytes.
        let first = node.input.first().and_then(dequantize);
        let wanted = |r: &&NodeProto| has_weights(&r.op_type) || selects(&reader, r);
        if let Some(first) = first
            && readers.iter().any(wanted)
            && node.input[..data]
                .iter()
                .all(|name| dequantize(name).is_some_and(|d| d.input[1..] == first.input[1..]))
            && first.input.len() > 2
            && one_scale(&reader, first).is_some()
        {
            let mut node = node.clone();
            let real = format!("{output} before");
            let mut parts = pair(first, &real, output);
            parts[1].output[0].clone_from(output);
            node.output[0] = real;
            nodes.push(node);
            nodes.extend(parts);
            moved = true;
            continue;
        }
        nodes.push(node.clone());
    }
    graph.node = nodes;
    moved
}

/// QuantizeLinear of `name` and DequantizeLinear, with the parameters of `like`.
fn pair(like: &NodeProto, name: &str, output: &str) -> [NodeProto; 2] {
    let bytes = format!("{name} in bytes for {output}");
    let node = |op_type: &str, from: &str, to: String| {
        let mut inputs = like.input.clone();
        inputs[0] = from.to_owned();
        NodeProto {
            op_type: op_type.to_owned(),
            input: inputs,
            output: vec![to],
            ..NodeProto::default()
        }
    };
    let real = format!("{bytes} and back");
    [
        node("QuantizeLinear", name, bytes.clone()),
        node("DequantizeLinear", &bytes, real),
    ]
}
