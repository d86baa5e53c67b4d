//! Which layers run as one: what the threads do between two meetings.

use std::collections::HashMap;

use super::layer::{Convolution, Form, Layer, Operation, Padding, Shape, Window};

/// Widest convolution that shares one block with its siblings.
const SIBLING_LANES: usize = 16;

/// Bytes that a core's own cache does not hold beside all else.
const LARGE: usize = 1 << 20;
/// Of as many rows one may be made twice.
const REPEATED: usize = 16;

/// Layers that run as one.
#[derive(Debug)]
pub(super) struct Stage<'a> {
    /// Layers that only the main one or another of these reads: their rows are made when it needs them, in memory of the
    /// thread's own, which is still in its cache then.
    pub(super) inlined: Vec<&'a Layer>,
    /// The main layer; after it others that read the same, so that it is read once.
    pub(super) siblings: Vec<&'a Layer>,
}

impl<'a> Stage<'a> {
    /// Inlined ones first.
    pub(super) fn layers(&self) -> impl Iterator<Item = &'a Layer> {
        self.inlined.iter().chain(&self.siblings).copied()
    }
}

/// All layers in order, to be run by a number of threads.
pub(super) fn stages<'a>(
    layers: &'a [Layer],
    shapes: &HashMap<&str, Shape>,
    threads: usize,
) -> Vec<Stage<'a>> {
    let mut readers: HashMap<&str, usize> = HashMap::new();
    for input in layers.iter().flat_map(|layer| &layer.inputs) {
        *readers.entry(&input.name).or_default() += 1;
    }
    let mut producers: HashMap<&str, &Layer> = HashMap::new();
    for layer in layers {
        let once = readers.get(layer.output.as_str()) == Some(&1);
        if once && makes_rows(layer) {
            producers.insert(&layer.output, layer);
        }
    }
    let mut inlined: HashMap<&str, Vec<&Layer>> = HashMap::new();
    let mut moved: Vec<&str> = Vec::new();
    // Those that have rows made twice.
    let mut repeating: Vec<&str> = Vec::new();
    for layer in layers {
        for input in &layer.inputs {
            let Some(&producer) = producers.get(input.name.as_str()) else {
                continue;
            };
            let repeats = repeating.contains(&producer.output.as_str());
            let alone = reads_its_row_alone(layer, shapes) || takes_depthwise_row(layer, producer);
            if alone || !repeats && pays_twice(layer, producer, shapes, threads) {
                inlined.entry(&layer.output).or_default().push(producer);
                moved.push(&producer.output);
                if repeats || !alone {
                    repeating.push(&layer.output);
                }
            }
        }
    }
    with_siblings_together(layers)
        .into_iter()
        .filter(|siblings| !moved.contains(&siblings[0].output.as_str()))
        .map(|siblings| {
            let mut stage = Stage {
                inlined: Vec::new(),
                siblings,
            };
            gather(stage.siblings[0], &inlined, &mut stage.inlined);
            stage
        })
        .collect()
}

/// All that is inlined into a layer, and into that, what comes first first.
fn gather<'a>(layer: &Layer, inlined: &HashMap<&str, Vec<&'a Layer>>, all: &mut Vec<&'a Layer>) {
    for producer in inlined.get(layer.output.as_str()).into_iter().flatten() {
        gather(producer, inlined, all);
        all.push(producer);
    }
}

/// Whether its rows of bytes can be made one at a time, and making one is worth more than calling for it.
fn makes_rows(layer: &Layer) -> bool {
    matches!(layer.form, Form::Bytes { .. })
        && matches!(
            layer.operation,
            Operation::Convolution(_) | Operation::Resize(_)
        )
}

/// Whether a row of it takes that row of its inputs, and no other.
fn reads_its_row_alone(layer: &Layer, shapes: &HashMap<&str, Shape>) -> bool {
    let [_, height, width] = shapes[layer.output.as_str()];
    let same = |name: &str| shapes.get(name) == shapes.get(layer.output.as_str());
    matches!(layer.form, Form::Bytes { .. })
        && [height, width] != [1, 1]
        && match layer.operation {
            Operation::Add | Operation::Multiply | Operation::Table(_) => {
                layer.inputs.iter().all(|input| same(&input.name))
            }
            Operation::Concat => true,
            _ => false,
        }
}

