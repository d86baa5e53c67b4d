//! The whole picture, from RGB bytes to depth, in each mode side by side, and its stages.
#![allow(missing_docs, clippy::expect_used)]

use std::path::Path;

use criterion::{Criterion, criterion_group, criterion_main};
use gedepth::{Calibration, Estimator, Model, OutputSize, Picture, picture};

fn modes(criterion: &mut Criterion) {
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fixtures");
    let scene = fixtures.join("scenes/street");
    let image = picture::read(&scene.join("image.png")).expect("the shipped picture");
    let picture = Picture::from(&image);
    let calibration = Calibration::read(&scene.join("calibration.json")).expect("its calibration");
    for precision in ["int8", "f32"] {
        let mut group =
            criterion.benchmark_group(format!("picture to depth, 640x192, {precision}"));
        group.sample_size(20);
        for mode in ["baseline", "vanilla", "adaptive"] {
            let path = fixtures.join(format!("models/{mode}-{precision}.onnx"));
            let model = Model::from_file(&path).expect("a shipped model");
            let mut estimator = Estimator::new(
                &model,
                &calibration,
                picture.size(),
                Some((640, 192)),
                OutputSize::Network,
            )
            .expect("an estimator");
            group.bench_function(mode, |bencher| {
                bencher.iter(|| estimator.run(picture).expect("depth").depth[0]);
            });
        }
        group.finish();
    }
}

criterion_group!(benches, modes);
criterion_main!(benches);
