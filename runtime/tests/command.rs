//! The `gedepth` command as a user calls it: what it writes, and what it says when it cannot.
#![allow(clippy::panic, clippy::unwrap_used)]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use tempfile::TempDir;

const PICTURE_ERROR: i32 = 3;
const CALIBRATION_ERROR: i32 = 4;
const MODEL_ERROR: i32 = 5;
const WRITE_ERROR: i32 = 6;

fn scene() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../fixtures/scenes/street")
}

fn model() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../fixtures/models/adaptive-int8.onnx")
}

/// `gedepth run` with these files and arguments.
fn run_at(picture: &Path, calibration: &Path, more: &[&str], out: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_gedepth"))
        .arg("run")
        .arg(picture)
        .arg("--calibration")
        .arg(calibration)
        .arg("--out")
        .arg(out)
        .args(more)
        .output()
        .unwrap()
}

/// The same with a small network, so that tests are fast.
fn run(picture: &Path, calibration: &Path, more: &[&str], out: &Path) -> Output {
    run_at(
        picture,
        calibration,
        &[more, &["--network-size", "320x96"]].concat(),
        out,
    )
}

/// The call failed with this code and one line that has all of `words`, and wrote nothing.
fn assert_refused(output: &Output, code: i32, words: &[&str], out: &Path) {
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{message}");
    assert_eq!(message.trim_end().lines().count(), 1, "{message}");
    for word in words {
        assert!(message.contains(word), "`{word}` is not in: {message}");
    }
    let written = fs::read_dir(out).map_or(0, Iterator::count);
    assert_eq!(written, 0, "something was written although: {message}");
}

fn inspect(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_gedepth"));
    command.arg("inspect").args(arguments).output().unwrap()
}

struct Folder {
    dir: TempDir,
}

impl Folder {
    fn new() -> Self {
        Self {
            dir: TempDir::new().unwrap(),
        }
    }

    fn out(&self) -> PathBuf {
        self.dir.path().join("out")
    }

    fn file(&self, name: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
        let path = self.dir.path().join(name);
        fs::write(&path, bytes).unwrap();
        path
    }
}

#[test]
fn writes_all_outputs_at_the_pictures_size() {
    let folder = Folder::new();
    let picture = scene().join("image.png");
    let output = run(
        &picture,
        &scene().join("calibration.json"),
        &[],
        &folder.out(),
    );
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let size = image::image_dimensions(&picture).unwrap();
    let mut names: Vec<_> = fs::read_dir(folder.out())
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    assert_eq!(
        names,
        [
            "attention.png",
            "depth.png",
            "depth_colours.png",
            "ground.png"
        ]
    );
    for name in names {
        let (width, height) = image::image_dimensions(folder.out().join(&name)).unwrap();
        // Those in colours stand above a scale bar.
        let bar = if ["depth_colours.png", "ground.png"].contains(&name.as_str()) {
            32
        } else {
            0
        };
        assert_eq!((width, height), (size.0, size.1 + bar), "{name}");
    }
    let depth = image::open(folder.out().join("depth.png")).unwrap();
    assert_eq!(depth.color(), image::ColorType::L16);
    let table = String::from_utf8(output.stdout).unwrap();
    for word in [
        "picture",
        "network",
        "depth",
        "ground",
        "decode",
        "preprocess",
        "fusion",
    ] {
        assert!(table.contains(word), "{table}");
    }
}

