//! From a head's values to metres, attention and the tangent of the slope, row by row; plain loops that vectorize.

use super::head::{
    AttentionHead, AttentionUnit, DecodeAt, HeadMap, ResidualHead, ResidualUnit, check_finite,
    decode_row,
};
use super::upsample::{self, SourceRows, Upsampler, Upsampling};
use super::{Scratch, SlopeHead};
use crate::Error;
use crate::camera::ImageSize;
use crate::error::Head;
use crate::polynomial::{clamp, exp, tan};

/// Residuals are kept within this many metres, so that no difference of two overflows.
const RESIDUAL_MAX: f32 = 1e6;

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
    fn in_place(self, row: &mut [f32]) {
        match self {
            Self::Metres => each(row, metres),
            Self::LogMetres => each(row, log_metres),
            Self::Logit => each(row, logit),
            Self::Probability => each(row, probability),
        }
    }

    /// Writes what the numbers of a head say. Errs if one is NaN or beyond [`HEAD_VALUE_MAX`](super::HEAD_VALUE_MAX).
    #[inline(always)]
    fn row(self, head: Head, numbers: &[f32], row: &mut [f32]) -> Result<(), Error> {
        match self {
            Self::Metres => decode_row(head, numbers, row, metres),
            Self::LogMetres => decode_row(head, numbers, row, log_metres),
            Self::Logit => decode_row(head, numbers, row, logit),
            Self::Probability => decode_row(head, numbers, row, probability),
        }
    }
}

#[inline(always)]
fn each(row: &mut [f32], decode: impl Fn(f32) -> f32) {
    for value in row {
        *value = decode(*value);
    }
}

#[inline(always)]
fn metres(value: f32) -> f32 {
    clamp(value, -RESIDUAL_MAX, RESIDUAL_MAX)
}

#[inline(always)]
fn log_metres(value: f32) -> f32 {
    clamp(exp(value), 0.0, RESIDUAL_MAX)
}

#[inline(always)]
fn logit(value: f32) -> f32 {
    1.0 / (1.0 + exp(-value))
}

#[inline(always)]
fn probability(value: f32) -> f32 {
    clamp(value, 0.0, 1.0)
}

/// A head of one channel on its way to the output's size.
pub(super) struct Plane<'a, 's> {
    source: PlaneRows<'a>,
    late: Option<Decoding>,
    upsampler: Upsampler<'s>,
}

/// Its rows at its own size.
struct PlaneRows<'a> {
    map: HeadMap<'a>,
    head: Head,
    decoding: Option<Decoding>,
}

impl SourceRows for PlaneRows<'_> {
    // Firmware has no vectors to be compiled for, and less memory for copies.
    #[cfg_attr(not(target_os = "none"), inline(always))]
    fn write_row(&mut self, y: u32, row: &mut [f32]) -> Result<(), Error> {
        match (self.decoding, self.map.numbers(0, y)) {
            (Some(decoding), Some(numbers)) => decoding.row(self.head, numbers, row),
            (decoding, _) => {
                self.map.write_row((0, self.head), y, row)?;
                if let Some(decoding) = decoding {
                    decoding.in_place(row);
                }
                Ok(())
            }
        }
    }
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
            ResidualUnit::LogMetres | ResidualUnit::LogMetresPerPixel { .. } => Decoding::LogMetres,
        };
        let (map, at) = (head.map, head.decode_at);
        Self::new(
            map,
            Head::Residual,
            decoding,
            at,
            upsampling,
            output,
            scratch,
        )
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
        let (map, at) = (head.map, head.decode_at);
        Self::new(
            map,
            Head::Attention,
            decoding,
            at,
            upsampling,
            output,
            scratch,
        )
    }

    fn new(
        map: HeadMap<'a>,
        head: Head,
        decoding: Decoding,
        decode_at: DecodeAt,
        upsampling: Upsampling,
        output: ImageSize,
        scratch: &mut Scratch<'s>,
    ) -> Result<Self, Error> {
        map.single()?;
        let (early, late) = match decode_at {
            DecodeAt::HeadSize => (Some(decoding), None),
            DecodeAt::OutputSize => (None, Some(decoding)),
        };
        Ok(Self {
            source: PlaneRows {
                map,
                head,
                decoding: early,
            },
            late,
            upsampler: Upsampler::new(upsampling, 1, map.size(), output, scratch)?,
        })
    }

    /// Writes the decoded output row `v`.
    // Firmware has no vectors to be compiled for, and less memory for copies.
    #[cfg_attr(not(target_os = "none"), inline(always))]
    pub(super) fn row(&mut self, v: u32, out: &mut [f32]) -> Result<(), Error> {
        self.upsampler.row(v, out, &mut self.source)?;
        if let Some(decoding) = self.late {
            decoding.in_place(out);
        }
        Ok(())
    }
}

