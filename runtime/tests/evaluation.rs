//! Scores against a stored case, whose numbers NumPy computed from the same frames and predictions
//! (`fixtures/training/evaluation_case.py`), and `gedepth eval` as a user calls it.
#![allow(clippy::panic, clippy::unwrap_used)]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use gedepth::evaluation::{
    CropRule, DataSet, ErrorScores, Evaluator, Frame, GroundFrom, Metrics, Protocol, Scores,
};
use gedepth::{Estimate, Model, Placement, StageTimes};
use gedepth_core::fusion::DepthRange;
use gedepth_core::metrics::CloudMetrics;
use serde_json::{Value, json};
use tempfile::TempDir;

const PICTURE_ERROR: i32 = 3;
const CALIBRATION_ERROR: i32 = 4;
const MODEL_ERROR: i32 = 5;
const WRITE_ERROR: i32 = 6;
const DATA_SET_ERROR: i32 = 7;

fn case() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../fixtures/evaluation")
}

fn model(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../fixtures/models/{name}.onnx"))
}

fn json_file(path: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap()
}

/// Numbers to 1e-9 of themselves, all else exactly.
fn assert_same(ours: &Value, expected: &Value, name: &str) {
    match (ours, expected) {
        (Value::Object(a), Value::Object(b)) => {
            assert_eq!(a.len(), b.len(), "{name}");
            for (key, value) in a {
                assert_same(value, &b[key], &format!("{name}.{key}"));
            }
        }
        (Value::Array(a), Value::Array(b)) => {
            assert_eq!(a.len(), b.len(), "{name}");
            for (index, (a, b)) in a.iter().zip(b).enumerate() {
                assert_same(a, b, &format!("{name}[{index}]"));
            }
        }
        (Value::Number(a), Value::Number(b)) => {
            let (a, b) = (a.as_f64().unwrap(), b.as_f64().unwrap());
            assert!((a - b).abs() <= 1e-9 * b.abs(), "{name}: {a}, not {b}");
        }
        (a, b) => assert_eq!(a, b, "{name}"),
    }
}

fn as_json(scores: &Scores) -> Value {
    let errors = |e: &ErrorScores| json!({"pictures": e.pictures(), "pixels": e.pixels(), "mean": e.mean(), "pooled": e.pooled()});
    let cloud = |m: Option<CloudMetrics>| {
        m.map(|m| json!({"precision": m.precision, "recall": m.recall, "f_score": m.f_score, "iou": m.iou}))
    };
    let c = &scores.cloud;
    json!({
        "whole": errors(&scores.whole),
        "ground": errors(&scores.ground),
        "not_ground": errors(&scores.not_ground),
        "by_distance": scores.by_distance.iter().map(errors).collect::<Vec<_>>(),
        "cloud": {"pictures": c.pictures(), "mean": cloud(c.mean()), "pooled": cloud(c.pooled())},
    })
}

#[test]
fn scores_are_those_that_numpy_computes() {
    let cases = json_file(&case().join("expected.json"));
    assert_eq!(cases.as_array().unwrap().len(), 2);
    for expected in cases.as_array().unwrap() {
        let rules = &expected["protocol"];
        let number = |value: &Value| value.as_f64().unwrap();
        let range = &rules["depth_range_m"];
        let mut evaluator = Evaluator::new(Protocol {
            range: DepthRange::new(number(&range[0]) as f32, number(&range[1]) as f32).unwrap(),
            crop: match rules["crop"].as_str().unwrap() {
                "garg" => CropRule::Garg,
                _ => CropRule::None,
            },
            cloud_threshold_m: number(&rules["cloud_threshold_m"]),
        });
        let [left, top, width, height] =
            [0, 1, 2, 3].map(|i| expected["region"][i].as_u64().unwrap() as u32);
        let set = DataSet::open(&case()).unwrap();
        assert_eq!(set.name, "evaluation");
        let mut scores = Scores::default();
        for path in &set.frames {
            let frame = Frame::read(path).unwrap();
            let predicted = image::open(case().join(format!("{}.predicted.png", frame.name)))
                .unwrap()
                .into_luma16();
            let depth: Vec<f32> = (top..top + height)
                .flat_map(|v| (left..left + width).map(move |u| (u, v)))
                .map(|(u, v)| f32::from(predicted.get_pixel(u, v).0[0]) / 256.0)
                .collect();
            let estimate = Estimate {
                size: (width, height),
                placement: Placement {
                    left,
                    top,
                    region: (width, height),
                    network: (64, 32),
                },
                depth: &depth,
                times: StageTimes::default(),
            };
            scores.merge(&evaluator.score(&frame, &estimate).unwrap());
            let at = |u: u32, v: u32| evaluator.depth()[(v * 96 + u) as usize];
            assert_eq!(at(left, top), depth[0]);
            if top > 0 {
                assert_eq!(at(left, top - 1), 0.0);
            }
        }
        assert_same(&as_json(&scores), &expected["scores"], "scores");
    }
}

