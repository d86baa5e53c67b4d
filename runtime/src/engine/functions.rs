//! Functions of one tensor's bytes that are written as several layers, made one table.
//!
//! ONNX Runtime's tools write HardSwish and SiLU as a function of a tensor, quantized, and its product with the tensor.

use std::collections::{HashMap, HashSet};

use super::kernels::{Addition, Kernel, ToBytes, multiply_row};
use super::layer::{Form, Layer, Operand, Operation};

/// The byte that a function makes of each byte of an operand.
#[derive(Clone)]
struct Function {
    of: Operand,
    table: Box<[u8; 256]>,
}

/// Makes one table of what is a function of one tensor's bytes, bit by bit the same, and leaves out tables that nobody reads then.
pub(super) fn merge(mut layers: Vec<Layer>) -> Vec<Layer> {
    let mut functions: HashMap<String, Function> = HashMap::new();
    for layer in &mut layers {
        let Form::Bytes {
            quantization,
            range,
        } = &layer.form
        else {
            continue;
        };
        let inputs = layer.inputs.iter().map(|input| function(input, &functions));
        let Some(inputs) = inputs.collect::<Option<Vec<_>>>() else {
            continue;
        };
        let to = ToBytes {
            zero: quantization.zero,
            range: range.clone(),
        };
        let table = match (&layer.operation, &inputs[..]) {
            (Operation::Table(table), [only]) => {
                Box::new(only.table.map(|byte| table[usize::from(byte)]))
            }
            (Operation::Add | Operation::Multiply, [one, other])
                if one.of.name == other.of.name =>
            {
                let [Some(first), Some(second)] = [0, 1].map(|n| layer.inputs[n].quantization)
                else {
                    continue;
                };
                let factors = [first, second].map(|q| q.scale / quantization.scale);
                let factor = first.scale * second.scale / quantization.scale;
                // Planning refuses these, with the reason.
                if !(factors[0] + factors[1] + factor).is_finite() {
                    continue;
                }
                let zeros = [first.zero, second.zero];
                let mut out = Box::new([0; 256]);
                match layer.operation {
                    Operation::Add => {
                        let addition = Addition { zeros, factors, to };
                        Kernel::Portable.add(
                            &addition,
                            &one.table[..],
                            &other.table[..],
                            &mut out[..],
                        );
                    }
                    _ => multiply_row(
                        zeros,
                        factor,
                        &to,
                        &one.table[..],
                        &other.table[..],
                        &mut out[..],
                    ),
                }
                out
            }
            _ => continue,
        };
        let of = inputs[0].of.clone();
        layer.operation = Operation::Table(table.clone());
        layer.inputs = vec![of.clone()];
        functions.insert(layer.output.clone(), Function { of, table });
    }
    // Backwards, so that a table that only such tables read goes too.
    let mut read: HashSet<String> = HashSet::new();
    let mut kept: Vec<Layer> = layers
        .into_iter()
        .rev()
        .filter(|layer| {
            let keep = !functions.contains_key(&layer.output) || read.contains(&layer.output);
            if keep {
                read.extend(layer.inputs.iter().map(|input| input.name.clone()));
            }
            keep
        })
        .collect();
    kept.reverse();
    kept
}

/// What an operand is a function of: itself, unless a table makes it. `None` where it is f32.
fn function(operand: &Operand, functions: &HashMap<String, Function>) -> Option<Function> {
    operand.quantization?;
    let known = functions.get(&operand.name).cloned();
    Some(known.unwrap_or_else(|| Function {
        of: operand.clone(),
        table: Box::new(std::array::from_fn(|byte| byte as u8)),
    }))
}

#[cfg(test)]
#[allow(clippy::panic)]
mod tests {
    use super::super::layer::Quantization;
    use super::*;

    const fn steps(scale: f32, zero: u8) -> Quantization {
        Quantization { scale, zero }
    }

    fn layer(
        operation: Operation,
        inputs: &[(&str, Quantization)],
        output: &str,
        to: Quantization,
    ) -> Layer {
        let operand = |&(name, quantization): &(&str, Quantization)| Operand {
            name: name.to_owned(),
            quantization: Some(quantization),
        };
        Layer {
            operation,
            inputs: inputs.iter().map(operand).collect(),
            output: output.to_owned(),
            form: Form::Bytes {
                quantization: to,
                range: 3..=255,
            },
        }
    }

