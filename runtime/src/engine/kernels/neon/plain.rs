//! `smull`, `smlal`, `sadalp`: sixteen bytes of input against sixteen weights of one output, their products added two by two in 16
//! bits, and those four by four to 32.
//!
//! They take signed bytes, so the input is `x - 128`, and the starts hold the rest (see `Dense::new`). Two products fit 16 bits since
//! no weight is -128 (see `Kernel::least_weight`).

use std::arch::aarch64::*;
use std::arch::asm;

use super::{Multiply, Tile, kernel, quad, signed};
use crate::engine::kernels::{BLOCK, Dense, Depthwise, Row, ToBytes};

struct Plain;

/// Bytes of a run that meet one output at a time.
const BYTES: usize = 16;
/// Outputs and pixels of a tile: sixteen accumulators.
const OUTPUTS: usize = 8;
const PAIR: usize = 2;

impl Multiply for Plain {
    const DOT: bool = false;

    #[inline(always)]
    unsafe fn sums<const COUNT: usize>(tile: Tile<'_>) -> [[int32x4_t; 4]; COUNT] {
        // SAFETY: as this function's, and every aarch64 has NEON: a block has sixteen weights of each of its outputs for as many bytes
        // of its runs, zero beyond their ends, and what is read of a pixel is sixteen bytes of its run, eight, or the last four.
        unsafe {
            let (run, step) = (tile.dense.run, tile.row.step);
            let mut sums = [tile.starts(); COUNT];
            for outputs in (0..BLOCK).step_by(OUTPUTS) {
                for one in (0..COUNT).step_by(PAIR) {
                    let other = (one + 1).min(COUNT - 1);
                    let mut products = [[vdupq_n_s32(0); OUTPUTS]; PAIR];
                    let mut weights = tile.weights.add(outputs * BYTES);
                    for &offset in tile.row.runs {
                        let first = tile.input(offset);
                        let pixels = [first.add(one * step), first.add(other * step)];
                        for at in (0..run / BYTES * BYTES).step_by(BYTES) {
                            let input = pixels.map(|pixel| vld1q_u8(pixel.add(at)));
                            add_products::<false>(&mut products, input, weights);
                            weights = weights.wrapping_add(BYTES * BLOCK);
                        }
                        let rest = run / BYTES * BYTES;
                        if rest < run {
                            let input = pixels.map(|pixel| match run - rest {
                                4 => vcombine_u8(quad(pixel.add(rest)), vdup_n_u8(0)),
                                8 => vcombine_u8(vld1_u8(pixel.add(rest)), vdup_n_u8(0)),
                                _ => {
                                    vcombine_u8(vld1_u8(pixel.add(rest)), quad(pixel.add(rest + 8)))
                                }
                            });
                            if run - rest <= 8 {
                                add_products::<true>(&mut products, input, weights);
                            } else {
                                add_products::<false>(&mut products, input, weights);
                            }
                            weights = weights.wrapping_add(BYTES * BLOCK);
                        }
                    }
                    for (pixel, products) in [one, other].into_iter().zip(products) {
                        let [a, b, c, d, e, f, g, h] = products;
                        let low = vpaddq_s32(vpaddq_s32(a, b), vpaddq_s32(c, d));
                        let high = vpaddq_s32(vpaddq_s32(e, f), vpaddq_s32(g, h));
                        let starts = tile.starts();
                        sums[pixel][outputs / 4] = vaddq_s32(starts[outputs / 4], low);
                        sums[pixel][outputs / 4 + 1] = vaddq_s32(starts[outputs / 4 + 1], high);
                    }
                }
            }
            sums
        }
    }

    #[inline(always)]
    fn input(bytes: uint8x16_t) -> uint8x16_t {
        signed(bytes)
    }

    #[target_feature(enable = "neon")]
    #[inline]
    unsafe fn products(sums: int32x4_t, input: uint8x16_t, weights: int8x16_t) -> int32x4_t {
        let input = vreinterpretq_s8_u8(input);
        let products = vmull_s8(vget_low_s8(input), vget_low_s8(weights));
        vpadalq_s16(sums, vmlal_high_s8(products, input, weights))
    }
}

/// Adds the products of two pixels' bytes and each output's weights, [`BYTES`] apart; or only of the first eight bytes.
///
/// # Safety
/// The weights are there.
#[inline(always)]
unsafe fn add_products<const HALF: bool>(
    sums: &mut [[int32x4_t; OUTPUTS]; PAIR],
    input: [uint8x16_t; PAIR],
    weights: *const i8,
) {
    // SAFETY: as this function's, and every aarch64 has NEON.
    unsafe {
        let input = input.map(|bytes| vreinterpretq_s8_u8(signed(bytes)));
        unrolled!(output in 0 2 4 6 {
            let weights = [
                vld1q_s8(weights.add(output * BYTES)),
                vld1q_s8(weights.add((output + 1) * BYTES)),
            ];
            let [[a, b], [c, d]] = [0, 1].map(|pixel| [sums[pixel][output], sums[pixel][output + 1]]);
            let [a, b, c, d] = two_by_two::<HALF>([a, b, c, d], input, weights);
            [sums[0][output], sums[0][output + 1]] = [a, b];
            [sums[1][output], sums[1][output + 1]] = [c, d];
        });
    }
}

/// The products of two pixels and two outputs, `[pixel][output]`. In assembly since the compiler begins with all multiplications of a
/// tile, and has no registers left then.
#[inline(always)]
fn two_by_two<const HALF: bool>(
    [mut a, mut b, mut c, mut d]: [int32x4_t; 4],
    [x, y]: [int8x16_t; PAIR],
    [v, w]: [int8x16_t; 2],
) -> [int32x4_t; 4] {
    macro_rules! products {
        ($($more:literal),*) => {
            // SAFETY: it touches nothing but these registers; every aarch64 has NEON.
            unsafe {
                asm!(
                    "smull {e:v}.8h, {x:v}.8b, {v:v}.8b",
                    "smull {f:v}.8h, {x:v}.8b, {w:v}.8b",
                    "smull {g:v}.8h, {y:v}.8b, {v:v}.8b",
                    "smull {h:v}.8h, {y:v}.8b, {w:v}.8b",
                    $($more,)*
                    "sadalp {a:v}.4s, {e:v}.8h",
                    "sadalp {b:v}.4s, {f:v}.8h",
                    "sadalp {c:v}.4s, {g:v}.8h",
                    "sadalp {d:v}.4s, {h:v}.8h",
                    a = inout(vreg) a, b = inout(vreg) b, c = inout(vreg) c, d = inout(vreg) d,
                    x = in(vreg) x, y = in(vreg) y, v = in(vreg) v, w = in(vreg) w,
                    e = out(vreg) _, f = out(vreg) _, g = out(vreg) _, h = out(vreg) _,
                    options(pure, nomem, nostack, preserves_flags),
                );
            }
        };
    }
    if HALF {
        products!();
    } else {
        products!(
            "smlal2 {e:v}.8h, {x:v}.16b, {v:v}.16b",
            "smlal2 {f:v}.8h, {x:v}.16b, {w:v}.16b",
            "smlal2 {g:v}.8h, {y:v}.16b, {v:v}.16b",
            "smlal2 {h:v}.8h, {y:v}.16b, {w:v}.16b"
        );
    }
    [a, b, c, d]
}

kernel!(Plain, "neon");
