//! How long a network takes in rten: `compare-rten MODEL WIDTH HEIGHT THREADS RUNS` prints microseconds of every run.

use std::error::Error;
use std::hint::black_box;
use std::sync::Arc;
use std::time::Instant;

use rten::{ModelOptions, RunOptions, ThreadPool};
use rten_tensor::NdTensor;
use rten_tensor::prelude::*;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [model, numbers @ ..] = arguments.as_slice() else {
        return Err("compare-rten MODEL WIDTH HEIGHT THREADS RUNS".into());
    };
    let numbers: Vec<usize> = numbers
        .iter()
        .map(|n| n.parse())
        .collect::<Result<_, _>>()?;
    let &[width, height, threads, runs] = numbers.as_slice() else {
        return Err("four numbers are needed: WIDTH HEIGHT THREADS RUNS".into());
    };
    // Weights packed at load: as quick as rten gets.
    let model = ModelOptions::with_all_ops()
        .prepack_weights(true)
        .load_file(model)?;
    let input = model.node_id("input")?;
    let heads = ["residual", "attention", "slope"].map(|name| model.node_id(name));
    let heads = heads.into_iter().collect::<Result<Vec<_>, _>>()?;
    let options = RunOptions::default()
        .with_thread_pool(Some(Arc::new(ThreadPool::with_num_threads(threads))));
    let planes: NdTensor<f32, 4> = NdTensor::from_fn([1, 4, height, width], |[_, c, y, x]| {
        ((c * height + y) * width + x) as f32 * 0.37 % 4.5 - 2.0
    });
    for _ in 0..runs {
        let clock = Instant::now();
        black_box(model.run(
            vec![(input, planes.view().into())],
            &heads,
            Some(options.clone()),
        )?);
        println!("{:.1}", clock.elapsed().as_secs_f64() * 1e6);
    }
    Ok(())
}
