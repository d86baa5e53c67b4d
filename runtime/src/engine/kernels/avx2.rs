//! AVX2: bytes widened to 16 bits, `vpmaddwd` multiplies them in pairs and adds exactly. (`vpmaddubsw`, which takes
//! bytes, saturates in between and would not give the same result.)

use std::arch::x86_64::*;

use super::{Addition, BLOCK, Dense, Depthwise, Group, Row, ToBytes, portable};

/// Pixels of a depthwise tile.
const PIXELS: usize = 4;

/// Zero point and bounds of the output in every lane.
#[derive(Clone, Copy)]
pub(super) struct Limits {
    /// Whether the zero point is 0 and no byte is out of bounds, as after most clipped layers.
    plain: bool,
    zero: __m256i,
    low: __m128i,
    high: __m128i,
}

impl Limits {
    #[target_feature(enable = "avx2")]
    pub(super) fn new(to: &ToBytes) -> Self {
        Self {
            plain: to.zero == 0 && to.range == (0..=u8::MAX),
            zero: _mm256_set1_epi16(i16::from(to.zero)),
            low: _mm_set1_epi8(*to.range.start() as i8),
            high: _mm_set1_epi8(*to.range.end() as i8),
        }
    }

    /// Sixteen rounded results, in order, as bytes.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn pack(&self, results: __m256i) -> __m128i {
        let words = _mm256_adds_epi16(results, self.zero);
        let bytes = _mm256_permute4x64_epi64::<0b1000>(_mm256_packus_epi16(words, words));
        _mm_min_epu8(
            _mm_max_epu8(_mm256_castsi256_si128(bytes), self.low),
            self.high,
        )
    }

    /// Four registers of rounded results as bytes; 128-bit lane by lane, the first's four, the second's four and so on.
    #[target_feature(enable = "avx2")]
    #[inline]
    pub(super) fn pack_four(&self, [a, b, c, d]: [__m256i; 4]) -> __m256i {
        let [one, other] = [_mm256_packs_epi32(a, b), _mm256_packs_epi32(c, d)];
        if self.plain {
            return _mm256_packus_epi16(one, other);
        }
        let [one, other] = [one, other].map(|words| _mm256_adds_epi16(words, self.zero));
        let [low, high] = [self.low, self.high].map(|limit| _mm256_broadcastsi128_si256(limit));
        _mm256_min_epu8(_mm256_max_epu8(_mm256_packus_epi16(one, other), low), high)
    }
}

/// Accumulators as rounded results; the processor's rounding mode is Rust's: to nearest, ties to even.
#[target_feature(enable = "avx2")]
#[inline]
pub(super) fn scaled(sums: __m256i, factors: __m256) -> __m256i {
    _mm256_cvtps_epi32(_mm256_mul_ps(_mm256_cvtepi32_ps(sums), factors))
}

/// A block of channels of some pixels of a dense convolution.
#[derive(Clone, Copy)]
pub(super) struct Tile<'a> {
    pub(super) dense: &'a Dense,
    pub(super) row: &'a Row<'a>,
    /// First output channel.
    lane: usize,
    /// Of this block alone.
    pub(super) group: &'a Group,
    pixel: usize,
}

impl Tile<'_> {
    /// What the block's accumulators start from.
    ///
    /// # Safety
    /// The block is one of the convolution's.
    #[target_feature(enable = "avx2")]
    #[inline]
    pub(super) unsafe fn starts(&self) -> [__m256i; 2] {
        // SAFETY: there is a start for every lane of every block.
        unsafe {
            let at = self.dense.starts.as_ptr().add(self.lane);
            [
                _mm256_loadu_si256(at.cast()),
                _mm256_loadu_si256(at.add(8).cast()),
            ]
        }
    }

    /// The first byte of a run of the tile's first pixel.
    ///
    /// # Safety
    /// The row passed `Dense::check`, and has the pixel; `run` is one of its own.
    #[inline]
    pub(super) unsafe fn input(&self, run: usize) -> *const u8 {
        let Row {
            input, base, step, ..
        } = *self.row;
        // SAFETY: it is in the row's input.
        unsafe { input.as_ptr().add(base + run + self.pixel * step) }
    }
}

