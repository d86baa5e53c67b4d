//! Fusion as the reference implementation does it, for networks that it exported. Not for new ones: zeros bleed over the
//! horizon, and the slope's height is not the camera's.
//!
//! At the input's size: `M z`, `z` being 0 where it is negative or beyond the limit. Adaptive: slope logits upsampled
//! (half-pixel), softmax, expectation, `z = h / (h / z_plane - tan(alpha))` with the implementation's own `h` and its 1e-8
//! against division by zero. `M` and `M z` are resized to the decoder's size with corners aligned; there
//! `depth = max(residual, 0) (1 - M) + M z + min`, clamped, and resized back with corners aligned.

use super::decode::SlopeTangent;
use super::head::{DecodeAt, HeadMap, SlopeHead};
use super::upsample::{self, SourceRows, Upsampler, Upsampling};
use super::{DepthRange, Scratch, check_output};
use crate::Error;
use crate::camera::ImageSize;
use crate::error::Head;
use crate::polynomial::clamp;
use crate::table::GroundRows;

/// The reference implementation's fusion and its settings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReferenceFusion {
    slope_height: f32,
    ground_limit: f32,
    depth: DepthRange,
}

/// Scratch values that [`ReferenceFusion`] needs for input of this size, a decoder of the width `decoder_width`, and a
/// slope head of the width `slope_width` with so many classes (0 for none).
pub const fn reference_scratch_len(
    input: ImageSize,
    decoder_width: u32,
    slope_width: u32,
    slope_classes: usize,
) -> usize {
    let (input, decoder) = (input.width() as usize, decoder_width as usize);
    let slope = if slope_classes > 0 {
        super::decode::slope_scratch_len(slope_classes, slope_width as usize, input)
    } else {
        0
    };
    let down = upsample::scratch_len(2, input, decoder).saturating_add(decoder.saturating_mul(2));
    let up = upsample::scratch_len(1, decoder, input);
    slope.saturating_add(down).saturating_add(up)
}

impl ReferenceFusion {
    /// `slope_height`: the `h` of the slope formula, metres (1.65 on KITTI, though the plane is 1.578 m below the camera);
    /// `ground_limit`: ground beyond is none, metres (200 on KITTI, 250 on DDAD).
    ///
    /// # Errors
    /// [`Error::CameraNotAboveGround`] or [`Error::GroundLimit`] if either is not positive and finite.
    pub fn new(slope_height: f32, ground_limit: f32, depth: DepthRange) -> Result<Self, Error> {
        if !(slope_height > 0.0 && slope_height.is_finite()) {
            return Err(Error::CameraNotAboveGround {
                height: f64::from(slope_height),
            });
        }
        if !(ground_limit > 0.0 && ground_limit.is_finite()) {
            return Err(Error::GroundLimit(ground_limit));
        }
        Ok(Self {
            slope_height,
            ground_limit,
            depth,
        })
    }

    /// Vanilla. `residual`: metres at the decoder's size; `attention`: M, 0 to 1, at the input's (the ground's) size;
    /// `depth`: the input's pixels, metres.
    ///
    /// # Errors
    /// [`Error::HeadSize`] if the attention has another size than the ground, [`Error::HeadChannels`],
    /// [`Error::HeadNotFinite`], [`Error::OutputLength`], [`Error::ScratchLength`], [`Error::GroundRow`].
    #[inline(always)]
    pub fn vanilla<G: GroundRows + ?Sized>(
        &self,
        ground: &G,
        residual: &HeadMap<'_>,
        attention: &HeadMap<'_>,
        scratch: &mut [f32],
        depth: &mut [f32],
    ) -> Result<(), Error> {
        let scratch = &mut Scratch::new(scratch);
        self.fuse(ground, None, residual, attention, scratch, depth)
    }

    /// Adaptive: as [`Self::vanilla`], with the slope's logits at any size; `slope.decode_at` is not looked at.
    ///
    /// # Errors
    /// As [`Self::vanilla`], and [`Error::SlopeLogitCount`].
    #[inline(always)]
    pub fn adaptive<G: GroundRows + ?Sized, const N: usize>(
        &self,
        ground: &G,
        residual: &HeadMap<'_>,
        attention: &HeadMap<'_>,
        slope: &SlopeHead<'_, N>,
        scratch: &mut [f32],
        depth: &mut [f32],
    ) -> Result<(), Error> {
        let scratch = &mut Scratch::new(scratch);
        let input = ground.size();
        let slope = SlopeHead {
            decode_at: DecodeAt::OutputSize,
            ..*slope
        };
        let slope = SlopeTangent::new(&slope, Upsampling::HalfPixel, input, scratch)?;
        self.fuse(ground, Some(slope), residual, attention, scratch, depth)
    }

