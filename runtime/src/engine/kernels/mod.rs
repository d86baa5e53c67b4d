//! The inner loops: one file per instruction set, one meaning (that of [`super::layer`]), the same bytes from each.
//!
//! Layout: a tensor is rows of pixels, each pixel `pitch` bytes: its channels, then bytes without meaning up to a
//! multiple of 16 or of a cache line (of 4 for a tensor of at most four channels that enters from f32). Rows carry a border of pixels that
//! hold the zero point, so that no kernel asks where the picture ends.
//!
//! Convolution weights are packed for instructions that multiply some neighbouring bytes of input with as many of weights
//! and add to a 32-bit lane (four for `vpdpbusd`): output channels in blocks of 16 lanes, blocks in groups that share
//! what is loaded, input in runs of consecutive bytes, `[group][run][some bytes of it][block][lane][byte]`; how many
//! bytes and blocks is the [`Packing`]. Where training made all weights of a block for some bytes zero, x86 and portable kernels
//! leave both out, if the block is alone in its group.
//!
//! # Panics
//! Each kernel checks once per row that its slices hold what the geometry says, and panics otherwise. The schedule makes
//! geometry and slices from the same shapes, so no model and no picture can bring that about.

use std::ops::RangeInclusive;

/// A loop that the compiler cannot leave a loop: what it indexes are registers.
#[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
macro_rules! unrolled {
    ($number:ident in $($value:literal)* $body:block) => {
        $({
            let $number = $value;
            $body
        })*
    };
}

/// 3x3 as a window that moves over the columns of a row: `column!(tap of sums, ..)` unpacks the next column and adds it, as that
/// tap, to the sums of each pixel that it belongs to (as tap 0 they begin); `done!(sums)` writes a pixel, and returns after the last.
#[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
macro_rules! moving_window {
    ($stride:ident, $column:ident, $done:ident) => {
        $column!(0 of 0);
        if $stride == 1 {
            $column!(1 of 0, 0 of 1);
            loop {
                $column!(2 of 0, 1 of 1, 0 of 2);
                $done!(0);
                $column!(2 of 1, 1 of 2, 0 of 0);
                $done!(1);
                $column!(2 of 2, 1 of 0, 0 of 1);
                $done!(2);
            }
        }
        loop {
            $column!(1 of 0);
            $column!(2 of 0, 0 of 1);
            $done!(0);
            $column!(1 of 1);
            $column!(2 of 1, 0 of 0);
            $done!(1);
        }
    };
}

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512vnni;
#[cfg(target_arch = "x86_64")]
mod avxvnni;
#[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
mod few;
#[cfg(target_arch = "aarch64")]
mod neon;
mod portable;
#[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
mod quads;

#[cfg(target_arch = "x86_64")]
use avx512vnni::Interleaved;
#[cfg(target_arch = "x86_64")]
use avxvnni::TapQuads;
#[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
use few::Few;
#[cfg(target_arch = "aarch64")]
use neon::depthwise::Interleaved;
pub(crate) use portable::{
    Halves, average_row, channel_row, copy_row, dequantize_row, flatten, max_row, multiply_row,
    pad_row, quantize_row, resize_row, saturate_channel, spread_row, store_channel,
};

/// Lanes of a block of output channels.
pub(crate) const BLOCK: usize = 16;
/// An instruction set that the engine has kernels for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kernel {
    /// Plain Rust, any processor.
    Portable,
    /// x86-64 with AVX2.
    Avx2,
    /// x86-64 with AVX-VNNI: VNNI in 256 bits.
    AvxVnni,
    /// x86-64 with AVX-512 F, BW, VL and VNNI.
    Avx512Vnni,
    /// Any aarch64.
    Neon,
    /// aarch64 with the dot product (FEAT_DotProd).
    NeonDotprod,
    /// aarch64 with the dot product and 8-bit matrix products (FEAT_I8MM).
    NeonI8mm,
}

