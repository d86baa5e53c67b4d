//! From picture to depth with the shipped models: against the shipped scenes' exact depth, int8 against f32, and on
//! real pictures.
#![allow(clippy::expect_used, clippy::panic)] // a test that cannot go on says why

use std::path::Path;

use gedepth::{
    Calibration, Distortion, Estimator, Model, Numbers, OutputSize, Picture, PixelFormat, Plane,
    Yuv, picture,
};
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

/// The ONNX file of `model` whose contract has `value` for `entry`. In protobuf the entry is `72 LENGTH 0a LENGTH key 12 LENGTH
/// value`, each length one byte, and in nothing else whose length would change.
fn with_entry(model: &[u8], entry: &str, value: &str) -> Vec<u8> {
    let key = format!("gedepth.{entry}");
    let at = (0..model.len())
        .find(|&at| model[at..].starts_with(key.as_bytes()))
        .expect("an entry");
    let (start, value_at) = (at - 4, at + key.len() + 2);
    let end = value_at + usize::from(model[value_at - 1]);
    assert_eq!(usize::from(model[start + 1]), end - at + 2);
    let length = |length: usize| u8::try_from(length).expect("one byte");
    let mut changed = model[..start].to_vec();
    changed.extend([0x72, length(key.len() + value.len() + 4), 0x0a]);
    changed.push(length(key.len()));
    changed.extend_from_slice(key.as_bytes());
    changed.extend([0x12, length(value.len())]);
    changed.extend_from_slice(value.as_bytes());
    changed.extend_from_slice(&model[end..]);
    changed
}

/// A residual over the focal length is times that of the network's input: of a picture of 1242 x 375 shrunk to 320 x 96, with pixels
/// that are not quite square.
#[test]
fn residual_over_the_focal_length_is_times_that_of_the_networks_input() {
    let street = root().join("fixtures/scenes/street");
    let image = picture::read(&gedepth_tests::picture(&street)).expect("a picture");
    let text = std::fs::read_to_string(street.join("calibration.json")).expect("a calibration");
    let mut numbers: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    // A lens so wide that both depths are within the range.
    (numbers["K"][0], numbers["K"][4]) = (4.0.into(), 9.0.into());
    let file = std::env::temp_dir().join(format!("gedepth-focal-{}.json", std::process::id()));
    std::fs::write(&file, numbers.to_string()).expect("written");
    let calibration = Calibration::read(&file).expect("a calibration");
    std::fs::remove_file(&file).expect("removed");
    let path = root().join("fixtures/models/baseline-int8.onnx");
    let bytes = std::fs::read(&path).expect("a model");
    let depth = |form: &str| {
        let model = with_entry(&bytes, "residual_form", form);
        let model = Model::from_bytes(&path, &model).expect("a model");
        let (size, network) = (image.dimensions(), Some((320, 96)));
        let mut estimator =
            Estimator::new(&model, &calibration, size, network, OutputSize::Network)
                .expect("an estimator");
        let estimate = estimator.run(Picture::from(&image)).expect("depth");
        estimate.depth.to_vec()
    };
    let focal = f32::sqrt(4.0 * 320.0 / 1242.0 * 9.0 * 96.0 / 375.0);
    let (plain, over_focal) = (depth("log_depth"), depth("log_metres_per_pixel"));
    let mut compared = 0;
    for (z, times) in plain.iter().zip(&over_focal) {
        if (1.0..50.0).contains(z) {
            assert!((times / (focal * z) - 1.0).abs() < 1e-5, "{z} {times}");
            compared += 1;
        }
    }
    assert!(compared > 10_000, "{compared}");
}

/// A camera's own format is as good as red, green, blue: the same bytes where it has the same values; and of NV12, which has a
/// quarter of the colours, much the same depth.
#[test]
fn depth_is_the_same_in_every_format() {
    let street = root().join("fixtures/scenes/street");
    let image = picture::read(&gedepth_tests::picture(&street)).expect("a picture");
    let calibration = Calibration::read(&street.join("calibration.json")).expect("a calibration");
    let size = image.dimensions();
    let pixels: Vec<[u8; 3]> = image.pixels().map(|pixel| pixel.0).collect();
    let bgrx: Vec<u8> = pixels.iter().flat_map(|&[r, g, b]| [b, g, r, 7]).collect();
    // BT.601, 0 to 255, by its definition.
    let yuv = |[r, g, b]: [u8; 3]| {
        let [r, g, b] = [r, g, b].map(f64::from);
        let y = 0.299 * r + 0.587 * g + 0.114 * b;
        [y, 128.0 + (b - y) / 1.772, 128.0 + (r - y) / 1.402]
    };
    let luma: Vec<u8> = pixels
        .iter()
        .map(|&pixel| yuv(pixel)[0].round() as u8)
        .collect();
    let mut chroma = Vec::new();
    for y in (0..size.1).step_by(2) {
        for x in (0..size.0).step_by(2) {
            let near =
                |x: u32, y: u32| yuv(image.get_pixel(x.min(size.0 - 1), y.min(size.1 - 1)).0);
            let four = [
                near(x, y),
                near(x + 1, y),
                near(x, y + 1),
                near(x + 1, y + 1),
            ];
            chroma.extend(
                [1, 2].map(|c| (four.iter().map(|p| p[c]).sum::<f64>() / 4.0).round() as u8),
            );
        }
    }
    let plane = |bytes, stride: u32| Plane {
        bytes,
        stride: stride as usize,
    };
    let bgrx = Picture::with_format(size, PixelFormat::Bgrx, &[plane(&bgrx, 4 * size.0)]);
    let planes = [
        plane(&luma, size.0),
        plane(&chroma, size.0.next_multiple_of(2)),
    ];
    let nv12 = Picture::with_format(size, PixelFormat::Nv12(Yuv::Bt601Full), &planes);
    // Whole in the engine, and from planes of f32 in tract.
    for name in ["adaptive-int8.onnx", "adaptive-f32.onnx"] {
        let model = shipped_model(name);
        let network = Some((320, 96));
        let mut estimator =
            Estimator::new(&model, &calibration, size, network, OutputSize::Network)
                .expect("an estimator");
        let mut depth = |picture: &Picture<'_>| {
            let estimate = estimator.run(*picture).expect("depth");
            estimate.depth.to_vec()
        };
        let rgb = depth(&Picture::from(&image));
        assert!(depth(bgrx.as_ref().expect("a picture")) == rgb, "{name}");
        let of_nv12 = depth(nv12.as_ref().expect("a picture"));
        let errors = rgb.iter().zip(&of_nv12).map(|(a, b)| (b / a).ln().abs());
        let mean = errors.sum::<f32>() / rgb.len() as f32;
        assert!(mean < 0.02 && of_nv12 != rgb, "{name}: {mean}");
    }
}

