//! Resampling of 8-bit RGB pictures in integers, row by row: the same bytes on every processor, and no allocation.
//!
//! The filter is a triangle as wide as the reduction, so that nothing aliases: input pixel `i` weighs
//! `max(0, 1 - |i + 1/2 - c| / r)`, `c` the output pixel's centre among the input pixels, `r` input pixels per output
//! pixel, at least 1; weights are normalised over those that lie in the picture. The region's neighbours count where
//! the picture has them.
//!
//! Weights are multiples of 2^-14: differences of their running sums, rounded, so that they sum to one. Along the columns (over rows of the picture) first:
//! sums rounded (halves up) to 2^-7 of a step; then along the rows: sums rounded (halves up) to whole steps. A result is the
//! exact filter's within 1/2 + 1/256 steps, and 255 steps times 2^-14 for every two weights of either pass.

use crate::Size;
use crate::preprocess::Placement;

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
    fn new(length: usize, start: usize, region: usize, outputs: usize) -> Self {
        let step = region as f64 / outputs as f64;
        let reach = step.max(1.0);
        let centre = |output: usize| start as f64 + (output as f64 + 0.5) * step;
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
    /// What the first pass makes.
    between: Vec<i16>,
    /// What the second makes: red, green, blue and a byte without meaning.
    pixels: Vec<[u8; 4]>,
}

/// Resamples pictures of one size at one placement.
#[derive(Debug)]
pub(crate) struct Resampler {
    /// Of the picture, pixels.
    width: usize,
    columns: Axis,
    rows: Axis,
    /// Columns of the picture that are read.
    read: std::ops::Range<usize>,
}

impl Resampler {
    /// For pictures of the size `picture`.
    pub(crate) fn new(picture: Size, placement: &Placement) -> Self {
        let axis = |length, start, region, outputs| {
            Axis::new(
                length as usize,
                start as usize,
                region as usize,
                outputs as usize,
            )
        };
        let Placement {
            left,
            top,
            region,
            network,
        } = *placement;
        let columns = axis(picture.0, left, region.0, network.0);
        let rows = axis(picture.1, top, region.1, network.1);
        let read = columns.firsts.iter().copied().min().unwrap_or(0)
            ..columns.firsts.iter().copied().max().unwrap_or(0) + columns.taps;
        Self {
            width: picture.0 as usize,
            columns,
            rows,
            read,
        }
    }

    /// Memory for [`Resampler::row`].
    pub(crate) fn scratch(&self) -> Scratch {
        Scratch {
            // A pixel is read as four values, the last of which may be beyond the end.
            between: vec![0; 3 * self.read.len() + 1],
            pixels: vec![[0; 4]; self.columns.firsts.len()],
        }
    }

    /// Calls `put(x, red green blue)` for every pixel of the output's row `y`.
    ///
    /// # Panics
    /// Where `rgb` is not of the picture's size, `scratch` is another resampler's, or there is no row `y`.
    #[inline(always)]
    pub(crate) fn row(
        &self,
        rgb: &[u8],
        y: usize,
        scratch: &mut Scratch,
        mut put: impl FnMut(usize, [u8; 3]),
    ) {
        let Scratch { between, pixels } = scratch;
        self.down(rgb, y, between);
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
        for (x, &[red, green, blue, _]) in pixels.iter().enumerate() {
            put(x, [red, green, blue]);
        }
    }

    /// The first pass: one row of the picture's width and the output's height.
    #[inline(always)]
    fn down(&self, rgb: &[u8], y: usize, between: &mut [i16]) {
        let Axis {
            taps,
            firsts,
            weights,
        } = &self.rows;
        let weights = &weights[y * taps..][..*taps];
        let length = 3 * self.read.len();
        let row =
            |tap: usize| &rgb[((firsts[y] + tap) * self.width + self.read.start) * 3..][..length];
        let half = 1 << (WEIGHT_BITS - BETWEEN_BITS - 1);
        let done = |sum: i32| (sum >> (WEIGHT_BITS - BETWEEN_BITS)) as i16;
        let (chunks, rest) = between[..length].as_chunks_mut::<CHUNK>();
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

#[cfg(test)]
mod tests {
    use super::*;

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

    fn resampled(picture: Size, placement: &Placement, rgb: &[u8]) -> Vec<[u8; 3]> {
        let resampler = Resampler::new(picture, placement);
        let mut scratch = resampler.scratch();
        let mut pixels = Vec::new();
        for y in 0..placement.network.1 as usize {
            resampler.row(rgb, y, &mut scratch, |_, pixel| pixels.push(pixel));
        }
        pixels
    }

    /// Weights of an axis as the filter's definition has them, for every input pixel.
    fn exact_weights(length: u32, start: u32, region: u32, outputs: u32) -> Vec<Vec<f64>> {
        let step = f64::from(region) / f64::from(outputs);
        let weights = |output: u32| {
            let centre = f64::from(start) + (f64::from(output) + 0.5) * step;
            let weight = |input: u32| {
                (1.0 - ((f64::from(input) + 0.5 - centre) / step.max(1.0)).abs()).max(0.0)
            };
            let sum: f64 = (0..length).map(weight).sum();
            (0..length).map(|input| weight(input) / sum).collect()
        };
        (0..outputs).map(weights).collect()
    }

    #[test]
    fn results_are_the_exact_filters_within_what_the_module_says() {
        for (picture, left, top, region, network) in [
            ((50, 40), 0, 0, (50, 40), (25, 20)),
            ((53, 41), 0, 0, (53, 41), (27, 19)),
            ((53, 41), 7, 5, (31, 30), (16, 9)),
            ((20, 15), 3, 4, (10, 11), (33, 40)),
            ((90, 70), 0, 10, (90, 60), (5, 60)),
            ((3, 90), 0, 0, (3, 90), (3, 1)),
            ((1, 1), 0, 0, (1, 1), (32, 32)),
        ] {
            let placement = Placement {
                left,
                top,
                region,
                network,
            };
            let rgb = noise(3 * picture.0 as usize * picture.1 as usize);
            let columns = exact_weights(picture.0, left, region.0, network.0);
            let rows = exact_weights(picture.1, top, region.1, network.1);
            let used = |weights: &[Vec<f64>]| {
                let used = |w: &Vec<f64>| w.iter().filter(|&&w| w > 0.0).count();
                weights
                    .iter()
                    .map(used)
                    .max()
                    .map_or(0.0, |taps| taps as f64)
            };
            let bound = 0.5 + 1.0 / 256.0 + 255.0 / 16384.0 * (used(&columns) + used(&rows)) / 2.0;
            for (at, pixel) in resampled(picture, &placement, &rgb).into_iter().enumerate() {
                let (x, y) = (at % network.0 as usize, at / network.0 as usize);
                for (colour, &byte) in pixel.iter().enumerate() {
                    let mut exact = 0.0;
                    for (v, row) in rows[y].iter().enumerate() {
                        for (u, column) in columns[x].iter().enumerate() {
                            let byte = rgb[(v * picture.0 as usize + u) * 3 + colour];
                            exact += row * column * f64::from(byte);
                        }
                    }
                    let difference = (f64::from(byte) - exact).abs();
                    assert!(
                        difference <= bound,
                        "{placement:?} ({x}, {y}): {byte} {exact}"
                    );
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
            let pixels = resampled((125, 61), &placement, &[255, 0, 254].repeat(125 * 61));
            assert!(pixels.iter().all(|&pixel| pixel == [255, 0, 254]));
        }
    }
}
