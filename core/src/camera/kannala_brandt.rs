//! The Kannala-Brandt fisheye camera (ROS `equidistant`, OpenCV `fisheye`).
//!
//! The angle `t` from the optical axis becomes the radius `t P(t^2)` on the image plane, with
//! `P(s) = 1 + k1 s + k2 s^2 + k3 s^3 + k4 s^4`.

use core::ops::RangeInclusive;

use glam::{DVec2, DVec3};

use super::{
    CameraModel, FORWARD_MAX, ImageSize, Intrinsics, Pixel, check_coefficients, monotone,
    valid_until,
};
use crate::scalar::{atan2, sqrt};
use crate::{Angle, CameraFrame, Direction, Error, Point};

/// A fisheye camera with four coefficients.
///
/// It sees the cone around the optical axis within which the radius grows with the angle, by 0.01 to 100 per radian, up to
/// 179 degrees from the axis; beyond there is no ray, since two rays would claim one pixel. Rays at 90 degrees and more have
/// no planar depth, so tables hold no ground there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KannalaBrandt {
    intrinsics: Intrinsics,
    k: [f64; 4],
    /// Where the search for an angle starts: at equal distances of the radius squared, the angle squared and its slope
    /// (per interval).
    nodes: [[f64; 2]; INTERVALS + 1],
    /// At the edge of the field of view: the angle squared, and the radius squared.
    limit: f64,
    limit_radius: f64,
    /// Intervals of `nodes` per unit of the radius squared.
    per_interval: f64,
}

const ANGLE_MAX: Angle = Angle::from_degrees(179.0);
const SLOPE: RangeInclusive<f64> = 1e-2..=1e2;
const INTERVALS: usize = 12;

impl KannalaBrandt {
    /// A camera with coefficients `[k1, k2, k3, k4]`.
    ///
    /// # Errors
    /// [`Error::DistortionCoefficient`] if one is not finite or beyond +-1e6.
    pub fn new(intrinsics: Intrinsics, k: [f64; 4]) -> Result<Self, Error> {
        check_coefficients(&k)?;
        let mut camera = Self {
            intrinsics,
            k,
            nodes: [[0.0; 2]; INTERVALS + 1],
            limit: 0.0,
            limit_radius: 0.0,
            per_interval: 0.0,
        };
        // d(t P)/dt = P + 2 s P'
        let angle = valid_until(ANGLE_MAX.radians(), |angle| {
            let s = angle * angle;
            let [p, slope] = camera.polynomial(s);
            SLOPE.contains(&(p + 2.0 * s * slope))
        });
        camera.limit = angle * angle;
        camera.limit_radius = camera.radius_squared(camera.limit)[0];
        Ok(camera.with_intrinsics(intrinsics))
    }

    /// Its intrinsics.
    pub const fn intrinsics(&self) -> &Intrinsics {
        &self.intrinsics
    }

    /// The same lens with other intrinsics: after cropping, resizing, flipping or binning.
    pub fn with_intrinsics(mut self, intrinsics: Intrinsics) -> Self {
        self.intrinsics = intrinsics;
        // The search starts well for all pixels of the picture, and somehow for others.
        let (right, bottom) = (intrinsics.size().width(), intrinsics.size().height());
        let mut largest: f64 = 1e-9;
        for (u, v) in [(0, 0), (right, 0), (0, bottom), (right, bottom)] {
            let (x, y) = intrinsics.image_plane(Pixel::new(f64::from(u), f64::from(v)));
            largest = largest.max(x * x + y * y);
        }
        self.per_interval = INTERVALS as f64 / largest.min(self.limit_radius);
        let lens = self;
        for (i, node) in self.nodes.iter_mut().enumerate() {
            let squared = i as f64 / lens.per_interval;
            let s = lens.angle_squared(squared, squared);
            let [_, slope] = lens.radius_squared(s);
            *node = [s, 1.0 / slope / lens.per_interval];
        }
        self
    }

    /// P and its derivative at `s`.
    #[inline]
    fn polynomial(&self, s: f64) -> [f64; 2] {
        let [k1, k2, k3, k4] = self.k;
        // Pairs of terms, which shortens the chain of dependent operations.
        let q = s * s;
        [
            (1.0 + s * k1) + q * ((k2 + s * k3) + q * k4),
            (k1 + s * (2.0 * k2)) + q * (3.0 * k3 + s * (4.0 * k4)),
        ]
    }

    /// The radius squared, `s P(s)^2`, and its derivative by `s`, the angle squared.
    #[inline]
    fn radius_squared(&self, s: f64) -> [f64; 2] {
        let [p, slope] = self.polynomial(s);
        [s * p * p, p * (p + 2.0 * s * slope)]
    }

    /// The angle squared where the radius squared is `squared`, searched from `start` on.
    #[inline]
    fn angle_squared(&self, squared: f64, start: f64) -> f64 {
        monotone::invert(|s| self.radius_squared(s), squared, start, self.limit)
    }

    /// About the angle squared where the radius squared is `squared`.
    #[inline]
    fn start(&self, squared: f64) -> Option<f64> {
        let place = squared * self.per_interval;
        let index = (place as usize).min(INTERVALS - 1);
        let [before, after] = *self.nodes.get(index..)?.first_chunk::<2>()?;
        Some(cubic(before, after, place - index as f64))
    }

