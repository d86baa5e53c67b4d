//! From a head's values to metres, attention and the tangent of the slope, row by row; plain loops that vectorize.

use super::head::{
    AttentionHead, AttentionUnit, DecodeAt, HeadMap, ResidualHead, ResidualUnit, check_finite,
};
use super::upsample::{self, Between, SourceRows, Upsampler, Upsampling};
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
    upsampler: Upsampler<'s>,
    /// Where raw values are upsampled: what decodes them then, and the row.
    late: Option<(Decoding, &'s mut [f32])>,
}

/// Scratch that a [`Plane`] takes, wherever it is decoded.
pub(super) const fn plane_scratch_len(input_width: usize, output_width: usize) -> usize {
    upsample::scratch_len(1, input_width, output_width).saturating_add(output_width)
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
        self.map.write_row((0, self.head), y, row)?;
        if let Some(decoding) = self.decoding {
            decoding.in_place(row);
        }
        Ok(())
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
            DecodeAt::OutputSize => {
                let row = scratch.take(output.width() as usize)?;
                (None, Some((decoding, row)))
            }
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

    /// Makes output row `v`.
    // Firmware has no vectors to be compiled for, and less memory for copies.
    #[cfg_attr(not(target_os = "none"), inline(always))]
    pub(super) fn advance(&mut self, v: u32) -> Result<(), Error> {
        self.upsampler.advance(v, &mut self.source)?;
        if let Some((decoding, row)) = &mut self.late {
            self.upsampler.between().write(row);
            decoding.in_place(row);
        }
        Ok(())
    }

    /// The decoded row that [`Self::advance`] made.
    #[inline(always)]
    pub(super) fn row(&self) -> Between<'_> {
        match &self.late {
            Some((_, row)) => Between::itself(row),
            None => self.upsampler.between(),
        }
    }
}

/// The slope head on its way to the tangent of the expected slope at every output pixel.
pub(super) struct SlopeTangent<'a, 's> {
    source: SlopeRows<'a, 's>,
    upsampler: Upsampler<'s>,
    width: usize,
    /// Where logits are upsampled: what decodes them then, and the row.
    late: Option<(Softmax<'a, 's>, &'s mut [f32])>,
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
    upsample::scratch_len(classes, input_width, output_width)
        .saturating_add(wider.saturating_mul(3))
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
        let row = scratch.take(width)?;
        let softmax = Softmax {
            angles,
            largest: scratch.take(width)?,
            sum: scratch.take(width)?,
        };
        let upsampler = Upsampler::new(upsampling, channels, input, output, scratch)?;
        let (source, late) = if early {
            let tangents = TangentRows {
                map,
                logits: row,
                softmax,
            };
            (SlopeRows::Tangents(tangents), None)
        } else {
            (SlopeRows::Logits(LogitRows { map }), Some((softmax, row)))
        };
        Ok(Self {
            source,
            upsampler,
            width: output.width() as usize,
            late,
        })
    }

    /// Makes the tangents of output row `v`.
    // Firmware has no vectors to be compiled for, and less memory for copies.
    #[cfg_attr(not(target_os = "none"), inline(always))]
    pub(super) fn advance(&mut self, v: u32) -> Result<(), Error> {
        self.upsampler.advance(v, &mut self.source)?;
        if let Some((softmax, tangents)) = &mut self.late {
            let logits = self.upsampler.between();
            softmax.begin(tangents);
            for class in 0..softmax.angles.len() {
                softmax.raise(logits.channel(class, self.width));
            }
            for class in 0..softmax.angles.len() {
                softmax.accumulate(class, logits.channel(class, self.width), tangents);
            }
            softmax.finish(tangents);
        }
        Ok(())
    }

    /// The tangents that [`Self::advance`] made.
    #[inline(always)]
    pub(super) fn row(&self) -> Between<'_> {
        match &self.late {
            Some((_, tangents)) => Between::itself(tangents),
            None => self.upsampler.between(),
        }
    }
}

impl SourceRows for TangentRows<'_, '_> {
    #[inline(always)]
    fn write_row(&mut self, y: u32, row: &mut [f32]) -> Result<(), Error> {
        self.softmax.begin(row);
        for class in 0..self.map.channels() {
            let logits = self.map.row(class, y, self.logits);
            check_finite(logits, Head::Slope)?;
            self.softmax.raise(Between::itself(logits));
        }
        for class in 0..self.map.channels() {
            let logits = Between::itself(self.map.row(class, y, self.logits));
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
    fn begin(&mut self, weighted: &mut [f32]) {
        self.largest.fill(f32::MIN);
        self.sum.fill(0.0);
        weighted.fill(0.0);
    }

    #[inline(always)]
    fn raise(&mut self, logits: Between<'_>) {
        for (largest, pair) in self.largest.iter_mut().zip(logits.pairs()) {
            *largest = largest.max(logits.value(pair));
        }
    }

    /// Adds one class to the sums of weights and of weighted angles.
    #[inline(always)]
    fn accumulate(&mut self, class: usize, logits: Between<'_>, weighted: &mut [f32]) {
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
fn accumulate(
    weighted: &mut [f32],
    sum: &mut [f32],
    logits: Between<'_>,
    largest: &[f32],
    angle: f32,
) {
    let sums = weighted.iter_mut().zip(sum);
    for (((weighted, sum), pair), largest) in sums.zip(logits.pairs()).zip(largest) {
        let weight = exp(logits.value(pair) - largest);
        *sum += weight;
        *weighted += weight * angle;
    }
}
