//! A model: an ONNX file and the contract in its metadata.

use std::collections::HashSet;
use std::fmt;
use std::fs::File;
use std::io::Read;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use tract_onnx::pb::tensor_proto::{DataLocation, DataType};
use tract_onnx::pb::tensor_shape_proto::dimension::Value as Dimension;
use tract_onnx::pb::type_proto::Value as TypeValue;
use tract_onnx::pb::{GraphProto, ModelProto, NodeProto, TensorProto};
use tract_onnx::prelude::*;

use crate::Error;
use crate::contract::{Contract, MAX_SIDE};
use crate::engine::{self, Engine, Entrance, LayerTime, Reader, Results, Threads, Whole};
use crate::inspection::PlanKind;

/// The quantized adaptive model that the crate carries; see `fixtures/README.md` for how it was trained.
static EMBEDDED: &[u8] = include_bytes!("../../fixtures/models/adaptive-int8.onnx");

/// Largest file that is read as a model, bytes: protobuf's own limit.
const MAX_FILE_BYTES: u64 = 1 << 31;
/// Greatest number of pixels that a network is run at.
pub(crate) const MAX_PIXELS: u64 = 1 << 24;
/// Attributes of nodes that are numbers of pixels.
const WINDOWS: [&str; 6] = [
    "dilations",
    "kernel_shape",
    "output_padding",
    "output_shape",
    "pads",
    "strides",
];

/// Width and height, pixels.
pub type Size = (u32, u32);

/// An ONNX model and its contract, not yet bound to a size.
pub struct Model {
    path: PathBuf,
    contract: Contract,
    pub(crate) proto: ModelProto,
    /// Width and height of the input, where the file fixes them.
    fixed_size: Option<Size>,
    engine: Engine,
}

impl Model {
    /// Reads a model from an ONNX file.
    pub fn from_file(path: &Path) -> Result<Self, Error> {
        let read = || {
            let mut bytes = Vec::new();
            let file = File::open(path)?;
            // Pipes and devices do not say how long they are.
            if file.metadata()?.len() <= MAX_FILE_BYTES {
                file.take(MAX_FILE_BYTES + 1).read_to_end(&mut bytes)?;
                if bytes.len() as u64 <= MAX_FILE_BYTES {
                    return Ok(bytes);
                }
            }
            Err(std::io::Error::other(
                "larger than 2 GiB, the limit of an ONNX file",
            ))
        };
        let bytes = read().map_err(|reason| Error::ModelRead {
            path: path.to_owned(),
            reason,
        })?;
        Self::from_bytes(path, &bytes)
    }

    /// The quantized adaptive model that this crate carries.
    pub fn embedded() -> Result<Self, Error> {
        Self::from_bytes(Path::new("the embedded model"), EMBEDDED)
    }

    /// Reads a model from the bytes of an ONNX file; `path` names it in errors.
    pub fn from_bytes(path: &Path, mut bytes: &[u8]) -> Result<Self, Error> {
        let unfit = |reason: String| Error::Model {
            path: path.to_owned(),
            reason,
        };
        let mut proto = tract_onnx::onnx()
            .proto_model_for_read(&mut bytes)
            .map_err(|_| unfit("not an ONNX file".to_owned()))?;
        let Some(graph) = &proto.graph else {
            return Err(unfit(
                "not an ONNX file: there is no graph in it".to_owned(),
            ));
        };
        check_nodes(graph).map_err(unfit)?;
        guarded(|| Ok(check_windows(graph, &[])))
            .flatten()
            .map_err(unfit)?;
        forget_names_of_sizes(&mut proto);
        guarded(|| {
            engine::to_qdq(&mut proto);
            Ok(())
        })
        .map_err(unfit)?;
        let metadata = proto
            .metadata_props
            .iter()
            .map(|e| (e.key.as_str(), e.value.as_str()));
        let contract = Contract::from_metadata(metadata).map_err(|reason| Error::Contract {
            path: path.to_owned(),
            reason,
        })?;
        let fixed_size = check_graph(&proto, &contract).map_err(unfit)?;
        Ok(Self {
            path: path.to_owned(),
            contract,
            proto,
            fixed_size,
            engine: Engine::default(),
        })
    }

    /// Runs its quantized layers in another way than [`Engine::default`].
    pub fn with_engine(self, engine: Engine) -> Self {
        Self { engine, ..self }
    }

    /// How its quantized layers are run.
    pub fn engine(&self) -> Engine {
        self.engine
    }

    /// What the model says about itself.
    pub fn contract(&self) -> &Contract {
        &self.contract
    }

