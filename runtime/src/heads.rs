//! From a network's heads to depth: core's fusion, a stripe of rows on every thread.

use std::sync::{Mutex, PoisonError};

use gedepth_core::camera::ImageSize;
use gedepth_core::fusion::{
    AttentionHead, DecodeAt, FusedMaps, Fusion, HeadMap, ResidualHead, ResidualUnit, Samples,
    SlopeHead, scratch_len,
};
use gedepth_core::table::GroundRows;

use crate::Error;
use crate::contract::Contract;
use crate::engine::Threads;
use crate::ground::PixelGround;
use crate::model::Outputs;
use crate::vectors::{Loops, widest};

/// Most threads that fuse together.
const MOST_THREADS: usize = 16;
/// What a row of sky takes, and one where there may be ground, without slopes and with them: one to the other.
const SKY: usize = 6;
const GROUND: usize = 8;
const SLOPE: usize = 12;

/// The outputs that fusion reads, in the order in which [`Heads::new`] does.
pub(crate) fn outputs(contract: &Contract) -> Vec<&str> {
    let attention = contract.attention.as_ref().map(|a| a.output.as_str());
    let slope = contract.slope.as_ref().map(|s| s.output.as_str());
    [Some(contract.residual.as_str()), attention, slope]
        .into_iter()
        .flatten()
        .collect()
}

/// The heads of one run.
#[derive(Clone, Copy)]
struct Heads<'a> {
    residual: ResidualHead<'a>,
    attention: Option<AttentionHead<'a>>,
    slope: Option<SlopeHead<'a>>,
}

impl<'a> Heads<'a> {
    fn new(
        contract: &'a Contract,
        residual_unit: ResidualUnit,
        outputs: &'a Outputs<'_>,
    ) -> Result<Self, Error> {
        let map = |index, expected: usize| {
            let (values, [channels, height, width]) = outputs.head(index)?;
            if channels != expected {
                let reason = format!("has {channels} channels instead of {expected}");
                return Err(outputs.unfit_head(index, reason));
            }
            let side = |length: usize| u32::try_from(length).unwrap_or(u32::MAX);
            ImageSize::new(side(width), side(height))
                .and_then(|size| HeadMap::new(Samples::F32(values), channels, size))
                .map_err(|e| outputs.unfit_head(index, e))
        };
        let attention = |attention: &crate::contract::Attention| {
            Ok(AttentionHead {
                map: map(1, 1)?,
                unit: attention.unit,
                decode_at: DecodeAt::HeadSize,
            })
        };
        let slope = |slope: &'a crate::contract::Slope| {
            Ok(SlopeHead {
                map: map(2, slope.classes.radians().len())?,
                classes: &slope.classes,
                decode_at: slope.decode_at,
            })
        };
        Ok(Self {
            residual: ResidualHead {
                map: map(0, 1)?,
                unit: residual_unit,
                decode_at: DecodeAt::HeadSize,
            },
            attention: contract.attention.as_ref().map(attention).transpose()?,
            slope: contract.slope.as_ref().map(slope).transpose()?,
        })
    }

    /// Scratch values that fusing them takes.
    fn scratch_len(&self, output: ImageSize) -> usize {
        let classes = self.slope.map_or(0, |slope| match slope.decode_at {
            DecodeAt::HeadSize => 1,
            DecodeAt::OutputSize => slope.classes.radians().len(),
        });
        let maps = [
            Some(self.residual.map),
            self.attention.map(|head| head.map),
            self.slope.map(|head| head.map),
        ];
        let widths = maps.into_iter().flatten().map(|map| map.size().width());
        scratch_len(output, widths.max().unwrap_or(0), classes)
    }
}

/// Rows of the output that one thread makes.
struct Stripe<'a> {
    fusion: Fusion,
    heads: Heads<'a>,
    ground: &'a PixelGround,
    scratch: &'a mut [f32],
    maps: FusedMaps<'a>,
}

impl Loops for Stripe<'_> {
    type Output = Result<(), gedepth_core::Error>;

    #[inline(always)]
    fn run(self) -> Self::Output {
        let Self {
            fusion,
            ground,
            scratch,
            maps,
            ..
        } = self;
        let Heads {
            residual,
            attention,
            slope,
        } = &self.heads;
        fusion.any_mode(
            ground,
            residual,
            attention.as_ref(),
            slope.as_ref(),
            scratch,
            maps,
        )
    }
}

/// The first `values` of a map, which keeps the others.
fn take<'a>(map: &mut &'a mut [f32], values: usize) -> &'a mut [f32] {
    map.split_off_mut(..values).unwrap_or_default()
}

/// So many values of a thread's memory from the start of a cache line on: most widths are whole lines, and a vector that lies in
/// two takes two loads.
fn from_line(memory: &mut Vec<f32>, values: usize) -> &mut [f32] {
    const LINE: usize = 64;
    let spare = LINE / size_of::<f32>();
    memory.resize(values + spare, 0.0);
    let start = memory.as_ptr().align_offset(LINE).min(spare);
    memory.get_mut(start..start + values).unwrap_or_default()
}

