//! Quantization parameters and quantized constants.

use tract_onnx::pb::NodeProto;
use tract_onnx::pb::tensor_proto::DataType;
use tract_onnx::prelude::DatumType;

use super::graph::{Reader, input, integer};
use super::{Found, Reason};
use crate::engine::layer::{Operand, Quantization};

/// A constant in real numbers.
pub(super) struct Constant {
    pub(super) values: Vec<f32>,
    pub(super) shape: Vec<usize>,
}

/// A quantized constant: integers less their zero points, and scales.
pub(super) struct Integers {
    pub(super) values: Vec<i64>,
    pub(super) shape: Vec<usize>,
    /// One, or one per index of `axis`.
    pub(super) scales: Vec<f32>,
    pub(super) axis: usize,
}

impl Integers {
    /// The values with their scales.
    pub(super) fn scaled(&self) -> impl Iterator<Item = (i64, f32)> {
        runs(&self.values, self.scales.len(), self.axis, &self.shape).flat_map(|(index, run)| {
            let scale = self.scales[index];
            run.iter().map(move |&value| (value, scale))
        })
    }
}

/// The values that follow one another with the same parameter, and which that is: one per index of `axis`, or the one there is for all.
fn runs<'a, T>(
    values: &'a [T],
    parameters: usize,
    axis: usize,
    shape: &[usize],
) -> impl Iterator<Item = (usize, &'a [T])> {
    let length = match parameters {
        1 => values.len(),
        _ => shape[axis + 1..].iter().product(),
    };
    let runs = values.chunks(length.max(1)).enumerate();
    runs.map(move |(number, run)| (number % parameters, run))
}

