//! Picture sizes and pixel positions.

use crate::Error;

/// The size of a picture or map: at least one pixel, each side at most [`ImageSize::MAX_SIDE`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct ImageSize {
    width: u32,
    height: u32,
}

impl ImageSize {
    /// The longest side, pixels; with it the number of pixels fits a 32-bit `usize`.
    pub const MAX_SIDE: u32 = 65_535;

    /// A picture of `width` columns and `height` rows.
    ///
    /// # Errors
    /// [`Error::ImageSize`] if a side is 0 or longer than [`Self::MAX_SIDE`].
    pub const fn new(width: u32, height: u32) -> Result<Self, Error> {
        if width == 0 || height == 0 || width > Self::MAX_SIDE || height > Self::MAX_SIDE {
            return Err(Error::ImageSize { width, height });
        }
        Ok(Self { width, height })
    }

    /// Columns.
    pub const fn width(self) -> u32 {
        self.width
    }

    /// Rows.
    pub const fn height(self) -> u32 {
        self.height
    }

    /// Values of a row. The compiler sees that it is not 0: maps are cut into rows without code for a panic.
    pub(crate) const fn row(self) -> usize {
        if self.width == 0 {
            return 1;
        }
        self.width as usize
    }

    /// Pixels: the length of a row-major map of this size.
    pub const fn pixels(self) -> usize {
        self.width as usize * self.height as usize
    }

    /// Whether `pixel` lies on the picture's area, which reaches half a pixel beyond the outermost pixel centres.
    pub fn contains(self, pixel: Pixel) -> bool {
        pixel.u >= -0.5
            && pixel.v >= -0.5
            && pixel.u < f64::from(self.width) - 0.5
            && pixel.v < f64::from(self.height) - 0.5
    }
}

/// A position in a picture, in pixels: `u` to the right, `v` down.
///
/// Integer coordinates are the **centres** of pixels: (0, 0) is the centre of the top left pixel and the picture's
/// area begins at (-0.5, -0.5). This is the convention of OpenCV, of KITTI's calibrations and of the reference
/// implementation of GEDepth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pixel {
    /// Columns to the right of the centre of the leftmost pixels.
    pub u: f64,
    /// Rows below the centre of the topmost pixels.
    pub v: f64,
}

impl Pixel {
    /// The position (u, v).
    pub const fn new(u: f64, v: f64) -> Self {
        Self { u, v }
    }
}
