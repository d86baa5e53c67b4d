//! The ground under a camera, which may change while the camera is open.

use std::iter;

use gedepth::gedepth_core::{Angle, Direction, Error, Ground};

use crate::calibration::gedepth_calibration;
use crate::camera::gedepth_camera;
use crate::memory::{Array, check_disjoint, look, read};
use crate::result::{Result, guarded};

/// The ground as a camera sees it.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct gedepth_ground {
    /// The direction straight down to it, in the camera's frame: x right, y down, z forward. Of any length; the library writes
    /// unit vectors.
    pub down: [f64; 3],
    /// The camera's height over it, metres, 0.001 to 1e5.
    pub height: f64,
}

impl gedepth_ground {
    fn checked(&self) -> std::result::Result<Ground, Error> {
        let [x, y, z] = self.down;
        Ground::new(Direction::new(x, y, z)?, self.height)
    }
}

impl From<Ground> for gedepth_ground {
    fn from(ground: Ground) -> Self {
        Self {
            down: ground.down().vector().to_array(),
            height: ground.height(),
        }
    }
}

/// # Safety
/// [The crate's contract](crate#safety).
unsafe fn write(ground: *mut gedepth_ground, value: Result<Ground>) -> Result<()> {
    let place = Array::one(ground)?;
    // SAFETY: passed on.
    unsafe { place.write(0, &[value?.into()]) };
    Ok(())
}

/// The ground that R, T and the plane of a calibration give; the camera and its lens are not looked at.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gedepth_ground_of_calibration(
    calibration: *const gedepth_calibration,
    ground: *mut gedepth_ground,
) -> i32 {
    guarded(|| {
        let place = Array::one(ground)?.span();
        check_disjoint(iter::once(&place), &[Array::one(calibration)?.span()])?;
        // SAFETY: the crate's contract.
        let numbers = unsafe { read(calibration) }?;
        // SAFETY: as above.
        unsafe { write(ground, Ok(numbers.ground()?)) }
    })
}

/// The ground `height` metres (0.001 to 1e5) under a camera that looks along the ground, but for `pitch` (positive looks down) and
/// then `roll` (positive lowers the right side), both in radians.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gedepth_ground_of_mounting(
    height: f64,
    pitch: f64,
    roll: f64,
    ground: *mut gedepth_ground,
) -> i32 {
    guarded(|| {
        let [pitch, roll] = [pitch, roll].map(Angle::from_radians);
        // SAFETY: the crate's contract.
        unsafe { write(ground, Ok(Ground::from_mounting(height, pitch, roll)?)) }
    })
}

/// The ground that the camera's next picture is fused with. Allocates nothing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gedepth_camera_ground(
    camera: *const gedepth_camera,
    ground: *mut gedepth_ground,
) -> i32 {
    guarded(|| {
        // SAFETY: the crate's contract.
        let camera = unsafe { look(camera) }?;
        // SAFETY: as above.
        unsafe { write(ground, camera.ground()) }
    })
}

/// The same camera over another ground, from its next picture on: a vehicle pitches, and its springs give under a load. Depth is
/// then that of a camera opened with this ground. Until a picture has run, gedepth_camera_plausibility is the last one's
/// heads over the new ground. Allocates nothing; takes 2 to 3 % of the time of a picture, with a lens 7.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gedepth_camera_set_ground(
    camera: *mut gedepth_camera,
    ground: *const gedepth_ground,
) -> i32 {
    guarded(|| {
        // SAFETY: the crate's contract.
        let (camera, ground) = unsafe { (look(camera.cast_const())?, read(ground)?) };
        camera.set_ground(&ground.checked()?)
    })
}