    /// The file it came from.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// How many numbers were learned, as far as the graph shows: its initializers but for shapes, quantization scales
    /// and zero points, and what resizing and clipping take.
    pub fn parameters(&self) -> u64 {
        let graph = self.proto.graph.iter();
        let initializers = graph.clone().flat_map(|graph| &graph.initializer);
        let not_learned = |name: &str| {
            let mut uses = graph
                .clone()
                .flat_map(|graph| &graph.node)
                .flat_map(|node| {
                    let inputs = node.input.iter().enumerate();
                    inputs
                        .filter(|(_, input)| *input == name)
                        .map(|(index, _)| (node.op_type.as_str(), index))
                });
            uses.all(|(operator, index)| match operator {
                "QuantizeLinear" | "DequantizeLinear" | "Resize" | "Clip" => index > 0,
                "QLinearConv" | "QLinearMatMul" => !matches!(index, 3 | 8),
                _ => false,
            })
        };
        initializers
            .filter(|tensor| {
                tensor.data_type != DataType::Int64 as i32 && !not_learned(&tensor.name)
            })
            .map(|tensor| {
                tensor
                    .dims
                    .iter()
                    .map(|&n| n.max(0) as u64)
                    .product::<u64>()
            })
            .sum()
    }

    /// Width and height of the input, where the file fixes them.
    pub fn fixed_size(&self) -> Option<Size> {
        self.fixed_size
    }
}

impl fmt::Debug for Model {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Model")
            .field("path", &self.path)
            .field("contract", &self.contract)
            .field("fixed_size", &self.fixed_size)
            .finish_non_exhaustive()
    }
}

/// What neither tract nor the engine asks. Each node reads only what is there before it, as ONNX has it: what follows a tensor to where it
/// comes from then ends.
fn check_nodes(graph: &GraphProto) -> Result<(), String> {
    let elsewhere =
        |tensor: &&TensorProto| tensor.data_location == Some(DataLocation::External as i32);
    if let Some(tensor) = graph.initializer.iter().find(elsewhere) {
        return Err(format!(
            "its weights `{}` are in another file; save the model as one (onnx.save_model without save_as_external_data)",
            tensor.name
        ));
    }
    let inputs = graph.input.iter().map(|input| &input.name);
    let weights = graph.initializer.iter().map(|tensor| &tensor.name);
    let sparse = graph
        .sparse_initializer
        .iter()
        .filter_map(|tensor| Some(&tensor.values.as_ref()?.name));
    check_bits(graph)?;
    let mut there: HashSet<&str> = inputs
        .chain(weights)
        .chain(sparse)
        .map(String::as_str)
        .collect();
    for node in &graph.node {
        let missing = |name: &&String| !name.is_empty() && !there.contains(name.as_str());
        if let Some(missing) = node.input.iter().find(missing) {
            return Err(format!(
                "its node {} `{}` reads `{missing}`, which nothing before it makes; ONNX has nodes in the order in which they run",
                node.op_type, node.name
            ));
        }
        for output in node.output.iter().filter(|name| !name.is_empty()) {
            if !there.insert(output) {
                return Err(format!(
                    "its node {} `{}` makes `{output}`, which is there already",
                    node.op_type, node.name
                ));
            }
        }
    }
    Ok(())
}

/// No window is larger than any picture, here or in an inner graph: tract would allocate for it, and end the process. And no node is the
/// engine's own, which trusts what it reads.
fn check_windows<'a>(graph: &'a GraphProto, around: &[&Reader<'a>]) -> Result<(), String> {
    let own = Reader::new(graph);
    let scopes: Vec<&Reader<'_>> = around.iter().copied().chain([&own]).collect();
    let pads = |node: &NodeProto| {
        let name = node.input.get(1).filter(|_| node.op_type == "Pad")?;
        let constant = scopes.iter().rev().find_map(|scope| scope.integers(name))?;
        Some(("pads", constant.0))
    };
    for node in &graph.node {
        if node.op_type == engine::ISLAND {
            return Err(format!(
                "its node `{}` is a {}, which is no operator for files",
                node.name, node.op_type
            ));
        }
        let windows = node
            .attribute
            .iter()
            .filter(|a| WINDOWS.contains(&a.name.as_str()))
            .map(|a| (a.name.as_str(), a.ints.clone()));
        for (name, numbers) in windows.chain(pads(node)) {
            let limit = u64::from(MAX_SIDE);
            if let Some(wrong) = numbers.iter().find(|n| n.unsigned_abs() > limit) {
                return Err(format!(
                    "its node {} `{}` has {wrong} among its {name}: more than {limit} pixels",
                    node.op_type, node.name
                ));
            }
        }
        for inner in node
            .attribute
            .iter()
            .flat_map(|a| a.g.iter().chain(&a.graphs))
        {
            check_windows(inner, &scopes)?;
        }
    }
    Ok(())
}

