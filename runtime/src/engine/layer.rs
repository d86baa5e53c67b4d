//! The layers of an island and what each one means, exactly.
//!
//! Activations are bytes. A tensor that ONNX calls `int8` is kept as `q + 128` with its zero point moved likewise, so
//! that every kernel sees unsigned activations and signed weights; the meaning is the same.
//!
//! Notation: `x` a byte, `z` its zero point, `s` its scale, real value `s (x - z)`; subscripts i (input), w (weight), o
//! (output). `rne` rounds to the nearest integer, ties to even, as ONNX's QuantizeLinear does. All scale arithmetic is
//! f32, in the order written here, one rounding per operation (nothing contracts to a fused multiply-add), so that every
//! kernel on every machine gives the same bytes.
//!
//! - quantize: `rne(v / s_o) + z_o`, saturated.
//! - convolution: 32-bit accumulator `a = sum w (x - z_i) + bias`, then `rne(a m) + z_o`, saturated to `[low, high]`,
//!   `m = s_i s_w / s_o` per output channel. Padding counts as `x = z_i`. A result that leaves as f32 is `a (s_i s_w)`.
//!   The bias is an integer in units of `s_i s_w`, the form in which ONNX Runtime writes it; a bias given in f32 is
//!   rounded to that unit.
//! - addition: `rne((x_1 - z_1) s_1/s_o + (x_2 - z_2) s_2/s_o) + z_o`.
//! - multiplication: `rne((x_1 - z_1)(x_2 - z_2) (s_1 s_2 / s_o)) + z_o`.
//! - anything of one byte (activation functions, a change of scale): a table of 256 bytes, filled by the formula in f32.
//! - bilinear resize: `rne((interpolation of (x - z_i), along x first) s_i/s_o) + z_o`.
//! - average: `rne(sum (x - z_i) (s_i / s_o / n)) + z_o`.
//! - ReLU and Clip after any of these: `[low, high]`, since quantization is monotonic.
//! - padding, spreading, flattening, depth to space: bytes in other places, through a table where the scale changes.
//! - a transposed convolution: a spread (`s - 1` zero points between pixels) and a convolution with mirrored taps.
//! - anything else that goes element by element ([`super::expression`]): in f32, in the graph's own order, then quantized.
//!
//! Tensors have four dimensions, `[1, channels, height, width]`, or two, `[1, channels]`, which are kept as one pixel.

use std::ops::RangeInclusive;

use super::expression::Expression;

/// Channels, height and width of a picture's tensor (one picture at a time).
pub(crate) type Shape = [usize; 3];

/// How bytes stand for real numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Quantization {
    /// Real value of one step.
    pub(crate) scale: f32,
    /// The byte that stands for zero (already moved by 128 for `int8`).
    pub(crate) zero: u8,
}

impl Quantization {
    /// The real value of a byte.
    pub(crate) fn real(self, byte: u8) -> f32 {
        (i32::from(byte) - i32::from(self.zero)) as f32 * self.scale
    }

    /// The byte of a real value. NaN becomes the smallest byte.
    #[inline(always)]
    pub(crate) fn byte(self, real: f32) -> u8 {
        saturate(real / self.scale, self.zero, &(0..=255))
    }
}

/// `rne(value) + zero`, saturated to a range of bytes. NaN becomes the smallest.
#[inline(always)]
pub(crate) fn saturate(value: f32, zero: u8, range: &RangeInclusive<u8>) -> u8 {
    // What is added to it leaves no place for a fraction: f32 rounds to nearest, ties to even, and the last bits are the
    // integer. A cast saturates one value at a time.
    const ROUNDED: f32 = 1.5 * (1 << 23) as f32;
    // No byte is farther than 256 from the zero point. `max` loses a NaN, which `clamp` would keep.
    #[expect(clippy::manual_clamp)]
    let near = value.max(-256.0).min(256.0);
    let steps = (near + ROUNDED).to_bits() as i32 - ROUNDED.to_bits() as i32;
    let byte = steps + i32::from(zero);
    byte.clamp(i32::from(*range.start()), i32::from(*range.end())) as u8
}

