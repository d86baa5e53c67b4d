//! Bilinear upsampling, one output row at a time, that decodes each source row once.

use super::Scratch;
use crate::Error;
use crate::camera::ImageSize;

/// Where the samples of a resized map lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Upsampling {
    /// Corners of the picture's area stay corners: `source = (target + 0.5) in / out - 0.5` (PyTorch and ONNX
    /// `half_pixel`, `align_corners` off). The same convention as [`crate::camera::Pixel`].
    HalfPixel,
    /// Centres of corner pixels stay centres: `source = target (in - 1) / (out - 1)` (`align_corners` on).
    AlignCorners,
}

impl Upsampling {
    /// The source samples before and after `target`, and the share of the latter.
    #[cfg_attr(not(target_os = "none"), inline(always))]
    fn sample(self, target: u32, input: u32, output: u32) -> (u32, u32, f32) {
        let (i, n, m) = (f64::from(target), f64::from(input), f64::from(output));
        let source = match self {
            Self::HalfPixel => (i + 0.5) * n / m - 0.5,
            Self::AlignCorners if output > 1 => i * (n - 1.0) / (m - 1.0),
            Self::AlignCorners => 0.0,
        };
        // Beyond the last sample both are the last one. What is negative becomes 0, as in the conversion.
        let before = source as u32;
        let after = (before + 1).min(input - 1);
        (before, after, (source.max(0.0) - f64::from(before)) as f32)
    }
}

/// Scratch that an upsampler of so many channels takes: a source row of each, two of them as wide as the output, and a number
/// for each column of source and output.
pub(super) const fn scratch_len(channels: usize, input_width: usize, output_width: usize) -> usize {
    let rows = output_width.saturating_mul(2).saturating_add(input_width);
    rows.saturating_mul(channels)
        .saturating_add(input_width)
        .saturating_add(output_width)
}

/// A row between two others.
#[derive(Clone, Copy)]
pub(super) struct Between<'r> {
    pub(super) above: &'r [f32],
    pub(super) below: &'r [f32],
    /// Of the latter.
    pub(super) share: f32,
}

impl<'r> Between<'r> {
    /// A row that is there.
    #[inline(always)]
    pub(super) fn itself(row: &'r [f32]) -> Self {
        Self {
            above: row,
            below: row,
            share: 0.0,
        }
    }

    /// A channel of rows of this width, one after the other.
    #[inline(always)]
    pub(super) fn channel(self, channel: usize, width: usize) -> Self {
        let row = channel * width..(channel + 1) * width;
        let [above, below] =
            [self.above, self.below].map(|rows| rows.get(row.clone()).unwrap_or_default());
        Self {
            above,
            below,
            ..self
        }
    }

    /// What each value lies between: for loops over several rows, which compilers see through where no closure is in the way.
    #[inline(always)]
    pub(super) fn pairs(self) -> Pairs<'r> {
        self.above.iter().zip(self.below)
    }

    /// The value between these.
    #[inline(always)]
    pub(super) fn value(self, (above, below): (&f32, &f32)) -> f32 {
        lerp(*above, *below, self.share)
    }

    /// Writes its values.
    #[inline(always)]
    pub(super) fn write(self, row: &mut [f32]) {
        for (out, pair) in row.iter_mut().zip(self.pairs()) {
            *out = self.value(pair);
        }
    }
}

type Pairs<'r> = core::iter::Zip<core::slice::Iter<'r, f32>, core::slice::Iter<'r, f32>>;

/// What is upsampled. A trait and not a closure: closures cannot be `#[inline(always)]`, and what is not inlined does not
/// get the caller's vectors.
pub(super) trait SourceRows {
    /// Writes source row `y`.
    fn write_row(&mut self, y: u32, row: &mut [f32]) -> Result<(), Error>;
}

/// How columns are upsampled.
enum Columns<'s> {
    /// Not at all.
    Same,
    /// Half-pixel, twice.
    Twice,
    /// Half-pixel, four times.
    FourTimes,
    /// Half-pixel, eight times.
    EightTimes,
    /// Any way: of each source column the number of output columns between it and the next, as bits; of each output column the
    /// share of the source column after it.
    Any {
        run: &'s mut [f32],
        share: &'s mut [f32],
    },
}

/// Planes on their way from their own size to the output's, row by row; a row holds the rows of all channels, one after
/// the other. First columns, once for each source row, then rows: these in the loop that wants them, without a pass of their own.
pub(super) struct Upsampler<'s> {
    upsampling: Upsampling,
    input: ImageSize,
    output: ImageSize,
    columns: Columns<'s>,
    /// A decoded source row.
    source: &'s mut [f32],
    /// Source rows as wide as the output; row y is kept in slot y % 2.
    rows: [&'s mut [f32]; 2],
    held: [Option<u32>; 2],
    /// The slots of the source rows before and after the output row, and the share of the latter.
    between: ([usize; 2], f32),
}

