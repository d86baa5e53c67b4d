//! AVX-512 with VNNI: `vpdpbusd` multiplies 64 bytes by 64 weights and adds them, four by four, to 16 lanes.
//!
//! Nothing here saturates before the end: `vpdpbusd` adds exactly, [`Convolution::fit_32_bits`] keeps the lanes and the
//! rounded results in range, and rounding is `vcvtps2dq` with ties to even. Packing to bytes saturates as it should.
//!
//! [`Convolution::fit_32_bits`]: crate::engine::layer::Convolution::fit_32_bits

use std::arch::x86_64::*;

use super::{Addition, BLOCK, Dense, Depthwise, Part, Row, ToBytes, avx2, portable};

/// Channels that the depthwise kernel takes at a time.
const WIDE: usize = 64;
/// Rows of taps that one multiplication takes.
const TALL: usize = 4;
const NEAREST: i32 = _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC;

/// A loop that the compiler cannot leave a loop: what it indexes are registers.
macro_rules! unrolled {
    ($number:ident in $($value:literal)* $body:block) => {
        $({
            let $number = $value;
            $body
        })*
    };
}

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

/// Where a tile of a dense convolution starts.
#[derive(Clone, Copy)]
struct Tile<'a> {
    dense: &'a Dense,
    row: &'a Row<'a>,
    /// First output channel.
    lane: usize,
    weights: *const i8,
    pixel: usize,
}