/// Quantization is to 8 bits, of biases to 32.
fn check_bits(graph: &GraphProto) -> Result<(), String> {
    let taken = [DataType::Uint8, DataType::Int8, DataType::Int32].map(|t| t as i32);
    let other = |tensor: &&TensorProto| !taken.contains(&tensor.data_type);
    let others = graph.initializer.iter().filter(other);
    let names: HashSet<&str> = others.clone().map(|tensor| tensor.name.as_str()).collect();
    let unfit = |node: &NodeProto, kind: i32| {
        let kind = DataType::try_from(kind).map_or("a type without a name", |t| t.as_str_name());
        format!(
            "its node {} `{}` is of {kind}; quantize to 8 bits",
            node.op_type, node.name
        )
    };
    let quantizes =
        |node: &&NodeProto| matches!(node.op_type.as_str(), "QuantizeLinear" | "DequantizeLinear");
    for node in graph.node.iter().filter(quantizes) {
        let zero = node.input.get(2).map_or("", String::as_str);
        let said = node.attribute.iter().find(|a| a.name == "output_dtype");
        if let Some(said) = said.filter(|_| node.op_type == "QuantizeLinear")
            && said.i != 0
            && !taken.map(i64::from).contains(&said.i)
        {
            return Err(unfit(node, said.i as i32));
        }
        if names.contains(zero)
            && let Some(zero) = others.clone().find(|tensor| tensor.name == zero)
        {
            return Err(unfit(node, zero.data_type));
        }
    }
    Ok(())
}

/// Tools write the sizes of inner tensors as the names of the input's, or as new ones; tract takes those for other sizes than the numbers that the
/// input gets. How many dimensions there are stays.
fn forget_names_of_sizes(proto: &mut ModelProto) {
    let values = proto
        .graph
        .iter_mut()
        .flat_map(|graph| &mut graph.value_info);
    for value in values {
        if let Some(TypeValue::TensorType(tensor)) =
            value.r#type.as_mut().and_then(|t| t.value.as_mut())
        {
            for dimension in tensor.shape.iter_mut().flat_map(|shape| &mut shape.dim) {
                if let Some(Dimension::DimParam(_)) = dimension.value {
                    dimension.value = None;
                }
            }
        }
    }
}

/// Holds the graph against its contract; returns the size that the input fixes.
fn check_graph(proto: &ModelProto, contract: &Contract) -> Result<Option<Size>, String> {
    let graph = proto.graph.as_ref().ok_or("there is no graph in it")?;
    // Older files list the weights among the inputs.
    let inputs: Vec<_> = graph
        .input
        .iter()
        .filter(|input| {
            graph
                .initializer
                .iter()
                .all(|weights| weights.name != input.name)
        })
        .collect();
    let [input] = inputs.as_slice() else {
        return Err(format!("it has {} inputs instead of one", inputs.len()));
    };
    if input.name != contract.input {
        return Err(format!(
            "its input is `{}`, but its contract says `{}`",
            input.name, contract.input
        ));
    }
    let Some(TypeValue::TensorType(tensor)) = input.r#type.as_ref().and_then(|t| t.value.as_ref())
    else {
        return Err("its input has no type".to_owned());
    };
    if tensor.elem_type != DataType::Float as i32 {
        return Err(format!(
            "its input is of {}, but the contract's is f32; begin the graph with the first QuantizeLinear or Cast",
            DataType::try_from(tensor.elem_type).map_or("no known type", |t| t.as_str_name())
        ));
    }
    let dimensions: Vec<Option<i64>> = tensor
        .shape
        .iter()
        .flat_map(|shape| &shape.dim)
        .map(|dimension| match dimension.value {
            Some(Dimension::DimValue(n)) => Some(n),
            _ => None,
        })
        .collect();
    let channels = contract.channels.len() as i64;
    let multiple = i64::from(contract.size_multiple);
    let (width, height) = contract.nominal_size;
    if u64::from(width) * u64::from(height) > MAX_PIXELS {
        return Err(format!(
            "its contract's nominal_size of {width} x {height} is more than {MAX_PIXELS} pixels"
        ));
    }
    match dimensions[..] {
        [_, _, Some(height), Some(width)] if height % multiple != 0 || width % multiple != 0 => {
            Err(format!(
                "its input is fixed to {width} x {height} pixels, but its contract's size_multiple is {multiple}"
            ))
        }
        [batch, c, height, width]
            if batch.is_none_or(|n| n == 1) && c.is_none_or(|n| n == channels) =>
        {
            match (height, width) {
                (Some(height), Some(width))
                    if [height, width]
                        .iter()
                        .all(|side| (1..=i64::from(MAX_SIDE)).contains(side)) =>
                {
                    if width.unsigned_abs() * height.unsigned_abs() > MAX_PIXELS {
                        return Err(format!(
                            "its input of {width} x {height} is more than {MAX_PIXELS} pixels"
                        ));
                    }
                    Ok(Some((width as u32, height as u32)))
                }
                (None, None) => Ok(None),
                (Some(height), Some(width)) => Err(format!(
                    "its input is fixed to {width} x {height} pixels; each side must be 1 to {MAX_SIDE}"
                )),
                _ => Err("its input must have a fixed height and width, or neither".to_owned()),
            }
        }
        _ => {
            let shape: Vec<String> = dimensions
                .iter()
                .map(|n| n.map_or("any".to_owned(), |n| n.to_string()))
                .collect();
            Err(format!(
                "its input has the shape [{}], but its contract needs [1, {channels}, height, width]: one picture at a time, of the contract's {channels} channels",
                shape.join(", ")
            ))
        }
    }
}