#[test]
fn an_estimate_at_another_size_is_refused() {
    let frame = Frame::read(&case().join("masked")).unwrap();
    assert_eq!(frame.ground_from, GroundFrom::Mask);
    let mut evaluator = Evaluator::new(Protocol {
        range: DepthRange::new(1.0, 80.0).unwrap(),
        crop: CropRule::None,
        cloud_threshold_m: 0.1,
    });
    // Not at the region's size; of smaller pictures; of larger ones.
    for (size, region) in [
        ((48, 32), (96, 64)),
        ((48, 32), (48, 32)),
        ((96, 32), (96, 32)),
        ((192, 64), (192, 64)),
        ((96, 128), (96, 128)),
    ] {
        let estimate = Estimate {
            size,
            placement: Placement {
                left: 0,
                top: 0,
                region,
                network: (48, 32),
            },
            depth: &vec![1.0; size.0 as usize * size.1 as usize],
            times: StageTimes::default(),
        };
        evaluator.score(&frame, &estimate).unwrap_err();
    }
}

#[test]
fn no_picture_has_no_mean() {
    let scores = Scores::default();
    assert_eq!(
        (scores.whole.mean(), scores.whole.pooled()),
        (None::<Metrics>, None)
    );
    assert_eq!((scores.cloud.mean(), scores.cloud.pooled()), (None, None));
    assert_eq!(scores.times.network.mean(), None);
    assert_eq!(scores.times.network.least(), None);
}

fn eval(sets: &[&Path], more: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_gedepth"))
        .arg("eval")
        .args(sets)
        .args(["--network-size", "96x64"])
        .args(more)
        .output()
        .unwrap()
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let to = to.join(entry.file_name());
        match entry.file_type().unwrap().is_dir() {
            true => copy(&entry.path(), &to),
            false => drop(fs::copy(entry.path(), to).unwrap()),
        }
    }
}

/// Two data sets, two models: what is written agrees with the depth that was saved, and both outputs with each other.
#[test]
fn writes_tables_numbers_and_depth() {
    let dir = TempDir::new().unwrap();
    let (first, second) = (dir.path().join("first"), dir.path().join("second"));
    copy(&case().join("masked"), &first.join("masked"));
    copy(&case(), &second);
    let [json, tables, depth] =
        ["out/scores.json", "out/tables.md", "depth"].map(|name| dir.path().join(name));
    let (adaptive, baseline) = (model("adaptive-int8"), model("baseline-int8"));
    let text = |path: &Path| path.to_str().unwrap().to_owned();
    let arguments = [
        "--model",
        &text(&adaptive),
        "--model",
        &text(&baseline),
        "--json",
        &text(&json),
        "--markdown",
        &text(&tables),
        "--save-depth",
        &text(&depth),
        "--cap",
        "50",
    ];
    let output = eval(&[&first, &second], &arguments);
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let tables = fs::read_to_string(tables).unwrap();
    assert_eq!(String::from_utf8(output.stdout).unwrap(), tables);

    let scores = json_file(&json);
    assert_eq!(
        scores["data_sets"],
        json!([
            {"name": "first", "pictures": 1, "pictures_with_ground_mask": 1},
            {"name": "second", "pictures": 2, "pictures_with_ground_mask": 1},
        ])
    );
    for (index, name) in ["adaptive-int8", "baseline-int8"].into_iter().enumerate() {
        let of_model = &scores["models"][index];
        assert_eq!(of_model["name"], name);
        assert!(of_model["parameters"].as_u64().unwrap() > 1_000_000);
        let mut pictures = Vec::new();
        for (set, frame) in [
            ("first", "masked"),
            ("second", "masked"),
            ("second", "unmasked"),
        ] {
            let bytes = fs::read(depth.join(name).join(set).join(format!("{frame}.f32"))).unwrap();
            let predicted = bytes
                .as_chunks::<4>()
                .0
                .iter()
                .map(|bytes| f64::from(f32::from_le_bytes(*bytes)));
            let truth = image::open(case().join(frame).join("depth.png"))
                .unwrap()
                .into_luma16();
            assert_eq!(predicted.len(), truth.len());
            let errors: Vec<f64> = predicted
                .zip(truth.iter())
                .map(|(p, steps)| (p.min(50.0), f64::from(*steps) / 256.0))
                .filter(|(_, t)| *t > 0.0 && *t <= 50.0)
                .map(|(p, t)| (p - t).abs() / t)
                .collect();
            pictures.push(errors.iter().sum::<f64>() / errors.len() as f64);
        }
        let abs_rel = |scores: &Value| scores["whole"]["mean"]["abs_rel"].as_f64().unwrap();
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-9, "{a}, not {b}");
        close(abs_rel(&of_model["by_data_set"][0]), pictures[0]);
        close(
            abs_rel(&of_model["by_data_set"][1]),
            (pictures[1] + pictures[2]) / 2.0,
        );
        close(
            abs_rel(&of_model["all"]),
            pictures.iter().sum::<f64>() / 3.0,
        );
        let row = format!(
            "| second | {name} | 2 | {:.4} |",
            (pictures[1] + pictures[2]) / 2.0
        );
        assert!(tables.contains(&row), "`{row}` is not in\n{tables}");
        let network = &of_model["all"]["times_ms"]["network"];
        assert!(network["least"].as_f64().unwrap() <= network["mean"].as_f64().unwrap());
    }
    assert!(
        tables.contains("| **all** | baseline-int8 | 3 |"),
        "{tables}"
    );
}

