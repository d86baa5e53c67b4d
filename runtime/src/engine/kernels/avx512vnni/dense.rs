//! Dense convolutions: tiles of some pixels in some blocks of channels, their accumulators in registers.

use std::arch::asm;
use std::arch::x86_64::*;

use super::super::{BLOCK, Dense, Group, Row, ToBytes};
use super::{Limits, few, scaled};

/// Where a tile of a dense convolution starts.
#[derive(Clone, Copy)]
struct Tile<'a> {
    dense: &'a Dense,
    row: &'a Row<'a>,
    /// First output channel.
    lane: usize,
    group: &'a Group,
    /// The group's.
    weights: *const i8,
    pixel: usize,
}

impl Tile<'_> {
    /// Accumulators of `PIXELS` pixels in `BLOCKS` blocks of channels. Four bytes of input are spread once for all `TAPS` pixels that
    /// take them.
    ///
    /// # Safety
    /// The row passed `Dense::check`; `lane`, `group` of `BLOCKS` and `pixel` are such that the tile lies in the row. `TAPS` is 1, or
    /// 3 and [`Group::is_window`].
    #[target_feature(enable = "avx512f,avx512vnni")]
    #[inline]
    unsafe fn sums<const BLOCKS: usize, const PIXELS: usize, const TAPS: usize>(
        &self,
    ) -> [[__m512i; PIXELS]; BLOCKS] {
        let starts = &self.dense.starts;
        let mut sums = [[_mm512_setzero_si512(); PIXELS]; BLOCKS];
        for (block, sums) in sums.iter_mut().enumerate() {
            // SAFETY: there is a start for every lane of every block.
            let start = unsafe {
                _mm512_loadu_si512(starts.as_ptr().add(self.lane + block * BLOCK).cast())
            };
            *sums = [start; PIXELS];
        }
        let Group { counts, places, .. } = self.group;
        let mut place = places.as_ptr();
        let mut weights = self.weights;
        let step = self.row.step;
        let of_tap = self.dense.run / 4 / TAPS;
        let tap = of_tap * BLOCKS * 4 * BLOCK;
        for (offset, &count) in self.row.runs.iter().zip(counts) {
            // SAFETY: the first byte of the run of the tile's first pixel is in the row's input.
            let first = unsafe {
                self.row
                    .input
                    .as_ptr()
                    .add(self.row.base + offset + self.pixel * step)
            };
            let skips = BLOCKS == 1 && TAPS == 1;
            // To look up counts and places is 2 to 3 % of the time of those that leave nothing out.
            let count = if skips { count as usize } else { of_tap };
            let fourth = |number: usize, at: usize| first.wrapping_add(4 * number * step + at);
            // Where the input of every fourth pixel is: all others are a multiple of `step` from there that an address can hold.
            let mut fours: [*const u8; 5] = std::array::from_fn(|number| fourth(number, 0));
            for _ in 0..count {
                if skips {
                    // SAFETY: a group has as many places, within its runs, as the sum of its counts.
                    let at = unsafe { *place } as usize;
                    fours = std::array::from_fn(|number| fourth(number, at));
                    place = place.wrapping_add(1);
                }
                let mut w = [[_mm512_setzero_si512(); BLOCKS]; TAPS];
                for (number, w) in w.iter_mut().enumerate() {
                    for (block, w) in w.iter_mut().enumerate() {
                        // SAFETY: a group has `BLOCKS` vectors of weights for each place.
                        *w = unsafe {
                            _mm512_loadu_si512(weights.add(number * tap + block * 4 * BLOCK).cast())
                        };
                    }
                }
                unrolled!(column in 0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 {
                    if column < PIXELS + TAPS - 1 {
                        // SAFETY: four bytes of a run of a pixel of the row.
                        let quad = unsafe { fours[column / 4].add(column % 4 * step).cast::<i32>().read_unaligned() };
                        let quad = _mm512_set1_epi32(quad);
                        unrolled!(number in 0 1 2 {
                            if number < TAPS && column >= number && column - number < PIXELS {
                                for (sums, w) in sums.iter_mut().zip(&w[number]) {
                                    let sum = &mut sums[column - number];
                                    *sum = _mm512_dpbusd_epi32(*sum, quad, *w);
                                }
                            }
                        });
                        // Empty, but what it may touch stays in order: with all loads before all products, as the compiler would
                        // have it, the sums do not fit into the registers.
                        // SAFETY: no instruction.
                        unsafe {
                            asm!("/* {} */", inout(zmm_reg) sums[0][column.min(PIXELS - 1)], options(nostack, preserves_flags));
                        }
                    }
                });
                if !skips {
                    for four in &mut fours[..(PIXELS + TAPS - 1).div_ceil(4)] {
                        *four = four.wrapping_add(4);
                        // Empty too: the compiler would make each address of the one before, by an instruction each.
                        // SAFETY: no instruction.
                        unsafe {
                            asm!(
                                "/* {} */",
                                inout(reg) * four,
                                options(nostack, preserves_flags)
                            );
                        }
                    }
                }
                weights = weights.wrapping_add(BLOCKS * 4 * BLOCK);
            }
            weights = weights.wrapping_add((TAPS - 1) * tap);
        }
        sums
    }

    /// Writes a tile as bytes. `PIXELS` is 1; or of one block a multiple of four, of two even.
    ///
    /// # Safety
    /// As [`Tile::sums`]; `out` has room for the row.
    #[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512vnni")]
    #[inline]
    unsafe fn bytes<const BLOCKS: usize, const PIXELS: usize, const TAPS: usize>(
        &self,
        limits: Limits,
        out: *mut u8,
        pitch: usize,
    ) {
        // SAFETY: as this function's.
        let sums = unsafe { self.sums::<BLOCKS, PIXELS, TAPS>() };
        // From lanes of four channels of each register to lanes of sixteen channels of one.
        let in_order = _mm512_setr_epi32(0, 4, 8, 12, 1, 5, 9, 13, 2, 6, 10, 14, 3, 7, 11, 15);
        // SAFETY: there is a factor for every lane.
        let factors: [__m512; BLOCKS] = std::array::from_fn(|block| unsafe {
            _mm512_loadu_ps(self.dense.factors.as_ptr().add(self.lane + block * BLOCK))
        });
        let of = |pixel: usize, block: usize| {
            let (pixel, block) = (pixel.min(PIXELS - 1), block.min(BLOCKS - 1));
            scaled(sums[block][pixel], factors[block])
        };
        // Four registers are packed together: stores are few and long.
        for first in (0..PIXELS).step_by(4 / BLOCKS) {
            let four = match BLOCKS {
                1 => [
                    of(first, 0),
                    of(first + 1, 0),
                    of(first + 2, 0),
                    of(first + 3, 0),
                ],
                2 => [
                    of(first, 0),
                    of(first, 1),
                    of(first + 1, 0),
                    of(first + 1, 1),
                ],
                _ => [of(first, 0), of(first, 1), of(first, 2), of(first, 2)],
            };
            let bytes = _mm512_permutexvar_epi32(in_order, limits.pack(four));
            // SAFETY: the pixels' bytes are in `out`.
            unsafe {
                let out = out.add((self.pixel + first) * pitch + self.lane);
                match BLOCKS {
                    1 => {
                        _mm_storeu_si128(out.cast(), _mm512_castsi512_si128(bytes));
                        if PIXELS > 1 {
                            let (second, third) = (
                                _mm512_extracti32x4_epi32::<1>(bytes),
                                _mm512_extracti32x4_epi32::<2>(bytes),
                            );
                            _mm_storeu_si128(out.add(pitch).cast(), second);
                            _mm_storeu_si128(out.add(2 * pitch).cast(), third);
                            _mm_storeu_si128(
                                out.add(3 * pitch).cast(),
                                _mm512_extracti32x4_epi32::<3>(bytes),
                            );
                        }
                    }
                    2 => {
                        _mm256_storeu_si256(out.cast(), _mm512_castsi512_si256(bytes));
                        if PIXELS > 1 {
                            let second = _mm512_extracti64x4_epi64::<1>(bytes);
                            _mm256_storeu_si256(out.add(pitch).cast(), second);
                        }
                    }
                    _ => _mm512_mask_storeu_epi8(out.cast(), u64::MAX >> 16, bytes),
                }
            }
        }
    }

    /// Writes a tile as f32, lane by lane.
    ///
    /// # Safety
    /// As [`Tile::sums`]; `out` has room for the row.
    #[target_feature(enable = "avx512f,avx512vl,avx512vnni")]
    #[inline]
    unsafe fn floats<const BLOCKS: usize, const PIXELS: usize, const TAPS: usize>(
        &self,
        out: *mut f32,
    ) {
        // SAFETY: as this function's.
        let sums = unsafe { self.sums::<BLOCKS, PIXELS, TAPS>() };
        let pixels = self.row.pixels;
        for (block, sums) in sums.iter().enumerate() {
            let lane = self.lane + block * BLOCK;
            let outputs = self.dense.outputs.saturating_sub(lane).min(BLOCK);
            // SAFETY: there is a factor for every lane; each lane's pixels are in `out`.
            unsafe {
                let factors = _mm512_loadu_ps(self.dense.factors.as_ptr().add(lane));
                let out = out.add(lane * pixels + self.pixel);
                let of = |pixel: usize| {
                    _mm512_mul_ps(_mm512_cvtepi32_ps(sums[pixel.min(PIXELS - 1)]), factors)
                };
                // From sixteen lanes of four pixels to four pixels of sixteen lanes: 128-bit lane `l` of `four[k]` is lane
                // `4 l + k`.
                let four = |first: usize| {
                    let (a, b) = (of(first), of(first + 1));
                    let (c, d) = (of(first + 2), of(first + 3));
                    let (ab, ab2) = (_mm512_unpacklo_ps(a, b), _mm512_unpackhi_ps(a, b));
                    let (cd, cd2) = (_mm512_unpacklo_ps(c, d), _mm512_unpackhi_ps(c, d));
                    [
                        _mm512_shuffle_ps::<0b01_00_01_00>(ab, cd),
                        _mm512_shuffle_ps::<0b11_10_11_10>(ab, cd),
                        _mm512_shuffle_ps::<0b01_00_01_00>(ab2, cd2),
                        _mm512_shuffle_ps::<0b11_10_11_10>(ab2, cd2),
                    ]
                };
                // Fours of lanes `k`, `4 + k`, `8 + k`, `12 + k` of as many pixels as a register holds.
                let fours = [four(0), four(4), four(8), four(12)];
                unrolled!(k in 0 1 2 3 {
                    let (a, b) = (fours[0][k], fours[1][k]);
                    let (c, d) = (fours[2][k], fours[3][k]);
                    let (ab, ab2) = (
                        _mm512_shuffle_f32x4::<0b01_00_01_00>(a, b),
                        _mm512_shuffle_f32x4::<0b11_10_11_10>(a, b),
                    );
                    let (cd, cd2) = (
                        _mm512_shuffle_f32x4::<0b01_00_01_00>(c, d),
                        _mm512_shuffle_f32x4::<0b11_10_11_10>(c, d),
                    );
                    let lanes = [
                        _mm512_shuffle_f32x4::<0b10_00_10_00>(ab, cd),
                        _mm512_shuffle_f32x4::<0b11_01_11_01>(ab, cd),
                        _mm512_shuffle_f32x4::<0b10_00_10_00>(ab2, cd2),
                        _mm512_shuffle_f32x4::<0b11_01_11_01>(ab2, cd2),
                    ];
                    let mask = u16::MAX >> (16 - PIXELS);
                    unrolled!(l in 0 1 2 3 {
                        if 4 * l + k < outputs {
                            _mm512_mask_storeu_ps(out.add((4 * l + k) * pixels), mask, lanes[l]);
                        }
                    });
                });
            }
        }
    }
}