/// Who runs a network.
enum Plan {
    /// tract, with or without islands of the engine in it.
    Tract {
        plan: Arc<TypedRunnableModel>,
        /// `[1, channels, height, width]`; taken by a run and given back after it.
        input: Arc<Tensor>,
        /// Of the last run.
        outputs: TVec<TValue>,
        kind: PlanKind,
    },
    /// The engine alone, without an allocation per run.
    Engine(Box<Whole>),
}

/// A network bound to a size, ready to run.
pub(crate) struct Network {
    path: PathBuf,
    plan: Plan,
    /// The outputs that were asked for, and where each is among the plan's.
    outputs: Vec<(String, usize)>,
}

impl Network {
    /// Plans the model for an input of `size`; the outputs come in the order of `outputs`.
    pub(crate) fn new(model: &Model, size: Size, outputs: &[&str]) -> Result<Self, Error> {
        model.engine.check()?;
        let unfit = |reason: String| Error::Model {
            path: model.path.clone(),
            reason,
        };
        if u64::from(size.0) * u64::from(size.1) > MAX_PIXELS {
            return Err(unfit(format!(
                "{} x {} pixels are more than it is run at",
                size.0, size.1
            )));
        }
        let graph_outputs: Vec<&str> = model
            .proto
            .graph
            .iter()
            .flat_map(|g| &g.output)
            .map(|o| o.name.as_str())
            .collect();
        let outputs = outputs
            .iter()
            .map(|name| {
                let place = graph_outputs.iter().position(|output| output == name);
                let missing = || {
                    let all = graph_outputs.join("`, `");
                    unfit(format!(
                        "it has no output `{name}`, which its contract names; it has `{all}`"
                    ))
                };
                Ok(((*name).to_owned(), place.ok_or_else(missing)?))
            })
            .collect::<Result<Vec<_>, _>>()?;
        let shape = [
            1,
            model.contract.channels.len(),
            size.1 as usize,
            size.0 as usize,
        ];
        let plan = |proto: &ModelProto, kind: PlanKind| {
            guarded(|| {
                let mut onnx = tract_onnx::onnx();
                engine::register(&mut onnx);
                let plan = onnx
                    .model_for_proto_model(proto)?
                    .with_input_fact(0, f32::fact(shape).into())?
                    .into_optimized()?
                    .into_runnable()?;
                let input = Arc::new(Tensor::zero::<f32>(&shape)?);
                Ok(Plan::Tract {
                    plan,
                    input,
                    outputs: tvec!(),
                    kind,
                })
            })
        };
        // What the engine cannot do, tract does; what it cannot do after all, too.
        let [_, channels, height, width] = shape;
        let (whole, split) = guarded(|| {
            let split = model.engine.split(&model.proto);
            let whole = split
                .as_ref()
                .and_then(|split| Whole::new(split, [channels, height, width]));
            Ok((whole, split))
        })
        .map_err(unfit)?;
        // tract's words are of its own nodes and symbols.
        let unplanned = |reason: String| {
            unfit(match model.fixed_size {
                Some(_) => reason,
                None => format!(
                    "{reason} (at {} x {} pixels, multiples of its contract's size_multiple, {})",
                    size.0, size.1, model.contract.size_multiple
                ),
            })
        };
        let plan = match (whole, split) {
            (Some(whole), _) => Plan::Engine(Box::new(whole)),
            (None, Some(split)) => plan(&split, PlanKind::TractWithIslands)
                .or_else(|reason| {
                    let islands_refused = Some(reason);
                    plan(&model.proto, PlanKind::Tract { islands_refused })
                })
                .map_err(unplanned)?,
            (None, None) => {
                let islands_refused = None;
                plan(&model.proto, PlanKind::Tract { islands_refused }).map_err(unplanned)?
            }
        };
        Ok(Self {
            path: model.path.clone(),
            plan,
            outputs,
        })
    }