    /// The ray through the point (x, y) of the image plane: its x and y as the same multiple of (x, y), and its z.
    #[inline]
    fn ray(&self, x: f64, y: f64) -> Option<[f64; 2]> {
        // Everything is even in the angle, so that squares are enough: no root is taken.
        let squared = x * x + y * y;
        // Also false for NaN.
        if !(0.0..=self.limit_radius).contains(&squared) {
            return None;
        }
        let s = self.angle_squared(squared, self.start(squared)?);
        let (sinc, cos) = sinc_cos(s);
        Some([sinc, self.polynomial(s)[0] * cos])
    }
}

/// The cubic between two points at distance 1, each with value and slope, at the share `t` of the way.
#[inline]
fn cubic([a, a_slope]: [f64; 2], [b, b_slope]: [f64; 2], t: f64) -> f64 {
    let rise = b - a;
    let left = a_slope - rise;
    let right = rise - b_slope;
    a + t * (rise + (1.0 - t) * (left + t * (right - left)))
}

/// `sin t / t` and `cos t` for `s = t^2` up to pi^2, to 1e-14: the series of the half angle, and its doubling.
#[inline]
fn sinc_cos(s: f64) -> (f64, f64) {
    let h = s / 4.0;
    // 1/(2n + 1)! and 1/(2n)!; even and odd terms apart, which halves the chain of dependent operations.
    let q = h * h;
    let sinc = (1.0
        + q * (1.0 / 120.0
            + q * (1.0 / 362_880.0
                + q * (1.0 / 6_227_020_800.0 + q * (1.0 / 355_687_428_096_000.0)))))
        - h * (1.0 / 6.0
            + q * (1.0 / 5_040.0
                + q * (1.0 / 39_916_800.0
                    + q * (1.0 / 1_307_674_368_000.0 + q * (1.0 / 121_645_100_408_832_000.0)))));
    let cos = (1.0
        + q * (1.0 / 24.0
            + q * (1.0 / 40_320.0 + q * (1.0 / 479_001_600.0 + q * (1.0 / 20_922_789_888_000.0)))))
        - h * (0.5
            + q * (1.0 / 720.0
                + q * (1.0 / 3_628_800.0
                    + q * (1.0 / 87_178_291_200.0 + q * (1.0 / 6_402_373_705_728_000.0)))));
    (sinc * cos, 1.0 - 2.0 * h * sinc * sinc)
}

impl CameraModel for KannalaBrandt {
    fn size(&self) -> ImageSize {
        self.intrinsics.size()
    }

    fn field_of_view(&self) -> Angle {
        Angle::from_radians(sqrt(self.limit))
    }

    fn project(&self, point: Point<CameraFrame>) -> Option<Pixel> {
        let ray: Direction<CameraFrame> = Direction::from_vector(point.vector()).ok()?;
        let DVec3 { x, y, z } = ray.vector();
        let from_axis = DVec2::new(x, y).length();
        let angle = atan2(from_axis, z);
        let s = angle * angle;
        if s > self.limit {
            return None;
        }
        let scale = if from_axis > 0.0 {
            angle / from_axis * self.polynomial(s)[0]
        } else {
            0.0
        };
        Some(self.intrinsics.pixel(x * scale, y * scale))
    }

    fn unproject(&self, pixel: Pixel) -> Option<Direction<CameraFrame>> {
        let (x, y) = self.intrinsics.image_plane(pixel);
        let [across, along] = self.ray(x, y)?;
        Direction::new(x * across, y * across, along).ok()
    }

    #[inline]
    fn forward_ray(&self, pixel: Pixel) -> Option<DVec2> {
        let (x, y) = self.intrinsics.image_plane(pixel);
        let [across, along] = self.ray(x, y)?;
        let scale = across / along;
        (along > 0.0 && scale < FORWARD_MAX).then_some(DVec2::new(x * scale, y * scale))
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::{KannalaBrandt, sinc_cos};
    use crate::camera::{ImageSize, Intrinsics};

    /// What makes the search short: it starts within 1e-4 of its end anywhere in the picture of a usual fisheye.
    #[test]
    fn the_search_starts_well() -> Result<(), crate::Error> {
        let intrinsics = Intrinsics::centred(ImageSize::new(1216, 352)?, 350.0)?;
        let camera = KannalaBrandt::new(intrinsics, [0.02, -0.01, 0.004, -0.0008])?;
        for i in 0..=1808 {
            let squared = f64::from(i) * 1e-3 * f64::from(i) * 1e-3;
            let start = camera.start(squared).unwrap_or(f64::NAN);
            let s = camera.angle_squared(squared, start);
            assert!((camera.radius_squared(s)[0] - squared).abs() < 1e-9);
            assert!(
                (start - s).abs() < 1e-4,
                "radius squared {squared}: {start} instead of {s}"
            );
        }
        Ok(())
    }

    #[test]
    fn series_up_to_180_degrees() {
        for i in 0..=3141 {
            let t = f64::from(i) * 1e-3;
            let (sinc, cos) = sinc_cos(t * t);
            let truth = if t > 0.0 { t.sin() / t } else { 1.0 };
            assert!((sinc - truth).abs() < 1e-14, "sin({t}) / {t} is {sinc}");
            assert!((cos - t.cos()).abs() < 1e-14, "cos({t}) is {cos}");
        }
    }
}
