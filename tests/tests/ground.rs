//! The ground of real calibration files: against formulas of the test's own, and against LiDAR.
#![allow(clippy::expect_used, clippy::panic)] // a test that cannot go on says why

use std::path::Path;

use gedepth::Calibration;
use gedepth_core::camera::CameraModel;
use gedepth_core::slope::adaptive_inverse_depth;
use gedepth_core::table::GroundView;
use gedepth_tests::{depth, folders, real_data};

/// Eq. 5 in f64 from the numbers of a `calibration.json`, by solving for the ray instead of inverting K:
/// `1/z = n . R^T K^-1 [u v 1] / (d - n . B)`.
struct Eq5 {
    /// The plane's normal, up, in the camera.
    up: [f64; 3],
    k: [f64; 9],
    /// H = n . B - d.
    height: f64,
}

impl Eq5 {
    fn read(path: &Path) -> Self {
        let json: serde_json::Value =
            serde_json::from_str(&std::fs::read_to_string(path).expect("readable")).expect("JSON");
        let numbers = |value: &serde_json::Value| -> Vec<f64> {
            value
                .as_array()
                .expect("a list")
                .iter()
                .map(|n| n.as_f64().expect("a number"))
                .collect()
        };
        let (k, r, t) = (
            numbers(&json["K"]),
            numbers(&json["R"]),
            numbers(&json["T"]),
        );
        let n = numbers(&json["ground"]["normal"]);
        let d = json["ground"]["offset_nominal"].as_f64().expect("a number");
        // R n; B = -R^T T.
        let rotated = |i: usize| (0..3).map(|j| r[3 * i + j] * n[j]).sum::<f64>();
        let up = [rotated(0), rotated(1), rotated(2)];
        let n_b: f64 = -(0..3).map(|i| up[i] * t[i]).sum::<f64>();
        Self {
            up,
            k: k.try_into().expect("nine"),
            height: n_b - d,
        }
    }

    fn inverse_depth(&self, u: f64, v: f64) -> f64 {
        let [fx, s, cx, _, fy, cy, ..] = self.k;
        let y = (v - cy) / fy;
        let x = (u - cx - s * y) / fx;
        let [a, b, c] = self.up;
        -(a * x + b * y + c) / self.height
    }
}

#[test]
fn table_is_eq_5_for_every_real_frame() {
    let Some(frames) = real_data("frames") else {
        return;
    };
    for frame in folders(&frames) {
        let path = frame.join("calibration.json");
        let calibration = Calibration::read(&path).expect("a calibration");
        let oracle = Eq5::read(&path);
        let camera = calibration
            .camera(calibration.size().expect("a size"))
            .expect("a camera");
        let size = camera.size();
        let mut table = vec![0.0; GroundView::len(size)];
        let view = GroundView::build(&mut table, &camera, calibration.ground()).expect("a table");
        let mut compared = 0;
        for v in 0..size.height() {
            for u in 0..size.width() {
                let expected = oracle.inverse_depth(f64::from(u), f64::from(v));
                let z = f64::from(view.depth(u, v).expect("inside"));
                if expected <= 0.0 {
                    assert_eq!(
                        z,
                        0.0,
                        "{}: ({u}, {v}) is above the vanishing line",
                        frame.display()
                    );
                } else if expected > 1.0 / 200.0 {
                    assert!(
                        (z * expected - 1.0).abs() < 1e-4,
                        "{}: ({u}, {v})",
                        frame.display()
                    );
                    compared += 1;
                }
                // Eq. 7, downhill and uphill.
                let inverse = f64::from(view.inverse_depth(u, v).expect("inside"));
                for slope in [3f64.to_radians(), -3f64.to_radians()] {
                    let sloped = expected - slope.tan() / oracle.height;
                    let ours = adaptive_inverse_depth(inverse, slope, calibration.ground());
                    if sloped > 1.0 / 200.0 {
                        assert!(
                            (ours / sloped - 1.0).abs() < 1e-4,
                            "{}: ({u}, {v})",
                            frame.display()
                        );
                    }
                }
            }
        }
        assert!(
            compared > 1000,
            "{}: only {compared} pixels see ground",
            frame.display()
        );
    }
}

/// The reference implementation's ground for KITTI: `z = -1.65` in the LiDAR's frame, seen through
/// `P2 R0_rect Tr_velo_to_cam`, all in f64 and all from the file's own text.
struct Reference {
    /// `A^-1`'s last row and `(A^-1 a4)_z - 1.65`, with `A` the left part of the projection and `a4` its last column.
    last_row: [f64; 3],
    numerator: f64,
}

impl Reference {
    fn read(path: &Path) -> Self {
        let text = std::fs::read_to_string(path).expect("readable");
        let numbers = |keys: &[&str]| -> Option<Vec<f64>> {
            let line = text.lines().find(|line| {
                let key = line.split_whitespace().next().unwrap_or_default();
                keys.contains(&key.trim_end_matches(':'))
            })?;
            Some(
                line.split_whitespace()
                    .skip(1)
                    .map(|n| n.parse().expect("a number"))
                    .collect(),
            )
        };
        let p2 = numbers(&["P2"]).expect("P2");
        let rect =
            numbers(&["R0_rect", "R_rect"]).unwrap_or(vec![1., 0., 0., 0., 1., 0., 0., 0., 1.]);
        let tr = numbers(&["Tr_velo_to_cam", "Tr_velo_cam", "Tr"]).expect("Tr");
        // R0_rect Tr, then P2 times that, as 3x4 matrices whose fourth row is 0 0 0 1.
        let mut rectified = [[0.0; 4]; 3];
        let mut m = [[0.0; 4]; 3];
        for i in 0..3 {
            for j in 0..4 {
                rectified[i][j] = (0..3).map(|k| rect[3 * i + k] * tr[4 * k + j]).sum();
            }
        }
        for i in 0..3 {
            for j in 0..4 {
                m[i][j] = (0..3).map(|k| p2[4 * i + k] * rectified[k][j]).sum::<f64>()
                    + if j == 3 { p2[4 * i + 3] } else { 0.0 };
            }
        }
        // Last row of the inverse, by cofactors.
        let determinant = m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1])
            - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
            + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0]);
        let last_row = [
            (m[1][0] * m[2][1] - m[1][1] * m[2][0]) / determinant,
            (m[0][1] * m[2][0] - m[0][0] * m[2][1]) / determinant,
            (m[0][0] * m[1][1] - m[0][1] * m[1][0]) / determinant,
        ];
        let numerator = (0..3).map(|i| last_row[i] * m[i][3]).sum::<f64>() - 1.65;
        Self {
            last_row,
            numerator,
        }
    }

    fn depth(&self, u: f64, v: f64) -> f64 {
        let [a, b, c] = self.last_row;
        self.numerator / (a * u + b * v + c)
    }
}

