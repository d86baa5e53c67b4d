//! Fusion: `depth = M z_ground + (1 - M) z_residual`, in one pass, row by row.
//!
//! # Inputs
//!
//! - The ground, from any [`GroundRows`]: inverse planar depth of every output pixel.
//! - Head maps ([`HeadMap`]): planar, row-major, `f32` or 8-bit with scale and zero point, of any size; they are
//!   upsampled bilinearly to the output's size. What their values mean is said beside each: [`ResidualHead`],
//!   [`AttentionHead`], [`SlopeHead`].
//!
//! # Order of decoding and upsampling
//!
//! Exponentials, sigmoids and softmax are taken either at the head's own size, before upsampling
//! ([`DecodeAt::HeadSize`]: 4 to 16 times cheaper), or at the output's size after it ([`DecodeAt::OutputSize`]: what
//! networks trained the reference's way expect). For the slope, `HeadSize` upsamples the *tangent of the expected
//! angle*. Where heads already have the output's size both are the same.
//!
//! Networks exported from the reference implementation fuse in an order of their own: [`ReferenceFusion`].
//!
//! # Output
//!
//! Planar depth in metres, row-major, clamped to a [`DepthRange`]; never NaN. Where there is no ground `z_ground` is 0,
//! as the network saw it in training. Same input, same bytes, on every processor: only plain additions and
//! multiplications in a fixed order, no fused ones.
//!
//! # Speed
//!
//! Every function on the way is `#[inline(always)]`, so that a caller with `#[target_feature]` gets a copy compiled for
//! its vectors. Scratch memory is the caller's: [`scratch_len`].
//!
//! # Errors and panics
//!
//! Wrong lengths are errors, and so are head values that are NaN or beyond +-1e37 (in rows that are read: all, unless a head is made
//! smaller; of slopes those where there can be ground); after an error outputs hold a part of the picture. Nothing panics.

mod decode;
mod head;
mod reference;
mod upsample;

pub use head::{
    AttentionHead, AttentionUnit, DecodeAt, HEAD_VALUE_MAX, HeadMap, ResidualHead, ResidualUnit,
    Samples, SlopeHead,
};
pub use reference::{ReferenceFusion, reference_scratch_len};
pub use upsample::Upsampling;

pub use crate::error::Head;

use crate::Error;
use crate::camera::ImageSize;
use crate::polynomial::clamp;
use crate::table::{GroundRows, MIN_INVERSE_DEPTH};
use decode::{Plane, SlopeTangent};

/// Far more than what rounding adds to a slope's tangent and to the ground it makes, as a share.
const SLACK: f32 = 1e-4;

/// The range that output depths are clamped to, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthRange {
    min: f32,
    max: f32,
}

impl DepthRange {
    /// From `min` to `max`, metres.
    ///
    /// # Errors
    /// [`Error::DepthRange`] unless `0 < min < max`, both finite.
    pub const fn new(min: f32, max: f32) -> Result<Self, Error> {
        if !(0.0 < min && min < max && max < f32::INFINITY) {
            return Err(Error::DepthRange { min, max });
        }
        Ok(Self { min, max })
    }

    /// The least depth, metres.
    pub const fn min(self) -> f32 {
        self.min
    }

    /// The largest depth, metres.
    pub const fn max(self) -> f32 {
        self.max
    }
}

/// What all modes have in common.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fusion {
    upsampling: Upsampling,
    depth: DepthRange,
    /// 1/m: the inverse depth of the farthest ground.
    ground_floor: f32,
    /// The first of the output's rows that are made, and the one after the last.
    rows: [u32; 2],
}

/// Where results go: slices of the output's pixels (of the [`Fusion::rows`] that are made), row-major.
#[derive(Debug, Default)]
pub struct FusedMaps<'a> {
    /// Depth, metres.
    pub depth: &'a mut [f32],
    /// M, the attention upsampled, 0 to 1, if wanted.
    pub attention: Option<&'a mut [f32]>,
    /// The ground depth that went into the fusion (adaptive where the mode is), metres, 0 for none, if wanted.
    pub ground: Option<&'a mut [f32]>,
}

