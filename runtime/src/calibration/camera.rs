//! The camera of a calibration file: one of core's camera models, known when the file is read.

use gedepth_core::camera::{
    BrownConrady, CameraModel, ImageSize, Intrinsics, KannalaBrandt, Pinhole, Pixel,
};
use gedepth_core::{Angle, CameraFrame, Direction, Error, Point};
use glam::DVec2;

/// How the lens bends rays; coefficients in the order of ROS and OpenCV.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Distortion {
    /// Not at all.
    None,
    /// ROS `plumb_bob`: k1, k2, p1, p2, k3.
    PlumbBob([f64; 5]),
    /// ROS `rational_polynomial`: k1, k2, p1, p2, k3, k4, k5, k6.
    RationalPolynomial([f64; 8]),
    /// ROS `equidistant`, a fisheye: k1, k2, k3, k4.
    Equidistant([f64; 4]),
}

/// A camera of any of core's models.
#[derive(Clone, Copy, Debug)]
pub enum Camera {
    /// Without distortion.
    Pinhole(Pinhole),
    /// ROS `plumb_bob` and `rational_polynomial`.
    BrownConrady(BrownConrady),
    /// ROS `equidistant`.
    KannalaBrandt(KannalaBrandt),
}

impl Camera {
    pub(super) fn new(intrinsics: Intrinsics, distortion: Distortion) -> Result<Self, Error> {
        Ok(match distortion {
            Distortion::None => Self::Pinhole(Pinhole::new(intrinsics)),
            Distortion::PlumbBob(k) => Self::BrownConrady(BrownConrady::new(intrinsics, k)?),
            Distortion::RationalPolynomial(k) => {
                Self::BrownConrady(BrownConrady::rational(intrinsics, k)?)
            }
            Distortion::Equidistant(k) => Self::KannalaBrandt(KannalaBrandt::new(intrinsics, k)?),
        })
    }

    /// The camera of the picture's part that begins at column `left` and row `top`, resized to `size`. Only the
    /// intrinsics change; the lens stays what it is.
    pub fn crop_and_resize(
        &self,
        left: u32,
        top: u32,
        region: ImageSize,
        size: ImageSize,
    ) -> Result<Self, Error> {
        let changed = |intrinsics: &Intrinsics| intrinsics.crop(left, top, region)?.resize(size);
        Ok(match self {
            Self::Pinhole(camera) => Self::Pinhole(Pinhole::new(changed(camera.intrinsics())?)),
            Self::BrownConrady(camera) => {
                Self::BrownConrady(camera.with_intrinsics(changed(camera.intrinsics())?))
            }
            Self::KannalaBrandt(camera) => {
                Self::KannalaBrandt(camera.with_intrinsics(changed(camera.intrinsics())?))
            }
        })
    }

    /// `sqrt(|fx fy|)`, pixels.
    pub fn focal_length(&self) -> f64 {
        let [[fx, ..], [_, fy, _], _] = match self {
            Self::Pinhole(camera) => camera.intrinsics(),
            Self::BrownConrady(camera) => camera.intrinsics(),
            Self::KannalaBrandt(camera) => camera.intrinsics(),
        }
        .matrix();
        (fx * fy).abs().sqrt()
    }

    fn model(&self) -> &dyn CameraModel {
        match self {
            Self::Pinhole(camera) => camera,
            Self::BrownConrady(camera) => camera,
            Self::KannalaBrandt(camera) => camera,
        }
    }
}

impl CameraModel for Camera {
    fn size(&self) -> ImageSize {
        self.model().size()
    }

    fn project(&self, point: Point<CameraFrame>) -> Option<Pixel> {
        self.model().project(point)
    }

    fn unproject(&self, pixel: Pixel) -> Option<Direction<CameraFrame>> {
        self.model().unproject(pixel)
    }

    fn field_of_view(&self) -> Angle {
        self.model().field_of_view()
    }

    fn forward_ray(&self, pixel: Pixel) -> Option<DVec2> {
        self.model().forward_ray(pixel)
    }

    fn as_pinhole(&self) -> Option<&Intrinsics> {
        self.model().as_pinhole()
    }
}