impl Kernel {
    /// All of them, of each processor's the fastest last.
    pub const ALL: [Kernel; 7] = [
        Kernel::Portable,
        Kernel::Avx2,
        Kernel::AvxVnni,
        Kernel::Avx512Vnni,
        Kernel::Neon,
        Kernel::NeonDotprod,
        Kernel::NeonI8mm,
    ];

    /// The fastest that this processor has.
    pub fn best() -> Self {
        Self::ALL
            .into_iter()
            .rev()
            .find(|kernel| kernel.is_supported())
            .unwrap_or(Kernel::Portable)
    }

    /// Whether this processor has it.
    pub fn is_supported(self) -> bool {
        #[cfg(target_arch = "aarch64")]
        use std::arch::is_aarch64_feature_detected as has;
        #[cfg(target_arch = "x86_64")]
        use std::arch::is_x86_feature_detected as has;
        match self {
            Kernel::Portable => true,
            #[cfg(target_arch = "x86_64")]
            Kernel::Avx2 => has!("avx2"),
            #[cfg(target_arch = "x86_64")]
            Kernel::AvxVnni => {
                let evex = cfg!(test) && has!("avx512vnni") && has!("avx512vl");
                has!("avx2") && (has!("avxvnni") || evex)
            }
            #[cfg(target_arch = "x86_64")]
            Kernel::Avx512Vnni => {
                has!("avx512f") && has!("avx512bw") && has!("avx512vl") && has!("avx512vnni")
            }
            #[cfg(target_arch = "aarch64")]
            Kernel::Neon => true,
            #[cfg(target_arch = "aarch64")]
            Kernel::NeonDotprod => has!("dotprod"),
            #[cfg(target_arch = "aarch64")]
            Kernel::NeonI8mm => has!("dotprod") && has!("i8mm"),
            // Those of other processors.
            _ => false,
        }
    }

    /// Bytes whose multiples its loads had better not cross: those of 64 bytes take twice as long where two cache lines share one.
    pub(crate) fn line(self) -> usize {
        match self {
            Kernel::Avx512Vnni => 64,
            _ => 16,
        }
    }

    /// The least weight that its dense convolutions take; NEON without the dot product adds two products in 16 bits. A layer with one
    /// below it reads its input twice.
    pub(crate) fn least_weight(self) -> i8 {
        match self {
            Kernel::Neon => -127,
            _ => i8::MIN,
        }
    }

    /// How it wants the weights of dense convolutions.
    fn packing(self) -> Packing {
        let (bytes, group, skips) = match self {
            Kernel::Avx512Vnni => (4, 3, true),
            Kernel::Portable | Kernel::Avx2 | Kernel::AvxVnni => (4, 1, true),
            Kernel::Neon => (16, 1, false),
            Kernel::NeonDotprod => (4, 1, false),
            Kernel::NeonI8mm => (8, 1, false),
        };
        Packing {
            bytes,
            group,
            skips,
        }
    }
}

/// In which order a kernel reads the weights of a dense convolution.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Packing {
    /// Neighbouring bytes of a run whose weights of one output lie together.
    bytes: usize,
    /// Most blocks of a group.
    group: usize,
    /// Whether it leaves out what a block that is alone has no weights for.
    skips: bool,
}

/// How accumulators become bytes.
#[derive(Clone, Debug)]
pub(crate) struct ToBytes {
    /// The zero point of the output.
    pub(crate) zero: u8,
    /// What the bytes may be.
    pub(crate) range: RangeInclusive<u8>,
}

/// Weights of a dense convolution, packed, with start and factor of each output channel.
#[derive(Clone, Debug)]
pub(crate) struct Dense {
    /// Of the lanes, those that are outputs.
    #[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
    outputs: usize,
    /// Blocks that hold the output channels.
    blocks: usize,
    /// Runs of input bytes per output pixel.
    runs: usize,
    /// Bytes of a run, a multiple of four.
    run: usize,
    groups: Vec<Group>,
    weights: Vec<i8>,
    /// Weights in another order, where there are few outputs.
    #[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
    few: Few,
    starts: Vec<i32>,
    factors: Vec<f32>,
}