/// A tensor that a layer reads.
#[derive(Clone, Debug)]
pub(crate) struct Operand {
    /// The tensor's name.
    pub(crate) name: String,
    /// How the layer reads its bytes; `None` where it is f32.
    pub(crate) quantization: Option<Quantization>,
}

/// What a layer writes.
#[derive(Clone, Debug)]
pub(crate) enum Form {
    /// Bytes in `range`.
    Bytes {
        /// What they stand for.
        quantization: Quantization,
        /// What ReLU and Clip leave of 0 to 255.
        range: RangeInclusive<u8>,
    },
    /// f32, in ONNX's planar layout, for whoever comes after the island or for an expression in it.
    Floats,
}

/// One layer of an island.
#[derive(Clone, Debug)]
pub(crate) struct Layer {
    /// What it computes.
    pub(crate) operation: Operation,
    /// What it reads.
    pub(crate) inputs: Vec<Operand>,
    /// Name of the tensor that it writes.
    pub(crate) output: String,
    /// In which form.
    pub(crate) form: Form,
}

/// What a layer computes.
#[derive(Clone, Debug)]
pub(crate) enum Operation {
    /// Bytes of an f32 tensor from outside; the layer's input names it.
    Quantize,
    /// f32 of a byte tensor.
    Dequantize,
    /// Two-dimensional convolution.
    Convolution(Convolution),
    /// Sum of two tensors, broadcast.
    Add,
    /// Product of two tensors, broadcast.
    Multiply,
    /// Channels of several tensors, one after the other.
    Concat,
    /// A function of one byte.
    Table(Box<[u8; 256]>),
    /// Another height and width.
    Resize(Resize),
    /// The greatest byte under a window, through a table where the scale changes.
    MaxPool(Window),
    /// The mean under a window; padding counts where the flag says so.
    AveragePool(Window, bool),
    /// The mean of each channel.
    GlobalAveragePool,
    /// Pixels further apart, or more of them around.
    Pad(Pad),
    /// Channels, rows and columns, in this order, as channels of one pixel.
    Flatten,
    /// Channels as pixels: PixelShuffle.
    DepthToSpace(DepthToSpace),
    /// What goes element by element, broadcast.
    Elementwise(Expression),
}

impl Operation {
    /// Whether it only moves bytes in and out.
    pub(crate) fn is_border(&self) -> bool {
        matches!(self, Operation::Quantize | Operation::Dequantize)
    }
}

/// Where a window of a convolution or a pool stands. Pairs are (along the height, along the width).
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Window {
    /// Rows and columns of taps.
    pub(crate) kernel: [usize; 2],
    /// Input pixels per output pixel.
    pub(crate) strides: [usize; 2],
    /// Input pixels from tap to tap.
    pub(crate) dilations: [usize; 2],
    /// Rows above, columns left, rows below, columns right.
    pub(crate) padding: Padding,
    /// Whether a last window may stand out over the end of the padding.
    pub(crate) ceil: bool,
}

/// Where a window's output stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Placed {
    /// Padding above and left.
    pub(crate) before: [usize; 2],
    /// Height and width of the input with all its padding.
    pub(crate) padded: [usize; 2],
    /// Height and width of the output.
    pub(crate) output: [usize; 2],
}

/// Of a tensor. Far more than any network has, and its bytes with all borders are far from usize's end.
const MOST_VALUES: usize = 1 << 31;

/// How many rows and columns of padding.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Padding {
    /// Above, left, below, right.
    Explicit([usize; 4]),
    /// As many as make `output = ceil(input / stride)`; the odd one at the end, or (true) at the beginning.
    Same(bool),
}

impl Placed {
    /// How many taps of the window of this output (row, column) stand on the input or on its padding.
    pub(crate) fn taps(&self, window: &Window, at: [usize; 2]) -> usize {
        let along = |axis: usize| {
            let first = at[axis] * window.strides[axis];
            let on = |tap: &usize| first + tap * window.dilations[axis] < self.padded[axis];
            (0..window.kernel[axis]).filter(on).count()
        };
        along(0) * along(1)
    }
}

