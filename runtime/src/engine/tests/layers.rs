//! Rarer layers on random shapes, against their definition in real numbers.

use super::*;
use crate::engine::tidy::tidy;

/// Weights of bytes of any type and zero point: values in steps, and the name of what dequantizes them along `axis`.
fn weights(
    b: &mut Builder,
    numbers: &mut Numbers,
    dims: &[usize],
    axis: usize,
    zero: u8,
    scales: &[f32],
) -> (Vec<f64>, String) {
    let raw: Vec<u8> = (0..dims.iter().product())
        .map(|_| [numbers.next() as u8, 0, 255, numbers.next() as u8][numbers.below(4)])
        .collect();
    let after: usize = dims[axis + 1..].iter().product();
    let real = |(index, &byte): (usize, &u8)| {
        let scale = scales[index / after % dims[axis]];
        (f64::from(byte) - f64::from(zero)) * f64::from(scale)
    };
    let reals = raw.iter().enumerate().map(real).collect();
    let raw = b.constant(DataType::Uint8, dims, raw);
    let scale = b.floats(&[scales.len()], scales);
    let zero = b.constant(DataType::Uint8, &[scales.len()], vec![zero; scales.len()]);
    let axis = int("axis", axis);
    (
        reals,
        b.node("DequantizeLinear", &[&raw, &scale, &zero], vec![axis]),
    )
}

/// Unsigned bytes whose zero point is 128 fit one byte of weights less it; others take two, and the farthest three.
fn weight_zero(numbers: &mut Numbers) -> u8 {
    [128, 128, 3, 200, 0, 255][numbers.below(6)]
}

#[test]
fn transposed_convolutions_are_the_nearest_step() {
    let mut numbers = Numbers(21);
    for case in 0..30 {
        let (groups, ins, outs) = match numbers.below(4) {
            0 => (2, 2 * numbers.from(1..=5), 2 * numbers.from(1..=9)),
            _ => (1, numbers.from(1..=20), numbers.from(1..=20)),
        };
        let kernel = [numbers.from(1..=4), numbers.from(1..=4)];
        let stride = [numbers.from(1..=3), numbers.from(1..=3)];
        let dilation = numbers.from(1..=2);
        // Padding by more than the kernel reaches over crops.
        let pads = [0, 1, 2, 3].map(|axis| numbers.below(kernel[axis % 2] + 2));
        let more = stride.map(|stride| numbers.below(stride));
        let shape = [ins, numbers.from(2..=6), numbers.from(2..=9)];
        let size = [0, 1].map(|axis| {
            let reach = (kernel[axis] - 1) * dilation + 1;
            ((shape[axis + 1] - 1) * stride[axis] + reach + more[axis])
                .checked_sub(pads[axis] + pads[axis + 2])
                .filter(|&length| length > 0)
        });
        let [Some(height), Some(width)] = size else {
            continue;
        };
        let per_group = outs / groups;
        let from = Steps::random(&mut numbers, 0.02);
        let out = Steps::random(&mut numbers, 0.02 * (ins as f32).sqrt());
        let mut b = Builder::new(shape);
        let x = b.quantized("x", from);
        let scales: Vec<f32> = (0..per_group).map(|_| numbers.real(0.001, 0.01)).collect();
        let dims = [ins, per_group, kernel[0], kernel[1]];
        let zero = weight_zero(&mut numbers);
        let (w, name) = weights(&mut b, &mut numbers, &dims, 1, zero, &scales);
        let attributes = vec![
            ints("kernel_shape", &kernel),
            ints("strides", &stride),
            ints("dilations", &[dilation, dilation]),
            ints("pads", &pads),
            ints("output_padding", &more),
            int("group", groups),
        ];
        let y = b.node("ConvTranspose", &[&x, &name], attributes);
        let y = b.quantized(&y, out);
        let input = on_grid(&mut numbers, from, shape.iter().product());
        let mut real = vec![0.0; outs * height * width];
        for (index, &value) in input.iter().enumerate() {
            let (i, y, x) = (
                index / (shape[1] * shape[2]),
                index / shape[2] % shape[1],
                index % shape[2],
            );
            let group = i / (ins / groups);
            for within in 0..per_group {
                for (row, column) in
                    (0..kernel[0]).flat_map(|r| (0..kernel[1]).map(move |c| (r, c)))
                {
                    let at_y = (y * stride[0] + row * dilation).wrapping_sub(pads[0]);
                    let at_x = (x * stride[1] + column * dilation).wrapping_sub(pads[1]);
                    if at_y < height && at_x < width {
                        let o = group * per_group + within;
                        let tap = ((i * per_group + within) * kernel[0] + row) * kernel[1] + column;
                        real[(o * height + at_y) * width + at_x] += f64::from(value) * w[tap];
                    }
                }
            }
        }
        let case = format!(
            "case {case}: {ins}->{outs} g{groups} {kernel:?} /{stride:?} {pads:?} {more:?}"
        );
        // tract knows no grouped transposed convolution with padding of the output.
        check_engine(&b.finish(&[&y]), shape, &input, out, &real, &case);
    }
}

