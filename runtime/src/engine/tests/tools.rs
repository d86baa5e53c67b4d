//! Files as other people's tools write them (`fixtures/engine`), layer by layer against ONNX Runtime and against tract.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use tract_onnx::pb::{ModelProto, NodeProto, TensorProto};
use tract_onnx::tract_hir::internal::Tensor;

use super::super::Place;
use super::super::island::ISLAND;
use super::super::recognize::graph::{Reader, input};
use super::super::tidy::tidy;
use super::*;

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../fixtures/engine")
}

/// A file in the form that the engine works on, and ONNX Runtime's values of its tensors.
fn file(name: &str) -> (ModelProto, HashMap<String, Tensor>) {
    let read = |name: String| {
        let bytes = std::fs::read(folder().join(name)).unwrap();
        tract_onnx::onnx()
            .proto_model_for_read(&mut bytes.as_slice())
            .unwrap()
    };
    let mut model = read(format!("{name}.onnx"));
    to_qdq(&mut model);
    model.graph = Some(tidy(&model, model.graph.as_ref().unwrap()));
    let golden = read(format!("{name}.golden.onnx")).graph.unwrap();
    let tensor = |tensor: &TensorProto| (tensor.name.clone(), loaded(tensor));
    (model, golden.initializer.iter().map(tensor).collect())
}

fn loaded(tensor: &TensorProto) -> Tensor {
    let resolver = &tract_onnx::data_resolver::MmapDataResolver;
    tract_onnx::tensor::load_tensor(resolver, tensor, None).unwrap()
}

/// Bytes of any type, as numbers.
fn bytes(tensor: &Tensor) -> Vec<i32> {
    let plain = tensor.try_as_plain_ram().unwrap();
    match plain.as_slice::<u8>() {
        Ok(bytes) => bytes.iter().map(|&byte| byte.into()).collect(),
        Err(_) => plain
            .as_slice::<i8>()
            .unwrap()
            .iter()
            .map(|&byte| byte.into())
            .collect(),
    }
}

fn reals(tensor: &Tensor) -> Vec<f32> {
    tensor
        .try_as_plain_ram()
        .unwrap()
        .as_slice::<f32>()
        .unwrap()
        .to_vec()
}

/// Runs a model on all of its inputs, by name.
fn outputs(model: &ModelProto, engine: Engine, values: &HashMap<String, Tensor>) -> Vec<Tensor> {
    let split = engine.split(model);
    let model = split.as_ref().unwrap_or(model);
    let mut onnx = tract_onnx::onnx();
    register(&mut onnx);
    let names: Vec<&String> = model
        .graph
        .as_ref()
        .unwrap()
        .input
        .iter()
        .map(|i| &i.name)
        .collect();
    let mut plan = onnx.model_for_proto_model(model).unwrap();
    for (index, name) in names.iter().enumerate() {
        plan.set_input_fact(index, f32::fact(values[*name].shape()).into())
            .unwrap();
    }
    let plan = plan.into_optimized().unwrap().into_runnable().unwrap();
    let inputs = names
        .iter()
        .map(|name| values[*name].clone().into_tvalue())
        .collect();
    plan.run(inputs)
        .unwrap()
        .into_iter()
        .map(|value| value.into_tensor())
        .collect()
}

/// A byte tensor where a model is cut open.
struct Cut {
    /// Its name.
    name: String,
    /// What is quantized there.
    float: String,
    steps: Steps,
}

fn like(quantize: &NodeProto, op: &str, from: String, to: String) -> NodeProto {
    NodeProto {
        op_type: op.into(),
        input: [vec![from], quantize.input[1..].to_vec()].concat(),
        output: vec![to],
        ..NodeProto::default()
    }
}

