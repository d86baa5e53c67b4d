//! The camera of a calibration file: one of core's camera models, known when the file is read.

use gedepth_core::camera::{CameraModel, ImageSize, Intrinsics, Pinhole, Pixel};
use gedepth_core::{CameraFrame, Direction, Error, Point};

/// How the lens bends rays; coefficients in the order of ROS and OpenCV.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Distortion {
    None,
    PlumbBob([f64; 5]),
    RationalPolynomial([f64; 8]),
    Equidistant([f64; 4]),
}

/// Intrinsics with the lens of the file.
#[derive(Clone, Copy, Debug)]
pub struct Camera {
    distortion: Distortion,
    model: Pinhole,
}

impl Camera {
    pub(super) fn new(intrinsics: Intrinsics, distortion: Distortion) -> Result<Self, Error> {
        let _ = distortion;
        Ok(Self {
            distortion,
            model: Pinhole::new(intrinsics),
        })
    }

    /// The camera of a picture that was cropped and then resized: only the intrinsics change, not the lens.
    pub fn crop_and_resize(
        &self,
        left: u32,
        top: u32,
        region: ImageSize,
        size: ImageSize,
    ) -> Result<Self, Error> {
        Self::new(
            self.model
                .intrinsics()
                .crop(left, top, region)?
                .resize(size)?,
            self.distortion,
        )
    }
}

impl CameraModel for Camera {
    fn size(&self) -> ImageSize {
        self.model.size()
    }

    fn project(&self, point: Point<CameraFrame>) -> Option<Pixel> {
        self.model.project(point)
    }

    fn unproject(&self, pixel: Pixel) -> Option<Direction<CameraFrame>> {
        self.model.unproject(pixel)
    }

    fn as_pinhole(&self) -> Option<&Intrinsics> {
        self.model.as_pinhole()
    }
}
