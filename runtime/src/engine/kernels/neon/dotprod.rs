//! `sdot`: four bytes of input against four weights in each lane, sixteen products in an instruction.
//!
//! It takes signed bytes, so the input is `x - 128`, and the starts hold the rest (see `Dense::new`).

use std::arch::aarch64::*;
use std::arch::asm;

use super::{Multiply, Tile, kernel, quad, signed};
use crate::engine::kernels::{BLOCK, Dense, Depthwise, Row, ToBytes};

struct Dotprod;

/// Adds to each lane the products of its four weights with four bytes of input, number `QUAD`. The intrinsic
/// (`vdotq_laneq_s32`) is not stable yet.
#[target_feature(enable = "neon,dotprod")]
#[inline]
fn sdot<const QUAD: i32>(sums: int32x4_t, weights: int8x16_t, input: int8x16_t) -> int32x4_t {
    let mut sums = sums;
    // SAFETY: it touches nothing but these registers, and the processor has it.
    unsafe {
        asm!("sdot {0:v}.4s, {1:v}.16b, {2:v}.4b[{3}]",
            inout(vreg) sums, in(vreg) weights, in(vreg) input, const QUAD,
            options(pure, nomem, nostack, preserves_flags));
    }
    sums
}

impl Multiply for Dotprod {
    const DOT: bool = true;

    #[inline(always)]
    unsafe fn sums<const COUNT: usize>(tile: Tile<'_>) -> [[int32x4_t; 4]; COUNT] {
        // SAFETY: as this function's, and every aarch64 has NEON: a block has as many vectors of 64 weights as its runs have fours, and
        // what is read of a pixel is sixteen bytes of its run, eight, or the last four.
        unsafe {
            let (run, step) = (tile.dense.run, tile.row.step);
            let (mut weights, mut sums) = (tile.weights, [tile.starts(); COUNT]);
            let signed = |bytes| vreinterpretq_s8_u8(signed(bytes));
            let mut input = [vdupq_n_s8(0); COUNT];
            // Four bytes of the run.
            macro_rules! quad {
                ($number:literal) => {
                    for quarter in 0..4 {
                        let lanes = vld1q_s8(weights.add(quarter * BLOCK));
                        for (sums, &input) in sums.iter_mut().zip(&input) {
                            sums[quarter] = sdot::<$number>(sums[quarter], lanes, input);
                        }
                    }
                    weights = weights.wrapping_add(4 * BLOCK);
                };
            }
            for &offset in tile.row.runs {
                let first = tile.input(offset);
                for at in (0..run / 16 * 16).step_by(16) {
                    for (number, input) in input.iter_mut().enumerate() {
                        *input = signed(vld1q_u8(first.add(number * step + at)));
                    }
                    quad!(0);
                    quad!(1);
                    quad!(2);
                    quad!(3);
                }
                let rest = run / 16 * 16;
                if run % 16 >= 8 {
                    for (number, input) in input.iter_mut().enumerate() {
                        let bytes = vld1_u8(first.add(number * step + rest));
                        *input = signed(vcombine_u8(bytes, bytes));
                    }
                    quad!(0);
                    quad!(1);
                }
                if run % 8 == 4 {
                    for (number, input) in input.iter_mut().enumerate() {
                        let bytes = quad(first.add(number * step + run - 4));
                        *input = signed(vcombine_u8(bytes, bytes));
                    }
                    quad!(0);
                }
            }
            sums
        }
    }

    #[inline(always)]
    fn input(bytes: uint8x16_t) -> uint8x16_t {
        signed(bytes)
    }

    #[target_feature(enable = "neon,dotprod")]
    #[inline]
    unsafe fn products(sums: int32x4_t, input: uint8x16_t, weights: int8x16_t) -> int32x4_t {
        let mut sums = sums;
        // SAFETY: it touches nothing but these registers, and the processor has it. The intrinsic (`vdotq_s32`) is not stable yet.
        unsafe {
            asm!("sdot {0:v}.4s, {1:v}.16b, {2:v}.16b",
                inout(vreg) sums, in(vreg) input, in(vreg) weights,
                options(pure, nomem, nostack, preserves_flags));
        }
        sums
    }
}

kernel!(Dotprod, "neon,dotprod");