    /// Who runs it.
    pub(crate) fn kind(&self) -> PlanKind {
        match &self.plan {
            Plan::Engine(_) => PlanKind::Engine,
            Plan::Tract { kind, .. } => kind.clone(),
        }
    }

    /// Lets `fill` write the input.
    pub(crate) fn fill_input(
        &mut self,
        fill: impl FnOnce(Entrance<'_>) -> Result<(), String>,
    ) -> Result<(), Error> {
        let filled = match &mut self.plan {
            Plan::Engine(whole) => guarded(|| Ok(fill(whole.entrance()))),
            Plan::Tract { input, .. } => guarded(|| {
                let mut plain = Arc::make_mut(input).try_as_plain_ram_mut()?;
                Ok(fill(Entrance::Planes(plain.as_slice_mut()?)))
            }),
        };
        filled
            .and_then(|filled| filled)
            .map_err(|reason| Error::Model {
                path: self.path.clone(),
                reason,
            })
    }

    /// Keeps each thread on one of `cores`, where the engine runs all layers.
    pub(crate) fn pin(&mut self, cores: &[usize]) -> Result<(), String> {
        match &mut self.plan {
            Plan::Engine(whole) => whole.pin(cores),
            Plan::Tract { .. } => Err("tract runs this model, on the caller's thread".to_owned()),
        }
    }

    /// From now on measures how long each layer takes, where the engine runs all of them.
    pub(crate) fn measure(&mut self) {
        if let Plan::Engine(whole) = &mut self.plan {
            whole.measure();
        }
    }

    /// Times of the layers in all runs since [`Network::measure`]; none where tract runs the network.
    pub(crate) fn times(&self) -> Vec<LayerTime> {
        match &self.plan {
            Plan::Engine(whole) => whole.times(),
            Plan::Tract { .. } => Vec::new(),
        }
    }

    /// Runs the network on its input.
    pub(crate) fn run(&mut self) -> Result<(), Error> {
        let ran = match &mut self.plan {
            Plan::Tract {
                plan,
                input,
                outputs,
                ..
            } => guarded(|| plan.run(tvec!(input.clone().into_tvalue()))).map(|values| {
                *outputs = values;
            }),
            Plan::Engine(whole) => guarded(|| Ok(whole.run())).and_then(|ran| ran),
        };
        ran.map_err(|reason| Error::Model {
            path: self.path.clone(),
            reason,
        })
    }

    /// What the last run gave. The threads that ran it are free to go on with it; none where tract did.
    pub(crate) fn outputs(&mut self) -> (Outputs<'_>, Option<Threads<'_>>) {
        let (values, threads) = match &mut self.plan {
            Plan::Tract { outputs, .. } => (Values::Tract(outputs), None),
            Plan::Engine(whole) => {
                let (results, threads) = whole.results();
                (Values::Engine(results), Some(threads))
            }
        };
        let outputs = Outputs {
            path: &self.path,
            order: &self.outputs,
            values,
        };
        (outputs, threads)
    }
}

/// What a run of a network gave.
pub(crate) struct Outputs<'a> {
    path: &'a Path,
    order: &'a [(String, usize)],
    values: Values<'a>,
}

enum Values<'a> {
    Tract(&'a [TValue]),
    Engine(&'a Results),
}

impl Outputs<'_> {
    /// The error of a model whose outputs are not what its contract says.
    pub(crate) fn unfit(&self, reason: impl ToString) -> Error {
        Error::Model {
            path: self.path.to_owned(),
            reason: reason.to_string(),
        }
    }

    /// The same of the output that was asked for as number `index`.
    pub(crate) fn unfit_head(&self, index: usize, reason: impl fmt::Display) -> Error {
        self.unfit(format!("its output `{}`: {reason}", self.order[index].0))
    }

    /// The output that was asked for as number `index`: its numbers, planar, and its `[channels, height, width]`.
    pub(crate) fn head(&self, index: usize) -> Result<(&[f32], [usize; 3]), Error> {
        let place = self.order[index].1;
        let value = match &self.values {
            Values::Tract(values) => &values[place],
            Values::Engine(results) => return Ok(results.output(place)),
        };
        let &[1, channels, height, width] = value.shape() else {
            let reason = format!(
                "has the shape {:?} instead of [1, channels, height, width]",
                value.shape()
            );
            return Err(self.unfit_head(index, reason));
        };
        if value.datum_type() != f32::datum_type() {
            let reason = format!("is of {:?} instead of f32", value.datum_type());
            return Err(self.unfit_head(index, reason));
        }
        let numbers = guarded(|| value.try_as_plain_ram()?.as_slice::<f32>())
            .map_err(|reason| self.unfit_head(index, reason))?;
        Ok((numbers, [channels, height, width]))
    }
}

