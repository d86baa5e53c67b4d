//! Every kernel in plain Rust: for processors without one of their own, and for the layers that need no other.

use std::ops::Range;

use super::{Addition, BLOCK, Dense, Depthwise, Group, Part, Row, ToBytes};
use crate::engine::layer::{Between, Quantization, saturate};

/// Accumulators of one block of one pixel.
fn accumulate(
    dense: &Dense,
    row: &Row<'_>,
    pixel: usize,
    starts: &[i32],
    group: &Group,
) -> [i32; BLOCK] {
    let mut sums = [0; BLOCK];
    sums.copy_from_slice(starts);
    let mut quads = group
        .places
        .iter()
        .zip(dense.weights[group.weights..].chunks_exact(4 * BLOCK));
    for (run, &count) in row.runs.iter().zip(&group.counts) {
        let input = &row.input[row.base + run + pixel * row.step..][..dense.run];
        for (&place, weights) in quads.by_ref().take(count as usize) {
            let bytes = &input[place as usize..][..4];
            for (sum, weights) in sums.iter_mut().zip(weights.chunks_exact(4)) {
                for (&byte, &weight) in bytes.iter().zip(weights) {
                    *sum = sum.wrapping_add(i32::from(byte) * i32::from(weight));
                }
            }
        }
    }
    sums
}

/// Calls `store(pixel, lanes, accumulators)` for every block of every pixel.
fn dense(dense: &Dense, row: &Row<'_>, mut store: impl FnMut(usize, Range<usize>, &[i32; BLOCK])) {
    for (block, group) in dense.groups.iter().enumerate() {
        debug_assert_eq!(group.blocks, 1);
        let lanes = block * BLOCK..(block + 1) * BLOCK;
        for pixel in 0..row.pixels {
            let sums = accumulate(dense, row, pixel, &dense.starts[lanes.clone()], group);
            store(pixel, lanes.clone(), &sums);
        }
    }
}

pub(super) fn dense_bytes(
    packed: &Dense,
    row: &Row<'_>,
    to: &ToBytes,
    out: &mut [u8],
    pitch: usize,
) {
    dense(packed, row, |pixel, lanes, sums| {
        let out = &mut out[pixel * pitch..][lanes.clone()];
        for ((out, &sum), factor) in out.iter_mut().zip(sums).zip(&packed.factors[lanes]) {
            *out = saturate(sum as f32 * factor, to.zero, &to.range);
        }
    });
}

pub(super) fn dense_floats(packed: &Dense, row: &Row<'_>, out: &mut [f32]) {
    dense(packed, row, |pixel, lanes, sums| {
        for ((lane, &sum), factor) in lanes.clone().zip(sums).zip(&packed.factors[lanes]) {
            out[lane * row.pixels + pixel] = sum as f32 * factor;
        }
    });
}

pub(super) fn depthwise(packed: &Depthwise, row: &Row<'_>, to: &ToBytes, out: &mut [u8]) {
    for (pixel, out) in out
        .chunks_exact_mut(packed.pitch)
        .take(row.pixels)
        .enumerate()
    {
        for first in (0..packed.pitch).step_by(BLOCK) {
            let mut sums = [0; BLOCK];
            sums.copy_from_slice(&packed.starts[first..][..BLOCK]);
            for (tap, run) in row.runs.iter().enumerate() {
                let input = &row.input[row.base + run + pixel * row.step + first..][..BLOCK];
                let weights = &packed.weights[tap * packed.pitch + first..][..BLOCK];
                for ((sum, &byte), &weight) in sums.iter_mut().zip(input).zip(weights) {
                    *sum = sum.wrapping_add(i32::from(byte) * i32::from(weight));
                }
            }
            for ((out, sum), factor) in out[first..]
                .iter_mut()
                .zip(sums)
                .zip(&packed.factors[first..])
            {
                *out = saturate(sum as f32 * factor, to.zero, &to.range);
            }
        }
    }
}

pub(super) fn add(addition: &Addition, one: &[u8], other: &[u8], out: &mut [u8]) {
    let part = |byte: u8, input: usize| {
        (i32::from(byte) - i32::from(addition.zeros[input])) as f32 * addition.factors[input]
    };
    for ((out, &one), &other) in out.iter_mut().zip(one).zip(other) {
        *out = saturate(
            part(one, 0) + part(other, 1),
            addition.to.zero,
            &addition.to.range,
        );
    }
}

pub(super) fn quantize_four(planes: &[&[f32]], scale: f32, zero: u8, out: &mut [u8]) {
    quantize_row(
        |channel| planes[channel],
        planes.len(),
        Quantization { scale, zero },
        out,
        4,
    );
}

/// A row of planes of f32 as pixels of any pitch.
pub(crate) fn quantize_row<'a>(
    plane: impl Fn(usize) -> &'a [f32],
    channels: usize,
    quantization: Quantization,
    out: &mut [u8],
    pitch: usize,
) {
    out.fill(quantization.zero);
    for channel in 0..channels {
        for (pixel, &value) in out.chunks_exact_mut(pitch).zip(plane(channel)) {
            pixel[channel] = quantization.byte(value);
        }
    }
}

