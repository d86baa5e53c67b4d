//! From a head's values to metres, attention and the tangent of the slope, row by row; plain loops that vectorize.

use super::head::{AttentionHead, AttentionUnit, DecodeAt, HeadMap, ResidualHead, ResidualUnit};
use super::upsample::{self, Upsampler, Upsampling};
use super::{Scratch, SlopeHead};
use crate::Error;
use crate::camera::ImageSize;
use crate::error::Head;
use crate::slope::SlopeClasses;

/// Residuals are kept within this many metres, so that no difference of two overflows.
const RESIDUAL_MAX: f32 = 1e6;

/// `e^x`, to 2e-7 relative from -87 to 88; beyond, its value at the nearer end. NaN gives NaN or an end.
///
/// One polynomial, no branch, no table: it vectorizes, and gives the same bits on every processor.
#[inline(always)]
pub(crate) fn exp(x: f32) -> f32 {
    let x = x.max(-87.0).min(88.0);
    // x = n ln 2 + r. Adding 1.5 * 2^23 rounds to the nearest integer and leaves n in the low bits.
    const ROUND: f32 = 12_582_912.0;
    let shifted = x * core::f32::consts::LOG2_E + ROUND;
    let n = shifted - ROUND;
    // ln 2 in two parts, the first short enough that its product with n is exact.
    let r = x - n * 0.693_359_4 + n * 2.121_944_4e-4;
    // The series of e^r up to r^7; |r| <= 0.35 leaves 6e-9.
    let p = 1.0 / 5040.0 * r + 1.0 / 720.0;
    let p = p * r + 1.0 / 120.0;
    let p = p * r + 1.0 / 24.0;
    let p = p * r + 1.0 / 6.0;
    let p = p * r + 0.5;
    let p = p * r + 1.0;
    let p = p * r + 1.0;
    let power = f32::from_bits((shifted.to_bits() << 23).wrapping_add(0x3f80_0000));
    p * power
}

/// `tan x` for |x| up to 0.53 (30.3 degrees), to 2e-7 relative: its series up to x^15.
#[inline(always)]
fn tan(x: f32) -> f32 {
    let s = x * x;
    let p = 929_569.0 / 638_512_875.0 * s + 21_844.0 / 6_081_075.0;
    let p = p * s + 1_382.0 / 155_925.0;
    let p = p * s + 62.0 / 2_835.0;
    let p = p * s + 17.0 / 315.0;
    let p = p * s + 2.0 / 15.0;
    let p = p * s + 1.0 / 3.0;
    x + x * (s * p)
}

/// What is done to every value of a plane.
#[derive(Clone, Copy)]
enum Decoding {
    Metres,
    LogMetres,
    Logit,
    Probability,
}

impl Decoding {
    #[inline(always)]
    fn apply(self, row: &mut [f32]) {
        match self {
            Self::Metres => {
                for value in row {
                    *value = value.max(-RESIDUAL_MAX).min(RESIDUAL_MAX);
                }
            }
            Self::LogMetres => {
                for value in row {
                    *value = exp(*value).min(RESIDUAL_MAX);
                }
            }
            Self::Logit => {
                for value in row {
                    *value = 1.0 / (1.0 + exp(-*value));
                }
            }
            Self::Probability => {
                for value in row {
                    *value = value.max(0.0).min(1.0);
                }
            }
        }
    }
}

/// A head of one channel on its way to the output's size.
pub(super) struct Plane<'a, 's> {
    map: HeadMap<'a>,
    head: Head,
    decoding: Decoding,
    decode_at: DecodeAt,
    upsampler: Upsampler<'s>,
}

impl<'a, 's> Plane<'a, 's> {
    pub(super) fn residual(
        head: &ResidualHead<'a>,
        upsampling: Upsampling,
        output: ImageSize,
        scratch: &mut Scratch<'s>,
    ) -> Result<Self, Error> {
        let decoding = match head.unit {
            ResidualUnit::Metres => Decoding::Metres,
            ResidualUnit::LogMetres => Decoding::LogMetres,
        };
        head.map.single()?;
        Ok(Self {
            map: head.map,
            head: Head::Residual,
            decoding,
            decode_at: head.decode_at,
            upsampler: Upsampler::new(upsampling, 1, head.map.size(), output, scratch)?,
        })
    }

    pub(super) fn attention(
        head: &AttentionHead<'a>,
        upsampling: Upsampling,
        output: ImageSize,
        scratch: &mut Scratch<'s>,
    ) -> Result<Self, Error> {
        let decoding = match head.unit {
            AttentionUnit::Logit => Decoding::Logit,
            AttentionUnit::Probability => Decoding::Probability,
        };
        head.map.single()?;
        Ok(Self {
            map: head.map,
            head: Head::Attention,
            decoding,
            decode_at: head.decode_at,
            upsampler: Upsampler::new(upsampling, 1, head.map.size(), output, scratch)?,
        })
    }

