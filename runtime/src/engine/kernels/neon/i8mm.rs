//! `usmmla`: eight bytes of two pixels against eight weights of two channels, 32 products in an instruction.

use std::arch::aarch64::*;
use std::arch::asm;

use super::{Multiply, Tile, kernel, quad};
use crate::engine::kernels::{BLOCK, Dense, Depthwise, Row, ToBytes};

struct I8mm;

/// Adds the products of two pixels and two channels: `[pixel][channel]`. The intrinsic (`vusmmlaq_s32`) is not stable yet.
#[target_feature(enable = "neon,i8mm")]
#[inline]
fn usmmla(sums: int32x4_t, pixels: uint8x16_t, channels: int8x16_t) -> int32x4_t {
    let mut sums = sums;
    // SAFETY: it touches nothing but these registers, and the processor has it.
    unsafe {
        asm!("usmmla {0:v}.4s, {1:v}.16b, {2:v}.16b",
            inout(vreg) sums, in(vreg) pixels, in(vreg) channels,
            options(pure, nomem, nostack, preserves_flags));
    }
    sums
}

/// The first halves of two registers, and the second ones.
#[target_feature(enable = "neon")]
#[inline]
fn halves(one: int32x4_t, other: int32x4_t) -> [int32x4_t; 2] {
    let (one, other) = (vreinterpretq_s64_s32(one), vreinterpretq_s64_s32(other));
    [
        vreinterpretq_s32_s64(vzip1q_s64(one, other)),
        vreinterpretq_s32_s64(vzip2q_s64(one, other)),
    ]
}

/// Pairs of pixels of a tile.
const PAIRS: usize = super::PIXELS / 2;

impl Multiply for I8mm {
    const DOT: bool = true;

    #[inline(always)]
    unsafe fn sums<const COUNT: usize>(tile: Tile<'_>) -> [[int32x4_t; 4]; COUNT] {
        // SAFETY: as this function's, and every aarch64 has NEON: a block has as many vectors of 128 weights as its runs have eights, and
        // what is read of two pixels is eight bytes of their runs, or the last four.
        unsafe {
            const { assert!(COUNT == 1 || COUNT == 2 * PAIRS) }
            let (run, step) = (tile.dense.run, tile.row.step);
            let (mut weights, starts) = (tile.weights, tile.starts());
            // A single pixel is a pair with itself.
            let pairs = COUNT.div_ceil(2);
            let second = COUNT.min(2) - 1;
            let mut sums = [[vdupq_n_s32(0); 8]; PAIRS];
            for sums in &mut sums {
                for (quarter, start) in starts.into_iter().enumerate() {
                    [sums[2 * quarter], sums[2 * quarter + 1]] = halves(start, start);
                }
            }
            let mut input = [vdupq_n_u8(0); PAIRS];
            // Eight bytes of the run.
            macro_rules! eight {
                () => {
                    for channels in 0..8 {
                        let lanes = vld1q_s8(weights.add(channels * 16));
                        for (sums, &input) in sums.iter_mut().zip(&input).take(pairs) {
                            sums[channels] = usmmla(sums[channels], input, lanes);
                        }
                    }
                    weights = weights.wrapping_add(8 * BLOCK);
                };
            }
            for &offset in tile.row.runs {
                let first = tile.input(offset);
                for at in (0..run / 8 * 8).step_by(8) {
                    for (pair, input) in input.iter_mut().enumerate().take(pairs) {
                        *input = {
                            let at = first.add(2 * pair * step + at);
                            vcombine_u8(vld1_u8(at), vld1_u8(at.add(second * step)))
                        };
                    }
                    eight!();
                }
                if run % 8 == 4 {
                    for (pair, input) in input.iter_mut().enumerate().take(pairs) {
                        *input = {
                            let at = first.add(2 * pair * step + run - 4);
                            vcombine_u8(quad(at), quad(at.add(second * step)))
                        };
                    }
                    eight!();
                }
            }
            let mut lanes = [starts; COUNT];
            for (pixel, lanes) in lanes.iter_mut().enumerate() {
                for (quarter, lanes) in lanes.iter_mut().enumerate() {
                    let sums = &sums[pixel / 2];
                    *lanes = halves(sums[2 * quarter], sums[2 * quarter + 1])[pixel % 2];
                }
            }
            lanes
        }
    }

    #[target_feature(enable = "neon,i8mm")]
    #[inline]
    unsafe fn products(sums: int32x4_t, input: uint8x16_t, weights: int8x16_t) -> int32x4_t {
        let mut sums = sums;
        // SAFETY: it touches nothing but these registers, and the processor has it. The intrinsic (`vusdotq_s32`) is not stable yet.
        unsafe {
            asm!("usdot {0:v}.4s, {1:v}.16b, {2:v}.16b",
                inout(vreg) sums, in(vreg) input, in(vreg) weights,
                options(pure, nomem, nostack, preserves_flags));
        }
        sums
    }
}

kernel!(I8mm, "neon,i8mm");