/// The model with those byte tensors of activations that `values` has (all, without it) made outputs, as f32; with
/// `values`, who reads them reads an input instead.
fn open(model: &ModelProto, values: Option<&HashMap<String, Tensor>>) -> (ModelProto, Vec<Cut>) {
    let mut open = model.clone();
    let reader = Reader::new(model.graph.as_ref().unwrap());
    let graph = open.graph.as_mut().unwrap();
    let mut cuts = Vec::new();
    let mut enter: Vec<NodeProto> = Vec::new();
    let mut leave: Vec<NodeProto> = Vec::new();
    for node in &mut graph.node {
        let is_weight = input(node, 0).is_some_and(|name| reader.is_constant(name));
        if node.op_type != "QuantizeLinear" || is_weight {
            continue;
        }
        let (name, float) = (node.output[0].clone(), node.input[0].clone());
        let (zero, _, kind) = reader.integers(&node.input[2]).unwrap();
        let steps = Steps {
            scale: reader.floats(&node.input[1]).unwrap()[0],
            zero: zero[0] as i32,
            signed: kind == DatumType::I8,
        };
        match values {
            None => leave.push(like(
                node,
                "DequantizeLinear",
                name.clone(),
                format!("{name} out"),
            )),
            Some(values) if values.contains_key(&name) => {
                enter.push(like(
                    node,
                    "QuantizeLinear",
                    format!("{name} in"),
                    name.clone(),
                ));
                let made = format!("{name} made");
                leave.push(like(
                    node,
                    "DequantizeLinear",
                    made.clone(),
                    format!("{name} out"),
                ));
                node.output[0] = made;
                let shape = values[&name].shape();
                graph
                    .input
                    .push(Builder::input(&format!("{name} in"), shape));
            }
            Some(_) => continue,
        }
        graph.output.push(ValueInfoProto {
            name: format!("{name} out"),
            ..ValueInfoProto::default()
        });
        cuts.push(Cut { name, float, steps });
    }
    let rest = std::mem::take(&mut graph.node);
    graph.node = [enter, rest, leave].concat();
    (open, cuts)
}

/// What a comparison of layers found.
#[derive(Debug, Default)]
struct Found {
    bytes: usize,
    /// Bytes that differ, all of them on the edge between two steps.
    ties: usize,
    /// Farthest from the nearest step, in steps; 0.5 is the edge.
    farthest: f64,
    /// Greatest difference of outputs in f32 from ONNX Runtime's, and from tract's.
    floats: [f32; 2],
}

/// What a convolution, and a bound of it if one follows, makes of the bytes of `values`, before it is quantized: sums of integers, scaled
/// in f64. Products of thousands of steps that cancel out cost tract's f32 more than 1e-4 of a step. `None` of any other
/// operator's result.
fn exact_convolution(
    model: &ModelProto,
    values: &HashMap<String, Tensor>,
    float: &str,
) -> Option<Vec<f64>> {
    let graph = model.graph.as_ref()?;
    let made = |name: &str| graph.node.iter().find(|node| node.output[0] == name);
    let constant = |name: &str| {
        let tensor = graph.initializer.iter().find(|t| t.name == name);
        tensor.map(loaded)
    };
    let mut node = made(float)?;
    while matches!(node.op_type.as_str(), "Clip" | "Relu") {
        node = made(&node.input[0])?;
    }
    if node.op_type != "Conv" {
        return None;
    }
    let dequantized = |name: &str| {
        let node = made(name).filter(|node| node.op_type == "DequantizeLinear")?;
        let tensor = values.get(&node.input[0]).cloned();
        let tensor = tensor.or_else(|| constant(&node.input[0]))?;
        let scales: Vec<f64> = reals(&constant(&node.input[1])?)
            .into_iter()
            .map(f64::from)
            .collect();
        Some((tensor, scales, node.input.get(2).and_then(|z| constant(z))))
    };
    let integers = |tensor: &Tensor, zero: Option<Tensor>| {
        let zero = zero.map_or(0, |zero| bytes(&zero)[0]);
        let all = bytes(tensor).into_iter();
        all.map(|byte| i64::from(byte - zero)).collect::<Vec<_>>()
    };
    let (x, x_scale, x_zero) = dequantized(&node.input[0])?;
    let (w, w_scales, w_zero) = dequantized(&node.input[1])?;
    let (b, b_scales, _) = dequantized(&node.input[2])?;
    let ([_, channels, height, width], [outputs, depth, rows, columns]) =
        (*x.shape().as_array()?, *w.shape().as_array()?);
    let b = b.try_as_plain_ram().ok()?;
    let (x, w, b) = (
        integers(&x, x_zero),
        integers(&w, w_zero),
        b.as_slice::<i32>().ok()?,
    );
    let numbers = |name: &str, other: [usize; 4]| {
        let attribute = node.attribute.iter().find(|a| a.name == name);
        attribute.map_or(other.to_vec(), |a| {
            a.ints.iter().map(|&n| n as usize).collect()
        })
    };
    let (pads, strides) = (numbers("pads", [0; 4]), numbers("strides", [1; 4]));
    let dilations = numbers("dilations", [1; 4]);
    let size = [
        (height + pads[0] + pads[2] - dilations[0] * (rows - 1) - 1) / strides[0] + 1,
        (width + pads[1] + pads[3] - dilations[1] * (columns - 1) - 1) / strides[1] + 1,
    ];
    let of = |scales: &[f64], output: usize| scales[output.min(scales.len() - 1)];
    let mut made = Vec::with_capacity(outputs * size[0] * size[1]);
    for output in 0..outputs {
        let first = output * channels / outputs / depth * depth;
        for (v, u) in (0..size[0]).flat_map(|v| (0..size[1]).map(move |u| (v, u))) {
            let mut sum = 0;
            for (channel, row) in (0..depth).flat_map(|c| (0..rows).map(move |r| (c, r))) {
                let y = (v * strides[0] + row * dilations[0]).wrapping_sub(pads[0]);
                for column in 0..columns {
                    let at = (u * strides[1] + column * dilations[1]).wrapping_sub(pads[1]);
                    if y < height && at < width {
                        sum += x[((first + channel) * height + y) * width + at]
                            * w[((output * depth + channel) * rows + row) * columns + column];
                    }
                }
            }
            let bias = f64::from(b[output]) * of(&b_scales, output);
            made.push(sum as f64 * x_scale[0] * of(&w_scales, output) + bias);
        }
    }
    Some(made)
}