/// Blocks of output channels that share what is loaded.
#[derive(Clone, Debug)]
struct Group {
    blocks: usize,
    /// Of each run, how many pieces of [`Packing::bytes`] have weights.
    counts: Vec<u32>,
    /// Where in its run each begins, run after run.
    places: Vec<u32>,
    /// Where in [`Dense::weights`] its own begin.
    weights: usize,
}

impl Group {
    /// Whether runs are three pixels of `step` bytes each, so that neighbouring outputs share two, and it leaves none of their weights
    /// out.
    #[cfg(target_arch = "x86_64")]
    fn is_window(&self, dense: &Dense, step: usize) -> bool {
        dense.run == 3 * step
            && step.is_multiple_of(4)
            && self.places.len() == dense.runs * dense.run / 4
    }
}

impl Dense {
    /// Packs `weights`, `[output][run][byte]`, none of them below [`Kernel::least_weight`].
    pub(crate) fn new(
        kernel: Kernel,
        [runs, run]: [usize; 2],
        starts: &[i32],
        factors: &[f32],
        weights: &[i8],
    ) -> Self {
        debug_assert!(
            weights
                .iter()
                .all(|&weight| weight >= kernel.least_weight())
        );
        let outputs = starts.len();
        let packing = kernel.packing();
        let blocks = outputs.div_ceil(BLOCK);
        let pieces: Vec<_> = (0..runs)
            .flat_map(|number| {
                (0..run)
                    .step_by(packing.bytes)
                    .map(move |start| (number, start))
            })
            .collect();
        let piece = |output: usize, (number, start): (usize, usize)| {
            let at = (output * runs + number) * run;
            &weights[at + start..at + run.min(start + packing.bytes)]
        };
        let has_weights = |block: usize, place: (usize, usize)| {
            let mut outputs = block * BLOCK..outputs.min((block + 1) * BLOCK);
            outputs.any(|output| piece(output, place).iter().any(|&weight| weight != 0))
        };
        let filled = |block| {
            pieces
                .iter()
                .filter(|&&piece| has_weights(block, piece))
                .count()
        };
        let filled = || (0..blocks).map(filled).sum::<usize>();
        // Blocks that are alone load more for as many multiplications: it takes a fifth less of these to pay.
        let alone = packing.skips && packing.group > 1 && 5 * filled() < 4 * blocks * pieces.len();
        let mut groups = Vec::new();
        let mut packed = Vec::new();
        let mut first = 0;
        for blocks in sizes_of_groups(blocks, if alone { 1 } else { packing.group }) {
            let mut group = Group {
                blocks,
                counts: vec![0; runs],
                places: Vec::new(),
                weights: packed.len(),
            };
            for &place @ (number, start) in &pieces {
                if packing.skips && blocks == 1 && !has_weights(first, place) {
                    continue;
                }
                group.counts[number] += 1;
                group.places.push(start as u32);
                for output in first * BLOCK..(first + blocks) * BLOCK {
                    let end = packed.len() + packing.bytes;
                    if output < outputs {
                        packed.extend_from_slice(piece(output, place));
                    }
                    packed.resize(end, 0);
                }
            }
            groups.push(group);
            first += blocks;
        }
        // What growth has left over.
        packed.shrink_to_fit();
        #[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
        let few = match kernel {
            Kernel::Portable | Kernel::Avx2 => Few::default(),
            _ => Few::new([outputs, runs, run], weights),
        };
        let padded = |length| length - outputs;
        let mut starts = starts.to_vec();
        if let Kernel::Neon | Kernel::NeonDotprod = kernel {
            // They multiply signed bytes, `x - 128`.
            for (start, weights) in starts.iter_mut().zip(weights.chunks_exact(runs * run)) {
                let sum: i32 = weights.iter().map(|&weight| i32::from(weight)).sum();
                *start = start.wrapping_add(sum.wrapping_mul(128));
            }
        }
        starts.extend(std::iter::repeat_n(0, padded(blocks * BLOCK)));
        let mut factors = factors.to_vec();
        factors.extend(std::iter::repeat_n(0.0, padded(blocks * BLOCK)));
        Self {
            #[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
            outputs,
            blocks,
            runs,
            run,
            groups,
            weights: packed,
            #[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
            few,
            starts,
            factors,
        }
    }

