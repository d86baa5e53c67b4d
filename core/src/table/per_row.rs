//! One value per row: for pinholes that do not roll.

use super::{GroundCoefficients, GroundRows, ImageSize, check_height, check_length};
use crate::Error;

/// How far off one value per row may be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RowTolerance {
    /// Share of the depth.
    pub relative_error: f64,
    /// Up to this depth, metres; nearer the error is smaller.
    pub up_to: f64,
}

/// A table of one inverse depth (1/m) a row, in memory that it borrows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RowView<'a> {
    values: &'a [f32],
    size: ImageSize,
    height: f32,
}

impl<'a> RowView<'a> {
    /// Values that a table for a picture of this size takes.
    pub const fn len(size: ImageSize) -> usize {
        size.height() as usize
    }

    /// Makes the table at the start of `values`: each row's value is that of its middle.
    ///
    /// # Errors
    /// [`Error::TableLength`] if `values` is shorter than [`Self::len`]; [`Error::RollTooLarge`] if a pixel's depth would
    /// be wrong by more than `tolerance`.
    pub fn build(
        values: &'a mut [f32],
        coefficients: &GroundCoefficients,
        tolerance: RowTolerance,
    ) -> Result<Self, Error> {
        let size = coefficients.size();
        let given = values.len();
        let values = values
            .get_mut(..Self::len(size))
            .ok_or(Error::TableLength {
                needed: Self::len(size),
                given,
            })?;
        let middle = (f64::from(size.width()) - 1.0) / 2.0;
        let [_, per_column, _] = coefficients.coefficients();
        // Without any roll there is none, however far.
        let share = if per_column == 0.0 {
            0.0
        } else {
            per_column.abs() * middle * tolerance.up_to
        };
        // An inverse depth too small by this share of it.
        let relative_error = if share < 1.0 {
            share / (1.0 - share)
        } else {
            f64::INFINITY
        };
        // NaN, and distances behind the camera, allow nothing.
        let allowed = (0.0..=tolerance.relative_error).contains(&relative_error);
        if !allowed {
            return Err(Error::RollTooLarge { relative_error });
        }
        for (v, value) in (0_u32..).zip(values.iter_mut()) {
            *value = coefficients.inverse_depth(middle, f64::from(v)) as f32;
        }
        Ok(Self {
            values,
            size,
            height: coefficients.camera_height(),
        })
    }

    /// A table made earlier, say one kept in flash: a value a row in 1/m, `camera_height` in metres.
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

    /// The inverse depths, 1/m, from the top row on.
    pub const fn values(&self) -> &'a [f32] {
        self.values
    }
}

impl GroundRows for RowView<'_> {
    fn size(&self) -> ImageSize {
        self.size
    }

    fn camera_height(&self) -> f32 {
        self.height
    }

    #[inline(always)]
    fn write_row(&self, v: u32, row: &mut [f32]) -> Result<(), Error> {
        match self.values.get(v as usize) {
            Some(value) if row.len() == self.size.width() as usize => {
                row.fill(*value);
                Ok(())
            }
            _ => Err(Error::GroundRow { row: v }),
        }
    }

    fn row_bound(&self, v: u32) -> f32 {
        self.values
            .get(v as usize)
            .copied()
            .unwrap_or(f32::INFINITY)
    }
}

/// A table of one value a row that owns its memory, for pictures of up to `N` rows; it fits a `static`.
#[derive(Debug, Clone)]
pub struct RowLut<const N: usize> {
    values: [f32; N],
    built: Option<(ImageSize, f32)>,
}

impl<const N: usize> RowLut<N> {
    /// A table that is not built yet.
    pub const fn new() -> Self {
        Self {
            values: [0.0; N],
            built: None,
        }
    }

    /// Makes the table, in place of the one before: [`RowView::build`].
    ///
    /// # Errors
    /// As [`RowView::build`]; the table before is then kept.
    pub fn build(
        &mut self,
        coefficients: &GroundCoefficients,
        tolerance: RowTolerance,
    ) -> Result<RowView<'_>, Error> {
        let view = RowView::build(&mut self.values, coefficients, tolerance)?;
        self.built = Some((view.size, view.height));
        Ok(view)
    }

    /// The table.
    ///
    /// # Errors
    /// [`Error::TableNotBuilt`].
    pub fn view(&self) -> Result<RowView<'_>, Error> {
        let (size, height) = self.built.ok_or(Error::TableNotBuilt)?;
        let values = self
            .values
            .get(..RowView::len(size))
            .ok_or(Error::TableNotBuilt)?;
        Ok(RowView {
            values,
            size,
            height,
        })
    }
}

impl<const N: usize> Default for RowLut<N> {
    fn default() -> Self {
        Self::new()
    }
}
