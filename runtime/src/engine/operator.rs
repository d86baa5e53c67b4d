//! An island as an operator of tract.

use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};

use tract_onnx::model::ParsingContext;
use tract_onnx::pb::NodeProto;
use tract_onnx::tract_hir::internal::*;

use super::arena::Shared;
use super::island::{BODY, ISLAND, Island};
use super::kernels::Kernel;
use super::layer::Shape;
use super::recognize::graph::attribute;
use super::schedule::{Inputs, Schedule};

/// Names of the attributes of an island's node that say how to run it.
const THREADS: &str = "threads";
const KERNEL: &str = "kernel";

/// Writes into an island's node how to run it.
pub(crate) fn configure(node: &mut NodeProto, kernel: Kernel, threads: usize) {
    let number = |name: &str, i: i64| tract_onnx::pb::AttributeProto {
        name: name.to_owned(),
        i,
        ..Default::default()
    };
    let place = Kernel::ALL.iter().position(|k| *k == kernel).unwrap_or(0);
    node.attribute.push(number(THREADS, threads as i64));
    node.attribute.push(number(KERNEL, place as i64));
}

/// Teaches tract the islands' operator.
pub(crate) fn register(onnx: &mut tract_onnx::Onnx) {
    onnx.op_register.insert(ISLAND, build);
}

/// What an island's node says: its layers and how to run them.
pub(crate) fn read(node: &NodeProto) -> Option<(Island, Kernel, usize)> {
    let body = attribute(node, BODY)?.g.as_ref()?;
    let number = |name: &str| attribute(node, name).map_or(0, |a| a.i as usize);
    let kernel = Kernel::ALL
        .get(number(KERNEL))
        .copied()
        .unwrap_or(Kernel::Portable);
    Some((Island::from_body(body), kernel, number(THREADS)))
}

fn build(
    _: &ParsingContext<'_>,
    node: &NodeProto,
) -> TractResult<(Box<dyn InferenceOp>, Vec<String>)> {
    let (island, kernel, threads) = read(node).context("an island without a body")?;
    Ok((
        expand(Unplanned {
            island: Arc::new(island),
            kernel,
            threads,
        }),
        vec![],
    ))
}

/// An island before the sizes are known.
#[derive(Clone, Debug)]
struct Unplanned {
    island: Arc<Island>,
    kernel: Kernel,
    threads: usize,
}

/// The shape of an island's tensor as tract sees it.
fn dimensions(flat: bool, [channels, height, width]: Shape) -> TVec<usize> {
    if flat {
        tvec!(1, channels)
    } else {
        tvec!(1, channels, height, width)
    }
}

fn picture(shape: &[TDim]) -> TractResult<Shape> {
    match shape
        .iter()
        .map(|d| Ok(d.to_usize()?))
        .collect::<TractResult<Vec<_>>>()?[..]
    {
        [1, channels, height, width] => Ok([channels, height, width]),
        [1, channels] => Ok([channels, 1, 1]),
        _ => bail!("a quantized island reads [1, channels, height, width], not {shape:?}"),
    }
}

/// Shapes of the outputs, as tract sees them.
fn outputs(island: &Island, inputs: &[Shape]) -> TractResult<Vec<TVec<usize>>> {
    let shapes = island
        .shapes(inputs)
        .map_err(|reason| format_err!(reason))?;
    let shape = |name: &String| {
        shapes
            .get(name.as_str())
            .map(|shape| dimensions(island.flat.contains(name), *shape))
            .with_context(|| format!("`{name}` is not made"))
    };
    island.outputs.iter().map(shape).collect()
}

impl Expansion for Unplanned {
    fn name(&self) -> StaticName {
        ISLAND.into()
    }

    fn nboutputs(&self) -> TractResult<usize> {
        Ok(self.island.outputs.len())
    }