    /// Output channels, padded to whole blocks.
    pub(crate) fn lanes(&self) -> usize {
        self.blocks * BLOCK
    }

    /// Whether [`Kernel::dense_floats`] makes rows like this one, of few outputs, in less time than [`Kernel::dense_bytes`].
    #[cfg_attr(
        not(any(target_arch = "x86_64", target_arch = "aarch64")),
        expect(unused_variables, reason = "the portable kernels know no few outputs")
    )]
    pub(crate) fn has_few_outputs(&self, row: &Row<'_>) -> bool {
        #[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
        return self.few(row, BLOCK).is_some();
        #[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
        return false;
    }

    /// Numbers that a row of so many pixels takes as f32, if [`Self::has_few_outputs`] may say so of it.
    #[cfg_attr(
        not(any(target_arch = "x86_64", target_arch = "aarch64")),
        expect(unused_variables, reason = "as above")
    )]
    pub(crate) fn row_of_few(&self, pixels: usize) -> usize {
        #[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
        if self.few.is_some() {
            return self.lanes() * pixels;
        }
        0
    }

    /// How many blocks of weights a pixel is multiplied by.
    #[cfg(test)]
    pub(crate) fn blocks_of_weights(&self) -> usize {
        let groups = self.groups.iter();
        groups.map(|group| group.blocks * group.places.len()).sum()
    }

    fn check(&self, row: &Row<'_>) {
        assert!(row.runs.len() == self.runs && row.is_inside(self.run));
    }
}

/// Sizes of the groups of blocks: as few and as even as can be.
fn sizes_of_groups(blocks: usize, most: usize) -> impl Iterator<Item = usize> {
    let count = blocks.div_ceil(most).max(1);
    (0..count).map(move |group| blocks / count + usize::from(group < blocks % count))
}

/// One row of output pixels and where its input lies.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Row<'a> {
    /// The whole input tensor.
    pub(crate) input: &'a [u8],
    /// Where in it the first output pixel's first tap is.
    pub(crate) base: usize,
    /// From there to each run (dense) or tap (depthwise).
    pub(crate) runs: &'a [usize],
    /// Input bytes from one output pixel to the next.
    pub(crate) step: usize,
    /// Output pixels.
    pub(crate) pixels: usize,
}

impl Row<'_> {
    /// Whether all that is read of it, `run` bytes from each run on, is in the input.
    fn is_inside(&self, run: usize) -> bool {
        let farthest = self
            .runs
            .iter()
            .max()
            .map_or(Some(0), |run| self.base.checked_add(*run));
        let last = self.pixels.saturating_sub(1).checked_mul(self.step);
        let end = || farthest?.checked_add(last?)?.checked_add(run);
        end().is_some_and(|end| end <= self.input.len())
    }
}

/// Whether so many things of a size do. What would wrap does not.
fn fits(things: usize, size: usize, length: usize) -> bool {
    things
        .checked_mul(size)
        .is_some_and(|needed| needed <= length)
}

/// Weights of a depthwise convolution, with start and factor of each channel.
#[derive(Clone, Debug)]
pub(crate) struct Depthwise {
    /// Bytes of a pixel of input and output: channels padded to a multiple of 16.
    pitch: usize,
    rows: usize,
    columns: usize,
    /// `[row][column][pitch]`.
    weights: Vec<i8>,
    starts: Vec<i32>,
    factors: Vec<f32>,
    /// As dot products want them; empty for other kernels.
    #[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
    interleaved: Interleaved,
    /// As AVX-VNNI wants them; empty for other kernels.
    #[cfg(target_arch = "x86_64")]
    tap_quads: TapQuads,
}

