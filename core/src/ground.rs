//! The ground: a plane in the world, and the same plane as one camera sees it.
//!
//! World and camera frames as in [`crate::frame`](crate#frames-units-and-signs), metres. Nothing panics.

mod vanishing_line;

use glam::{DVec2, DVec3};

use crate::{Angle, CameraFrame, Direction, Error, Extrinsics, Mounting, Point, WorldFrame};

/// The ground plane `n . p = d` in the world's frame; `n` points **up**, out of the ground.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GroundPlane {
    up: Direction<WorldFrame>,
    offset: f64,
}

const OFFSET_MAX: f64 = 1e9;

impl GroundPlane {
    /// The plane of all points with `up . p = offset`, metres. `up` points out of the ground: it is what tells a camera
    /// over the plane from one under it.
    ///
    /// # Errors
    /// [`Error::PlaneOffset`] if `offset` is not finite or beyond 1e9 m.
    pub fn new(up: Direction<WorldFrame>, offset: f64) -> Result<Self, Error> {
        if !(-OFFSET_MAX..=OFFSET_MAX).contains(&offset) {
            return Err(Error::PlaneOffset(offset));
        }
        Ok(Self { up, offset })
    }

    /// `y = h` in a world whose y axis points down, metres: the paper's Eq. 4.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn y_down(h: f64) -> Result<Self, Error> {
        Self::new(Direction::from_unit(DVec3::NEG_Y), -h)
    }

    /// `z = height` in a world whose z axis points up, metres: -1.65 for KITTI's LiDAR, 0 where the vehicle's frame has
    /// its origin on the road.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn z_up(height: f64) -> Result<Self, Error> {
        Self::new(Direction::from_unit(DVec3::Z), height)
    }

    /// R^-T n.
    fn up_seen_by(&self, extrinsics: &Extrinsics) -> DVec3 {
        extrinsics.inverse_rotation().transpose() * self.up.vector()
    }

    /// The height of `point` over the plane, metres; negative below it.
    pub fn height_of(&self, point: Point<WorldFrame>) -> f64 {
        self.up.vector().dot(point.vector()) - self.offset
    }
}

/// The ground plane as one camera sees it: which way is down, and how far below the camera the ground is.
///
/// The inverse depth of the ground on the ray `r` is `down . r / (r_z H)` (paper Eq. 5 in the camera's frame).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ground {
    down: Direction<CameraFrame>,
    height: f64,
}

const HEIGHT_MIN: f64 = 1e-3;
const HEIGHT_MAX: f64 = 1e5;

impl Ground {
    /// Ground `height` metres below the camera, in the direction `down` of the camera's frame.
    ///
    /// # Errors
    /// [`Error::CameraNotAboveGround`] if `height` is not in 0.001 to 1e5 m.
    pub fn new(down: Direction<CameraFrame>, height: f64) -> Result<Self, Error> {
        if !(HEIGHT_MIN..=HEIGHT_MAX).contains(&height) {
            return Err(Error::CameraNotAboveGround { height });
        }
        Ok(Self { down, height })
    }

    /// `plane` as the camera with these extrinsics sees it.
    ///
    /// # Errors
    /// [`Error::CameraNotAboveGround`] if the camera is under the plane, on it, or absurdly high.
    pub fn seen_by(extrinsics: &Extrinsics, plane: &GroundPlane) -> Result<Self, Error> {
        // n . (R^-1 r) = (R^-T n) . r, with the file's R as it is; its length, 1 but for printing errors, cancels
        // between numerator and denominator of Eq. 5.
        let up = plane.up_seen_by(extrinsics);
        let height = plane.height_of(extrinsics.camera_position()) / up.length();
        Self::new(Direction::from_vector(-up)?, height)
    }

    /// For a camera mounted `height` metres over the road: see [`Mounting`] for the signs of `pitch` (positive looks
    /// down) and `roll`. Yaw does not change what a camera sees of a plane.
    ///
    /// # Errors
    /// [`Error::AngleNotFinite`], [`Error::CameraNotAboveGround`].
    pub fn from_mounting(height: f64, pitch: Angle, roll: Angle) -> Result<Self, Error> {
        if !(HEIGHT_MIN..=HEIGHT_MAX).contains(&height) {
            return Err(Error::CameraNotAboveGround { height });
        }
        let extrinsics = Extrinsics::from_mounting(&Mounting {
            height,
            pitch,
            roll,
            yaw: Angle::ZERO,
        })?;
        // The height as given: rounded on its way through T it may be beyond its bounds.
        let up = GroundPlane::z_up(0.0)?.up_seen_by(&extrinsics);
        Self::new(Direction::from_vector(-up)?, height)
    }

    /// The direction straight down to the ground.
    pub const fn down(&self) -> Direction<CameraFrame> {
        self.down
    }

    /// H: the camera's height over the ground, metres; positive.
    pub const fn height(&self) -> f64 {
        self.height
    }

    /// The inverse of the ground's depth `z`, 1/m, on the ray through `point` at z = 1
    /// ([`CameraModel::forward_ray`](crate::camera::CameraModel::forward_ray)): positive where the ray meets the ground, 0
    /// where it runs along it, negative where it rises.
    pub fn inverse_depth(&self, point: DVec2) -> f64 {
        self.down.vector().dot(point.extend(1.0)) / self.height
    }
}