/// Scratch values that any mode needs for this output, heads of at most the width `head_width` and this many slope
/// classes: 0 where there is no slope head, and 1 is enough for any number decoded at the head's size.
pub const fn scratch_len(output: ImageSize, head_width: u32, slope_classes: usize) -> usize {
    let (out, head) = (output.width() as usize, head_width as usize);
    let planes = decode::plane_scratch_len(head, out).saturating_mul(2);
    let slope = if slope_classes > 0 {
        decode::slope_scratch_len(slope_classes, head, out)
    } else {
        0
    };
    // And a row of ground.
    out.saturating_add(planes).saturating_add(slope)
}

impl Fusion {
    /// Fusion that upsamples heads like this, clamps depth to this range, and takes ground farther than `ground_limit`
    /// metres for none (the cut that the network's ground channel had in training).
    ///
    /// # Errors
    /// [`Error::GroundLimit`] if `ground_limit` is not positive and finite.
    pub fn new(
        upsampling: Upsampling,
        depth: DepthRange,
        ground_limit: f32,
    ) -> Result<Self, Error> {
        let ground_floor = 1.0 / ground_limit;
        if !(ground_limit > 0.0 && ground_limit.is_finite() && ground_floor.is_finite()) {
            return Err(Error::GroundLimit(ground_limit));
        }
        Ok(Self {
            upsampling,
            depth,
            ground_floor: ground_floor.max(MIN_INVERSE_DEPTH),
            rows: [0, u32::MAX],
        })
    }

    /// Only these rows of the output, of those that it has; maps then hold no others. The bytes are the same, so that
    /// several threads can make an output together, each with scratch of its own.
    #[must_use]
    pub const fn rows(self, rows: core::ops::Range<u32>) -> Self {
        Self {
            rows: [rows.start, rows.end],
            ..self
        }
    }

    /// The rows of this output that are made, and how many values they have.
    fn part(&self, output: ImageSize) -> (core::ops::Range<u32>, usize) {
        let [first, end] = self.rows.map(|row| row.min(output.height()));
        let rows = end.saturating_sub(first) as usize;
        (first..end, rows * output.row())
    }

    /// The least inverse depth of the plane, 1/m, that a slope may make ground of: for a camera so many metres over it,
    /// and slopes whose steepest climb has this tangent
    /// ([`SlopeClasses::steepest_climb`](crate::slope::SlopeClasses::steepest_climb); 0 for vanilla). A row whose
    /// [`GroundRows::row_bound`] is less has no ground and takes a fraction of the time of others, which whoever shares
    /// [`Self::rows`] out wants to know.
    pub fn least_ground(&self, camera_height: f32, steepest_climb: f32) -> f32 {
        let climb = steepest_climb.max(0.0) / camera_height;
        self.ground_floor * (1.0 - SLACK) - climb * (1.0 + SLACK)
    }

    /// Baseline: the residual is the depth. `depth` has the output's pixels, or those of [`Self::rows`].
    ///
    /// # Errors
    /// [`Error::HeadChannels`], [`Error::HeadNotFinite`], [`Error::OutputLength`], [`Error::ScratchLength`],
    /// [`Error::FocalLength`] of the residual's unit.
    #[inline(always)]
    pub fn baseline(
        &self,
        output: ImageSize,
        residual: &ResidualHead<'_>,
        scratch: &mut [f32],
        depth: &mut [f32],
    ) -> Result<(), Error> {
        let (rows, values) = self.part(output);
        check_length(values, depth)?;
        let mut scratch = Scratch::new(scratch);
        let unit = residual.unit.metres()?;
        let mut residual = Plane::residual(residual, self.upsampling, output, &mut scratch)?;
        for (v, depth) in rows.zip(depth.chunks_exact_mut(output.row())) {
            residual.advance(v)?;
            let z = residual.row();
            for (depth, pair) in depth.iter_mut().zip(z.pairs()) {
                *depth = clamp(unit * z.value(pair), self.depth.min, self.depth.max);
            }
        }
        Ok(())
    }