impl Window {
    /// Over an input of this height and width.
    pub(crate) fn place(&self, input: [usize; 2]) -> Result<Placed, String> {
        let mut placed = Placed {
            before: [0; 2],
            padded: [0; 2],
            output: [0; 2],
        };
        for axis in 0..2 {
            let reach = (self.kernel[axis] - 1) * self.dilations[axis] + 1;
            let stride = self.strides[axis];
            let (before, padded) = match &self.padding {
                Padding::Explicit(pads) => (pads[axis], input[axis] + pads[axis] + pads[axis + 2]),
                Padding::Same(more_before) => {
                    let outputs = input[axis].div_ceil(stride);
                    let needed = outputs.saturating_sub(1) * stride + reach;
                    let total = needed.saturating_sub(input[axis]);
                    let before = if *more_before {
                        total.div_ceil(2)
                    } else {
                        total / 2
                    };
                    (before, input[axis] + total)
                }
            };
            if padded < reach || before >= reach {
                return Err(format!(
                    "a window of {reach} does not fit {} pixels with {before} of padding",
                    input[axis]
                ));
            }
            let mut steps = (padded - reach) / stride;
            // As PyTorch has it: no window starts beyond the input.
            if self.ceil
                && steps * stride + reach < padded
                && (steps + 1) * stride < input[axis] + before
            {
                steps += 1;
            }
            placed.before[axis] = before;
            placed.padded[axis] = padded;
            placed.output[axis] = steps + 1;
        }
        Ok(placed)
    }
}

/// Where each row and column of a padded tensor comes from. Pairs are (along the height, along the width).
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Pad {
    /// Rows above and columns left; negative: cut off.
    pub(crate) before: [i64; 2],
    /// Rows below and columns right; negative: cut off.
    pub(crate) after: [i64; 2],
    /// From pixel to pixel of the input; 1 where they stay neighbours.
    pub(crate) apart: [usize; 2],
    /// What stands where no pixel of the input does.
    pub(crate) fill: Fill,
}

/// What padding consists of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Fill {
    /// A real number.
    Constant(f32),
    /// The nearest pixel.
    Edge,
    /// The picture mirrored at its outermost pixels.
    Reflect,
}

impl Pad {
    fn output(&self, axis: usize, input: usize) -> Result<usize, String> {
        let spread = ((input - 1) * self.apart[axis] + 1) as i64;
        let length = spread + self.before[axis] + self.after[axis];
        if self.fill == Fill::Reflect && self.before[axis].max(self.after[axis]) >= input as i64 {
            return Err(format!("{input} pixels are too few to mirror"));
        }
        usize::try_from(length)
            .ok()
            .filter(|&length| length > 0)
            .ok_or_else(|| format!("nothing remains of {input} pixels"))
    }

    /// The row (axis 0) or column (axis 1) of the input that each of the output is; `None`: a constant.
    pub(crate) fn axis(&self, axis: usize, input: usize) -> Result<Vec<Option<usize>>, String> {
        let last = input as i64 - 1;
        let source = |at: usize| {
            let at = at as i64 - self.before[axis];
            let apart = self.apart[axis] as i64;
            let at = match self.fill {
                Fill::Constant(_) => (at.rem_euclid(apart) == 0
                    && (0..=last * apart).contains(&at))
                .then_some(at / apart),
                Fill::Edge => Some(at.clamp(0, last)),
                Fill::Reflect => Some(last - (last - at.abs()).abs()),
            };
            at.map(|at| at as usize)
        };
        Ok((0..self.output(axis, input)?).map(source).collect())
    }
}

/// Each pixel becomes a square of `block` x `block` pixels, of which each takes its part of the channels.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct DepthToSpace {
    /// Rows and columns of a square.
    pub(crate) block: usize,
    /// Whether the channels of one pixel are together (ONNX's DCR), or those of one channel (CRD).
    pub(crate) pixels_together: bool,
}

