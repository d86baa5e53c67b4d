//! Rays kept between calibrations of the same camera: pitch and height change with load, the lens does not.

use glam::DVec2;

use super::{ImageSize, NO_GROUND};
use crate::camera::{CameraModel, Pixel};
use crate::{Error, Ground};

/// The ray of every pixel as its point (x, y) on the plane z = 1, in memory that it borrows: first all x, row-major, then
/// all y. A pixel without a forward ray holds NaN.
///
/// Tables made from kept rays are off by at most `5.01 2^-24 (|a x| + |b y| + |c|) / H` in 1/m (five roundings), (a, b, c)
/// being the direction down. For an upright camera that is below 1e-5 of the depth up to 200 m if it is 1.5 m high or more and pitched by 7
/// degrees or less; on the KITTI, nuScenes and DDAD cameras it is 5e-7. Build the table from the camera where the bound is
/// too large.
#[derive(Debug, Clone, Copy)]
pub struct RayView<'a> {
    x: &'a [f32],
    y: &'a [f32],
    size: ImageSize,
}

impl<'a> RayView<'a> {
    /// Values that the rays of a picture of this size take.
    pub const fn len(size: ImageSize) -> usize {
        size.pixels().saturating_mul(2)
    }

    /// Unprojects every pixel of `camera`, into the start of `values`.
    ///
    /// # Errors
    /// [`Error::TableLength`] if `values` is shorter than [`Self::len`].
    pub fn build<C: CameraModel + ?Sized>(
        values: &'a mut [f32],
        camera: &C,
    ) -> Result<Self, Error> {
        let size = camera.size();
        let given = values.len();
        let too_short = Error::TableLength {
            needed: Self::len(size),
            given,
        };
        let values = values.get_mut(..Self::len(size)).ok_or(too_short)?;
        let (x, y) = values
            .split_at_mut_checked(size.pixels())
            .ok_or(too_short)?;
        let width = size.row();
        let rows = (0_u32..).zip(x.chunks_exact_mut(width));
        for ((v, x), y) in rows.zip(y.chunks_exact_mut(width)) {
            for (u, (x, y)) in (0_u32..).zip(x.iter_mut().zip(y)) {
                let point = camera.forward_ray(Pixel::new(f64::from(u), f64::from(v)));
                let point = point.unwrap_or(DVec2::NAN);
                (*x, *y) = (point.x as f32, point.y as f32);
            }
        }
        Ok(Self { x, y, size })
    }

    /// Rays made earlier: what [`Self::build`] wrote.
    ///
    /// # Errors
    /// [`Error::TableLength`] if `values` has another length than [`Self::len`].
    pub fn from_values(values: &'a [f32], size: ImageSize) -> Result<Self, Error> {
        let given = values.len();
        match values.split_at_checked(size.pixels()) {
            Some((x, y)) if y.len() == x.len() => Ok(Self { x, y, size }),
            _ => Err(Error::TableLength {
                needed: Self::len(size),
                given,
            }),
        }
    }

    /// The picture's size.
    pub const fn size(&self) -> ImageSize {
        self.size
    }

    /// Writes the inverse depths of `ground`; `values` has the rays' number of pixels.
    #[inline(always)]
    pub(super) fn fill(&self, values: &mut [f32], ground: &Ground) {
        let down = ground.down().vector() / ground.height();
        let (a, b, c) = (down.x as f32, down.y as f32, down.z as f32);
        for ((value, x), y) in values.iter_mut().zip(self.x).zip(self.y) {
            let inverse = a * x + b * y + c;
            // Also where there is no ray: the comparison is false for NaN.
            *value = if inverse > NO_GROUND {
                inverse
            } else {
                NO_GROUND
            };
        }
    }
}

/// Rays in memory of their own, for pictures of up to `N` pixels; they fit a `static`. Eight bytes a pixel.
#[derive(Debug, Clone)]
pub struct RayLut<const N: usize> {
    values: [[f32; N]; 2],
    size: Option<ImageSize>,
}

impl<const N: usize> RayLut<N> {
    /// Rays that are not built yet.
    pub const fn new() -> Self {
        Self {
            values: [[f32::NAN; N]; 2],
            size: None,
        }
    }

    /// Unprojects every pixel of `camera`, in place of the rays before.
    ///
    /// # Errors
    /// [`Error::TableLength`] if the picture has more than `N` pixels; the rays before are then kept.
    pub fn build<C: CameraModel + ?Sized>(&mut self, camera: &C) -> Result<RayView<'_>, Error> {
        let view = RayView::build(self.values.as_flattened_mut(), camera)?;
        self.size = Some(view.size);
        Ok(view)
    }

    /// The rays.
    ///
    /// # Errors
    /// [`Error::TableNotBuilt`].
    pub fn view(&self) -> Result<RayView<'_>, Error> {
        let size = self.size.ok_or(Error::TableNotBuilt)?;
        let values = self.values.as_flattened();
        let (x, y) = values
            .get(..RayView::len(size))
            .and_then(|values| values.split_at_checked(size.pixels()))
            .ok_or(Error::TableNotBuilt)?;
        Ok(RayView { x, y, size })
    }
}

impl<const N: usize> Default for RayLut<N> {
    fn default() -> Self {
        Self::new()
    }
}