    /// Vanilla: ground depth from the plane.
    ///
    /// # Errors
    /// [`Error::HeadChannels`], [`Error::HeadNotFinite`], [`Error::OutputLength`], [`Error::ScratchLength`],
    /// [`Error::FocalLength`] of the residual's unit, [`Error::GroundRow`] from the ground source.
    #[inline(always)]
    pub fn vanilla<G: GroundRows + ?Sized>(
        &self,
        ground: &G,
        residual: &ResidualHead<'_>,
        attention: &AttentionHead<'_>,
        scratch: &mut [f32],
        maps: FusedMaps<'_>,
    ) -> Result<(), Error> {
        let mut scratch = Scratch::new(scratch);
        self.fuse(ground, None, residual, Some(attention), &mut scratch, maps)
    }

    /// Adaptive: ground depth from the plane and the expected slope,
    /// `1 / z_slope = 1 / z_plane - tan(alpha) / H`.
    ///
    /// # Errors
    /// As [`Self::vanilla`], and [`Error::SlopeLogitCount`] if the slope head has more or fewer channels than classes.
    #[inline(always)]
    pub fn adaptive<G: GroundRows + ?Sized, const N: usize>(
        &self,
        ground: &G,
        residual: &ResidualHead<'_>,
        attention: &AttentionHead<'_>,
        slope: &SlopeHead<'_, N>,
        scratch: &mut [f32],
        maps: FusedMaps<'_>,
    ) -> Result<(), Error> {
        self.any_mode(
            ground,
            residual,
            Some(attention),
            Some(slope),
            scratch,
            maps,
        )
    }

    /// Adaptive where there are slopes, else vanilla, and baseline where there is no attention (its maps, if wanted, are 0): for a
    /// program that does them all, one copy of the loops.
    ///
    /// # Errors
    /// As [`Self::adaptive`].
    #[inline(always)]
    pub fn any_mode<G: GroundRows + ?Sized, const N: usize>(
        &self,
        ground: &G,
        residual: &ResidualHead<'_>,
        attention: Option<&AttentionHead<'_>>,
        slope: Option<&SlopeHead<'_, N>>,
        scratch: &mut [f32],
        maps: FusedMaps<'_>,
    ) -> Result<(), Error> {
        let output = ground.size();
        let mut scratch = Scratch::new(scratch);
        let slope = match slope {
            Some(slope) => {
                let climb = slope.classes.steepest_climb();
                let slope = SlopeTangent::new(slope, self.upsampling, output, &mut scratch)?;
                Some((slope, climb))
            }
            None => None,
        };
        self.fuse(ground, slope, residual, attention, &mut scratch, maps)
    }