impl Tile<'_> {
    /// Accumulators of `PIXELS` pixels in `BLOCKS` blocks of channels.
    ///
    /// # Safety
    /// The row passed `Dense::check`; `lane`, `weights` and `pixel` are such that the tile lies in the row.
    #[target_feature(enable = "avx512f,avx512vnni")]
    #[inline]
    unsafe fn sums<const BLOCKS: usize, const PIXELS: usize>(&self) -> [[__m512i; PIXELS]; BLOCKS] {
        let Dense { run, starts, .. } = self.dense;
        let mut sums = [[_mm512_setzero_si512(); PIXELS]; BLOCKS];
        for (block, sums) in sums.iter_mut().enumerate() {
            // SAFETY: there is a start for every lane of every block.
            let start = unsafe {
                _mm512_loadu_si512(starts.as_ptr().add(self.lane + block * BLOCK).cast())
            };
            *sums = [start; PIXELS];
        }
        let mut weights = self.weights;
        let step = self.row.step;
        for offset in self.row.runs {
            // SAFETY: the first byte of the run of the tile's first pixel is in the row's input.
            let mut input = unsafe {
                self.row
                    .input
                    .as_ptr()
                    .add(self.row.base + offset + self.pixel * step)
            };
            for _ in 0..run / 4 {
                let mut w = [_mm512_setzero_si512(); BLOCKS];
                for (block, w) in w.iter_mut().enumerate() {
                    // SAFETY: a group has `runs * run / 4` times `BLOCKS` vectors of weights.
                    *w = unsafe { _mm512_loadu_si512(weights.add(block * 4 * BLOCK).cast()) };
                }
                for pixel in 0..PIXELS {
                    // SAFETY: four bytes of a run of a pixel of the row.
                    let quad = unsafe { input.add(pixel * step).cast::<i32>().read_unaligned() };
                    let quad = _mm512_set1_epi32(quad);
                    for (sums, &w) in sums.iter_mut().zip(&w) {
                        sums[pixel] = _mm512_dpbusd_epi32(sums[pixel], quad, w);
                    }
                }
                // SAFETY: at most to the end of the run, and of the group's weights.
                (input, weights) = unsafe { (input.add(4), weights.add(BLOCKS * 4 * BLOCK)) };
            }
        }
        sums
    }

    /// Writes a tile as bytes. `PIXELS` is a multiple of four, or 1.
    ///
    /// # Safety
    /// As [`Tile::sums`]; `out` has room for the row.
    #[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512vnni")]
    #[inline]
    unsafe fn bytes<const BLOCKS: usize, const PIXELS: usize>(
        &self,
        limits: Limits,
        out: *mut u8,
        pitch: usize,
    ) {
        // SAFETY: as this function's.
        let sums = unsafe { self.sums::<BLOCKS, PIXELS>() };
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
                _ => [of(first, 0), of(first, 1), of(first, 2), of(first, 3)],
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
                    3 => _mm512_mask_storeu_epi8(out.cast(), u64::MAX >> 16, bytes),
                    _ => _mm512_storeu_si512(out.cast(), bytes),
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
    unsafe fn floats<const BLOCKS: usize, const PIXELS: usize>(&self, out: *mut f32) {
        // SAFETY: as this function's.
        let sums = unsafe { self.sums::<BLOCKS, PIXELS>() };
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

/// Covers a row with tiles of `$most` pixels, then of four (the last one moved back onto pixels already done), or, in
/// a row shorter than that, of one.
macro_rules! tiles {
    ($tile:ident, $blocks:literal, $most:literal, $method:ident($($argument:expr),*)) => {{
        let pixels = $tile.row.pixels;
        let mut pixel = 0;
        while pixel + $most <= pixels {
            $tile.pixel = pixel;
            $tile.$method::<$blocks, $most>($($argument),*);
            pixel += $most;
        }
        while pixel < pixels && pixels >= 4 {
            $tile.pixel = pixel.min(pixels - 4);
            $tile.$method::<$blocks, 4>($($argument),*);
            pixel += 4;
        }
        while pixel < pixels {
            $tile.pixel = pixel;
            $tile.$method::<$blocks, 1>($($argument),*);
            pixel += 1;
        }
    }};
}

/// Covers all channels of a row.
macro_rules! channels {
    ($dense:ident, $row:ident, $method:ident($($argument:expr),*)) => {{
        let mut tile = Tile { dense: $dense, row: $row, lane: 0, weights: $dense.weights.as_ptr(), pixel: 0 };
        for group in $dense.groups() {
            // SAFETY: `Dense::check` held; `Dense::new` packed as many starts, factors and weights as the groups have;
            // the caller of this function checked that `out` has room.
            unsafe {
                match group {
                    1 => tiles!(tile, 1, 16, $method($($argument),*)),
                    2 => tiles!(tile, 2, 8, $method($($argument),*)),
                    3 => tiles!(tile, 3, 8, $method($($argument),*)),
                    _ => tiles!(tile, 4, 4, $method($($argument),*)),
                }
                tile.weights = tile.weights.add(group * BLOCK * $dense.runs * $dense.run);
            }
            tile.lane += group * BLOCK;
        }
    }};
}

/// # Safety
/// The processor has AVX-512 F, BW, VL and VNNI.
#[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512vnni")]
pub(super) unsafe fn dense_bytes(
    dense: &Dense,
    row: &Row<'_>,
    to: &ToBytes,
    out: &mut [u8],
    pitch: usize,
) {
    let limits = Limits::new(to);
    let out = out.as_mut_ptr();
    channels!(dense, row, bytes(limits, out, pitch));
}

/// # Safety
/// As [`dense_bytes`].
#[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512vnni")]
pub(super) unsafe fn dense_floats(dense: &Dense, row: &Row<'_>, out: &mut [f32]) {
    let out = out.as_mut_ptr();
    if !dense.few.0.is_empty() && row.step == NARROW && row.pixels >= FEW_PIXELS {
        // SAFETY: passed on; one block has all outputs, and no other lane is written.
        return unsafe { few_floats(dense, row, out) };
    }
    channels!(dense, row, floats(out));
}

/// Outputs that leave three quarters of a block of lanes empty.
const FEW: usize = 4;
/// Bytes of a pixel of input that is a 128-bit lane.
const NARROW: usize = 16;
const FEW_PIXELS: usize = 16;

/// Weights of up to [`FEW`] outputs, `[run][16 bytes of it][output]`; empty where they are more, or runs no multiple of 16.
#[derive(Clone, Debug, Default)]
pub(super) struct Few(Vec<[i8; NARROW]>);

impl Few {
    pub(super) fn new(
        outputs: usize,
        runs: usize,
        run: usize,
        weight: impl Fn(usize, usize, usize) -> i8,
    ) -> Self {
        if outputs > FEW || !run.is_multiple_of(NARROW) {
            return Self::default();
        }
        let mut few = Vec::with_capacity(runs * run / NARROW * outputs);
        for number in 0..runs {
            for start in (0..run).step_by(NARROW) {
                few.extend((0..outputs).map(|output| {
                    std::array::from_fn(|byte| weight(output, number, start + byte))
                }));
            }
        }
        Self(few)
    }
}

/// Up to four outputs from pixels of 16 channels: the heads. A register holds four pixels of one output, each as four sums that are
/// added up in the end, instead of sixteen outputs of one pixel of which most do not exist.
///
/// # Safety
/// As [`dense_bytes`]; the row passed `Dense::check`, its pixels lie [`NARROW`] bytes apart and it has [`FEW_PIXELS`] or more;
/// `Dense::few` is not empty; `out` has room for the outputs' rows.
#[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512vnni")]
unsafe fn few_floats(dense: &Dense, row: &Row<'_>, out: *mut f32) {
    // SAFETY: passed on; no more outputs have weights of this kind.
    unsafe {
        match dense.outputs {
            1 => few_of::<1>(dense, row, out),
            2 => few_of::<2>(dense, row, out),
            3 => few_of::<3>(dense, row, out),
            _ => few_of::<FEW>(dense, row, out),
        }
    }
}

/// # Safety
/// As [`few_floats`]; there are `OUTPUTS` outputs.
#[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512vnni")]
#[inline]
unsafe fn few_of<const OUTPUTS: usize>(dense: &Dense, row: &Row<'_>, out: *mut f32) {
    for pixel in (0..row.pixels).step_by(FEW_PIXELS) {
        let pixel = pixel.min(row.pixels - FEW_PIXELS);
        let mut sums = [[_mm512_setzero_si512(); FEW_PIXELS / 4]; OUTPUTS];
        let mut weights = dense.few.0.as_ptr();
        for offset in row.runs {
            for tap in (0..dense.run).step_by(NARROW) {
                let at = row.base + offset + pixel * NARROW + tap;
                let mut input = [_mm512_setzero_si512(); FEW_PIXELS / 4];
                for (four, input) in input.iter_mut().enumerate() {
                    // SAFETY: the tap's bytes of four pixels of the row, one after the other.
                    *input = unsafe {
                        _mm512_loadu_si512(row.input.as_ptr().add(at + 64 * four).cast())
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

/// Weights of a depthwise convolution for `vpdpbusd`: four rows of taps are the four bytes of a lane. Of a fifth row they are
/// its first four taps; the last is the fourth of the next pixel, or, with a stride of 2, its third.
///
/// Unpacking four rows of 64 channels byte by byte leaves, in register `j` and 128-bit lane `l`, the channels
/// `16 l + 4 j` to `+ 3`; weights, starts and factors come in that order, and packing the results undoes it. Where only
/// 32 or 16 channels are left they come twice or four times, for as many pixels at once.
#[derive(Clone, Debug, Default)]
pub(super) struct Interleaved {
    /// `[64 channels][register][quad]`: a quad for each column of four rows, then three for a fifth row.
    weights: Vec<Lanes<[i8; TALL]>>,
    /// `[64 channels][register]`.
    starts: Vec<Lanes<i32>>,
    factors: Vec<Lanes<f32>>,
}

/// A register in memory. A load that crosses into the next cache line takes the time of two, and here weights are half of all loads:
/// 5x5 takes 1.8 times as long where they do.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
struct Lanes<T>([T; BLOCK]);

/// Vectors of weights for a register of channels.
const fn quads(rows: usize) -> usize {
    // Kernels are square.
    if rows > TALL { rows + 3 } else { rows }
}

impl Interleaved {
    /// Of the kernels that [`depthwise`] has; of others it stays empty.
    pub(super) fn new(depthwise: &Depthwise) -> Self {
        let Depthwise {
            pitch,
            rows,
            columns,
            ..
        } = *depthwise;
        let mut packed = Self::default();
        if !has(rows, columns) {
            return packed;
        }
        // Row and column of the tap that a byte of a quad multiplies.
        let tap = |quad: usize, byte: usize| match quad.checked_sub(columns) {
            None => (byte, quad),
            Some(0) => (TALL, byte),
            Some(stride) if byte + stride == TALL => (TALL, TALL),
            Some(_) => (rows, 0),
        };
        let order = |lane: usize| (lane / 16 * 4) + (lane % 16 / 4 * 16) + lane % 4;
        for (first, split) in strips(pitch) {
            let channels: [usize; WIDE] =
                std::array::from_fn(|lane| first + order(lane) % (WIDE / split));
            for channels in channels.as_chunks::<BLOCK>().0 {
                for quad in 0..quads(rows) {
                    let weight = |channel: usize, byte| {
                        let (row, column) = tap(quad, byte);
                        let at = (row * columns + column) * pitch + channel;
                        if row < rows { depthwise.weights[at] } else { 0 }
                    };
                    packed.weights.push(Lanes(
                        channels.map(|channel| std::array::from_fn(|byte| weight(channel, byte))),
                    ));
                }
                let starts = channels.map(|channel| depthwise.starts[channel]);
                packed.starts.push(Lanes(starts));
                let factors = channels.map(|channel| depthwise.factors[channel]);
                packed.factors.push(Lanes(factors));
            }
        }
        packed
    }
}

/// Whether [`depthwise`] has a loop of its own for a kernel.
fn has(rows: usize, columns: usize) -> bool {
    rows == columns && matches!(rows, 3 | 5)
}

/// Four registers of 64 bytes, byte by byte in turns: of each 128-bit lane the first, second, third and fourth four.
#[target_feature(enable = "avx512f,avx512bw")]
#[inline]
fn interleaved(bytes: [__m512i; TALL]) -> [__m512i; 4] {
    words(pair(bytes[0], bytes[1]), pair(bytes[2], bytes[3]))
}

/// Two registers of 64 bytes, byte by byte in turns.
#[target_feature(enable = "avx512f,avx512bw")]
#[inline]
fn pair(one: __m512i, other: __m512i) -> [__m512i; 2] {
    [
        _mm512_unpacklo_epi8(one, other),
        _mm512_unpackhi_epi8(one, other),
    ]
}

/// Two pairs, word by word in turns.
#[target_feature(enable = "avx512f,avx512bw")]
#[inline]
fn words(one: [__m512i; 2], other: [__m512i; 2]) -> [__m512i; 4] {
    [
        _mm512_unpacklo_epi16(one[0], other[0]),
        _mm512_unpackhi_epi16(one[0], other[0]),
        _mm512_unpacklo_epi16(one[1], other[1]),
        _mm512_unpackhi_epi16(one[1], other[1]),
    ]
}

/// The strips of channels that a pixel is made of: the first channel of each, and of how many pixels the strip fills a register.
fn strips(pitch: usize) -> impl Iterator<Item = (usize, usize)> {
    let mut next = 0;
    std::iter::from_fn(move || {
        let split = [1, 2, 4]
            .into_iter()
            .find(|split| next + WIDE / split <= pitch)?;
        let first = next;
        next += WIDE / split;
        Some((first, split))
    })
}

/// A row of 64 channels, or of the 32 or 16 that are left. Of these the row comes in `SPLIT` parts of one length, which overlap where
/// they have to, and a register holds a pixel of each part, so that none is half empty.
struct Strip<const SPLIT: usize> {
    /// The first tap of each row of taps of the first pixel.
    rows: [*const u8; MOST],
    /// Bytes from the first part's input and output to each part's.
    apart: [[usize; 2]; SPLIT],
    /// Pixels of a part.
    pixels: usize,
    /// Bytes of a pixel of input and output.
    pitch: usize,
    /// Of this strip: `[register][quad]`, `[register]`, `[register]`.
    weights: *const Lanes<[i8; TALL]>,
    starts: *const Lanes<i32>,
    factors: *const Lanes<f32>,
    limits: Limits,
    out: *mut u8,
}

/// Most rows of taps.
const MOST: usize = 5;

impl<const SPLIT: usize> Strip<SPLIT> {
    /// The strip from `channel` on.
    ///
    /// # Safety
    /// The row passed `Depthwise::check`, has a kernel that [`has`], without dilation, and one pixel or more; the strip is the one of
    /// this `number` in [`strips`], with this `SPLIT`; `out` has room for the row.
    #[target_feature(enable = "avx512f")]
    #[inline]
    unsafe fn new(
        depthwise: &Depthwise,
        row: &Row<'_>,
        limits: Limits,
        [number, channel]: [usize; 2],
        out: *mut u8,
    ) -> Self {
        let &Depthwise {
            pitch,
            rows: side,
            interleaved: ref packed,
            ..
        } = depthwise;
        let pixels = row.pixels.div_ceil(SPLIT);
        // SAFETY: the first tap of each row of taps, and for a row that the kernel does not have of its last, is in the row's
        // input; `Interleaved::new` packed four vectors of starts and factors for every strip, and four times `quads` of weights.
        unsafe {
            Self {
                rows: std::array::from_fn(|line| {
                    let tap = row.runs.get_unchecked(line.min(side - 1) * side);
                    row.input.as_ptr().add(row.base + tap + channel)
                }),
                apart: std::array::from_fn(|part| {
                    let first = (part * pixels).min(row.pixels - pixels);
                    [first * row.step, first * pitch]
                }),
                pixels,
                pitch,
                weights: packed.weights.as_ptr().add(4 * quads(side) * number),
                starts: packed.starts.as_ptr().add(4 * number),
                factors: packed.factors.as_ptr().add(4 * number),
                limits,
                out: out.add(channel),
            }
        }
    }

    /// The channels of a pixel of input of each part.
    ///
    /// # Safety
    /// `at` leads from the row's first tap to a tap of one of a part's pixels.
    #[target_feature(enable = "avx512f,avx512bw")]
    #[inline]
    unsafe fn load(&self, row: usize, at: usize) -> __m512i {
        // SAFETY: as this function's; the same tap of the parts' pixels.
        unsafe {
            let of = |part: usize| self.rows[row].add(self.apart[part][0] + at);
            match SPLIT {
                1 => _mm512_loadu_si512(of(0).cast()),
                2 => {
                    let half = |part: usize| _mm256_loadu_si256(of(part).cast());
                    _mm512_inserti64x4::<1>(_mm512_castsi256_si512(half(0)), half(1))
                }
                _ => {
                    let quarter = |part: usize| _mm_loadu_si128(of(part).cast());
                    let four = _mm512_castsi128_si512(quarter(0));
                    let four = _mm512_inserti32x4::<1>(four, quarter(1));
                    let four = _mm512_inserti32x4::<2>(four, quarter(2));
                    _mm512_inserti32x4::<3>(four, quarter(3))
                }
            }
        }
    }

    /// The weights of a register's channels.
    ///
    /// # Safety
    /// The kernel has `SIDE` rows, and such a quad.
    #[target_feature(enable = "avx512f")]
    #[inline]
    unsafe fn weight<const SIDE: usize>(&self, register: usize, quad: usize) -> __m512i {
        // SAFETY: there are `quads` for each of the four registers.
        unsafe { _mm512_load_si512(self.weights.add(register * quads(SIDE) + quad).cast()) }
    }

    /// # Safety
    /// There are four registers.
    #[target_feature(enable = "avx512f")]
    #[inline]
    unsafe fn start(&self, register: usize) -> __m512i {
        // SAFETY: as this function's.
        unsafe { _mm512_load_si512(self.starts.add(register).cast()) }
    }

    /// Writes the sums of some neighbouring pixels of each part.
    ///
    /// # Safety
    /// From `pixel` on there are so many in a part.
    #[target_feature(enable = "avx512f,avx512bw")]
    #[inline]
    unsafe fn store<const PIXELS: usize>(&self, mut sums: [[__m512i; 4]; PIXELS], pixel: usize) {
        unrolled!(j in 0 1 2 3 {
            // SAFETY: four vectors of factors.
            let factors = unsafe { _mm512_load_ps(self.factors.add(j).cast()) };
            for sums in &mut sums {
                sums[j] = scaled(sums[j], factors);
            }
        });
        for (number, bytes) in self.limits.pack_all(sums).into_iter().enumerate() {
            // SAFETY: `out` has room for each part's pixels.
            unsafe {
                let of = |part: usize| {
                    self.out
                        .add(self.apart[part][1] + (pixel + number) * self.pitch)
                };
                match SPLIT {
                    1 => _mm512_storeu_si512(of(0).cast(), bytes),
                    2 => {
                        _mm256_storeu_si256(of(0).cast(), _mm512_castsi512_si256(bytes));
                        _mm256_storeu_si256(of(1).cast(), _mm512_extracti64x4_epi64::<1>(bytes));
                    }
                    _ => {
                        _mm_storeu_si128(of(0).cast(), _mm512_castsi512_si128(bytes));
                        _mm_storeu_si128(of(1).cast(), _mm512_extracti32x4_epi32::<1>(bytes));
                        _mm_storeu_si128(of(2).cast(), _mm512_extracti32x4_epi32::<2>(bytes));
                        _mm_storeu_si128(of(3).cast(), _mm512_extracti32x4_epi32::<3>(bytes));
                    }
                }
            }
        }
    }

    /// 3x3, as a window that moves over the columns: each is unpacked once and goes into the sums of all pixels that it belongs to,
    /// while weights and sums stay in registers. Nothing waits for a tile to end: multiplications of some pixels, unpacking of
    /// the next and rounding of the last keep all ports busy.
    ///
    /// # Safety
    /// As [`Strip::new`]; the kernel is 3x3 and moves by `STRIDE`.
    #[target_feature(enable = "avx512f,avx512bw,avx512vnni")]
    unsafe fn three<const STRIDE: usize>(&self) {
        // SAFETY: three quads of each register.
        let weights: [[__m512i; 4]; 3] =
            std::array::from_fn(|tap| std::array::from_fn(|j| unsafe { self.weight::<3>(j, tap) }));
        let zero = _mm512_setzero_si512();
        let mut sums = [[zero; 4]; 3];
        let (mut at, mut pixel) = (0, 0);
        macro_rules! column {
            ($($tap:literal of $sums:literal),*) => {
                // SAFETY: a column of a pixel that is still to be written.
                let row = |row| unsafe { self.load(row, at) };
                let four = interleaved([row(0), row(1), row(2), zero]);
                at += self.pitch;
                $(unrolled!(j in 0 1 2 3 {
                    if $tap == 0 {
                        // SAFETY: as above.
                        sums[$sums][j] = unsafe { self.start(j) };
                    }
                    sums[$sums][j] = _mm512_dpbusd_epi32(sums[$sums][j], four[j], weights[$tap][j]);
                });)*
            };
        }
        macro_rules! done {
            ($sums:literal) => {
                // SAFETY: there is such a pixel.
                unsafe { self.store([sums[$sums]], pixel) };
                pixel += 1;
                if pixel == self.pixels {
                    return;
                }
            };
        }
        column!(0 of 0);
        if STRIDE == 1 {
            column!(1 of 0, 0 of 1);
            loop {
                column!(2 of 0, 1 of 1, 0 of 2);
                done!(0);
                column!(2 of 1, 1 of 2, 0 of 0);
                done!(1);
                column!(2 of 2, 1 of 0, 0 of 1);
                done!(2);
            }
        }
        loop {
            column!(1 of 0);
            column!(2 of 0, 0 of 1);
            done!(0);
            column!(1 of 1);
            column!(2 of 1, 0 of 0);
            done!(1);
        }
    }

    /// 5x5, in tiles of `PIXELS` pixels, the last one moved back onto pixels already done.
    ///
    /// # Safety
    /// As [`Strip::new`]; the kernel is 5x5 and moves by `STRIDE`, and a part has `PIXELS` pixels or more.
    #[target_feature(enable = "avx512f,avx512bw,avx512vnni")]
    unsafe fn five<const STRIDE: usize, const PIXELS: usize>(&self) {
        for pixel in (0..self.pixels).step_by(PIXELS) {
            // SAFETY: all tiles lie in the parts.
            unsafe { self.five_tile::<STRIDE, PIXELS>(pixel.min(self.pixels - PIXELS)) };
        }
    }

    /// # Safety
    /// As [`Strip::five`]; a part has so many pixels from `pixel` on.
    #[target_feature(enable = "avx512f,avx512bw,avx512vnni")]
    #[inline]
    unsafe fn five_tile<const STRIDE: usize, const PIXELS: usize>(&self, pixel: usize) {
        const SIDE: usize = 5;
        // As far as the loops below are written out.
        const {
            assert!((PIXELS - 1) * STRIDE + SIDE <= 7 && PIXELS <= 3);
        }
        // SAFETY: each column of the tile is the tap of some output pixel of it.
        let at = |row: usize, column: usize| unsafe {
            self.load(row, (pixel * STRIDE + column) * self.pitch)
        };
        // SAFETY: the kernel has such quads.
        let weight = |j: usize, quad: usize| unsafe { self.weight::<SIDE>(j, quad) };
        let mut sums = [[_mm512_setzero_si512(); 4]; PIXELS];
        unrolled!(j in 0 1 2 3 {
            // SAFETY: one of four.
            let start = unsafe { self.start(j) };
            for sums in &mut sums {
                sums[j] = start;
            }
        });
        // Column by column, each at once into the sums that it belongs to: where all unpacked columns wait in registers
        // for their weights, the compiler has none left and moves them to memory and back.
        unrolled!(column in 0 1 2 3 4 5 6 {
            if column < (PIXELS - 1) * STRIDE + SIDE {
                let four = interleaved([at(0, column), at(1, column), at(2, column), at(3, column)]);
                unrolled!(pixel in 0 1 2 {
                    if pixel < PIXELS && column >= pixel * STRIDE && column < pixel * STRIDE + SIDE {
                        let tap = column - pixel * STRIDE;
                        unrolled!(j in 0 1 2 3 {
                            sums[pixel][j] = _mm512_dpbusd_epi32(sums[pixel][j], four[j], weight(j, tap));
                        });
                    }
                });
            }
        });
        // The fifth row, four columns to a lane, from each output pixel's first column on, and from the next one's.
        let last = (PIXELS - 1) * STRIDE + SIDE - 1;
        let fifth = |column: usize| at(SIDE - 1, column.min(last));
        unrolled!(start in 0 1 2 3 {
            if start <= PIXELS {
                let first = start * STRIDE;
                let four = words(
                    pair(fifth(first), fifth(first + 1)),
                    pair(fifth(first + 2), fifth(first + 3)),
                );
                unrolled!(j in 0 1 2 3 {
                    if start < PIXELS {
                        sums[start][j] = _mm512_dpbusd_epi32(sums[start][j], four[j], weight(j, SIDE));
                    }
                    if let Some(before) = usize::checked_sub(start, 1) {
                        sums[before][j] = _mm512_dpbusd_epi32(sums[before][j], four[j], weight(j, SIDE + STRIDE));
                    }
                });
            }
        });
        // SAFETY: as this function's.
        unsafe { self.store(sums, pixel) };
    }

    /// # Safety
    /// As [`Strip::new`]; the kernel has so many rows and columns and moves by `stride`, 1 or 2, and a part of a 5x5 one has [`FIVE_PIXELS`].
    #[target_feature(enable = "avx512f,avx512bw,avx512vnni")]
    unsafe fn run(&self, side: usize, stride: usize) {
        // SAFETY: as this function's.
        unsafe {
            match (side, stride) {
                (3, 1) => self.three::<1>(),
                (3, _) => self.three::<2>(),
                (_, 1) => self.five::<1, FIVE_PIXELS>(),
                _ => self.five::<2, 2>(),
            }
        }
    }
}

/// Pixels of the largest tile of 5x5.
const FIVE_PIXELS: usize = 3;

/// # Safety
/// As [`dense_bytes`].
#[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512vnni")]
pub(super) unsafe fn depthwise(depthwise: &Depthwise, row: &Row<'_>, to: &ToBytes, out: &mut [u8]) {
    let &Depthwise {
        pitch,
        rows,
        columns,
        ..
    } = depthwise;
    // Without dilation neighbouring taps are neighbouring pixels.
    let close = |line: &[usize]| line.windows(2).all(|taps| taps[0] + pitch == taps[1]);
    let stride = row.step / pitch;
    let most_split = strips(pitch).map(|(_, split)| split).max().unwrap_or(1);
    let least = if rows > TALL { FIVE_PIXELS } else { 1 };
    if depthwise.interleaved.starts.is_empty()
        || !row.runs.chunks(columns).all(close)
        || !matches!(stride, 1 | 2)
        || row.pixels.div_ceil(most_split) < least
    {
        // SAFETY: every processor with AVX-512 has AVX2.
        return unsafe { avx2::depthwise(depthwise, row, to, out) };
    }
    let limits = Limits::new(to);
    let out = out.as_mut_ptr();
    for (number, (channel, split)) in strips(pitch).enumerate() {
        let place = [number, channel];
        // SAFETY: the caller checked the row, whose taps lie side by side; kernel and stride are its own, the weights are packed for
        // them, and it is long enough.
        unsafe {
            match split {
                1 => Strip::<1>::new(depthwise, row, limits, place, out).run(rows, stride),
                2 => Strip::<2>::new(depthwise, row, limits, place, out).run(rows, stride),
                _ => Strip::<4>::new(depthwise, row, limits, place, out).run(rows, stride),
            }
        }
    }
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
        for channel in (0..part.channels).step_by(WIDE) {
            let mask = u64::MAX >> (WIDE - WIDE.min(part.channels - channel));
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
