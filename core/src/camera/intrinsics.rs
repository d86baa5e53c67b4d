//! The affine part that all cameras share: from the image plane at z = 1 to pixels, and what cropping, resizing,
//! flipping and binning a picture do to it.

use super::{ImageSize, Pixel};
use crate::Error;

/// Picture size, focal lengths, principal point and skew:
///
/// ```text
/// u = fx x + s y + cx        (x, y): on the image plane at z = 1, after distortion
/// v =        fy y + cy
/// ```
///
/// All in pixels, with integer coordinates at pixel **centres** (see [`Pixel`]): the centre of a picture is
/// `cx = (width - 1) / 2`, and resizing by `s` moves it to `(cx + 0.5) s - 0.5`.
///
/// A flipped picture has a negative focal length: the camera's frame stays what it was, only the
/// columns or rows run the other way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Intrinsics {
    size: ImageSize,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    skew: f64,
}

/// Pixels; of either sign where pictures are flipped.
pub(crate) const FOCAL_LENGTHS: core::ops::RangeInclusive<f64> = 1e-2..=1e7;
const OFFSET_MAX: f64 = 1e6;

impl Intrinsics {
    /// Focal lengths `fx`, `fy` and principal point (`cx`, `cy`) in pixels, no skew.
    ///
    /// # Errors
    /// [`Error::FocalLength`] outside 0.01 to 1e7, [`Error::PrincipalPoint`] beyond +-1e6, or not finite.
    pub fn new(size: ImageSize, fx: f64, fy: f64, cx: f64, cy: f64) -> Result<Self, Error> {
        for focal in [fx, fy] {
            if !FOCAL_LENGTHS.contains(&focal) {
                return Err(Error::FocalLength(focal));
            }
        }
        Self {
            size,
            fx,
            fy,
            cx,
            cy,
            skew: 0.0,
        }
        .checked()
    }

