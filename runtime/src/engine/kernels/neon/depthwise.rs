//! Depthwise convolutions: with `smlal`, tap by tap, and with the dot product, four rows of taps at a time.

use std::arch::aarch64::*;
use std::arch::asm;

use super::{Limits, PIXELS, lanes, scaled, widen};
use crate::engine::kernels::{BLOCK, Depthwise, Row, ToBytes};

/// Adds the products of sixteen lanes.
#[inline]
fn multiply_add(sums: &mut [int32x4_t; 4], bytes: [int16x8_t; 2], weights: [int16x8_t; 2]) {
    for half in 0..2 {
        let (bytes, weights) = (bytes[half], weights[half]);
        // SAFETY: every aarch64 has NEON.
        unsafe {
            sums[2 * half] = vmlal_s16(sums[2 * half], vget_low_s16(bytes), vget_low_s16(weights));
            sums[2 * half + 1] = vmlal_high_s16(sums[2 * half + 1], bytes, weights);
        }
    }
}

/// # Safety
/// The row passed `Depthwise::check`.
pub(in crate::engine::kernels) unsafe fn plain(
    packed: &Depthwise,
    row: &Row<'_>,
    to: &ToBytes,
    out: &mut [u8],
) {
    let limits = Limits::new(to);
    let pitch = packed.pitch;
    for channel in (0..pitch).step_by(BLOCK) {
        // SAFETY: there are a start and a factor for every channel of the pitch.
        let (starts, factors) = unsafe {
            (
                lanes(packed.starts.as_ptr().add(channel)),
                packed.factors.as_ptr().add(channel),
            )
        };
        for first in (0..row.pixels).step_by(PIXELS) {
            let mut sums = [starts; PIXELS];
            for (tap, run) in row.runs.iter().enumerate() {
                // SAFETY: `Depthwise::new` packed a pitch of weights for each tap.
                let weights = unsafe {
                    let weights = vld1q_s8(packed.weights.as_ptr().add(tap * pitch + channel));
                    [vmovl_s8(vget_low_s8(weights)), vmovl_high_s8(weights)]
                };
                for (pixel, sums) in sums.iter_mut().enumerate() {
                    // Past the end the last pixel is done again; only the pixels of the row are stored.
                    let pixel = (first + pixel).min(row.pixels - 1);
                    // SAFETY: sixteen channels of a tap of a pixel of the row.
                    let bytes = unsafe {
                        let at = row.base + run + pixel * row.step + channel;
                        vld1q_u8(row.input.as_ptr().add(at))
                    };
                    multiply_add(sums, widen(bytes), weights);
                }
            }
            for (pixel, sums) in sums.into_iter().enumerate().take(row.pixels - first) {
                // SAFETY: sixteen bytes of a pixel that `out` has room for.
                unsafe {
                    let out = out.as_mut_ptr().add((first + pixel) * pitch + channel);
                    vst1q_u8(out, limits.pack(scaled(sums, factors)));
                }
            }
        }
    }
}

/// Rows of taps that one dot product takes.
const TALL: usize = 4;

/// Weights for the dot product: four rows of taps are the four bytes of a lane. It multiplies `x - 128`.
#[derive(Clone, Debug, Default)]
pub(in crate::engine::kernels) struct Interleaved {
    /// `[16 channels][4 rows][column][channel][row]`.
    weights: Vec<i8>,
    starts: Vec<i32>,
}

impl Interleaved {
    pub(in crate::engine::kernels) fn new(depthwise: &Depthwise) -> Self {
        let Depthwise {
            pitch,
            rows,
            columns,
            ..
        } = *depthwise;
        let weight = |channel: usize, row: usize, column: usize| {
            let tap = row * columns + column;
            if row < rows {
                depthwise.weights[tap * pitch + channel]
            } else {
                0
            }
        };
        let mut packed = Self {
            weights: Vec::new(),
            starts: depthwise.starts.clone(),
        };
        for first in (0..pitch).step_by(BLOCK) {
            for top in (0..rows).step_by(TALL) {
                for column in 0..columns {
                    for channel in first..first + BLOCK {
                        for row in top..top + TALL {
                            let weight = weight(channel, row, column);
                            packed.weights.push(weight);
                            let start = &mut packed.starts[channel];
                            *start = start.wrapping_add(128 * i32::from(weight));
                        }
                    }
                }
            }
        }
        packed
    }
}

/// Adds to each lane the products of its four weights and four bytes.
#[target_feature(enable = "neon,dotprod")]
#[inline]
fn sdot(sums: int32x4_t, weights: int8x16_t, bytes: int8x16_t) -> int32x4_t {
    let mut sums = sums;
    // SAFETY: it touches nothing but these registers, and the processor has it. The intrinsic is not stable yet.
    unsafe {
        asm!("sdot {0:v}.4s, {1:v}.16b, {2:v}.16b",
            inout(vreg) sums, in(vreg) weights, in(vreg) bytes,
            options(pure, nomem, nostack, preserves_flags));
    }
    sums
}

/// Sixteen channels of a row of output.
struct Strip<'a> {
    depthwise: &'a Depthwise,
    row: &'a Row<'a>,
    channel: usize,
    limits: Limits,
    out: *mut u8,
}