impl Depthwise {
    /// Packs `filters`, `[channel][row][column]`.
    pub(crate) fn new(
        kernel: Kernel,
        pitch: usize,
        [rows, columns]: [usize; 2],
        filters: &[i8],
        starts: &[i32],
        factors: &[f32],
    ) -> Self {
        let taps = rows * columns;
        let mut weights = vec![0; taps * pitch];
        for (channel, filter) in filters.chunks_exact(taps).enumerate() {
            for (tap, &weight) in filter.iter().enumerate() {
                weights[tap * pitch + channel] = weight;
            }
        }
        let (mut starts, mut factors) = (starts.to_vec(), factors.to_vec());
        starts.resize(pitch, 0);
        factors.resize(pitch, 0.0);
        let mut packed = Self {
            pitch,
            rows,
            columns,
            weights,
            starts,
            factors,
            #[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
            interleaved: Interleaved::default(),
            #[cfg(target_arch = "x86_64")]
            tap_quads: TapQuads::default(),
        };
        #[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
        if let Kernel::Avx512Vnni | Kernel::NeonDotprod | Kernel::NeonI8mm = kernel {
            packed.interleaved = Interleaved::new(kernel, &packed);
        }
        #[cfg(target_arch = "x86_64")]
        if kernel == Kernel::AvxVnni {
            packed.tap_quads = TapQuads::new(&packed);
        }
        #[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
        let _ = (kernel, &mut packed);
        packed
    }

    fn check(&self, row: &Row<'_>, out: &[u8]) {
        assert!(row.runs.len() == self.rows * self.columns && row.is_inside(self.pitch));
        assert!(fits(row.pixels, self.pitch, out.len()));
    }
}

/// Quantizations of an addition.
#[derive(Clone, Debug)]
pub(crate) struct Addition {
    /// Zero points of the two.
    pub(crate) zeros: [u8; 2],
    /// Scales of the two, over that of the sum.
    pub(crate) factors: [f32; 2],
    /// What becomes of the sum.
    pub(crate) to: ToBytes,
}

/// Channels of a row of pixels, and where they go in another.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Part {
    /// Pixels of the row.
    pub(crate) pixels: usize,
    /// Channels of the input, all of which go.
    pub(crate) channels: usize,
    /// Bytes of a pixel of input and of output.
    pub(crate) pitches: [usize; 2],
    /// Where in an output pixel they go.
    pub(crate) first: usize,
}

macro_rules! dispatch {
    ($kernel:expr, $function:ident($($argument:expr),*)) => {
        match $kernel {
            Kernel::Portable => portable::$function($($argument),*),
            #[cfg(target_arch = "x86_64")]
            Kernel::Avx2 => {
                // SAFETY: an engine is built only with kernels that `is_supported` found on this processor.
                unsafe { avx2::$function($($argument),*) }
            }
            #[cfg(target_arch = "x86_64")]
            Kernel::AvxVnni => {
                // SAFETY: as above.
                unsafe { avxvnni::$function($($argument),*) }
            }
            #[cfg(target_arch = "x86_64")]
            Kernel::Avx512Vnni => {
                // SAFETY: as above.
                unsafe { avx512vnni::$function($($argument),*) }
            }
            #[cfg(target_arch = "aarch64")]
            Kernel::Neon => {
                // SAFETY: as above.
                unsafe { neon::plain::$function($($argument),*) }
            }
            #[cfg(target_arch = "aarch64")]
            Kernel::NeonDotprod => {
                // SAFETY: as above.
                unsafe { neon::dotprod::$function($($argument),*) }
            }
            #[cfg(target_arch = "aarch64")]
            Kernel::NeonI8mm => {
                // SAFETY: as above.
                unsafe { neon::i8mm::$function($($argument),*) }
            }
            // Those of other processors: no engine is built with one.
            _ => portable::$function($($argument),*),
        }
    };
}