#[test]
fn weights_of_any_zero_point_are_the_nearest_step() {
    let mut numbers = Numbers(22);
    for case in 0..20 {
        let depthwise = case % 2 == 0;
        let (ins, outs) = match depthwise {
            true => {
                let channels = numbers.from(5..=40);
                (channels, channels)
            }
            false => (numbers.from(1..=20), numbers.from(1..=40)),
        };
        let per_group = if depthwise { 1 } else { ins };
        let side = [1, 3, 5][numbers.below(3)];
        let shape = [ins, numbers.from(5..=7), numbers.from(5..=20)];
        let (height, width) = (shape[1] + 1 - side, shape[2] + 1 - side);
        let from = Steps::random(&mut numbers, 0.02);
        let out = Steps::random(
            &mut numbers,
            0.02 * ((per_group * side * side) as f32).sqrt(),
        );
        let mut b = Builder::new(shape);
        let x = b.quantized("x", from);
        let scales: Vec<f32> = (0..outs).map(|_| numbers.real(0.001, 0.01)).collect();
        let zero = numbers.next() as u8;
        let (w, name) = weights(
            &mut b,
            &mut numbers,
            &[outs, per_group, side, side],
            0,
            zero,
            &scales,
        );
        let attributes = vec![
            ints("kernel_shape", &[side, side]),
            int("group", ins / per_group),
        ];
        let y = b.node("Conv", &[&x, &name], attributes);
        let y = b.quantized(&y, out);
        let input = on_grid(&mut numbers, from, shape.iter().product());
        let mut real = Vec::new();
        for (o, y, x) in
            (0..outs).flat_map(|o| (0..height * width).map(move |i| (o, i / width, i % width)))
        {
            let first = if depthwise { o } else { 0 };
            let taps = (0..per_group * side * side).map(|tap| {
                let (c, row, column) = (tap / (side * side), tap / side % side, tap % side);
                let at = ((first + c) * shape[1] + y + row) * shape[2] + x + column;
                f64::from(input[at]) * w[o * per_group * side * side + tap]
            });
            real.push(taps.sum());
        }
        check(
            &b.finish(&[&y]),
            shape,
            &input,
            out,
            &real,
            &format!("case {case}: {ins}->{outs} {side} zero {zero}"),
        );
    }
}

