//! Convolutions made ready: weights packed, and where the input's bytes under a window lie.

use super::super::kernels::{Dense, Depthwise, Kernel};
use super::super::layer::{Convolution, Form, Quantization};
use super::buffer::Buffer;

/// Packs a depthwise convolution, and says where its taps are.
pub(super) fn depthwise(
    kernel: Kernel,
    convolution: &Convolution,
    from: Quantization,
    form: &Form,
    input: &Buffer,
) -> (Depthwise, Vec<usize>) {
    let window = &convolution.window;
    let parts = parts(convolution, i8::MIN);
    let [rows, columns] = window.kernel;
    let taps = (0..parts * rows).flat_map(|row| {
        (0..columns).map(move |column| {
            row % rows * window.dilations[0] * input.row_bytes()
                + column * window.dilations[1] * input.pitch
        })
    });
    // A part's filter follows the other's, as more rows of taps.
    let filters: Vec<i8> = (0..convolution.outputs)
        .flat_map(|output| {
            (0..parts).flat_map(move |number| {
                let filter = convolution.filter(output);
                filter
                    .iter()
                    .map(move |&weight| part(weight, number, i8::MIN))
            })
        })
        .collect();
    let packed = Depthwise::new(
        kernel,
        input.pitch,
        [parts * rows, columns],
        &filters,
        &convolution.starts(from),
        &convolution.factors(from, form),
    );
    (packed, taps.collect())
}

/// Packs convolutions that read the same pixels, one after the other, and says where their runs are.
pub(super) fn dense(
    kernel: Kernel,
    convolutions: &[&Convolution],
    from: Quantization,
    form: &Form,
    input: &Buffer,
) -> (Dense, Vec<usize>) {
    let Convolution { window, inputs, .. } = convolutions[0];
    let (starts, factors): (Vec<_>, Vec<_>) = convolutions
        .iter()
        .map(|c| (c.starts(from), c.factors(from, form)))
        .unzip();
    let [rows, columns] = window.kernel;
    let channels = inputs.next_multiple_of(4);
    let least = kernel.least_weight();
    let parts = convolutions
        .iter()
        .map(|c| parts(c, least))
        .max()
        .unwrap_or(1);
    // Neighbouring taps of a row are neighbours in memory: one run.
    let (runs, run): (Vec<usize>, usize) = if window.dilations[1] == 1 {
        let starts = (0..rows).map(|row| row * window.dilations[0] * input.row_bytes());
        (starts.collect(), (columns - 1) * input.pitch + channels)
    } else {
        let starts = (0..rows * columns).map(|tap| {
            tap / columns * window.dilations[0] * input.row_bytes()
                + tap % columns * window.dilations[1] * input.pitch
        });
        (starts.collect(), channels)
    };
    let outputs: usize = convolutions.iter().map(|c| c.outputs).sum();
    // What is too large for one weight is read again, with the rest of it.
    let once = runs.len();
    let runs = runs.repeat(parts);
    let mut weights = vec![0; outputs * runs.len() * run];
    let filters = convolutions
        .iter()
        .flat_map(|c| (0..c.outputs).map(|output| c.filter(output)));
    for (filter, weights) in filters.zip(weights.chunks_exact_mut(runs.len() * run)) {
        for tap in 0..parts * rows * columns {
            let (again, tap) = (tap / (rows * columns), tap % (rows * columns));
            let at = match window.dilations[1] {
                1 => tap / columns * run + tap % columns * input.pitch,
                _ => tap * run,
            };
            let of_tap = filter.iter().skip(tap).step_by(rows * columns);
            let weights = &mut weights[again * once * run + at..][..*inputs];
            for (weight, byte) in of_tap.zip(weights) {
                *byte = part(*weight, again, least);
            }
        }
    }
    let (starts, factors) = (starts.concat(), factors.concat());
    (
        Dense::new(kernel, [runs.len(), run], &starts, &factors, &weights),
        runs,
    )
}

/// Bytes that make up each weight, none below `least`: up to three, of 255.
fn parts(convolution: &Convolution, least: i8) -> usize {
    let all = |&parts: &usize| {
        let rest = |&weight: &i16| part(weight, parts, least) == 0;
        convolution.weights.iter().all(rest)
    };
    (1..3).find(all).unwrap_or(3)
}

/// One of the bytes that make up `weight`, which is from -255 to 255.
fn part(weight: i16, number: usize, least: i8) -> i8 {
    let byte = |weight: i16| weight.clamp(i16::from(least), i16::from(i8::MAX));
    let rest = (0..number).fold(weight, |rest, _| rest - byte(rest));
    byte(rest) as i8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_add_up_to_the_weight() {
        for least in [i8::MIN, -127] {
            for weight in -255_i16..=255 {
                let parts = [0, 1, 2].map(|number| part(weight, number, least));
                assert_eq!(parts.map(i16::from).iter().sum::<i16>(), weight);
                assert!(parts.iter().all(|&part| part >= least), "{weight}, {least}");
            }
        }
    }
}
