//! From stages to steps: what is read and written where, factors, tables and weights.

use std::collections::HashMap;
use std::ops::RangeInclusive;

use super::super::expression::{Binary, Expression, Function};
use super::super::kernels::{Addition, Kernel, ToBytes};
use super::super::layer::{
    Convolution, Fill, Form, Layer, Operand, Operation, Padding, Quantization, Shape, Window,
};
use super::super::stages::Stage;
use super::buffer::{Buffer, Taps};
use super::convolution::{dense, depthwise};
use super::memory::Planes;
use super::step::{Source, Step, Work};

/// What is known of every tensor.
pub(super) struct Plan<'a> {
    pub(super) kernel: Kernel,
    pub(super) shapes: &'a HashMap<&'a str, Shape>,
    pub(super) buffers: HashMap<&'a str, Buffer>,
    pub(super) planes: HashMap<&'a str, Planes>,
}

/// What a layer of bytes reads and writes.
struct Bytes<'a> {
    reads: &'a [Buffer],
    from: &'a [Quantization],
    quantization: Quantization,
    range: &'a RangeInclusive<u8>,
}

impl Plan<'_> {
    /// The work of a stage.
    pub(super) fn stage(&self, stage: &Stage<'_>) -> Result<Step, String> {
        self.with_inputs(&stage.siblings, &stage.inlined)
    }

    /// The work of siblings, with that of the inlined layers that make their inputs, and so on.
    fn with_inputs(&self, siblings: &[&Layer], inlined: &[&Layer]) -> Result<Step, String> {
        let named = |operand: &Operand| {
            let layer = inlined.iter().find(|layer| layer.output == operand.name);
            layer
                .map(|layer| self.with_inputs(&[layer], inlined))
                .transpose()
        };
        let inputs = siblings[0].inputs.iter().map(named);
        let inlined = inputs.collect::<Result<_, _>>()?;
        Ok(Step {
            inlined,
            ..self.step(siblings)?
        })
    }

    fn buffer(&self, operand: &Operand) -> Result<Buffer, String> {
        let buffer = self.buffers.get(operand.name.as_str());
        buffer.copied().ok_or_else(|| unknown(&operand.name))
    }

    fn floats(&self, name: &str) -> Result<Planes, String> {
        let planes = self.planes.get(name);
        planes.copied().ok_or_else(|| unknown(name))
    }

    /// The work of one layer, or of several siblings.
    fn step(&self, siblings: &[&Layer]) -> Result<Step, String> {
        let layer = siblings[0];
        match &layer.operation {
            Operation::Quantize => return Ok(self.alone(layer, self.quantize(layer)?)),
            Operation::Elementwise(expression) => {
                return Ok(self.alone(layer, self.elementwise(layer, expression.clone())?));
            }
            _ => {}
        }
        let buffers = layer.inputs.iter().map(|input| self.buffer(input));
        let mut reads: Vec<Buffer> = buffers.collect::<Result<_, _>>()?;
        let quantizations = layer
            .inputs
            .iter()
            .map(|input| input.quantization.ok_or_else(|| unknown(&input.name)));
        let mut from: Vec<Quantization> = quantizations.collect::<Result<_, _>>()?;
        if let Operation::Add | Operation::Multiply = layer.operation {
            let shape = self.shapes[layer.output.as_str()];
            let pixel = |buffer: &Buffer| [buffer.height, buffer.width] == [1, 1];
            // One pixel for all comes second. Other repetition is rare.
            if pixel(&reads[0]) {
                reads.swap(0, 1);
                from.swap(0, 1);
            }
            let whole = |buffer: &Buffer| [buffer.channels, buffer.height, buffer.width] == shape;
            let repeats = pixel(&reads[1]) && reads[1].channels == shape[0];
            if !whole(&reads[0]) || !(whole(&reads[1]) || repeats) {
                let binary = match layer.operation {
                    Operation::Add => Binary::Add,
                    _ => Binary::Mul,
                };
                let [one, other] = [0, 1].map(|number| Box::new(Expression::Input(number)));
                let expression = Expression::Binary(binary, one, other);
                return Ok(self.alone(layer, self.elementwise(layer, expression)?));
            }
        }
        let work = match (&layer.operation, &layer.form) {
            (Operation::Dequantize, _) => Work::Dequantize {
                quantization: from[0],
                output: self.floats(&layer.output)?,
            },
            (Operation::Convolution(_), Form::Floats) => {
                self.dense_floats(siblings, from[0], &reads[0])?
            }
            (_, Form::Floats) => {
                return Err(format!("`{}` leaves the island as f32", layer.output));
            }
            (
                operation,
                Form::Bytes {
                    quantization,
                    range,
                },
            ) => {
                let bytes = Bytes {
                    reads: &reads,
                    from: &from,
                    quantization: *quantization,
                    range,
                };
                match operation {
                    Operation::Convolution(convolution) => {
                        self.convolution(layer, convolution, &bytes)?
                    }
                    _ => self.bytes(layer, &bytes)?,
                }
            }
        };
        Ok(Step {
            reads,
            ..self.alone(layer, work)
        })
    }

    /// A step without the byte tensors that it reads row by row.
    fn alone(&self, layer: &Layer, work: Work) -> Step {
        Step {
            work,
            reads: Vec::new(),
            inlined: Vec::new(),
            writes: self.buffers.get(layer.output.as_str()).copied(),
            rows: self.shapes[layer.output.as_str()][1],
        }
    }

    fn quantize(&self, layer: &Layer) -> Result<Work, String> {
        let Form::Bytes { quantization, .. } = layer.form else {
            return Err(unknown(&layer.output));
        };
        let name = layer.inputs[0].name.as_str();
        Ok(Work::Quantize {
            input: self.floats(name)?,
            shape: self.shapes[name],
            quantization,
        })
    }

    fn elementwise(&self, layer: &Layer, expression: Expression) -> Result<Work, String> {
        let source = |operand: &Operand| match operand.quantization {
            Some(quantization) => Ok(Source::Bytes(self.buffer(operand)?, quantization)),
            None => Ok(Source::Floats(
                self.floats(&operand.name)?,
                self.shapes[operand.name.as_str()],
            )),
        };
        let (expression, quantization, output) = match &layer.form {
            Form::Bytes {
                quantization,
                range,
            } => {
                let [least, most] = [range.start(), range.end()].map(|end| quantization.real(*end));
                let expression = match *range == (0..=255) {
                    true => expression,
                    false => {
                        Expression::Function(Function::Clip(least, most), Box::new(expression))
                    }
                };
                (expression, Some(*quantization), None)
            }
            Form::Floats => (expression, None, Some(self.floats(&layer.output)?)),
        };
        let sources = layer.inputs.iter().map(source);
        Ok(Work::Elementwise {
            expression,
            sources: sources.collect::<Result<_, String>>()?,
            shape: self.shapes[layer.output.as_str()],
            quantization,
            output,
        })
    }

    /// Convolutions whose sums leave as f32.
    fn dense_floats(
        &self,
        siblings: &[&Layer],
        from: Quantization,
        read: &Buffer,
    ) -> Result<Work, String> {
        let convolutions: Vec<&Convolution> = siblings
            .iter()
            .filter_map(|layer| match &layer.operation {
                Operation::Convolution(convolution) => Some(convolution),
                _ => None,
            })
            .collect();
        let (dense, runs) = dense(self.kernel, &convolutions, from, &siblings[0].form, read);
        let outputs = siblings.iter().map(|layer| self.floats(&layer.output));
        let outputs: Vec<Planes> = outputs.collect::<Result<_, _>>()?;
        let channels = convolutions.iter().map(|convolution| convolution.outputs);
        let [_, height, width] = self.shapes[siblings[0].output.as_str()];
        Ok(Work::DenseFloats {
            dense,
            taps: Taps::new(&convolutions[0].window, read, runs)?,
            outputs: outputs.into_iter().zip(channels).collect(),
            size: [height, width],
        })
    }

    /// A convolution from bytes to bytes.
    fn convolution(
        &self,
        layer: &Layer,
        convolution: &Convolution,
        bytes: &Bytes<'_>,
    ) -> Result<Work, String> {
        let (kernel, form) = (self.kernel, &layer.form);
        let (read, from, window) = (&bytes.reads[0], bytes.from[0], &convolution.window);
        let to = bytes.to();
        if convolution.depthwise {
            let (depthwise, taps) = depthwise(kernel, convolution, from, form, read);
            let taps = Taps::new(window, read, taps)?;
            Ok(Work::Depthwise {
                depthwise,
                taps,
                to,
            })
        } else {
            let (dense, runs) = dense(kernel, &[convolution], from, form, read);
            let taps = Taps::new(window, read, runs)?;
            Ok(Work::Dense { dense, taps, to })
        }
    }

    /// All else from bytes to bytes.
    fn bytes(&self, layer: &Layer, bytes: &Bytes<'_>) -> Result<Work, String> {
        let Bytes {
            reads,
            from,
            quantization,
            range,
        } = *bytes;
        let operation = &layer.operation;
        let to = bytes.to();
        // Infinity times 0 is no number, which kernels round as they like.
        let too_far = || format!("`{}` has scales too far apart", layer.output);
        let finite = |factor: f32| match factor.is_finite() {
            true => Ok(factor),
            false => Err(too_far()),
        };
        let factor = finite(from[0].scale / quantization.scale)?;
        let zero = from[0].zero;
        let written = self.buffers.get(layer.output.as_str());
        let out_pitch = written.map_or(0, |buffer| buffer.pitch);
        let other_channels = matches!(
            operation,
            Operation::Concat | Operation::Flatten | Operation::DepthToSpace(_)
        );
        if !other_channels && reads.iter().any(|read| read.pitch != out_pitch) {
            return Err(format!(
                "`{}` has an input of four channels or fewer",
                layer.output
            ));
        }
        let table = || Box::new(rescale(from[0], quantization, range));
        let size = [reads[0].height, reads[0].width];
        Ok(match operation {
            Operation::Add => {
                let factors = [factor, finite(from[1].scale / quantization.scale)?];
                // Of more steps than an i32 holds, x86's conversion makes the least number.
                if 255.0 * (factors[0] + factors[1]) >= (1 << 30) as f32 {
                    return Err(too_far());
                }
                Work::Add(Addition {
                    zeros: [from[0].zero, from[1].zero],
                    factors,
                    to,
                })
            }
            Operation::Multiply => Work::Multiply {
                zeros: [from[0].zero, from[1].zero],
                factor: finite(from[0].scale * from[1].scale / quantization.scale)?,
                to,
            },
            Operation::Table(table) => Work::Table(table.clone()),
            Operation::Concat => {
                let tables = from.iter().map(|from| rescale(*from, quantization, range));
                Work::Concat(tables.collect())
            }
            Operation::Resize(resize) => Work::Resize {
                rows: resize.axis(0, size),
                columns: resize.axis(1, size),
                to,
                zero,
                factor,
                same: !resize.linear && from[0] == quantization && *range == (0..=255),
            },
            Operation::Pad(pad) => Work::Pad {
                rows: pad.axis(0, size[0])?,
                columns: pad.axis(1, size[1])?,
                fill: match pad.fill {
                    Fill::Constant(real) => {
                        quantization.byte(real).clamp(*range.start(), *range.end())
                    }
                    Fill::Edge | Fill::Reflect => quantization.zero,
                },
                table: table(),
            },
            Operation::Flatten => Work::Flatten(table()),
            Operation::DepthToSpace(spread) => Work::DepthToSpace {
                block: spread.block,
                sources: spread.sources(reads[0].channels),
                table: table(),
            },
            Operation::MaxPool(window) => Work::MaxPool {
                window: window.clone(),
                placed: window.place(size)?,
                table: table(),
            },
            Operation::AveragePool(window, counts_padding) => Work::Average {
                window: window.clone(),
                placed: window.place(size)?,
                counts_padding: *counts_padding,
                zero,
                factor,
                to,
            },
            Operation::GlobalAveragePool => {
                let window = Window {
                    kernel: size,
                    strides: [1; 2],
                    dilations: [1; 2],
                    padding: Padding::Explicit([0; 4]),
                    ceil: false,
                };
                Work::Average {
                    placed: window.place(size)?,
                    window,
                    counts_padding: false,
                    zero,
                    factor,
                    to,
                }
            }
            Operation::Quantize
            | Operation::Dequantize
            | Operation::Convolution(_)
            | Operation::Elementwise(_) => return Err(unknown(&layer.output)),
        })
    }
}

impl Bytes<'_> {
    fn to(&self) -> ToBytes {
        ToBytes {
            zero: self.quantization.zero,
            range: self.range.clone(),
        }
    }
}

fn unknown(name: &str) -> String {
    format!("`{name}` is not made")
}

/// What a change of scale makes of each byte.
fn rescale(from: Quantization, to: Quantization, range: &RangeInclusive<u8>) -> [u8; 256] {
    let mut table = [0; 256];
    for (byte, out) in (0..=255).zip(&mut table) {
        *out = to.byte(from.real(byte)).clamp(*range.start(), *range.end());
    }
    table
}