#[test]
fn paddings_are_the_nearest_step() {
    let mut numbers = Numbers(23);
    for case in 0..24 {
        let shape = [
            numbers.from(1..=20),
            numbers.from(4..=6),
            numbers.from(4..=9),
        ];
        let [channels, height, width] = shape;
        let pads = [0, 1, 2, 3].map(|_| numbers.below(4));
        let mode = ["constant", "edge", "reflect"][case % 3];
        let from = Steps::random(&mut numbers, 0.02);
        let out = if case % 2 == 0 {
            from
        } else {
            Steps {
                signed: from.signed,
                zero: from.zero,
                ..Steps::random(&mut numbers, 0.02)
            }
        };
        let mut b = Builder::new(shape);
        let x = b.quantized("x", from);
        let ends: Vec<u8> = [0, 0, pads[0], pads[1], 0, 0, pads[2], pads[3]]
            .iter()
            .flat_map(|&n| (n as i64).to_le_bytes())
            .collect();
        let ends = b.constant(DataType::Int64, &[8], ends);
        let fill = numbers.real(-1.0, 1.0);
        let fill_name = b.floats(&[], &[fill]);
        // Given a value, tract pads with it in every mode.
        let inputs = [&x, &ends, &fill_name].map(String::as_str);
        let used = if mode == "constant" { 3 } else { 2 };
        let y = b.node("Pad", &inputs[..used], vec![text("mode", mode)]);
        let y = b.quantized(&y, out);
        let input = on_grid(&mut numbers, from, shape.iter().product());
        let source = |at: usize, before: usize, length: usize| -> Option<usize> {
            let (at, last) = (at as i64 - before as i64, length as i64 - 1);
            let at = match mode {
                "constant" if at < 0 || at > last => return None,
                "reflect" if at < 0 => -at,
                "reflect" if at > last => 2 * last - at,
                _ => at.clamp(0, last),
            };
            Some(at as usize)
        };
        let mut real = Vec::new();
        for c in 0..channels {
            for y in 0..height + pads[0] + pads[2] {
                for x in 0..width + pads[1] + pads[3] {
                    real.push(
                        match (source(y, pads[0], height), source(x, pads[1], width)) {
                            (Some(y), Some(x)) => f64::from(input[(c * height + y) * width + x]),
                            _ => f64::from(fill),
                        },
                    );
                }
            }
        }
        check(
            &b.finish(&[&y]),
            shape,
            &input,
            out,
            &real,
            &format!("case {case}: {mode} {pads:?}"),
        );
    }
}

#[test]
fn linear_layers_are_the_nearest_step() {
    let mut numbers = Numbers(24);
    for case in 0..16 {
        let shape = [
            numbers.from(1..=9),
            numbers.from(1..=3),
            numbers.from(1..=4),
        ];
        let (ins, outs) = (shape.iter().product(), numbers.from(1..=40));
        let from = Steps::random(&mut numbers, 0.02);
        let out = Steps::random(&mut numbers, 0.02 * (ins as f32).sqrt());
        let scales: Vec<f32> = (0..outs).map(|_| numbers.real(0.001, 0.01)).collect();
        let by_output = case % 3 == 0;
        let (dims, axis) = if by_output {
            ([outs, ins], 0)
        } else {
            ([ins, outs], 1)
        };
        let mut b = Builder::new(shape);
        let x = b.quantized("x", from);
        let x = b.node("Flatten", &[&x], vec![]);
        let zero = weight_zero(&mut numbers);
        let (w, name) = weights(&mut b, &mut numbers, &dims, axis, zero, &scales);
        let bias: Vec<f32> = scales
            .iter()
            .map(|scale| from.scale * scale * numbers.below(999) as f32)
            .collect();
        let y = if case % 3 == 2 {
            b.node("MatMul", &[&x, &name], vec![])
        } else {
            let bias = b.floats(&[outs], &bias);
            b.node(
                "Gemm",
                &[&x, &name, &bias],
                vec![int("transB", usize::from(by_output))],
            )
        };
        let y = b.quantized(&y, out);
        let input = on_grid(&mut numbers, from, ins);
        let real: Vec<f64> = (0..outs)
            .map(|o| {
                let product = |(i, &value): (usize, &f32)| {
                    f64::from(value) * w[if by_output { o * ins + i } else { i * outs + o }]
                };
                let start = if case % 3 == 2 {
                    0.0
                } else {
                    f64::from(bias[o])
                };
                start + input.iter().enumerate().map(product).sum::<f64>()
            })
            .collect();
        check(
            &b.finish(&[&y]),
            shape,
            &input,
            out,
            &real,
            &format!("case {case}: {ins}->{outs}"),
        );
    }
}