/// Gives each layer the bytes of `values` and holds its bytes against them: the same, or one step away where
/// [`exact_convolution`], or else tract's f32 operators, give a number on the edge between two steps, within `edge` of a step.
fn compare_layers(
    model: &ModelProto,
    values: &HashMap<String, Tensor>,
    engine: Engine,
    edge: f64,
    case: &str,
) -> Found {
    let (open, cuts) = open(model, Some(values));
    let mut inputs = values.clone();
    for cut in &cuts {
        let real = |byte: i32| (byte - cut.steps.zero) as f32 * cut.steps.scale;
        let value: Vec<f32> = bytes(&values[&cut.name]).into_iter().map(real).collect();
        let value = Tensor::from_shape(values[&cut.name].shape(), &value).unwrap();
        inputs.insert(format!("{} in", cut.name), value);
    }
    let ours = outputs(&open, engine, &inputs);
    let mut in_floats = open.clone();
    let graph = in_floats.graph.as_mut().unwrap();
    let finals = model.graph.as_ref().unwrap().output.len();
    for (output, cut) in graph.output[finals..].iter_mut().zip(&cuts) {
        // An input of the graph cannot be an output of tract's.
        output.name.clone_from(&cut.float);
    }
    let quantizes_input: Vec<bool> = cuts
        .iter()
        .map(|cut| cut.float == graph.input[0].name)
        .collect();
    let mut number = 0;
    graph.output.retain(|_| {
        number += 1;
        number <= finals || !quantizes_input[number - 1 - finals]
    });
    let mut theirs = outputs(&in_floats, Engine::Tract, &inputs).into_iter();
    let mut found = Found::default();
    for (output, ours) in model.graph.as_ref().unwrap().output.iter().zip(&ours) {
        let ours = reals(ours);
        let others = [reals(&values[&output.name]), reals(&theirs.next().unwrap())];
        for (most, other) in found.floats.iter_mut().zip(others) {
            for (a, b) in ours.iter().zip(other) {
                *most = most.max((a - b).abs());
            }
        }
        assert_eq!(
            ours.len(),
            values[&output.name].len(),
            "{case}: `{}`",
            output.name
        );
    }
    for ((cut, ours), is_input) in cuts.iter().zip(&ours[finals..]).zip(quantizes_input) {
        let float = if is_input {
            reals(&values[&cut.float])
        } else {
            reals(&theirs.next().unwrap())
        };
        let expected = bytes(&values[&cut.name]);
        let ours = reals(ours);
        assert_eq!(
            [ours.len(), float.len()],
            [expected.len(); 2],
            "{case}: `{}`",
            cut.name
        );
        let real = exact_convolution(model, values, &cut.float);
        let real = real.unwrap_or_else(|| float.into_iter().map(f64::from).collect());
        assert_eq!(real.len(), ours.len(), "{case}: `{}`", cut.name);
        for ((ours, expected), real) in ours.into_iter().zip(expected).zip(real) {
            let step = (ours / cut.steps.scale).round() as i32 + cut.steps.zero;
            let exact = real / f64::from(cut.steps.scale) + f64::from(cut.steps.zero);
            let least = f64::from(cut.steps.least());
            let exact = exact.clamp(least, least + 255.0);
            let apart = [step, expected].map(|step| (f64::from(step) - exact).abs());
            found.farthest = apart.into_iter().fold(found.farthest, f64::max);
            found.bytes += 1;
            found.ties += usize::from(step != expected);
            assert!(
                step == expected || apart.iter().all(|apart| *apart <= 0.5 + edge),
                "{case}: `{}` is {step}, not {expected}, of {exact}",
                cut.name
            );
        }
    }
    found
}

