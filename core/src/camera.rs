//! Cameras: from a point in the camera's frame to a pixel and back.
//!
//! - Camera frame: x right, y down, z forward; pixels: u right, v down, integers at pixel centres.
//! - [`Pinhole`] (with skew), [`BrownConrady`] (5 or 8 coefficients), [`KannalaBrandt`] (fisheye).
//! - [`Intrinsics`] are common to all: cropping, resizing, flipping and binning a picture changes them and leaves the lens
//!   alone ([`BrownConrady::with_intrinsics`]).
//! - [`CameraModel`] is what tables need; a model of your own may implement it.
//!
//! Sides of a picture are 1 to 65535 pixels, focal lengths 0.01 to 1e7 pixels, so that no inverse depth leaves the
//! range of `f32`. What the camera cannot see is `None`; nothing panics.

mod brown_conrady;
mod intrinsics;
mod kannala_brandt;
mod monotone;
mod pinhole;
mod pixel;

pub use brown_conrady::BrownConrady;
pub(crate) use intrinsics::FOCAL_LENGTHS;
pub use intrinsics::Intrinsics;
pub use kannala_brandt::KannalaBrandt;
pub use pinhole::Pinhole;
pub use pixel::{ImageSize, Pixel};

use glam::{DVec2, DVec3};

use crate::{Angle, CameraFrame, Direction, Error, Point};

/// A camera: which pixel a point falls on, and which ray a pixel sees.
pub trait CameraModel {
    /// The picture's size.
    fn size(&self) -> ImageSize;

    /// The valid field of view: the largest angle from the optical axis at which the model is known to have rays.
    fn field_of_view(&self) -> Angle;

    /// The pixel that `point` falls on, inside the picture or not; `None` if it is outside the valid field of view
    /// (behind a pinhole camera, where a distortion folds).
    fn project(&self, point: Point<CameraFrame>) -> Option<Pixel>;

    /// The ray that `pixel` sees; `None` where the model has no ray. Rays at 90 degrees or more from the optical axis
    /// have `z <= 0`.
    fn unproject(&self, pixel: Pixel) -> Option<Direction<CameraFrame>>;

    /// The point (x, y) at z = 1 on the ray that `pixel` sees; `None` where there is no ray, or none that points forward
    /// (less than about 1e-6 short of 90 degrees, a distorted lens' do not).
    fn forward_ray(&self, pixel: Pixel) -> Option<DVec2> {
        forward(self.unproject(pixel)?.vector())
    }

    /// The intrinsics, if this camera is a pinhole without distortion: its ground is then linear in (u, v), and
    /// tables are filled without unprojecting each pixel.
    fn as_pinhole(&self) -> Option<&Intrinsics> {
        None
    }
}

/// Where the ray in direction `ray` meets the plane z = 1, if it points forward.
#[inline]
fn forward(ray: DVec3) -> Option<DVec2> {
    let point = DVec2::new(ray.x, ray.y) / ray.z;
    (ray.z > 0.0 && point.abs().max_element() <= FORWARD_MAX).then_some(point)
}

/// How far out at z = 1 rays still count as forward (89.99994 degrees), so that inverse depths stay far inside the range of
/// `f32`.
const FORWARD_MAX: f64 = 1e6;

/// Distortion coefficients that no polynomial of ours overflows with.
fn check_coefficients(coefficients: &[f64]) -> Result<(), Error> {
    for (index, value) in (0..).zip(coefficients) {
        if !(-1e6..=1e6).contains(value) {
            return Err(Error::DistortionCoefficient {
                index,
                value: *value,
            });
        }
    }
    Ok(())
}

/// How far from 0 a distortion is `valid` without interruption, at most to `end` (radians).
fn valid_until(end: f64, valid: impl Fn(f64) -> bool) -> f64 {
    // Fine enough for polynomials of so few terms; a dip narrower than a step would have to be contrived.
    const STEPS: u32 = 2000;
    let step = end / f64::from(STEPS);
    let mut good = 0.0;
    for k in 1..=STEPS {
        let angle = step * f64::from(k);
        if valid(angle) {
            good = angle;
            continue;
        }
        let mut bad = angle;
        for _ in 0..40 {
            let middle = 0.5 * (good + bad);
            if valid(middle) {
                good = middle;
            } else {
                bad = middle;
            }
        }
        break;
    }
    good
}
