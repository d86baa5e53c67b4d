//! Three numbers instead of a table: the ground of a pinhole camera is linear in (u, v).

use super::{GroundRows, ImageSize, check_height};

use crate::camera::Intrinsics;
use crate::{Error, Ground};

/// The inverse ground depth of a pinhole camera, `1/z = a + b u + c v`, and what fusion needs besides.
///
/// Rows are made on demand. Their error is at most `2^-23 (|1/z| + 16 |b|)`: 1e-5 of the depth up to 200 m wherever
/// `|b|` is below 0.02, which takes a focal length times height of less than 50 m px to exceed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GroundCoefficients {
    size: ImageSize,
    height: f32,
    origin: f64,
    per_column: f64,
    per_row: f64,
}

/// Columns that share one start in `f64`: the fewer, the smaller the error beside the vanishing line.
const BLOCK: usize = 16;

impl GroundCoefficients {
    /// The ground as the pinhole camera with these intrinsics sees it.
    pub fn new(intrinsics: &Intrinsics, ground: &Ground) -> Self {
        let [[fx, skew, cx], [_, fy, cy], _] = intrinsics.matrix();
        let down = ground.down().vector();
        // down . K^-1 [u v 1] / H, sorted by u and v.
        let per_column = down.x / fx / ground.height();
        let per_row = (down.y - down.x * skew / fx) / fy / ground.height();
        Self {
            size: intrinsics.size(),
            height: ground.height() as f32,
            origin: down.z / ground.height() - per_column * cx - per_row * cy,
            per_column,
            per_row,
        }
    }

    /// Coefficients made earlier, as [`Self::coefficients`] gives them; `camera_height` in metres.
    ///
    /// # Errors
    /// [`Error::CameraNotAboveGround`] if `camera_height` is not positive and finite.
    pub fn from_values(
        [origin, per_column, per_row]: [f64; 3],
        size: ImageSize,
        camera_height: f32,
    ) -> Result<Self, Error> {
        Ok(Self {
            size,
            height: check_height(camera_height)?,
            origin,
            per_column,
            per_row,
        })
    }

    /// `[a, b, c]` of `1/z = a + b u + c v`, in 1/m and 1/m per pixel.
    pub const fn coefficients(&self) -> [f64; 3] {
        [self.origin, self.per_column, self.per_row]
    }

    /// The inverse depth at column `u`, row `v`, 1/m, in full precision.
    pub fn inverse_depth(&self, u: f64, v: f64) -> f64 {
        self.origin + self.per_column * u + self.per_row * v
    }

    /// Writes row `v` from column 0 on.
    #[inline(always)]
    pub(super) fn fill_row(&self, v: u32, row: &mut [f32]) {
        // Each block starts in f64, steps inside it are f32: near the vanishing line, where terms cancel, a block's
        // values are small and so are their rounding errors.
        let mut ramp = [0.0; BLOCK];
        for (k, step) in ramp.iter_mut().enumerate() {
            *step = (self.per_column * k as f64) as f32;
        }
        let mut start = self.origin + self.per_row * f64::from(v);
        let (blocks, rest) = row.as_chunks_mut::<BLOCK>();
        for block in blocks {
            let base = start as f32;
            for (value, step) in block.iter_mut().zip(&ramp) {
                *value = base + step;
            }
            start += self.per_column * BLOCK as f64;
        }
        let base = start as f32;
        for (value, step) in rest.iter_mut().zip(&ramp) {
            *value = base + step;
        }
    }
}

impl GroundRows for GroundCoefficients {
    fn size(&self) -> ImageSize {
        self.size
    }

    fn camera_height(&self) -> f32 {
        self.height
    }

    #[inline(always)]
    fn write_row(&self, v: u32, row: &mut [f32]) -> Result<(), Error> {
        if v >= self.size.height() || row.len() != self.size.width() as usize {
            return Err(Error::GroundRow { row: v });
        }
        self.fill_row(v, row);
        Ok(())
    }

    /// The larger end of the row, and more than what rounding adds.
    #[inline(always)]
    fn row_bound(&self, v: u32) -> f32 {
        let [left, right] =
            [0, self.size.width() - 1].map(|u| self.inverse_depth(f64::from(u), f64::from(v)));
        let largest = left.max(right);
        let rounding = f64::from(f32::EPSILON) * (largest.abs() + 16.0 * self.per_column.abs());
        (largest + 2.0 * rounding) as f32
    }
}
