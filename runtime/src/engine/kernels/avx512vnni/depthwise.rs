//! Depthwise convolutions, 3x3 and 5x5: rows of taps unpacked into the bytes of a lane.

use std::arch::x86_64::*;

use super::super::quads::{TALL, has, quads};
use super::super::{BLOCK, Depthwise, Kernel, Row, ToBytes, avx2};
use super::{Limits, scaled};

/// Channels that the depthwise kernel takes at a time.
const WIDE: usize = 64;

/// Weights of a depthwise convolution as [`quads`](super::super::quads) of 64 channels.
///
/// Unpacking four rows of 64 channels byte by byte leaves, in register `j` and 128-bit lane `l`, the channels
/// `16 l + 4 j` to `+ 3`; weights, starts and factors come in that order, and packing the results undoes it. Where only
/// 32 or 16 channels are left they come twice or four times, for as many pixels at once.
#[derive(Clone, Debug, Default)]
pub(in super::super) struct Interleaved {
    /// `[64 channels][register][quad]`.
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

impl Interleaved {
    /// Of kernels that have quads; of others it stays empty.
    pub(in super::super) fn new(_: Kernel, depthwise: &Depthwise) -> Self {
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
        let order = |lane: usize| (lane / 16 * 4) + (lane % 16 / 4 * 16) + lane % 4;
        for (first, split) in strips(pitch) {
            let channels: [usize; WIDE] =
                std::array::from_fn(|lane| first + order(lane) % (WIDE / split));
            for channels in channels.as_chunks::<BLOCK>().0 {
                for quad in 0..quads(rows) {
                    let weights = |channel: usize| {
                        std::array::from_fn(|byte| depthwise.in_quad(channel, quad, byte))
                    };
                    packed.weights.push(Lanes(channels.map(weights)));
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
        moving_window!(STRIDE, column, done);
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
/// As [`super::dense_bytes`].
#[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512vnni")]
pub(in super::super) unsafe fn depthwise(
    depthwise: &Depthwise,
    row: &Row<'_>,
    to: &ToBytes,
    out: &mut [u8],
) {
    let &Depthwise { pitch, rows, .. } = depthwise;
    let stride = row.step / pitch;
    let most_split = strips(pitch).map(|(_, split)| split).max().unwrap_or(1);
    let least = if rows > TALL { FIVE_PIXELS } else { 1 };
    if depthwise.interleaved.starts.is_empty()
        || !depthwise.is_close(row.runs)
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