impl Strip<'_> {
    /// Up to four rows of one column of input: byte `row` of lane `i` of register `j` is that of channel `4 j + i`.
    ///
    /// # Safety
    /// The first `count` of `rows` point to sixteen bytes of input.
    #[target_feature(enable = "neon,dotprod")]
    #[inline]
    unsafe fn column(rows: [*const u8; TALL], count: usize) -> [int8x16_t; 4] {
        let mut bytes = [vdupq_n_s8(0); TALL];
        for (bytes, row) in bytes.iter_mut().zip(rows).take(count) {
            // SAFETY: as this function's.
            *bytes = vreinterpretq_s8_u8(veorq_u8(unsafe { vld1q_u8(row) }, vdupq_n_u8(128)));
        }
        let [a, b, c, d] = bytes;
        let wide = |bytes| vreinterpretq_s16_s8(bytes);
        let (low, high) = (wide(vzip1q_s8(a, b)), wide(vzip2q_s8(a, b)));
        let (low2, high2) = (wide(vzip1q_s8(c, d)), wide(vzip2q_s8(c, d)));
        [
            vzip1q_s16(low, low2),
            vzip2q_s16(low, low2),
            vzip1q_s16(high, high2),
            vzip2q_s16(high, high2),
        ]
        .map(|pairs| vreinterpretq_s8_s16(pairs))
    }

    /// `COUNT` pixels from `pixel` on, of a kernel of `SIDE x SIDE` without dilation that moves by `STRIDE`.
    ///
    /// # Safety
    /// The row passed `Depthwise::check`, has `SIDE * SIDE` taps at regular distances and the pixels, and `out` has room
    /// for them.
    #[target_feature(enable = "neon,dotprod")]
    #[inline]
    unsafe fn run<const SIDE: usize, const STRIDE: usize, const COUNT: usize>(&self, pixel: usize) {
        let Depthwise {
            pitch, interleaved, ..
        } = self.depthwise;
        let Row {
            input,
            base,
            runs,
            step,
            ..
        } = *self.row;
        // SAFETY: `Interleaved::new` packed as many for every sixteen channels.
        let (weights, starts, factors) = unsafe {
            let of_block = SIDE.div_ceil(TALL) * SIDE * TALL * BLOCK;
            (
                interleaved
                    .weights
                    .as_ptr()
                    .add(self.channel / BLOCK * of_block),
                lanes(interleaved.starts.as_ptr().add(self.channel)),
                self.depthwise.factors.as_ptr().add(self.channel),
            )
        };
        let mut sums = [starts; COUNT];
        let start = base + pixel * step + self.channel;
        for top in (0..SIDE).step_by(TALL) {
            let count = TALL.min(SIDE - top);
            for column in 0..(COUNT - 1) * STRIDE + SIDE {
                // SAFETY: pixel by pixel along the row: each is the tap of some output pixel of the tile, and so in the
                // input; rows of taps that do not exist are not read.
                let bytes = unsafe {
                    let at = input.as_ptr().add(start + column * pitch);
                    let row = |number: usize| at.add(runs[(top + number).min(SIDE - 1) * SIDE]);
                    Self::column([row(0), row(1), row(2), row(3)], count)
                };
                for (pixel, sums) in sums.iter_mut().enumerate() {
                    let tap = column.wrapping_sub(pixel * STRIDE);
                    if tap >= SIDE {
                        continue;
                    }
                    for (quarter, sums) in sums.iter_mut().enumerate() {
                        // SAFETY: four vectors of weights for each column of four rows.
                        let weights = unsafe {
                            let column = top / TALL * SIDE + tap;
                            vld1q_s8(weights.add((column * 4 + quarter) * BLOCK))
                        };
                        *sums = sdot(*sums, weights, bytes[quarter]);
                    }
                }
            }
        }
        for (number, sums) in sums.into_iter().enumerate() {
            // SAFETY: sixteen factors; `out` has room.
            unsafe {
                let out = self.out.add((pixel + number) * pitch + self.channel);
                vst1q_u8(out, self.limits.pack(scaled(sums, factors)));
            }
        }
    }

    /// The whole row, in tiles of which the last is moved back onto pixels already done.
    ///
    /// # Safety
    /// As [`Strip::run`], for the whole row.
    #[target_feature(enable = "neon,dotprod")]
    unsafe fn all<const SIDE: usize, const STRIDE: usize>(&self) {
        let pixels = self.row.pixels;
        // SAFETY: all tiles lie in the row.
        unsafe {
            if pixels < PIXELS {
                (0..pixels).for_each(|pixel| self.run::<SIDE, STRIDE, 1>(pixel));
                return;
            }
            for pixel in (0..pixels).step_by(PIXELS) {
                self.run::<SIDE, STRIDE, PIXELS>(pixel.min(pixels - PIXELS));
            }
        }
    }
}

/// # Safety
/// The processor has the dot product, the row passed `Depthwise::check`, and `out` has room for it.
#[target_feature(enable = "neon,dotprod")]
pub(in crate::engine::kernels) unsafe fn dotprod(
    packed: &Depthwise,
    row: &Row<'_>,
    to: &ToBytes,
    out: &mut [u8],
) {
    let Depthwise {
        pitch,
        rows,
        columns,
        ..
    } = *packed;
    let (limits, stride) = (Limits::new(to), row.step / pitch);
    // Without dilation neighbouring taps are neighbouring pixels.
    let close = columns > 1 && row.runs[1] - row.runs[0] == pitch;
    if !close || !matches!((rows, columns, stride), (3, 3, 1 | 2) | (5, 5, 1 | 2)) {
        // SAFETY: as this function's.
        return unsafe { plain(packed, row, to, out) };
    }
    for channel in (0..pitch).step_by(BLOCK) {
        let strip = Strip {
            depthwise: packed,
            row,
            channel,
            limits,
            out: out.as_mut_ptr(),
        };
        // SAFETY: as this function's; side and stride are the row's own.
        unsafe {
            match (rows, stride) {
                (3, 1) => strip.all::<3, 1>(),
                (3, _) => strip.all::<3, 2>(),
                (_, 1) => strip.all::<5, 1>(),
                _ => strip.all::<5, 2>(),
            }
        }
    }
}
