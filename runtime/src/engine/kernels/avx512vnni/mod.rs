//! AVX-512 with VNNI: `vpdpbusd` multiplies 64 bytes by 64 weights and adds them, four by four, to 16 lanes.
//!
//! Nothing here saturates before the end: `vpdpbusd` adds exactly, [`Convolution::fit_32_bits`] keeps the lanes and the
//! rounded results in range, and rounding is `vcvtps2dq` with ties to even. Packing to bytes saturates as it should.
//!
//! [`Convolution::fit_32_bits`]: crate::engine::layer::Convolution::fit_32_bits

use std::arch::x86_64::*;

use super::{Addition, Part, ToBytes, portable};

mod dense;
mod depthwise;
mod few;

pub(super) use dense::{dense_bytes, dense_floats};
pub(super) use depthwise::{Interleaved, depthwise};

const NEAREST: i32 = _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC;

/// Zero point and bounds of the output in every lane.
#[derive(Clone, Copy)]
struct Limits {
    zero: __m512i,
    low: __m512i,
    high: __m512i,
    /// Whether the zero point is 0 and no byte is out of bounds, as after most clipped layers.
    plain: bool,
}

impl Limits {
    #[target_feature(enable = "avx512f,avx512bw")]
    fn new(to: &ToBytes) -> Self {
        Self {
            zero: _mm512_set1_epi16(i16::from(to.zero)),
            low: _mm512_set1_epi8(*to.range.start() as i8),
            high: _mm512_set1_epi8(*to.range.end() as i8),
            plain: to.zero == 0 && to.range == (0..=u8::MAX),
        }
    }

    /// Four registers of rounded results as bytes; 128-bit lane by lane, the first's four, the second's four and so on.
    #[target_feature(enable = "avx512f,avx512bw")]
    #[inline]
    fn pack(&self, v: [__m512i; 4]) -> __m512i {
        self.pack_all([v])[0]
    }

    /// The same of several fours, with one branch: the compiler computes what stands before a branch that needs it, and
    /// with one for each four it would keep all inputs of the later ones in memory until then.
    #[target_feature(enable = "avx512f,avx512bw")]
    #[inline]
    fn pack_all<const FOURS: usize>(&self, fours: [[__m512i; 4]; FOURS]) -> [__m512i; FOURS] {
        let mut words = [[_mm512_setzero_si512(); 2]; FOURS];
        for (words, four) in words.iter_mut().zip(&fours) {
            words[0] = _mm512_packs_epi32(four[0], four[1]);
            words[1] = _mm512_packs_epi32(four[2], four[3]);
        }
        let mut bytes = [_mm512_setzero_si512(); FOURS];
        if self.plain {
            for (bytes, words) in bytes.iter_mut().zip(&words) {
                *bytes = _mm512_packus_epi16(words[0], words[1]);
            }
        } else {
            for (bytes, words) in bytes.iter_mut().zip(&words) {
                let one = _mm512_adds_epi16(words[0], self.zero);
                let both = _mm512_packus_epi16(one, _mm512_adds_epi16(words[1], self.zero));
                *bytes = _mm512_min_epu8(_mm512_max_epu8(both, self.low), self.high);
            }
        }
        bytes
    }
}

/// Accumulators as rounded results.
#[target_feature(enable = "avx512f")]
#[inline]
fn scaled(sums: __m512i, factors: __m512) -> __m512i {
    _mm512_cvt_roundps_epi32::<NEAREST>(_mm512_mul_ps(_mm512_cvtepi32_ps(sums), factors))
}

