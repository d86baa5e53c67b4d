//! From picture to depth with the shipped models: against the shipped scenes' exact depth, int8 against f32, and on
//! real pictures.
#![allow(clippy::expect_used, clippy::panic)] // a test that cannot go on says why

use std::path::Path;

use gedepth::{Calibration, Estimator, Model, OutputSize, Picture, picture};
use gedepth_tests::{abs_rel, depth, folders, real_data, root, shipped_scenes};

/// The farthest depth that counts, metres, as on KITTI.
const CAP: f32 = 80.0;

fn shipped_model(name: &str) -> Model {
    Model::from_file(&root().join("fixtures/models").join(name)).expect("a shipped model")
}

fn estimate(model: &Model, frame: &Path) -> Vec<f32> {
    let image = picture::read(&gedepth_tests::picture(frame)).expect("a picture");
    let calibration = Calibration::read(&frame.join("calibration.json")).expect("a calibration");
    let mut estimator = Estimator::new(
        model,
        &calibration,
        image.dimensions(),
        None,
        OutputSize::Picture,
    )
    .expect("an estimator");
    let estimate = estimator.run(Picture::from(&image)).expect("depth");
    assert_eq!(estimate.size, image.dimensions());
    estimate.depth.to_vec()
}

#[test]
fn the_embedded_model_is_the_shipped_adaptive_int8() {
    let embedded = Model::embedded().expect("the embedded model");
    assert_eq!(
        embedded.contract(),
        shipped_model("adaptive-int8.onnx").contract()
    );
}

#[test]
fn depth_is_right_on_the_shipped_scenes_in_every_mode_and_precision() {
    for mode in ["baseline", "vanilla", "adaptive"] {
        let mut means = [0.0; 2];
        for (mean, precision) in means.iter_mut().zip(["f32", "int8"]) {
            let model = shipped_model(&format!("{mode}-{precision}.onnx"));
            let scenes = shipped_scenes();
            for scene in &scenes {
                let (_, _, truth) = depth(&scene.join("depth.png"));
                let estimate = estimate(&model, scene);
                let (least, most) = (
                    model.contract().depth_range.min(),
                    model.contract().depth_range.max(),
                );
                assert!(estimate.iter().all(|&z| (least..=most).contains(&z)));
                *mean += abs_rel(&estimate, &truth, CAP) / scenes.len() as f64;
            }
        }
        println!("{mode}: Abs Rel f32 {:.4}, int8 {:.4}", means[0], means[1]);
        assert!(means[0] < 0.35, "{mode}: {means:?}");
        assert!((means[1] - means[0]).abs() < 0.02, "{mode}: {means:?}");
    }
}

/// The road just ahead is nearer than the vehicles on it, and the sky is farthest.
#[test]
fn the_street_is_in_the_right_order_of_depth() {
    let street = root().join("fixtures/scenes/street");
    let (width, _, truth) = depth(&street.join("depth.png"));
    let estimate = estimate(&Model::embedded().expect("the embedded model"), &street);
    let median = |select: &dyn Fn(usize, f32) -> bool| {
        let mut depths: Vec<f32> = (0..truth.len())
            .filter(|&i| select(i / width as usize, truth[i]))
            .map(|i| estimate[i])
            .collect();
        assert!(depths.len() > 500);
        depths.sort_by(f32::total_cmp);
        depths[depths.len() / 2]
    };
    let rows = truth.len() / width as usize;
    let road = median(&|v, z| v > rows * 19 / 20 && z > 0.0);
    let middle = median(&|_, z| z > 15.0 && z < 25.0);
    let far = median(&|_, z| z > 45.0 && z < 80.0);
    let sky = median(&|_, z| z == 0.0);
    assert!(
        road < middle && middle < far && far < sky,
        "{road} {middle} {far} {sky}"
    );
}

#[test]
fn every_real_frame_runs() {
    let Some(frames) = real_data("frames") else {
        return;
    };
    let model = Model::embedded().expect("the embedded model");
    for frame in folders(&frames) {
        let (_, _, lidar) = depth(&frame.join("depth.png"));
        let error = abs_rel(&estimate(&model, &frame), &lidar, CAP);
        println!(
            "{}: Abs Rel {error:.3}",
            frame.file_name().expect("a name").display()
        );
        assert!(error.is_finite());
    }
}

/// Ground and attention are made when asked for: of the picture that ran last, whichever ran or was asked about before, and
/// beside the depth that the run gave.
#[test]
fn maps_are_of_the_last_picture() {
    for name in ["adaptive-int8.onnx", "adaptive-f32.onnx"] {
        let frame = root().join("fixtures/scenes/street");
        let image = picture::read(&gedepth_tests::picture(&frame)).expect("a picture");
        let calibration =
            Calibration::read(&frame.join("calibration.json")).expect("a calibration");
        let (size, network) = (image.dimensions(), Some((320, 96)));
        let model = shipped_model(name);
        let mut estimator =
            Estimator::new(&model, &calibration, size, network, OutputSize::Network)
                .expect("an estimator");
        let mut maps_of = |picture: Picture<'_>| {
            let depth = estimator.run(picture).expect("depth").depth.to_vec();
            let maps = estimator.maps().expect("maps");
            assert_eq!(maps.depth, depth, "{name}");
            let attention = maps.attention.expect("an attention").to_vec();
            (maps.ground.to_vec(), attention)
        };
        let grey = vec![128; image.as_raw().len()];
        let street = maps_of(Picture::from(&image));
        let wall = maps_of(Picture::new(size, &grey).expect("a picture"));
        assert!(street.0 != wall.0 && street.1 != wall.1, "{name}");
        assert!(street == maps_of(Picture::from(&image)), "{name}");
    }
}