/// The instructions that multiply.
pub(super) trait Multiply {
    /// Accumulators of a tile of `COUNT` pixels, eight lanes in a register.
    ///
    /// # Safety
    /// The processor has the instructions, the row passed `Dense::check`, and the tile lies in it.
    unsafe fn sums<const COUNT: usize>(tile: Tile<'_>) -> [[__m256i; 2]; COUNT];
}

struct Avx2;

impl Multiply for Avx2 {
    #[target_feature(enable = "avx2")]
    #[inline]
    unsafe fn sums<const COUNT: usize>(tile: Tile<'_>) -> [[__m256i; 2]; COUNT] {
        let step = tile.row.step;
        let Group { counts, places, .. } = tile.group;
        let mut place = places.as_ptr();
        let mut weights = tile.dense.weights[tile.group.weights..].as_ptr();
        // SAFETY: as this function's.
        let mut sums = [unsafe { tile.starts() }; COUNT];
        let even = _mm256_set1_epi16(0xff);
        for (&run, &count) in tile.row.runs.iter().zip(counts) {
            // SAFETY: as this function's.
            let first = unsafe { tile.input(run) };
            for _ in 0..count {
                // SAFETY: a block has as many places, within its runs, as vectors of 64 weights: the sum of its counts.
                let (input, halves) = unsafe {
                    (
                        first.add(*place as usize),
                        [weights, weights.add(32)].map(|at| _mm256_loadu_si256(at.cast())),
                    )
                };
                let evens = halves.map(|w| _mm256_srai_epi16::<8>(_mm256_slli_epi16::<8>(w)));
                let odds = halves.map(|w| _mm256_srai_epi16::<8>(w));
                for (number, sums) in sums.iter_mut().enumerate() {
                    // SAFETY: four bytes of a run of a pixel of the row.
                    let quad = unsafe { input.add(number * step).cast::<i32>().read_unaligned() };
                    let quad = _mm256_set1_epi32(quad);
                    let (e, o) = (_mm256_and_si256(quad, even), _mm256_srli_epi16::<8>(quad));
                    for half in 0..2 {
                        let products = _mm256_add_epi32(
                            _mm256_madd_epi16(e, evens[half]),
                            _mm256_madd_epi16(o, odds[half]),
                        );
                        sums[half] = _mm256_add_epi32(sums[half], products);
                    }
                }
                (place, weights) = (place.wrapping_add(1), weights.wrapping_add(4 * BLOCK));
            }
        }
        sums
    }
}

/// Where accumulators of a block of channels of some pixels go. A trait and not a closure: closures cannot be
/// `#[inline(always)]`, and what is not inlined has no AVX2, and calls every intrinsic.
trait Store {
    /// # Safety
    /// The processor has AVX2, and this was made for the row and the convolution that `pixel` and `lane` are of: it has a factor for
    /// each lane, and room for each pixel.
    unsafe fn store<const COUNT: usize>(
        &mut self,
        pixel: usize,
        lane: usize,
        sums: [[__m256i; 2]; COUNT],
    );
}

/// As bytes, pixels `pitch` apart.
struct Bytes<'a> {
    factors: &'a [f32],
    limits: Limits,
    out: &'a mut [u8],
    pitch: usize,
}

impl Store for Bytes<'_> {
    #[inline(always)]
    unsafe fn store<const COUNT: usize>(
        &mut self,
        pixel: usize,
        lane: usize,
        sums: [[__m256i; 2]; COUNT],
    ) {
        // SAFETY: this function's conditions.
        unsafe {
            let factors = self.factors.as_ptr().add(lane);
            let factors = [_mm256_loadu_ps(factors), _mm256_loadu_ps(factors.add(8))];
            // From eights of channels to sixteens of two pixels.
            let in_order = _mm256_setr_epi32(0, 4, 1, 5, 2, 6, 3, 7);
            let out = self.out.as_mut_ptr().add(pixel * self.pitch + lane);
            for one in (0..COUNT).step_by(2) {
                let other = (one + 1).min(COUNT - 1);
                let bytes = self.limits.pack_four([
                    scaled(sums[one][0], factors[0]),
                    scaled(sums[one][1], factors[1]),
                    scaled(sums[other][0], factors[0]),
                    scaled(sums[other][1], factors[1]),
                ]);
                let bytes = _mm256_permutevar8x32_epi32(bytes, in_order);
                let at = [one, other].map(|number| out.add(number * self.pitch));
                _mm_storeu_si128(at[0].cast(), _mm256_castsi256_si128(bytes));
                if other > one {
                    _mm_storeu_si128(at[1].cast(), _mm256_extracti128_si256::<1>(bytes));
                }
            }
        }
    }
}

/// As f32, lane after lane; lanes without an output stay as they are.
struct Floats<'a> {
    factors: &'a [f32],
    outputs: usize,
    pixels: usize,
    out: &'a mut [f32],
}