    /// What a layer that is a table of `x` makes of a byte.
    fn table<'a>(layers: &'a [Layer], output: &str) -> &'a [u8; 256] {
        let layer = layers.iter().find(|layer| layer.output == output);
        match layer.map(|layer| (&layer.operation, &layer.inputs[..])) {
            Some((Operation::Table(table), [input])) if input.name == "x" => table,
            other => panic!("{output}: {other:?}"),
        }
    }

    fn names(layers: &[Layer]) -> Vec<&str> {
        layers.iter().map(|layer| layer.output.as_str()).collect()
    }

    // Scales are powers of two, so that f32 rounds nothing before the bytes.
    const X: Quantization = steps(0.25, 100);
    const Y: Quantization = steps(0.125, 7);
    const Z: Quantization = steps(0.5, 60);

    fn function() -> Layer {
        let bytes = Box::new(std::array::from_fn(|byte| {
            (byte as u8).wrapping_mul(37) | 3
        }));
        layer(Operation::Table(bytes), &[("x", X)], "y", Y)
    }

    fn reader(inputs: &[(&str, Quantization)]) -> Layer {
        layer(Operation::Concat, inputs, "w", Z)
    }

    #[test]
    fn functions_of_one_tensor_are_one_table() {
        let y = |byte: u8| match function().operation {
            Operation::Table(table) => table[usize::from(byte)],
            _ => 0,
        };
        type Join = fn(f64, f64) -> f64;
        for (operation, join) in [
            (Operation::Multiply, (|a, b| a * b) as Join),
            (Operation::Add, |a, b| a + b),
        ] {
            let joined = layer(operation, &[("x", X), ("y", Y)], "z", Z);
            let merged = merge(vec![function(), joined, reader(&[("z", Z)])]);
            assert_eq!(names(&merged), ["z", "w"]);
            for byte in 0..=255_u8 {
                let real = |byte: u8, q: Quantization| {
                    (f64::from(byte) - f64::from(q.zero)) * f64::from(q.scale)
                };
                let joined = join(real(byte, X), real(y(byte), Y)) / f64::from(Z.scale);
                let exact = (joined.round_ties_even() + f64::from(Z.zero)).clamp(3.0, 255.0);
                assert_eq!(
                    f64::from(table(&merged, "z")[usize::from(byte)]),
                    exact,
                    "{byte}"
                );
            }
        }
        // A table of a table; bytes read in other steps go by their own.
        let twice = Operation::Table(Box::new(std::array::from_fn(|byte| 255 - byte as u8)));
        let twice = layer(twice, &[("y", Y)], "z", Z);
        let merged = merge(vec![function(), twice, reader(&[("z", Z)])]);
        assert_eq!(names(&merged), ["z", "w"]);
        assert_eq!(table(&merged, "z")[9], 255 - y(9));
    }

    #[test]
    fn what_others_read_stays_and_other_tensors_are_no_function() {
        let product = || layer(Operation::Multiply, &[("x", X), ("y", Y)], "z", Z);
        let merged = merge(vec![function(), product(), reader(&[("y", Y), ("z", Z)])]);
        assert_eq!(names(&merged), ["y", "z", "w"]);
        table(&merged, "z");

        let of_two = layer(Operation::Multiply, &[("y", Y), ("v", X)], "z", Z);
        let merged = merge(vec![function(), of_two, reader(&[("z", Z)])]);
        assert!(matches!(merged[1].operation, Operation::Multiply));
        assert_eq!(names(&merged), ["y", "z", "w"]);

        // Refused when it is planned, and so not hidden.
        let far = steps(f32::MAX, 0);
        let beyond = layer(Operation::Multiply, &[("x", far), ("y", far)], "z", Z);
        let merged = merge(vec![function(), beyond, reader(&[("z", Z)])]);
        assert!(matches!(merged[1].operation, Operation::Multiply));
    }
}
