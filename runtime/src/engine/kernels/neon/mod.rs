//! NEON, which every aarch64 has: what multiplies and adds in dense convolutions is in [`plain`], [`dotprod`] and
//! [`i8mm`]; [`mod@depthwise`] is with the dot product and without; all else is the same for the three, and here.

use std::arch::aarch64::*;

use super::few::LANE;
use super::{Addition, BLOCK, Dense, Row, ToBytes, portable};

pub(super) mod depthwise;
pub(super) mod dotprod;
pub(super) mod i8mm;
pub(super) mod plain;

/// Pixels of a tile: sixteen accumulators, which hide the latency and leave registers for weights and input.
const PIXELS: usize = 4;

/// Zero point and bounds of the output in every lane.
#[derive(Clone, Copy)]
struct Limits {
    /// Whether the zero point is 0 and no byte is out of bounds, as after most clipped layers.
    plain: bool,
    zero: int16x8_t,
    low: uint8x16_t,
    high: uint8x16_t,
}

impl Limits {
    #[inline]
    fn new(to: &ToBytes) -> Self {
        // SAFETY: every aarch64 has NEON.
        unsafe {
            Self {
                plain: to.zero == 0 && to.range == (0..=u8::MAX),
                zero: vdupq_n_s16(i16::from(to.zero)),
                low: vdupq_n_u8(*to.range.start()),
                high: vdupq_n_u8(*to.range.end()),
            }
        }
    }

    /// Sixteen values as bytes. Each narrowing saturates, and so brings what is far out of bounds to the bound that it is beyond.
    #[inline]
    fn pack(&self, values: [float32x4_t; 4]) -> uint8x16_t {
        // SAFETY: every aarch64 has NEON.
        unsafe {
            let [a, b, c, d] = values.map(|value| vcvtnq_s32_f32(value));
            let one = vqmovn_high_s32(vqmovn_s32(a), b);
            let other = vqmovn_high_s32(vqmovn_s32(c), d);
            if self.plain {
                return vqmovun_high_s16(vqmovun_s16(one), other);
            }
            let (one, other) = (vqaddq_s16(one, self.zero), vqaddq_s16(other, self.zero));
            let bytes = vqmovun_high_s16(vqmovun_s16(one), other);
            vminq_u8(vmaxq_u8(bytes, self.low), self.high)
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
    /// The block's, as its kernel had them packed.
    weights: *const i8,
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

/// `x - 128`, as a signed byte.
#[inline(always)]
fn signed(bytes: uint8x16_t) -> uint8x16_t {
    // SAFETY: every aarch64 has NEON.
    unsafe { veorq_u8(bytes, vdupq_n_u8(128)) }
}

/// The instructions that multiply.
trait Multiply {
    /// Accumulators of a tile of `COUNT` pixels.
    ///
    /// # Safety
    /// The processor has the instructions, the row passed `Dense::check`, and the tile lies in it.
    unsafe fn sums<const COUNT: usize>(tile: Tile<'_>) -> [[int32x4_t; 4]; COUNT];

    /// Whether the products that are added to a sum are those of its four bytes.
    const DOT: bool;

    /// Input as [`Multiply::products`] takes it.
    #[inline(always)]
    fn input(bytes: uint8x16_t) -> uint8x16_t {
        bytes
    }

    /// Adds sixteen products to four sums; a dot product adds to each those of its four bytes.
    ///
    /// # Safety
    /// The processor has the instructions.
    unsafe fn products(sums: int32x4_t, input: uint8x16_t, weights: int8x16_t) -> int32x4_t;
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
    // The compiler has two copies of the accumulators where there may be none.
    assert!(!row.runs.is_empty());
    for (block, group) in dense.groups.iter().enumerate() {
        let lane = block * BLOCK;
        let mut tile = Tile {
            dense,
            row,
            block,
            weights: dense.weights[group.weights..].as_ptr(),
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
    // SAFETY: as this function's; the weights of few outputs are of this row's convolution.
    unsafe {
        if let Some(weights) = packed.few(row, PIXELS) {
            for output in 0..packed.outputs {
                few::<M>(packed, weights, output, row, out);
            }
            return;
        }
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

/// One of few outputs: each pixel as four sums that are added up in the end. Inlined into a function that has the instructions.
///
/// # Safety
/// As [`dense`]; `all` is what [`Dense::few`] gave for the row and [`PIXELS`].
#[inline(always)]
unsafe fn few<M: Multiply>(
    packed: &Dense,
    all: &[[i8; LANE]],
    output: usize,
    row: &Row<'_>,
    out: &mut [f32],
) {
    for pixel in (0..row.pixels).step_by(PIXELS) {
        let pixel = pixel.min(row.pixels - PIXELS);
        // SAFETY: sixteen bytes at a time of the runs of the pixels of the row, and as many weights of each output; a start and a factor for
        // each output, and four pixels of its row.
        unsafe {
            let mut sums = [vdupq_n_s32(0); PIXELS];
            let mut weights = all.as_ptr().add(output);
            for offset in row.runs {
                for tap in (0..packed.run).step_by(LANE) {
                    let of_tap = vld1q_s8(weights.cast());
                    let at = row.base + offset + pixel * row.step + tap;
                    for (number, sums) in sums.iter_mut().enumerate() {
                        let input = vld1q_u8(row.input.as_ptr().add(at + number * row.step));
                        *sums = M::products(*sums, M::input(input), of_tap);
                    }
                    weights = weights.wrapping_add(packed.outputs);
                }
            }
            let [a, b, c, d] = sums;
            let sums = vpaddq_s32(vpaddq_s32(a, b), vpaddq_s32(c, d));
            let start = vdupq_n_s32(*packed.starts.get_unchecked(output));
            let factor = *packed.factors.get_unchecked(output);
            let values = vmulq_n_f32(vcvtq_f32_s32(vaddq_s32(sums, start)), factor);
            vst1q_f32(out.as_mut_ptr().add(output * row.pixels + pixel), values);
        }
    }
}

/// What [`Kernel`](super::Kernel) calls, for one way to multiply.
macro_rules! kernel {
    ($multiply:ident, $features:literal) => {
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

        /// # Safety
        /// The processor has the instructions, the row passed `Depthwise::check`, and `out` has room for it.
        #[target_feature(enable = $features)]
        pub(in crate::engine::kernels) unsafe fn depthwise(
            packed: &Depthwise,
            row: &Row<'_>,
            to: &ToBytes,
            out: &mut [u8],
        ) {
            // SAFETY: as this function's.
            unsafe { super::depthwise::row::<$multiply>(packed, row, to, out) }
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
    // SAFETY: every aarch64 has NEON.
    let lowest = unsafe { vdupq_n_f32(-f32::from(zero)) };
    let whole = out.len() / 64 * 64;
    for at in (0..whole).step_by(64) {
        // SAFETY: sixteen values of each plane and 64 bytes from the first of these pixels on.
        unsafe {
            let bytes = |channel: usize| match planes.get(channel) {
                Some(plane) => limits.pack([0, 4, 8, 12].map(|value| {
                    let values = vld1q_f32(plane.as_ptr().add(at / 4 + value));
                    // Also sends NaN to the lower bound.
                    vmaxnmq_f32(vdivq_f32(values, vdupq_n_f32(scale)), lowest)
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
