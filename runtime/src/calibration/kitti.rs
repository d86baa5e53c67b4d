//! KITTI's calibration files, all of the form `KEY: numbers` (tracking leaves out some colons).
//!
//! | benchmark | files | rectified camera | LiDAR to camera 0 |
//! |---|---|---|---|
//! | raw | `calib_cam_to_cam.txt`, `calib_velo_to_cam.txt` | `P_rect_02`, `R_rect_00`, `S_rect_02` | `R`, `T` |
//! | object | one | `P2`, `R0_rect` | `Tr_velo_to_cam` |
//! | tracking | one | `P2`, `R_rect` | `Tr_velo_cam` |
//! | odometry | one | `P2` | `Tr`, rectified already |
//!
//! The left colour camera (2) is read. World: the LiDAR's frame (x forward, y left, z up). With `P = K [I | t]`,
//! `p_camera = R_rect (R p + T) + K^-1 P[:, 3]`. The files do not say where the ground is: it is the plane
//! `z = -1.65` m, the height that the paper states for KITTI.

use std::collections::BTreeMap;

use glam::{DMat3, DVec3};

use super::{Distortion, Numbers};

/// The paper's ground for KITTI: metres along the LiDAR's z axis.
const GROUND_OFFSET: f64 = -1.65;

/// The numbers of a file by key, or the first word that is none (some lines hold dates).
pub(super) struct Entries(BTreeMap<String, Result<Vec<f64>, String>>);

impl Entries {
    pub(super) fn parse(text: &str) -> Self {
        Self(
            text.lines()
                .filter_map(|line| {
                    let mut words = line.split_ascii_whitespace();
                    let key = words.next()?.trim_end_matches(':').to_owned();
                    let numbers = words
                        .map(|word| word.parse().map_err(|_| word.to_owned()))
                        .collect();
                    Some((key, numbers))
                })
                .collect(),
        )
    }

    pub(super) fn has(&self, key: &str) -> bool {
        self.0.contains_key(key)
    }

    fn get<const N: usize>(&self, key: &str) -> Result<[f64; N], String> {
        let numbers = match self.0.get(key) {
            Some(Ok(numbers)) => numbers,
            Some(Err(word)) => {
                return Err(format!("`{key}` has `{word}` where a number should be"));
            }
            None => return Err(format!("`{key}` is missing")),
        };
        numbers
            .as_slice()
            .try_into()
            .map_err(|_| format!("`{key}` has {} numbers instead of {N}", numbers.len()))
    }

    fn matrix(&self, key: &str) -> Result<DMat3, String> {
        Ok(DMat3::from_cols_array(&self.get(key)?).transpose())
    }

    /// A 3x4 matrix as its left 3x3 part and its last column.
    fn affine(&self, key: &str) -> Result<(DMat3, DVec3), String> {
        let m: [f64; 12] = self.get(key)?;
        let row = |i: usize| DVec3::new(m[4 * i], m[4 * i + 1], m[4 * i + 2]);
        Ok((
            DMat3::from_cols(row(0), row(1), row(2)).transpose(),
            DVec3::new(m[3], m[7], m[11]),
        ))
    }
}

/// KITTI object, tracking and odometry: one file.
pub(super) fn single(file: &Entries) -> Result<Numbers, String> {
    let (rotation, lidar) = if file.has("Tr") {
        (DMat3::IDENTITY, "Tr")
    } else if file.has("Tr_velo_cam") {
        (file.matrix("R_rect")?, "Tr_velo_cam")
    } else if file.has("R0_rect") || file.has("Tr_velo_to_cam") {
        (file.matrix("R0_rect")?, "Tr_velo_to_cam")
    } else {
        return Err(
            "the LiDAR's pose is missing, from which the ground is told: `Tr` (odometry), `R0_rect` and `Tr_velo_to_cam` \
             (object), or `R_rect` and `Tr_velo_cam` (tracking)"
                .to_owned(),
        );
    };
    numbers(None, file.affine("P2")?, rotation, file.affine(lidar)?)
}

/// LiDAR to camera 0, of the LiDAR's file of KITTI raw.
pub(super) fn lidar(velo_to_cam: &Entries) -> Result<(DMat3, DVec3), String> {
    let translation = velo_to_cam.get("T")?;
    Ok((velo_to_cam.matrix("R")?, DVec3::from_array(translation)))
}

/// KITTI raw: the camera file, and what the LiDAR file says.
pub(super) fn raw(cam_to_cam: &Entries, lidar: (DMat3, DVec3)) -> Result<Numbers, String> {
    let [width, height]: [f64; 2] = cam_to_cam.get("S_rect_02")?;
    if !(width >= 1.0 && height >= 1.0 && width <= 65536.0 && height <= 65536.0) {
        return Err(format!("`S_rect_02` is not a size: {width} x {height}"));
    }
    numbers(
        Some((width as u32, height as u32)),
        cam_to_cam.affine("P_rect_02")?,
        cam_to_cam.matrix("R_rect_00")?,
        lidar,
    )
}

fn numbers(
    size: Option<(u32, u32)>,
    (k, kt): (DMat3, DVec3),
    rect: DMat3,
    (r, t): (DMat3, DVec3),
) -> Result<Numbers, String> {
    // A singular K leaves a non-finite t behind, which the check of the extrinsics would report as their fault.
    let determinant = k.determinant();
    if determinant == 0.0 || !determinant.is_finite() {
        return Err("the camera matrix is singular or not finite".to_owned());
    }
    let rotation = rect * r;
    let translation = rect * t + k.inverse() * kt;
    let rows = |m: DMat3| m.transpose().to_cols_array_2d();
    Ok(Numbers {
        size,
        k: rows(k),
        distortion: Distortion::None,
        r: rows(rotation),
        t: translation.to_array(),
        up: [0.0, 0.0, 1.0],
        offset: GROUND_OFFSET,
    })
}
