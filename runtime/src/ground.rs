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
        /// The largest value of each row.
        bounds: Vec<f32>,
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
        let rows = values.chunks_exact(size.width() as usize);
        let bounds = rows.map(|row| row.iter().copied().fold(f32::MIN, f32::max));
        Ok(Self::Table {
            bounds: bounds.collect(),
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
                ..
            } => GroundView::from_values(values, *size, *height)?.write_row(v, row),
        }
    }

    #[inline(always)]
    fn row_bound(&self, v: u32) -> f32 {
        match self {
            Self::Pinhole(coefficients) => coefficients.row_bound(v),
            Self::Table { bounds, .. } => bounds.get(v as usize).copied().unwrap_or(f32::INFINITY),
        }
    }
}

#[cfg(test)]
#[allow(clippy::expect_used)]
mod tests {
    use gedepth_core::Angle;
    use gedepth_core::camera::{BrownConrady, Intrinsics, Pinhole};

    use super::*;

    fn rows(ground: &OutputGround) -> Vec<f32> {
        let width = ground.size().width() as usize;
        let mut rows = vec![0.0; ground.size().pixels()];
        for (v, row) in (0..).zip(rows.chunks_exact_mut(width)) {
            ground.write_row(v, row).expect("a row");
        }
        rows
    }

    /// Coefficients and table are the same ground, whichever the camera takes.
    #[test]
    fn every_camera_sees_the_ground_of_its_table() {
        let size = ImageSize::new(640, 192).expect("a size");
        let intrinsics = Intrinsics::new(size, 380.0, 380.0, 314.0, 90.0).expect("intrinsics");
        let degrees = Angle::from_degrees;
        let ground =
            Ground::from_mounting(1.65, degrees(0.6), degrees(-0.5)).expect("a camera above it");
        let lens =
            BrownConrady::new(intrinsics, [-0.3, 0.12, 0.0005, -0.0004, -0.02]).expect("a lens");
        let pinhole = Pinhole::new(intrinsics);
        let mut table = vec![0.0; GroundView::len(size)];

        let kept = OutputGround::new(&lens, &ground).expect("a ground");
        assert!(matches!(kept, OutputGround::Table { .. }));
        GroundView::build(&mut table, &lens, &ground).expect("a table");
        assert_eq!(rows(&kept), table);
        for (v, row) in (0..).zip(table.chunks_exact(640)) {
            let largest = row.iter().copied().fold(f32::MIN, f32::max);
            assert_eq!(kept.row_bound(v), largest, "row {v}");
        }

        let made = OutputGround::new(&pinhole, &ground).expect("a ground");
        assert!(matches!(made, OutputGround::Pinhole(_)));
        let view = GroundView::build(&mut table, &pinhole, &ground).expect("a table");
        assert_eq!(made.camera_height(), view.camera_height());
        assert_eq!(rows(&made), table);
    }
}