/// Heads as ONNX Runtime's tools quantize them: one to four outputs, which kernels sum up in another way.
#[test]
fn convolutions_of_few_outputs_are_the_nearest_step() {
    let mut numbers = Numbers(31);
    for case in 0..24 {
        let outs = 1 + case % 5;
        let channels = [16, 12][case / 20];
        let [height, width] = [2 + numbers.below(4), 17 + numbers.below(30)];
        let shape = [channels, height, width];
        let side = [1, 3][case / 5 % 2];
        let from = Steps {
            signed: case % 2 == 0,
            zero: [-5, 77][case % 2],
            scale: 0.02,
        };
        let out = Steps {
            signed: false,
            zero: 101,
            scale: 0.05,
        };
        let input = on_grid(&mut numbers, from, channels * height * width);
        let mut b = Builder::new(shape);
        let x = b.quantized("x", from);
        let scales: Vec<f32> = (0..outs).map(|_| numbers.real(0.002, 0.01)).collect();
        let (w, name) = weights(
            &mut b,
            &mut numbers,
            &[outs, channels, side, side],
            0,
            128,
            &scales,
        );
        let y = b.node("Conv", &[&x, &name], vec![ints("pads", &[side / 2; 4])]);
        let y = b.quantized(&y, out);
        let at = |channel: usize, y: usize, x: usize| {
            // Beyond the border, rows and columns wrap around to huge ones.
            let inside = y < height && x < width;
            let index = || (channel * height + y) * width + x;
            if inside {
                f64::from(input[index()])
            } else {
                0.0
            }
        };
        let mut real = Vec::new();
        for out in 0..outs {
            for y in 0..height {
                for x in 0..width {
                    let mut sum = 0.0;
                    for channel in 0..channels {
                        for v in 0..side {
                            for u in 0..side {
                                let weight = w[((out * channels + channel) * side + v) * side + u];
                                let [v, u] = [y + v, x + u].map(|at| at.wrapping_sub(side / 2));
                                sum += weight * at(channel, v, u);
                            }
                        }
                    }
                    real.push(sum);
                }
            }
        }
        let case = format!("case {case}: {channels}->{outs}, {side}x{side}, {height}x{width}");
        check(&b.finish(&[&y]), shape, &input, out, &real, &case);
    }
}

/// An attention that is quantized before and after its sigmoid: the head's rows are made for the table, one by one, and have no step of
/// their own.
#[test]
fn a_head_of_few_outputs_is_made_row_by_row_for_its_function() {
    let mut numbers = Numbers(53);
    let shape = [16, 4, 40];
    let from = Steps {
        signed: false,
        zero: 77,
        scale: 0.02,
    };
    let mut b = Builder::new(shape);
    let x = b.quantized("x", from);
    let (_, w) = weights(&mut b, &mut numbers, &[1, 16, 3, 3], 0, 128, &[0.004]);
    let y = b.node("Conv", &[&x, &w], vec![ints("pads", &[1; 4])]);
    let y = b.quantized(
        &y,
        Steps {
            zero: 128,
            scale: 0.1,
            ..from
        },
    );
    let y = b.node("Sigmoid", &[&y], vec![]);
    let y = b.quantized(
        &y,
        Steps {
            zero: 0,
            scale: 1.0 / 256.0,
            ..from
        },
    );
    let model = b.finish(&[&y]);
    let input = on_grid(&mut numbers, from, shape.iter().product());
    let made = |kernel, threads| {
        let (outputs, rest) = run(&model, Engine::Quantized { kernel, threads }, shape, &input);
        assert_eq!(rest, 0, "{kernel:?}");
        outputs
    };
    let expected = made(Kernel::Portable, 1);
    assert!(expected[0].iter().any(|&m| m > 0.1 && m < 0.9));
    for kernel in kernels() {
        for threads in [1, 2] {
            assert_eq!(made(kernel, threads), expected, "{kernel:?} on {threads}");
        }
    }
}