impl Kernel {
    /// A row of a dense convolution as bytes, pixels `pitch` apart.
    pub(crate) fn dense_bytes(
        self,
        dense: &Dense,
        row: &Row<'_>,
        to: &ToBytes,
        out: &mut [u8],
        pitch: usize,
    ) {
        dense.check(row);
        assert!(fits(row.pixels, pitch, out.len()) && dense.lanes() <= pitch);
        dispatch!(self, dense_bytes(dense, row, to, out, pitch));
    }

    /// A row of a dense convolution as f32, `[lanes][pixels]`; lanes without an output may stay as they are.
    pub(crate) fn dense_floats(self, dense: &Dense, row: &Row<'_>, out: &mut [f32]) {
        dense.check(row);
        assert!(fits(row.pixels, dense.lanes(), out.len()));
        dispatch!(self, dense_floats(dense, row, out));
    }

    /// A row of a depthwise convolution.
    pub(crate) fn depthwise(
        self,
        depthwise: &Depthwise,
        row: &Row<'_>,
        to: &ToBytes,
        out: &mut [u8],
    ) {
        depthwise.check(row, out);
        dispatch!(self, depthwise(depthwise, row, to, out));
    }

    /// The sum of two rows.
    pub(crate) fn add(self, addition: &Addition, one: &[u8], other: &[u8], out: &mut [u8]) {
        assert!(one.len() == out.len() && other.len() == out.len());
        dispatch!(self, add(addition, one, other, out));
    }

    /// Puts the bytes of a row's channels where `part` says, through a table.
    pub(crate) fn place(self, table: &[u8; 256], part: Part, input: &[u8], out: &mut [u8]) {
        assert!(part.channels <= part.pitches[0] && part.first + part.channels <= part.pitches[1]);
        let length = |pitch: usize| part.pixels.checked_mul(pitch);
        assert!(
            length(part.pitches[0]) == Some(input.len())
                && length(part.pitches[1]) == Some(out.len())
        );
        #[cfg(target_arch = "x86_64")]
        if self == Kernel::Avx512Vnni && std::arch::is_x86_feature_detected!("avx512vbmi") {
            // SAFETY: the processor has VBMI, and the other two as an engine with this kernel was built; checked above.
            return unsafe { avx512vnni::place_row(table, part, input, out) };
        }
        portable::place_row(table, part, input, out);
    }

    /// A row of up to four planes of f32 as pixels of four bytes.
    pub(crate) fn quantize_four(self, planes: &[&[f32]], scale: f32, zero: u8, out: &mut [u8]) {
        assert!(planes.len() <= 4 && planes.iter().all(|plane| plane.len() * 4 == out.len()));
        dispatch!(self, quantize_four(planes, scale, zero, out));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What wraps must not pass for what fits: these checks are what the kernels' reads and writes rest on.
    #[test]
    fn lengths_that_wrap_do_not_fit() {
        assert!(fits(4, 16, 64) && !fits(4, 16, 63));
        assert!(!fits(1 << 60, 16, 64) && !fits(1 << 59, 64, usize::MAX));
        let inside = |base, step, pixels, run| {
            let input = &[0; 64];
            let runs = &[0, 16];
            Row {
                input,
                base,
                runs,
                step,
                pixels,
            }
            .is_inside(run)
        };
        assert!(inside(0, 16, 3, 16) && inside(16, 16, 2, 16) && inside(0, 16, 0, 48));
        assert!(!inside(0, 16, 4, 16) && !inside(1, 16, 3, 16) && !inside(0, 16, 3, 17));
        assert!(!inside(usize::MAX, 16, 3, 16) && !inside(0, 1 << 60, 17, 16));
        assert!(!inside(0, 16, usize::MAX, 16) && !inside(0, 16, 1, usize::MAX));
    }
}
