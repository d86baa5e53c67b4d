//! NEON, which every aarch64 has: what multiplies and adds in dense convolutions is in [`plain`], [`dotprod`] and
//! [`i8mm`]; [`mod@depthwise`] is with the dot product and without; all else is the same for the three, and here.

use std::arch::aarch64::*;

use super::{Addition, BLOCK, Dense, Row, ToBytes, portable};

pub(super) mod depthwise;
pub(super) mod dotprod;
pub(super) mod i8mm;
pub(super) mod plain;

/// Pixels of a tile: sixteen accumulators, which hide the latency and leave registers for weights and input.
const PIXELS: usize = 4;

/// Zero point and bounds of the output in every lane. Clamped before rounding and before the zero point is added, which
/// also sends NaN to the lower bound.
#[derive(Clone, Copy)]
struct Limits {
    zero: int16x8_t,
    low: float32x4_t,
    high: float32x4_t,
}

impl Limits {
    #[inline]
    fn new(to: &ToBytes) -> Self {
        let bound = |byte: u8| f32::from(byte) - f32::from(to.zero);
        // SAFETY: every aarch64 has NEON.
        unsafe {
            Self {
                zero: vdupq_n_s16(i16::from(to.zero)),
                low: vdupq_n_f32(bound(*to.range.start())),
                high: vdupq_n_f32(bound(*to.range.end())),
            }
        }
    }

    /// `rne(value)` in bounds, without the zero point.
    #[inline]
    fn round(&self, value: float32x4_t) -> int32x4_t {
        // SAFETY: every aarch64 has NEON.
        unsafe { vcvtnq_s32_f32(vminnmq_f32(vmaxnmq_f32(value, self.low), self.high)) }
    }

    /// Sixteen values as bytes.
    #[inline]
    fn pack(&self, values: [float32x4_t; 4]) -> uint8x16_t {
        let [a, b, c, d] = values.map(|value| self.round(value));
        // SAFETY: every aarch64 has NEON.
        unsafe {
            let one = vaddq_s16(vmovn_high_s32(vmovn_s32(a), b), self.zero);
            let other = vaddq_s16(vmovn_high_s32(vmovn_s32(c), d), self.zero);
            vreinterpretq_u8_s8(vmovn_high_s16(vmovn_s16(one), other))
        }
    }
}

/// Sixteen accumulators as real numbers.
///
/// # Safety
/// Sixteen factors are there.
#[inline]
unsafe fn scaled(sums: [int32x4_t; 4], factors: *const f32) -> [float32x4_t; 4] {
    let mut values = sums.map(|sums| {
        // SAFETY: every aarch64 has NEON.
        unsafe { vcvtq_f32_s32(sums) }
    });
    for (quarter, value) in values.iter_mut().enumerate() {
        // SAFETY: as this function's.
        *value = unsafe { vmulq_f32(*value, vld1q_f32(factors.add(4 * quarter))) };
    }
    values
}

/// Sixteen lanes from memory.
///
/// # Safety
/// Sixteen values are there.
#[inline]
unsafe fn lanes(from: *const i32) -> [int32x4_t; 4] {
    // SAFETY: as this function's.
    unsafe { [0, 4, 8, 12].map(|lane| vld1q_s32(from.add(lane))) }
}

/// A block of channels of some pixels of a dense convolution.
#[derive(Clone, Copy)]
struct Tile<'a> {
    dense: &'a Dense,
    row: &'a Row<'a>,
    block: usize,
    pixel: usize,
}

impl Tile<'_> {
    /// What the block's accumulators start from.
    ///
    /// # Safety
    /// The block is one of the convolution's.
    #[inline]
    unsafe fn starts(&self) -> [int32x4_t; 4] {
        // SAFETY: there is a start for every lane of every block.
        unsafe { lanes(self.dense.starts.as_ptr().add(self.block * BLOCK)) }
    }

    /// The block's weights, as its kernel had them packed.
    ///
    /// # Safety
    /// As [`Tile::starts`].
    #[inline]
    unsafe fn weights(&self) -> *const i8 {
        let at = self.block * self.dense.block_weights();
        // SAFETY: there are as many for every block.
        unsafe { self.dense.weights.as_ptr().add(at) }
    }

    /// The first byte of a run of the tile's first pixel.
    ///
    /// # Safety
    /// The row passed `Dense::check`, and has the pixel; `run` is one of its own.
    #[inline]
    unsafe fn input(&self, run: usize) -> *const u8 {
        let Row {
            input, base, step, ..
        } = *self.row;
        // SAFETY: it is in the row's input.
        unsafe { input.as_ptr().add(base + run + self.pixel * step) }
    }
}