/// PixelShuffle, in both orders of channels, also where the steps change and what is below zero is cut off.
#[test]
fn channels_as_pixels_are_the_nearest_step() {
    let mut numbers = Numbers(47);
    for case in 0..12 {
        let block = 2 + case % 2;
        let outs = [1, 5, 24][case / 4];
        let [height, width] = [1 + numbers.below(4), 1 + numbers.below(9)];
        let shape = [outs * block * block, height, width];
        let from = Steps {
            signed: case % 3 == 0,
            zero: [7, 90][case % 2],
            scale: 0.03,
        };
        let relu = case % 4 == 3;
        let out = Steps {
            scale: [0.03, 0.05][case / 2 % 2],
            ..from
        };
        let input = on_grid(&mut numbers, from, shape.iter().product());
        let mut b = Builder::new(shape);
        let x = b.quantized("x", from);
        let columns_first = case % 4 >= 2;
        let mut attributes = vec![int("blocksize", block)];
        if columns_first {
            attributes.push(text("mode", "CRD"));
        }
        let mut y = b.node("DepthToSpace", &[&x], attributes);
        if relu {
            y = b.node("Relu", &[&y], vec![]);
        }
        let y = b.quantized(&y, out);
        let mut real = Vec::new();
        for channel in 0..outs {
            for v in 0..height * block {
                for u in 0..width * block {
                    // As ONNX's operator says it: reshape, transpose, reshape.
                    let (row, column) = (v % block, u % block);
                    let from = if columns_first {
                        (channel * block + row) * block + column
                    } else {
                        (row * block + column) * outs + channel
                    };
                    let value = input[(from * height + v / block) * width + u / block];
                    real.push(f64::from(if relu { value.max(0.0) } else { value }));
                }
            }
        }
        let case = format!("case {case}: {shape:?} by {block}");
        check(&b.finish(&[&y]), shape, &input, out, &real, &case);
    }
}

/// The largest products that there are, all of one sign: some kernels add two of them in 16 bits.
#[test]
fn extreme_bytes_and_weights_are_the_nearest_step() {
    let (channels, outs) = (40, 16);
    let shape = [channels, 2, 3];
    let from = Steps {
        signed: false,
        zero: 128,
        scale: 0.02,
    };
    let out = Steps {
        signed: false,
        zero: 128,
        scale: 3.0,
    };
    for (byte, weight) in [
        (0_i32, -128_i8),
        (0, -127),
        (0, 127),
        (255, -128),
        (255, 127),
    ] {
        let mut b = Builder::new(shape);
        let x = b.quantized("x", from);
        let dims = [outs, channels, 1, 1];
        let raw = b.constant(DataType::Int8, &dims, vec![weight as u8; outs * channels]);
        let scale = b.floats(&[], &[0.01]);
        let zero = b.constant(DataType::Int8, &[], vec![0]);
        let w = b.node("DequantizeLinear", &[&raw, &scale, &zero], vec![]);
        let y = b.node("Conv", &[&x, &w], vec![]);
        let y = b.quantized(&y, out);
        let value = (byte - from.zero) as f32 * from.scale;
        let real = channels as f64 * f64::from(value) * f64::from(weight) * 0.01;
        check(
            &b.finish(&[&y]),
            shape,
            &vec![value; channels * 6],
            out,
            &vec![real; outs * 6],
            &format!("byte {byte}, weight {weight}"),
        );
    }
}

