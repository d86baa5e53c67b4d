//! The ground as the output's pixels see it.

use gedepth_core::Error;
use gedepth_core::Ground;
use gedepth_core::camera::{CameraModel, ImageSize};
use gedepth_core::table::{GroundCoefficients, GroundRows, GroundView};

/// Inverse ground depth of every pixel, row by row.
pub(crate) enum OutputGround {
    /// Of a pinhole: three numbers. Making a row of them takes less time than reading one from memory that the network
    /// used meanwhile.
    Pinhole(GroundCoefficients),
    /// Of any lens: made once, 1/m.
    Table {
        values: Vec<f32>,
        size: ImageSize,
        /// Of the camera over the ground, metres.
        height: f32,
    },
}

impl OutputGround {
    pub(crate) fn new<C: CameraModel>(camera: &C, ground: &Ground) -> Result<Self, Error> {
        if let Some(intrinsics) = camera.as_pinhole() {
            return Ok(Self::Pinhole(GroundCoefficients::new(intrinsics, ground)));
        }
        let size = camera.size();
        let mut values = vec![0.0; GroundView::len(size)];
        let height = GroundView::build(&mut values, camera, ground)?.camera_height();
        Ok(Self::Table {
            values,
            size,
            height,
        })
    }
}

impl GroundRows for OutputGround {
    fn size(&self) -> ImageSize {
        match self {
            Self::Pinhole(coefficients) => coefficients.size(),
            Self::Table { size, .. } => *size,
        }
    }

    fn camera_height(&self) -> f32 {
        match self {
            Self::Pinhole(coefficients) => coefficients.camera_height(),
            Self::Table { height, .. } => *height,
        }
    }

    #[inline(always)]
    fn write_row(&self, v: u32, row: &mut [f32]) -> Result<(), Error> {
        match self {
            Self::Pinhole(coefficients) => coefficients.write_row(v, row),
            Self::Table {
                values,
                size,
                height,
            } => GroundView::from_values(values, *size, *height)?.write_row(v, row),
        }
    }
}