impl<'s> Upsampler<'s> {
    pub(super) fn new(
        upsampling: Upsampling,
        channels: usize,
        input: ImageSize,
        output: ImageSize,
        scratch: &mut Scratch<'s>,
    ) -> Result<Self, Error> {
        let (from, to) = (input.width(), output.width());
        let columns = if from == to {
            Columns::Same
        } else if upsampling == Upsampling::HalfPixel && to == 2 * from {
            Columns::Twice
        } else if upsampling == Upsampling::HalfPixel && to == 4 * from {
            Columns::FourTimes
        } else if upsampling == Upsampling::HalfPixel && to == 8 * from {
            Columns::EightTimes
        } else {
            let run = scratch.take(from as usize)?;
            let share = scratch.take(to as usize)?;
            Columns::any(upsampling, run, share)
        };
        let [from, to] = [from, to].map(|width| channels.saturating_mul(width as usize));
        Ok(Self {
            upsampling,
            input,
            output,
            columns,
            source: scratch.take(from)?,
            rows: [scratch.take(to)?, scratch.take(to)?],
            held: [None, None],
            between: ([0, 0], 0.0),
        })
    }

    /// Makes what output row `v` lies between, of what `source` gives.
    #[inline(always)]
    pub(super) fn advance<S: SourceRows>(&mut self, v: u32, source: &mut S) -> Result<(), Error> {
        let (above, below, share) =
            self.upsampling
                .sample(v, self.input.height(), self.output.height());
        for y in [above, below] {
            let [even, odd] = &mut self.rows;
            let [even_held, odd_held] = &mut self.held;
            let (slot, held) = if y % 2 == 0 {
                (even, even_held)
            } else {
                (odd, odd_held)
            };
            if *held == Some(y) {
                continue;
            }
            if matches!(self.columns, Columns::Same) {
                source.write_row(y, slot)?;
            } else {
                source.write_row(y, self.source)?;
                // Not a zip of two chunkings: that divides their lengths, with code for a panic at 0.
                let from = self.input.row();
                for (channel, wide) in slot.chunks_exact_mut(self.output.row()).enumerate() {
                    let narrow = self.source.get(channel * from..(channel + 1) * from);
                    self.columns.widen(narrow.unwrap_or_default(), wide);
                }
            }
            *held = Some(y);
        }
        self.between = ([above, below].map(|y| y as usize % 2), share);
        Ok(())
    }

    /// The output row that [`Self::advance`] was called for, of all channels.
    #[inline(always)]
    pub(super) fn between(&self) -> Between<'_> {
        let [even, odd] = &self.rows;
        let ([above, below], share) = self.between;
        let [above, below] = [above, below].map(|slot| if slot == 0 { &**even } else { &**odd });
        Between {
            above,
            below,
            share,
        }
    }

    /// Writes output row `v` of what `source` gives.
    #[inline(always)]
    pub(super) fn row<S: SourceRows>(
        &mut self,
        v: u32,
        out: &mut [f32],
        source: &mut S,
    ) -> Result<(), Error> {
        if self.input == self.output {
            return source.write_row(v, out);
        }
        self.advance(v, source)?;
        self.between().write(out);
        Ok(())
    }
}

impl<'s> Columns<'s> {
    /// From as many columns as `run` has to as many as `share` has.
    fn any(upsampling: Upsampling, run: &'s mut [f32], share: &'s mut [f32]) -> Self {
        let (from, to) = (run.len() as u32, share.len() as u32);
        run.fill(f32::from_bits(0));
        for (u, share) in (0_u32..).zip(share.iter_mut()) {
            let (before, _, weight) = upsampling.sample(u, from, to);
            *share = weight;
            if let Some(run) = run.get_mut(before as usize) {
                *run = f32::from_bits(run.to_bits() + 1);
            }
        }
        Self::Any { run, share }
    }

    #[cfg_attr(not(target_os = "none"), inline(always))]
    fn widen(&self, row: &[f32], out: &mut [f32]) {
        match self {
            Self::Same => {
                for (out, value) in out.iter_mut().zip(row) {
                    *out = *value;
                }
            }
            Self::Twice => widen(row, out, [0.25, 0.75]),
            Self::FourTimes => widen(row, out, [0.125, 0.375, 0.625, 0.875]),
            Self::EightTimes => widen(
                row,
                out,
                [
                    0.0625, 0.1875, 0.3125, 0.4375, 0.5625, 0.6875, 0.8125, 0.9375,
                ],
            ),
            Self::Any { run, share } => stretch::<LANES>(row, out, run, share),
        }
    }
}

/// Values of a register, or 1 where compilers make no vectors of floats: columns that the next register overwrites are lost time there.
const LANES: usize = if cfg!(any(target_arch = "x86_64", target_arch = "aarch64")) {
    8
} else {
    1
};

