//! The ground of every camera of the rigs that other data sets publish: Eq. 5 and Eq. 7, distorted lenses included,
//! against f64 formulas of the test's own.
#![allow(clippy::expect_used, clippy::panic)] // a test that cannot go on says why

use std::fs;
use std::path::Path;

use gedepth_core::camera::{BrownConrady, CameraModel, ImageSize, Intrinsics};
use gedepth_core::slope::adaptive_inverse_depth;
use gedepth_core::table::GroundView;
use gedepth_core::{Extrinsics, Ground, GroundPlane};
use gedepth_tests::real_data;
use serde_json::Value;

type Matrix = [[f64; 3]; 3];

/// One camera over the plane `z = ground` of its world.
struct Camera {
    name: String,
    size: (u32, u32),
    /// fx, fy, cx, cy.
    pinhole: [f64; 4],
    /// k1, k2, p1, p2, k3.
    lens: [f64; 5],
    /// World to camera.
    r: Matrix,
    t: [f64; 3],
    ground: f64,
}

fn rotation([w, x, y, z]: [f64; 4]) -> Matrix {
    [
        [
            1.0 - 2.0 * (y * y + z * z),
            2.0 * (x * y - w * z),
            2.0 * (x * z + w * y),
        ],
        [
            2.0 * (x * y + w * z),
            1.0 - 2.0 * (x * x + z * z),
            2.0 * (y * z - w * x),
        ],
        [
            2.0 * (x * z - w * y),
            2.0 * (y * z + w * x),
            1.0 - 2.0 * (x * x + y * y),
        ],
    ]
}

/// World to camera from the camera's pose in the world.
fn inverted(pose: Matrix, position: [f64; 3]) -> (Matrix, [f64; 3]) {
    let r: Matrix = std::array::from_fn(|i| std::array::from_fn(|j| pose[j][i]));
    (
        r,
        r.map(|row| -(0..3).map(|j| row[j] * position[j]).sum::<f64>()),
    )
}

fn numbers<const N: usize>(value: &Value) -> [f64; N] {
    let list = value.as_array().expect("a list");
    assert_eq!(list.len(), N);
    std::array::from_fn(|i| list[i].as_f64().expect("a number"))
}

fn named<const N: usize>(value: &Value, names: [&str; N]) -> [f64; N] {
    names.map(|name| {
        value[name]
            .as_f64()
            .unwrap_or_else(|| panic!("no `{name}`"))
    })
}

fn json(path: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(path).expect("readable")).expect("JSON")
}

fn nuscenes(path: &Path) -> Vec<Camera> {
    let sensors = json(path);
    let cameras = sensors.as_array().expect("a list").iter();
    cameras
        .filter(|sensor| {
            sensor["camera_intrinsic"]
                .as_array()
                .is_some_and(|k| !k.is_empty())
        })
        .map(|sensor| {
            let k: [[f64; 3]; 3] = std::array::from_fn(|i| numbers(&sensor["camera_intrinsic"][i]));
            let (r, t) = inverted(
                rotation(numbers(&sensor["rotation"])),
                numbers(&sensor["translation"]),
            );
            Camera {
                name: format!("nuScenes {}", sensor["token"]),
                size: (1600, 900),
                pinhole: [k[0][0], k[1][1], k[0][2], k[1][2]],
                lens: [0.0; 5],
                r,
                t,
                ground: 0.0,
            }
        })
        .collect()
}

fn ddad(path: &Path) -> Vec<Camera> {
    let rig = json(path);
    (1..rig["names"].as_array().expect("a list").len())
        .map(|i| {
            let pose = &rig["extrinsics"][i];
            let (r, t) = inverted(
                rotation(named(&pose["rotation"], ["qw", "qx", "qy", "qz"])),
                named(&pose["translation"], ["x", "y", "z"]),
            );
            Camera {
                name: format!("DDAD {}", rig["names"][i]),
                size: (1936, 1216),
                pinhole: named(&rig["intrinsics"][i], ["fx", "fy", "cx", "cy"]),
                lens: [0.0; 5],
                r,
                t,
                ground: 0.0,
            }
        })
        .collect()
}

fn argoverse(path: &Path) -> Vec<Camera> {
    let rig = json(path);
    let cameras = rig["camera_data_"].as_array().expect("a list").iter();
    cameras
        .map(|camera| {
            let value = &camera["value"];
            let pose = &value["vehicle_SE3_camera_"];
            let (r, t) = inverted(
                rotation(numbers(&pose["rotation"]["coefficients"])),
                numbers(&pose["translation"]),
            );
            let [k1, k2, k3] = numbers(&value["distortion_coefficients_"]);
            let name = camera["key"].as_str().expect("a name");
            Camera {
                name: format!("Argoverse {name}"),
                size: if name.contains("stereo") {
                    (2464, 2056)
                } else {
                    (1920, 1200)
                },
                pinhole: named(
                    value,
                    [
                        "focal_length_x_px_",
                        "focal_length_y_px_",
                        "focal_center_x_px_",
                        "focal_center_y_px_",
                    ],
                ),
                lens: [k1, k2, 0.0, 0.0, k3],
                r,
                t,
                // The vehicle's frame has its origin on the rear axle.
                ground: -0.33,
            }
        })
        .collect()
}