/// Four bytes, and zeros.
///
/// # Safety
/// Four bytes are there.
#[inline]
unsafe fn quad(from: *const u8) -> uint8x8_t {
    // SAFETY: as this function's.
    unsafe { vcreate_u8(u64::from(from.cast::<u32>().read_unaligned())) }
}

/// The instructions that multiply.
trait Multiply {
    /// Accumulators of a tile of `COUNT` pixels.
    ///
    /// # Safety
    /// The processor has the instructions, the row passed `Dense::check`, and the tile lies in it.
    unsafe fn sums<const COUNT: usize>(tile: Tile<'_>) -> [[int32x4_t; 4]; COUNT];
}

/// Calls `store(pixel, lane, values)` for each block of each pixel. A row ends in a tile that is moved back onto pixels
/// already done; one shorter than a tile is done pixel by pixel.
///
/// # Safety
/// The processor has the instructions of `M`, and the row passed `Dense::check`.
#[inline(always)]
unsafe fn dense<M: Multiply>(
    dense: &Dense,
    row: &Row<'_>,
    mut store: impl FnMut(usize, usize, [float32x4_t; 4]),
) {
    for block in 0..dense.blocks {
        let lane = block * BLOCK;
        let mut tile = Tile {
            dense,
            row,
            block,
            pixel: 0,
        };
        // SAFETY: the blocks are the convolution's, with a factor for every lane, and the pixels the row's.
        unsafe {
            let factors = dense.factors.as_ptr().add(lane);
            if row.pixels < PIXELS {
                for pixel in 0..row.pixels {
                    tile.pixel = pixel;
                    store(pixel, lane, scaled(M::sums::<1>(tile)[0], factors));
                }
                continue;
            }
            for pixel in (0..row.pixels).step_by(PIXELS) {
                tile.pixel = pixel.min(row.pixels - PIXELS);
                for (number, sums) in M::sums::<PIXELS>(tile).into_iter().enumerate() {
                    store(tile.pixel + number, lane, scaled(sums, factors));
                }
            }
        }
    }
}

/// A row as bytes. Inlined into a function that has the instructions.
///
/// # Safety
/// As [`dense`]; `out` has room for the row.
#[inline(always)]
unsafe fn bytes<M: Multiply>(
    packed: &Dense,
    row: &Row<'_>,
    to: &ToBytes,
    out: &mut [u8],
    pitch: usize,
) {
    let limits = Limits::new(to);
    let out = out.as_mut_ptr();
    // SAFETY: as this function's.
    unsafe {
        dense::<M>(packed, row, |pixel, lane, values| {
            vst1q_u8(out.add(pixel * pitch + lane), limits.pack(values));
        });
    }
}

/// A row as f32. Inlined into a function that has the instructions.
///
/// # Safety
/// As [`dense`].
#[inline(always)]
unsafe fn floats<M: Multiply>(packed: &Dense, row: &Row<'_>, out: &mut [f32]) {
    // SAFETY: as this function's.
    unsafe {
        dense::<M>(packed, row, |pixel, lane, values| {
            for (quarter, values) in values.into_iter().enumerate() {
                let mut reals = [0.0; 4];
                vst1q_f32(reals.as_mut_ptr(), values);
                for (number, real) in reals.into_iter().enumerate() {
                    out[(lane + 4 * quarter + number) * row.pixels + pixel] = real;
                }
            }
        });
    }
}

/// What [`Kernel`](super::Kernel) calls, for one way to multiply.
macro_rules! kernel {
    ($multiply:ident, $features:literal, $depthwise:ident) => {
        pub(in crate::engine::kernels) use super::depthwise::$depthwise as depthwise;
        pub(in crate::engine::kernels) use super::{add, quantize_four};

        /// # Safety
        /// The processor has the instructions, the row passed `Dense::check`, and `out` has room for it.
        #[target_feature(enable = $features)]
        pub(in crate::engine::kernels) unsafe fn dense_bytes(
            packed: &Dense,
            row: &Row<'_>,
            to: &ToBytes,
            out: &mut [u8],
            pitch: usize,
        ) {
            // SAFETY: as this function's.
            unsafe { super::bytes::<$multiply>(packed, row, to, out, pitch) }
        }

        /// # Safety
        /// As [`dense_bytes`].
        #[target_feature(enable = $features)]
        pub(in crate::engine::kernels) unsafe fn dense_floats(
            packed: &Dense,
            row: &Row<'_>,
            out: &mut [f32],
        ) {
            // SAFETY: as this function's.
            unsafe { super::floats::<$multiply>(packed, row, out) }
        }
    };
}
use kernel;

/// Sixteen bytes as 16-bit numbers.
#[inline]
fn widen(bytes: uint8x16_t) -> [int16x8_t; 2] {
    // SAFETY: every aarch64 has NEON.
    unsafe {
        [
            vreinterpretq_s16_u16(vmovl_u8(vget_low_u8(bytes))),
            vreinterpretq_s16_u16(vmovl_high_u8(bytes)),
        ]
    }
}

/// # Safety
/// The three slices are of one length.
pub(super) unsafe fn add(addition: &Addition, one: &[u8], other: &[u8], out: &mut [u8]) {
    let limits = Limits::new(&addition.to);
    let whole = out.len() / 16 * 16;
    for at in (0..whole).step_by(16) {
        let part = |input: usize, bytes: &[u8]| {
            // SAFETY: sixteen bytes from `at` on.
            unsafe {
                let zero = vdupq_n_s16(i16::from(addition.zeros[input]));
                let [low, high] =
                    widen(vld1q_u8(bytes.as_ptr().add(at))).map(|bytes| vsubq_s16(bytes, zero));
                [
                    vmovl_s16(vget_low_s16(low)),
                    vmovl_high_s16(low),
                    vmovl_s16(vget_low_s16(high)),
                    vmovl_high_s16(high),
                ]
                .map(|value| vmulq_n_f32(vcvtq_f32_s32(value), addition.factors[input]))
            }
        };
        let (mut sums, others) = (part(0, one), part(1, other));
        for (sum, other) in sums.iter_mut().zip(others) {
            // SAFETY: every aarch64 has NEON.
            *sum = unsafe { vaddq_f32(*sum, other) };
        }
        // SAFETY: sixteen bytes from `at` on.
        unsafe { vst1q_u8(out.as_mut_ptr().add(at), limits.pack(sums)) };
    }
    portable::add(addition, &one[whole..], &other[whole..], &mut out[whole..]);
}

/// # Safety
/// Each plane has a fourth of `out`'s length.
pub(super) unsafe fn quantize_four(planes: &[&[f32]], scale: f32, zero: u8, out: &mut [u8]) {
    let limits = Limits::new(&ToBytes {
        zero,
        range: 0..=255,
    });
    let whole = out.len() / 64 * 64;
    for at in (0..whole).step_by(64) {
        // SAFETY: sixteen values of each plane and 64 bytes from the first of these pixels on.
        unsafe {
            let bytes = |channel: usize| match planes.get(channel) {
                Some(plane) => limits.pack([0, 4, 8, 12].map(|value| {
                    let values = vld1q_f32(plane.as_ptr().add(at / 4 + value));
                    vdivq_f32(values, vdupq_n_f32(scale))
                })),
                None => vdupq_n_u8(zero),
            };
            let pixels = uint8x16x4_t(bytes(0), bytes(1), bytes(2), bytes(3));
            vst4q_u8(out.as_mut_ptr().add(at), pixels);
        }
    }
    let mut rest: [&[f32]; 4] = [&[]; 4];
    for (rest, plane) in rest.iter_mut().zip(planes) {
        *rest = &plane[whole / 4..];
    }
    portable::quantize_four(&rest[..planes.len()], scale, zero, &mut out[whole..]);
}
