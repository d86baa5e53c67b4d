//! Elementwise operators, gathered into expressions.

use std::collections::HashSet;

use tract_onnx::pb::NodeProto;

use super::constants::Constant;
use super::graph::{Reader, float, input, text};
use super::{Found, Reason, convolution};
use crate::engine::expression::{Binary, Expression, Function};
use crate::engine::layer::Operand;

/// Longest expression, in operations.
const MAX_OPERATIONS: usize = 64;

/// An expression, what it reads, and its nodes.
pub(super) struct Gathered {
    pub(super) expression: Expression,
    pub(super) inputs: Vec<Operand>,
    pub(super) nodes: Vec<usize>,
}

impl Gathered {
    fn input(&mut self, operand: Operand) -> Expression {
        let same = |known: &Operand| {
            known.name == operand.name && known.quantization == operand.quantization
        };
        let number = self.inputs.iter().position(same).unwrap_or_else(|| {
            self.inputs.push(operand.clone());
            self.inputs.len() - 1
        });
        Expression::Input(number)
    }
}

/// Whether an operator is a function of one number.
pub(super) fn is_function(op: &str) -> bool {
    matches!(
        op,
        "Abs"
            | "Celu"
            | "Clip"
            | "Elu"
            | "Erf"
            | "Exp"
            | "Gelu"
            | "HardSigmoid"
            | "HardSwish"
            | "LeakyRelu"
            | "Log"
            | "Mish"
            | "Neg"
            | "Reciprocal"
            | "Relu"
            | "Selu"
            | "Sigmoid"
            | "Softplus"
            | "Softsign"
            | "Sqrt"
            | "Tanh"
    )
}

/// Whether an operator joins two numbers.
pub(super) fn is_binary(op: &str) -> bool {
    binary(op).is_some()
}

fn binary(op: &str) -> Option<Binary> {
    Some(match op {
        "Add" => Binary::Add,
        "Div" => Binary::Div,
        "Max" => Binary::Max,
        "Min" => Binary::Min,
        "Mul" => Binary::Mul,
        "PRelu" => Binary::PRelu,
        "Pow" => Binary::Pow,
        "Sub" => Binary::Sub,
        _ => return None,
    })
}

impl<'a> Reader<'a> {
    /// Whether a tensor is made element by element.
    pub(super) fn is_elementwise(&self, name: &str) -> bool {
        self.maker(name).is_some_and(|(_, node)| {
            is_function(&node.op_type) || (is_binary(&node.op_type) && node.input.len() == 2)
        })
    }

    /// The expression that makes `root`, as far back as bytes and tensors made otherwise; with `cut`, as far as tensors that
    /// others read too.
    pub(super) fn expression(&self, root: &'a str, cut: bool) -> Found<Gathered> {
        let mut within = HashSet::new();
        let mut open = vec![root];
        while let Some(name) = open.pop() {
            if let Some((index, node)) = self.maker(name)
                && self.is_elementwise(name)
                && within.insert(index)
            {
                open.extend(node.input.iter().map(String::as_str));
            }
        }
        let mut gathered = Gathered {
            expression: Expression::Input(0),
            inputs: Vec::new(),
            nodes: Vec::new(),
        };
        let whole = |name: &str| {
            let own = |index: &usize| within.contains(index);
            let ours = || !self.is_output(name) && self.readers(name).iter().all(own);
            name == root || !cut || ours()
        };
        gathered.expression = self.part(root, &whole, &mut gathered)?;
        Ok(gathered)
    }

    fn part(
        &self,
        name: &'a str,
        whole: &impl Fn(&str) -> bool,
        gathered: &mut Gathered,
    ) -> Found<Expression> {
        if let Some(constant) = self.scalar_or_channels(name, &mut gathered.nodes) {
            return Ok(Expression::Constant(constant?));
        }
        if let Some(operand) = self.operand(name) {
            return Ok(gathered.input(operand?));
        }
        let (index, node) = match self.maker(name) {
            Some((index, node)) if self.is_elementwise(name) && whole(name) => (index, node),
            _ => {
                return Ok(gathered.input(Operand {
                    name: name.to_owned(),
                    quantization: None,
                }));
            }
        };
        gathered.nodes.push(index);
        if gathered.nodes.len() > MAX_OPERATIONS {
            return Err(Reason::from("its expression is too long"));
        }
        let first = node.input.first().ok_or("no input")?;
        let one = Box::new(self.part(first, whole, gathered)?);
        Ok(match binary(&node.op_type) {
            Some(binary) => {
                let second = node.input.get(1).ok_or("no second input")?;
                let other = self.part(second, whole, gathered)?;
                Expression::Binary(binary, one, Box::new(other))
            }
            None => {
                gathered
                    .nodes
                    .extend(self.makers(node.input.iter().skip(1)));
                Expression::Function(self.function(node)?, one)
            }
        })
    }

