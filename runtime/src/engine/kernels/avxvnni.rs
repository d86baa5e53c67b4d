//! VNNI in 256 bits: AVX2's kernels, with `vpdpbusd` in the dense ones. It multiplies 32 bytes by 32 weights and adds them
//! exactly, four by four, to 8 lanes.
//!
//! Two encodings of one instruction: AVX-VNNI's (client processors, and server ones from Sapphire Rapids on) and
//! AVX-512's.

use std::arch::x86_64::*;

use super::avx2::{self, Multiply, Tile};
use super::{Dense, Row, ToBytes};

pub(super) use avx2::{add, depthwise, quantize_four};

/// Pixels of a tile: twelve accumulators hide the instruction's latency, and with weights and input fill 16 registers.
const PIXELS: usize = 6;

macro_rules! encoding {
    ($name:ident, $features:literal, $multiply:ident) => {
        mod $name {
            use super::*;

            struct Encoding;

            impl Multiply for Encoding {
                #[target_feature(enable = $features)]
                #[inline]
                unsafe fn sums<const COUNT: usize>(tile: Tile<'_>) -> [[__m256i; 2]; COUNT] {
                    let step = tile.row.step;
                    let mut weights = tile.weights;
                    // SAFETY: as this function's.
                    let mut sums = [unsafe { tile.starts() }; COUNT];
                    for &run in tile.row.runs {
                        // SAFETY: as this function's.
                        let mut input = unsafe { tile.input(run) };
                        for _ in 0..tile.dense.run / 4 {
                            // SAFETY: a block has `runs * run / 4` vectors of 64 weights.
                            let halves = unsafe {
                                [weights, weights.add(32)].map(|at| _mm256_loadu_si256(at.cast()))
                            };
                            for (number, sums) in sums.iter_mut().enumerate() {
                                // SAFETY: four bytes of a run of a pixel of the row.
                                let quad = unsafe {
                                    input.add(number * step).cast::<i32>().read_unaligned()
                                };
                                let quad = _mm256_set1_epi32(quad);
                                for (sum, weights) in sums.iter_mut().zip(halves) {
                                    *sum = $multiply(*sum, quad, weights);
                                }
                            }
                            input = input.wrapping_add(4);
                            weights = weights.wrapping_add(tile.next_weights);
                        }
                    }
                    sums
                }
            }

            /// # Safety
            /// The processor has the encoding, the row passed `Dense::check`, and `out` has room for it.
            #[target_feature(enable = $features)]
            pub(super) unsafe fn dense_bytes(
                packed: &Dense,
                row: &Row<'_>,
                to: &ToBytes,
                out: &mut [u8],
                pitch: usize,
            ) {
                // SAFETY: as this function's.
                unsafe { avx2::bytes::<Encoding, PIXELS>(packed, row, to, out, pitch) }
            }

            /// # Safety
            /// As [`dense_bytes`].
            #[target_feature(enable = $features)]
            pub(super) unsafe fn dense_floats(packed: &Dense, row: &Row<'_>, out: &mut [f32]) {
                // SAFETY: as this function's.
                unsafe { avx2::floats::<Encoding, PIXELS>(packed, row, out) }
            }
        }
    };
}

encoding!(vex, "avx2,avxvnni", _mm256_dpbusd_avx_epi32);
encoding!(evex, "avx2,avx512vl,avx512vnni", _mm256_dpbusd_epi32);

/// # Safety
/// The processor has AVX2 and one of the encodings; the row passed `Dense::check`, and `out` has room for it.
pub(super) unsafe fn dense_bytes(
    packed: &Dense,
    row: &Row<'_>,
    to: &ToBytes,
    out: &mut [u8],
    pitch: usize,
) {
    // SAFETY: the processor has been asked; the rest is as this function's.
    unsafe {
        if std::arch::is_x86_feature_detected!("avxvnni") {
            vex::dense_bytes(packed, row, to, out, pitch);
        } else {
            evex::dense_bytes(packed, row, to, out, pitch);
        }
    }
}

/// # Safety
/// As [`dense_bytes`].
pub(super) unsafe fn dense_floats(packed: &Dense, row: &Row<'_>, out: &mut [f32]) {
    // SAFETY: as above.
    unsafe {
        if std::arch::is_x86_feature_detected!("avxvnni") {
            vex::dense_floats(packed, row, out);
        } else {
            evex::dense_floats(packed, row, out);
        }
    }
}
