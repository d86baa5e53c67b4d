//! Resampling of 8-bit pictures in integers, row by row: the same bytes on every processor, and no allocation.
//!
//! The filter is a triangle as wide as the reduction, so that nothing aliases: input pixel `i` weighs
//! `max(0, 1 - |i + 1/2 - c| / r)`, `c` the output pixel's centre among the input pixels, `r` input pixels per output
//! pixel, at least 1; weights are normalised over those that lie in the picture. The region's neighbours count where
//! the picture has them.
//!
//! Weights are multiples of 2^-14: differences of their running sums, rounded, so that they sum to one. Along the columns (over rows of the picture) first:
//! sums rounded (halves up) to 2^-7 of a step; then along the rows: sums rounded (halves up) to whole steps. A result is the
//! exact filter's within 1/2 + 1/256 steps, and 255 steps times 2^-14 for every two weights of either pass.
//!
//! All formats have three values a pixel from between the passes on, chroma that of the pixels that share it. Luma and chroma become colours after the second
//! pass, at the network's size: there are fewer pixels then.

use std::ops::Range;

use crate::Size;
use crate::pixel_format::{Picture, Plane};
use crate::preprocess::Placement;
use crate::vectors::{Loops, widest};

/// Fraction bits of a weight.
const WEIGHT_BITS: u32 = 14;
/// Fraction bits between the two passes.
const BETWEEN_BITS: u32 = 7;
/// Values that the first pass makes at a time.
const CHUNK: usize = 32;

/// Which input pixels make each output pixel of an axis, and how much of each.
#[derive(Debug)]
struct Axis {
    /// Weights of an output pixel; those that it does not need are 0.
    taps: usize,
    /// The first input pixel of each output pixel; all `taps` of them lie in the picture.
    firsts: Vec<usize>,
    /// `[outputs][taps]`.
    weights: Vec<i32>,
}

impl Axis {
    /// From the part of `region` pixels from `start` on, of a picture of `length` pixels, to `outputs` pixels.
    fn new(length: usize, start: f64, region: f64, outputs: usize) -> Self {
        let step = region / outputs as f64;
        let reach = step.max(1.0);
        let centre = |output: usize| start + (output as f64 + 0.5) * step;
        let weight = |output: usize, input: usize| {
            (1.0 - (input as f64 + 0.5 - centre(output)).abs() / reach).max(0.0)
        };
        let ends = |output: usize| {
            let first = (centre(output) - reach).max(0.0) as usize;
            let end = ((centre(output) + reach).ceil() as usize).min(length);
            let used = |&input: &usize| weight(output, input) > 0.0;
            let first = (first..end).find(used).unwrap_or(first);
            (first, (first..end).rfind(used).unwrap_or(first) + 1)
        };
        let taps = (0..outputs)
            .map(ends)
            .map(|(first, end)| end - first)
            .max()
            .unwrap_or(1);
        let mut axis = Self {
            taps,
            firsts: Vec::new(),
            weights: Vec::new(),
        };
        for output in 0..outputs {
            let first = ends(output).0.min(length - taps);
            let exact: Vec<f64> = (first..first + taps)
                .map(|input| weight(output, input))
                .collect();
            let total: f64 = exact.iter().sum();
            let (mut exact_sum, mut sum) = (0.0, 0);
            for weight in &exact {
                exact_sum += weight / total;
                let rounded = (exact_sum * f64::from(1 << WEIGHT_BITS)).round() as i32;
                axis.weights.push(rounded - sum);
                sum = rounded;
            }
            axis.firsts.push(first);
        }
        axis
    }
}

/// Memory for resampling a row.
#[derive(Debug)]
pub(crate) struct Scratch {
    /// What the first pass makes of the first plane and the second, where a pixel is not three values of the first already.
    planes: [Vec<i16>; 2],
    /// What the second pass reads: three values a pixel.
    between: Vec<i16>,
    /// What the second makes: red, green, blue and a byte without meaning.
    pixels: Vec<[u8; 4]>,
}

/// Resamples pictures of one size at one placement.
#[derive(Debug)]
pub(crate) struct Resampler {
    columns: Axis,
    rows: Axis,
    /// The rows of a plane with half as many.
    half_rows: Axis,
    /// Columns of the picture that are read; the first is even.
    read: Range<usize>,
}