#[test]
fn a_second_run_replaces_the_first() {
    let folder = Folder::new();
    let picture = scene().join("image.png");
    for _ in 0..2 {
        let output = run(
            &picture,
            &scene().join("calibration.json"),
            &[],
            &folder.out(),
        );
        assert!(
            output.status.success(),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
    }
    assert_eq!(fs::read_dir(folder.out()).unwrap().count(), 4);
}

#[test]
fn pictures_that_are_none_are_refused() {
    let folder = Folder::new();
    let calibration = scene().join("calibration.json");
    let whole = fs::read(scene().join("image.png")).unwrap();
    // A PNG header that promises more pixels than any memory has.
    let mut huge = whole.clone();
    huge[16..24].copy_from_slice(&[0x00, 0xff, 0xff, 0xff, 0x00, 0xff, 0xff, 0xff]);
    for picture in [
        folder.file("empty.png", b""),
        folder.file("text.png", b"not a picture"),
        folder.file("half.png", &whole[..whole.len() / 2]),
        folder.file("huge.png", huge),
        folder.dir.path().join("absent.png"),
        folder.dir.path().to_owned(),
    ] {
        let output = run(&picture, &calibration, &[], &folder.out());
        assert_refused(
            &output,
            PICTURE_ERROR,
            &[&picture.display().to_string()],
            &folder.out(),
        );
    }
}

#[test]
fn a_picture_of_another_size_is_refused() {
    let folder = Folder::new();
    let picture = folder.dir.path().join("small.png");
    image::RgbImage::new(64, 48).save(&picture).unwrap();
    let output = run(
        &picture,
        &scene().join("calibration.json"),
        &[],
        &folder.out(),
    );
    assert_refused(
        &output,
        PICTURE_ERROR,
        &["(64, 48)", "unscaled"],
        &folder.out(),
    );
}

/// The decoder would make up what is missing of a file that was cut off, and depth of it. Thumbnails have ends of their own.
#[test]
fn jpegs_that_end_early_are_refused() {
    let folder = Folder::new();
    let calibration = scene().join("calibration.json");
    let mut whole = Vec::new();
    let image = image::open(scene().join("image.png")).unwrap();
    image
        .write_to(
            &mut std::io::Cursor::new(&mut whole),
            image::ImageFormat::Jpeg,
        )
        .unwrap();
    // The start, then an application's segment with an end of image in it.
    let thumbnail = [
        &whole[..2],
        &[0xff, 0xe1, 0, 8, 0xff, 0xd8, 1, 2, 0xff, 0xd9],
    ]
    .concat();
    let whole = [&thumbnail, &whole[2..]].concat();
    let length = whole.len();
    for kept in [600, 2000, length / 2, length - 10, length - 2, length - 1] {
        let picture = folder.file("cut.jpg", &whole[..kept]);
        let output = run(&picture, &calibration, &[], &folder.out());
        assert_refused(
            &output,
            PICTURE_ERROR,
            &["cut.jpg", "ends before"],
            &folder.out(),
        );
    }
    // Cameras pad their files.
    let padded = [&whole[..], &[0; 100]].concat();
    for (bytes, out) in [(&whole, "whole"), (&padded, "padded")] {
        let picture = folder.file("whole.jpg", bytes);
        let output = run(&picture, &calibration, &[], &folder.dir.path().join(out));
        assert!(output.status.success());
    }
}

/// Every number of the calibration, each replaced by what cannot be right.
#[test]
fn calibrations_that_are_none_are_refused() {
    let folder = Folder::new();
    let whole: serde_json::Value =
        serde_json::from_str(&fs::read_to_string(scene().join("calibration.json")).unwrap())
            .unwrap();
    let changed = |pointer: &str, value: serde_json::Value| {
        let mut json = whole.clone();
        *json.pointer_mut(pointer).unwrap() = value;
        json.to_string()
    };
    let text = whole.to_string();
    for (bad, words) in [
        (String::new(), vec!["not a calibration"]),
        ("{".to_owned(), vec!["not a calibration"]),
        ("P2: 1 2 3".to_owned(), vec!["not a calibration"]),
        (text.replacen("\"K\"", "\"k\"", 1), vec!["`k`"]),
        (changed("/K/0", f64::NAN.into()), vec!["not a calibration"]),
        (
            text.replacen("\"K\":[", "\"K\":[1e999,", 1),
            vec!["not a calibration"],
        ),
        (changed("/K/0", 0.0.into()), vec!["focal length", "0"]),
        (changed("/K/4", (-1e9).into()), vec!["focal length"]),
        (changed("/K/2", 1e12.into()), vec!["principal point"]),
        (
            changed("/K/3", 1.0.into()),
            vec!["intrinsic matrix", "[1][0]"],
        ),
        (
            changed("/K/8", 0.0.into()),
            vec!["intrinsic matrix", "[2][2]"],
        ),
        (changed("/R/0", 2.0.into()), vec!["rotation"]),
        (
            changed("/R", [0, 0, 0, 0, 0, 0, 0, 0, 0].to_vec().into()),
            vec!["rotation"],
        ),
        (
            changed("/R", [1, 0, 0, 0, 1, 0, 0, 0, -1].to_vec().into()),
            vec!["mirrors"],
        ),
        (changed("/T/1", 1e300.into()), vec!["translation"]),
        (
            changed("/ground/normal", [0, 0, 0].to_vec().into()),
            vec!["direction"],
        ),
        (
            changed("/ground/offset_nominal", 50.0.into()),
            vec!["height over the ground"],
        ),
        (changed("/width", 0.into()), vec!["size"]),
        (changed("/width", (-5).into()), vec!["not a calibration"]),
        (
            changed(
                "/distortion",
                serde_json::json!({"model": "fov", "coefficients": [1.0]}),
            ),
            vec!["not a calibration", "fov"],
        ),
        (
            changed(
                "/distortion",
                serde_json::json!({"model": "plumb_bob", "coefficients": [1.0]}),
            ),
            vec!["not a calibration"],
        ),
        (
            changed(
                "/distortion",
                serde_json::json!({"model": "plumb_bob", "coefficients": [1e9, 0, 0, 0, 0]}),
            ),
            vec!["distortion"],
        ),
        (
            changed(
                "/distortion",
                serde_json::json!({
                    "model": "plumb_bob", "coefficients": [0, 0, 0, 0, 0], "coefficents": [-0.3, 0.1, 0, 0, 0],
                }),
            ),
            vec!["coefficents"],
        ),
    ] {
        let calibration = folder.file("calibration.json", &bad);
        let output = run(&scene().join("image.png"), &calibration, &[], &folder.out());
        let mut words = words;
        words.push("calibration.json");
        assert_refused(&output, CALIBRATION_ERROR, &words, &folder.out());
    }
}

const OBJECT: &str = "P0: 700 0 620 0 0 700 187 0 0 0 1 0
P2: 700 0 620 0 0 700 187 0 0 0 1 0
R0_rect: 1 0 0 0 1 0 0 0 1
Tr_velo_to_cam: 0 -1 0 0 0 0 -1 -0.08 1 0 0 -0.27
";
const CAMERA: &str = "calib_time: 09-Jan-2012 13:57:47
S_rect_02: 1242 375
R_rect_00: 1 0 0 0 1 0 0 0 1
P_rect_02: 700 0 620 0 0 700 187 0 0 0 1 0
";
const LIDAR: &str = "calib_time: 15-Mar-2012 11:37:16
R: 0 -1 0 0 0 -1 1 0 0
T: 0 -0.08 -0.27
";

/// KITTI's files; what is wrong with them is said of the file in which it is.
#[test]
fn kittis_calibrations_are_read_or_named() {
    let folder = Folder::new();
    let picture = scene().join("image.png");
    for (number, (object, words)) in [
        (OBJECT.to_owned(), vec![]),
        (format!("\u{feff}{OBJECT}"), vec![]),
        (
            OBJECT.replace("P2: 7", "P2: x7"),
            vec!["object.txt", "`P2` has `x700`"],
        ),
        (
            OBJECT.replace("Tr_velo_to_cam: 0", "Tr_velo_to_cam:"),
            vec!["object.txt", "`Tr_velo_to_cam` has 11 numbers"],
        ),
        (
            OBJECT.replace("R0_rect", "R1_rect"),
            vec!["object.txt", "`R0_rect` is missing"],
        ),
        (
            OBJECT.lines().nth(1).unwrap().to_owned(),
            vec!["object.txt", "`Tr` (odometry)", "`R_rect`"],
        ),
        (
            OBJECT.replace("P2: 700", "P2: NaN"),
            vec!["object.txt", "singular or not finite"],
        ),
    ]
    .into_iter()
    .enumerate()
    {
        let calibration = folder.file("object.txt", object);
        let out = folder.dir.path().join(number.to_string());
        let output = run(&picture, &calibration, &[], &out);
        match words.is_empty() {
            true => assert!(
                output.status.success(),
                "{}",
                String::from_utf8_lossy(&output.stderr)
            ),
            false => assert_refused(&output, CALIBRATION_ERROR, &words, &out),
        }
    }
    for (lidar, words) in [
        (
            LIDAR.replace("T: 0", "T:"),
            ["calib_velo_to_cam.txt", "`T` has 2 numbers"],
        ),
        (
            LIDAR.replace("R: 0", "R: zero"),
            ["calib_velo_to_cam.txt", "`R` has `zero`"],
        ),
        (
            LIDAR.replace("R: ", "r: "),
            ["calib_velo_to_cam.txt", "`R` is missing"],
        ),
    ] {
        folder.file("calib_velo_to_cam.txt", lidar);
        let calibration = folder.file("calib_cam_to_cam.txt", CAMERA);
        let output = run(&picture, &calibration, &[], &folder.out());
        assert_refused(&output, CALIBRATION_ERROR, &words, &folder.out());
    }
    folder.file("calib_velo_to_cam.txt", LIDAR);
    let output = run(
        &picture,
        &folder.file("calib_cam_to_cam.txt", CAMERA),
        &[],
        &folder.out(),
    );
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
}

#[test]
fn models_that_are_none_are_refused() {
    let folder = Folder::new();
    let whole = fs::read(model()).unwrap();
    let renamed = |from: &str, to: &str| -> Vec<u8> {
        assert_eq!(from.len(), to.len(), "protobuf counts bytes");
        let mut bytes = whole.clone();
        let mut found = 0;
        for at in 0..bytes.len() - from.len() {
            if bytes[at..].starts_with(from.as_bytes()) {
                bytes[at..at + to.len()].copy_from_slice(to.as_bytes());
                found += 1;
            }
        }
        assert!(found > 0, "`{from}` is not in the model");
        bytes
    };
    for (bytes, words) in [
        (Vec::new(), vec!["not an ONNX file"]),
        (b"not a model".to_vec(), vec!["not an ONNX file"]),
        (whole[..whole.len() / 2].to_vec(), vec!["not an ONNX file"]),
        (
            renamed("gedepth.contract", "gedepth_contract"),
            vec!["no gedepth contract"],
        ),
        (
            renamed("gedepth.mode", "gedepth.mood"),
            vec!["gedepth.mode"],
        ),
        (
            renamed("adaptive", "adoptive"),
            vec!["gedepth.mode", "adoptive"],
        ),
        (
            renamed("gedepth.attention_form", "gedepth.attention_farm"),
            vec!["gedepth.attention_form"],
        ),
        (
            renamed("downhill_positive", "downhill_negative"),
            vec!["gedepth.slope_sign"],
        ),
        (
            renamed("red,green,blue", "red,green,grey"),
            vec!["gedepth.channels"],
        ),
    ] {
        let model = folder.file("model.onnx", bytes);
        let output = run(
            &scene().join("image.png"),
            &scene().join("calibration.json"),
            &["--model", model.to_str().unwrap()],
            &folder.out(),
        );
        let mut words = words;
        words.push("model.onnx");
        assert_refused(&output, MODEL_ERROR, &words, &folder.out());
    }
}

/// A broken file may break tract in any way; the command still ends with a line and a code.
#[test]
fn models_with_a_flipped_byte_never_panic_the_command() {
    let folder = Folder::new();
    let whole = fs::read(model()).unwrap();
    for at in (0..whole.len()).step_by(whole.len() / 24) {
        let mut bytes = whole.clone();
        bytes[at] ^= 0x15;
        let model = folder.file("model.onnx", bytes);
        let output = run(
            &scene().join("image.png"),
            &scene().join("calibration.json"),
            &["--model", model.to_str().unwrap()],
            &folder.out(),
        );
        // A flipped weight is still a model.
        assert!(
            matches!(output.status.code(), Some(0 | MODEL_ERROR)),
            "byte {at}: {:?} {}",
            output.status,
            String::from_utf8_lossy(&output.stderr)
        );
    }
}

/// A tensor's type is a byte that tract, for some, has no code for.
#[test]
fn models_with_another_type_of_tensor_never_panic_the_command() {
    let folder = Folder::new();
    let whole = fs::read(model()).unwrap();
    let name = b"trunk.encoder.stem.bias_quantized";
    let named = |at: &usize| whole[*at..].starts_with(name) && whole[at - 4..at - 2] == [0x10, 6];
    let at = (4..whole.len()).find(named).unwrap() - 3;
    for data_type in 0..24 {
        let mut bytes = whole.clone();
        bytes[at] = data_type;
        let model = folder.file("model.onnx", bytes);
        let output = inspect(&[model.to_str().unwrap()]);
        let refused = output.status.code() == Some(MODEL_ERROR);
        assert!(
            refused || output.status.success(),
            "{data_type}: {:?}",
            output.status
        );
    }
}

/// Not a file with another's depth beside it, and none where another should be.
#[test]
fn outputs_of_an_earlier_run_do_not_stay_among_those_of_another() {
    let folder = Folder::new();
    let (picture, calibration) = (scene().join("image.png"), scene().join("calibration.json"));
    let baseline = model().with_file_name("baseline-int8.onnx");
    let baseline = ["--model", baseline.to_str().unwrap()];
    assert!(
        run(&picture, &calibration, &[], &folder.out())
            .status
            .success()
    );
    assert!(folder.out().join("attention.png").exists());
    assert!(
        run(&picture, &calibration, &baseline, &folder.out())
            .status
            .success()
    );
    assert!(!folder.out().join("attention.png").exists());

    let before = fs::read(folder.out().join("depth.png")).unwrap();
    fs::remove_file(folder.out().join("ground.png")).unwrap();
    fs::create_dir(folder.out().join("ground.png")).unwrap();
    let output = run(&picture, &calibration, &[], &folder.out());
    assert_eq!(output.status.code(), Some(WRITE_ERROR));
    assert!(String::from_utf8_lossy(&output.stderr).contains("ground.png"));
    assert_eq!(fs::read(folder.out().join("depth.png")).unwrap(), before);
}

/// The picture, its calibration, what a data set has measured, and outputs that links lead to one place.
#[cfg(unix)]
#[test]
fn nothing_is_written_over_inputs_measured_depth_or_another_output() {
    let refused = |folder: &Folder, name: &str, kept: &[(&str, &[u8])], words: &[&str]| {
        let out = folder.out();
        let output = run(&out.join(name), &out.join("calibration.json"), &[], &out);
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(WRITE_ERROR), "{message}");
        for word in words {
            assert!(message.contains(word), "`{word}` is not in: {message}");
        }
        for (name, bytes) in kept {
            assert_eq!(&fs::read(out.join(name)).unwrap(), bytes, "{name}");
        }
        assert_eq!(fs::read_dir(&out).unwrap().count(), kept.len() + 1);
    };
    let picture = fs::read(scene().join("image.png")).unwrap();
    let frame = |name: &str| {
        let folder = Folder::new();
        fs::create_dir(folder.out()).unwrap();
        fs::write(folder.out().join(name), &picture).unwrap();
        fs::copy(
            scene().join("calibration.json"),
            folder.out().join("calibration.json"),
        )
        .unwrap();
        folder
    };

    let over_itself = frame("depth_colours.png");
    let kept: [(&str, &[u8]); 1] = [("depth_colours.png", &picture)];
    refused(
        &over_itself,
        "depth_colours.png",
        &kept,
        &["depth_colours.png", "input"],
    );

    let measured = frame("image.png");
    fs::write(measured.out().join("ground.png"), b"measured").unwrap();
    let kept: [(&str, &[u8]); 2] = [("image.png", &picture), ("ground.png", b"measured")];
    refused(
        &measured,
        "image.png",
        &kept,
        &["ground.png", "another folder"],
    );

    let linked = frame("image.png");
    for name in ["depth.png", "depth_colours.png"] {
        std::os::unix::fs::symlink("both.png", linked.out().join(name)).unwrap();
    }
    fs::write(linked.out().join("both.png"), b"").unwrap();
    let kept: [(&str, &[u8]); 4] = [
        ("image.png", &picture),
        ("both.png", b""),
        ("depth.png", b""),
        ("depth_colours.png", b""),
    ];
    refused(
        &linked,
        "image.png",
        &kept,
        &["depth_colours.png", "another output"],
    );
}