impl Reader<'_> {
    /// The one scale and zero point of a QuantizeLinear or DequantizeLinear of an activation.
    pub(super) fn quantization(&self, node: &NodeProto) -> Found<Quantization> {
        let scale = self
            .floats(input(node, 1).ok_or("it has no scale")?)
            .ok_or("its scale is not a constant in f32")?;
        let [scale] = scale[..] else {
            return Err("its activations have a scale per channel".into());
        };
        if !(scale.is_finite() && scale > 0.0) {
            return Err(format!("its scale is {scale}").into());
        }
        let (zero, data_type) = match input(node, 2) {
            Some(name) => match self.integers(name) {
                Some((values, _, data_type)) if values.len() == 1 => (values[0], data_type),
                _ => return Err("its zero point is not one constant byte".into()),
            },
            // Signed ones have one: see `to_qdq`.
            None => (0, DatumType::U8),
        };
        let zero = match data_type {
            DatumType::U8 => zero,
            DatumType::I8 => zero + 128,
            other => return Err(format!("its activations are {other:?}, not bytes").into()),
        };
        Ok(Quantization {
            scale,
            zero: u8::try_from(zero).map_err(|_| "its zero point is no byte")?,
        })
    }

    /// The byte tensor behind an f32 name; `None` where the name is not dequantized from an activation.
    pub(super) fn operand(&self, name: &str) -> Option<Found<Operand>> {
        let (_, node) = self
            .maker(name)
            .filter(|(_, node)| node.op_type == "DequantizeLinear")?;
        let bytes = input(node, 0)?;
        if self.is_constant(bytes) || self.quantizes_constant(bytes) {
            return None;
        }
        Some(self.quantization(node).map(|quantization| Operand {
            name: bytes.clone(),
            quantization: Some(quantization),
        }))
    }

    /// Whether a byte tensor is a constant's, quantized in the graph.
    fn quantizes_constant(&self, bytes: &str) -> bool {
        self.maker(bytes).is_some_and(|(_, node)| {
            node.op_type == "QuantizeLinear"
                && input(node, 0).is_some_and(|name| self.is_constant(name))
        })
    }

    /// A constant that is stored in f32, or quantized; `None` where the name is no constant.
    pub(super) fn real_constant(
        &self,
        name: &str,
        nodes: &mut Vec<usize>,
    ) -> Option<Found<Constant>> {
        if let Some(tensor) = self.constant(name) {
            nodes.extend(self.maker(name).map(|(index, _)| index));
            let floats = self.floats(name);
            return Some(match floats {
                Some(values) => Ok(Constant {
                    values,
                    shape: tensor.shape().to_vec(),
                }),
                None => Err("a constant is not f32".into()),
            });
        }
        let (_, node) = self
            .maker(name)
            .filter(|(_, node)| node.op_type == "DequantizeLinear")?;
        let bytes = input(node, 0)?;
        if !self.is_constant(bytes) && !self.quantizes_constant(bytes) {
            return None;
        }
        Some(self.quantized_constant(name, nodes).map(|integers| {
            let reals = integers.scaled().map(|(value, scale)| value as f32 * scale);
            Constant {
                values: reals.collect(),
                shape: integers.shape.clone(),
            }
        }))
    }

    /// A constant that is stored quantized (DequantizeLinear of integers), or that is quantized on the spot
    /// (DequantizeLinear of QuantizeLinear of f32).
    pub(super) fn quantized_constant(&self, name: &str, nodes: &mut Vec<usize>) -> Found<Integers> {
        let (index, node) = self
            .maker(name)
            .filter(|(_, node)| node.op_type == "DequantizeLinear")
            .ok_or("its weights are not quantized constants")?;
        nodes.push(index);
        nodes.extend(self.makers(&node.input));
        let scales = self
            .floats(input(node, 1).ok_or("its weights have no scale")?)
            .ok_or("its weights' scale is not a constant in f32")?;
        if scales.is_empty()
            || scales
                .iter()
                .any(|scale| !(scale.is_finite() && *scale > 0.0))
        {
            return Err("a scale of its weights is not a positive number".into());
        }
        let zeros = match input(node, 2) {
            None => None,
            Some(zeros) => Some(
                self.integers(zeros)
                    .ok_or("its weights' zero point is not a constant of bytes")?,
            ),
        };
        let source = input(node, 0).ok_or("its weights are missing")?;
        let kind = zeros.as_ref().map_or(DatumType::U8, |(_, _, kind)| *kind);
        let (stored, floats, shape) = match self.integers(source) {
            Some((values, shape, _)) => (values, None, shape),
            None => {
                let quantize = self
                    .maker(source)
                    .map(|(_, node)| node)
                    .filter(|node| node.op_type == "QuantizeLinear")
                    .ok_or("its weights are not constant bytes")?;
                nodes.extend(self.makers(&quantize.input));
                let name = input(quantize, 0).ok_or("its weights are missing")?;
                let floats = self.floats(name).ok_or("its weights are not constant")?;
                let same = (1..3).all(|number| input(quantize, number) == input(node, number))
                    && integer(quantize, "axis", 1) == integer(node, "axis", 1);
                if !same {
                    return Err(
                        "its weights are quantized in one way and dequantized in another".into(),
                    );
                }
                let shape = self.shape(name).unwrap_or_default();
                (Vec::new(), Some(floats), shape)
            }
        };
        let axis = match integer(node, "axis", 1) {
            axis if axis < 0 => axis + shape.len() as i64,
            axis => axis,
        };
        let axis = axis as usize;
        if integer(node, "block_size", 0) != 0
            || (scales.len() > 1 && shape.get(axis) != Some(&scales.len()))
            || zeros
                .as_ref()
                .is_some_and(|(zeros, ..)| zeros.len() != scales.len())
        {
            return Err("the scales of its weights do not fit their shape".into());
        }
        let zero = |index: usize| zeros.as_ref().map_or(0, |(zeros, ..)| zeros[index]);
        let mut values = Vec::with_capacity(floats.as_ref().map_or(stored.len(), Vec::len));
        match floats {
            None => {
                for (index, run) in runs(&stored, scales.len(), axis, &shape) {
                    let zero = zero(index);
                    values.extend(run.iter().map(|value| value - zero));
                }
            }
            Some(floats) => {
                let (low, high) = match kind {
                    DatumType::I8 => (-128, 127),
                    DatumType::U8 => (0, 255),
                    _ => return Err("its weights are not bytes".into()),
                };
                for (index, run) in runs(&floats, scales.len(), axis, &shape) {
                    let (scale, zero) = (scales[index], zero(index));
                    let quantized = |value: &f32| {
                        let steps = (value / scale).round_ties_even() as i64;
                        steps.saturating_add(zero).clamp(low, high) - zero
                    };
                    values.extend(run.iter().map(quantized));
                }
            }
        }
        Ok(Integers {
            values,
            shape,
            scales,
            axis,
        })
    }

    /// The type of the weights behind a DequantizeLinear is one byte.
    pub(super) fn check_weight_type(&self, name: &str) -> Found<()> {
        let stored = self
            .maker(name)
            .and_then(|(_, node)| input(node, 0))
            .and_then(|bytes| self.constant_type(bytes));
        match stored {
            Some(kind) if kind != DataType::Int8 as i32 && kind != DataType::Uint8 as i32 => {
                Err(Reason::from("its weights are not bytes"))
            }
            _ => Ok(()),
        }
    }
}