impl DepthToSpace {
    /// The input's channel of every output's `[row of the square][column of the square][channel]`.
    pub(crate) fn sources(&self, channels: usize) -> Vec<usize> {
        let squares = self.block * self.block;
        let outputs = channels / squares;
        (0..squares)
            .flat_map(|place| (0..outputs).map(move |channel| (place, channel)))
            .map(|(place, channel)| match self.pixels_together {
                true => place * outputs + channel,
                false => channel * squares + place,
            })
            .collect()
    }
}

/// A convolution. Grouped convolutions that are not depthwise are written out with zero weights.
#[derive(Clone, Debug)]
pub(crate) struct Convolution {
    /// Every channel has its own filter, and there are as many outputs as inputs.
    pub(crate) depthwise: bool,
    /// Number of input channels.
    pub(crate) inputs: usize,
    /// Number of output channels.
    pub(crate) outputs: usize,
    /// Less their zero points, -255 to 255: `[outputs, inputs (1 if depthwise), kernel rows, kernel columns]`.
    pub(crate) weights: Vec<i16>,
    /// Scale of each output channel's weights.
    pub(crate) scales: Vec<f32>,
    /// Bias of each output channel, in units of `s_i s_w`.
    pub(crate) bias: Vec<i32>,
    /// Where the taps are.
    pub(crate) window: Window,
}

impl Convolution {
    /// Weights of one output channel.
    pub(crate) fn filter(&self, output: usize) -> &[i16] {
        let length = self.weights.len() / self.outputs;
        &self.weights[output * length..][..length]
    }

    /// The same with a filter over all channels for each output, all but one zero.
    pub(crate) fn into_dense(mut self) -> Self {
        if self.depthwise {
            let taps = self.weights.len() / self.outputs;
            let mut weights = vec![0; self.outputs * self.inputs * taps];
            for output in 0..self.outputs {
                weights[(output * self.inputs + output) * taps..][..taps]
                    .copy_from_slice(self.filter(output));
            }
            self.weights = weights;
            self.depthwise = false;
        }
        self
    }

    /// Factor from accumulator to output steps (to real values where the output is f32), per output channel.
    pub(crate) fn factors(&self, input: Quantization, form: &Form) -> Vec<f32> {
        let factor = |&scale: &f32| match form {
            Form::Bytes { quantization, .. } => input.scale * scale / quantization.scale,
            Form::Floats => input.scale * scale,
        };
        self.scales.iter().map(factor).collect()
    }

    /// What the accumulators start from: bias less `z_i sum w`, so that kernels multiply raw bytes.
    pub(crate) fn starts(&self, input: Quantization) -> Vec<i32> {
        let start = |(output, &bias): (usize, &i32)| {
            let sum: i32 = self.filter(output).iter().map(|&w| i32::from(w)).sum();
            bias.wrapping_sub(i32::from(input.zero) * sum)
        };
        self.bias.iter().enumerate().map(start).collect()
    }

    /// Whether factors are finite, and no input whatever can carry an accumulator's final value, or a rounded result, out of 32 bits. (On the
    /// way there sums may wrap around: adding is exact modulo 2^32.)
    ///
    /// ONNX Runtime gives channels that never fire biases close to -2^31. Such a channel loses its weights here, and half
    /// its bias, provided that it comes out saturated either way.
    pub(crate) fn fit_32_bits(&mut self, input: Quantization, form: &Form) -> bool {
        let factors = self.factors(input, form);
        let (least, most) = (-i64::from(input.zero), 255 - i64::from(input.zero));
        let length = self.weights.len() / self.outputs;
        for (output, factor) in factors.into_iter().enumerate() {
            if !factor.is_finite() {
                return false;
            }
            let filter = || self.filter(output).iter().map(|&weight| i64::from(weight));
            let above: i64 = filter().map(|weight| weight.max(0)).sum();
            let below: i64 = filter().map(|weight| weight.min(0)).sum();
            let bias = i64::from(self.bias[output]);
            let ends = [
                bias + above * least + below * most,
                bias + above * most + below * least,
            ];
            let farthest = ends[0].abs().max(ends[1].abs());
            let step = match form {
                Form::Bytes { .. } => farthest as f64 * f64::from(factor),
                Form::Floats => 0.0,
            };
            if step >= f64::from(1 << 30) {
                return false;
            }
            if farthest >= i64::from(i32::MAX) {
                let Form::Bytes {
                    quantization,
                    range,
                } = form
                else {
                    return false;
                };
                let bias = self.bias[output] / 2;
                let byte = |end: i64| saturate(end as f32 * factor, quantization.zero, range);
                let low = [ends[1], i64::from(bias)].map(byte) == [*range.start(); 2];
                let high = [ends[0], i64::from(bias)].map(byte) == [*range.end(); 2];
                if !low && !high {
                    return false;
                }
                self.bias[output] = bias;
                self.weights[output * length..][..length].fill(0);
            }
        }
        true
    }
}

