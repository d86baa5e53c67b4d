//! The tables of real calibrations, which are not part of this repository: looked for in `../shared/data` beside it.
#![allow(clippy::unwrap_used)]

use std::fs;
use std::path::Path;

use gedepth_core::camera::{BrownConrady, CameraModel, ImageSize, Intrinsics, Pinhole, Pixel};
use gedepth_core::slope::adaptive_inverse_depth;
use gedepth_core::table::{FixedView, GroundCoefficients, GroundRows, GroundView, RayView};
use gedepth_core::{Direction, Extrinsics, Ground, GroundPlane};

type Matrix = [[f64; 3]; 3];

fn numbers<const N: usize>(value: &serde_json::Value) -> [f64; N] {
    let list = value.as_array().unwrap();
    assert_eq!(list.len(), N);
    std::array::from_fn(|i| list[i].as_f64().unwrap())
}

fn rows(flat: [f64; 9]) -> Matrix {
    std::array::from_fn(|i| std::array::from_fn(|j| flat[3 * i + j]))
}

fn inverse(m: Matrix) -> Matrix {
    let c = |i: usize, j: usize| {
        let (a, b, c, d) = ((i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3);
        m[a][c] * m[b][d] - m[a][d] * m[b][c]
    };
    let determinant = (0..3).map(|j| m[0][j] * c(0, j)).sum::<f64>();
    std::array::from_fn(|i| std::array::from_fn(|j| c(j, i) / determinant))
}

fn apply(a: Matrix, p: [f64; 3]) -> [f64; 3] {
    a.map(|row| row.iter().zip(p).map(|(a, b)| a * b).sum())
}

/// Eq. 5 and Eq. 7 at every pixel of every frame's calibration, with the file's own numbers, in all forms of table.
#[test]
fn every_frame() {
    let frames = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data/frames");
    let Ok(entries) = fs::read_dir(&frames) else {
        println!("skipped: no data in {}", frames.display());
        return;
    };
    for entry in entries {
        let file = entry.unwrap().path().join("calibration.json");
        let c: serde_json::Value =
            serde_json::from_str(&fs::read_to_string(&file).unwrap()).unwrap();
        let k = rows(numbers::<9>(&c["K"]));
        let r = rows(numbers::<9>(&c["R"]));
        let t = numbers::<3>(&c["T"]);
        let n = numbers::<3>(&c["ground"]["normal"]);
        let d = c["ground"]["offset_nominal"].as_f64().unwrap();
        let side = |name: &str| u32::try_from(c[name].as_u64().unwrap()).unwrap();
        let size = ImageSize::new(side("width"), side("height")).unwrap();

        let intrinsics = Intrinsics::from_matrix(size, k).unwrap();
        let camera = Pinhole::new(intrinsics);
        let up = Direction::new(n[0], n[1], n[2]).unwrap();
        let extrinsics = Extrinsics::world_to_camera(r, t).unwrap();
        let ground = Ground::seen_by(&extrinsics, &GroundPlane::new(up, d).unwrap()).unwrap();
        let mut memory = vec![0.0; size.pixels()];
        let table = GroundView::build(&mut memory, &camera, &ground).unwrap();
        let mut fixed = vec![0; size.pixels()];
        let fixed = FixedView::<256, 255>::build(&mut fixed, &camera, &ground).unwrap();
        let mut ray_memory = vec![0.0; RayView::len(size)];
        let rays = RayView::build(&mut ray_memory, &camera).unwrap();
        let mut rebuilt = vec![0.0; size.pixels()];
        let rebuilt = GroundView::rebuild(&mut rebuilt, &rays, &ground).unwrap();

        let (k_inverse, r_inverse) = (inverse(k), inverse(r));
        let b = apply(r_inverse, t).map(|c| -c);
        let height = n.iter().zip(b).map(|(n, b)| n * b).sum::<f64>() - d;
        let (mut worst, mut worst_rebuilt, mut worst_sloped, mut worst_step) =
            (0.0_f64, 0.0_f64, 0.0_f64, 0.0_f64);
        for (index, value) in table.values().iter().enumerate() {
            let (u, v) = (index % size.width() as usize, index / size.width() as usize);
            let a = apply(r_inverse, apply(k_inverse, [u as f64, v as f64, 1.0]));
            let truth = -n.iter().zip(a).map(|(n, a)| n * a).sum::<f64>() / height;
            let relative = |value: f64, truth: f64| (value / truth - 1.0).abs();
            if truth >= 1.0 / 200.0 {
                worst = worst.max(relative(f64::from(*value), truth));
                worst_rebuilt =
                    worst_rebuilt.max(relative(f64::from(rebuilt.values()[index]), truth));
            }
            if truth <= 0.0 {
                assert_eq!(
                    table.depth(u as u32, v as u32),
                    Some(0.0),
                    "{}: ({u}, {v})",
                    file.display()
                );
            }
            let step = f64::from(fixed.values()[index])
                - 256.0
                    * if truth >= 1.0 / 255.0 {
                        1.0 / truth
                    } else {
                        0.0
                    };
            worst_step = worst_step.max(step.abs());
            for degrees in [-4.0_f64, 2.5] {
                let sloped = truth - degrees.to_radians().tan() / height;
                if sloped >= 1.0 / 200.0 {
                    let got =
                        adaptive_inverse_depth(f64::from(*value), degrees.to_radians(), &ground);
                    worst_sloped = worst_sloped.max(relative(got, sloped));
                }
            }
        }
        println!(
            "{}: up to 200 m off by {worst:.1e}, from kept rays {worst_rebuilt:.1e}, sloped {worst_sloped:.1e}, fixed point {worst_step:.2} steps",
            file.parent().unwrap().file_name().unwrap().display()
        );
        assert!(worst <= 1e-5 && worst_rebuilt <= 1e-5 && worst_sloped <= 1e-5);
        assert!(worst_step <= 1.0);
        assert_eq!(table.size(), size);
        let far = GroundCoefficients::new(&intrinsics, &ground).coefficients();
        assert!(far.iter().all(|c| c.is_finite()));
    }
}

/// A camera with OpenCV coefficients: its table is that of undistorted pixels, within 1e-5 up to 200 m.
#[test]
fn a_distorted_calibration() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../shared/data/calibrations/camera_lidar_opencv/calib.txt");
    let Ok(text) = fs::read_to_string(&file) else {
        println!("skipped: no {}", file.display());
        return;
    };
    let line = |key: &str| -> Vec<f64> {
        let line = text
            .lines()
            .find_map(|line| line.strip_prefix(key))
            .unwrap();
        line.split_whitespace()
            .map(|word| word.parse().unwrap())
            .collect()
    };
    let (k, distortion, t) = (line("K:"), line("D:"), line("T:"));
    let size = ImageSize::new(1920, 1280).unwrap();
    let k = rows(<[f64; 9]>::try_from(k).unwrap());
    let intrinsics = Intrinsics::from_matrix(size, k).unwrap();
    let d: [f64; 5] = distortion.try_into().unwrap();
    let camera = BrownConrady::new(intrinsics, d).unwrap();
    let r = [[t[0], t[1], t[2]], [t[4], t[5], t[6]], [t[8], t[9], t[10]]];
    let extrinsics = Extrinsics::world_to_camera(r, [t[3], t[7], t[11]]).unwrap();
    let ground = Ground::seen_by(&extrinsics, &GroundPlane::z_up(-1.9).unwrap()).unwrap();
    let mut memory = vec![0.0; size.pixels()];
    let table = GroundView::build(&mut memory, &camera, &ground).unwrap();
    let (mut worst, mut without) = (0.0_f64, 0);
    for (index, value) in table.values().iter().enumerate() {
        let (u, v) = ((index % 1920) as f64, (index / 1920) as f64);
        let Some(ray) = camera.unproject(Pixel::new(u, v)) else {
            without += 1;
            continue;
        };
        // Distorting the ray again, by OpenCV's equations, must give the pixel: the table's rays are the right ones.
        let (x, y) = (
            ray.vector().x / ray.vector().z,
            ray.vector().y / ray.vector().z,
        );
        let s = x * x + y * y;
        let g = 1.0 + s * (d[0] + s * (d[1] + s * d[4]));
        let moved_x = x * g + 2.0 * d[2] * x * y + d[3] * (s + 2.0 * x * x);
        let moved_y = y * g + d[2] * (s + 2.0 * y * y) + 2.0 * d[3] * x * y;
        assert!((k[0][0] * moved_x + k[0][2] - u).abs() < 1e-6);
        assert!((k[1][1] * moved_y + k[1][2] - v).abs() < 1e-6);
        let down = ground.down().vector();
        let truth = (down.x * x + down.y * y + down.z) / ground.height();
        if truth >= 1.0 / 200.0 {
            worst = worst.max((f64::from(*value) / truth - 1.0).abs());
        }
    }
    println!("distorted: off by {worst:.1e} up to 200 m; {without} pixels without a ray");
    assert!(worst <= 1e-5);
    assert_eq!(without, 0);
}
