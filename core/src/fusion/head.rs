//! What a network hands over: maps, and what their values mean.

use crate::Error;
use crate::camera::{FOCAL_LENGTHS, ImageSize};
use crate::error::Head;
use crate::slope::SlopeClasses;

/// The values of a head, planar: all of channel 0, row-major, then all of channel 1, and so on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Samples<'a> {
    /// As they are.
    F32(&'a [f32]),
    /// Quantized: `(value - zero_point) * scale`.
    U8 {
        /// Quantized values.
        values: &'a [u8],
        /// Step; positive.
        scale: f32,
        /// The value that stands for 0.
        zero_point: u8,
    },
    /// Quantized: `(value - zero_point) * scale`.
    I8 {
        /// Quantized values.
        values: &'a [i8],
        /// Step; positive.
        scale: f32,
        /// The value that stands for 0.
        zero_point: i8,
    },
}

/// A head's map: `channels` planes of `size`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HeadMap<'a> {
    samples: Samples<'a>,
    channels: usize,
    size: ImageSize,
}

impl<'a> HeadMap<'a> {
    /// A map of `channels` planes, each of `size`, in NCHW order with N = 1.
    ///
    /// # Errors
    /// [`Error::HeadLength`] if the number of values is not `channels * size.pixels()`,
    /// [`Error::QuantizationScale`] if a scale is not positive, or a byte may stand for more than
    /// [`HEAD_VALUE_MAX`].
    pub fn new(samples: Samples<'a>, channels: usize, size: ImageSize) -> Result<Self, Error> {
        let (given, scale) = match samples {
            Samples::F32(values) => (values.len(), 1.0),
            Samples::U8 { values, scale, .. } => (values.len(), scale),
            Samples::I8 { values, scale, .. } => (values.len(), scale),
        };
        let needed = channels.saturating_mul(size.pixels());
        if given != needed {
            return Err(Error::HeadLength { needed, given });
        }
        // No difference of two bytes is larger.
        if !(scale > 0.0 && 255.0 * scale <= HEAD_VALUE_MAX) {
            return Err(Error::QuantizationScale(scale));
        }
        Ok(Self {
            samples,
            channels,
            size,
        })
    }

    /// Planes.
    pub const fn channels(&self) -> usize {
        self.channels
    }

    /// The size of each plane.
    pub const fn size(&self) -> ImageSize {
        self.size
    }

    /// Errs unless there is exactly one channel.
    pub(super) fn single(&self) -> Result<(), Error> {
        if self.channels != 1 {
            return Err(Error::HeadChannels {
                given: self.channels,
            });
        }
        Ok(())
    }

    /// Row `y` of a channel as numbers: in place, or in `scratch`, which has the map's width.
    #[cfg_attr(not(target_os = "none"), inline(always))]
    pub(super) fn row<'r>(&'r self, channel: usize, y: u32, scratch: &'r mut [f32]) -> &'r [f32] {
        let width = self.size.width() as usize;
        let start = channel * self.size.pixels() + y as usize * width;
        let range = start..start + width;
        match self.samples {
            Samples::F32(values) => return values.get(range).unwrap_or_default(),
            Samples::U8 {
                values,
                scale,
                zero_point,
            } => {
                for (out, value) in scratch
                    .iter_mut()
                    .zip(values.get(range).unwrap_or_default())
                {
                    *out = (i32::from(*value) - i32::from(zero_point)) as f32 * scale;
                }
            }
            Samples::I8 {
                values,
                scale,
                zero_point,
            } => {
                for (out, value) in scratch
                    .iter_mut()
                    .zip(values.get(range).unwrap_or_default())
                {
                    *out = (i32::from(*value) - i32::from(zero_point)) as f32 * scale;
                }
            }
        }
        scratch
    }

    /// Row `y` of a channel in place, if it is numbers already.
    #[inline(always)]
    pub(super) fn numbers(&self, channel: usize, y: u32) -> Option<&[f32]> {
        match self.samples {
            Samples::F32(_) => Some(self.row(channel, y, &mut [])),
            Samples::U8 { .. } | Samples::I8 { .. } => None,
        }
    }

