//! The primary table: inverse depth as `f32`, one value a pixel, for every camera.

use super::{
    GroundCoefficients, GroundRows, ImageSize, NO_GROUND, RayView, check_height, check_length,
    depth_from_inverse, fill, table_memory,
};
use crate::camera::CameraModel;
use crate::{Error, Ground};

/// A table in memory that it borrows: inverse depths in 1/m, row-major.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GroundView<'a> {
    values: &'a [f32],
    size: ImageSize,
    height: f32,
}

impl<'a> GroundView<'a> {
    /// Values that a table for a picture of this size takes.
    pub const fn len(size: ImageSize) -> usize {
        size.pixels()
    }

    /// Makes the table of `camera` over `ground` at the start of `values`.
    ///
    /// # Errors
    /// [`Error::TableLength`] if `values` is shorter than [`Self::len`].
    pub fn build<C: CameraModel + ?Sized>(
        values: &'a mut [f32],
        camera: &C,
        ground: &Ground,
    ) -> Result<Self, Error> {
        let size = camera.size();
        let values = table_memory(values, size)?;
        if let Some(intrinsics) = camera.as_pinhole() {
            let coefficients = GroundCoefficients::new(intrinsics, ground);
            let rows = values.chunks_exact_mut(size.row());
            for (v, row) in (0..).zip(rows) {
                coefficients.fill_row(v, row);
            }
        } else {
            fill(values, camera, ground, |inverse| inverse as f32);
        }
        Ok(Self {
            values,
            size,
            height: ground.height() as f32,
        })
    }

    /// Makes the table of the camera whose rays were kept, for a new pitch, roll or height: no ray is computed.
    /// Inlines into callers with target features.
    ///
    /// # Errors
    /// [`Error::TableLength`] if `values` is shorter than [`Self::len`].
    #[inline(always)]
    pub fn rebuild(
        values: &'a mut [f32],
        rays: &RayView<'_>,
        ground: &Ground,
    ) -> Result<Self, Error> {
        let size = rays.size();
        let values = table_memory(values, size)?;
        rays.fill(values, ground);
        Ok(Self {
            values,
            size,
            height: ground.height() as f32,
        })
    }

    /// A table made earlier, say one kept in flash: `values` row-major in 1/m, `camera_height` in metres.
    ///
    /// # Errors
    /// [`Error::TableLength`] if `values` has another length than [`Self::len`],
    /// [`Error::CameraNotAboveGround`] if `camera_height` is not positive and finite.
    pub fn from_values(
        values: &'a [f32],
        size: ImageSize,
        camera_height: f32,
    ) -> Result<Self, Error> {
        Ok(Self {
            values: check_length(values, Self::len(size))?,
            size,
            height: check_height(camera_height)?,
        })
    }

    /// All inverse depths, 1/m, row-major.
    pub const fn values(&self) -> &'a [f32] {
        self.values
    }

    /// The inverse depth of the pixel in column `u` and row `v`, 1/m; `None` outside the picture.
    pub fn inverse_depth(&self, u: u32, v: u32) -> Option<f32> {
        if u >= self.size.width() || v >= self.size.height() {
            return None;
        }
        self.values
            .get(v as usize * self.size.width() as usize + u as usize)
            .copied()
    }

    /// The planar ground depth of that pixel in metres, 0 on and above the vanishing line; `None` outside the picture.
    pub fn depth(&self, u: u32, v: u32) -> Option<f32> {
        self.inverse_depth(u, v).map(depth_from_inverse)
    }
}

impl GroundRows for GroundView<'_> {
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
                row.copy_from_slice(values);
                Ok(())
            }
            _ => Err(Error::GroundRow { row: v }),
        }
    }
}

/// A table that owns its memory, for pictures of up to `N` pixels; it fits a `static`.
///
/// Four bytes a pixel: 1.7 MB for 1216x352.
#[derive(Debug, Clone)]
pub struct GroundLut<const N: usize> {
    values: [f32; N],
    built: Option<(ImageSize, f32)>,
}

impl<const N: usize> GroundLut<N> {
    /// A table that is not built yet.
    pub const fn new() -> Self {
        Self {
            values: [NO_GROUND; N],
            built: None,
        }
    }

    /// Makes the table of `camera` over `ground`, in place of the one before.
    ///
    /// # Errors
    /// [`Error::TableLength`] if the picture has more than `N` pixels; the table before is then kept.
    pub fn build<C: CameraModel + ?Sized>(
        &mut self,
        camera: &C,
        ground: &Ground,
    ) -> Result<GroundView<'_>, Error> {
        let view = GroundView::build(&mut self.values, camera, ground)?;
        self.built = Some((view.size, view.height));
        Ok(view)
    }

    /// Makes the table anew, in place, from kept rays: [`GroundView::rebuild`].
    ///
    /// # Errors
    /// [`Error::TableLength`] if there are more than `N` rays; the table before is then kept.
    #[inline(always)]
    pub fn rebuild(
        &mut self,
        rays: &RayView<'_>,
        ground: &Ground,
    ) -> Result<GroundView<'_>, Error> {
        let view = GroundView::rebuild(&mut self.values, rays, ground)?;
        self.built = Some((view.size, view.height));
        Ok(view)
    }

    /// The table.
    ///
    /// # Errors
    /// [`Error::TableNotBuilt`].
    pub fn view(&self) -> Result<GroundView<'_>, Error> {
        let (size, height) = self.built.ok_or(Error::TableNotBuilt)?;
        let values = self
            .values
            .get(..size.pixels())
            .ok_or(Error::TableNotBuilt)?;
        Ok(GroundView {
            values,
            size,
            height,
        })
    }
}

impl<const N: usize> Default for GroundLut<N> {
    fn default() -> Self {
        Self::new()
    }
}