/// A folder in the way of what is only to be removed.
#[test]
fn nothing_is_written_beside_what_cannot_be_removed() {
    let folder = Folder::new();
    let attention = folder.out().join("attention.png");
    fs::create_dir_all(&attention).unwrap();
    let baseline = model().with_file_name("baseline-int8.onnx");
    let output = run(
        &scene().join("image.png"),
        &scene().join("calibration.json"),
        &["--model", baseline.to_str().unwrap()],
        &folder.out(),
    );
    assert_eq!(output.status.code(), Some(WRITE_ERROR));
    assert!(String::from_utf8_lossy(&output.stderr).contains("attention.png"));
    assert_eq!(fs::read_dir(folder.out()).unwrap().count(), 1);
}

/// A full log does not change the exit code.
#[test]
fn an_error_that_cannot_be_told_keeps_its_code() {
    let Ok(full) = fs::File::options().write(true).open("/dev/full") else {
        return;
    };
    let status = Command::new(env!("CARGO_BIN_EXE_gedepth"))
        .args(["inspect", "absent.onnx"])
        .stderr(full)
        .status()
        .unwrap();
    assert_eq!(status.code(), Some(MODEL_ERROR));
}

/// Paths need not be text.
#[cfg(target_os = "linux")]
#[test]
fn a_model_whose_name_is_no_text_is_inspected() {
    use std::os::unix::ffi::OsStrExt;
    let folder = Folder::new();
    let path = folder
        .dir
        .path()
        .join(std::ffi::OsStr::from_bytes(b"m\xff.onnx"));
    fs::copy(model(), &path).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_gedepth"));
    let output = command
        .args(["inspect", "--json"])
        .arg(path)
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(json["path"].as_str().unwrap().ends_with("m\u{fffd}.onnx"));
}