/// The slope head on its way to the tangent of the expected slope at every output pixel.
pub(super) struct SlopeTangent<'a, 's> {
    source: SlopeRows<'a, 's>,
    upsampler: Upsampler<'s>,
    /// Where logits are upsampled: what decodes them then.
    late: Option<(&'s mut [f32], Softmax<'a, 's>)>,
}

/// What is upsampled. Not a type each: all of the upsampling is inlined, and would be there twice.
enum SlopeRows<'a, 's> {
    Tangents(TangentRows<'a, 's>),
    Logits(LogitRows<'a>),
}

impl SourceRows for SlopeRows<'_, '_> {
    #[inline(always)]
    fn write_row(&mut self, y: u32, row: &mut [f32]) -> Result<(), Error> {
        match self {
            Self::Tangents(tangents) => tangents.write_row(y, row),
            Self::Logits(logits) => logits.write_row(y, row),
        }
    }
}

/// Tangents at the head's size.
struct TangentRows<'a, 's> {
    map: HeadMap<'a>,
    logits: &'s mut [f32],
    softmax: Softmax<'a, 's>,
}

/// The logits of all classes at the head's size, class after class.
struct LogitRows<'a> {
    map: HeadMap<'a>,
}

/// A row's softmax over classes, on the way to the tangent of the expected angle.
struct Softmax<'a, 's> {
    angles: &'a [f32],
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
    let rows = classes.saturating_add(2).saturating_mul(wider);
    upsample::scratch_len(classes, input_width, output_width).saturating_add(rows)
}

impl<'a, 's> SlopeTangent<'a, 's> {
    pub(super) fn new<const N: usize>(
        head: &SlopeHead<'a, N>,
        upsampling: Upsampling,
        output: ImageSize,
        scratch: &mut Scratch<'s>,
    ) -> Result<Self, Error> {
        let (map, angles) = (head.map, head.classes.radians());
        if map.channels() != angles.len() {
            return Err(Error::SlopeLogitCount {
                classes: angles.len(),
                given: map.channels(),
            });
        }
        let input = map.size();
        let early = head.decode_at == DecodeAt::HeadSize;
        let width = if early { input } else { output }.width() as usize;
        let channels = if early { 1 } else { angles.len() };
        let logits = scratch.take(channels.saturating_mul(width))?;
        let softmax = Softmax {
            angles,
            largest: scratch.take(width)?,
            sum: scratch.take(width)?,
        };
        let upsampler = Upsampler::new(upsampling, channels, input, output, scratch)?;
        let (source, late) = if early {
            let tangents = TangentRows {
                map,
                logits,
                softmax,
            };
            (SlopeRows::Tangents(tangents), None)
        } else {
            (
                SlopeRows::Logits(LogitRows { map }),
                Some((logits, softmax)),
            )
        };
        Ok(Self {
            source,
            upsampler,
            late,
        })
    }

    /// Writes the tangents of output row `v`.
    // Firmware has no vectors to be compiled for, and less memory for copies.
    #[cfg_attr(not(target_os = "none"), inline(always))]
    pub(super) fn row(&mut self, v: u32, out: &mut [f32]) -> Result<(), Error> {
        let upsampled = match &mut self.late {
            Some((logits, _)) => &mut **logits,
            None => &mut *out,
        };
        self.upsampler.row(v, upsampled, &mut self.source)?;
        if let Some((logits, softmax)) = &mut self.late {
            let rows = logits.chunks_exact(out.len().max(1));
            softmax.begin();
            for row in rows.clone() {
                softmax.raise(row);
            }
            out.fill(0.0);
            for (class, row) in rows.enumerate() {
                softmax.accumulate(class, row, out);
            }
            softmax.finish(out);
        }
        Ok(())
    }
}

impl SourceRows for TangentRows<'_, '_> {
    #[inline(always)]
    fn write_row(&mut self, y: u32, row: &mut [f32]) -> Result<(), Error> {
        self.softmax.begin();
        for class in 0..self.map.channels() {
            let logits = self.map.row(class, y, self.logits);
            check_finite(logits, Head::Slope)?;
            self.softmax.raise(logits);
        }
        row.fill(0.0);
        for class in 0..self.map.channels() {
            let logits = self.map.row(class, y, self.logits);
            self.softmax.accumulate(class, logits, row);
        }
        self.softmax.finish(row);
        Ok(())
    }
}

impl SourceRows for LogitRows<'_> {
    #[inline(always)]
    fn write_row(&mut self, y: u32, rows: &mut [f32]) -> Result<(), Error> {
        let width = self.map.size().row();
        for (class, row) in rows.chunks_exact_mut(width).enumerate() {
            self.map.write_row((class, Head::Slope), y, row)?;
        }
        Ok(())
    }
}

impl Softmax<'_, '_> {
    /// Starts a row: first [`Self::raise`] with all classes, then [`Self::accumulate`] with all, then [`Self::finish`].
    #[inline(always)]
    fn begin(&mut self) {
        self.largest.fill(f32::MIN);
        self.sum.fill(0.0);
    }

    #[inline(always)]
    fn raise(&mut self, logits: &[f32]) {
        for (largest, logit) in self.largest.iter_mut().zip(logits) {
            *largest = largest.max(*logit);
        }
    }

    /// Adds one class to the sums of weights and of weighted angles.
    #[inline(always)]
    fn accumulate(&mut self, class: usize, logits: &[f32], weighted: &mut [f32]) {
        let angle = self.angles.get(class).copied().unwrap_or(0.0);
        accumulate(weighted, self.sum, logits, self.largest, angle);
    }

    /// From weighted angles to the tangent of their mean.
    #[inline(always)]
    fn finish(&self, weighted: &mut [f32]) {
        for (value, sum) in weighted.iter_mut().zip(self.sum.iter()) {
            *value = tan(*value / sum);
        }
    }
}

/// A function of its own: as arguments, slices are known not to overlap, without which this does not vectorize.
#[inline(always)]
fn accumulate(weighted: &mut [f32], sum: &mut [f32], logits: &[f32], largest: &[f32], angle: f32) {
    for (((weighted, sum), logit), largest) in weighted.iter_mut().zip(sum).zip(logits).zip(largest)
    {
        let weight = exp(logit - largest);
        *sum += weight;
        *weighted += weight * angle;
    }
}