impl Store for Floats<'_> {
    #[inline(always)]
    unsafe fn store<const COUNT: usize>(
        &mut self,
        pixel: usize,
        lane: usize,
        sums: [[__m256i; 2]; COUNT],
    ) {
        for (number, sums) in sums.into_iter().enumerate() {
            for (half, sums) in sums.into_iter().enumerate() {
                let lane = lane + half * 8;
                let mut values = [0.0; 8];
                // SAFETY: this function's conditions.
                unsafe {
                    let factors = _mm256_loadu_ps(self.factors.as_ptr().add(lane));
                    let reals = _mm256_mul_ps(_mm256_cvtepi32_ps(sums), factors);
                    _mm256_storeu_ps(values.as_mut_ptr(), reals);
                }
                for (lane, value) in (lane..self.outputs).zip(values) {
                    self.out[lane * self.pixels + pixel + number] = value;
                }
            }
        }
    }
}

/// Puts each block of each pixel into `sink`, `PIXELS` at a time.
///
/// # Safety
/// The processor has AVX2 and the instructions of `M`; the row passed `Dense::check`; `sink` was made for it and `dense`.
#[inline(always)]
unsafe fn dense<M: Multiply, const PIXELS: usize>(
    dense: &Dense,
    row: &Row<'_>,
    mut sink: impl Store,
) {
    for (block, group) in dense.groups.iter().enumerate() {
        let lane = block * BLOCK;
        let mut tile = Tile {
            dense,
            row,
            lane,
            group,
            pixel: 0,
        };
        // SAFETY: `Dense::new` packed starts and factors for each lane; the pixels are the row's, and `sink` has room for them.
        unsafe {
            if row.pixels >= PIXELS {
                // The last tile is moved back onto pixels already done.
                for pixel in (0..row.pixels).step_by(PIXELS) {
                    tile.pixel = pixel.min(row.pixels - PIXELS);
                    sink.store(tile.pixel, lane, M::sums::<PIXELS>(tile));
                }
            } else {
                for pixel in 0..row.pixels {
                    tile.pixel = pixel;
                    sink.store(pixel, lane, M::sums::<1>(tile));
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
pub(super) unsafe fn bytes<M: Multiply, const PIXELS: usize>(
    packed: &Dense,
    row: &Row<'_>,
    to: &ToBytes,
    out: &mut [u8],
    pitch: usize,
) {
    // SAFETY: this function's conditions.
    unsafe {
        let sink = Bytes {
            factors: &packed.factors,
            limits: Limits::new(to),
            out,
            pitch,
        };
        dense::<M, PIXELS>(packed, row, sink);
    }
}

/// A row as f32. Inlined into a function that has the instructions.
///
/// # Safety
/// As [`dense`].
#[inline(always)]
pub(super) unsafe fn floats<M: Multiply, const PIXELS: usize>(
    packed: &Dense,
    row: &Row<'_>,
    out: &mut [f32],
) {
    let sink = Floats {
        factors: &packed.factors,
        outputs: packed.outputs,
        pixels: row.pixels,
        out,
    };
    // SAFETY: this function's conditions.
    unsafe { dense::<M, PIXELS>(packed, row, sink) }
}

/// # Safety
/// The processor has AVX2, the row passed `Dense::check`, and `out` has room for it.
#[target_feature(enable = "avx2")]
pub(super) unsafe fn dense_bytes(
    packed: &Dense,
    row: &Row<'_>,
    to: &ToBytes,
    out: &mut [u8],
    pitch: usize,
) {
    // SAFETY: as this function's.
    unsafe { bytes::<Avx2, 4>(packed, row, to, out, pitch) }
}

/// # Safety
/// As [`dense_bytes`].
#[target_feature(enable = "avx2")]
pub(super) unsafe fn dense_floats(packed: &Dense, row: &Row<'_>, out: &mut [f32]) {
    // SAFETY: as this function's.
    unsafe { floats::<Avx2, 4>(packed, row, out) }
}

/// Sixteen channels of two taps as 16-bit pairs; 128-bit lane by lane, so channels 0 to 3 and 8 to 11, then the others.
#[target_feature(enable = "avx2")]
#[inline]
fn pairs(one: __m256i, other: __m256i) -> [__m256i; 2] {
    [
        _mm256_unpacklo_epi16(one, other),
        _mm256_unpackhi_epi16(one, other),
    ]
}

/// # Safety
/// As [`dense_bytes`].
#[target_feature(enable = "avx2")]
pub(super) unsafe fn depthwise(packed: &Depthwise, row: &Row<'_>, to: &ToBytes, out: &mut [u8]) {
    let limits = Limits::new(to);
    let pitch = packed.pitch;
    for channel in (0..pitch).step_by(BLOCK) {
        // SAFETY: there are a start and a factor for every channel of the pitch.
        let (starts, factors) = unsafe {
            let starts = packed.starts.as_ptr().add(channel);
            let starts = [
                _mm256_loadu_si256(starts.cast()),
                _mm256_loadu_si256(starts.add(8).cast()),
            ];
            let factors = packed.factors.as_ptr().add(channel);
            (
                starts,
                [_mm256_loadu_ps(factors), _mm256_loadu_ps(factors.add(8))],
            )
        };
        let starts = [
            _mm256_permute2x128_si256::<0x20>(starts[0], starts[1]),
            _mm256_permute2x128_si256::<0x31>(starts[0], starts[1]),
        ];
        let factors = [
            _mm256_permute2f128_ps::<0x20>(factors[0], factors[1]),
            _mm256_permute2f128_ps::<0x31>(factors[0], factors[1]),
        ];
        for first in (0..row.pixels).step_by(PIXELS) {
            let mut sums = [starts; PIXELS];
            for (number, taps) in row.runs.chunks(2).enumerate() {
                let zero = _mm256_setzero_si256();
                // SAFETY: `Depthwise::new` packed a pitch of weights for each tap.
                let weight = |tap: usize| unsafe {
                    let at = packed
                        .weights
                        .as_ptr()
                        .add((2 * number + tap) * pitch + channel);
                    _mm256_cvtepi8_epi16(_mm_loadu_si128(at.cast()))
                };
                let weights = pairs(weight(0), if taps.len() > 1 { weight(1) } else { zero });
                for (pixel, sums) in sums.iter_mut().enumerate() {
                    // Past the end the last pixel is done again; only the pixels of the row are stored.
                    let pixel = (first + pixel).min(row.pixels - 1);
                    // SAFETY: sixteen channels of a tap of a pixel of the row.
                    let input = |tap: usize| unsafe {
                        let at = row
                            .input
                            .as_ptr()
                            .add(row.base + tap + pixel * row.step + channel);
                        _mm256_cvtepu8_epi16(_mm_loadu_si128(at.cast()))
                    };
                    let bytes = pairs(input(taps[0]), taps.get(1).map_or(zero, |&tap| input(tap)));
                    for half in 0..2 {
                        sums[half] = _mm256_add_epi32(
                            sums[half],
                            _mm256_madd_epi16(bytes[half], weights[half]),
                        );
                    }
                }
            }
            for (pixel, sums) in sums.into_iter().enumerate().take(row.pixels - first) {
                let results =
                    _mm256_packs_epi32(scaled(sums[0], factors[0]), scaled(sums[1], factors[1]));
                // SAFETY: sixteen bytes of a pixel that `out` has room for.
                unsafe {
                    let out = out.as_mut_ptr().add((first + pixel) * pitch + channel);
                    _mm_storeu_si128(out.cast(), limits.pack(results));
                }
            }
        }
    }
}

/// # Safety
/// As [`dense_bytes`]; the three slices are of one length.
#[target_feature(enable = "avx2")]
pub(super) unsafe fn add(addition: &Addition, one: &[u8], other: &[u8], out: &mut [u8]) {
    let limits = Limits::new(&addition.to);
    let zeros = addition
        .zeros
        .map(|zero| _mm256_set1_epi32(i32::from(zero)));
    let factors = addition.factors.map(|factor| _mm256_set1_ps(factor));
    let whole = out.len() / 16 * 16;
    for at in (0..whole).step_by(16) {
        let part = |input: usize, bytes: &[u8], half: usize| {
            // SAFETY: eight of the sixteen bytes from `at` on.
            let bytes = unsafe { _mm_loadl_epi64(bytes.as_ptr().add(at + 8 * half).cast()) };
            let value =
                _mm256_cvtepi32_ps(_mm256_sub_epi32(_mm256_cvtepu8_epi32(bytes), zeros[input]));
            _mm256_mul_ps(value, factors[input])
        };
        let sum = |half: usize| {
            _mm256_cvtps_epi32(_mm256_add_ps(part(0, one, half), part(1, other, half)))
        };
        let results = _mm256_permute4x64_epi64::<0b11_01_10_00>(_mm256_packs_epi32(sum(0), sum(1)));
        // SAFETY: sixteen bytes from `at` on.
        unsafe { _mm_storeu_si128(out.as_mut_ptr().add(at).cast(), limits.pack(results)) };
    }
    portable::add(addition, &one[whole..], &other[whole..], &mut out[whole..]);
}

/// # Safety
/// None; it is like the others to be dispatched like them.
pub(super) unsafe fn quantize_four(planes: &[&[f32]], scale: f32, zero: u8, out: &mut [u8]) {
    portable::quantize_four(planes, scale, zero, out);
}
