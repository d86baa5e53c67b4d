//! Two bytes a pixel: planar depth in fixed point.
//!
//! Depth, not inverse depth: KITTI's 16-bit depth pictures have the same form (1/256 m up to 255 m). 0 stands for no
//! ground, so what the vanishing line hides is not kept: with an uphill slope the adaptive mode finds no ground above the
//! line in these tables. Use another form where that matters.

use super::{
    GroundCoefficients, GroundRows, ImageSize, NO_GROUND, check_height, check_length, fill,
    table_memory,
};
use crate::camera::CameraModel;
use crate::{Error, Ground};

/// A table of planar depths in steps of `1 / STEPS_PER_METRE` m, up to `RANGE` metres, in memory that it borrows.
///
/// `STEPS_PER_METRE * RANGE` must fit 16 bits, which is checked at compile time:
///
/// ```compile_fail
/// # use gedepth_core::{table::FixedView, camera::ImageSize};
/// let length = FixedView::<256, 256>::len(ImageSize::new(4, 4).unwrap());
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FixedView<'a, const STEPS_PER_METRE: u32, const RANGE: u32> {
    values: &'a [u16],
    size: ImageSize,
    height: f32,
}

impl<'a, const STEPS_PER_METRE: u32, const RANGE: u32> FixedView<'a, STEPS_PER_METRE, RANGE> {
    const FITS: () = assert!(
        STEPS_PER_METRE > 0 && RANGE > 0 && STEPS_PER_METRE as u64 * RANGE as u64 <= 65_535,
        "STEPS_PER_METRE * RANGE must be 1 to 65535"
    );

    /// Values that a table for a picture of this size takes.
    pub const fn len(size: ImageSize) -> usize {
        let () = Self::FITS;
        size.pixels()
    }

    /// Makes the table of `camera` over `ground` at the start of `values`. Each depth is rounded to the nearest step, but
    /// ground in sight is never less than one; ground beyond `RANGE` is none.
    ///
    /// # Errors
    /// [`Error::TableLength`] if `values` is shorter than [`Self::len`].
    pub fn build<C: CameraModel + ?Sized>(
        values: &'a mut [u16],
        camera: &C,
        ground: &Ground,
    ) -> Result<Self, Error> {
        let () = Self::FITS;
        let size = camera.size();
        let values = table_memory(values, size)?;
        let encode = |inverse: f64| {
            if inverse >= 1.0 / f64::from(RANGE) {
                // Half a step more, cut: the nearest step.
                ((f64::from(STEPS_PER_METRE) / inverse + 0.5) as u16).max(1)
            } else {
                0
            }
        };
        if let Some(intrinsics) = camera.as_pinhole() {
            let coefficients = GroundCoefficients::new(intrinsics, ground);
            let rows = values.chunks_exact_mut(size.row());
            for (v, row) in (0_u32..).zip(rows) {
                for (u, value) in (0_u32..).zip(row) {
                    *value = encode(coefficients.inverse_depth(f64::from(u), f64::from(v)));
                }
            }
        } else {
            fill(values, camera, ground, encode);
        }
        Ok(Self {
            values,
            size,
            height: ground.height() as f32,
        })
    }

    /// A table made earlier, say one kept in flash: `values` row-major in steps, `camera_height` in metres.
    ///
    /// # Errors
    /// [`Error::TableLength`] if `values` has another length than [`Self::len`],
    /// [`Error::CameraNotAboveGround`] if `camera_height` is not positive and finite.
    pub fn from_values(
        values: &'a [u16],
        size: ImageSize,
        camera_height: f32,
    ) -> Result<Self, Error> {
        Ok(Self {
            values: check_length(values, Self::len(size))?,
            size,
            height: check_height(camera_height)?,
        })
    }

    /// The depths in steps, row-major; 0 where there is no ground.
    pub const fn values(&self) -> &'a [u16] {
        self.values
    }
}

impl<const STEPS_PER_METRE: u32, const RANGE: u32> GroundRows
    for FixedView<'_, STEPS_PER_METRE, RANGE>
{
    fn size(&self) -> ImageSize {
        self.size
    }

    fn camera_height(&self) -> f32 {
        self.height
    }

    #[inline(always)]
    fn write_row(&self, v: u32, row: &mut [f32]) -> Result<(), Error> {
        let width = self.size.row();
        match self.values.chunks_exact(width).nth(v as usize) {
            Some(values) if values.len() == row.len() => {
                for (inverse, steps) in row.iter_mut().zip(values) {
                    *inverse = if *steps > 0 {
                        STEPS_PER_METRE as f32 / f32::from(*steps)
                    } else {
                        NO_GROUND
                    };
                }
                Ok(())
            }
            _ => Err(Error::GroundRow { row: v }),
        }
    }
}

/// A fixed-point table that owns its memory, for pictures of up to `N` pixels; it fits a `static`.
#[derive(Debug, Clone)]
pub struct FixedLut<const N: usize, const STEPS_PER_METRE: u32, const RANGE: u32> {
    values: [u16; N],
    built: Option<(ImageSize, f32)>,
}

/// KITTI's depth format: steps of 1/256 m, up to 255 m.
pub type KittiLut<const N: usize> = FixedLut<N, 256, 255>;

impl<const N: usize, const STEPS_PER_METRE: u32, const RANGE: u32>
    FixedLut<N, STEPS_PER_METRE, RANGE>
{
    /// A table that is not built yet.
    pub const fn new() -> Self {
        Self {
            values: [0; N],
            built: None,
        }
    }

    /// Makes the table of `camera` over `ground`, in place of the one before: [`FixedView::build`].
    ///
    /// # Errors
    /// [`Error::TableLength`] if the picture has more than `N` pixels; the table before is then kept.
    pub fn build<C: CameraModel + ?Sized>(
        &mut self,
        camera: &C,
        ground: &Ground,
    ) -> Result<FixedView<'_, STEPS_PER_METRE, RANGE>, Error> {
        let view = FixedView::build(&mut self.values, camera, ground)?;
        self.built = Some((view.size, view.height));
        Ok(view)
    }

    /// The table.
    ///
    /// # Errors
    /// [`Error::TableNotBuilt`].
    pub fn view(&self) -> Result<FixedView<'_, STEPS_PER_METRE, RANGE>, Error> {
        let (size, height) = self.built.ok_or(Error::TableNotBuilt)?;
        let values = self
            .values
            .get(..size.pixels())
            .ok_or(Error::TableNotBuilt)?;
        Ok(FixedView {
            values,
            size,
            height,
        })
    }
}

impl<const N: usize, const STEPS_PER_METRE: u32, const RANGE: u32> Default
    for FixedLut<N, STEPS_PER_METRE, RANGE>
{
    fn default() -> Self {
        Self::new()
    }
}
