//! `smlal`: bytes and weights widened to 16 bits, a byte of input against four lanes in an instruction.

use std::arch::aarch64::*;

use super::{Multiply, Tile, kernel, quad};
use crate::engine::kernels::{BLOCK, Dense, Row, ToBytes};

struct Plain;

impl Multiply for Plain {
    #[target_feature(enable = "neon")]
    #[inline]
    unsafe fn sums<const COUNT: usize>(tile: Tile<'_>) -> [[int32x4_t; 4]; COUNT] {
        let (run, step) = (tile.dense.run, tile.row.step);
        // SAFETY: as this function's.
        let (mut weights, mut sums) = unsafe { (tile.weights(), [tile.starts(); COUNT]) };
        let mut input = [vdupq_n_s16(0); COUNT];
        // One byte of the run.
        macro_rules! byte {
            ($number:literal) => {
                // SAFETY: a block has as many vectors of sixteen weights as its runs have bytes.
                let lanes = unsafe { vld1q_s8(weights) };
                let (low, high) = (vmovl_s8(vget_low_s8(lanes)), vmovl_high_s8(lanes));
                for (sums, input) in sums.iter_mut().zip(input) {
                    sums[0] = vmlal_laneq_s16::<$number>(sums[0], vget_low_s16(low), input);
                    sums[1] = vmlal_high_laneq_s16::<$number>(sums[1], low, input);
                    sums[2] = vmlal_laneq_s16::<$number>(sums[2], vget_low_s16(high), input);
                    sums[3] = vmlal_high_laneq_s16::<$number>(sums[3], high, input);
                }
                weights = weights.wrapping_add(BLOCK);
            };
        }
        for &offset in tile.row.runs {
            // SAFETY: as this function's.
            let first = unsafe { tile.input(offset) };
            for at in (0..run / 8 * 8).step_by(8) {
                for (number, input) in input.iter_mut().enumerate() {
                    // SAFETY: eight bytes of a run of a pixel of the row.
                    let bytes = unsafe { vld1_u8(first.add(number * step + at)) };
                    *input = vreinterpretq_s16_u16(vmovl_u8(bytes));
                }
                byte!(0);
                byte!(1);
                byte!(2);
                byte!(3);
                byte!(4);
                byte!(5);
                byte!(6);
                byte!(7);
            }
            if run % 8 == 4 {
                for (number, input) in input.iter_mut().enumerate() {
                    // SAFETY: the last four bytes of a run of a pixel of the row.
                    let bytes = unsafe { quad(first.add(number * step + run - 4)) };
                    *input = vreinterpretq_s16_u16(vmovl_u8(bytes));
                }
                byte!(0);
                byte!(1);
                byte!(2);
                byte!(3);
            }
        }
        sums
    }
}

kernel!(Plain, "neon", plain);