/// A resize of height and width.
#[derive(Clone, Debug)]
pub(crate) struct Resize {
    /// Bilinear instead of nearest.
    pub(crate) linear: bool,
    /// Where output pixels fall in the input.
    pub(crate) coordinates: Coordinates,
    /// Which of the two neighbours is the nearest.
    pub(crate) nearest: Nearest,
    /// By what factor, or to what size. (height, width)
    pub(crate) target: Target,
}

/// Of ONNX's coordinate_transformation_mode.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Coordinates {
    HalfPixel,
    PytorchHalfPixel,
    Asymmetric,
    AlignCorners,
}

/// Of ONNX's nearest_mode.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Nearest {
    RoundPreferFloor,
    RoundPreferCeil,
    Floor,
    Ceil,
}

/// Of ONNX's scales and sizes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Target {
    Scales([f32; 2]),
    Sizes([usize; 2]),
}

/// Where one output row or column comes from: two neighbours and the weight of the second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Between {
    pub(crate) first: usize,
    pub(crate) second: usize,
    pub(crate) weight: f32,
}

impl Resize {
    fn output(&self, input: [usize; 2]) -> [usize; 2] {
        match self.target {
            Target::Sizes(sizes) => sizes,
            Target::Scales(scales) => {
                [0, 1].map(|axis| (input[axis] as f32 * scales[axis]) as usize)
            }
        }
    }

    /// Where each output row (axis 0) or column (axis 1) comes from.
    pub(crate) fn axis(&self, axis: usize, input: [usize; 2]) -> Vec<Between> {
        let length = input[axis];
        let outputs = self.output(input)[axis];
        let scale = match self.target {
            Target::Scales(scales) => scales[axis],
            Target::Sizes(_) => outputs as f32 / length as f32,
        };
        let last = length - 1;
        let place = |output: usize| {
            let x = output as f32;
            let position = match self.coordinates {
                Coordinates::Asymmetric => x / scale,
                Coordinates::PytorchHalfPixel if outputs == 1 => 0.0,
                Coordinates::HalfPixel | Coordinates::PytorchHalfPixel => (x + 0.5) / scale - 0.5,
                Coordinates::AlignCorners if outputs == 1 => 0.0,
                Coordinates::AlignCorners => x * last as f32 / (outputs - 1) as f32,
            };
            if self.linear {
                let position = position.clamp(0.0, last as f32);
                let first = position as usize;
                let second = (first + 1).min(last);
                return Between {
                    first,
                    second,
                    weight: position - first as f32,
                };
            }
            // A tie, but for the rounding of scale and position, goes where ONNX Runtime has it go.
            let tie = (position - position.floor() - 0.5).abs() <= 1e-6;
            let nearest = match self.nearest {
                Nearest::RoundPreferFloor if tie => position.floor(),
                Nearest::RoundPreferCeil if tie => position.ceil(),
                Nearest::Floor => position.floor(),
                Nearest::Ceil => position.ceil(),
                Nearest::RoundPreferFloor | Nearest::RoundPreferCeil => position.round(),
            };
            let first = (nearest.max(0.0) as usize).min(last);
            Between {
                first,
                second: first,
                weight: 0.0,
            }
        };
        (0..outputs).map(place).collect()
    }
}