/// A script must not take half a table for a whole one.
#[test]
fn a_standard_output_that_cannot_be_written_is_an_error() {
    let Ok(full) = fs::File::options().write(true).open("/dev/full") else {
        return;
    };
    let output = Command::new(env!("CARGO_BIN_EXE_gedepth"))
        .args(["inspect", "--json"])
        .stdout(full)
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(WRITE_ERROR));
    assert!(String::from_utf8_lossy(&output.stderr).contains("standard output"));
}

#[test]
fn an_output_folder_that_cannot_be_written_is_refused() {
    let folder = Folder::new();
    let file = folder.file("out", b"a file where the folder should be");
    let output = run(
        &scene().join("image.png"),
        &scene().join("calibration.json"),
        &[],
        &file,
    );
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(WRITE_ERROR), "{message}");
    assert_eq!(
        fs::read(&file).unwrap(),
        b"a file where the folder should be"
    );

    // The device that is always full: its folder cannot take files, even from root.
    let full = Path::new("/proc/self/gedepth");
    if Path::new("/proc/self").exists() {
        let output = run(
            &scene().join("image.png"),
            &scene().join("calibration.json"),
            &[],
            full,
        );
        assert_eq!(output.status.code(), Some(WRITE_ERROR));
    }
}

#[test]
fn wrong_calls_are_refused() {
    let folder = Folder::new();
    let (picture, calibration) = (scene().join("image.png"), scene().join("calibration.json"));
    for more in [
        ["--network-size", "wide"],
        ["--network-size", "100x100"],
        ["--network-size", "8192x4096"],
        ["--size", "1x1"],
    ] {
        let output = run_at(&picture, &calibration, &more, &folder.out());
        assert_eq!(output.status.code(), Some(2), "{more:?}");
    }
}