    #[inline(always)]
    fn fuse<'s, G: GroundRows + ?Sized>(
        &self,
        ground: &G,
        slope: Option<SlopeTangent<'_, 's>>,
        residual: &HeadMap<'_>,
        attention: &HeadMap<'_>,
        scratch: &mut Scratch<'s>,
        depth: &mut [f32],
    ) -> Result<(), Error> {
        let (input, decoder) = (ground.size(), residual.size());
        check_output(input, depth)?;
        residual.single()?;
        attention.single()?;
        if attention.size() != input {
            return Err(Error::HeadSize {
                needed: input,
                given: attention.size(),
            });
        }
        let align = Upsampling::AlignCorners;
        let mut decoder_rows = DecoderRows {
            settings: self,
            ground: GroundTimesAttention {
                settings: self,
                ground,
                slope,
                attention,
            },
            resize: Upsampler::new(align, 2, input, decoder, scratch)?,
            pair: scratch.take(2 * decoder.width() as usize)?,
            residual,
        };
        let mut resize = Upsampler::new(align, 1, decoder, input, scratch)?;
        for (v, row) in (0..).zip(depth.chunks_exact_mut(input.row())) {
            resize.row(v, row, &mut decoder_rows)?;
        }
        Ok(())
    }
}

/// Rows of `M z` and, after each, of `M`, at the input's size.
struct GroundTimesAttention<'a, 's, G: ?Sized> {
    settings: &'a ReferenceFusion,
    ground: &'a G,
    slope: Option<SlopeTangent<'a, 's>>,
    attention: &'a HeadMap<'a>,
}

impl<G: GroundRows + ?Sized> SourceRows for GroundTimesAttention<'_, '_, G> {
    #[inline(always)]
    fn write_row(&mut self, y: u32, rows: &mut [f32]) -> Result<(), Error> {
        let (ground, attention) = rows.split_at_mut(rows.len() / 2);
        self.ground.write_row(y, ground)?;
        self.attention
            .write_row((0, Head::Attention), y, attention)?;
        // h / z, of which the least is h / limit.
        let (h, limit) = (self.settings.slope_height, self.settings.ground_limit);
        for value in ground.iter_mut() {
            *value *= h;
        }
        if let Some(slope) = &mut self.slope {
            slope.advance(y)?;
            let tangents = slope.row();
            for (value, pair) in ground.iter_mut().zip(tangents.pairs()) {
                *value = *value - tangents.value(pair) - 1e-8;
            }
        }
        for (value, m) in ground.iter_mut().zip(attention.iter()) {
            let z = if *value >= h / limit { h / *value } else { 0.0 };
            *value = z * m;
        }
        Ok(())
    }
}

/// Rows of the depth at the decoder's size.
struct DecoderRows<'a, 's, G: ?Sized> {
    settings: &'a ReferenceFusion,
    ground: GroundTimesAttention<'a, 's, G>,
    resize: Upsampler<'s>,
    pair: &'s mut [f32],
    residual: &'a HeadMap<'a>,
}

impl<G: GroundRows + ?Sized> SourceRows for DecoderRows<'_, '_, G> {
    #[inline(always)]
    fn write_row(&mut self, y: u32, row: &mut [f32]) -> Result<(), Error> {
        self.resize.row(y, self.pair, &mut self.ground)?;
        self.residual.write_row((0, Head::Residual), y, row)?;
        let (ground, attention) = self.pair.split_at_checked(row.len()).unwrap_or_default();
        let DepthRange { min, max } = self.settings.depth;
        for ((depth, ground), m) in row.iter_mut().zip(ground).zip(attention) {
            let residual = clamp(*depth, 0.0, f32::MAX);
            *depth = clamp(residual * (1.0 - m) + ground + min, min, max);
        }
        Ok(())
    }
}
