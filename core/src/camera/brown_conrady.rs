//! The Brown-Conrady camera: ROS `plumb_bob` (5 coefficients) and `rational_polynomial` (8), OpenCV's default models.
//!
//! A point (x, y) of the image plane at z = 1 is moved, with `r^2 = x^2 + y^2`, to
//!
//! ```text
//! x' = x g + 2 p1 x y + p2 (r^2 + 2 x^2)        g = (1 + k1 r^2 + k2 r^4 + k3 r^6)
//! y' = y g + p1 (r^2 + 2 y^2) + 2 p2 x y          / (1 + k4 r^2 + k5 r^4 + k6 r^6)
//! ```

use core::ops::RangeInclusive;

use glam::{DVec2, DVec3};

use super::{CameraModel, ImageSize, Intrinsics, Pixel, check_coefficients, monotone};
use crate::scalar::{atan2, sin_cos, tan};
use crate::{Angle, CameraFrame, Direction, Error, Point};

/// A camera with radial and tangential distortion.
///
/// It sees the cone around the optical axis within which the distortion neither folds nor tears: its Jacobian, which is
/// symmetric, stays positive definite with a determinant of 1e-3 to 1e3 (checked on 32 meridians), so that no two rays share
/// a pixel. The cone reaches at most 89 degrees from the axis. Polynomials of narrow lenses turn back not far
/// beyond the corners of their picture; there is no ray there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BrownConrady {
    intrinsics: Intrinsics,
    /// k1, k2, p1, p2, k3, k4, k5, k6: OpenCV's order.
    coefficients: [f64; 8],
    /// The largest radius on the undistorted image plane.
    limit: f64,
}

const ANGLE_MAX: Angle = Angle::from_degrees(89.0);
const DETERMINANT: RangeInclusive<f64> = 1e-3..=1e3;
const MERIDIANS: u32 = 32;

impl BrownConrady {
    /// A camera with coefficients `[k1, k2, p1, p2, k3]`, in the order of OpenCV and ROS `plumb_bob`.
    ///
    /// # Errors
    /// [`Error::DistortionCoefficient`] if one is not finite or beyond +-1e6.
    pub fn new(intrinsics: Intrinsics, coefficients: [f64; 5]) -> Result<Self, Error> {
        let [k1, k2, p1, p2, k3] = coefficients;
        Self::rational(intrinsics, [k1, k2, p1, p2, k3, 0.0, 0.0, 0.0])
    }

    /// A camera with coefficients `[k1, k2, p1, p2, k3, k4, k5, k6]`, in the order of OpenCV and ROS
    /// `rational_polynomial`.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn rational(intrinsics: Intrinsics, coefficients: [f64; 8]) -> Result<Self, Error> {
        check_coefficients(&coefficients)?;
        let mut camera = Self {
            intrinsics,
            coefficients,
            limit: tan(ANGLE_MAX.radians()),
        };
        let angle = super::valid_until(ANGLE_MAX.radians(), |angle| {
            let radius = tan(angle);
            (0..MERIDIANS).all(|k| {
                let (sin, cos) =
                    sin_cos(core::f64::consts::TAU * f64::from(k) / f64::from(MERIDIANS));
                camera.is_regular(radius * DVec2::new(cos, sin))
            })
        });
        camera.limit = tan(angle);
        Ok(camera)
    }

    /// Its intrinsics.
    pub const fn intrinsics(&self) -> &Intrinsics {
        &self.intrinsics
    }

    /// The same lens with other intrinsics: after cropping, resizing, flipping or binning.
    pub const fn with_intrinsics(self, intrinsics: Intrinsics) -> Self {
        Self { intrinsics, ..self }
    }

    /// g and its derivative by r^2, at r^2; the denominator must be positive.
    fn radial(&self, s: f64) -> Option<(f64, f64)> {
        let [k1, k2, _, _, k3, k4, k5, k6] = self.coefficients;
        let over = 1.0 + s * (k1 + s * (k2 + s * k3));
        let over_slope = k1 + s * (2.0 * k2 + s * 3.0 * k3);
        let under = 1.0 + s * (k4 + s * (k5 + s * k6));
        let under_slope = k4 + s * (2.0 * k5 + s * 3.0 * k6);
        let g = over / under;
        (under > 0.0).then_some((g, (over_slope - g * under_slope) / under))
    }

    /// Where the distortion moves `p`, and its (symmetric) Jacobian `[dx'/dx, dx'/dy, dy'/dy]`.
    fn distorted(&self, p: DVec2) -> Option<(DVec2, [f64; 3])> {
        let [_, _, p1, p2, ..] = self.coefficients;
        let DVec2 { x, y } = p;
        let s = p.length_squared();
        let (g, slope) = self.radial(s)?;
        let moved = DVec2::new(
            x * g + 2.0 * p1 * x * y + p2 * (s + 2.0 * x * x),
            y * g + p1 * (s + 2.0 * y * y) + 2.0 * p2 * x * y,
        );
        let jacobian = [
            g + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x,
            2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y,
            g + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x,
        ];
        Some((moved, jacobian))
    }

    /// Whether the Jacobian at `p` is neither nearly singular nor huge. It is positive definite on the axis, and stays so
    /// until its determinant has been 0.
    fn is_regular(&self, p: DVec2) -> bool {
        self.distorted(p)
            .is_some_and(|(_, [xx, xy, yy])| DETERMINANT.contains(&(xx * yy - xy * xy)))
    }

    /// The point that the distortion moves to `target`.
    fn undistorted(&self, target: DVec2) -> Option<DVec2> {
        // Mostly the distortion is so mild that Newton's steps lead there from where its factor is about undone.
        self.search(target, self.start(target))
            .or_else(|| self.search(target, self.radially_undistorted(target)))
    }

    /// About the point that the distortion moves to `target`.
    fn start(&self, target: DVec2) -> DVec2 {
        target / self.radial(target.length_squared()).map_or(1.0, |(g, _)| g)
    }

    /// The radius that the radial part of the distortion gives to the radius `r`, and its slope.
    fn radius(&self, r: f64) -> [f64; 2] {
        self.radial(r * r)
            .map_or([f64::INFINITY, 1.0], |(g, slope)| {
                [r * g, g + 2.0 * r * r * slope]
            })
    }

    /// The point that the radial part of the distortion moves to `target`, or towards it as far as the field of view
    /// goes.
    fn radially_undistorted(&self, target: DVec2) -> DVec2 {
        let radius = target.length();
        let radius = monotone::invert(|r| self.radius(r), radius, radius, self.limit);
        target.normalize_or_zero() * radius
    }

    /// Newton's steps from `start` to the point that is moved to `target`; `None` if they do not lead there.
    fn search(&self, target: DVec2, start: DVec2) -> Option<DVec2> {
        let mut p = start.clamp_length_max(self.limit);
        for _ in 0..20 {
            let (moved, [xx, xy, yy]) = self.distorted(p)?;
            let miss = target - moved;
            let step = DVec2::new(yy * miss.x - xy * miss.y, xx * miss.y - xy * miss.x)
                / (xx * yy - xy * xy);
            p += step;
            let inside = p.length_squared() <= self.limit * self.limit;
            // The next step would be of the order of this one's square.
            if step.length_squared() <= 1e-18 && inside {
                return Some(p);
            }
            // Beyond the limit is another sheet of a fold; a target there is never met.
            p = p.clamp_length_max(self.limit);
        }
        None
    }
}