/// Between each source column and the next as many columns as `run` says (as bits), at `shares` of the way. Whole registers are
/// written, and what is too much of one is overwritten by the next: to look up two source columns for each column of output would
/// be a gather.
#[inline(always)]
fn stretch<const LANES: usize>(row: &[f32], out: &mut [f32], run: &[f32], shares: &[f32]) {
    // Of one length, so that one comparison finds a place inside of both.
    let Some(shares) = shares.get(..out.len()) else {
        return;
    };
    let mut at = 0;
    for (pair, run) in row.windows(2).zip(run) {
        let [before, after] = *pair else { return };
        let end = at + run.to_bits() as usize;
        while at < end {
            let next = at..at + LANES;
            if let (Some(out), Some(shares)) = (out.get_mut(next.clone()), shares.get(next)) {
                let (out, shares) = (out.first_chunk_mut(), shares.first_chunk::<LANES>());
                if let (Some(out), Some(shares)) = (out, shares) {
                    *out = shares.map(|share| lerp(before, after, share));
                }
            } else if let (Some(out), Some(shares)) = (out.get_mut(at..), shares.get(at..)) {
                for (out, share) in out.iter_mut().zip(shares) {
                    *out = lerp(before, after, *share);
                }
            }
            at = end.min(at + LANES);
        }
    }
    // Beyond the last column both are the last one.
    if let (Some(last), Some(out)) = (row.last(), out.get_mut(at..)) {
        out.fill(*last);
    }
}

#[inline(always)]
fn lerp(a: f32, b: f32, share: f32) -> f32 {
    a + share * (b - a)
}

/// Half-pixel upsampling of a row to `S` times its width: `S` values between the centres of each two source pixels, at
/// `shares` of the way; beyond the first and the last centre, that pixel.
#[inline(always)]
fn widen<const S: usize>(row: &[f32], out: &mut [f32], shares: [f32; S]) {
    let (Some(first), Some(last), Some((left, rest))) =
        (row.first(), row.last(), out.split_at_mut_checked(S / 2))
    else {
        return;
    };
    left.fill(*first);
    let (blocks, right) = rest.as_chunks_mut::<S>();
    for (pair, block) in row.windows(2).zip(blocks) {
        if let [before, after] = *pair {
            for (out, share) in block.iter_mut().zip(shares) {
                *out = lerp(before, after, share);
            }
        }
    }
    right.fill(*last);
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::format;
    use std::vec;
    use std::vec::Vec;

    use super::{Columns, Upsampling, lerp, stretch};

    /// The fast ways for two, four and eight times give the very bytes of the general one.
    #[test]
    fn fast_columns_are_the_general_ones() {
        for (columns, factor) in [
            (Columns::Twice, 2),
            (Columns::FourTimes, 4),
            (Columns::EightTimes, 8),
        ] {
            for width in [1_u32, 2, 3, 4, 7, 64] {
                let row: Vec<f32> = (0..width).map(|i| (i as f32 * 1.7).sin() * 10.0).collect();
                let length = (width * factor) as usize;
                let (mut run, mut share) = (vec![0.0; width as usize], vec![0.0; length]);
                let general = Columns::any(Upsampling::HalfPixel, &mut run, &mut share);
                let (mut fast, mut slow) = (vec![0.0; length], vec![1.0; length]);
                columns.widen(&row, &mut fast);
                general.widen(&row, &mut slow);
                assert_eq!(fast, slow, "{width} columns, {factor} times");
            }
        }
    }

    /// Each output column is the mixture of the two source columns that `sample` says, whichever way and however far.
    #[test]
    fn general_columns_are_those_sampled() {
        for upsampling in [Upsampling::HalfPixel, Upsampling::AlignCorners] {
            for (from, to) in [
                (1, 1),
                (1, 9),
                (2, 3),
                (3, 2),
                (5, 5),
                (7, 100),
                (320, 1242),
                (80, 1242),
                (100, 7),
                (9, 1),
                (13, 29),
                (20, 33),
            ] {
                let row: Vec<f32> = (0..from).map(|i| (i as f32 * 1.7).sin() * 10.0).collect();
                let (mut run, mut share) = (vec![0.0; row.len()], vec![0.0; to as usize]);
                let general = Columns::any(upsampling, &mut run, &mut share);
                let Columns::Any { run, share } = general else {
                    unreachable!("made so")
                };
                let mut out = [(); 2].map(|()| vec![f32::NAN; to as usize]);
                stretch::<1>(&row, &mut out[0], run, share);
                stretch::<8>(&row, &mut out[1], run, share);
                for (u, made) in (0..to).zip(out[0].iter().zip(&out[1])) {
                    let (before, after, share) = upsampling.sample(u, from, to);
                    let expected = lerp(row[before as usize], row[after as usize], share);
                    let what = format!("{upsampling:?}, column {u} of {from} to {to}");
                    assert_eq!(made, (&expected, &expected), "{what}");
                }
            }
        }
    }
}
