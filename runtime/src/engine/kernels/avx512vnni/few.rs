//! Dense convolutions of few outputs that leave as f32.

use std::arch::x86_64::*;

use super::super::few::{FEW, LANE};
use super::super::{Dense, Row};

/// Pixels of a tile: four registers of four.
pub(super) const PIXELS: usize = 16;

/// Up to four outputs: the heads. A register holds four pixels of one output, each as four sums that are
/// added up in the end, instead of sixteen outputs of one pixel of which most do not exist.
///
/// # Safety
/// As [`super::dense_bytes`]; the row passed `Dense::check`; `weights` is what [`Dense::few`] gave for it and [`PIXELS`]; `out` has
/// room for the outputs' rows.
#[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512vnni")]
pub(super) unsafe fn few_floats(
    dense: &Dense,
    weights: &[[i8; LANE]],
    row: &Row<'_>,
    out: *mut f32,
) {
    // SAFETY: passed on; no more outputs have weights of this kind.
    unsafe {
        match dense.outputs {
            1 => few_of::<1>(dense, weights, row, out),
            2 => few_of::<2>(dense, weights, row, out),
            3 => few_of::<3>(dense, weights, row, out),
            _ => few_of::<FEW>(dense, weights, row, out),
        }
    }
}

/// # Safety
/// As [`few_floats`]; there are `OUTPUTS` outputs.
#[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512vnni")]
#[inline]
unsafe fn few_of<const OUTPUTS: usize>(
    dense: &Dense,
    all: &[[i8; LANE]],
    row: &Row<'_>,
    out: *mut f32,
) {
    for pixel in (0..row.pixels).step_by(PIXELS) {
        let pixel = pixel.min(row.pixels - PIXELS);
        let mut sums = [[_mm512_setzero_si512(); PIXELS / 4]; OUTPUTS];
        let mut weights = all.as_ptr();
        for offset in row.runs {
            for tap in (0..dense.run).step_by(LANE) {
                let at = row.base + offset + pixel * row.step + tap;
                let mut input = [_mm512_setzero_si512(); PIXELS / 4];
                for (four, input) in input.iter_mut().enumerate() {
                    // SAFETY: the same 16 bytes of the run of four pixels of the row.
                    *input = unsafe {
                        lanes(row.input.as_ptr().add(at + 4 * four * row.step), row.step)
                    };
                }
                for (output, sums) in sums.iter_mut().enumerate() {
                    // SAFETY: each 16 bytes of each run have weights of each output.
                    let of_tap = unsafe { _mm_loadu_si128(weights.add(output).cast()) };
                    let of_tap = _mm512_broadcast_i32x4(of_tap);
                    for (sums, &input) in sums.iter_mut().zip(&input) {
                        *sums = _mm512_dpbusd_epi32(*sums, input, of_tap);
                    }
                }
                // SAFETY: at most to the end of the weights.
                weights = unsafe { weights.add(OUTPUTS) };
            }
        }
        // Lane `4 l + k` of all that is added up is pixel `4 k + l`.
        let by_pixel = _mm512_setr_epi32(0, 4, 8, 12, 1, 5, 9, 13, 2, 6, 10, 14, 3, 7, 11, 15);
        for (output, [a, b, c, d]) in sums.into_iter().enumerate() {
            let ab = _mm512_add_epi32(_mm512_unpacklo_epi32(a, b), _mm512_unpackhi_epi32(a, b));
            let cd = _mm512_add_epi32(_mm512_unpacklo_epi32(c, d), _mm512_unpackhi_epi32(c, d));
            let all =
                _mm512_add_epi32(_mm512_unpacklo_epi64(ab, cd), _mm512_unpackhi_epi64(ab, cd));
            // SAFETY: a start and a factor for each output, and sixteen pixels of its row.
            unsafe {
                let start = _mm512_set1_epi32(*dense.starts.get_unchecked(output));
                let factor = _mm512_set1_ps(*dense.factors.get_unchecked(output));
                let sum = _mm512_permutexvar_epi32(by_pixel, _mm512_add_epi32(all, start));
                let value = _mm512_mul_ps(_mm512_cvtepi32_ps(sum), factor);
                _mm512_storeu_ps(out.add(output * row.pixels + pixel), value);
            }
        }
    }
}

/// Four times 16 bytes, `step` apart.
///
/// # Safety
/// They can be read.
#[target_feature(enable = "avx512f")]
#[inline]
unsafe fn lanes(first: *const u8, step: usize) -> __m512i {
    // SAFETY: passed on.
    unsafe {
        if step == LANE {
            return _mm512_loadu_si512(first.cast());
        }
        let lane = |number: usize| _mm_loadu_si128(first.add(number * step).cast());
        let lanes = _mm512_castsi128_si512(lane(0));
        let lanes = _mm512_inserti32x4::<1>(lanes, lane(1));
        let lanes = _mm512_inserti32x4::<2>(lanes, lane(2));
        _mm512_inserti32x4::<3>(lanes, lane(3))
    }
}
