//! An island made ready for one size of picture: weights packed, memory laid out, work shared out.
//!
//! Every byte tensor has its place in one arena; places are given again once the last reader is done. A layer's rows are
//! shared out among the threads, which meet after each layer. A run allocates nothing.
//!
//! [`memory`] says where each tensor lies, [`plan`] makes a [`step`] of each stage, [`run`] is what a thread does of it.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering::SeqCst};
use std::time::{Duration, Instant};

use super::arena::{Arena, Shared};
use super::island::Island;
use super::kernels::Kernel;
use super::layer::{Quantization, Shape};
use super::profile::{LayerTime, Times};
use super::stages::stages;
use super::threads::{Member, Team, stay_on};
use buffer::Buffer;
use memory::{Planes, place, place_floats};
use plan::Plan;
use run::{Run, write_rows};
use step::{Source, Step, Work};

mod buffer;
mod convolution;
mod memory;
mod plan;
mod run;
mod step;

/// An island ready to run.
#[derive(Debug)]
pub(crate) struct Schedule {
    kernel: Kernel,
    steps: Vec<Step>,
    /// What the first step writes, where bytes can be written instead of quantizing the only input.
    entrance: Option<(Buffer, Quantization)>,
    arena: Arena,
    /// f32 tensors that do not leave the island.
    floats: Vec<f32>,
    team: Team,
    /// What each step is.
    layers: Vec<LayerTime>,
    /// Where somebody measures.
    times: Option<Times>,
    /// A row of f32 for each member.
    scratch: Vec<Mutex<Vec<f32>>>,
    /// Rows of inlined steps, for each member.
    rows: Vec<Mutex<Arena>>,
    inputs: Vec<Shape>,
    outputs: Vec<Shape>,
}

/// What a schedule runs on.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Inputs<'a> {
    /// The island's f32 tensors, planar.
    Planes(&'a [&'a [f32]]),
    /// What [`Schedule::enter`] wrote.
    Entered,
}

impl Schedule {
    /// Plans `island` for inputs of these shapes. The error says what about the model cannot be done.
    pub(crate) fn new(
        island: &Island,
        inputs: &[Shape],
        kernel: Kernel,
        threads: usize,
    ) -> Result<Self, String> {
        if !kernel.is_supported() {
            return Err(format!("this processor has no {kernel:?}"));
        }
        let shapes = island.shapes(inputs)?;
        let shape = |name: &String| {
            shapes
                .get(name.as_str())
                .copied()
                .ok_or_else(|| format!("`{name}` is not made"))
        };
        let outputs: Vec<Shape> = island.outputs.iter().map(shape).collect::<Result<_, _>>()?;
        let order = stages(&island.layers, &shapes, threads);
        let (buffers, arena) = place(&order, &shapes, kernel)?;
        let (planes, floats) = place_floats(island, &order, &shapes)?;
        let plan = Plan {
            kernel,
            shapes: &shapes,
            buffers,
            planes,
        };
        let steps = order
            .iter()
            .map(|stage| plan.stage(stage))
            .collect::<Result<Vec<_>, _>>()?;
        let layers = order
            .iter()
            .map(|stage| LayerTime::new(stage, &shapes))
            .collect();
        let team = Team::new(threads);
        let widest = steps.iter().map(Step::scratch).max().unwrap_or(0);
        let longest = steps.iter().map(Step::inlined_bytes).max().unwrap_or(0);
        let members = 0..team.members();
        let scratch = members
            .clone()
            .map(|_| Mutex::new(vec![0.0; widest]))
            .collect();
        let rows = members.map(|_| Mutex::new(Arena::new(longest))).collect();
        Ok(Self {
            kernel,
            entrance: entrance(&steps),
            steps,
            arena: Arena::new(arena),
            floats: vec![0.0; floats],
            team,
            layers,
            times: None,
            scratch,
            rows,
            inputs: inputs.to_vec(),
            outputs,
        })
    }

    /// Shapes of the f32 tensors that it writes; those of two dimensions have height and width 1.
    pub(crate) fn output_shapes(&self) -> &[Shape] {
        &self.outputs
    }

    /// How the bytes that [`Schedule::enter`] writes stand for real numbers; `None` where it cannot be called.
    pub(crate) fn entrance_quantization(&self) -> Option<Quantization> {
        self.entrance.map(|(_, quantization)| quantization)
    }

