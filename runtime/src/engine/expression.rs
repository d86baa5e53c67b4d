//! What goes element by element: functions of one number and operations on two, as the graph has them.
//!
//! Evaluated in f32 and in the graph's order, so that it rounds where the graph does. Transcendental functions are `libm`'s
//! on every machine.

use super::layer::Quantization;

/// A tree of elementwise operations.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Expression {
    /// The layer's input of this number.
    Input(usize),
    /// One number, or one per channel.
    Constant(Vec<f32>),
    /// A function of one number.
    Function(Function, Box<Expression>),
    /// An operation on two.
    Binary(Binary, Box<Expression>, Box<Expression>),
}

/// A function of one number, by its ONNX operator's name.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Function {
    Abs,
    /// Least and greatest value: ReLU too.
    Clip(f32, f32),
    Celu(f32),
    Elu(f32),
    Erf,
    Exp,
    Gelu,
    GeluTanh,
    HardSigmoid(f32, f32),
    HardSwish,
    LeakyRelu(f32),
    Log,
    Mish,
    Neg,
    Reciprocal,
    /// Alpha and gamma.
    Selu(f32, f32),
    Sigmoid,
    Softplus,
    Softsign,
    Sqrt,
    Tanh,
}

impl Function {
    fn of(self, x: f32) -> f32 {
        let softplus = |x: f32| x.max(0.0) + libm::log1pf(libm::expf(-x.abs()));
        match self {
            Function::Abs => x.abs(),
            // Not `clamp`, which keeps NaN's sign and panics where the bounds are not in order.
            Function::Clip(least, most) => x.max(least).min(most),
            Function::Celu(alpha) => x.max(0.0) + (alpha * libm::expm1f(x / alpha)).min(0.0),
            Function::Elu(alpha) if x < 0.0 => alpha * libm::expm1f(x),
            Function::Elu(_) => x,
            Function::Erf => libm::erff(x),
            Function::Exp => libm::expf(x),
            Function::Gelu => 0.5 * x * (1.0 + libm::erff(x * std::f32::consts::FRAC_1_SQRT_2)),
            Function::GeluTanh => {
                let inner = (2.0 / std::f32::consts::PI).sqrt() * (x + 0.044715 * x * x * x);
                0.5 * x * (1.0 + libm::tanhf(inner))
            }
            Function::HardSigmoid(alpha, beta) => (alpha * x + beta).clamp(0.0, 1.0),
            Function::HardSwish => x * (x / 6.0 + 0.5).clamp(0.0, 1.0),
            Function::LeakyRelu(alpha) if x < 0.0 => alpha * x,
            Function::LeakyRelu(_) => x,
            Function::Log => libm::logf(x),
            Function::Mish => x * libm::tanhf(softplus(x)),
            Function::Neg => -x,
            Function::Reciprocal => 1.0 / x,
            Function::Selu(alpha, gamma) if x < 0.0 => gamma * alpha * libm::expm1f(x),
            Function::Selu(_, gamma) => gamma * x,
            Function::Sigmoid => 1.0 / (1.0 + libm::expf(-x)),
            Function::Softplus => softplus(x),
            Function::Softsign => x / (1.0 + x.abs()),
            Function::Sqrt => x.sqrt(),
            Function::Tanh => libm::tanhf(x),
        }
    }
}

/// An operation on two numbers, by its ONNX operator's name.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Binary {
    Add,
    Div,
    Max,
    Min,
    Mul,
    Pow,
    /// The second is the slope below zero.
    PRelu,
    Sub,
}

impl Binary {
    fn of(self, x: f32, y: f32) -> f32 {
        match self {
            Binary::Add => x + y,
            Binary::Div => x / y,
            Binary::Max => x.max(y),
            Binary::Min => x.min(y),
            Binary::Mul => x * y,
            Binary::Pow => libm::powf(x, y),
            Binary::PRelu => x * if x < 0.0 { y } else { 1.0 },
            Binary::Sub => x - y,
        }
    }
}

impl Expression {
    /// How many channels its constants say there are; 1: any number. An error where they do not agree.
    pub(crate) fn channels(&self) -> Result<usize, String> {
        match self {
            Expression::Input(_) => Ok(1),
            Expression::Constant(values) => Ok(values.len()),
            Expression::Function(_, of) => of.channels(),
            Expression::Binary(_, one, other) => match (one.channels()?, other.channels()?) {
                (1, channels) | (channels, 1) => Ok(channels),
                (one, other) if one == other => Ok(one),
                (one, other) => Err(format!("constants of {one} and of {other} channels meet")),
            },
        }
    }

    /// Whether it is a Clip of an input and nothing else.
    pub(crate) fn is_clip(&self) -> bool {
        matches!(self, Expression::Function(Function::Clip(..), of) if matches!(**of, Expression::Input(_)))
    }

    /// Rows of scratch that [`Self::row`] needs.
    pub(crate) fn scratch(&self) -> usize {
        match self {
            Expression::Input(_) | Expression::Constant(_) => 0,
            Expression::Function(_, of) => of.scratch(),
            Expression::Binary(_, one, other) => one.scratch().max(1 + other.scratch()),
        }
    }

    /// Evaluates a row of one channel; `input(number, row)` fills a row with that of an input.
    pub(crate) fn row(
        &self,
        input: &impl Fn(usize, &mut [f32]),
        channel: usize,
        out: &mut [f32],
        scratch: &mut [f32],
    ) {
        match self {
            Expression::Input(number) => input(*number, out),
            Expression::Constant(values) => {
                out.fill(values[if values.len() == 1 { 0 } else { channel }]);
            }
            Expression::Function(function, of) => {
                of.row(input, channel, out, scratch);
                for x in out {
                    *x = function.of(*x);
                }
            }
            Expression::Binary(binary, one, other) => {
                one.row(input, channel, out, scratch);
                let (second, scratch) = scratch.split_at_mut(out.len());
                other.row(input, channel, second, scratch);
                for (x, y) in out.iter_mut().zip(second) {
                    *x = binary.of(*x, *y);
                }
            }
        }
    }

    /// Its value for each byte of its only input; no constant may be per channel.
    pub(crate) fn table(&self, from: Quantization, to: Quantization) -> Box<[u8; 256]> {
        let mut values = [0.0; 256];
        let mut scratch = vec![0.0; 256 * self.scratch()];
        let bytes = |_: usize, row: &mut [f32]| {
            for (byte, value) in (0..=255).zip(row) {
                *value = from.real(byte);
            }
        };
        self.row(&bytes, 0, &mut values, &mut scratch);
        Box::new(values.map(|value| to.byte(value)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn constants_of_different_numbers_of_channels_do_not_meet() {
        let constant = |channels: usize| Box::new(Expression::Constant(vec![1.0; channels]));
        let with = |one: usize, other: usize| {
            let product =
                Expression::Binary(Binary::Mul, Box::new(Expression::Input(0)), constant(one));
            Expression::Binary(Binary::Add, Box::new(product), constant(other)).channels()
        };
        assert_eq!(
            [with(1, 1), with(1, 5), with(3, 1), with(3, 3)],
            [Ok(1), Ok(5), Ok(3), Ok(3)]
        );
        assert!(with(3, 5).is_err());
    }
}