    /// Writes the decoded output row `v`.
    #[inline(always)]
    pub(super) fn row(&mut self, v: u32, out: &mut [f32]) -> Result<(), Error> {
        let (map, decoding, decode_at) = (&self.map, self.decoding, self.decode_at);
        let not_finite = Error::HeadNotFinite(self.head);
        self.upsampler.row(v, out, |y, row| {
            if !map.read_row(0, y, row) {
                return Err(not_finite);
            }
            if decode_at == DecodeAt::HeadSize {
                decoding.apply(row);
            }
            Ok(())
        })?;
        if decode_at == DecodeAt::OutputSize {
            decoding.apply(out);
        }
        Ok(())
    }
}

/// The slope head on its way to the tangent of the expected slope at every output pixel.
pub(super) struct SlopeTangent<'a, 's, const N: usize> {
    map: HeadMap<'a>,
    classes: &'a SlopeClasses<N>,
    decode_at: DecodeAt,
    /// Of tangents, or of logits.
    upsampler: Upsampler<'s>,
    /// A row of logits: of one class at the head's size, or of all at the output's.
    logits: &'s mut [f32],
    largest: &'s mut [f32],
    sum: &'s mut [f32],
}

/// Scratch that a [`SlopeTangent`] takes, whichever way it decodes.
pub(super) const fn slope_scratch_len(
    classes: usize,
    input_width: usize,
    output_width: usize,
) -> usize {
    let wider = if input_width > output_width {
        input_width
    } else {
        output_width
    };
    upsample::scratch_len(classes, input_width, output_width) + (classes + 2) * wider
}

impl<'a, 's, const N: usize> SlopeTangent<'a, 's, N> {
    pub(super) fn new(
        head: &SlopeHead<'a, N>,
        upsampling: Upsampling,
        output: ImageSize,
        scratch: &mut Scratch<'s>,
    ) -> Result<Self, Error> {
        let (map, classes) = (head.map, head.classes.radians().len());
        if map.channels() != classes {
            return Err(Error::SlopeLogitCount {
                classes,
                given: map.channels(),
            });
        }
        let (width, held, upsampled) = match head.decode_at {
            DecodeAt::HeadSize => (map.size().width() as usize, 1, 1),
            DecodeAt::OutputSize => (output.width() as usize, classes, classes),
        };
        Ok(Self {
            map,
            classes: head.classes,
            decode_at: head.decode_at,
            upsampler: Upsampler::new(upsampling, upsampled, map.size(), output, scratch)?,
            logits: scratch.take(held * width)?,
            largest: scratch.take(width)?,
            sum: scratch.take(width)?,
        })
    }

    /// Writes the tangents of output row `v`.
    #[inline(always)]
    pub(super) fn row(&mut self, v: u32, out: &mut [f32]) -> Result<(), Error> {
        let map = &self.map;
        let angles = self.classes.radians();
        match self.decode_at {
            DecodeAt::HeadSize => {
                let (logits, largest, sum) =
                    (&mut *self.logits, &mut *self.largest, &mut *self.sum);
                self.upsampler.row(v, out, |y, row| {
                    largest.fill(f32::MIN);
                    for class in 0..angles.len() {
                        read_logits(map, class, y, logits)?;
                        raise(largest, logits);
                    }
                    row.fill(0.0);
                    sum.fill(0.0);
                    for (class, angle) in angles.iter().enumerate() {
                        read_logits(map, class, y, logits)?;
                        accumulate(row, sum, logits, largest, *angle);
                    }
                    tangents(row, sum);
                    Ok(())
                })
            }
            DecodeAt::OutputSize => {
                let input_width = map.size().width() as usize;
                self.upsampler.row(v, self.logits, |y, rows| {
                    for (class, row) in rows.chunks_exact_mut(input_width).enumerate() {
                        read_logits(map, class, y, row)?;
                    }
                    Ok(())
                })?;
                let rows = self.logits.chunks_exact(out.len().max(1));
                self.largest.fill(f32::MIN);
                for row in rows.clone() {
                    raise(self.largest, row);
                }
                out.fill(0.0);
                self.sum.fill(0.0);
                for (row, angle) in rows.zip(angles) {
                    accumulate(out, self.sum, row, self.largest, *angle);
                }
                tangents(out, self.sum);
                Ok(())
            }
        }
    }
}

#[inline(always)]
fn read_logits(map: &HeadMap<'_>, class: usize, y: u32, row: &mut [f32]) -> Result<(), Error> {
    if map.read_row(class, y, row) {
        Ok(())
    } else {
        Err(Error::HeadNotFinite(Head::Slope))
    }
}

#[inline(always)]
fn raise(largest: &mut [f32], logits: &[f32]) {
    for (largest, logit) in largest.iter_mut().zip(logits) {
        *largest = largest.max(*logit);
    }
}

/// Adds one class to the softmax's two sums: of weights, and of weighted angles.
#[inline(always)]
fn accumulate(weighted: &mut [f32], sum: &mut [f32], logits: &[f32], largest: &[f32], angle: f32) {
    for (((weighted, sum), logit), largest) in weighted.iter_mut().zip(sum).zip(logits).zip(largest)
    {
        let weight = exp(logit - largest);
        *sum += weight;
        *weighted += weight * angle;
    }
}

/// From weighted angles to the tangent of their mean.
#[inline(always)]
fn tangents(weighted: &mut [f32], sum: &[f32]) {
    for (value, sum) in weighted.iter_mut().zip(sum) {
        *value = tan(*value / sum);
    }
}
