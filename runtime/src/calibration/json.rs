//! The project's own calibration file, JSON:
//!
//! ```json
//! {
//!   "width": 1242, "height": 375,
//!   "K": [721.5, 0, 609.6, 0, 721.5, 172.9, 0, 0, 1],
//!   "distortion": null,
//!   "R": [0, -1, 0, 0, 0, -1, 1, 0, 0],
//!   "T": [0, 1.65, 0],
//!   "ground": { "normal": [0, 0, 1], "offset_nominal": 0 }
//! }
//! ```
//!
//! - `width`, `height`: size of the picture, pixels.
//! - `K`: row-major 3x3 intrinsics, pixels; integer coordinates are pixel centres.
//! - `distortion`: absent, `null`, or `{"model": "plumb_bob", "coefficients": [k1, k2, p1, p2, k3]}`;
//!   `rational_polynomial` takes 8 coefficients `[k1, k2, p1, p2, k3, k4, k5, k6]`, `equidistant` 4 `[k1, k2, k3, k4]`.
//! - `R` row-major 3x3, `T` metres: world to camera, `p_camera = R p_world + T`; camera x right, y down, z forward.
//! - `ground`: the plane `normal . p_world = offset_nominal`, metres, `normal` pointing up.
//! - `world`, `note`, `ground.offset_fitted`, `ground.grade_percent_fitted`: for people; accepted, not used.
//!   Any other entry is an error: a misspelt one must not go unnoticed.

use serde::Deserialize;

use super::{Distortion, Numbers};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    width: u32,
    height: u32,
    #[serde(rename = "K")]
    k: [f64; 9],
    #[serde(default)]
    distortion: Option<Coefficients>,
    #[serde(rename = "R")]
    r: [f64; 9],
    #[serde(rename = "T")]
    t: [f64; 3],
    ground: Ground,
    #[serde(rename = "world")]
    _world: Option<String>,
    #[serde(rename = "note")]
    _note: Option<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Ground {
    normal: [f64; 3],
    offset_nominal: f64,
    #[serde(rename = "offset_fitted")]
    _offset_fitted: Option<f64>,
    #[serde(rename = "grade_percent_fitted")]
    _grade_percent_fitted: Option<f64>,
}

#[derive(Deserialize)]
#[serde(
    tag = "model",
    content = "coefficients",
    rename_all = "snake_case",
    deny_unknown_fields
)]
enum Coefficients {
    PlumbBob([f64; 5]),
    RationalPolynomial([f64; 8]),
    Equidistant([f64; 4]),
}

/// Parses the text of a calibration file; the error says what is wrong with which entry.
pub(super) fn parse(text: &str) -> Result<Numbers, String> {
    let file: File = serde_json::from_str(text).map_err(|e| e.to_string())?;
    Ok(Numbers {
        size: Some((file.width, file.height)),
        k: rows(file.k),
        distortion: match file.distortion {
            None => Distortion::None,
            Some(Coefficients::PlumbBob(c)) => Distortion::PlumbBob(c),
            Some(Coefficients::RationalPolynomial(c)) => Distortion::RationalPolynomial(c),
            Some(Coefficients::Equidistant(c)) => Distortion::Equidistant(c),
        },
        r: rows(file.r),
        t: file.t,
        up: file.ground.normal,
        offset: file.ground.offset_nominal,
    })
}

fn rows(m: [f64; 9]) -> [[f64; 3]; 3] {
    [[m[0], m[1], m[2]], [m[3], m[4], m[5]], [m[6], m[7], m[8]]]
}