/// # Safety
/// As [`dense_bytes`]; the three slices are of one length.
#[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512vnni")]
pub(super) unsafe fn add(addition: &Addition, one: &[u8], other: &[u8], out: &mut [u8]) {
    let limits = Limits::new(&addition.to);
    let zeros = addition
        .zeros
        .map(|zero| _mm512_set1_epi32(i32::from(zero)));
    let factors = addition.factors.map(|factor| _mm512_set1_ps(factor));
    // After packing, register j holds the bytes 4 j to 4 j + 3 of each 16.
    let order = _mm512_setr_epi32(0, 4, 8, 12, 1, 5, 9, 13, 2, 6, 10, 14, 3, 7, 11, 15);
    let whole = out.len() / 64 * 64;
    for at in (0..whole).step_by(64) {
        let part = |input: usize, bytes: &[u8], quarter: usize| {
            // SAFETY: 16 of the 64 bytes from `at` on.
            let bytes = unsafe { _mm_loadu_si128(bytes.as_ptr().add(at + 16 * quarter).cast()) };
            let value =
                _mm512_cvtepi32_ps(_mm512_sub_epi32(_mm512_cvtepu8_epi32(bytes), zeros[input]));
            _mm512_mul_ps(value, factors[input])
        };
        let sum = |quarter: usize| {
            let sum = _mm512_add_ps(part(0, one, quarter), part(1, other, quarter));
            _mm512_cvt_roundps_epi32::<NEAREST>(sum)
        };
        let bytes = _mm512_permutexvar_epi32(order, limits.pack([sum(0), sum(1), sum(2), sum(3)]));
        // SAFETY: 64 bytes from `at` on.
        unsafe { _mm512_storeu_si512(out.as_mut_ptr().add(at).cast(), bytes) };
    }
    portable::add(addition, &one[whole..], &other[whole..], &mut out[whole..]);
}

/// # Safety
/// As [`dense_bytes`]; each plane has a fourth of `out`'s length.
#[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512vnni")]
pub(super) unsafe fn quantize_four(planes: &[&[f32]], scale: f32, zero: u8, out: &mut [u8]) {
    let divisor = _mm512_set1_ps(scale);
    // Before the zero point is added; the comparisons also send NaN to the lower bound.
    let (low, high) = (
        _mm512_set1_ps(-f32::from(zero)),
        _mm512_set1_ps(255.0 - f32::from(zero)),
    );
    let zeros = _mm512_set1_epi32(i32::from(zero));
    let whole = out.len() / 64 * 64;
    for at in (0..whole).step_by(64) {
        let mut pixels = _mm512_setzero_si512();
        for channel in (0..4).rev() {
            let bytes = match planes.get(channel) {
                // SAFETY: 16 values from the first of these pixels on.
                Some(plane) => unsafe {
                    let value = _mm512_div_ps(_mm512_loadu_ps(plane.as_ptr().add(at / 4)), divisor);
                    let value = _mm512_min_ps(_mm512_max_ps(value, low), high);
                    _mm512_add_epi32(_mm512_cvt_roundps_epi32::<NEAREST>(value), zeros)
                },
                None => zeros,
            };
            pixels = _mm512_or_si512(_mm512_slli_epi32::<8>(pixels), bytes);
        }
        // SAFETY: 64 bytes from `at` on.
        unsafe { _mm512_storeu_si512(out.as_mut_ptr().add(at).cast(), pixels) };
    }
    let mut rest: [&[f32]; 4] = [&[]; 4];
    for (rest, plane) in rest.iter_mut().zip(planes) {
        *rest = &plane[whole / 4..];
    }
    portable::quantize_four(&rest[..planes.len()], scale, zero, &mut out[whole..]);
}

/// Bytes of `input`'s pixels through a table: as [`portable::place_row`].
///
/// # Safety
/// The processor has AVX-512 F, BW and VBMI; `part` passed its check with these slices.
#[target_feature(enable = "avx512f,avx512bw,avx512vbmi")]
pub(super) unsafe fn place_row(table: &[u8; 256], part: Part, input: &[u8], out: &mut [u8]) {
    // SAFETY: a fourth of the table each.
    let table =
        [0, 64, 128, 192].map(|at| unsafe { _mm512_loadu_si512(table.as_ptr().add(at).cast()) });
    for pixel in 0..part.pixels {
        for channel in (0..part.channels).step_by(64) {
            let mask = u64::MAX >> (64 - 64.min(part.channels - channel));
            // SAFETY: this pixel's channels, as the caller checked; bytes that are masked out are not touched.
            unsafe {
                let at = input.as_ptr().add(pixel * part.pitches[0] + channel);
                let bytes = _mm512_maskz_loadu_epi8(mask, at.cast());
                let low = _mm512_permutex2var_epi8(table[0], bytes, table[1]);
                let high = _mm512_permutex2var_epi8(table[2], bytes, table[3]);
                let bytes = _mm512_mask_blend_epi8(_mm512_movepi8_mask(bytes), low, high);
                let at = pixel * part.pitches[1] + part.first + channel;
                _mm512_mask_storeu_epi8(out.as_mut_ptr().add(at).cast(), mask, bytes);
            }
        }
    }
}