/// A baseline's ground is the plane, as a vanilla network's is, whether or not its heads use it.
#[test]
fn a_baseline_shows_the_plane_too() {
    let frame = root().join("fixtures/scenes/street");
    let image = picture::read(&gedepth_tests::picture(&frame)).expect("a picture");
    let calibration = Calibration::read(&frame.join("calibration.json")).expect("a calibration");
    let grounds = ["baseline-int8.onnx", "vanilla-int8.onnx"].map(|name| {
        let (size, network) = (image.dimensions(), Some((320, 96)));
        let model = shipped_model(name);
        let mut estimator =
            Estimator::new(&model, &calibration, size, network, OutputSize::Network)
                .expect("an estimator");
        estimator.run(Picture::from(&image)).expect("depth");
        let maps = estimator.maps().expect("maps");
        assert_eq!(maps.attention.is_some(), name.starts_with("vanilla"));
        maps.ground.to_vec()
    });
    assert!(grounds[0].iter().filter(|z| **z > 0.0).count() > 10_000);
    assert_eq!(grounds[0], grounds[1]);
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

/// Online calibration: an estimator that is given another ground is the one that would have been made with it, in every mode, whether
/// the engine or tract runs the model, whatever the lens.
#[test]
fn an_estimator_over_another_ground_is_a_new_one_with_it() {
    let image = picture::read(&root().join("fixtures/scenes/hill/image.png")).expect("a picture");
    let hill =
        Numbers::read(&root().join("fixtures/scenes/hill/calibration.json")).expect("numbers");
    let sin = 1.5_f64.to_radians().sin();
    let lenses = [
        Distortion::None,
        Distortion::PlumbBob([-0.2, 0.05, 1e-3, -2e-3, 0.0]),
        Distortion::Equidistant([0.02, -0.003, 0.0, 0.0]),
    ];
    let models = [
        "baseline-int8",
        "vanilla-int8",
        "adaptive-int8",
        "adaptive-f32",
    ];
    for (distortion, name) in lenses
        .iter()
        .flat_map(|lens| models.map(|name| (*lens, name)))
    {
        let model = shipped_model(&format!("{name}.onnx"));
        let calibration = |up, offset| {
            let numbers = Numbers {
                distortion,
                up,
                offset,
                ..hill
            };
            Calibration::new(Path::new("hill"), &numbers).expect("a calibration")
        };
        // The vehicle's frame, z up: pitched by 1.5 degrees and rolled by 0.6, 7 cm lower.
        let first = calibration(hill.up, hill.offset);
        let then = calibration([sin, 0.01, 1.0], hill.offset + 0.07);
        for output in [OutputSize::Picture, OutputSize::Network] {
            let new = |calibration| {
                let size = Some((192, 96));
                Estimator::new(&model, calibration, image.dimensions(), size, output)
                    .expect("an estimator")
            };
            let maps = |estimator: &mut Estimator| {
                estimator.run(Picture::from(&image)).expect("depth");
                let maps = estimator.maps().expect("maps");
                [maps.depth, maps.ground, maps.attention.unwrap_or_default()].map(<[f32]>::to_vec)
            };
            let (mut changed, mut anew) = (new(&first), new(&then));
            let before = maps(&mut changed);
            changed.set_ground(then.ground()).expect("a ground");
            assert_eq!(changed.ground(), anew.ground());
            let after = maps(&mut changed);
            assert!(
                after == maps(&mut anew),
                "{name}, {distortion:?}, {output:?}"
            );
            assert!(after[1] != before[1], "{name}, {distortion:?}, {output:?}");
            assert_eq!(
                after[0] == before[0],
                name.starts_with("baseline"),
                "{name}"
            );
            let signs = [&mut changed, &mut anew].map(|e| e.plausibility().expect("signs"));
            assert_eq!(signs[0], signs[1]);
            changed.set_ground(first.ground()).expect("a ground");
            assert!(
                maps(&mut changed) == before,
                "{name}, {distortion:?}, {output:?}"
            );
        }
    }
}
