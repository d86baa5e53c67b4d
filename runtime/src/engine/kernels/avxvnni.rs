//! VNNI in 256 bits: AVX2's kernels, with `vpdpbusd` in the convolutions. It multiplies 32 bytes by 32 weights and adds them
//! exactly, four by four, to 8 lanes.
//!
//! The instruction has two encodings: AVX-VNNI's (client processors, and server ones from Sapphire Rapids on) and AVX-512's, which is here
//! for tests on processors that have no other; they run the kernels of 512 bits.

use std::arch::x86_64::*;

use super::avx2::{self, Limits, Multiply, Tile, scaled};
use super::few::LANE;
use super::{BLOCK, Dense, Depthwise, Group, Row, ToBytes};

pub(super) use avx2::{add, quantize_four};

/// Pixels of a tile: twelve accumulators hide the instruction's latency, and with weights and input fill 16 registers.
const PIXELS: usize = 6;

/// Pixels of a tile of few outputs: four registers of two.
const FEW_PIXELS: usize = 8;
/// Taps that one multiplication takes.
const TAPS: usize = 4;
/// Channels of a register.
const WIDE: usize = 32;

/// Weights of a depthwise convolution: four taps are the four bytes of a lane; those that the last quad lacks weigh nothing.
///
/// Unpacking four taps of 32 channels byte by byte leaves, in register `j` and 128-bit lane `l`, the channels `16 l + 4 j` to
/// `+ 3`; weights, starts and factors come in that order, and packing the results undoes it. Where only 16 channels are left
/// they come twice, for two pixels at once.
#[derive(Clone, Debug, Default)]
pub(super) struct TapQuads {
    /// `[32 channels][quad][register]`.
    weights: Vec<Lanes<[i8; TAPS]>>,
    /// `[32 channels][register]`.
    starts: Vec<Lanes<i32>>,
    factors: Vec<Lanes<f32>>,
}

/// A register in memory.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(32))]
struct Lanes<T>([T; 8]);

impl TapQuads {
    pub(super) fn new(depthwise: &Depthwise) -> Self {
        let pitch = depthwise.pitch;
        let taps = depthwise.rows * depthwise.columns;
        let mut packed = Self::default();
        for first in (0..pitch).step_by(WIDE) {
            let width = WIDE.min(pitch - first);
            let channels: [[usize; 8]; 4] = std::array::from_fn(|register| {
                let order = |lane: usize| lane / 4 * 16 + 4 * register + lane % 4;
                std::array::from_fn(|lane| first + order(lane) % width)
            });
            for quad in 0..taps.div_ceil(TAPS) {
                let weight = |channel: usize, byte: usize| match TAPS * quad + byte {
                    tap if tap < taps => depthwise.weights[tap * pitch + channel],
                    _ => 0,
                };
                packed.weights.extend(channels.map(|channels| {
                    Lanes(channels.map(|channel| std::array::from_fn(|byte| weight(channel, byte))))
                }));
            }
            let starts = channels.map(|channels| Lanes(channels.map(|c| depthwise.starts[c])));
            packed.starts.extend(starts);
            let factors = channels.map(|channels| Lanes(channels.map(|c| depthwise.factors[c])));
            packed.factors.extend(factors);
        }
        packed
    }
}

/// A tap of 32 channels, or of 16 of two pixels.
///
/// # Safety
/// Both pixels' channels lie in memory.
#[target_feature(enable = "avx2")]
#[inline]
unsafe fn tap<const PIXELS: usize>(pixels: [*const u8; 2]) -> __m256i {
    // SAFETY: as this function's.
    unsafe {
        if PIXELS == 1 {
            _mm256_loadu_si256(pixels[0].cast())
        } else {
            _mm256_loadu2_m128i(pixels[1].cast(), pixels[0].cast())
        }
    }
}