    /// Square pixels and the principal point in the picture's centre: an adopter's short way.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn centred(size: ImageSize, focal: f64) -> Result<Self, Error> {
        Self::new(
            size,
            focal,
            focal,
            (f64::from(size.width()) - 1.0) / 2.0,
            (f64::from(size.height()) - 1.0) / 2.0,
        )
    }

    /// From the matrix `K = [fx s cx; 0 fy cy; 0 0 1]`.
    ///
    /// # Errors
    /// [`Error::IntrinsicMatrix`] if an entry that must be 0 or 1 is not, else as [`Self::new`] and
    /// [`Self::with_skew`].
    pub fn from_matrix(size: ImageSize, k: [[f64; 3]; 3]) -> Result<Self, Error> {
        let fixed = [
            (1, 0, k[1][0], 0.0),
            (2, 0, k[2][0], 0.0),
            (2, 1, k[2][1], 0.0),
            (2, 2, k[2][2], 1.0),
        ];
        for (row, column, value, expected) in fixed {
            if value != expected {
                return Err(Error::IntrinsicMatrix { row, column, value });
            }
        }
        Self::new(size, k[0][0], k[1][1], k[0][2], k[1][2])?.with_skew(k[0][1])
    }

    /// The same with skew `s`, pixels.
    ///
    /// # Errors
    /// [`Error::Skew`] beyond +-1e6 or not finite.
    pub fn with_skew(self, skew: f64) -> Result<Self, Error> {
        Self { skew, ..self }.checked()
    }

    /// What every way of making intrinsics must keep.
    fn checked(self) -> Result<Self, Error> {
        for focal in [self.fx, self.fy] {
            if !FOCAL_LENGTHS.contains(&focal.abs()) {
                return Err(Error::FocalLength(focal));
            }
        }
        for offset in [self.cx, self.cy] {
            if !(-OFFSET_MAX..=OFFSET_MAX).contains(&offset) {
                return Err(Error::PrincipalPoint(offset));
            }
        }
        if !(-OFFSET_MAX..=OFFSET_MAX).contains(&self.skew) {
            return Err(Error::Skew(self.skew));
        }
        Ok(self)
    }

    /// The picture's size.
    pub const fn size(&self) -> ImageSize {
        self.size
    }

    /// The matrix `K = [fx s cx; 0 fy cy; 0 0 1]`.
    pub const fn matrix(&self) -> [[f64; 3]; 3] {
        [
            [self.fx, self.skew, self.cx],
            [0.0, self.fy, self.cy],
            [0.0, 0.0, 1.0],
        ]
    }

    /// The pixel of the point (x, y) of the image plane at z = 1.
    pub fn pixel(&self, x: f64, y: f64) -> Pixel {
        Pixel {
            u: self.fx * x + self.skew * y + self.cx,
            v: self.fy * y + self.cy,
        }
    }

    /// The point (x, y) of the image plane at z = 1 that falls on `pixel`.
    pub fn image_plane(&self, pixel: Pixel) -> (f64, f64) {
        let y = (pixel.v - self.cy) / self.fy;
        ((pixel.u - self.cx - self.skew * y) / self.fx, y)
    }

    /// After cutting out `size` pixels from column `left` and row `top` on.
    ///
    /// # Errors
    /// [`Error::CropOutsidePicture`] if the crop reaches beyond the picture.
    pub fn crop(self, left: u32, top: u32, size: ImageSize) -> Result<Self, Error> {
        let fits = |start: u32, length: u32, whole: u32| {
            start.checked_add(length).is_some_and(|end| end <= whole)
        };
        if !fits(left, size.width(), self.size.width())
            || !fits(top, size.height(), self.size.height())
        {
            return Err(Error::CropOutsidePicture {
                left,
                top,
                width: size.width(),
                height: size.height(),
            });
        }
        Self {
            size,
            cx: self.cx - f64::from(left),
            cy: self.cy - f64::from(top),
            ..self
        }
        .checked()
    }

    /// After resizing the picture's whole area to `size` (as image libraries do: corners of the area stay corners).
    ///
    /// # Errors
    /// [`Error::FocalLength`], [`Error::PrincipalPoint`] or [`Error::Skew`] if the result leaves its range.
    pub fn resize(self, size: ImageSize) -> Result<Self, Error> {
        self.scaled(
            size,
            f64::from(size.width()) / f64::from(self.size.width()),
            f64::from(size.height()) / f64::from(self.size.height()),
        )
    }

    /// After joining blocks of `factor` x `factor` pixels into one each; incomplete blocks at the right and the bottom
    /// are dropped.
    ///
    /// # Errors
    /// [`Error::Binning`] if `factor` is 0 or leaves no pixel, else as [`Self::resize`].
    pub fn bin(self, factor: u32) -> Result<Self, Error> {
        let side = |length: u32| length.checked_div(factor).unwrap_or(0);
        let Ok(size) = ImageSize::new(side(self.size.width()), side(self.size.height())) else {
            return Err(Error::Binning(factor));
        };
        let scale = 1.0 / f64::from(factor);
        self.scaled(size, scale, scale)
    }

    fn scaled(self, size: ImageSize, sx: f64, sy: f64) -> Result<Self, Error> {
        Self {
            size,
            fx: self.fx * sx,
            fy: self.fy * sy,
            // Pixel centres: the area's corner, half a pixel before the first centre, is what scales.
            cx: (self.cx + 0.5) * sx - 0.5,
            cy: (self.cy + 0.5) * sy - 0.5,
            skew: self.skew * sx,
        }
        .checked()
    }

    /// After mirroring left and right: column u becomes `width - 1 - u`.
    pub fn flip_horizontally(self) -> Self {
        Self {
            fx: -self.fx,
            skew: -self.skew,
            cx: f64::from(self.size.width()) - 1.0 - self.cx,
            ..self
        }
    }

    /// After mirroring top and bottom: row v becomes `height - 1 - v`.
    pub fn flip_vertically(self) -> Self {
        Self {
            fy: -self.fy,
            cy: f64::from(self.size.height()) - 1.0 - self.cy,
            ..self
        }
    }
}
