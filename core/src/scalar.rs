//! Elementary functions of one `f64`, which `core` lacks: glam's, so that this crate needs no second
//! mathematics library.

use glam::DVec2;

pub(crate) fn sin_cos(radians: f64) -> (f64, f64) {
    let unit = DVec2::from_angle(radians);
    (unit.y, unit.x)
}

pub(crate) fn tan(radians: f64) -> f64 {
    let (sin, cos) = sin_cos(radians);
    sin / cos
}

pub(crate) fn atan2(y: f64, x: f64) -> f64 {
    DVec2::new(x, y).to_angle()
}

pub(crate) fn sqrt(x: f64) -> f64 {
    DVec2::splat(x).sqrt().x
}