/// Four registers of 32 bytes, byte by byte in turns: of each 128-bit lane the first, second, third and fourth four.
#[target_feature(enable = "avx2")]
#[inline]
fn interleaved([a, b, c, d]: [__m256i; TAPS]) -> [__m256i; 4] {
    let (ab, ab2) = (_mm256_unpacklo_epi8(a, b), _mm256_unpackhi_epi8(a, b));
    let (cd, cd2) = (_mm256_unpacklo_epi8(c, d), _mm256_unpackhi_epi8(c, d));
    [
        _mm256_unpacklo_epi16(ab, cd),
        _mm256_unpackhi_epi16(ab, cd),
        _mm256_unpacklo_epi16(ab2, cd2),
        _mm256_unpackhi_epi16(ab2, cd2),
    ]
}

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
                    let Group { counts, places, .. } = tile.group;
                    let mut place = places.as_ptr();
                    let mut weights = tile.dense.weights[tile.group.weights..].as_ptr();
                    // SAFETY: as this function's.
                    let mut sums = [unsafe { tile.starts() }; COUNT];
                    for (&run, &count) in tile.row.runs.iter().zip(counts) {
                        // SAFETY: as this function's.
                        let first = unsafe { tile.input(run) };
                        for _ in 0..count {
                            // SAFETY: a block has as many places, within its runs, as vectors of 64 weights: the sum of its counts.
                            let (input, halves) = unsafe {
                                (
                                    first.add(*place as usize),
                                    [weights, weights.add(32)]
                                        .map(|at| _mm256_loadu_si256(at.cast())),
                                )
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
                            (place, weights) =
                                (place.wrapping_add(1), weights.wrapping_add(4 * BLOCK));
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
                // SAFETY: as this function's; the weights of few outputs are of this row's convolution.
                unsafe {
                    let Some(all) = packed.few(row, FEW_PIXELS) else {
                        return avx2::floats::<Encoding, PIXELS>(packed, row, out);
                    };
                    for output in 0..packed.outputs {
                        few(packed, all, output, row, out);
                    }
                }
            }

            /// One of few outputs: a register holds two pixels, each as four sums that are added up in the end.
            ///
            /// # Safety
            /// As [`dense_bytes`]; there is such an output, and `all` is what [`Dense::few`] gave for the row and [`FEW_PIXELS`].
            #[target_feature(enable = $features)]
            unsafe fn few(
                packed: &Dense,
                all: &[[i8; LANE]],
                output: usize,
                row: &Row<'_>,
                out: &mut [f32],
            ) {
                let in_order = _mm256_setr_epi32(0, 4, 1, 5, 2, 6, 3, 7);
                for pixel in (0..row.pixels).step_by(FEW_PIXELS) {
                    let pixel = pixel.min(row.pixels - FEW_PIXELS);
                    let mut sums = [_mm256_setzero_si256(); FEW_PIXELS / 2];
                    let mut weights = all.as_ptr().wrapping_add(output);
                    for offset in row.runs {
                        for tap in (0..packed.run).step_by(LANE) {
                            // SAFETY: each 16 bytes of each run have weights of each output.
                            let of_tap = unsafe { _mm_loadu_si128(weights.cast()) };
                            let of_tap = _mm256_broadcastsi128_si256(of_tap);
                            let at = row.base + offset + pixel * row.step + tap;
                            for (two, sums) in sums.iter_mut().enumerate() {
                                // SAFETY: the same 16 bytes of the run of two pixels of the row.
                                let input = unsafe {
                                    let one = row.input.as_ptr().add(at + 2 * two * row.step);
                                    _mm256_loadu2_m128i(one.add(row.step).cast(), one.cast())
                                };
                                *sums = $multiply(*sums, input, of_tap);
                            }
                            weights = weights.wrapping_add(packed.outputs);
                        }
                    }
                    // The even pixels, then the odd ones.
                    let [a, b, c, d] = sums;
                    let all = _mm256_hadd_epi32(_mm256_hadd_epi32(a, b), _mm256_hadd_epi32(c, d));
                    // SAFETY: a start and a factor for each output, and eight pixels of its row.
                    unsafe {
                        let start = _mm256_set1_epi32(*packed.starts.get_unchecked(output));
                        let factor = _mm256_set1_ps(*packed.factors.get_unchecked(output));
                        let sum =
                            _mm256_add_epi32(_mm256_permutevar8x32_epi32(all, in_order), start);
                        let value = _mm256_mul_ps(_mm256_cvtepi32_ps(sum), factor);
                        let out = out.as_mut_ptr().add(output * row.pixels + pixel);
                        _mm256_storeu_ps(out, value);
                    }
                }
            }

            /// # Safety
            /// The processor has the encoding, and the row passed `Depthwise::check` with `out`.
            #[target_feature(enable = $features)]
            pub(super) unsafe fn depthwise(
                packed: &Depthwise,
                row: &Row<'_>,
                to: &ToBytes,
                out: &mut [u8],
            ) {
                let limits = Limits::new(to);
                for (number, channel) in (0..packed.pitch).step_by(WIDE).enumerate() {
                    // SAFETY: as this function's; the pitch is a multiple of 16, and has that many channels from there on.
                    unsafe {
                        if channel + WIDE <= packed.pitch {
                            strip::<1>(packed, row, limits, [number, channel], out);
                        } else {
                            strip::<2>(packed, row, limits, [number, channel], out);
                        }
                    }
                }
            }

            /// The strip of 32 channels of this number, from `channel` on; or the last 16, `PIXELS` being 2.
            ///
            /// # Safety
            /// As [`depthwise`]; the pitch has these channels.
            #[target_feature(enable = $features)]
            #[inline]
            unsafe fn strip<const PIXELS: usize>(
                packed: &Depthwise,
                row: &Row<'_>,
                limits: Limits,
                [number, channel]: [usize; 2],
                out: &mut [u8],
            ) {
                let TapQuads {
                    weights,
                    starts,
                    factors,
                } = &packed.tap_quads;
                let quads = row.runs.len().div_ceil(TAPS);
                // SAFETY: `TapQuads::new` packed four vectors of starts and factors for every strip, and as many of weights for
                // each quad of its taps, of which the row has as many.
                let (weights, starts, factors) = unsafe {
                    (
                        weights.as_ptr().add(4 * quads * number),
                        starts.as_ptr().add(4 * number),
                        factors.as_ptr().add(4 * number),
                    )
                };
                // SAFETY: one of four vectors, where a vector may be.
                let start = |j: usize| unsafe { _mm256_load_si256(starts.add(j).cast()) };
                // SAFETY: as above.
                let factor = |j: usize| unsafe { _mm256_load_ps(factors.add(j).cast()) };
                let starts: [__m256i; 4] = std::array::from_fn(start);
                let factors: [__m256; 4] = std::array::from_fn(factor);
                for pixel in (0..row.pixels).step_by(PIXELS) {
                    let pixels = [pixel, (pixel + PIXELS - 1).min(row.pixels - 1)];
                    // SAFETY: taps of the row's pixels lie in its input.
                    let at = pixels.map(|pixel| unsafe {
                        row.input
                            .as_ptr()
                            .add(row.base + pixel * row.step + channel)
                    });
                    let mut sums = starts;
                    for (quad, runs) in row.runs.chunks(TAPS).enumerate() {
                        let four = std::array::from_fn(|number| {
                            let run = runs[number.min(runs.len() - 1)];
                            // SAFETY: as above.
                            unsafe { tap::<PIXELS>(at.map(|at| at.add(run))) }
                        });
                        for (j, (sum, bytes)) in sums.iter_mut().zip(interleaved(four)).enumerate()
                        {
                            let at = weights.wrapping_add(4 * quad + j);
                            // SAFETY: a vector of weights for each register of each quad.
                            let of_quad = unsafe { _mm256_load_si256(at.cast()) };
                            *sum = $multiply(*sum, bytes, of_quad);
                        }
                    }
                    for (sum, factors) in sums.iter_mut().zip(factors) {
                        *sum = scaled(*sum, factors);
                    }
                    let bytes = limits.pack_four(sums);
                    // SAFETY: `out` has room for each pixel's channels.
                    unsafe {
                        let [one, other] = pixels
                            .map(|pixel| out.as_mut_ptr().add(pixel * packed.pitch + channel));
                        if PIXELS == 1 {
                            _mm256_storeu_si256(one.cast(), bytes);
                        } else {
                            _mm256_storeu2_m128i(other.cast(), one.cast(), bytes);
                        }
                    }
                }
            }
        }
    };
}