impl Resampler {
    /// For pictures of the size `picture`.
    pub(crate) fn new(picture: Size, placement: &Placement) -> Self {
        let Placement {
            left,
            top,
            region,
            network,
        } = *placement;
        let axis = |length: u32, start, region, outputs| {
            Axis::new(length as usize, start, region, outputs as usize)
        };
        let [left, top, width, height] = [left, top, region.0, region.1].map(f64::from);
        let columns = axis(picture.0, left, width, network.0);
        let first = columns.firsts.iter().copied().min().unwrap_or(0);
        let last = columns.firsts.iter().copied().max().unwrap_or(0);
        Self {
            read: first & !1..last + columns.taps,
            columns,
            rows: axis(picture.1, top, height, network.1),
            half_rows: axis(picture.1.div_ceil(2), top / 2.0, height / 2.0, network.1),
        }
    }

    /// Pairs of neighbouring pixels that are read of a row; of the last there may be one alone.
    fn pairs(&self) -> usize {
        self.read.len().div_ceil(2)
    }

    /// Memory for [`Resampler::row`].
    pub(crate) fn scratch(&self) -> Scratch {
        let pairs = self.pairs();
        Scratch {
            planes: [vec![0; 8 * pairs], vec![0; 2 * pairs]],
            // A pixel is read as four values, the last of which may be beyond the end.
            between: vec![0; 6 * pairs + 1],
            pixels: vec![[0; 4]; self.columns.firsts.len()],
        }
    }

    /// The pixels of the output's row `y`: red, green, blue, and a byte without meaning.
    ///
    /// # Panics
    /// Where `picture` is not of the size that this was made for, `scratch` is another resampler's, or there is no row `y`.
    pub(crate) fn row<'s>(
        &self,
        picture: &Picture<'_>,
        y: usize,
        scratch: &'s mut Scratch,
    ) -> &'s [[u8; 4]] {
        widest(Row {
            resampler: self,
            picture,
            y,
            scratch,
        });
        &scratch.pixels
    }

    /// Both passes.
    #[inline(always)]
    fn passes(&self, picture: &Picture<'_>, y: usize, scratch: &mut Scratch) {
        let Scratch {
            planes: [first, second],
            between,
            pixels,
        } = scratch;
        let format = picture.format();
        let target = match format.is_triple() {
            true => &mut *between,
            false => first,
        };
        let axes = [&self.rows, &self.half_rows];
        let targets = [target, second];
        let sizes = format.planes(picture.size());
        let pair_bytes = [format.pair_bytes(), 2];
        for index in 0..2 {
            let (row, rows) = sizes[index];
            if rows > 0 {
                // Of the last pair there may be no second pixel.
                let start = self.read.start / 2 * pair_bytes[index];
                let end = (start + self.pairs() * pair_bytes[index]).min(row as usize);
                let plane = &picture.planes()[index];
                self.down(axes[index], plane, start..end, y, targets[index]);
            }
        }
        format.triples(first, second, between);
        // As many loops as there are usual numbers of taps, so that each is straight code.
        match self.columns.taps {
            1 => self.along::<1>(between, pixels),
            2 => self.along::<2>(between, pixels),
            3 => self.along::<3>(between, pixels),
            4 => self.along::<4>(between, pixels),
            5 => self.along::<5>(between, pixels),
            6 => self.along::<6>(between, pixels),
            _ => self.along::<0>(between, pixels),
        }
        format.colours(pixels);
    }

    /// The first pass: of `read`, bytes of a row of the plane, one row of the output's height.
    #[inline(always)]
    fn down(&self, axis: &Axis, plane: &Plane<'_>, read: Range<usize>, y: usize, out: &mut [i16]) {
        let Axis {
            taps,
            firsts,
            weights,
        } = axis;
        let weights = &weights[y * taps..][..*taps];
        let length = read.len();
        let row =
            |tap: usize| &plane.bytes[(firsts[y] + tap) * plane.stride + read.start..][..length];
        let half = 1 << (WEIGHT_BITS - BETWEEN_BITS - 1);
        let done = |sum: i32| (sum >> (WEIGHT_BITS - BETWEEN_BITS)) as i16;
        let (chunks, rest) = out[..length].as_chunks_mut::<CHUNK>();
        for (chunk, out) in chunks.iter_mut().enumerate() {
            let mut sums = [half; CHUNK];
            for (tap, &weight) in weights.iter().enumerate() {
                for (sum, &byte) in sums.iter_mut().zip(&row(tap)[chunk * CHUNK..][..CHUNK]) {
                    *sum += weight * i32::from(byte);
                }
            }
            for (value, sum) in out.iter_mut().zip(sums) {
                *value = done(sum);
            }
        }
        for (at, out) in (length - rest.len()..).zip(rest) {
            let mut sum = half;
            for (tap, &weight) in weights.iter().enumerate() {
                sum += weight * i32::from(row(tap)[at]);
            }
            *out = done(sum);
        }
    }

    /// The second pass, of `TAPS` weights, or of any number. A pixel is four values, since four make a vector; the last
    /// of them is its neighbour's and without meaning.
    #[inline(always)]
    fn along<const TAPS: usize>(&self, between: &[i16], pixels: &mut [[u8; 4]]) {
        let taps = if TAPS == 0 { self.columns.taps } else { TAPS };
        let outputs = self
            .columns
            .firsts
            .iter()
            .zip(self.columns.weights.chunks_exact(taps));
        for (pixel, (&first, weights)) in pixels.iter_mut().zip(outputs) {
            let mut sums = [1 << (WEIGHT_BITS + BETWEEN_BITS - 1); 4];
            let window = &between[(first - self.read.start) * 3..][..3 * taps + 1];
            for (tap, &weight) in weights.iter().enumerate() {
                for (sum, &value) in sums.iter_mut().zip(&window[3 * tap..3 * tap + 4]) {
                    *sum += weight * i32::from(value);
                }
            }
            for (byte, sum) in pixel.iter_mut().zip(sums) {
                *byte = (sum >> (WEIGHT_BITS + BETWEEN_BITS)) as u8;
            }
        }
    }
}