/// Operators that are left to tract, and the number of islands.
fn left(model: &ModelProto) -> (Vec<String>, usize) {
    let split = fastest().split(model);
    let graph = split.as_ref().unwrap_or(model).graph.as_ref().unwrap();
    let (islands, rest): (Vec<_>, Vec<_>) =
        graph.node.iter().partition(|node| node.op_type == ISLAND);
    (
        rest.iter().map(|node| node.op_type.clone()).collect(),
        islands.len(),
    )
}

/// Files, and what of them is left to tract.
const FILES: &[(&str, usize, &[&str])] = &[
    (
        "decoder-ort-qlinear-u8s8",
        3,
        &["Elu", "ConvTranspose", "ConvTranspose"],
    ),
    (
        "decoder-ort-qlinear-u8u8",
        3,
        &["Elu", "ConvTranspose", "ConvTranspose"],
    ),
    ("decoder-ort-s8s8", 1, &[]),
    ("decoder-ort-u8s8", 1, &[]),
    ("decoder-ort-u8u8", 1, &[]),
    // Its ELU, GELU, transposed convolutions and what is between them are f32 in the file.
    (
        "decoder-pt2e",
        2,
        &[
            "Elu",
            "ConvTranspose",
            "LeakyRelu",
            "MaxPool",
            "ConvTranspose",
            "Div",
            "Erf",
            "Add",
            "Mul",
            "Mul",
        ],
    ),
    ("gate-ort-qlinear-u8s8", 1, &[]),
    ("gate-ort-qlinear-u8u8", 1, &[]),
    ("gate-ort-s8s8", 1, &[]),
    ("gate-ort-u8s8", 1, &[]),
    ("gate-ort-u8u8", 1, &[]),
    ("gate-pt2e", 2, &["Sigmoid", "Reshape"]),
    ("gate-torch", 1, &[]),
    ("mobile-ort-qlinear-u8s8", 1, &[]),
    ("mobile-ort-qlinear-u8u8", 1, &[]),
    ("mobile-ort-s8s8", 1, &[]),
    ("mobile-ort-u8s8", 1, &[]),
    ("mobile-ort-u8u8", 1, &[]),
    ("mobile-pt2e", 1, &[]),
    ("mobile-torch", 1, &[]),
    ("residual-ort-qlinear-u8s8", 1, &[]),
    ("residual-ort-qlinear-u8u8", 1, &[]),
    ("residual-ort-s8s8", 1, &[]),
    ("residual-ort-u8s8", 1, &[]),
    ("residual-ort-u8u8", 1, &[]),
    ("residual-pt2e", 1, &[]),
    ("residual-reduced", 1, &[]),
    // Its MaxPool is read as f32, too.
    ("residual-tensorrt", 2, &["Relu", "MaxPool"]),
    ("residual-tensorrt-residual", 1, &[]),
    ("residual-torch", 1, &[]),
];

#[test]
fn files_of_other_tools_run_in_the_engine() {
    for (name, islands, operators) in FILES {
        let (model, _) = file(name);
        let (rest, found) = left(&model);
        assert_eq!(
            (found, rest),
            (
                *islands,
                operators.iter().map(|&op| op.to_owned()).collect()
            ),
            "{name}"
        );
    }
}

/// Farther than this from the edge between two steps, bytes must be ONNX Runtime's.
const EDGE: f64 = 1e-4;
/// The same where biases are f32: the engine rounds them to a step of the accumulators, which moves a sum by half of one
/// at most; in these files an accumulator's step is at most 0.018 of an output's.
const EDGE_OF_BIASES: f64 = 9e-3;