/// Devices, pipes and links are written through, not replaced.
#[cfg(unix)]
#[test]
fn outputs_that_are_no_plain_files() {
    let dir = TempDir::new().unwrap();
    let (file, link) = (dir.path().join("scores.json"), dir.path().join("link.json"));
    fs::write(&file, "an older one").unwrap();
    std::os::unix::fs::symlink("scores.json", &link).unwrap();
    let arguments = [
        "--json",
        link.to_str().unwrap(),
        "--markdown",
        "/dev/stdout",
    ];
    let output = eval(&[&case()], &arguments);
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
    assert!(json_file(&file)["models"].is_array());
    let text = String::from_utf8(output.stdout).unwrap();
    assert_eq!(text.matches("**all**").count() % 2, 0);
    assert!(text.matches("Abs Rel").count() >= 2);
}

/// Pictures of several sizes with a calibration that names none are each a camera of their own; and names of files that mean
/// something in Markdown.
#[test]
fn pictures_of_two_sizes_and_odd_names() {
    let dir = TempDir::new().unwrap();
    let set = dir.path().join("day|night");
    let text = "P2: 60 0 47 0 0 60 30 0 0 0 1 0
Tr: 0 -1 0 0 0 0 -1 0 1 0 0 0
";
    for (name, size) in [("a", (96, 64)), ("b", (128, 96)), ("c", (96, 64))] {
        let frame = set.join(name);
        fs::create_dir_all(&frame).unwrap();
        image::RgbImage::new(size.0, size.1)
            .save(frame.join("image.png"))
            .unwrap();
        let depth = image::ImageBuffer::from_pixel(size.0, size.1, image::Luma([2560_u16]));
        depth.save(frame.join("depth.png")).unwrap();
        fs::write(frame.join("calibration.json"), text).unwrap();
    }
    let output = eval(&[&set], &[]);
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let tables = String::from_utf8(output.stdout).unwrap();
    assert!(
        tables.contains(r"| day\|night | embedded | 3 |"),
        "{tables}"
    );
    let parent = dir.path().join("...onnx");
    fs::copy(model("adaptive-int8"), &parent).unwrap();
    let refused = eval(&[&set], &["--model", parent.to_str().unwrap()]);
    assert_refused(&refused, MODEL_ERROR, &["...onnx", "rename"]);
}

/// Scales and zero points are not parameters: a network has as many in f32 as quantized.
#[test]
fn quantization_adds_no_parameters() {
    for mode in ["baseline", "vanilla", "adaptive"] {
        let [f32, int8] = ["f32", "int8"].map(|precision| {
            let path = model(&format!("{mode}-{precision}"));
            Model::from_file(&path).unwrap().parameters()
        });
        assert!(f32 > 1_000_000);
        assert_eq!(f32, int8, "{mode}");
    }
}

#[test]
fn the_limit_holds_and_the_embedded_model_is_the_default() {
    let dir = TempDir::new().unwrap();
    let json = dir.path().join("scores.json");
    let output = eval(
        &[&case()],
        &["--limit", "1", "--json", json.to_str().unwrap()],
    );
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let scores = json_file(&json);
    assert_eq!(scores["data_sets"][0]["pictures"], 1);
    assert_eq!(scores["models"][0]["name"], "embedded");
}

/// The call failed with this code and one line that has all of `words`, and wrote no table.
fn assert_refused(output: &Output, code: i32, words: &[&str]) {
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{message}");
    assert_eq!(message.trim_end().lines().count(), 1, "{message}");
    assert_eq!(output.stdout, b"");
    for word in words {
        assert!(message.contains(word), "`{word}` is not in: {message}");
    }
}