    /// Writes row `y` of a channel as numbers; `row` has the map's width. Errs if one is NaN or beyond [`HEAD_VALUE_MAX`].
    #[inline(always)]
    pub(super) fn write_row(
        &self,
        (channel, head): (usize, Head),
        y: u32,
        row: &mut [f32],
    ) -> Result<(), Error> {
        match self.numbers(channel, y) {
            Some(numbers) => {
                let mut largest = 0;
                for (out, number) in row.iter_mut().zip(numbers) {
                    largest = largest.max(magnitude(*number));
                    *out = *number;
                }
                finite(largest, head)
            }
            None => check_finite(self.row(channel, y, row), head),
        }
    }
}

/// Errs if a value of this head is NaN or beyond [`HEAD_VALUE_MAX`].
#[inline(always)]
pub(super) fn check_finite(row: &[f32], head: Head) -> Result<(), Error> {
    let mut largest = 0;
    for value in row {
        largest = largest.max(magnitude(*value));
    }
    finite(largest, head)
}

/// The bits of |value|: as integers they are in the order of the numbers, infinity and then NaN last. Their maximum
/// vectorizes, where float tests would not.
#[inline(always)]
fn magnitude(value: f32) -> i32 {
    (value.to_bits() & 0x7fff_ffff).cast_signed()
}

/// Heads hold numbers within +-1e37: differences of those are finite, and upsampling takes differences.
pub const HEAD_VALUE_MAX: f32 = 1e37;

fn finite(largest: i32, head: Head) -> Result<(), Error> {
    if largest <= magnitude(HEAD_VALUE_MAX) {
        Ok(())
    } else {
        Err(Error::HeadNotFinite(head))
    }
}

/// Where a head's values become depth, attention or slope: before upsampling or after it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DecodeAt {
    /// At the head's size; what is upsampled is metres, M, or the tangent of the expected slope.
    HeadSize,
    /// At the output's size; what is upsampled is the head's raw values, logits among them.
    OutputSize,
}

/// What a residual head's values are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ResidualUnit {
    /// Metres.
    Metres,
    /// Natural logarithm of metres.
    LogMetres,
    /// Natural logarithm of depth over focal length: of the metres that a pixel of the network's input spans at that depth. A
    /// thing of known size tells them, whatever the lens.
    LogMetresPerPixel {
        /// `sqrt(fx fy)` of the network's input, pixels.
        focal_length: f32,
    },
}

impl ResidualUnit {
    /// What decoded values are to be multiplied with to be metres: after upsampling, with what is done to every pixel
    /// there, so that there is no loop more.
    ///
    /// # Errors
    /// [`Error::FocalLength`] outside 0.01 to 1e7.
    pub(super) fn metres(self) -> Result<f32, Error> {
        match self {
            Self::Metres | Self::LogMetres => Ok(1.0),
            Self::LogMetresPerPixel { focal_length } => {
                let focal = f64::from(focal_length);
                if FOCAL_LENGTHS.contains(&focal) {
                    Ok(focal_length)
                } else {
                    Err(Error::FocalLength(focal))
                }
            }
        }
    }
}

/// What an attention head's values are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AttentionUnit {
    /// Logits: `M = 1 / (1 + exp(-value))`.
    Logit,
    /// M itself; clamped to 0 to 1.
    Probability,
}

/// The residual depth: one channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ResidualHead<'a> {
    /// The values; beyond +-1e6 m, or 1e6 m a pixel, they are clamped to that.
    pub map: HeadMap<'a>,
    /// What they are.
    pub unit: ResidualUnit,
    /// Where they are decoded.
    pub decode_at: DecodeAt,
}

/// The ground attention M: one channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AttentionHead<'a> {
    /// The values.
    pub map: HeadMap<'a>,
    /// What they are.
    pub unit: AttentionUnit,
    /// Where they are decoded.
    pub decode_at: DecodeAt,
}

/// The slope logits: one channel a class, in the order of `classes`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SlopeHead<'a, const N: usize = 64> {
    /// The logits.
    pub map: HeadMap<'a>,
    /// Their angles.
    pub classes: &'a SlopeClasses<N>,
    /// Where softmax, expectation and tangent are taken.
    pub decode_at: DecodeAt,
}