/// A row to resample.
struct Row<'a> {
    resampler: &'a Resampler,
    picture: &'a Picture<'a>,
    y: usize,
    scratch: &'a mut Scratch,
}

impl Loops for Row<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        self.resampler.passes(self.picture, self.y, self.scratch);
    }
}

#[cfg(test)]
#[allow(clippy::expect_used)]
mod tests {
    use super::*;
    use crate::pixel_format::{PixelFormat, Yuv};

    /// Bytes without pattern.
    fn noise(length: usize) -> Vec<u8> {
        let mut state = 1_u32;
        (0..length)
            .map(|_| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (state >> 24) as u8
            })
            .collect()
    }

    fn resampled(picture: &Picture<'_>, placement: &Placement) -> Vec<[u8; 3]> {
        let resampler = Resampler::new(picture.size(), placement);
        let mut scratch = resampler.scratch();
        let mut pixels = Vec::new();
        for y in 0..placement.network.1 as usize {
            let row = resampler.row(picture, y, &mut scratch);
            pixels.extend(row.iter().map(|&[red, green, blue, _]| [red, green, blue]));
        }
        pixels
    }

    /// Weights of an axis as the filter's definition has them, for every input pixel.
    fn exact_weights(length: u32, start: f64, region: f64, outputs: u32) -> Vec<Vec<f64>> {
        let step = region / f64::from(outputs);
        let weights = |output: u32| {
            let centre = start + (f64::from(output) + 0.5) * step;
            let weight = |input: u32| {
                (1.0 - ((f64::from(input) + 0.5 - centre) / step.max(1.0)).abs()).max(0.0)
            };
            let sum: f64 = (0..length).map(weight).sum();
            (0..length).map(|input| weight(input) / sum).collect()
        };
        (0..outputs).map(weights).collect()
    }

    /// Weights of the columns and of the rows.
    fn exact_axes(size: Size, placement: &Placement) -> [Vec<Vec<f64>>; 2] {
        let Placement {
            left,
            top,
            region,
            network,
        } = *placement;
        let exact = |length, start: u32, region: u32, outputs| {
            exact_weights(length, start.into(), region.into(), outputs)
        };
        [
            exact(size.0, left, region.0, network.0),
            exact(size.1, top, region.1, network.1),
        ]
    }

    /// What the module says of the difference to the exact filter's results.
    fn bound(columns: &[Vec<f64>], rows: &[Vec<f64>]) -> f64 {
        let used = |weights: &[Vec<f64>]| {
            let used = |w: &Vec<f64>| w.iter().filter(|&&w| w > 0.0).count();
            weights
                .iter()
                .map(used)
                .max()
                .map_or(0.0, |taps| taps as f64)
        };
        0.5 + 1.0 / 256.0 + 255.0 / 16384.0 * (used(columns) + used(rows)) / 2.0
    }

    /// Sizes of pictures, and placements within them: reduced, cropped, enlarged, by odd numbers.
    fn placements() -> Vec<(Size, Placement)> {
        [
            ((50, 40), 0, 0, (50, 40), (25, 20)),
            ((53, 41), 0, 0, (53, 41), (27, 19)),
            ((53, 41), 7, 5, (31, 30), (16, 9)),
            ((20, 15), 3, 4, (10, 11), (33, 40)),
            ((90, 70), 0, 10, (90, 60), (5, 60)),
            ((3, 90), 0, 0, (3, 90), (3, 1)),
            ((1, 1), 0, 0, (1, 1), (32, 32)),
        ]
        .map(|(picture, left, top, region, network)| {
            let placement = Placement {
                left,
                top,
                region,
                network,
            };
            (picture, placement)
        })
        .into()
    }

    /// Calls `check(x, y, pixel)` for each of the results.
    fn each(
        picture: &Picture<'_>,
        placement: &Placement,
        mut check: impl FnMut(usize, usize, [u8; 3]),
    ) {
        let pixels = resampled(picture, placement);
        assert_eq!(
            pixels.len() as u32,
            placement.network.0 * placement.network.1
        );
        for (at, pixel) in pixels.into_iter().enumerate() {
            let width = placement.network.0 as usize;
            check(at % width, at / width, pixel);
        }
    }

    #[test]
    fn results_are_the_exact_filters_within_what_the_module_says() {
        for (size, placement) in placements() {
            let rgb = noise(3 * size.0 as usize * size.1 as usize);
            let picture = Picture::new(size, &rgb).expect("a picture");
            let [columns, rows] = exact_axes(size, &placement);
            let bound = bound(&columns, &rows);
            each(&picture, &placement, |x, y, pixel| {
                for (colour, &byte) in pixel.iter().enumerate() {
                    let mut exact = 0.0;
                    for (v, row) in rows[y].iter().enumerate() {
                        for (u, column) in columns[x].iter().enumerate() {
                            let byte = rgb[(v * size.0 as usize + u) * 3 + colour];
                            exact += row * column * f64::from(byte);
                        }
                    }
                    let difference = (f64::from(byte) - exact).abs();
                    assert!(
                        difference <= bound,
                        "{placement:?} ({x}, {y}): {byte} {exact}"
                    );
                }
            });
        }
    }

    /// Rows of these bytes, with padding of noise between them but not after the last.
    fn padded(bytes: &[u8], row: usize, padding: usize) -> (Vec<u8>, usize) {
        let mut out = Vec::new();
        for (index, bytes) in bytes.chunks_exact(row).enumerate() {
            if index > 0 {
                out.extend(noise(padding));
            }
            out.extend(bytes);
        }
        (out, row + padding)
    }

    #[test]
    fn orders_of_colours_and_padding_change_nothing() {
        for (size, placement) in placements() {
            let rgb = noise(3 * size.0 as usize * size.1 as usize);
            let (pixels, _) = rgb.as_chunks::<3>();
            let picture = Picture::new(size, &rgb).expect("a picture");
            let expected = resampled(&picture, &placement);
            let formats: [(PixelFormat, Vec<u8>); 4] = [
                (PixelFormat::Rgb, rgb.clone()),
                (
                    PixelFormat::Bgr,
                    pixels.iter().flat_map(|&[r, g, b]| [b, g, r]).collect(),
                ),
                (
                    PixelFormat::Rgbx,
                    pixels
                        .iter()
                        .flat_map(|&[r, g, b]| [r, g, b, r ^ b])
                        .collect(),
                ),
                (
                    PixelFormat::Bgrx,
                    pixels
                        .iter()
                        .flat_map(|&[r, g, b]| [b, g, r, r ^ b])
                        .collect(),
                ),
            ];
            for (format, bytes) in formats {
                let (row, _) = format.planes(size)[0];
                let (bytes, stride) = padded(&bytes, row as usize, 5);
                let plane = Plane {
                    bytes: &bytes,
                    stride,
                };
                let picture = Picture::with_format(size, format, &[plane]).expect("a picture");
                assert!(
                    resampled(&picture, &placement) == expected,
                    "{format:?} {placement:?}"
                );
            }
            let greys: Vec<u8> = rgb.iter().copied().step_by(3).collect();
            let tripled: Vec<u8> = greys.iter().flat_map(|&grey| [grey; 3]).collect();
            let (greys, stride) = padded(&greys, size.0 as usize, 3);
            let plane = Plane {
                bytes: &greys,
                stride,
            };
            let grey = Picture::with_format(size, PixelFormat::Grey, &[plane]).expect("a picture");
            let tripled = Picture::new(size, &tripled).expect("a picture");
            assert!(resampled(&grey, &placement) == resampled(&tripled, &placement));
        }
    }

    /// Red, green, blue of luma and chroma, by the recommendations' definition of these; not held within 0 to 255.
    fn exact_colours(yuv: Yuv, [y, cb, cr]: [f64; 3]) -> [f64; 3] {
        let (kr, kg, kb) = match yuv {
            Yuv::Bt601Limited | Yuv::Bt601Full => (0.299, 0.587, 0.114),
            Yuv::Bt709Limited | Yuv::Bt709Full => (0.2126, 0.7152, 0.0722),
        };
        let (y, cb, cr) = match yuv {
            Yuv::Bt601Limited | Yuv::Bt709Limited => (
                (y - 16.0) / 219.0,
                (cb - 128.0) / 224.0,
                (cr - 128.0) / 224.0,
            ),
            Yuv::Bt601Full | Yuv::Bt709Full => {
                (y / 255.0, (cb - 128.0) / 255.0, (cr - 128.0) / 255.0)
            }
        };
        let (red, blue) = (y + 2.0 * (1.0 - kr) * cr, y + 2.0 * (1.0 - kb) * cb);
        [red, (y - kr * red - kb * blue) / kg, blue].map(|value| 255.0 * value)
    }

    const YUV: [Yuv; 4] = [
        Yuv::Bt601Limited,
        Yuv::Bt601Full,
        Yuv::Bt709Limited,
        Yuv::Bt709Full,
    ];

    #[test]
    fn luma_and_chroma_are_the_exact_filters_and_colours() {
        for ((size, placement), yuv) in placements().into_iter().zip(YUV.into_iter().cycle()) {
            let [columns, rows] = exact_axes(size, &placement);
            let (half, top) = (size.1.div_ceil(2), f64::from(placement.top));
            let height = f64::from(placement.region.1);
            let half_rows = exact_weights(half, top / 2.0, height / 2.0, placement.network.1);
            let exact = |rows: &[f64], x: usize, byte: &dyn Fn(usize, usize) -> u8| {
                let mut sum = 0.0;
                for (v, row) in rows.iter().enumerate() {
                    for (u, column) in columns[x].iter().enumerate() {
                        sum += row * column * f64::from(byte(u, v));
                    }
                }
                sum
            };
            for format in [
                PixelFormat::Yuyv(yuv),
                PixelFormat::Uyvy(yuv),
                PixelFormat::Nv12(yuv),
            ] {
                let made = format.planes(size).map(|(row, rows)| {
                    let bytes = noise((row * rows) as usize);
                    match row {
                        0 => (bytes, 0),
                        _ => padded(&bytes, row as usize, 7),
                    }
                });
                let [first, second] = [0, 1].map(|index| Plane {
                    bytes: &made[index].0,
                    stride: made[index].1,
                });
                let is_nv12 = matches!(format, PixelFormat::Nv12(_));
                let planes = match is_nv12 {
                    true => vec![first, second],
                    false => vec![first],
                };
                let picture = Picture::with_format(size, format, &planes).expect("a picture");
                let at = |plane: &Plane<'_>, u: usize, v: usize| plane.bytes[v * plane.stride + u];
                let (luma_at, cb_at, cr_at) = match format {
                    PixelFormat::Uyvy(_) => (1, 0, 2),
                    _ => (0, 1, 3),
                };
                let byte = |component: usize, u: usize, v: usize| match (component, is_nv12) {
                    (0, true) => at(&first, u, v),
                    (0, false) => at(&first, 2 * u + luma_at, v),
                    (component, true) => at(&second, u / 2 * 2 + component - 1, v),
                    (1, false) => at(&first, u / 2 * 4 + cb_at, v),
                    (_, false) => at(&first, u / 2 * 4 + cr_at, v),
                };
                let chroma_rows = match is_nv12 {
                    true => &half_rows,
                    false => &rows,
                };
                let (of_luma, of_chroma) = (bound(&columns, &rows), bound(&columns, chroma_rows));
                // The largest factors are 255 / 219 and, of chroma, 2.12; the factors' own rounding is below 0.02 of a step.
                let bound = 1.165 * of_luma + 2.12 * of_chroma + 0.5 + 0.02;
                each(&picture, &placement, |x, y, pixel| {
                    let components = [0, 1, 2].map(|component| {
                        let rows = if component == 0 { &rows } else { chroma_rows };
                        exact(&rows[y], x, &|u, v| byte(component, u, v))
                    });
                    let exact = exact_colours(yuv, components).map(|value| value.clamp(0.0, 255.0));
                    for (byte, exact) in pixel.into_iter().zip(exact) {
                        assert!(
                            (f64::from(byte) - exact).abs() <= bound,
                            "{format:?} {placement:?} ({x}, {y}): {pixel:?} {exact}"
                        );
                    }
                });
            }
        }
    }

    /// Where nothing is resampled, the colours of luma and chroma are exact to rounding; those of colour bars as published (ITU-R BT.601
    /// and BT.709 at 100 %, JFIF).
    #[test]
    fn colours_of_luma_and_chroma() {
        let convert = |yuv, [y, cb, cr]: [u8; 3]| {
            let bytes = [y, cb, y, cr];
            let plane = Plane {
                bytes: &bytes,
                stride: 4,
            };
            let picture =
                Picture::with_format((2, 1), PixelFormat::Yuyv(yuv), &[plane]).expect("a picture");
            let placement = Placement {
                left: 0,
                top: 0,
                region: (2, 1),
                network: (2, 1),
            };
            resampled(&picture, &placement)[1]
        };
        for (yuv, components, colours) in [
            (Yuv::Bt601Limited, [235, 128, 128], [255, 255, 255]),
            (Yuv::Bt601Limited, [16, 128, 128], [0, 0, 0]),
            (Yuv::Bt601Limited, [81, 90, 240], [255, 0, 0]),
            (Yuv::Bt601Limited, [145, 54, 34], [0, 255, 0]),
            (Yuv::Bt601Limited, [41, 240, 110], [0, 0, 255]),
            (Yuv::Bt709Limited, [63, 102, 240], [255, 0, 0]),
            (Yuv::Bt709Limited, [173, 42, 26], [0, 255, 0]),
            (Yuv::Bt709Limited, [32, 240, 118], [0, 0, 255]),
            (Yuv::Bt601Full, [76, 85, 255], [255, 0, 0]),
            (Yuv::Bt601Full, [150, 44, 21], [0, 255, 0]),
            (Yuv::Bt601Full, [29, 255, 107], [0, 0, 255]),
            (Yuv::Bt709Full, [255, 128, 128], [255, 255, 255]),
        ] {
            let got = convert(yuv, components);
            let near = got.iter().zip(colours).all(|(&a, b)| a.abs_diff(b) <= 2);
            assert!(near, "{yuv:?} {components:?}: {got:?} {colours:?}");
        }
        for (yuv, state) in YUV.into_iter().zip(1..) {
            for components in noise(30_000).as_chunks::<3>().0 {
                let components = components.map(|c| c.wrapping_mul(state));
                let exact = exact_colours(yuv, components.map(f64::from));
                for (byte, exact) in convert(yuv, components).into_iter().zip(exact) {
                    let difference = (f64::from(byte) - exact.clamp(0.0, 255.0)).abs();
                    assert!(difference <= 0.52, "{yuv:?} {components:?}: {byte} {exact}");
                }
            }
        }
    }

    #[test]
    fn one_colour_stays_that_colour() {
        for network in [(640, 192), (7, 5), (100, 300)] {
            let placement = Placement {
                left: 2,
                top: 1,
                region: (120, 60),
                network,
            };
            let rgb = [255, 0, 254].repeat(125 * 61);
            let picture = Picture::new((125, 61), &rgb).expect("a picture");
            let pixels = resampled(&picture, &placement);
            assert!(pixels.iter().all(|&pixel| pixel == [255, 0, 254]));
        }
    }
}