    /// Fuses row by row; `slope` comes with the tangent of its steepest climb.
    // Firmware has no vectors to be compiled for, and less memory for copies.
    #[cfg_attr(not(target_os = "none"), inline(always))]
    fn fuse<'s, G: GroundRows + ?Sized>(
        &self,
        ground: &G,
        mut slope: Option<(SlopeTangent<'_, 's>, f32)>,
        residual: &ResidualHead<'_>,
        attention: Option<&AttentionHead<'_>>,
        scratch: &mut Scratch<'s>,
        maps: FusedMaps<'_>,
    ) -> Result<(), Error> {
        let output = ground.size();
        let width = output.row();
        let (rows, values) = self.part(output);
        check_length(values, maps.depth)?;
        for map in [&maps.attention, &maps.ground].into_iter().flatten() {
            check_length(values, map)?;
        }
        let unit = residual.unit.metres()?;
        let mut residual = Plane::residual(residual, self.upsampling, output, scratch)?;
        let mut attention = attention
            .map(|head| Plane::attention(head, self.upsampling, output, scratch))
            .transpose()?;
        let per_height = 1.0 / ground.camera_height();
        let climb = slope.as_ref().map_or(0.0, |(_, climb)| *climb);
        let least = self.least_ground(ground.camera_height(), climb);
        let ground_row = scratch.take(width)?;
        let mut attention_map = maps.attention.map(|map| map.chunks_exact_mut(width));
        let mut ground_map = maps.ground.map(|map| map.chunks_exact_mut(width));
        for (v, depth_row) in rows.zip(maps.depth.chunks_exact_mut(width)) {
            // A loop, so that there is one copy of what upsamples and decodes.
            for plane in [Some(&mut residual), attention.as_mut()] {
                let Some(plane) = plane else { continue };
                plane.advance(v)?;
            }
            // Half of a picture lies above all ground, whatever its slope: no slopes, no divisions.
            let bound = ground.row_bound(v);
            let mut ground_ahead = attention.is_some() && bound >= least;
            if ground_ahead {
                ground.write_row(v, ground_row)?;
                if bound == f32::INFINITY {
                    // The source cannot say. Where there is ground, one of the first values mostly does.
                    ground_ahead = ground_row.iter().any(|inverse| *inverse >= least);
                }
            }
            if let (true, Some((slope, _))) = (ground_ahead, &mut slope) {
                slope.advance(v)?;
                let tangents = slope.row();
                for (ground, pair) in ground_row.iter_mut().zip(tangents.pairs()) {
                    *ground -= tangents.value(pair) * per_height;
                }
            }
            let z = residual.row();
            let m = attention.as_ref().map(Plane::row);
            let values = depth_row.iter_mut().zip(z.pairs());
            match m {
                None => {
                    for (depth, z_pair) in values {
                        *depth = self.blend(unit * z.value(z_pair), 0.0, 0.0);
                    }
                }
                Some(m) if ground_ahead => {
                    for (((depth, z_pair), m_pair), ground) in
                        values.zip(m.pairs()).zip(ground_row.iter())
                    {
                        let ground = self.ground_depth(*ground);
                        *depth = self.blend(unit * z.value(z_pair), m.value(m_pair), ground);
                    }
                }
                Some(m) => {
                    for ((depth, z_pair), m_pair) in values.zip(m.pairs()) {
                        // As `blend` with ground of 0, which adds nothing.
                        let residual = unit * z.value(z_pair);
                        let fused = residual - m.value(m_pair) * residual;
                        *depth = clamp(fused, self.depth.min, self.depth.max);
                    }
                }
            }
            if let Some(row) = attention_map.as_mut().and_then(Iterator::next) {
                match m {
                    Some(m) => m.write(row),
                    None => row.fill(0.0),
                }
            }
            if let Some(row) = ground_map.as_mut().and_then(Iterator::next) {
                if ground_ahead {
                    for (depth, inverse) in row.iter_mut().zip(ground_row.iter()) {
                        *depth = self.ground_depth(*inverse);
                    }
                } else {
                    row.fill(0.0);
                }
            }
        }
        Ok(())
    }

    /// `z_ground` for an inverse depth, 1/m; 0 where that is none.
    #[inline(always)]
    fn ground_depth(&self, inverse: f32) -> f32 {
        if inverse >= self.ground_floor {
            1.0 / inverse
        } else {
            0.0
        }
    }

    /// `M z_ground + (1 - M) z_residual`, in range.
    #[inline(always)]
    fn blend(&self, residual: f32, m: f32, ground: f32) -> f32 {
        let fused = m * ground + (residual - m * residual);
        clamp(fused, self.depth.min, self.depth.max)
    }
}

fn check_output(size: ImageSize, map: &[f32]) -> Result<(), Error> {
    check_length(size.pixels(), map)
}

fn check_length(needed: usize, map: &[f32]) -> Result<(), Error> {
    if map.len() != needed {
        return Err(Error::OutputLength {
            needed,
            given: map.len(),
        });
    }
    Ok(())
}

/// Hands out pieces of the caller's scratch memory.
struct Scratch<'s> {
    free: &'s mut [f32],
    given: usize,
}

impl<'s> Scratch<'s> {
    fn new(free: &'s mut [f32]) -> Self {
        let given = free.len();
        Self { free, given }
    }

    fn take(&mut self, length: usize) -> Result<&'s mut [f32], Error> {
        let free = core::mem::take(&mut self.free);
        let used = self.given - free.len();
        let (piece, rest) = free
            .split_at_mut_checked(length)
            .ok_or(Error::ScratchLength {
                needed: used.saturating_add(length),
                given: self.given,
            })?;
        self.free = rest;
        Ok(piece)
    }
}
