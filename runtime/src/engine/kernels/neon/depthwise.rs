//! Depthwise convolutions: with dot products four rows of taps at a time, and else with `smlal`, tap by tap.

use std::arch::aarch64::*;

use super::{Limits, Multiply, PIXELS, lanes, scaled, widen};
use crate::engine::kernels::quads::{TALL, has, quads};
use crate::engine::kernels::{BLOCK, Depthwise, Kernel, Row, ToBytes};

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

/// Tap by tap, any kernel.
///
/// # Safety
/// The row passed `Depthwise::check`.
unsafe fn plain(packed: &Depthwise, row: &Row<'_>, to: &ToBytes, out: &mut [u8]) {
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

/// Weights of a depthwise convolution as [`quads`](super::super::quads) of 16 channels.
#[derive(Clone, Debug, Default)]
pub(in crate::engine::kernels) struct Interleaved {
    /// `[16 channels][quad][channel][byte]`.
    weights: Vec<i8>,
    starts: Vec<i32>,
}

impl Interleaved {
    /// Of kernels that have quads; of others it stays empty.
    pub(in crate::engine::kernels) fn new(kernel: Kernel, depthwise: &Depthwise) -> Self {
        let &Depthwise {
            pitch,
            rows,
            columns,
            ..
        } = depthwise;
        let mut packed = Self::default();
        if !has(rows, columns) {
            return packed;
        }
        for first in (0..pitch).step_by(BLOCK) {
            for quad in 0..quads(rows) {
                for channel in first..first + BLOCK {
                    let weight = |byte| depthwise.in_quad(channel, quad, byte);
                    packed.weights.extend((0..TALL).map(weight));
                }
            }
        }
        packed.starts.clone_from(&depthwise.starts);
        if kernel == Kernel::NeonDotprod {
            // It multiplies signed bytes, `x - 128`.
            for taps in depthwise.weights.chunks_exact(pitch) {
                for (start, &weight) in packed.starts.iter_mut().zip(taps) {
                    *start = start.wrapping_add(128 * i32::from(weight));
                }
            }
        }
        packed
    }
}

/// Four registers of bytes, in turns: of the first four, the next and so on.
#[inline(always)]
fn interleaved([a, b, c, d]: [uint8x16_t; TALL]) -> [uint8x16_t; 4] {
    words(pair(a, b), pair(c, d))
}

/// Two registers, byte by byte in turns.
#[inline(always)]
fn pair(one: uint8x16_t, other: uint8x16_t) -> [uint16x8_t; 2] {
    // SAFETY: every aarch64 has NEON.
    unsafe {
        [vzip1q_u8(one, other), vzip2q_u8(one, other)].map(|bytes| vreinterpretq_u16_u8(bytes))
    }
}

/// Two pairs, word by word in turns.
#[inline(always)]
fn words(one: [uint16x8_t; 2], other: [uint16x8_t; 2]) -> [uint8x16_t; 4] {
    // SAFETY: every aarch64 has NEON.
    unsafe {
        [
            vzip1q_u16(one[0], other[0]),
            vzip2q_u16(one[0], other[0]),
            vzip1q_u16(one[1], other[1]),
            vzip2q_u16(one[1], other[1]),
        ]
        .map(|words| vreinterpretq_u8_u16(words))
    }
}

/// Most rows of taps.
const MOST: usize = 5;

/// Sixteen channels of a row.
struct Strip {
    /// The first tap of each row of taps of the first pixel.
    rows: [*const u8; MOST],
    pixels: usize,
    /// Bytes of a pixel of input and output.
    pitch: usize,
    /// Of this strip: `[quad][register]`, `[register]`, `[register]`.
    weights: *const i8,
    starts: *const i32,
    factors: *const f32,
    limits: Limits,
    out: *mut u8,
}

impl Strip {
    /// Sixteen channels of a pixel of input.
    ///
    /// # Safety
    /// `at` leads from the row's first tap to a tap of one of its pixels.
    #[inline(always)]
    unsafe fn load<M: Multiply>(&self, row: usize, at: usize) -> uint8x16_t {
        // SAFETY: as this function's.
        M::input(unsafe { vld1q_u8(self.rows[row].add(at)) })
    }

    /// # Safety
    /// There is such a quad, and four registers.
    #[inline(always)]
    unsafe fn weight(&self, register: usize, quad: usize) -> int8x16_t {
        // SAFETY: as this function's.
        unsafe { vld1q_s8(self.weights.add((4 * quad + register) * BLOCK)) }
    }

    /// # Safety
    /// There is such a pixel.
    #[inline(always)]
    unsafe fn store(&self, sums: [int32x4_t; 4], pixel: usize) {
        // SAFETY: sixteen factors; `out` has room for the pixels.
        unsafe {
            let bytes = self.limits.pack(scaled(sums, self.factors));
            vst1q_u8(self.out.add(pixel * self.pitch), bytes);
        }
    }

    /// 3x3, as a window that moves over the columns: each is unpacked once and goes into the sums of all pixels that it belongs to,
    /// while weights and sums stay in registers.
    ///
    /// # Safety
    /// As [`row`]; the kernel is 3x3 and moves by `STRIDE`.
    #[inline(always)]
    unsafe fn three<M: Multiply, const STRIDE: usize>(&self) {
        // SAFETY: three quads of four registers, four of starts.
        let (weights, starts) = unsafe {
            let quad = |quad: usize| [0, 1, 2, 3].map(|j| self.weight(j, quad));
            ([quad(0), quad(1), quad(2)], self.starts)
        };
        // SAFETY: every aarch64 has NEON.
        let mut sums = [[unsafe { vdupq_n_s32(0) }; 4]; 3];
        let (mut at, mut pixel) = (0, 0);
        macro_rules! column {
            ($($tap:literal of $sums:literal),*) => {
                // SAFETY: a column of a pixel that is still to be written; the processor has the instructions.
                unsafe {
                    let last = self.load::<M>(2, at);
                    let four = interleaved([self.load::<M>(0, at), self.load::<M>(1, at), last, last]);
                    at += self.pitch;
                    $(
                        if $tap == 0 {
                            sums[$sums] = lanes(starts);
                        }
                        unrolled!(j in 0 1 2 3 {
                            sums[$sums][j] = M::products(sums[$sums][j], four[j], weights[$tap][j]);
                        });
                    )*
                }
            };
        }
        macro_rules! done {
            ($sums:literal) => {
                // SAFETY: there is such a pixel.
                unsafe { self.store(sums[$sums], pixel) };
                pixel += 1;
                if pixel == self.pixels {
                    return;
                }
            };
        }
        moving_window!(STRIDE, column, done);
    }

    /// 5x5, in tiles of `COUNT` pixels, the last one moved back onto pixels already done; one by one in a shorter row.
    ///
    /// # Safety
    /// As [`row`]; the kernel is 5x5 and moves by `STRIDE`.
    #[inline(always)]
    unsafe fn five<M: Multiply, const STRIDE: usize, const COUNT: usize>(&self) {
        // SAFETY: all tiles lie in the row.
        unsafe {
            if self.pixels < COUNT {
                for pixel in 0..self.pixels {
                    self.five_tile::<M, STRIDE, 1>(pixel);
                }
                return;
            }
            for pixel in (0..self.pixels).step_by(COUNT) {
                self.five_tile::<M, STRIDE, COUNT>(pixel.min(self.pixels - COUNT));
            }
        }
    }

    /// # Safety
    /// As [`Strip::five`]; the row has so many pixels from `pixel` on.
    #[inline(always)]
    unsafe fn five_tile<M: Multiply, const STRIDE: usize, const COUNT: usize>(&self, pixel: usize) {
        const SIDE: usize = 5;
        // As far as the loops below are written out.
        const {
            assert!((COUNT - 1) * STRIDE + SIDE <= 8 && COUNT <= 4);
        }
        // SAFETY: each column of the tile is the tap of some output pixel of it; the kernel has such quads, and four registers of
        // starts; the processor has the instructions.
        unsafe {
            let at = |row: usize, column: usize| {
                self.load::<M>(row, (pixel * STRIDE + column) * self.pitch)
            };
            let mut sums = [lanes(self.starts); COUNT];
            unrolled!(column in 0 1 2 3 4 5 6 7 {
                if column < (COUNT - 1) * STRIDE + SIDE {
                    let four = interleaved([at(0, column), at(1, column), at(2, column), at(3, column)]);
                    unrolled!(pixel in 0 1 2 3 {
                        if pixel < COUNT && column >= pixel * STRIDE && column < pixel * STRIDE + SIDE {
                            let tap = column - pixel * STRIDE;
                            unrolled!(j in 0 1 2 3 {
                                sums[pixel][j] = M::products(sums[pixel][j], four[j], self.weight(j, tap));
                            });
                        }
                    });
                }
            });
            // The fifth row, four columns to a lane, from each output pixel's first column on, and from the next one's.
            let last = (COUNT - 1) * STRIDE + SIDE - 1;
            let fifth = |column: usize| at(SIDE - 1, column.min(last));
            unrolled!(start in 0 1 2 3 4 {
                if start <= COUNT {
                    let first = start * STRIDE;
                    let four = words(
                        pair(fifth(first), fifth(first + 1)),
                        pair(fifth(first + 2), fifth(first + 3)),
                    );
                    unrolled!(j in 0 1 2 3 {
                        if start < COUNT {
                            sums[start][j] = M::products(sums[start][j], four[j], self.weight(j, SIDE));
                        }
                        if let Some(before) = usize::checked_sub(start, 1) {
                            let weight = self.weight(j, SIDE + STRIDE);
                            sums[before][j] = M::products(sums[before][j], four[j], weight);
                        }
                    });
                }
            });
            for (number, sums) in sums.into_iter().enumerate() {
                self.store(sums, pixel + number);
            }
        }
    }
}

/// A row. Inlined into a function that has the instructions.
///
/// # Safety
/// The processor has the instructions of `M`, the row passed `Depthwise::check`, and `out` has room for it.
#[inline(always)]
pub(super) unsafe fn row<M: Multiply>(
    packed: &Depthwise,
    row: &Row<'_>,
    to: &ToBytes,
    out: &mut [u8],
) {
    let Depthwise {
        pitch,
        rows: side,
        ref interleaved,
        ..
    } = *packed;
    let stride = row.step / pitch;
    if !M::DOT
        || interleaved.weights.is_empty()
        || !packed.is_close(row.runs)
        || !matches!(stride, 1 | 2)
        || row.pixels == 0
    {
        // SAFETY: as this function's.
        return unsafe { plain(packed, row, to, out) };
    }
    let limits = Limits::new(to);
    for channel in (0..pitch).step_by(BLOCK) {
        // SAFETY: the first tap of each row of taps, and for a row that the kernel does not have of its last, is in the row's input;
        // `Interleaved::new` packed four vectors of starts for every strip, and four times `quads` of weights, and `Depthwise::new` factors; side and
        // stride are the row's own.
        unsafe {
            let of_strip = quads(side) * TALL * BLOCK;
            let strip = Strip {
                rows: [0, 1, 2, 3, 4].map(|line: usize| {
                    let tap = row.runs.get_unchecked(line.min(side - 1) * side);
                    row.input.as_ptr().add(row.base + tap + channel)
                }),
                pixels: row.pixels,
                pitch,
                weights: interleaved.weights.as_ptr().add(channel / BLOCK * of_strip),
                starts: interleaved.starts.as_ptr().add(channel),
                factors: packed.factors.as_ptr().add(channel),
                limits,
                out: out.as_mut_ptr().add(channel),
            };
            match (side, stride) {
                (3, 1) => strip.three::<M, 1>(),
                (3, _) => strip.three::<M, 2>(),
                (_, 1) => strip.five::<M, 1, 4>(),
                _ => strip.five::<M, 2, 2>(),
            }
        }
    }
}
