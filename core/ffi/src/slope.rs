//! Road slope: the paper's Eq. 7 to 9.

use gedepth_core::Angle;
use gedepth_core::slope::{SlopeClasses, SlopeSign, adaptive_inverse_depth, slope_from_depth};

use crate::camera::{Camera, check_finite, gedepth_core_camera};
use crate::memory::{Array, Span, check_disjoint, read};
use crate::result::{
    Failure, GEDEPTH_CORE_NOT_FINITE, GEDEPTH_CORE_UNKNOWN_CHOICE, GEDEPTH_CORE_UNUSED_NOT_ZERO,
    Result, number,
};

/// Classes are positive where the road falls away, the paper's Eq. 6.
pub const GEDEPTH_CORE_DOWNHILL_POSITIVE: u32 = 1;
/// Classes are positive where the road rises.
pub const GEDEPTH_CORE_UPHILL_POSITIVE: u32 = 2;

/// Most slope classes.
pub const GEDEPTH_CORE_MAX_SLOPE_CLASSES: usize = 64;

/// The angles of a network's slope classes, in the order of its channels.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct gedepth_core_slope_classes {
    /// Radians, ascending, within +-30 degrees.
    pub radians: *const f64,
    /// Angles, 1 to GEDEPTH_CORE_MAX_SLOPE_CLASSES.
    pub radians_len: usize,
    /// GEDEPTH_CORE_DOWNHILL_POSITIVE or GEDEPTH_CORE_UPHILL_POSITIVE.
    pub sign: u32,
    /// 0.
    pub reserved: u32,
}

pub(crate) type Classes = SlopeClasses<GEDEPTH_CORE_MAX_SLOPE_CLASSES>;

/// The classes, and where their descriptor and their angles lie.
///
/// # Safety
/// The crate's.
pub(crate) unsafe fn classes(
    classes: *const gedepth_core_slope_classes,
) -> Result<(Classes, [Span; 2])> {
    // SAFETY: the crate's.
    unsafe {
        let descriptor = Array::one(classes)?.span();
        let classes = read(classes)?;
        let radians = Array::new(classes.radians, classes.radians_len)?;
        let sign = match classes.sign {
            GEDEPTH_CORE_DOWNHILL_POSITIVE => SlopeSign::DownhillPositive,
            GEDEPTH_CORE_UPHILL_POSITIVE => SlopeSign::UphillPositive,
            _ => return Err(Failure(GEDEPTH_CORE_UNKNOWN_CHOICE)),
        };
        if classes.reserved != 0 {
            return Err(Failure(GEDEPTH_CORE_UNUSED_NOT_ZERO));
        }
        // More than fit are one too many.
        let mut angles = [Angle::ZERO; GEDEPTH_CORE_MAX_SLOPE_CLASSES + 1];
        for (angle, radians) in angles.iter_mut().zip(radians.slice()) {
            *angle = Angle::from_radians(*radians);
        }
        let angles = angles.get(..classes.radians_len).unwrap_or(&angles);
        Ok((Classes::new(angles, sign)?, [descriptor, radians.span()]))
    }
}

/// The expected slope of one pixel (Eq. 8), radians, positive downhill: softmax of logits_len logits, one a class, times the
/// angles.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gedepth_core_expected_slope(
    slope_classes: *const gedepth_core_slope_classes,
    logits: *const f32,
    logits_len: usize,
    radians: *mut f32,
) -> i32 {
    // SAFETY: the crate's.
    number((|| unsafe {
        let (slope_classes, [descriptor, angles]) = classes(slope_classes)?;
        let logits = Array::new(logits, logits_len)?;
        let radians = Array::one(radians)?;
        check_disjoint(&[radians.span()], &[descriptor, angles, logits.span()])?;
        radians.write(slope_classes.expected_angle(logits.slice())?);
        Ok(())
    })())
}

/// The slope at a measured planar depth (Eq. 9), radians, positive downhill; inverse_plane is the plane's inverse depth
/// there (gedepth_core_inverse_depth_at or a table's value), measured is in metres.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gedepth_core_slope_from_depth(
    camera: *const gedepth_core_camera,
    inverse_plane: f64,
    measured: f64,
    radians: *mut f64,
) -> i32 {
    // SAFETY: the crate's.
    number((|| unsafe {
        let camera = Camera::new(camera)?;
        let radians = Array::one(radians)?;
        check_disjoint(&[radians.span()], &[camera.span])?;
        let slope = slope_from_depth(inverse_plane, measured, camera.ground()?)
            .ok_or(Failure(GEDEPTH_CORE_NOT_FINITE))?;
        radians.write(slope.radians());
        Ok(())
    })())
}

/// The class nearest to a slope (radians, positive downhill), from 0.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gedepth_core_nearest_slope_class(
    slope_classes: *const gedepth_core_slope_classes,
    radians: f32,
    class_index: *mut u32,
) -> i32 {
    // SAFETY: the crate's.
    number((|| unsafe {
        let (slope_classes, spans) = classes(slope_classes)?;
        let class_index = Array::one(class_index)?;
        check_disjoint(&[class_index.span()], &spans)?;
        let nearest = slope_classes
            .nearest_class(radians)
            .ok_or(Failure(GEDEPTH_CORE_NOT_FINITE))?;
        // At most 64.
        class_index.write(nearest as u32);
        Ok(())
    })())
}

/// The inverse depth of sloped ground (Eq. 7), 1/m: that of the plane less tan(slope) / height; slope in radians, positive
/// downhill.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gedepth_core_sloped_inverse_depth(
    camera: *const gedepth_core_camera,
    inverse_plane: f64,
    slope: f64,
    inverse_depth: *mut f64,
) -> i32 {
    // SAFETY: the crate's.
    number((|| unsafe {
        let camera = Camera::new(camera)?;
        let inverse_depth = Array::one(inverse_depth)?;
        check_disjoint(&[inverse_depth.span()], &[camera.span])?;
        check_finite(&[inverse_plane, slope])?;
        inverse_depth.write(adaptive_inverse_depth(
            inverse_plane,
            slope,
            camera.ground()?,
        ));
        Ok(())
    })())
}
