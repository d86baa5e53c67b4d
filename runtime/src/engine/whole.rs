//! A network that is one island from input to outputs: it runs without tract, and without an allocation per run.

use tract_onnx::pb::ModelProto;
use tract_onnx::prelude::{TVec, tvec};

use super::arena::Shared;
use super::island::ISLAND;
use super::layer::Shape;
use super::operator::read;
use super::pixels::{PixelRow, Pixels};
use super::profile::LayerTime;
use super::schedule::{Inputs, Schedule};

/// Such a network, planned, and the outputs of its last run.
#[derive(Debug)]
pub(crate) struct Whole {
    schedule: Schedule,
    input: Input,
    results: Results,
}

/// The outputs of the last run.
#[derive(Debug)]
pub(crate) struct Results {
    /// Of the island, planar.
    outputs: Vec<(Shape, Vec<f32>)>,
    /// Where each output of the graph is among them.
    order: Vec<usize>,
}

impl Results {
    /// An output of the graph, planar, and its shape.
    pub(crate) fn output(&self, index: usize) -> (&[f32], Shape) {
        let (shape, values) = &self.outputs[self.order[index]];
        (values, *shape)
    }
}

/// The threads that ran a [`Whole`], for what comes after it.
pub(crate) struct Threads<'a>(&'a mut Schedule);

impl Threads<'_> {
    /// How many there are.
    pub(crate) fn count(&self) -> usize {
        self.0.members()
    }

    /// Runs `job(thread)` once on each.
    pub(crate) fn share(&mut self, job: &(dyn Fn(usize) + Sync)) -> Result<(), String> {
        self.0.share(job)
    }
}

/// What a [`Whole`] reads.
#[derive(Debug)]
enum Input {
    /// `[channels, height, width]`.
    Planes(Vec<f32>),
    /// Bytes, of up to four channels.
    Pixels(Pixels),
}

/// Where to write what a [`Whole`] reads.
pub(crate) enum Entrance<'a> {
    /// `[channels, height, width]`; what is not written again stays from run to run.
    Planes(&'a mut [f32]),
    /// Pixels, all of them for every run.
    Pixels(PixelEntrance<'a>),
}

/// Where pixels are written, on all threads.
pub(crate) struct PixelEntrance<'a> {
    schedule: &'a mut Schedule,
    /// What becomes of them.
    pub(crate) pixels: &'a mut Pixels,
}

impl Entrance<'_> {
    /// Writes planes of f32, quantized where and as the first layer would.
    #[cfg(test)]
    pub(crate) fn write_planes(self, planes: &[f32]) -> Result<(), String> {
        match self {
            Entrance::Planes(input) => {
                input.copy_from_slice(planes);
                Ok(())
            }
            Entrance::Pixels(PixelEntrance { schedule, pixels }) => {
                schedule.enter(&|_, y, out| pixels.quantize(planes, y, out))
            }
        }
    }
}

impl PixelEntrance<'_> {
    /// Calls `row(thread, y, pixels)` for every row.
    pub(crate) fn write(
        &mut self,
        row: impl Fn(usize, usize, PixelRow<'_>) + Sync,
    ) -> Result<(), String> {
        let pixels = &*self.pixels;
        self.schedule
            .enter(&|thread, y, out| row(thread, y, pixels.row(y, out)))
    }

    /// Number of threads.
    pub(crate) fn threads(&self) -> usize {
        self.schedule.members()
    }
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
        let input = match schedule.entrance_quantization() {
            Some(quantization) => Input::Pixels(Pixels::new(quantization, [input[1], input[2]])),
            None => Input::Planes(vec![0.0; input.iter().product()]),
        };
        Some(Self {
            schedule,
            input,
            results: Results { outputs, order },
        })
    }

    /// Where to write its input.
    pub(crate) fn entrance(&mut self) -> Entrance<'_> {
        match &mut self.input {
            Input::Planes(planes) => Entrance::Planes(planes),
            Input::Pixels(pixels) => Entrance::Pixels(PixelEntrance {
                schedule: &mut self.schedule,
                pixels,
            }),
        }
    }

    /// Keeps each thread on one of `cores`, in order, the caller's on the first.
    pub(crate) fn pin(&mut self, cores: &[usize]) -> Result<(), String> {
        self.schedule.pin(cores)
    }

    /// From now on measures how long each layer takes.
    pub(crate) fn measure(&mut self) {
        self.schedule.measure();
    }

    /// Times of the layers in all runs since [`Whole::measure`].
    pub(crate) fn times(&self) -> Vec<LayerTime> {
        self.schedule.times()
    }

    /// Runs it on what was written. Up to four outputs it allocates nothing.
    pub(crate) fn run(&mut self) -> Result<(), String> {
        let mut outputs: TVec<Shared<'_, f32>> = tvec!();
        outputs.extend(
            self.results
                .outputs
                .iter_mut()
                .map(|(_, values)| Shared::new(values)),
        );
        match &self.input {
            Input::Planes(planes) => self.schedule.run(Inputs::Planes(&[planes]), &outputs),
            Input::Pixels(_) => self.schedule.run(Inputs::Entered, &outputs),
        }
    }

    /// What the last run gave, and the threads that ran it.
    pub(crate) fn results(&mut self) -> (&Results, Threads<'_>) {
        (&self.results, Threads(&mut self.schedule))
    }
}