impl Layer {
    /// The output's shape, or why there is none.
    pub(crate) fn shape(&self, inputs: &[Shape]) -> Result<Shape, String> {
        let [channels, height, width] = inputs[0];
        let size = [height, width];
        let with = |channels: usize, [height, width]: [usize; 2]| [channels, height, width];
        let shape = match &self.operation {
            Operation::Quantize | Operation::Dequantize | Operation::Table(_) => inputs[0],
            Operation::Pad(pad) => with(channels, [pad.output(0, height)?, pad.output(1, width)?]),
            Operation::Flatten => with(channels * height * width, [1, 1]),
            Operation::DepthToSpace(DepthToSpace { block, .. }) => {
                let squares = block * block;
                if channels % squares != 0 {
                    return Err(format!("{channels} channels are no multiple of {squares}"));
                }
                with(channels / squares, size.map(|side| side * block))
            }
            Operation::Convolution(convolution) => {
                if channels != convolution.inputs {
                    return Err(format!(
                        "{channels} channels meet weights for {}",
                        convolution.inputs
                    ));
                }
                with(convolution.outputs, convolution.window.place(size)?.output)
            }
            Operation::Add | Operation::Multiply | Operation::Elementwise(_) => {
                let constants = match &self.operation {
                    Operation::Elementwise(expression) => expression.channels()?,
                    _ => 1,
                };
                inputs
                    .iter()
                    .chain([&[constants, 1, 1]])
                    .try_fold([1; 3], |one, other| broadcast(one, *other))?
            }
            Operation::Concat => {
                if inputs.iter().any(|shape| shape[1..] != inputs[0][1..]) {
                    return Err("the parts of a concatenation differ in size".to_owned());
                }
                with(inputs.iter().map(|shape| shape[0]).sum(), size)
            }
            Operation::Resize(resize) => with(channels, resize.output(size)),
            Operation::MaxPool(window) | Operation::AveragePool(window, _) => {
                with(channels, window.place(size)?.output)
            }
            Operation::GlobalAveragePool => with(channels, [1, 1]),
        };
        if shape.contains(&0) {
            return Err(format!("an empty tensor {shape:?}"));
        }
        let values = shape
            .iter()
            .try_fold(1_usize, |all, side| all.checked_mul(*side));
        if values.is_none_or(|values| values > MOST_VALUES) {
            return Err(format!(
                "a tensor {shape:?} is more than the engine has memory for"
            ));
        }
        Ok(shape)
    }
}

/// What two shapes are together: an axis of length 1 is repeated.
fn broadcast(one: Shape, other: Shape) -> Result<Shape, String> {
    let mut both = one;
    for (both, length) in both.iter_mut().zip(other) {
        *both = match (*both, length) {
            (1, length) | (length, 1) => length,
            (length, same) if length == same => length,
            _ => return Err(format!("shapes {one:?} and {other:?} do not match")),
        };
    }
    Ok(both)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// In f64, where nothing rounds before it is asked to.
    fn exact(value: f32, zero: u8, range: &RangeInclusive<u8>) -> u8 {
        let (start, end) = (f64::from(*range.start()), f64::from(*range.end()));
        match value.is_nan() {
            true => *range.start(),
            false => (f64::from(value).round_ties_even() + f64::from(zero)).clamp(start, end) as u8,
        }
    }

    #[test]
    fn bytes_are_the_nearest_ties_to_even_and_saturate() {
        let quarters = (-1200..=1200).map(|k| k as f32 / 4.0);
        let beside = |x: f32| [x.next_down(), x, x.next_up()];
        let extremes = [
            f32::NAN,
            -f32::NAN,
            f32::INFINITY,
            f32::MAX,
            1e9,
            8_388_609.0,
            f32::MIN_POSITIVE,
        ];
        let values = quarters
            .flat_map(beside)
            .chain(extremes.into_iter().flat_map(|x| [x, -x]));
        for value in values {
            for zero in [0, 1, 127, 128, 255] {
                for range in [0..=255, 3..=250, 128..=255, 200..=200] {
                    let (byte, exact) = (saturate(value, zero, &range), exact(value, zero, &range));
                    assert_eq!(byte, exact, "{value}, {zero}, {range:?}");
                }
            }
        }
    }
}