/// Its YAML has the numbers of each camera in a fixed order: rotation, translation, D, K.
fn pandaset(path: &Path) -> Vec<Camera> {
    let text = fs::read_to_string(path).expect("readable");
    let starts: Vec<usize> = text
        .match_indices('\n')
        .map(|(at, _)| at + 1)
        .chain([0])
        .filter(|&at| text[at..].starts_with(|c: char| c.is_ascii_lowercase()))
        .collect();
    starts
        .into_iter()
        .filter_map(|at| {
            let name = text[at..].split(':').next()?;
            let body = &text[at + name.len()..];
            let end = body.find("\nfront").into_iter().chain(body.find("\nback"));
            let end = end
                .chain(body.find("\nleft"))
                .chain(body.find("\nright"))
                .min();
            let found: Vec<f64> = body[..end.unwrap_or(body.len())]
                .split([' ', ',', ':', '{', '}', '[', ']', '\n'])
                .filter_map(|word| word.parse().ok())
                .collect();
            // The LiDAR has neither D nor K.
            let [
                qw,
                qx,
                qy,
                qz,
                tx,
                ty,
                tz,
                k1,
                k2,
                p1,
                p2,
                k3,
                fx,
                _,
                cx,
                _,
                fy,
                cy,
                ..,
            ] = found[..]
            else {
                return None;
            };
            Some(Camera {
                name: format!("PandaSet {name}"),
                size: (1920, 1080),
                pinhole: [fx, fy, cx, cy],
                lens: [k1, k2, p1, p2, k3],
                r: rotation([qw, qx, qy, qz]),
                t: [tx, ty, tz],
                // A LiDAR on the roof.
                ground: -1.85,
            })
        })
        .collect()
}

impl Camera {
    /// The lens of Brown and Conrady, forward.
    fn distorted(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [k1, k2, p1, p2, k3] = self.lens;
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        [
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        ]
    }

    /// Eq. 5 for the ray whose undistorted point at z = 1 is (x, y): `-(R n) . (x, y, 1) / H`.
    fn inverse_depth(&self, [x, y]: [f64; 2]) -> f64 {
        let up = self.r.map(|row| row[2]);
        -(up[0] * x + up[1] * y + up[2]) / self.height()
    }

    /// H = n . B - d with B = -R^T T.
    fn height(&self) -> f64 {
        -(0..3).map(|i| self.r[i][2] * self.t[i]).sum::<f64>() - self.ground
    }
}

#[test]
fn table_is_eq_5_for_every_camera_of_every_rig() {
    let Some(files) = real_data("calibrations") else {
        return;
    };
    let rigs = [
        nuscenes(&files.join("nuscenes/calibrated_sensor.json")),
        ddad(&files.join("ddad/c0e1a6f1c439b282be0066d8dfcad9dd54782030.json")),
        argoverse(&files.join("argoverse/vehicle_calibration_info.json")),
        pandaset(&files.join("pandaset/static_extrinsic_calibration.yaml")),
    ];
    assert_eq!(rigs.each_ref().map(Vec::len), [7, 3, 9, 6]);
    for camera in rigs.iter().flatten() {
        let name = &camera.name;
        let size = ImageSize::new(camera.size.0, camera.size.1).expect("a size");
        let [fx, fy, cx, cy] = camera.pinhole;
        let model = BrownConrady::new(
            Intrinsics::new(size, fx, fy, cx, cy).expect("intrinsics"),
            camera.lens,
        )
        .expect("a lens");
        let extrinsics = Extrinsics::world_to_camera(camera.r, camera.t).expect("a pose");
        let plane = GroundPlane::z_up(camera.ground).expect("a plane");
        let ground = Ground::seen_by(&extrinsics, &plane).expect("a camera over the ground");
        assert!(
            (ground.height() / camera.height() - 1.0).abs() < 1e-9,
            "{name}"
        );
        let mut table = vec![0.0; GroundView::len(size)];
        let view = GroundView::build(&mut table, &model, &ground).expect("a table");
        let (mut compared, mut blind) = (0, 0);
        for v in (0..size.height()).step_by(3) {
            for u in (0..size.width()).step_by(3) {
                let inverse = f64::from(view.inverse_depth(u, v).expect("inside"));
                let Some([x, y]) = model
                    .unproject(gedepth_core::camera::Pixel::new(f64::from(u), f64::from(v)))
                    .map(|ray| ray.vector().to_array())
                    .map(|[x, y, z]| [x / z, y / z])
                else {
                    assert!(
                        inverse < -1e30,
                        "{name}: ({u}, {v}) has no ray but {inverse}"
                    );
                    blind += 1;
                    continue;
                };
                // The ray is the one that the lens bends onto this pixel.
                let [xd, yd] = camera.distorted([x, y]);
                assert!(
                    (fx * xd + cx - f64::from(u)).abs() < 1e-3,
                    "{name}: ({u}, {v})"
                );
                assert!(
                    (fy * yd + cy - f64::from(v)).abs() < 1e-3,
                    "{name}: ({u}, {v})"
                );
                let expected = camera.inverse_depth([x, y]);
                for slope in [0.0_f64, 3.0, -3.0].map(f64::to_radians) {
                    let sloped = expected - slope.tan() / camera.height();
                    let ours = adaptive_inverse_depth(inverse, slope, &ground);
                    if sloped > 1.0 / 200.0 {
                        assert!((ours / sloped - 1.0).abs() < 1e-4, "{name}: ({u}, {v})");
                        compared += 1;
                    }
                }
            }
        }
        println!("{name}: {compared} depths compared, {blind} pixels without a ray");
        assert!(compared > 1000, "{name}: {compared}");
        assert!(blind < size.pixels() / 9 / 20, "{name}: {blind}");
    }
}