#[test]
fn threads_stay_on_cores_that_there_are() {
    let folder = Folder::new();
    let (picture, calibration) = (scene().join("image.png"), scene().join("calibration.json"));
    for cores in ["1023", "70000"] {
        let output = run(&picture, &calibration, &["--cores", cores], &folder.out());
        assert_refused(&output, 2, &["cores", cores], &folder.out());
    }
    let output = run(&picture, &calibration, &["--cores", "0"], &folder.out());
    assert!(output.status.success());
}

#[test]
fn bench_measures_every_stage() {
    let bench = |more: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_gedepth"))
            .arg("bench")
            .arg(scene().join("image.png"))
            .arg("--calibration")
            .arg(scene().join("calibration.json"))
            .args(["--network-size", "320x96", "--threads", "1"])
            .args(more)
            .output()
            .unwrap();
        let message = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{message}");
        String::from_utf8(output.stdout).unwrap()
    };
    let table = bench(&["--runs", "3", "--profile"]);
    for word in [
        "320 x 96",
        "preprocess",
        "network",
        "fusion",
        "all",
        "p99",
        "depthwise 3x3",
    ] {
        assert!(table.contains(word), "{table}");
    }
    // The first convolution, from colours and ground to 32 channels: its weights at each pixel; and what it reads and writes.
    let first = table
        .lines()
        .find(|line| line.contains("convolution 3x3 / 2"))
        .unwrap();
    let columns: Vec<&str> = first.split_whitespace().collect();
    let weights = 3 * 3 * 4 * 32;
    let pixels = 48 * 160;
    let bytes = 4 * 96 * 320 + weights + 32 * pixels;
    assert_eq!(
        columns[1],
        format!("{:.1}", f64::from(weights * pixels) / 1e6)
    );
    assert_eq!(columns[2], format!("{:.3}", f64::from(bytes) / 1e6));
    let raw = bench(&["--runs", "3", "--raw"]);
    let numbers: Vec<Vec<f64>> = raw
        .lines()
        .map(|run| run.split(' ').map(|n| n.parse().unwrap()).collect())
        .collect();
    assert_eq!(numbers.len(), 3, "{raw}");
    assert!(numbers.iter().all(|run| run.len() == 3), "{raw}");
}

/// `gedepth inspect | head -n 1`: what is left of the output has nobody to read it.
#[test]
fn a_reader_who_leaves_is_no_error() {
    let mut child = Command::new(env!("CARGO_BIN_EXE_gedepth"))
        .arg("inspect")
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{message}");
    assert_eq!(message, "");
}