/// By channel, with the zero points of their own, and what is beyond all bytes is the farthest one.
#[test]
fn weights_quantized_on_the_spot_are_the_nearest_bytes() {
    let shape = [2, 1, 2];
    let [from, out] = [0.02, 0.05].map(|scale| Steps {
        signed: false,
        zero: 100,
        scale,
    });
    let (scales, zeros) = ([0.1_f32, 0.01, 0.02], [128_u8, 3, 255]);
    let weights = [
        [0.31_f32, -0.28],
        [f32::MAX, f32::NEG_INFINITY],
        [0.049, f32::INFINITY],
    ];
    let mut b = Builder::new(shape);
    let x = b.quantized("x", from);
    let real = b.floats(&[3, 2, 1, 1], weights.as_flattened());
    let scale = b.floats(&[3], &scales);
    let zero = b.constant(DataType::Uint8, &[3], zeros.to_vec());
    let parameters = [real.as_str(), &scale, &zero];
    let axis = || vec![int("axis", 0)];
    let bytes = b.node("QuantizeLinear", &parameters, axis());
    let w = b.node("DequantizeLinear", &[&bytes, &scale, &zero], axis());
    let y = b.node("Conv", &[&x, &w], vec![]);
    let y = b.quantized(&y, out);
    // [channel][pixel]
    let input = [[0.5_f32, -0.3], [-0.2, 0.7]];
    let nearest = |output: usize, input: usize| {
        let (scale, zero) = (f64::from(scales[output]), f64::from(zeros[output]));
        let byte = (f64::from(weights[output][input]) / scale).round_ties_even() + zero;
        (byte.clamp(0.0, 255.0) - zero) * scale
    };
    let real: Vec<f64> = (0..3)
        .flat_map(|output| {
            [0, 1].map(|pixel| {
                (0..2)
                    .map(|channel| nearest(output, channel) * f64::from(input[channel][pixel]))
                    .sum()
            })
        })
        .collect();
    check(
        &b.finish(&[&y]),
        shape,
        input.as_flattened(),
        out,
        &real,
        "weights quantized on the spot",
    );
}

/// Infinity times 0 is no number: such a layer is refused, and the model left to tract.
#[test]
fn scales_whose_ratio_is_infinite_are_refused() {
    let shape = [16, 1, 2];
    // A sum of 5e9 steps is no i32.
    for (operator, from, out) in [
        ("Add", 1e38, 1e-30),
        ("Mul", 1e38, 1e-30),
        ("Add", 1.0, 1e-7),
    ] {
        let [from, out] = [from, out].map(|scale| Steps {
            signed: false,
            zero: 0,
            scale,
        });
        let mut b = Builder::new(shape);
        let x = b.quantized("x", from);
        // Not x alone: a function of one byte is a table.
        let other = b.quantized("x", Steps { zero: 1, ..from });
        let y = b.node(operator, &[&x, &other], vec![]);
        let y = b.quantized(&y, out);
        let model = fastest().split(&b.finish(&[&y])).unwrap();
        let mut onnx = tract_onnx::onnx();
        register(&mut onnx);
        let planned = onnx
            .model_for_proto_model(&model)
            .and_then(|model| model.with_input_fact(0, f32::fact([1, 16, 1, 2]).into()))
            .and_then(|model| model.into_optimized());
        let error = format!("{:?}", planned.unwrap_err());
        assert!(error.contains("too far apart"), "{operator}: {error}");
    }
}