encoding!(vex, "avx2,avxvnni", _mm256_dpbusd_avx_epi32);
#[cfg(test)]
encoding!(evex, "avx2,avx512vl,avx512vnni", _mm256_dpbusd_epi32);

/// Calls a kernel in AVX-VNNI's encoding; in tests in AVX-512's, where the processor has only that.
macro_rules! encoded {
    ($function:ident($($argument:expr),*)) => {{
        #[cfg(test)]
        if !std::arch::is_x86_feature_detected!("avxvnni") {
            // SAFETY: passed on; `Kernel::is_supported` found this encoding.
            return unsafe { evex::$function($($argument),*) };
        }
        // SAFETY: passed on.
        unsafe { vex::$function($($argument),*) }
    }};
}

/// # Safety
/// The processor has AVX2 and the encoding; the row passed `Dense::check`, and `out` has room for it.
pub(super) unsafe fn dense_bytes(
    packed: &Dense,
    row: &Row<'_>,
    to: &ToBytes,
    out: &mut [u8],
    pitch: usize,
) {
    encoded!(dense_bytes(packed, row, to, out, pitch));
}

/// # Safety
/// As [`dense_bytes`].
pub(super) unsafe fn dense_floats(packed: &Dense, row: &Row<'_>, out: &mut [f32]) {
    encoded!(dense_floats(packed, row, out));
}

/// # Safety
/// The processor has AVX2 and the encoding; the row passed `Depthwise::check` with `out`.
pub(super) unsafe fn depthwise(packed: &Depthwise, row: &Row<'_>, to: &ToBytes, out: &mut [u8]) {
    encoded!(depthwise(packed, row, to, out));
}