#[test]
fn frames_that_cannot_be_read_are_named() {
    let set = TempDir::new().unwrap();
    let small = set.path().join("small.png");
    image::GrayImage::new(8, 8).save(&small).unwrap();
    let small = fs::read(small).unwrap();
    fs::remove_file(set.path().join("small.png")).unwrap();
    let picture = fs::read(case().join("masked/image.png")).unwrap();
    let calibration = fs::read_to_string(case().join("masked/calibration.json")).unwrap();
    let other_size = calibration
        .replacen("\"width\": 96", "\"width\": 97", 1)
        .into_bytes();
    for (file, bytes, code, words) in [
        ("image.png", None, PICTURE_ERROR, vec!["cannot read"]),
        (
            "image.png",
            Some(b"text".to_vec()),
            PICTURE_ERROR,
            vec!["cannot decode"],
        ),
        (
            "image.png",
            Some(small.clone()),
            DATA_SET_ERROR,
            vec!["(8, 8)", "(96, 64)"],
        ),
        (
            "depth.png",
            None,
            PICTURE_ERROR,
            vec!["cannot read", "depth.png"],
        ),
        (
            "depth.png",
            Some(picture.clone()),
            DATA_SET_ERROR,
            vec!["Rgb8", "L16", "depth.png"],
        ),
        (
            "ground.png",
            Some(small),
            DATA_SET_ERROR,
            vec!["(8, 8)", "(96, 64)", "ground.png"],
        ),
        (
            "calibration.json",
            None,
            CALIBRATION_ERROR,
            vec!["cannot read"],
        ),
        (
            "calibration.json",
            Some(other_size),
            DATA_SET_ERROR,
            vec!["(97, 64)"],
        ),
    ] {
        let frame = set.path().join("frame_7");
        copy(&case().join("masked"), &frame);
        match bytes {
            Some(bytes) => fs::write(frame.join(file), bytes).unwrap(),
            None => fs::remove_file(frame.join(file)).unwrap(),
        }
        let output = eval(&[set.path()], &[]);
        assert_refused(&output, code, &[words, vec!["frame_7"]].concat());
        fs::remove_dir_all(frame).unwrap();
    }
    assert_refused(&eval(&[set.path()], &[]), DATA_SET_ERROR, &["no frame"]);
    let absent = set.path().join("absent");
    assert_refused(&eval(&[&absent], &[]), DATA_SET_ERROR, &["absent"]);
}

#[test]
fn what_does_not_fit_together_is_named() {
    let same_twice = eval(&[&case(), &case()], &[]);
    assert_refused(&same_twice, DATA_SET_ERROR, &["evaluation", "rename"]);
    let adaptive = model("adaptive-int8");
    let adaptive = adaptive.to_str().unwrap();
    let same_twice = eval(&[&case()], &["--model", adaptive, "--model", adaptive]);
    assert_refused(&same_twice, MODEL_ERROR, &["adaptive-int8", "rename"]);
    let absent = eval(&[&case()], &["--model", "absent.onnx"]);
    assert_refused(&absent, MODEL_ERROR, &["absent.onnx"]);
    if Path::new("/proc/self").exists() {
        // Found out before what takes long.
        let nowhere = eval(&[&case()], &["--json", "/proc/none/scores.json"]);
        assert_refused(&nowhere, WRITE_ERROR, &["/proc/none"]);
        // What took long is not lost with the file.
        let full = eval(&[&case()], &["--json", "/dev/full"]);
        assert_eq!(full.status.code(), Some(WRITE_ERROR));
        assert!(String::from_utf8_lossy(&full.stderr).contains("/dev/full"));
        assert!(String::from_utf8_lossy(&full.stdout).contains("Abs Rel"));
    }
    let dir = TempDir::new().unwrap();
    let [one, same] = ["x.txt", "./x.txt"].map(|name| dir.path().join(name));
    let [one, same] = [&one, &same].map(|path| path.to_str().unwrap());
    let both = eval(&[&case()], &["--json", one, "--markdown", same]);
    assert_refused(&both, WRITE_ERROR, &["x.txt", "another output"]);
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0);
    for wrong in [
        ["--cap", "0"],
        ["--cap", "far"],
        ["--cloud-threshold", "-1"],
        ["--crop", "eigen"],
        ["--limit", "0"],
    ] {
        assert_eq!(eval(&[&case()], &wrong).status.code(), Some(2), "{wrong:?}");
    }
    assert_eq!(eval(&[], &[]).status.code(), Some(2));
    let unfit = Command::new(env!("CARGO_BIN_EXE_gedepth"))
        .arg("eval")
        .arg(case())
        .args(["--network-size", "100x64"])
        .output()
        .unwrap();
    assert_refused(&unfit, 2, &["masked", "(100, 64)", "multiples of 32"]);
}