/// One pixel for all, one channel for all, and constants, on either side.
#[test]
fn broadcasts_are_the_nearest_step() {
    let mut numbers = Numbers(25);
    for case in 0..24 {
        let shape = [
            numbers.from(2..=30),
            numbers.from(1..=5),
            numbers.from(2..=9),
        ];
        let [channels, height, width] = shape;
        let (from, mean) = (
            Steps::random(&mut numbers, 0.02),
            Steps::random(&mut numbers, 0.01),
        );
        let out = Steps::random(&mut numbers, 0.03);
        let mut b = Builder::new(shape);
        let x = b.quantized("x", from);
        let input = on_grid(&mut numbers, from, shape.iter().product());
        let at = |c: usize, i: usize| f64::from(input[c * height * width + i]);
        let constants: Vec<f32> = (0..channels).map(|_| numbers.real(-1.0, 1.0)).collect();
        let (other, values): (String, Vec<f64>) = match case % 3 {
            0 => {
                let pooled = b.node("GlobalAveragePool", &[&x], vec![]);
                let area = (height * width) as f64;
                let value = |c: usize| {
                    let real = (0..height * width).map(|i| at(c, i)).sum::<f64>() / area;
                    let steps =
                        (real / f64::from(mean.scale)).round_ties_even() + f64::from(mean.zero);
                    let least = f64::from(mean.least());
                    (steps.clamp(least, least + 255.0) - f64::from(mean.zero))
                        * f64::from(mean.scale)
                };
                (
                    b.quantized(&pooled, mean),
                    (0..channels).map(value).collect(),
                )
            }
            1 => {
                let name = b.floats(&[1, channels, 1, 1], &constants);
                (name, constants.iter().map(|&v| f64::from(v)).collect())
            }
            _ => {
                let name = b.floats(&[], &constants[..1]);
                (name, vec![f64::from(constants[0]); channels])
            }
        };
        let operator = ["Add", "Mul", "Sub"][case / 3 % 3];
        let swapped = case % 2 == 0;
        let inputs = if swapped { [&other, &x] } else { [&x, &other] };
        let y = b.node(operator, &inputs.map(String::as_str), vec![]);
        let y = b.quantized(&y, out);
        let real: Vec<f64> = (0..channels * height * width)
            .map(|index| {
                let (c, i) = (index / (height * width), index % (height * width));
                match operator {
                    "Add" => at(c, i) + values[c],
                    "Mul" => at(c, i) * values[c],
                    _ if swapped => values[c] - at(c, i),
                    _ => at(c, i) - values[c],
                }
            })
            .collect();
        check(
            &b.finish(&[&y]),
            shape,
            &input,
            out,
            &real,
            &format!("case {case}: {operator} {shape:?}"),
        );
    }
}

/// The limits of a ReLU or Clip hold behind sums and products of which one side repeats along rows or columns, too.
#[test]
fn activations_behind_broadcasts_hold() {
    let mut numbers = Numbers(26);
    for case in 0..12 {
        let shape @ [channels, height, width] = [numbers.from(2..=20), 3, numbers.from(2..=9)];
        let (from, map) = (
            Steps::random(&mut numbers, 0.02),
            Steps::random(&mut numbers, 0.02),
        );
        let out = Steps::random(&mut numbers, 0.03);
        let mut b = Builder::new(shape);
        let x = b.quantized("x", from);
        // The first channel alone, for all of them.
        let mut weights = vec![0; channels];
        weights[0] = 1;
        let raw = b.constant(DataType::Int8, &[1, channels, 1, 1], weights);
        let (one, zero) = (
            b.floats(&[], &[1.0]),
            b.constant(DataType::Int8, &[], vec![0]),
        );
        let w = b.node("DequantizeLinear", &[&raw, &one, &zero], vec![]);
        let first = b.node("Conv", &[&x, &w], vec![ints("kernel_shape", &[1, 1])]);
        let first = b.quantized(&first, map);
        let operator = ["Add", "Mul"][case % 2];
        let inputs = if case % 4 < 2 {
            [&first, &x]
        } else {
            [&x, &first]
        };
        let y = b.node(operator, &inputs.map(String::as_str), vec![]);
        let clips = case % 3 > 0;
        let y = match clips {
            true => {
                let (least, most) = (b.floats(&[], &[-0.1]), b.floats(&[], &[0.2]));
                b.node("Clip", &[&y, &least, &most], vec![])
            }
            false => b.node("Relu", &[&y], vec![]),
        };
        let y = b.quantized(&y, out);
        let input = on_grid(&mut numbers, from, shape.iter().product());
        let area = height * width;
        let real: Vec<f64> = (0..channels * area)
            .map(|index| {
                let steps =
                    (f64::from(input[index % area]) / f64::from(map.scale)).round_ties_even();
                let least = f64::from(map.least() - map.zero);
                let repeated = steps.clamp(least, least + 255.0) * f64::from(map.scale);
                let own = f64::from(input[index]);
                let value = if operator == "Add" {
                    own + repeated
                } else {
                    own * repeated
                };
                match clips {
                    true => value.clamp(f64::from(-0.1_f32), f64::from(0.2_f32)),
                    false => value.max(0.0),
                }
            })
            .collect();
        let case = format!("case {case}: {operator} {shape:?}");
        check(&b.finish(&[&y]), shape, &input, out, &real, &case);
    }
}