/// Fuses the outputs of a run into `maps`, on the threads that ran the network where they are given. After the first
/// time it allocates nothing, so long as `scratch` is the same.
pub(crate) fn fuse(
    contract: &Contract,
    (fusion, residual_unit): (&Fusion, ResidualUnit),
    (outputs, team): (&Outputs<'_>, Option<Threads<'_>>),
    ground: &PixelGround,
    scratch: &mut Vec<Vec<f32>>,
    mut maps: FusedMaps<'_>,
) -> Result<(), Error> {
    let heads = Heads::new(contract, residual_unit, outputs)?;
    let size = ground.size();
    let threads = team
        .as_ref()
        .map_or(1, Threads::count)
        .clamp(1, MOST_THREADS);
    scratch.resize_with(threads, Vec::new);
    let mut stripes = [const { Mutex::new(None) }; MOST_THREADS];
    // One stripe each, as long as takes the same time: most of its rows of the heads this thread made itself, and has in its cache.
    let with_ground = match (heads.attention, heads.slope) {
        (None, _) => SKY,
        (_, None) => GROUND,
        _ => SLOPE,
    };
    let climb = heads
        .slope
        .map_or(0.0, |slope| slope.classes.steepest_climb());
    let least = fusion.least_ground(ground.camera_height(), climb);
    let work = |v: u32| match ground.row_bound(v) >= least {
        true => with_ground,
        false => SKY,
    };
    let all: usize = (0..size.height()).map(work).sum();
    let (mut done, mut end) = (0, 0);
    for ((number, stripe), scratch) in (1..=threads).zip(&mut stripes).zip(scratch) {
        let first = end;
        while end < size.height() && done * threads < all * number {
            done += work(end);
            end += 1;
        }
        let rows = first..end;
        let values = rows.len() * size.width() as usize;
        *stripe = Mutex::new(Some(Stripe {
            fusion: fusion.rows(rows),
            heads,
            ground,
            scratch: from_line(scratch, heads.scratch_len(size)),
            maps: FusedMaps {
                depth: take(&mut maps.depth, values),
                attention: maps.attention.as_mut().map(|map| take(map, values)),
                ground: maps.ground.as_mut().map(|map| take(map, values)),
            },
        }));
    }
    let failed = Mutex::new(None);
    let job = |thread: usize| {
        let stripe = stripes.get(thread).and_then(|stripe| {
            let mut stripe = stripe.lock().unwrap_or_else(PoisonError::into_inner);
            stripe.take()
        });
        if let Some(Err(e)) = stripe.map(widest) {
            *failed.lock().unwrap_or_else(PoisonError::into_inner) = Some(e);
        }
    };
    match team {
        Some(mut team) => team.share(&job).map_err(|reason| outputs.unfit(reason))?,
        None => job(0),
    }
    let failed = failed.into_inner().unwrap_or_else(PoisonError::into_inner);
    failed.map_or(Ok(()), |e| Err(outputs.unfit(e)))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use gedepth_core::camera::ImageSize;
    use gedepth_core::fusion::{
        AttentionHead, AttentionUnit, DecodeAt, DepthRange, FusedMaps, Fusion, HeadMap,
        ResidualHead, ResidualUnit, Samples, SlopeHead, Upsampling,
    };
    use gedepth_core::slope::{SlopeClasses, SlopeSign};
    use gedepth_core::table::GroundView;

    use super::{Heads, from_line};

    /// Any head may be the widest, and slopes may be decoded at either size.
    #[test]
    fn heads_of_any_width_find_room() {
        let output = ImageSize::new(24, 8).unwrap();
        let inverse = vec![0.1; output.pixels()];
        let ground = GroundView::from_values(&inverse, output, 1.5).unwrap();
        let angles = [-0.02, 0.0, 0.02].map(gedepth_core::Angle::from_radians);
        let classes = SlopeClasses::new(&angles, SlopeSign::DownhillPositive).unwrap();
        let range = DepthRange::new(0.5, 80.0).unwrap();
        let fusion = Fusion::new(Upsampling::AlignCorners, range, 80.0).unwrap();
        let values = vec![0.5; 3 * 30 * 4];
        for widths in [[5, 11, 7], [11, 5, 7], [5, 7, 11], [30, 3, 29], [3, 30, 12]] {
            for decode_at in [DecodeAt::HeadSize, DecodeAt::OutputSize] {
                let map = |width: u32, channels: usize| {
                    let size = ImageSize::new(width, 4).unwrap();
                    let values = &values[..channels * size.pixels()];
                    HeadMap::new(Samples::F32(values), channels, size).unwrap()
                };
                let heads = Heads {
                    residual: ResidualHead {
                        map: map(widths[0], 1),
                        unit: ResidualUnit::Metres,
                        decode_at: DecodeAt::HeadSize,
                    },
                    attention: Some(AttentionHead {
                        map: map(widths[1], 1),
                        unit: AttentionUnit::Probability,
                        decode_at: DecodeAt::HeadSize,
                    }),
                    slope: Some(SlopeHead {
                        map: map(widths[2], 3),
                        classes: &classes,
                        decode_at,
                    }),
                };
                let (mut memory, mut depth) = (Vec::new(), vec![0.0; output.pixels()]);
                let fused = fusion.any_mode(
                    &ground,
                    &heads.residual,
                    heads.attention.as_ref(),
                    heads.slope.as_ref(),
                    from_line(&mut memory, heads.scratch_len(output)),
                    FusedMaps {
                        depth: &mut depth,
                        ..FusedMaps::default()
                    },
                );
                assert_eq!(fused, Ok(()), "{widths:?}, {decode_at:?}");
            }
        }
    }
}