    /// A constant that is one number, or one per channel; `None` where the name is no constant.
    fn scalar_or_channels(&self, name: &str, nodes: &mut Vec<usize>) -> Option<Found<Vec<f32>>> {
        let Constant { values, shape } = match self.real_constant(name, nodes)? {
            Ok(constant) => constant,
            Err(reason) => return Some(Err(reason)),
        };
        // [C, 1, 1] and [1, C, 1, 1] meet [1, C, H, W]; [C] and [1, C] meet [1, C].
        let rank = self.readers(name).iter().find_map(|&reader| {
            let outputs = &self.graph.node[reader].output;
            outputs.first().and_then(|output| self.rank(output))
        });
        let channels = match (rank, &shape[..]) {
            (_, shape) if shape.iter().all(|&n| n == 1) => 1,
            (Some(4), [n, 1, 1] | [1, n, 1, 1]) => *n,
            (Some(2), [n] | [1, n]) => *n,
            _ => {
                return Some(Err(format!(
                    "a constant of shape {shape:?} is neither a number nor one per channel"
                )
                .into()));
            }
        };
        Some(if values.len() == channels {
            Ok(values)
        } else {
            Err("a constant's numbers do not fit its shape".into())
        })
    }

    /// Bounds of a ReLU or Clip.
    pub(super) fn bounds(&self, node: &NodeProto) -> Found<Option<[f32; 2]>> {
        match node.op_type.as_str() {
            "Relu" => Ok(Some([0.0, f32::INFINITY])),
            "Clip" => {
                let bound = |number: usize, name: &str, default: f32| match input(node, number) {
                    Some(constant) => Ok(self
                        .real_constant(constant, &mut Vec::new())
                        .ok_or("its bounds are not constant")??
                        .values
                        .first()
                        .copied()
                        .ok_or("its bounds are empty")?),
                    None => Ok::<f32, Reason>(float(node, name, default)),
                };
                let bounds = [
                    bound(1, "min", f32::NEG_INFINITY)?,
                    bound(2, "max", f32::INFINITY)?,
                ];
                if bounds[0] <= bounds[1] {
                    Ok(Some(bounds))
                } else {
                    Err("its bounds are not in order".into())
                }
            }
            _ => Ok(None),
        }
    }

    fn function(&self, node: &NodeProto) -> Found<Function> {
        if let Some([least, most]) = self.bounds(node)? {
            return Ok(Function::Clip(least, most));
        }
        let alpha = |default: f32| float(node, "alpha", default);
        Ok(match node.op_type.as_str() {
            "Abs" => Function::Abs,
            "Celu" => Function::Celu(alpha(1.0)),
            "Elu" => Function::Elu(alpha(1.0)),
            "Erf" => Function::Erf,
            "Exp" => Function::Exp,
            "Gelu" if text(node, "approximate", "none") == Some("tanh") => Function::GeluTanh,
            "Gelu" => Function::Gelu,
            "HardSigmoid" => Function::HardSigmoid(alpha(0.2), float(node, "beta", 0.5)),
            "HardSwish" => Function::HardSwish,
            "LeakyRelu" => Function::LeakyRelu(alpha(0.01)),
            "Log" => Function::Log,
            "Mish" => Function::Mish,
            "Neg" => Function::Neg,
            "Reciprocal" => Function::Reciprocal,
            "Selu" => Function::Selu(alpha(1.673_263_2), float(node, "gamma", 1.050_701)),
            "Sigmoid" => Function::Sigmoid,
            "Softplus" => Function::Softplus,
            "Softsign" => Function::Softsign,
            "Sqrt" => Function::Sqrt,
            "Tanh" => Function::Tanh,
            op => return Err(format!("no function {op}").into()),
        })
    }

    /// Whether an expression belongs with the engine: it reads what is made there, perhaps by way of other expressions. (Each tensor is
    /// looked at once, and waits in a list: there are graphs with more ways through than time, and with longer ones than the stack.)
    pub(super) fn belongs(&self, gathered: &Gathered) -> bool {
        let mut asked = HashSet::new();
        let mut open = gathered.inputs.clone();
        while let Some(input) = open.pop() {
            if input.quantization.is_some() {
                return true;
            }
            let Some((_, node)) = self.maker(&input.name) else {
                continue;
            };
            if !asked.insert(input.name.clone()) {
                continue;
            }
            if convolution::has_weights(&node.op_type) {
                let read = node.input.first();
                if read.is_some_and(|name| self.operand(name).is_some()) {
                    return true;
                }
            } else if self.is_elementwise(&input.name)
                && let Some(inner) = node.output.first()
                && let Ok(inner) = self.expression(inner, true)
            {
                open.extend(inner.inputs);
            }
        }
        self.takes_all
    }
}