#[test]
fn table_is_the_reference_formula_for_every_kitti_file() {
    let Some(files) = real_data("calibrations") else {
        return;
    };
    for name in [
        "kitti_object/000008.txt",
        "kitti_object/000010.txt",
        "kitti_odometry/1.txt",
        "kitti_odometry/2.txt",
        "kitti_odometry/3.txt",
        "kitti_tracking/0001.txt",
    ] {
        let path = files.join(name);
        let reference = Reference::read(&path);
        let calibration = Calibration::read(&path).expect(name);
        let camera = calibration.camera((1242, 375)).expect(name);
        let mut table = vec![0.0; GroundView::len(camera.size())];
        let view = GroundView::build(&mut table, &camera, calibration.ground()).expect(name);
        let mut compared = 0;
        for v in 0..375 {
            for u in 0..1242 {
                let expected = reference.depth(f64::from(u), f64::from(v));
                if expected > 0.0 && expected <= 200.0 {
                    let z = f64::from(view.depth(u, v).expect("inside"));
                    assert!(
                        (z / expected - 1.0).abs() < 1e-4,
                        "{name}: ({u}, {v}) {z} {expected}"
                    );
                    compared += 1;
                }
            }
        }
        assert!(compared > 100_000, "{name}: {compared}");
    }
    // KITTI raw is the same camera, given in two files.
    let raw = Calibration::read(&files.join("kitti_raw/calib_cam_to_cam.txt")).expect("raw");
    let object = Calibration::read(&files.join("kitti_object/000008.txt")).expect("object");
    assert_eq!(raw.size(), Some((1242, 375)));
    assert!((raw.ground().height() - object.ground().height()).abs() < 1e-6);
    let difference = raw.ground().down().vector() - object.ground().down().vector();
    assert!(difference.length() < 1e-6);
}

/// The paper's Figure 4: how many LiDAR points on the road lie within 3 % of the ground depth.
#[test]
fn ground_agrees_with_lidar_as_well_as_the_reference_formula() {
    let Some(data) = real_data("") else { return };
    for number in ["000008", "000010"] {
        let frame = data.join(format!("frames/kitti_object__training_{number}"));
        let reference =
            Reference::read(&data.join(format!("calibrations/kitti_object/{number}.txt")));
        let path = frame.join("calibration.json");
        let calibration = Calibration::read(&path).expect("a calibration");
        let (width, height, lidar) = depth(&frame.join("depth.png"));
        let camera = calibration.camera((width, height)).expect("a camera");
        let mut table = vec![0.0; GroundView::len(camera.size())];
        let view = GroundView::build(&mut table, &camera, calibration.ground()).expect("a table");
        let oracle = Eq5::read(&path);
        let json: serde_json::Value =
            serde_json::from_str(&std::fs::read_to_string(&path).expect("readable")).expect("JSON");
        let ground = |key: &str| json["ground"][key].as_f64().expect("a number");
        let (mut road, mut ours, mut theirs) = (0, 0, 0);
        for (index, &z) in lidar.iter().enumerate().filter(|&(_, &z)| z > 0.0) {
            let (u, v) = (index as u32 % width, index as u32 / width);
            let (u64, v64) = (f64::from(u), f64::from(v));
            let z = f64::from(z);
            // The point's height over the nominal plane, and the fitted road's there: H (1 - z / z_plane) is how far the
            // point is above the plane; forward distance is z to within the camera's small angles.
            let above = oracle.height * (1.0 - z * oracle.inverse_depth(u64, v64));
            let fitted = ground("offset_fitted") - ground("offset_nominal")
                + ground("grade_percent_fitted") / 100.0 * z;
            // A strip as wide as the road ahead, and what is no kerb, car or wall in it.
            let x = (u64 - oracle.k[2]) / oracle.k[0] * z;
            if (above - fitted).abs() > 0.15 || x.abs() > 4.0 {
                continue;
            }
            let within = |ground: f64| usize::from((ground - z).abs() <= 0.03 * z);
            road += 1;
            ours += within(f64::from(view.depth(u, v).expect("inside")));
            theirs += within(reference.depth(u64, v64));
        }
        let share = |n: usize| 100.0 * n as f64 / road as f64;
        println!(
            "{number}: {road} LiDAR pixels on the road, within 3 %: {:.2} % (reference formula {:.2} %)",
            share(ours),
            share(theirs)
        );
        assert!(road > 1000, "{number}: only {road} road pixels");
        assert!(
            (share(ours) - share(theirs)).abs() < 0.1,
            "{number}: {} {}",
            share(ours),
            share(theirs)
        );
    }
}
