//! What a model file holds and how it will be run: what `gedepth inspect` prints.

use std::collections::{BTreeMap, HashSet};
use std::path::{Path, PathBuf};

use serde::Serialize;
use tract_onnx::pb::tensor_proto::DataType;
use tract_onnx::pb::tensor_shape_proto::dimension::Value as Dimension;
use tract_onnx::pb::type_proto::Value as TypeValue;
use tract_onnx::pb::{ModelProto, StringStringEntryProto, TensorProto, ValueInfoProto};

use crate::Error;
use crate::calibration::{Calibration, Distortion, Numbers};
use crate::engine::{InspectedNode, Place};
use crate::estimator::{Estimator, OutputSize};
use crate::model::{Model, Size, guarded};

/// What a model file holds and how it will be run.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Inspection {
    /// The file.
    #[serde(serialize_with = "as_text")]
    pub path: PathBuf,
    /// Entries of its contract, `gedepth.` left out.
    pub contract: BTreeMap<String, String>,
    /// Its inputs.
    pub inputs: Vec<InspectedTensor>,
    /// Its outputs.
    pub outputs: Vec<InspectedTensor>,
    /// Its weights.
    pub weights: Weights,
    /// Width and height, pixels, that the rest is for.
    pub size: (u32, u32),
    /// Who runs it.
    pub plan: PlanKind,
    /// Its nodes in the form that the engine works on, constants aside.
    pub nodes: Vec<InspectedNode>,
}

impl Model {
    /// What the file holds and who will run which of its nodes, at the size that the file fixes or that the network was
    /// made for. Runs it once, as an estimator of some camera, so that it fails where [`Estimator::new`] would.
    pub fn inspect(&self) -> Result<Inspection, Error> {
        let size = self.fixed_size().unwrap_or(self.contract().nominal_size);
        let camera = some_camera(size)?;
        let estimator = Estimator::new(self, &camera, size, Some(size), OutputSize::Network)?;
        let graph = self.proto.graph.as_ref();
        let inspected = guarded(|| Ok(self.engine().inspect(&self.proto)));
        let mut nodes = inspected.map_err(|reason| Error::Model {
            path: self.path().to_owned(),
            reason,
        })?;
        let plan = estimator.plan();
        if let PlanKind::Tract {
            islands_refused: Some(reason),
        } = &plan
        {
            for node in &mut nodes {
                if matches!(node.place, Place::Engine { .. }) {
                    node.place = Place::Tract {
                        reason: format!("the engine cannot plan its part: {reason}"),
                    };
                }
            }
        }
        let entries = self.proto.metadata_props.iter();
        let entry = |e: &StringStringEntryProto| {
            Some((e.key.strip_prefix("gedepth.")?.to_owned(), e.value.clone()))
        };
        let weights: HashSet<&str> = graph
            .iter()
            .flat_map(|graph| graph.initializer.iter().map(|t| t.name.as_str()))
            .collect();
        let mut inputs = graph.map_or(Vec::new(), |graph| InspectedTensor::all(&graph.input));
        inputs.retain(|input| !weights.contains(input.name.as_str()));
        Ok(Inspection {
            path: self.path().to_owned(),
            contract: entries.filter_map(entry).collect(),
            inputs,
            outputs: graph.map_or(Vec::new(), |graph| InspectedTensor::all(&graph.output)),
            weights: Weights::of(&self.proto),
            size,
            plan,
            nodes,
        })
    }
}

/// One that looks along the ground, 1.5 m over it.
fn some_camera(size: Size) -> Result<Calibration, Error> {
    let [width, height] = [size.0, size.1].map(f64::from);
    let numbers = Numbers {
        size: Some(size),
        k: [
            [width, 0.0, width / 2.0],
            [0.0, width, height / 2.0],
            [0.0, 0.0, 1.0],
        ],
        distortion: Distortion::None,
        r: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        t: [0.0; 3],
        up: [0.0, -1.0, 0.0],
        offset: -1.5,
    };
    Calibration::new(Path::new("some camera"), &numbers)
}

/// Paths need not be UTF-8, JSON has to be.
fn as_text<S: serde::Serializer>(path: &Path, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_str(&path.display())
}

/// An input or output.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct InspectedTensor {
    /// Its name.
    pub name: String,
    /// Its dimensions as the file states them: a number, a name, or `?`.
    pub shape: Vec<String>,
}

/// Size of a model's constants.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Weights {
    /// Number of tensors.
    pub tensors: usize,
    /// Number of elements.
    pub numbers: u64,
    /// Bytes that they take in the file.
    pub bytes: u64,
}

/// Who runs a network.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "by", rename_all = "snake_case")]
#[non_exhaustive]
pub enum PlanKind {
    /// The engine alone, without an allocation per picture.
    Engine,
    /// tract, with islands that the engine runs.
    TractWithIslands,
    /// tract alone.
    #[non_exhaustive]
    Tract {
        /// Why the islands that there are cannot be planned; absent where there are none.
        #[serde(skip_serializing_if = "Option::is_none")]
        islands_refused: Option<String>,
    },
}

impl InspectedTensor {
    pub(crate) fn all(values: &[ValueInfoProto]) -> Vec<Self> {
        let tensor = |value: &ValueInfoProto| Self {
            name: value.name.clone(),
            shape: shape(value),
        };
        values.iter().map(tensor).collect()
    }
}

fn shape(value: &ValueInfoProto) -> Vec<String> {
    let Some(TypeValue::TensorType(tensor)) = value.r#type.as_ref().and_then(|t| t.value.as_ref())
    else {
        return Vec::new();
    };
    let dimensions = tensor.shape.iter().flat_map(|shape| &shape.dim);
    let dimension = |value: &Option<Dimension>| match value {
        Some(Dimension::DimValue(n)) => n.to_string(),
        Some(Dimension::DimParam(name)) if !name.is_empty() => name.clone(),
        _ => "?".to_owned(),
    };
    dimensions.map(|d| dimension(&d.value)).collect()
}

impl Weights {
    pub(crate) fn of(model: &ModelProto) -> Self {
        let graph = model.graph.iter();
        let constants = graph.flat_map(|graph| {
            let attributes = graph.node.iter().flat_map(|node| &node.attribute);
            graph
                .initializer
                .iter()
                .chain(attributes.filter_map(|a| a.t.as_ref()))
        });
        constants.fold(Self::default(), |sum, tensor| {
            let numbers = tensor
                .dims
                .iter()
                .map(|&n| n.max(0).unsigned_abs())
                .product::<u64>();
            Self {
                tensors: sum.tensors + 1,
                numbers: sum.numbers + numbers,
                bytes: sum.bytes + numbers * element_bytes(tensor),
            }
        })
    }
}

fn element_bytes(tensor: &TensorProto) -> u64 {
    match DataType::try_from(tensor.data_type) {
        Ok(DataType::Uint8 | DataType::Int8 | DataType::Bool) => 1,
        Ok(DataType::Uint16 | DataType::Int16 | DataType::Float16 | DataType::Bfloat16) => 2,
        Ok(DataType::Double | DataType::Int64 | DataType::Uint64) => 8,
        _ => 4,
    }
}