/// The convolution of a layer, and whether it is depthwise.
fn convolution(layer: &Layer) -> Option<(&Convolution, bool)> {
    match &layer.operation {
        Operation::Convolution(c) => Some((c, c.depthwise)),
        _ => None,
    }
}

/// Whether it is the pointwise convolution of a depthwise one: takes that row and no other.
fn takes_depthwise_row(layer: &Layer, producer: &Layer) -> bool {
    let plain = Window {
        kernel: [1; 2],
        strides: [1; 2],
        dilations: [1; 2],
        padding: Padding::Explicit([0; 4]),
        ceil: false,
    };
    let pointwise = matches!(convolution(layer), Some((c, false)) if c.window == plain);
    pointwise
        && matches!(layer.form, Form::Bytes { .. })
        && matches!(convolution(producer), Some((_, true)))
}

/// Whether a depthwise layer had better have the rows made that its window takes, though each thread's first ones are made
/// by the thread before it too, than read them from a tensor that no cache of a core's own holds.
fn pays_twice(
    layer: &Layer,
    producer: &Layer,
    shapes: &HashMap<&str, Shape>,
    threads: usize,
) -> bool {
    let (Some((Convolution { window, .. }, true)), Some((_, false))) =
        (convolution(layer), convolution(producer))
    else {
        return false;
    };
    let shape @ [_, height, _] = shapes[producer.output.as_str()];
    let Window {
        kernel,
        strides,
        dilations,
        ..
    } = window;
    let twice = ((kernel[0] - 1) * dilations[0] + 1).saturating_sub(strides[0]);
    matches!(layer.form, Form::Bytes { .. })
        && shape.iter().product::<usize>() >= LARGE
        && twice * threads.saturating_sub(1) * REPEATED <= height
}