#[test]
fn files_of_other_tools_give_what_onnx_runtime_gives() {
    for kernel in [Kernel::Portable, Kernel::best()] {
        let engine = Engine::Quantized { kernel, threads: 2 };
        for (name, ..) in FILES {
            let (model, values) = file(name);
            let edge = match name.ends_with("pt2e") {
                true => EDGE_OF_BIASES,
                false => EDGE,
            };
            let found = compare_layers(&model, &values, engine, edge, name);
            println!("{name}: {found:?}");
            assert!(found.floats[0] < 1e-4, "{name}: {:?}", found.floats);
            // Where no layer is on an edge, all of them together give the same too.
            if found.ties == 0 {
                let whole = outputs(&model, engine, &values);
                for (output, value) in model.graph.as_ref().unwrap().output.iter().zip(whole) {
                    let expected = reals(&values[&output.name]);
                    for (ours, expected) in reals(&value).into_iter().zip(expected) {
                        assert!(
                            (ours - expected).abs() < 1e-4,
                            "{name}: {ours} and {expected}"
                        );
                    }
                }
            }
        }
    }
}

/// Each layer of the shipped networks, and of one with blocks of weights that are zero, given what the engine made of the layers before it.
#[test]
fn every_layer_of_the_networks_is_the_nearest_step() {
    for name in ["tiny-adaptive-int8", "adaptive-int8", "large-adaptive-int8"] {
        let file =
            Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../fixtures/models/{name}.onnx"));
        every_layer_is_the_nearest_step(name, &std::fs::read(file).unwrap());
    }
    let [_, sparse] = dense_and_sparse();
    every_layer_is_the_nearest_step("sparse", &sparse);
}

fn every_layer_is_the_nearest_step(name: &str, mut bytes: &[u8]) {
    let mut model = tract_onnx::onnx().proto_model_for_read(&mut bytes).unwrap();
    model.graph = Some(tidy(&model, model.graph.as_ref().unwrap()));
    let graph = model.graph.as_ref().unwrap();
    let mut numbers = Numbers(9);
    let picture: Vec<f32> = (0..4 * 64 * 96).map(|_| numbers.real(-2.0, 2.0)).collect();
    let picture = Tensor::from_shape(&[1, 4, 64, 96], &picture).unwrap();
    let mut values = HashMap::from([(graph.input[0].name.clone(), picture)]);
    let (exposed, cuts) = open(&model, None);
    let made = outputs(&exposed, fastest(), &values);
    let finals = graph.output.len();
    for (output, value) in graph.output.iter().zip(&made) {
        values.insert(output.name.clone(), value.clone());
    }
    for (cut, real) in cuts.iter().zip(&made[finals..]) {
        let Steps {
            scale,
            zero,
            signed,
        } = cut.steps;
        assert!(!signed);
        let byte = |&real: &f32| ((real / scale).round() as i32 + zero) as u8;
        let bytes: Vec<u8> = reals(real).iter().map(byte).collect();
        values.insert(
            cut.name.clone(),
            Tensor::from_shape(real.shape(), &bytes).unwrap(),
        );
    }
    assert!(cuts.len() > 50, "{}", cuts.len());
    let found = compare_layers(&model, &values, fastest(), EDGE, name);
    println!("{found:?}");
    assert_eq!(
        (found.ties, found.floats[0]),
        (0, 0.0),
        "the engine, layer by layer, is another than in one go"
    );
    assert!(found.farthest <= 0.5 + EDGE, "{found:?}");
    assert!(found.floats[1] < 1e-4, "{found:?}");
}

#[test]
fn inspection_says_who_runs_a_node_and_why() {
    let (model, _) = file("decoder-ort-qlinear-u8s8");
    let nodes = fastest().inspect(&model);
    let of = |operator: &str| -> Vec<String> {
        let nodes = nodes.iter().filter(|node| node.operator == operator);
        nodes.map(|node| format!("{:?}", node.place)).collect()
    };
    assert!(
        of("Conv").iter().all(|place| place.contains("convolution")),
        "{:?}",
        of("Conv")
    );
    assert!(
        of("ConvTranspose")[0].contains("its input is not quantized"),
        "{:?}",
        of("ConvTranspose")
    );
    assert!(of("Elu")[0].contains("not quantized"), "{:?}", of("Elu"));
    let in_tract = nodes
        .iter()
        .filter(|node| matches!(node.place, Place::Tract { .. }))
        .count();
    assert_eq!(in_tract, left(&model).0.len());
    let all = Engine::Tract.inspect(&model);
    assert!(
        all.iter()
            .all(|node| matches!(node.place, Place::Tract { .. }))
    );
}
