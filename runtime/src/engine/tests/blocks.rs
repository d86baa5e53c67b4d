//! Layers that run as one.

use super::*;

/// A convolution, quantized per channel, with Relu, as bytes.
fn convolution(
    b: &mut Builder,
    numbers: &mut Numbers,
    x: (&str, Steps, usize),
    (outs, groups): (usize, usize),
    [kernel, stride, dilation, pad]: [usize; 4],
    out: Steps,
) -> String {
    let (x, steps, ins) = x;
    let dims = [outs, ins / groups, kernel, kernel];
    let count = dims.iter().product();
    let raw = (0..count).map(|_| numbers.next() as u8).collect();
    let raw = b.constant(DataType::Int8, &dims, raw);
    let reach = ((count / outs) as f32).sqrt();
    let scales: Vec<f32> = (0..outs)
        .map(|_| out.scale / (steps.scale * 70.0 * reach) * numbers.real(0.5, 2.0))
        .collect();
    let scale = b.floats(&[outs], &scales);
    let zero = b.constant(DataType::Int8, &[outs], vec![0; outs]);
    let w = b.node(
        "DequantizeLinear",
        &[&raw, &scale, &zero],
        vec![int("axis", 0)],
    );
    let attributes = vec![
        ints("kernel_shape", &[kernel; 2]),
        ints("strides", &[stride; 2]),
        ints("dilations", &[dilation; 2]),
        ints("pads", &[pad; 4]),
        int("group", groups),
    ];
    let y = b.node("Conv", &[x, &w], attributes);
    let y = b.node("Relu", &[&y], vec![]);
    b.quantized(&y, out)
}

/// Expansion, depthwise, projection and, where the sizes agree, addition of a tensor that is too large for a cache: the rows that
/// a window takes are made when it needs them. Where somebody reads the tensors between, each layer runs for itself; both give
/// the same bytes, with any kernel on any number of threads.
#[test]
fn a_block_that_runs_as_one_gives_what_its_layers_give() {
    let mut numbers = Numbers(12);
    for (kernel, stride, dilation, pad, channels, height, width) in [
        (3, 1, 1, 1, 8, 130, 129),
        (3, 2, 1, 1, 8, 131, 128),
        (5, 1, 1, 2, 4, 200, 90),
        (5, 2, 1, 2, 16, 133, 126),
        (3, 1, 2, 2, 8, 150, 115),
        (3, 2, 1, 0, 3, 129, 131),
    ] {
        let wide = 64;
        let shape = [channels, height, width];
        let [x_steps, wide_steps, deep_steps, out_steps, sum_steps] = [0.02, 0.05, 0.1, 0.02, 0.04]
            .map(|scale| Steps {
                signed: false,
                ..Steps::random(&mut numbers, scale)
            });
        let mut b = Builder::new(shape);
        let x = b.quantized("x", x_steps);
        let one = [1, 1, 1, 0];
        let expand = convolution(
            &mut b,
            &mut numbers,
            (&x, x_steps, channels),
            (wide, 1),
            one,
            wide_steps,
        );
        let depthwise = convolution(
            &mut b,
            &mut numbers,
            (&expand, wide_steps, wide),
            (wide, wide),
            [kernel, stride, dilation, pad],
            deep_steps,
        );
        let project = convolution(
            &mut b,
            &mut numbers,
            (&depthwise, deep_steps, wide),
            (channels, 1),
            one,
            out_steps,
        );
        let last = if stride == 1 {
            let sum = b.node("Add", &[&project, &x], vec![]);
            b.quantized(&sum, sum_steps)
        } else {
            project.clone()
        };
        let apart = Builder {
            graph: b.graph.clone(),
            count: b.count,
        };
        let apart = apart.finish(&[&last, &expand, &depthwise]);
        let together = b.finish(&[&last]);
        let input = on_grid(&mut numbers, x_steps, shape.iter().product());
        let portable = Engine::Quantized {
            kernel: Kernel::Portable,
            threads: 1,
        };
        let (expected, _) = run(&apart, portable, shape, &input);
        let mut values = expected[0].clone();
        values.sort_by(f32::total_cmp);
        values.dedup();
        assert!(values.len() > 20, "the case tells little: {values:?}");
        for kernel in kernels() {
            for threads in 1..=3 {
                let engine = Engine::Quantized { kernel, threads };
                let (outputs, rest) = run(&together, engine, shape, &input);
                assert_eq!(rest, 0);
                assert!(
                    outputs[0] == expected[0],
                    "{kernel:?} on {threads}, {shape:?}, depthwise {dilation} {stride}"
                );
            }
        }
    }
}