    /// Runs `job(thread)` once on every thread, 0 the caller's.
    pub(crate) fn share(&mut self, job: &(dyn Fn(usize) + Sync)) -> Result<(), String> {
        let whole = self.team.run(&|member: &Member<'_>| job(member.number));
        whole.then_some(()).ok_or_else(panicked)
    }

    /// Keeps each thread on one of `cores`, in order, the caller's on the first.
    pub(crate) fn pin(&mut self, cores: &[usize]) -> Result<(), String> {
        if cores.is_empty() {
            return Err("there are none; give at least one".to_owned());
        }
        let refused = AtomicBool::new(false);
        self.share(&|thread| {
            if !stay_on(cores[thread % cores.len()]) {
                refused.store(true, SeqCst);
            }
        })?;
        match refused.into_inner() {
            true => Err("the system refuses; give cores that this process may use".to_owned()),
            false => Ok(()),
        }
    }

    /// From now on measures how long each step takes.
    pub(crate) fn measure(&mut self) {
        self.times = Some(Times::new(self.steps.len()));
    }

    /// Times of the steps in all runs since [`Schedule::measure`].
    pub(crate) fn times(&self) -> Vec<LayerTime> {
        let time = |(number, layer): (usize, &LayerTime)| LayerTime {
            time: self
                .times
                .as_ref()
                .map_or(Duration::ZERO, |times| times.of(number)),
            ..layer.clone()
        };
        self.layers.iter().enumerate().map(time).collect()
    }

    /// Number of threads that run it.
    pub(crate) fn members(&self) -> usize {
        self.team.members()
    }

    /// Writes the only input's bytes, four a pixel: `row(member, y, bytes)` for each of its rows.
    pub(crate) fn enter(
        &mut self,
        row: &(dyn Fn(usize, usize, &mut [u8]) + Sync),
    ) -> Result<(), String> {
        let (buffer, _) = self.entrance.ok_or("the island takes f32")?;
        let arena = Shared::new(self.arena.bytes());
        let whole = self.team.run(&|member: &Member<'_>| {
            write_rows(&arena, &buffer, member.share(buffer.height), |y, out| {
                row(member.number, y, out)
            });
        });
        whole.then_some(()).ok_or_else(panicked)
    }

    /// Runs the island; planar f32 out.
    pub(crate) fn run(
        &mut self,
        inputs: Inputs<'_>,
        outputs: &[Shared<'_, f32>],
    ) -> Result<(), String> {
        let fits = |planes: &[&[f32]]| {
            let mut pairs = self.inputs.iter().zip(planes);
            self.inputs.len() == planes.len()
                && pairs.all(|(shape, plane)| shape.iter().product::<usize>() == plane.len())
        };
        let (inputs, steps) = match inputs {
            Inputs::Planes(planes) if !fits(planes) => {
                return Err(
                    "the island's inputs are not of the sizes that it was planned for".to_owned(),
                );
            }
            Inputs::Planes(planes) => (planes, &self.steps[..]),
            Inputs::Entered => (&[][..], &self.steps[1..]),
        };
        let run = Run {
            kernel: self.kernel,
            arena: Shared::new(self.arena.bytes()),
            floats: Shared::new(&mut self.floats),
            scratch: &self.scratch,
            rows: &self.rows,
            inputs,
            outputs,
        };
        let first = self.steps.len() - steps.len();
        let times = self.times.as_ref();
        let whole = self.team.run(&|member: &Member<'_>| {
            let times = times.filter(|_| member.number == 0);
            let mut since = times.map(|_| Instant::now());
            for (number, step) in steps.iter().enumerate() {
                run.step(step, member);
                if !member.wait() {
                    return;
                }
                if let (Some(times), Some(since)) = (times, &mut since) {
                    *since = times.add(first + number, *since);
                }
            }
        });
        whole.then_some(()).ok_or_else(panicked)
    }
}

/// The first step's output and quantization, if it quantizes the only input, to four bytes a pixel.
fn entrance(steps: &[Step]) -> Option<(Buffer, Quantization)> {
    let (first, rest) = steps.split_first()?;
    let takes_f32 = |step: &Step| match &step.work {
        Work::Quantize { input, .. } => matches!(input, Planes::Input(_)),
        Work::Elementwise { sources, .. } => {
            let is_input = |source: &Source| matches!(source, Source::Floats(Planes::Input(_), _));
            sources.iter().any(is_input)
        }
        _ => false,
    };
    match (&first.work, first.writes) {
        (&Work::Quantize { quantization, .. }, Some(buffer))
            if buffer.pitch == 4 && takes_f32(first) && !rest.iter().any(takes_f32) =>
        {
            Some((buffer, quantization))
        }
        _ => None,
    }
}

fn panicked() -> String {
    "the engine panicked on it; please report the model".to_owned()
}