/// Covers a row with tiles of `$most` pixels, of `$window` where three taps of each share what is loaded, then of four (the last one
/// moved back onto pixels already done), or, in a row shorter than that, of one.
macro_rules! tiles {
    ($tile:ident, $blocks:literal, $most:literal, $window:literal, $method:ident($($argument:expr),*)) => {{
        let pixels = $tile.row.pixels;
        let mut pixel = 0;
        if $tile.group.is_window($tile.dense, $tile.row.step) {
            while pixel + $window <= pixels {
                $tile.pixel = pixel;
                $tile.$method::<$blocks, $window, 3>($($argument),*);
                pixel += $window;
            }
        }
        while pixel + $most <= pixels {
            $tile.pixel = pixel;
            $tile.$method::<$blocks, $most, 1>($($argument),*);
            pixel += $most;
        }
        while pixel < pixels && pixels >= 4 {
            $tile.pixel = pixel.min(pixels - 4);
            $tile.$method::<$blocks, 4, 1>($($argument),*);
            pixel += 4;
        }
        while pixel < pixels {
            $tile.pixel = pixel;
            $tile.$method::<$blocks, 1, 1>($($argument),*);
            pixel += 1;
        }
    }};
}

/// Covers all channels of a row; of two and of three blocks with tiles of `$most` pixels, of three in windows of `$window`.
macro_rules! channels {
    ($dense:ident, $row:ident, $most:literal, $window:literal, $method:ident($($argument:expr),*)) => {{
        let mut lane = 0;
        for group in &$dense.groups {
            let mut tile = Tile { dense: $dense, row: $row, lane, group, weights: $dense.weights[group.weights..].as_ptr(), pixel: 0 };
            // SAFETY: `Dense::check` held; `Dense::new` packed as many starts, factors and weights as the groups have;
            // the caller of this function checked that `out` has room.
            unsafe {
                match group.blocks {
                    1 => tiles!(tile, 1, 16, 16, $method($($argument),*)),
                    2 => tiles!(tile, 2, $most, $most, $method($($argument),*)),
                    _ => tiles!(tile, 3, $most, $window, $method($($argument),*)),
                }
            }
            lane += group.blocks * BLOCK;
        }
    }};
}

/// # Safety
/// The processor has AVX-512 F, BW, VL and VNNI.
#[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512vnni")]
pub(in super::super) unsafe fn dense_bytes(
    dense: &Dense,
    row: &Row<'_>,
    to: &ToBytes,
    out: &mut [u8],
    pitch: usize,
) {
    let limits = Limits::new(to);
    let out = out.as_mut_ptr();
    channels!(dense, row, 8, 6, bytes(limits, out, pitch));
}

/// # Safety
/// As [`dense_bytes`].
#[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512vnni")]
pub(in super::super) unsafe fn dense_floats(dense: &Dense, row: &Row<'_>, out: &mut [f32]) {
    let out = out.as_mut_ptr();
    if let Some(weights) = dense.few(row, few::PIXELS) {
        // SAFETY: passed on; one block has all outputs, and no other lane is written.
        return unsafe { few::few_floats(dense, weights, row, out) };
    }
    // Rarely more than one block: not worth the code of larger tiles.
    channels!(dense, row, 4, 4, floats(out));
}
