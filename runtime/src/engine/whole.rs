//! A network that is one island from input to outputs: it runs without tract, and without an allocation per run.

use tract_onnx::pb::ModelProto;
use tract_onnx::prelude::{TVec, tvec};

use super::arena::Shared;
use super::island::ISLAND;
use super::layer::Shape;
use super::operator::read;
use super::schedule::Schedule;

/// Such a network, planned, and the outputs of its last run.
#[derive(Debug)]
pub(crate) struct Whole {
    schedule: Schedule,
    /// Of the island, planar.
    outputs: Vec<(Shape, Vec<f32>)>,
    /// Where each output of the graph is among them.
    order: Vec<usize>,
}

impl Whole {
    /// Plans a model that [`super::Engine::split`] made; `None` where it is not one island, or cannot be planned.
    pub(crate) fn new(split: &ModelProto, input: Shape) -> Option<Self> {
        let graph = split.graph.as_ref()?;
        let [node] = graph.node.as_slice() else {
            return None;
        };
        if node.op_type != ISLAND
            || node.input.len() != 1
            || graph.input.iter().all(|i| i.name != node.input[0])
        {
            return None;
        }
        let (island, kernel, threads) = read(node)?;
        let place = |name: &String| island.outputs.iter().position(|output| output == name);
        let order = graph
            .output
            .iter()
            .map(|output| place(&output.name))
            .collect::<Option<Vec<_>>>()?;
        let schedule = Schedule::new(&island, &[input], kernel, threads).ok()?;
        let buffer = |&shape: &Shape| (shape, vec![0.0; shape.iter().product()]);
        let outputs = schedule.output_shapes().iter().map(buffer).collect();
        Some(Self {
            schedule,
            outputs,
            order,
        })
    }

    /// Runs it on planar f32. Up to four outputs it allocates nothing.
    pub(crate) fn run(&mut self, input: &[f32]) -> Result<(), String> {
        let mut outputs: TVec<Shared<'_, f32>> = tvec!();
        outputs.extend(
            self.outputs
                .iter_mut()
                .map(|(_, values)| Shared::new(values)),
        );
        self.schedule.run(&[input], &outputs)
    }

    /// An output of the graph, planar, and its shape.
    pub(crate) fn output(&self, index: usize) -> (&[f32], Shape) {
        let (shape, values) = &self.outputs[self.order[index]];
        (values, *shape)
    }
}