/// Moving quantization past a node that changes the axes, or putting one bound for all channels, would change weights that are
/// quantized by channel.
#[test]
fn quantization_by_channel_stays_where_it_is() {
    let mut b = Builder::new([2, 1, 1]);
    let weights = b.constant(DataType::Int8, &[2, 2, 1, 1], vec![10, 100, 10, 100]);
    let scale = b.floats(&[2], &[0.001, 0.01]);
    let zero = b.constant(DataType::Int8, &[2], vec![0; 2]);
    let real = b.node(
        "DequantizeLinear",
        &[&weights, &scale, &zero],
        vec![int("axis", 0)],
    );
    let real = b.node("Flatten", &[&real], vec![]);
    let steps = Steps {
        signed: false,
        zero: 0,
        scale: 0.01,
    };
    let x = b.quantized("x", steps);
    let x = b.node("Flatten", &[&x], vec![]);
    let y = b.node("Gemm", &[&x, &real], vec![int("transB", 1)]);
    let bounded = b.floats(&[2, 2, 1, 1], &[0.05, -0.05, 1.0, -1.0]);
    let bytes = b.node(
        "QuantizeLinear",
        &[&bounded, &scale, &zero],
        vec![int("axis", 0)],
    );
    let [least, most] = [-127_i8, 127].map(|end| b.constant(DataType::Int8, &[], vec![end as u8]));
    let bytes = b.node("Clip", &[&bytes, &least, &most], vec![]);
    let back = b.node(
        "DequantizeLinear",
        &[&bytes, &scale, &zero],
        vec![int("axis", 0)],
    );
    let z = b.node("Conv", &[&x, &back], vec![]);
    let joined = b.node("Concat", &["x", "x"], vec![int("axis", 1)]);
    let scale = b.floats(&[4], &[0.1, 0.2, 0.3, 0.4]);
    let zero = b.constant(DataType::Int8, &[4], vec![0; 4]);
    let parameters = [joined.as_str(), &scale, &zero];
    let four = b.node("QuantizeLinear", &parameters, vec![int("axis", 1)]);
    let four = b.node(
        "DequantizeLinear",
        &[&four, &scale, &zero],
        vec![int("axis", 1)],
    );
    let model = b.finish(&[&y, &z, &four]);
    let graph = model.graph.as_ref().unwrap();
    let tidied = tidy(&model, graph);
    for name in [&real, &bytes, &back, &joined, &four] {
        let made = |graph: &GraphProto| {
            graph
                .node
                .iter()
                .find(|node| &node.output[0] == name)
                .unwrap()
                .clone()
        };
        assert_eq!(made(&tidied), made(graph), "{name}");
    }
}

/// Forty sums and differences, of each other: 2^40 ways through, and planning ends.
#[test]
fn graphs_with_many_ways_through_are_planned() {
    let shape = [4, 2, 3];
    let steps = Steps {
        signed: false,
        zero: 128,
        scale: 0.02,
    };
    let mut b = Builder::new(shape);
    let (mut x, mut y) = (
        b.node("Floor", &["x"], vec![]),
        b.node("Ceil", &["x"], vec![]),
    );
    let mut all = Vec::new();
    for _ in 0..40 {
        (x, y) = (
            b.node("Add", &[&x, &y], vec![]),
            b.node("Sub", &[&x, &y], vec![]),
        );
        all.extend([x.clone(), y.clone()]);
    }
    // Read by another, too, so that each is a tensor of its own.
    let all: Vec<&str> = all.iter().map(String::as_str).collect();
    let joined = b.node("Concat", &all, vec![int("axis", 1)]);
    let product = b.node("Mul", &[&x, &y], vec![]);
    let product = b.quantized(&product, steps);
    let pooled = b.node("MaxPool", &[&product], vec![ints("kernel_shape", &[1, 1])]);
    let pooled = b.quantized(&pooled, steps);
    drop(fastest().split(&b.finish(&[&joined, &pooled])));
}