/// Layers in order, with convolutions together whose f32 results fit one block and come from the same pixels.
fn with_siblings_together(layers: &[Layer]) -> Vec<Vec<&Layer>> {
    let mut order: Vec<Vec<&Layer>> = Vec::new();
    let dense = |layer: &Layer| match (&layer.operation, &layer.form) {
        (Operation::Convolution(c), Form::Floats) if !c.depthwise => {
            Some((c.outputs, c.window.clone()))
        }
        _ => None,
    };
    for layer in layers {
        if let Some((outputs, window)) = dense(layer) {
            let joins = |siblings: &&mut Vec<&Layer>| {
                let together: Option<Vec<_>> =
                    siblings.iter().map(|sibling| dense(sibling)).collect();
                together.is_some_and(|together| {
                    together.iter().map(|(outputs, _)| outputs).sum::<usize>() + outputs
                        <= SIBLING_LANES
                        && together[0].1 == window
                        && siblings[0].inputs[0].name == layer.inputs[0].name
                        && siblings[0].inputs[0].quantization == layer.inputs[0].quantization
                })
            };
            if let Some(siblings) = order.iter_mut().find(joins) {
                siblings.push(layer);
                continue;
            }
        }
        order.push(vec![layer]);
    }
    order
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::layer::{Coordinates, Nearest, Operand, Quantization, Resize, Target};

    fn layer(operation: Operation, inputs: &[&str], output: &str) -> Layer {
        let quantization = Quantization {
            scale: 1.0,
            zero: 0,
        };
        let operand = |name: &&str| Operand {
            name: (*name).to_owned(),
            quantization: Some(quantization),
        };
        Layer {
            operation,
            inputs: inputs.iter().map(operand).collect(),
            output: output.to_owned(),
            form: Form::Bytes {
                quantization,
                range: 0..=255,
            },
        }
    }

    fn resize() -> Operation {
        Operation::Resize(Resize {
            linear: false,
            coordinates: Coordinates::Asymmetric,
            nearest: Nearest::Floor,
            target: Target::Scales([2.0, 2.0]),
        })
    }

    /// Each stage as the outputs of its inlined layers, then of its own.
    fn outputs(layers: &[Layer], shapes: &[(&str, Shape)]) -> Vec<Vec<String>> {
        let shapes = shapes.iter().copied().collect();
        let names = |stage: &Stage<'_>| stage.layers().map(|l| l.output.clone()).collect();
        stages(layers, &shapes, 1).iter().map(names).collect()
    }

    /// What an addition alone reads is made by it, row by row; what others read too is not, nor what is repeated.
    #[test]
    fn layers_are_inlined_where_one_row_of_one_layer_takes_one_row_of_them() {
        let (small, large) = ([16, 2, 3], [16, 4, 6]);
        let shapes = [("x", small), ("y", large), ("up", large), ("sum", large)];
        let sum = layer(Operation::Add, &["up", "y"], "sum");
        let up = layer(resize(), &["x"], "up");
        assert_eq!(
            outputs(&[up.clone(), sum.clone()], &shapes),
            [vec!["up", "sum"]]
        );

        let again = layer(Operation::Table(Box::new([0; 256])), &["up"], "again");
        let more = [&shapes[..], &[("again", large)]].concat();
        assert_eq!(
            outputs(&[up.clone(), sum.clone(), again], &more),
            [["up"], ["sum"], ["again"]]
        );

        let twice = layer(Operation::Add, &["up", "up"], "sum");
        assert_eq!(outputs(&[up.clone(), twice], &shapes), [["up"], ["sum"]]);

        let one = [
            ("x", [16, 1, 1]),
            ("up", [16, 2, 2]),
            ("y", [16, 4, 4]),
            ("sum", [16, 4, 4]),
        ];
        assert_eq!(outputs(&[up, sum], &one), [["up"], ["sum"]]);
    }

    /// Expansion and depthwise run with the projection where the tensor between them is large, and threads have rows enough
    /// each; the depthwise layer alone where not. No row is made twice for the sake of one that is made twice itself.
    #[test]
    fn blocks_run_as_one_where_their_tensors_are_large() {
        let window = |kernel: usize| Window {
            kernel: [kernel; 2],
            strides: [1; 2],
            dilations: [1; 2],
            padding: Padding::Explicit([kernel / 2; 4]),
            ceil: false,
        };
        let convolution = |depthwise: bool, kernel: usize| {
            Operation::Convolution(Convolution {
                depthwise,
                inputs: 1,
                outputs: 1,
                weights: Vec::new(),
                scales: Vec::new(),
                bias: Vec::new(),
                window: window(kernel),
            })
        };
        let layers = [
            layer(convolution(false, 1), &["x"], "wide"),
            layer(convolution(true, 3), &["wide"], "deep"),
            layer(convolution(false, 1), &["deep"], "narrow"),
            layer(convolution(true, 3), &["narrow"], "again"),
        ];
        let of = |shape: Shape, threads: usize| {
            let shapes = ["x", "wide", "deep", "narrow", "again"].map(|name| (name, shape));
            let shapes = shapes.into_iter().collect();
            let names = |stage: &Stage<'_>| stage.layers().map(|l| l.output.clone()).collect();
            let stages = stages(&layers, &shapes, threads);
            stages.iter().map(names).collect::<Vec<Vec<String>>>()
        };
        let large = [LARGE / 4096, 64, 64];
        let whole = [vec!["wide", "deep", "narrow"], vec!["again"]];
        let halves = [vec!["wide"], vec!["deep", "narrow"], vec!["again"]];
        assert_eq!(of(large, 1), whole);
        assert_eq!(of(large, 3), whole);
        assert_eq!(of(large, 4), halves);
        assert_eq!(of([LARGE / 4096, 64, 63], 1), halves);
    }

    /// What is inlined reads what is there.
    #[test]
    fn stages_are_not_nested() {
        let large = [16, 4, 6];
        let names = ["x", "up", "sum", "up2", "sum2"];
        let shapes = names.map(|name| (name, large));
        let layers = [
            layer(resize(), &["x"], "up"),
            layer(Operation::Add, &["up", "x"], "sum"),
            layer(resize(), &["x"], "up2"),
            layer(Operation::Add, &["sum", "up2"], "sum2"),
        ];
        assert_eq!(
            outputs(&layers, &shapes),
            [vec!["up", "sum"], vec!["up2", "sum2"]]
        );
    }
}
