//! Ground tables: the inverse ground depth of every pixel, made once per calibration.
//!
//! - Layout: row-major, `index = v * width + u`, one value a pixel.
//! - Values: inverse planar depth `1 / z_c` in 1/m, with its sign: positive below the vanishing line, 0 on it, negative
//!   above (an uphill road rises above the plane's horizon, so the adaptive mode needs it), [`NO_GROUND`] where the
//!   camera has no ray. Never NaN.
//! - Depth in metres is [`depth_from_inverse`]: exactly 0 on and above the vanishing line.
//!
//! | form | memory | for |
//! |---|---|---|
//! | [`GroundLut`], [`GroundView`] | 4 bytes a pixel | every camera |
//! | [`FixedLut`], [`FixedView`] | 2 bytes a pixel | every camera; planar depth, no sign above the line |
//! | [`RowLut`], [`RowView`] | 4 bytes a row | pinholes that hardly roll |
//! | [`GroundCoefficients`] | three numbers | pinholes |
//!
//! A new pitch or height of a camera whose rays were kept ([`RayLut`], [`RayView`]) rebuilds its table in place:
//! [`GroundLut::rebuild`].
//!
//! Fusion reads any of them through [`GroundRows`]. Errors are about memory that is too small; nothing panics.

mod coefficients;
mod coverage;
mod fixed_point;
mod inverse_depth;
mod per_row;
mod rays;

pub use coefficients::GroundCoefficients;
pub use coverage::Coverage;
pub use fixed_point::{FixedLut, FixedView, KittiLut};
pub use inverse_depth::{GroundLut, GroundView};
pub use per_row::{RowLut, RowTolerance, RowView};
pub use rays::{RayLut, RayView};

use crate::camera::{CameraModel, ImageSize, Pixel};
use crate::{Error, Ground};

/// The inverse depth of a pixel whose ray has no depth at all (outside the field of view, or at 90 degrees and more
/// from the axis): so far above the vanishing line that no slope brings ground there.
pub const NO_GROUND: f32 = f32::MIN;

/// The least inverse depth that is not the vanishing line, 1/m: ground beyond 1000 km is none. It keeps rounding on the
/// line from becoming a depth.
pub const MIN_INVERSE_DEPTH: f32 = 1e-6;

/// The planar depth in metres for an inverse depth in 1/m; exactly 0 on and above the vanishing line.
#[inline(always)]
pub fn depth_from_inverse(inverse: f32) -> f32 {
    if inverse > MIN_INVERSE_DEPTH {
        1.0 / inverse
    } else {
        0.0
    }
}

/// Where fusion reads the ground from, row by row.
pub trait GroundRows {
    /// The picture's size.
    fn size(&self) -> ImageSize;

    /// H: the camera's height over the ground, metres; positive.
    fn camera_height(&self) -> f32;

    /// Writes the inverse depths of row `v` to `row`, [`Self::size`]`.width()` values.
    ///
    /// # Errors
    /// [`Error::GroundRow`] if there is no such row or `row` has another length.
    fn write_row(&self, v: u32, row: &mut [f32]) -> Result<(), Error>;

    /// No value of row `v` is larger than this, 1/m: what a source can say without looking at the row, infinity where
    /// it cannot, and fusion looks. It spares itself rows that lie above all ground.
    fn row_bound(&self, v: u32) -> f32 {
        let _ = v;
        f32::INFINITY
    }
}

/// Writes the planar ground depth in metres, 0 where there is no ground or where it is beyond `max_depth`: what a
/// network takes as its ground channel, and what [`crate::fusion`] does not need.
///
/// `metres` is row-major and of the table's size.
///
/// # Errors
/// [`Error::OutputLength`]; [`Error::GroundRow`] if the source has no such row.
pub fn write_depth<G: GroundRows + ?Sized>(
    ground: &G,
    max_depth: f32,
    metres: &mut [f32],
) -> Result<(), Error> {
    let size = ground.size();
    if metres.len() != size.pixels() {
        return Err(Error::OutputLength {
            needed: size.pixels(),
            given: metres.len(),
        });
    }
    for (v, row) in (0..).zip(metres.chunks_exact_mut(size.row())) {
        ground.write_row(v, row)?;
        for value in row {
            let depth = depth_from_inverse(*value);
            *value = if depth <= max_depth { depth } else { 0.0 };
        }
    }
    Ok(())
}

/// Checks that `values` can hold a table of this size and cuts it to length.
fn table_memory<T>(values: &mut [T], size: ImageSize) -> Result<&mut [T], Error> {
    let given = values.len();
    values.get_mut(..size.pixels()).ok_or(Error::TableLength {
        needed: size.pixels(),
        given,
    })
}

/// Checks that `values` is a finished table of this length.
fn check_length<T>(values: &[T], needed: usize) -> Result<&[T], Error> {
    if values.len() == needed {
        Ok(values)
    } else {
        Err(Error::TableLength {
            needed,
            given: values.len(),
        })
    }
}

/// Checks a finished table's height of the camera over the ground, metres.
fn check_height(height: f32) -> Result<f32, Error> {
    if height > 0.0 && height.is_finite() {
        Ok(height)
    } else {
        Err(Error::CameraNotAboveGround {
            height: f64::from(height),
        })
    }
}

/// Writes every pixel's inverse depth through `encode`, which gets [`NO_GROUND`] where there is no forward ray; `values` has
/// the camera's number of pixels.
fn fill<T, C: CameraModel + ?Sized>(
    values: &mut [T],
    camera: &C,
    ground: &Ground,
    encode: impl Fn(f64) -> T,
) {
    let rows = values.chunks_exact_mut(camera.size().row());
    let down = ground.down().vector() / ground.height();
    for (v, row) in (0_u32..).zip(rows) {
        for (u, value) in (0_u32..).zip(row) {
            let inverse = camera
                .forward_ray(Pixel::new(f64::from(u), f64::from(v)))
                .map(|point| down.dot(point.extend(1.0)))
                // Only a foreign camera model can give anything else.
                .filter(|inverse| inverse.is_finite());
            *value = encode(inverse.unwrap_or(f64::from(NO_GROUND)));
        }
    }
}