/// Does what depends on a model file. A broken one may make tract panic, or what looks for the engine's layers; that must not take the
/// caller with it.
pub(crate) fn guarded<T>(work: impl FnOnce() -> TractResult<T>) -> Result<T, String> {
    match catch_unwind(AssertUnwindSafe(work)) {
        Ok(Ok(value)) => Ok(value),
        Ok(Err(error)) => Err(format!("{error:#}").replace('\n', " ")),
        Err(_) => Err("it made the program panic; the file is broken or unsupported".to_owned()),
    }
}

#[cfg(test)]
#[allow(clippy::expect_used)]
mod tests {
    use tract_onnx::pb::type_proto;

    use super::*;

    const NETWORKS: [&str; 5] = [
        "baseline",
        "vanilla",
        "adaptive",
        "tiny-adaptive",
        "large-adaptive",
    ];

    /// Whoever follows a tensor back to its makers would go round and round; and memory ends.
    #[test]
    fn nodes_out_of_order_and_windows_beyond_all_pictures_are_refused() {
        let node = |input: &str, output: &str| NodeProto {
            op_type: "Relu".to_owned(),
            input: vec![input.to_owned(), String::new()],
            output: vec![output.to_owned()],
            ..NodeProto::default()
        };
        let graph = |nodes: &[NodeProto]| GraphProto {
            input: vec![tract_onnx::pb::ValueInfoProto {
                name: "x".to_owned(),
                ..Default::default()
            }],
            node: nodes.to_vec(),
            ..GraphProto::default()
        };
        let in_order = [node("x", "a"), node("a", "b")];
        assert_eq!(check_nodes(&graph(&in_order)), Ok(()));
        for wrong in [
            [node("b", "a"), node("a", "b")],
            [node("a", "b"), node("x", "a")],
            [node("x", "a"), node("c", "b")],
        ] {
            let refused = check_nodes(&graph(&wrong)).expect_err("not in order");
            assert!(refused.contains("nothing before it makes"), "{refused}");
        }
        for twice in ["x", "a"] {
            let refused = check_nodes(&graph(&[node("x", "a"), node("a", twice)]));
            assert!(
                refused.is_err_and(|e| e.contains("there already")),
                "{twice}"
            );
        }
        for (pixels, taken) in [(16384, true), (-1, true), (16385, false), (i64::MIN, false)] {
            let mut padded = node("x", "a");
            padded.attribute = vec![tract_onnx::pb::AttributeProto {
                name: "pads".to_owned(),
                ints: vec![0, 0, 0, pixels],
                ..Default::default()
            }];
            assert_eq!(
                check_windows(&graph(&[padded.clone()]), &[]).is_ok(),
                taken,
                "{pixels}"
            );
            // As an input, which is how files from opset 11 on pad, in an inner graph, of a constant outside of it.
            let mut within = node("x", "c");
            within.op_type = "Pad".to_owned();
            within.input[1] = "pads".to_owned();
            let mut branching = node("x", "b");
            branching.attribute = vec![tract_onnx::pb::AttributeProto {
                g: Some(graph(&[within])),
                ..Default::default()
            }];
            let mut whole = graph(&[branching]);
            whole.initializer = vec![TensorProto {
                name: "pads".to_owned(),
                data_type: DataType::Int64 as i32,
                dims: vec![2],
                int64_data: vec![0, pixels],
                ..TensorProto::default()
            }];
            assert_eq!(check_windows(&whole, &[]).is_ok(), taken, "{pixels} within");
        }
        let mut own = node("x", "a");
        own.op_type = engine::ISLAND.to_owned();
        assert!(check_windows(&graph(&[own]), &[]).is_err());
    }

    fn shipped(name: &str) -> Model {
        Model::from_file(&models().join(name)).expect("a shipped model")
    }

