//! The network alone, by each way of running it, and what the processor's int8 multiplier could do at best.
#![allow(missing_docs, clippy::expect_used)]

use std::path::Path;
use std::time::Duration;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use gedepth::{Calibration, Engine, Estimator, Kernel, Model, OutputSize, Picture, picture};
use gedepth_benches::{MULTIPLY_ADDS, multiply_add};

const NETWORK: (u32, u32) = (640, 192);

fn network(criterion: &mut Criterion) {
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fixtures");
    let scene = fixtures.join("scenes/street");
    let image = picture::read(&scene.join("image.png")).expect("the shipped picture");
    let picture = Picture::from(&image);
    let calibration = Calibration::read(&scene.join("calibration.json")).expect("its calibration");
    let mut engines = vec![("tract".to_owned(), Engine::Tract)];
    for kernel in Kernel::ALL
        .into_iter()
        .filter(|kernel| kernel.is_supported())
    {
        for threads in [1, 2] {
            engines.push((
                format!("{kernel:?}, {threads} threads"),
                Engine::Quantized { kernel, threads },
            ));
        }
    }
    let mut group = criterion.benchmark_group("adaptive int8 network, 640x192");
    group.sample_size(20);
    for (name, engine) in engines {
        let model =
            Model::from_file(&fixtures.join("models/adaptive-int8.onnx")).expect("a shipped model");
        let model = model.with_engine(engine);
        let mut estimator = Estimator::new(
            &model,
            &calibration,
            picture.size(),
            Some(NETWORK),
            OutputSize::Network,
        )
        .expect("an estimator");
        group.bench_function(name, |bencher| {
            bencher.iter_custom(|runs| {
                (0..runs)
                    .map(|_| estimator.run(picture).expect("depth").times.network)
                    .sum::<Duration>()
            });
        });
    }
    group.finish();
}

/// Multiply-adds per second of the VNNI unit of one core.
fn peak(criterion: &mut Criterion) {
    if !multiply_add() {
        return;
    }
    let mut group = criterion.benchmark_group("peak of one core");
    group.throughput(Throughput::Elements(MULTIPLY_ADDS));
    group.bench_function("vpdpbusd, multiply-adds", |bencher| {
        bencher.iter(multiply_add);
    });
    group.finish();
}

criterion_group!(benches, peak, network);
criterion_main!(benches);