    fn rules<'r, 'p: 'r, 's: 'r>(
        &'s self,
        solver: &mut Solver<'r>,
        inputs: &'p [TensorProxy],
        writes: &'p [TensorProxy],
    ) -> InferenceResult {
        check_input_arity(inputs, self.island.inputs.len())?;
        check_output_arity(writes, self.island.outputs.len())?;
        for tensor in inputs.iter().chain(writes) {
            solver.equals(&tensor.datum_type, f32::datum_type())?;
        }
        let names = self.island.inputs.iter().chain(&self.island.outputs);
        for (name, tensor) in names.zip(inputs.iter().chain(writes)) {
            let rank = if self.island.flat.contains(name) {
                2
            } else {
                4
            };
            solver.equals(&tensor.rank, rank)?;
        }
        solver.given_all(
            inputs.iter().map(|input| &input.shape),
            move |solver, shapes: Vec<TVec<TDim>>| {
                let shapes: Vec<Shape> = shapes
                    .iter()
                    .map(|shape| picture(shape))
                    .collect::<TractResult<_>>()?;
                for (output, shape) in writes.iter().zip(outputs(&self.island, &shapes)?) {
                    let shape: TVec<TDim> = shape.iter().map(|n| n.to_dim()).collect();
                    solver.equals(&output.shape, ShapeFactoid::from(shape))?;
                }
                Ok(())
            },
        )
    }

    fn wire(
        &self,
        prefix: &str,
        model: &mut TypedModel,
        inputs: &[OutletId],
    ) -> TractResult<TVec<OutletId>> {
        let shapes: Vec<Shape> = inputs
            .iter()
            .map(|&input| picture(&model.outlet_fact(input)?.shape))
            .collect::<TractResult<_>>()?;
        let schedule = Schedule::new(&self.island, &shapes, self.kernel, self.threads)
            .map_err(|reason| format_err!(reason))?;
        let shapes = outputs(&self.island, &shapes)?;
        let outputs = shapes
            .iter()
            .map(|shape| Tensor::zero::<f32>(shape).map(Arc::new));
        let running = Running {
            schedule,
            outputs: outputs.collect::<TractResult<_>>()?,
        };
        let operator = Operator {
            shapes,
            running: Arc::new(Mutex::new(running)),
        };
        model.wire_node(prefix, operator, inputs)
    }
}

/// An island that runs.
#[derive(Clone)]
struct Operator {
    shapes: Vec<TVec<usize>>,
    running: Arc<Mutex<Running>>,
}

struct Running {
    schedule: Schedule,
    /// Those of the last run. They are written again if nobody holds them any more.
    outputs: Vec<Arc<Tensor>>,
}

impl fmt::Debug for Operator {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct(ISLAND)
            .field("outputs", &self.shapes)
            .finish_non_exhaustive()
    }
}

impl PartialEq for Operator {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.running, &other.running)
    }
}

impl Eq for Operator {}

impl Op for Operator {
    fn name(&self) -> StaticName {
        ISLAND.into()
    }

    op_as_typed_op!();
}

impl EvalOp for Operator {
    op_out_of_plan!();

    fn eval(&self, _: &EvalContext<'_>, inputs: TVec<TValue>) -> TractResult<TVec<TValue>> {
        let mut running = self.running.lock().unwrap_or_else(PoisonError::into_inner);
        let Running { schedule, outputs } = &mut *running;
        for output in outputs.iter_mut() {
            if Arc::get_mut(output).is_none() {
                *output = Arc::new(Tensor::zero::<f32>(output.shape())?);
            }
        }
        let reads: TVec<&[f32]> = inputs
            .iter()
            .map(|input| input.try_as_plain_ram()?.as_slice::<f32>())
            .collect::<TractResult<_>>()?;
        let mut views = outputs
            .iter_mut()
            .map(|output| {
                Arc::get_mut(output)
                    .context("an output that somebody holds")?
                    .try_as_plain_ram_mut()
            })
            .collect::<TractResult<TVec<_>>>()?;
        let writes: TVec<Shared<'_, f32>> = views
            .iter_mut()
            .map(|view| Ok(Shared::new(view.as_slice_mut::<f32>()?)))
            .collect::<TractResult<_>>()?;
        schedule
            .run(Inputs::Planes(&reads), &writes)
            .map_err(|reason| format_err!(reason))?;
        drop(writes);
        drop(views);
        Ok(outputs
            .iter()
            .map(|output| output.clone().into_tvalue())
            .collect())
    }
}

impl TypedOp for Operator {
    fn output_facts(&self, _: &[&TypedFact]) -> TractResult<TVec<TypedFact>> {
        Ok(self.shapes.iter().map(f32::fact).collect())
    }

    as_op!();
}