/// One channel of a row of pixels as f32.
pub(crate) fn dequantize_row(
    input: &[u8],
    channel: usize,
    pitch: usize,
    quantization: Quantization,
    out: &mut [f32],
) {
    for (out, pixel) in out.iter_mut().zip(input.chunks_exact(pitch)) {
        *out = quantization.real(pixel[channel]);
    }
}

/// One channel of a row of pixels as f32; where there is only one pixel, for all.
pub(crate) fn channel_row(
    input: &[u8],
    channel: usize,
    pitch: usize,
    quantization: Quantization,
    out: &mut [f32],
) {
    if input.len() == pitch {
        out.fill(quantization.real(input[channel]));
    } else {
        dequantize_row(input, channel, pitch, quantization, out);
    }
}

/// A row of f32 as one channel of a row of pixels.
pub(crate) fn store_channel(
    values: &[f32],
    channel: usize,
    pitch: usize,
    quantization: Quantization,
    out: &mut [u8],
) {
    for (pixel, &value) in out.chunks_exact_mut(pitch).zip(values) {
        pixel[channel] = quantization.byte(value);
    }
}

/// A row of steps, not yet rounded, as one channel of a row of pixels.
pub(crate) fn saturate_channel(
    steps: &[f32],
    channel: usize,
    pitch: usize,
    to: &ToBytes,
    out: &mut [u8],
) {
    // As in `multiply_row`.
    let (zero, range) = (to.zero, to.range.clone());
    for (pixel, &steps) in out.chunks_exact_mut(pitch).zip(steps) {
        pixel[channel] = saturate(steps, zero, &range);
    }
}

/// A row of pixels in other columns, through a table, and `fill` where there is none.
pub(crate) fn pad_row(
    input: &[u8],
    columns: &[Option<usize>],
    pitch: usize,
    fill: u8,
    table: &[u8; 256],
    out: &mut [u8],
) {
    for (column, out) in columns.iter().zip(out.chunks_exact_mut(pitch)) {
        match column {
            Some(column) => table_row(table, &input[column * pitch..][..pitch], out),
            None => out.fill(fill),
        }
    }
}

/// Row `y` of a tensor (channels, height, pitch) as channels of one pixel, `[channel][y][x]`, through a table.
pub(crate) fn flatten(
    table: &[u8; 256],
    input: &[u8],
    [channels, height, pitch]: [usize; 3],
    y: usize,
    out: &mut [u8],
) {
    let width = input.len() / pitch;
    for (x, pixel) in input.chunks_exact(pitch).enumerate() {
        for (channel, &byte) in pixel[..channels].iter().enumerate() {
            out[(channel * height + y) * width + x] = table[usize::from(byte)];
        }
    }
}

/// A row of pixels, each as one row of a square of pixels whose channels `sources` names, square column by square column, through a
/// table.
pub(crate) fn spread_row(
    input: &[u8],
    sources: &[usize],
    channels: usize,
    pitches: [usize; 2],
    table: &[u8; 256],
    out: &mut [u8],
) {
    let mut pixels = out.chunks_exact_mut(pitches[1]);
    for pixel in input.chunks_exact(pitches[0]) {
        for (sources, out) in sources.chunks_exact(channels).zip(&mut pixels) {
            for (out, &source) in out.iter_mut().zip(sources) {
                *out = table[usize::from(pixel[source])];
            }
        }
    }
}

/// A function of every byte.
fn table_row(table: &[u8; 256], input: &[u8], out: &mut [u8]) {
    for (out, &byte) in out.iter_mut().zip(input) {
        *out = table[usize::from(byte)];
    }
}

/// The product of two rows.
pub(crate) fn multiply_row(
    zeros: [u8; 2],
    factor: f32,
    to: &ToBytes,
    one: &[u8],
    other: &[u8],
    out: &mut [u8],
) {
    let [first, second] = zeros.map(i32::from);
    // Of one's own: what is behind references may change with every byte that is written, for all the compiler knows.
    let (zero, range) = (to.zero, to.range.clone());
    for ((out, &one), &other) in out.iter_mut().zip(one).zip(other) {
        let product = (i32::from(one) - first) * (i32::from(other) - second);
        *out = saturate(product as f32 * factor, zero, &range);
    }
}

/// Puts channels where `part` says, through a table.
pub(super) fn place_row(table: &[u8; 256], part: Part, input: &[u8], out: &mut [u8]) {
    let pixels = input.chunks_exact(part.pitches[0]);
    for (pixel, out) in pixels.zip(out.chunks_exact_mut(part.pitches[1])) {
        table_row(table, pixel, &mut out[part.first..][..part.channels]);
    }
}

