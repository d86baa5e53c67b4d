//! Cameras: from a point in the camera's frame to a pixel and back.
//!
//! - Camera frame: x right, y down, z forward; pixels: u right, v down, integers at pixel centres.
//! - [`Pinhole`] (with skew).
//! - [`CameraModel`] is what tables need; a model of your own may implement it.
//!
//! Sides of a picture are 1 to 65535 pixels, focal lengths 0.01 to 1e7 pixels, so that no inverse depth leaves the
//! range of `f32`. What the camera cannot see is `None`; nothing panics.

mod intrinsics;
mod pinhole;
mod pixel;

pub use intrinsics::Intrinsics;
pub use pinhole::Pinhole;
pub use pixel::{ImageSize, Pixel};

use crate::{CameraFrame, Direction, Point};

/// A camera: which pixel a point falls on, and which ray a pixel sees.
pub trait CameraModel {
    /// The picture's size.
    fn size(&self) -> ImageSize;

    /// The pixel that `point` falls on, inside the picture or not; `None` if it is outside the valid field of view
    /// (behind a pinhole camera, where a distortion folds).
    fn project(&self, point: Point<CameraFrame>) -> Option<Pixel>;

    /// The ray that `pixel` sees; `None` where the model has no ray. Rays at 90 degrees or more from the optical axis
    /// have `z <= 0`.
    fn unproject(&self, pixel: Pixel) -> Option<Direction<CameraFrame>>;

    /// The intrinsics, if this camera is a pinhole without distortion: its ground is then linear in (u, v), and
    /// tables are filled without unprojecting each pixel.
    fn as_pinhole(&self) -> Option<&Intrinsics> {
        None
    }
}
