//! Which pixels of a picture count.

use crate::Error;
use crate::camera::ImageSize;
use crate::fusion::DepthRange;

/// A rectangle of pixels; right and bottom are the first column and row outside.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Crop {
    /// First column.
    pub left: u32,
    /// First row.
    pub top: u32,
    /// The column after the last.
    pub right: u32,
    /// The row after the last.
    pub bottom: u32,
}

impl Crop {
    /// The whole picture.
    pub const fn whole(size: ImageSize) -> Self {
        Self {
            left: 0,
            top: 0,
            right: size.width(),
            bottom: size.height(),
        }
    }

    /// The crop of Garg et al. (ECCV 2016), as KITTI results are reported with it: rows 0.40810811 to 0.99189189 and
    /// columns 0.03594771 to 0.96405229 of the picture.
    pub fn garg(size: ImageSize) -> Self {
        let at = |share: f64, length: u32| (share * f64::from(length)) as u32;
        Self {
            left: at(0.035_947_71, size.width()),
            top: at(0.408_108_11, size.height()),
            right: at(0.964_052_29, size.width()),
            bottom: at(0.991_891_89, size.height()),
        }
    }

    /// Whether the pixel in column `u` and row `v` lies inside.
    pub const fn contains(&self, u: u32, v: u32) -> bool {
        self.left <= u && u < self.right && self.top <= v && v < self.bottom
    }
}

/// The usual rules: pixels inside a crop whose true depth lies in a range (to 80 m on KITTI); predictions are clamped to
/// that range.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Evaluation {
    /// The pixels that count.
    pub crop: Crop,
    /// The true depths that count, both ends included, metres.
    pub range: DepthRange,
}

impl Evaluation {
    /// Hands every pixel that counts to `take`: its index in the map, its predicted depth (clamped, NaN to the least), and
    /// its true depth, metres.
    ///
    /// # Errors
    /// [`Error::OutputLength`] if a map has another length than `size` has pixels.
    pub fn pixels(
        &self,
        size: ImageSize,
        predicted: &[f32],
        truth: &[f32],
        mut take: impl FnMut(usize, f32, f32),
    ) -> Result<(), Error> {
        for map in [predicted, truth] {
            if map.len() != size.pixels() {
                return Err(Error::OutputLength {
                    needed: size.pixels(),
                    given: map.len(),
                });
            }
        }
        let (min, max) = (self.range.min(), self.range.max());
        let width = size.width() as usize;
        for (index, (predicted, truth)) in predicted.iter().zip(truth).enumerate() {
            let (u, v) = (index % width, index / width);
            if (min..=max).contains(truth) && self.crop.contains(u as u32, v as u32) {
                take(index, predicted.max(min).min(max), *truth);
            }
        }
        Ok(())
    }
}
