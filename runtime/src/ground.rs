//! The ground as a camera's pixels see it: those of the network's input, and those of the output.

use gedepth_core::camera::{CameraModel, ImageSize, Intrinsics};
use gedepth_core::table::{GroundCoefficients, GroundRows, GroundView, RayView};
use gedepth_core::{Error, Ground};

use crate::vectors::{Loops, widest};

/// Inverse ground depth of every pixel, row by row. The camera stays, the ground under it may change.
pub(crate) enum PixelGround {
    /// Of a pinhole: three numbers. Making a row of them takes less time than reading one from memory that the network
    /// used meanwhile.
    Pinhole {
        intrinsics: Intrinsics,
        coefficients: GroundCoefficients,
    },
    /// Of any lens: a table.
    Lens {
        /// Of every pixel, as [`RayView`] has them; made once, which takes hundreds of times as long as a table from them.
        rays: Vec<f32>,
        /// 1/m.
        values: Vec<f32>,
        /// The largest value of each row.
        bounds: Vec<f32>,
        size: ImageSize,
        /// Of the camera over the ground, metres.
        height: f32,
    },
}

impl PixelGround {
    pub(crate) fn new<C: CameraModel>(camera: &C, ground: &Ground) -> Result<Self, Error> {
        if let Some(&intrinsics) = camera.as_pinhole() {
            return Ok(Self::Pinhole {
                intrinsics,
                coefficients: GroundCoefficients::new(&intrinsics, ground),
            });
        }
        let size = camera.size();
        let mut rays = vec![0.0; RayView::len(size)];
        RayView::build(&mut rays, camera)?;
        let mut lens = Self::Lens {
            rays,
            values: vec![0.0; GroundView::len(size)],
            bounds: vec![0.0; size.height() as usize],
            size,
            height: 0.0,
        };
        lens.set(ground)?;
        Ok(lens)
    }

    /// The same camera over another ground. Allocates nothing.
    pub(crate) fn set(&mut self, ground: &Ground) -> Result<(), Error> {
        match self {
            Self::Pinhole {
                intrinsics,
                coefficients,
            } => *coefficients = GroundCoefficients::new(intrinsics, ground),
            Self::Lens {
                rays,
                values,
                bounds,
                size,
                height,
            } => {
                let rays = RayView::from_values(rays, *size)?;
                *height = widest(Table {
                    values,
                    bounds,
                    rays,
                    ground,
                })?;
            }
        }
        Ok(())
    }
}

/// The table of a ground, and the largest value of each row; gives the camera's height.
struct Table<'a> {
    values: &'a mut [f32],
    bounds: &'a mut [f32],
    rays: RayView<'a>,
    ground: &'a Ground,
}

impl Loops for Table<'_> {
    type Output = Result<f32, Error>;

    #[inline(always)]
    fn run(self) -> Self::Output {
        let view = GroundView::rebuild(self.values, &self.rays, self.ground)?;
        let rows = view
            .values()
            .chunks_exact(self.rays.size().width() as usize);
        for (bound, row) in self.bounds.iter_mut().zip(rows) {
            *bound = row.iter().copied().fold(f32::MIN, f32::max);
        }
        Ok(view.camera_height())
    }
}

impl GroundRows for PixelGround {
    fn size(&self) -> ImageSize {
        match self {
            Self::Pinhole { coefficients, .. } => coefficients.size(),
            Self::Lens { size, .. } => *size,
        }
    }

    fn camera_height(&self) -> f32 {
        match self {
            Self::Pinhole { coefficients, .. } => coefficients.camera_height(),
            Self::Lens { height, .. } => *height,
        }
    }

    #[inline(always)]
    fn write_row(&self, v: u32, row: &mut [f32]) -> Result<(), Error> {
        match self {
            Self::Pinhole { coefficients, .. } => coefficients.write_row(v, row),
            Self::Lens {
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
            Self::Pinhole { coefficients, .. } => coefficients.row_bound(v),
            Self::Lens { bounds, .. } => bounds.get(v as usize).copied().unwrap_or(f32::INFINITY),
        }
    }
}

#[cfg(test)]
#[allow(clippy::expect_used)]
mod tests {
    use gedepth_core::Angle;
    use gedepth_core::camera::{BrownConrady, Pinhole};

    use super::*;

    fn rows(ground: &PixelGround) -> Vec<f32> {
        let width = ground.size().width() as usize;
        let mut rows = vec![0.0; ground.size().pixels()];
        for (v, row) in (0..).zip(rows.chunks_exact_mut(width)) {
            ground.write_row(v, row).expect("a row");
        }
        rows
    }

    /// Coefficients and rays are the same ground as the camera's table: those to the last bit, these to f32's rounding; and a
    /// ground that is set is the one that would have been made.
    #[test]
    fn every_camera_sees_the_ground_of_its_table() {
        let size = ImageSize::new(640, 192).expect("a size");
        let intrinsics = Intrinsics::new(size, 380.0, 380.0, 314.0, 90.0).expect("intrinsics");
        let ground = |height, pitch, roll| {
            let [pitch, roll] = [pitch, roll].map(Angle::from_degrees);
            Ground::from_mounting(height, pitch, roll).expect("a camera above it")
        };
        let lens =
            BrownConrady::new(intrinsics, [-0.3, 0.12, 0.0005, -0.0004, -0.02]).expect("a lens");
        let pinhole = Pinhole::new(intrinsics);
        let (first, then) = (ground(1.65, 0.6, -0.5), ground(1.58, -1.2, 0.9));
        let mut table = vec![0.0; GroundView::len(size)];

        let mut kept = PixelGround::new(&lens, &first).expect("a ground");
        let mut made = PixelGround::new(&pinhole, &first).expect("a ground");
        assert!(matches!(kept, PixelGround::Lens { .. }));
        assert!(matches!(made, PixelGround::Pinhole { .. }));
        for ground in [first, then] {
            kept.set(&ground).expect("a ground");
            assert_eq!(
                f64::from(kept.camera_height()),
                f64::from(ground.height() as f32)
            );
            GroundView::build(&mut table, &lens, &ground).expect("a table");
            for (value, exact) in rows(&kept).iter().zip(&table) {
                // Core's bound for kept rays, |x| and |y| being below 2 here.
                assert!(
                    (value - exact).abs() <= 5.01 * 2.0_f32.powi(-24) * 5.0 / 1.58,
                    "{value} {exact}"
                );
            }
            for (v, row) in (0..).zip(rows(&kept).chunks_exact(640)) {
                let largest = row.iter().copied().fold(f32::MIN, f32::max);
                assert_eq!(kept.row_bound(v), largest, "row {v}");
            }
            let anew = PixelGround::new(&lens, &ground).expect("a ground");
            assert_eq!(rows(&kept), rows(&anew));

            made.set(&ground).expect("a ground");
            let view = GroundView::build(&mut table, &pinhole, &ground).expect("a table");
            assert_eq!(made.camera_height(), view.camera_height());
            assert_eq!(rows(&made), table);
        }
    }
}