    /// The dynamo exporter and ONNX's own shape inference write such names, and a graph's first Cast or Slice keeps them.
    #[test]
    fn names_of_sizes_between_nodes_do_not_matter() {
        let mut model = shipped("adaptive-f32.onnx");
        let graph = model.proto.graph.as_mut().expect("a graph");
        for input in graph.node.iter_mut().flat_map(|node| &mut node.input) {
            if *input == "input" {
                *input = "same".to_owned();
            }
        }
        graph.node.insert(
            0,
            NodeProto {
                op_type: "Identity".to_owned(),
                input: vec!["input".to_owned()],
                output: vec!["same".to_owned()],
                ..NodeProto::default()
            },
        );
        let mut named = graph.input[0].clone();
        named.name = "same".to_owned();
        if let Some(TypeValue::TensorType(tensor)) =
            named.r#type.as_mut().and_then(|t| t.value.as_mut())
        {
            let dimensions = tensor.shape.iter_mut().flat_map(|shape| &mut shape.dim);
            for (dimension, name) in dimensions.zip(["n", "c", "h", "w"]) {
                dimension.value = Some(Dimension::DimParam(name.to_owned()));
            }
        }
        graph.value_info.push(named);
        let network = |model: &Model| Network::new(model, (64, 64), &["residual"]).map(|_| ());
        // If tract takes them one day, there is nothing to forget.
        assert!(network(&model).is_err());
        forget_names_of_sizes(&mut model.proto);
        network(&model).expect("a network");
    }

    /// What [`crate::Estimator::new`] would refuse, [`Model::inspect`] does not call sound.
    #[test]
    fn inspection_holds_the_outputs_against_the_contract() {
        for precision in ["f32", "int8"] {
            let model = || shipped(&format!("adaptive-{precision}.onnx"));
            assert!(model().inspect().is_ok());
            let mut named = model();
            let attention = named.contract.attention.as_mut().expect("an attention");
            attention.output = "attentions".to_owned();
            let mut swapped = model();
            swapped.contract.residual = "slope".to_owned();
            let mut fewer = model();
            let slope = fewer.contract.slope.as_mut().expect("slopes");
            let angles = [-1.0, 0.0, 1.0].map(gedepth_core::Angle::from_degrees);
            let sign = gedepth_core::slope::SlopeSign::DownhillPositive;
            slope.classes = gedepth_core::slope::SlopeClasses::new(&angles, sign).expect("classes");
            for (model, says) in [
                (named, "no output `attentions`"),
                (swapped, "`slope`: has 11 channels instead of 1"),
                (fewer, "`slope`: has 11 channels instead of 3"),
            ] {
                let refused = model.inspect().expect_err("not what it says").to_string();
                assert!(refused.contains(says), "{refused}");
            }
        }
    }

    /// Files of other tools that look like models for this runtime and are not quite.
    #[test]
    fn inputs_that_are_not_the_contracts_are_refused() {
        let change = |change: &dyn Fn(&mut type_proto::Tensor)| {
            let mut model = shipped("baseline-f32.onnx");
            let graph = model.proto.graph.as_mut().expect("a graph");
            let value = graph.input[0]
                .r#type
                .as_mut()
                .and_then(|t| t.value.as_mut());
            if let Some(TypeValue::TensorType(tensor)) = value {
                change(tensor);
            }
            check_graph(&model.proto, &model.contract)
        };
        let sizes = |sizes: [i64; 4]| {
            move |tensor: &mut type_proto::Tensor| {
                let dimensions = tensor.shape.iter_mut().flat_map(|shape| &mut shape.dim);
                for (dimension, size) in dimensions.zip(sizes) {
                    dimension.value = Some(Dimension::DimValue(size));
                }
            }
        };
        assert_eq!(change(&sizes([1, 3, 64, 96])), Ok(Some((96, 64))));
        for (changed, says) in [
            (change(&|t| t.elem_type = DataType::Uint8 as i32), "UINT8"),
            (change(&sizes([4, 3, 64, 96])), "one picture at a time"),
            (change(&sizes([1, 4, 64, 96])), "[1, 4, 64, 96]"),
            (change(&sizes([1, 3, 64, 90])), "size_multiple is 32"),
            (change(&sizes([1, 3, 32, 32768])), "each side must be 1 to"),
            (
                change(&sizes([1, 3, 4096, 8192])),
                "more than 16777216 pixels",
            ),
        ] {
            let refused = changed.expect_err("not the contract's");
            assert!(refused.contains(says), "{refused}");
        }
        for (kind, says) in [(DataType::Uint16, "UINT16"), (DataType::Int4, "INT4")] {
            let mut model = shipped("baseline-int8.onnx");
            let graph = model.proto.graph.as_mut().expect("a graph");
            let quantize = graph.node.iter().find(|n| n.op_type == "QuantizeLinear");
            let zero = quantize.expect("a quantized model").input[2].clone();
            let mut weights = graph.initializer.iter_mut();
            weights
                .find(|t| t.name == zero)
                .expect("a zero point")
                .data_type = kind as i32;
            let refused = check_nodes(graph).expect_err("not 8 bits");
            assert!(
                refused.contains(says) && refused.contains("8 bits"),
                "{refused}"
            );
        }
        // Said by the node itself, as from opset 21 on.
        for (kind, taken) in [(DataType::Uint16, false), (DataType::Int8, true)] {
            let mut model = shipped("baseline-int8.onnx");
            let graph = model.proto.graph.as_mut().expect("a graph");
            let mut nodes = graph.node.iter_mut();
            let quantize = nodes.find(|n| n.op_type == "QuantizeLinear");
            let quantize = quantize.expect("a quantized model");
            quantize.input.truncate(2);
            quantize.attribute.push(tract_onnx::pb::AttributeProto {
                name: "output_dtype".to_owned(),
                i: kind as i64,
                ..Default::default()
            });
            assert_eq!(check_nodes(graph).is_ok(), taken, "{kind:?}");
        }
        let mut model = shipped("baseline-f32.onnx");
        let graph = model.proto.graph.as_mut().expect("a graph");
        graph.initializer[0].data_location = Some(DataLocation::External as i32);
        let refused = check_nodes(graph).expect_err("weights elsewhere");
        assert!(refused.contains("another file"), "{refused}");
    }