impl CameraModel for BrownConrady {
    fn size(&self) -> ImageSize {
        self.intrinsics.size()
    }

    fn field_of_view(&self) -> Angle {
        Angle::from_radians(atan2(self.limit, 1.0))
    }

    fn project(&self, point: Point<CameraFrame>) -> Option<Pixel> {
        let DVec3 { x, y, z } = point.vector();
        let p = DVec2::new(x / z, y / z);
        if !(z > 0.0 && p.length() <= self.limit) {
            return None;
        }
        let (moved, _) = self.distorted(p)?;
        Some(self.intrinsics.pixel(moved.x, moved.y))
    }

    fn unproject(&self, pixel: Pixel) -> Option<Direction<CameraFrame>> {
        let p = self.forward_ray(pixel)?;
        Direction::new(p.x, p.y, 1.0).ok()
    }

    fn forward_ray(&self, pixel: Pixel) -> Option<DVec2> {
        let (x, y) = self.intrinsics.image_plane(pixel);
        self.undistorted(DVec2::new(x, y))
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec2;

    use super::BrownConrady;
    use crate::Error;
    use crate::camera::{ImageSize, Intrinsics};

    fn camera(coefficients: [f64; 8]) -> Result<BrownConrady, Error> {
        let intrinsics = Intrinsics::centred(ImageSize::new(1000, 800)?, 700.0)?;
        BrownConrady::rational(intrinsics, coefficients)
    }

    /// Wrong slopes would only make Newton's steps lead there later, or not from everywhere.
    #[test]
    fn slopes_are_those_of_the_values() -> Result<(), Error> {
        const STEP: f64 = 1e-6;
        let c = camera([-0.3, 0.12, 0.05, -0.04, -0.02, 0.07, 0.03, 0.01])?;
        for (x, y) in [(0.3, 0.2), (-0.4, 0.1), (0.25, -0.45), (-0.1, -0.6)] {
            let moved = |x: f64, y: f64| c.distorted(DVec2::new(x, y)).map_or(DVec2::NAN, |d| d.0);
            let by_x = (moved(x + STEP, y) - moved(x - STEP, y)) / (2.0 * STEP);
            let by_y = (moved(x, y + STEP) - moved(x, y - STEP)) / (2.0 * STEP);
            let (_, [xx, xy, yy]) = c.distorted(DVec2::new(x, y)).unwrap_or_default();
            for (slope, truth) in [(xx, by_x.x), (xy, by_x.y), (xy, by_y.x), (yy, by_y.y)] {
                assert!((slope - truth).abs() < 1e-8, "({x}, {y}): {slope}, {truth}");
            }
            let slope = (c.radius(x.abs() + STEP)[0] - c.radius(x.abs() - STEP)[0]) / (2.0 * STEP);
            assert!((c.radius(x.abs())[1] - slope).abs() < 1e-8, "{x}: {slope}");
        }
        Ok(())
    }

    /// Both starts of the search: one that is cheap and near, and one that is exact but for the tangential part.
    #[test]
    fn the_search_starts_well() -> Result<(), Error> {
        let usual = camera([-0.3, 0.12, 0.0005, -0.0004, -0.02, 0.0, 0.0, 0.0])?;
        let radial = camera([-0.3, 0.12, 0.0, 0.0, -0.02, 0.0, 0.0, 0.0])?;
        for (x, y) in [(0.5, 0.0), (-0.3, 0.3), (0.1, -0.4), (-0.6, -0.2)] {
            let target = DVec2::new(x, y);
            let end = usual.undistorted(target).unwrap_or(DVec2::NAN);
            let (from_start, from_target) = (usual.start(target) - end, target - end);
            assert!(from_start.length() < 0.3 * from_target.length());
            let back = radial.distorted(radial.radially_undistorted(target));
            let (back, _) = back.unwrap_or_default();
            assert!((back - target).length() < 1e-9);
        }
        Ok(())
    }
}
