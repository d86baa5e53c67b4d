//! The pinhole camera, with skew.

use glam::{DVec2, DVec3};

use super::{CameraModel, ImageSize, Intrinsics, Pixel};
use crate::{Angle, CameraFrame, Direction, Point};

/// A camera without distortion. It sees every point in front of it (z > 0), and has a ray for every pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pinhole {
    intrinsics: Intrinsics,
}

impl Pinhole {
    /// The pinhole camera with these intrinsics.
    pub const fn new(intrinsics: Intrinsics) -> Self {
        Self { intrinsics }
    }

    /// The camera of a cropped, resized, flipped or binned picture.
    pub const fn with_intrinsics(self, intrinsics: Intrinsics) -> Self {
        Self { intrinsics }
    }

    /// Its intrinsics.
    pub const fn intrinsics(&self) -> &Intrinsics {
        &self.intrinsics
    }
}

impl CameraModel for Pinhole {
    fn size(&self) -> ImageSize {
        self.intrinsics.size()
    }

    fn field_of_view(&self) -> Angle {
        Angle::from_degrees(90.0)
    }

    fn project(&self, point: Point<CameraFrame>) -> Option<Pixel> {
        let DVec3 { x, y, z } = point.vector();
        let pixel = self.intrinsics.pixel(x / z, y / z);
        (z > 0.0 && pixel.u.is_finite() && pixel.v.is_finite()).then_some(pixel)
    }

    fn unproject(&self, pixel: Pixel) -> Option<Direction<CameraFrame>> {
        let (x, y) = self.intrinsics.image_plane(pixel);
        Direction::new(x, y, 1.0).ok()
    }

    fn forward_ray(&self, pixel: Pixel) -> Option<DVec2> {
        let (x, y) = self.intrinsics.image_plane(pixel);
        let point = DVec2::new(x, y);
        point.is_finite().then_some(point)
    }

    fn as_pinhole(&self) -> Option<&Intrinsics> {
        Some(&self.intrinsics)
    }
}
