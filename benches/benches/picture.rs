//! From picture bytes to depth, stage by stage: baseline, vanilla and adaptive side by side, int8, at three sizes, on one
//! thread and on two. Picture, network and depth have the same size, so that nothing is resampled. And what a camera's own pixel format costs, and
//! another ground.
#![allow(missing_docs, clippy::expect_used)]

use std::path::Path;
use std::time::Duration;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use gedepth::{
    Calibration, Distortion, Engine, Estimator, Kernel, Model, Numbers, OutputSize, Picture,
    PixelFormat, Plane, StageTimes, Yuv,
};

const MODES: [&str; 3] = ["baseline", "vanilla", "adaptive"];
const SIZES: [(u32, u32); 3] = [(640, 192), (1216, 352), (640, 384)];

/// A stage and its part of the times.
type Stage = (&'static str, fn(StageTimes) -> Duration);

const STAGES: [Stage; 4] = [
    ("preprocess", |times| times.preprocess),
    ("network", |times| times.network),
    ("fusion", |times| times.fusion),
    ("all", |times| {
        times.preprocess + times.network + times.fusion
    }),
];

fn stages(criterion: &mut Criterion) {
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fixtures");
    let path = fixtures.join("scenes/street/calibration.json");
    let street = Numbers::read(&path).expect("its calibration");
    for size in SIZES {
        // What is in the picture does not change the time; noise keeps every branch busy.
        let bytes: Vec<u8> = (0..3 * size.0 * size.1)
            .map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8)
            .collect();
        let picture = Picture::new(size, &bytes).expect("three bytes a pixel");
        let mut numbers = street;
        numbers.size = Some(size);
        numbers.k[0][2] = f64::from(size.0) / 2.0;
        numbers.k[1][2] = f64::from(size.1) / 2.0;
        let calibration = Calibration::new(&path, &numbers).expect("a camera");
        for threads in [1, 2] {
            let mut estimators = MODES.map(|mode| {
                let path = fixtures.join(format!("models/{mode}-int8.onnx"));
                let kernel = Kernel::best();
                let model = Model::from_file(&path)
                    .expect("a shipped model")
                    .with_engine(Engine::Quantized { kernel, threads });
                let output = OutputSize::Picture;
                Estimator::new(&model, &calibration, size, Some(size), output)
                    .expect("an estimator")
            });
            for (name, part) in STAGES {
                let mut group = criterion.benchmark_group(format!("{name}, {}x{}", size.0, size.1));
                group.sample_size(20);
                group.measurement_time(Duration::from_secs(2));
                for (mode, estimator) in MODES.iter().zip(&mut estimators) {
                    let id = BenchmarkId::new(*mode, format!("{threads} threads"));
                    group.bench_function(id, |bencher| {
                        bencher.iter_custom(|runs| {
                            (0..runs)
                                .map(|_| part(estimator.run(picture).expect("depth").times))
                                .sum()
                        });
                    });
                }
                group.finish();
            }
        }
    }
}

/// What a camera's own format costs: of a picture of 1280x720, resampled to 640x352.
fn formats(criterion: &mut Criterion) {
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fixtures");
    let path = fixtures.join("scenes/hill/calibration.json");
    let calibration = Calibration::read(&path).expect("its calibration");
    let size = (1280, 720);
    let bytes: Vec<u8> = (0..4 * size.0 * size.1)
        .map(|i: u32| (i.wrapping_mul(2_654_435_761) >> 24) as u8)
        .collect();
    let mut group = criterion.benchmark_group("preprocess by format, 1280x720");
    group.sample_size(20);
    for threads in [1, 2] {
        let kernel = Kernel::best();
        let model = Model::embedded().expect("the embedded model");
        let model = model.with_engine(Engine::Quantized { kernel, threads });
        let mut estimator = Estimator::new(&model, &calibration, size, None, OutputSize::Network)
            .expect("an estimator");
        let yuv = Yuv::Bt709Limited;
        for format in [
            PixelFormat::Rgb,
            PixelFormat::Bgr,
            PixelFormat::Bgrx,
            PixelFormat::Grey,
            PixelFormat::Uyvy(yuv),
            PixelFormat::Nv12(yuv),
        ] {
            let planes = format.planes(size).map(|(row, _)| Plane {
                bytes: &bytes,
                stride: row as usize,
            });
            let count = 1 + usize::from(planes[1].stride > 0);
            let picture =
                Picture::with_format(size, format, &planes[..count]).expect("enough bytes");
            let id = BenchmarkId::new(format!("{format:?}"), format!("{threads} threads"));
            group.bench_function(id, |bencher| {
                bencher.iter_custom(|runs| {
                    (0..runs)
                        .map(|_| estimator.run(picture).expect("depth").times.preprocess)
                        .sum()
                });
            });
        }
    }
    group.finish();
}

/// What a new pitch or height costs between two pictures.
fn another_ground(criterion: &mut Criterion) {
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fixtures");
    let path = fixtures.join("scenes/street/calibration.json");
    let street = Numbers::read(&path).expect("its calibration");
    let picture = street.size.expect("its pictures' size");
    let model = Model::embedded().expect("the embedded model");
    for network in [(640, 192), (1216, 352)] {
        let mut group = criterion.benchmark_group(format!(
            "another ground, network {}x{}, depth {}x{}",
            network.0, network.1, picture.0, picture.1
        ));
        for (lens, distortion) in [
            ("pinhole", Distortion::None),
            ("lens", Distortion::Equidistant([0.02, -0.003, 0.0, 0.0])),
        ] {
            let numbers = Numbers {
                distortion,
                ..street
            };
            let calibration = Calibration::new(&path, &numbers).expect("a camera");
            let output = OutputSize::Picture;
            let mut estimator =
                Estimator::new(&model, &calibration, picture, Some(network), output)
                    .expect("an estimator");
            group.bench_function(lens, |bencher| {
                bencher.iter(|| estimator.set_ground(calibration.ground()));
            });
        }
        group.finish();
    }
}

criterion_group!(benches, stages, formats, another_ground);
criterion_main!(benches);