    fn models() -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../fixtures/models")
    }

    /// A tensor file as ONNX's own test data has them.
    fn tensor(path: &Path) -> Vec<f32> {
        let file = std::fs::File::open(path).expect("a golden file");
        let proto = tract_onnx::tensor::proto_from_reader(file).expect("a tensor");
        let tensor = tract_onnx::tensor::load_tensor(
            &tract_onnx::data_resolver::MmapDataResolver,
            &proto,
            None,
        )
        .expect("a tensor");
        let plain = tensor.try_as_plain_ram().expect("numbers");
        plain.as_slice::<f32>().expect("f32").to_vec()
    }

    /// Largest and mean difference of each output from what ONNX Runtime gave for the same input.
    fn differences(name: &str, engine: Engine) -> Vec<(f32, f32)> {
        let golden = models().join("golden").join(name);
        let model = Model::from_file(&models().join(format!("{name}.onnx")))
            .expect("a shipped model")
            .with_engine(engine);
        let mut outputs = vec!["residual"];
        outputs.extend(model.contract.attention.as_ref().map(|_| "attention"));
        outputs.extend(model.contract.slope.as_ref().map(|_| "slope"));
        let mut network = Network::new(&model, (96, 64), &outputs).expect("a network");
        let input = tensor(&golden.join("input.pb"));
        network
            .fill_input(|entrance| entrance.write_planes(&input))
            .expect("filled");
        network.run().expect("a run");
        let (values, _) = network.outputs();
        let compare = |(index, output): (usize, &&str)| {
            let (ours, _) = values.head(index).expect("a head");
            let theirs = tensor(&golden.join(format!("{output}.pb")));
            assert_eq!(ours.len(), theirs.len());
            let differences: Vec<f32> = ours
                .iter()
                .zip(&theirs)
                .map(|(a, b)| (a - b).abs())
                .collect();
            let largest = differences.iter().copied().fold(0.0, f32::max);
            let mean = differences.iter().sum::<f32>() / differences.len() as f32;
            println!("{name} {output}: largest difference {largest}, mean {mean}");
            (largest, mean)
        };
        outputs.iter().enumerate().map(compare).collect()
    }

    /// Every integer is the same; only the last step, from 32-bit sums to f32, rounds in its own order.
    #[test]
    fn int8_networks_give_what_onnx_runtime_gives() {
        let engine = Engine::Quantized {
            kernel: engine::Kernel::best(),
            threads: 1,
        };
        for mode in NETWORKS {
            for (largest, _) in differences(&format!("{mode}-int8"), engine) {
                assert!(largest < 1e-4, "{mode}: {largest}");
            }
        }
    }

    #[test]
    fn f32_networks_give_what_onnx_runtime_gives() {
        for mode in NETWORKS {
            for (largest, _) in differences(&format!("{mode}-f32"), Engine::Tract) {
                assert!(largest < 1e-3, "{mode}: {largest}");
            }
        }
    }
}