/// Two input rows and the weight of the second.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Halves<'a> {
    pub(crate) rows: [&'a [u8]; 2],
    pub(crate) weight: f32,
}

/// A row of a resize to nearest pixels of a multiple of 16 bytes.
pub(crate) fn copy_row(input: &[u8], columns: &[Between], pitch: usize, out: &mut [u8]) {
    match pitch {
        16 => copy_pixels::<16>(input, columns, out),
        32 => copy_pixels::<32>(input, columns, out),
        48 => copy_pixels::<48>(input, columns, out),
        64 => copy_pixels::<64>(input, columns, out),
        _ => {
            for (column, out) in columns.iter().zip(out.chunks_exact_mut(pitch)) {
                out.copy_from_slice(&input[column.first * pitch..][..pitch]);
            }
        }
    }
}

/// The same where the compiler knows the length: a few loads and stores for each pixel instead of a call.
fn copy_pixels<const PITCH: usize>(input: &[u8], columns: &[Between], out: &mut [u8]) {
    let (input, _) = input.as_chunks::<PITCH>();
    let (out, _) = out.as_chunks_mut::<PITCH>();
    for (column, out) in columns.iter().zip(out) {
        *out = input[column.first];
    }
}

/// A row of a bilinear resize of pixels of a multiple of [`BLOCK`] bytes.
pub(crate) fn resize_row(
    halves: Halves<'_>,
    columns: &[Between],
    pitch: usize,
    zero: u8,
    factor: f32,
    to: &ToBytes,
    out: &mut [u8],
) {
    let zero = i32::from(zero);
    // As in `multiply_row`.
    let (to_zero, range) = (to.zero, to.range.clone());
    let down = [1.0 - halves.weight, halves.weight];
    for (column, out) in columns.iter().zip(out.chunks_exact_mut(pitch)) {
        let pixel = |row: usize, at: usize| {
            let pixel = &halves.rows[row][at * pitch..][..pitch];
            pixel.as_chunks::<BLOCK>().0
        };
        let right = [1.0 - column.weight, column.weight];
        let corners = |row| {
            pixel(row, column.first)
                .iter()
                .zip(pixel(row, column.second))
        };
        let blocks = out.as_chunks_mut::<BLOCK>().0.iter_mut();
        for ((out, upper), lower) in blocks.zip(corners(0)).zip(corners(1)) {
            for (lane, out) in out.iter_mut().enumerate() {
                let value = |pixel: &[u8; BLOCK]| (i32::from(pixel[lane]) - zero) as f32;
                let along = |(first, second): (&[u8; BLOCK], &[u8; BLOCK])| {
                    value(first) * right[0] + value(second) * right[1]
                };
                let between = along(upper) * down[0] + along(lower) * down[1];
                *out = saturate(between * factor, to_zero, &range);
            }
        }
    }
}

/// Greatest bytes of some pixels, through a table.
pub(crate) fn max_row<'a>(taps: impl Iterator<Item = &'a [u8]>, table: &[u8; 256], out: &mut [u8]) {
    out.fill(0);
    for pixel in taps {
        for (out, &byte) in out.iter_mut().zip(pixel) {
            *out = (*out).max(byte);
        }
    }
    for out in out {
        *out = table[usize::from(*out)];
    }
}

/// Sums of some pixels of a multiple of [`BLOCK`] bytes, times `factor`: the change of scale over their number.
pub(crate) fn average_row<'a>(
    taps: impl Iterator<Item = &'a [u8]> + Clone,
    zero: u8,
    factor: f32,
    to: &ToBytes,
    out: &mut [u8],
) {
    for (block, out) in out.as_chunks_mut::<BLOCK>().0.iter_mut().enumerate() {
        // Of more than 2^23 bytes: a mean of all of a large picture.
        let mut sums = [0_i64; BLOCK];
        for pixel in taps.clone() {
            for (sum, &byte) in sums.iter_mut().zip(&pixel.as_chunks::<BLOCK>().0[block]) {
                *sum += i64::from(byte) - i64::from(zero);
            }
        }
        for (out, sum) in out.iter_mut().zip(sums) {
            *out = saturate(sum as f32 * factor, to.zero, &to.range);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Between, copy_row};

    /// Pixels of lengths that have code of their own, and of one that has not.
    #[test]
    fn resize_to_nearest_copies_whole_pixels() {
        for pitch in [16, 32, 48, 64, 80] {
            let input: Vec<u8> = (0..3 * pitch).map(|at| at as u8).collect();
            let columns = [2, 0, 0, 1].map(|first| Between {
                first,
                second: first,
                weight: 0.0,
            });
            let mut out = vec![0; columns.len() * pitch];
            copy_row(&input, &columns, pitch, &mut out);
            let expected = columns
                .iter()
                .flat_map(|c| &input[c.first * pitch..][..pitch]);
            assert!(out.iter().eq(expected), "{pitch} bytes a pixel");
        }
    }
}
