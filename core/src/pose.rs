//! Where a camera is and how it is turned: extrinsics.
//!
//! `p_camera = R p_world + T`, metres. Nothing panics.

use glam::{DMat3, DVec3};

use crate::scalar::sin_cos;
use crate::{Angle, CameraFrame, Error, Point, WorldFrame};

/// World to camera: `p_camera = R p_world + T`.
///
/// `R` is kept as given, printing errors included, and its true inverse is used to go back, so that the paper's Eq. 5
/// (`A = R^-1 K^-1`) is met with the very numbers of a calibration file. It must be a rotation within
/// [`Extrinsics::ORTHONORMAL_TOLERANCE`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Extrinsics {
    rotation: DMat3,
    inverse: DMat3,
    translation: DVec3,
}

/// How a camera is mounted: the short way to extrinsics where there is no calibration file.
///
/// The world frame is the vehicle's: x forward, y left, z up, origin on the ground below the camera.
/// With all angles zero the camera looks along x, its picture upright. Rotations apply in the order yaw, pitch, roll,
/// each about the axes that the ones before have turned (ISO 8855).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mounting {
    /// Height of the centre of projection over the ground, metres.
    pub height: f64,
    /// About the left axis: positive looks down.
    pub pitch: Angle,
    /// About the forward axis: positive lowers the camera's right side.
    pub roll: Angle,
    /// About the up axis: positive looks to the left.
    pub yaw: Angle,
}

const TRANSLATION_MAX: f64 = 1e9;

impl Extrinsics {
    /// Largest accepted entry of `|R R^T - I|`: files print rotations with four digits and more.
    pub const ORTHONORMAL_TOLERANCE: f64 = 1e-3;

    /// From the rotation `r` (rows) and the translation `t`, metres: `p_camera = r p_world + t`.
    ///
    /// # Errors
    /// [`Error::NotARotation`] if `r` holds a NaN or is not orthonormal within [`Self::ORTHONORMAL_TOLERANCE`];
    /// [`Error::Reflection`] if it mirrors; [`Error::Translation`] if `t` is not finite or beyond 1e9 m.
    pub fn world_to_camera(r: [[f64; 3]; 3], t: [f64; 3]) -> Result<Self, Error> {
        let rotation = DMat3::from_cols_array_2d(&r).transpose();
        let difference = rotation * rotation.transpose() - DMat3::IDENTITY;
        let mut deviation: f64 = 0.0;
        for entry in difference.to_cols_array() {
            deviation = deviation.max(entry.abs());
        }
        // `max` loses a NaN.
        if difference.is_nan() {
            deviation = f64::NAN;
        }
        if deviation.is_nan() || deviation > Self::ORTHONORMAL_TOLERANCE {
            return Err(Error::NotARotation { deviation });
        }
        let determinant = rotation.determinant();
        if determinant < 0.0 {
            return Err(Error::Reflection { determinant });
        }
        for value in t {
            if !(-TRANSLATION_MAX..=TRANSLATION_MAX).contains(&value) {
                return Err(Error::Translation(value));
            }
        }
        Ok(Self {
            rotation,
            inverse: rotation.inverse(),
            translation: DVec3::from_array(t),
        })
    }

    /// From the camera's mounting; the world is the vehicle's frame of [`Mounting`].
    ///
    /// # Errors
    /// [`Error::AngleNotFinite`], or [`Error::Translation`] for the height.
    pub fn from_mounting(mounting: &Mounting) -> Result<Self, Error> {
        for angle in [mounting.pitch, mounting.roll, mounting.yaw] {
            if !angle.radians().is_finite() {
                return Err(Error::AngleNotFinite(angle.radians()));
            }
        }
        let (sin_yaw, cos_yaw) = sin_cos(mounting.yaw.radians());
        let (sin_pitch, cos_pitch) = sin_cos(mounting.pitch.radians());
        let (sin_roll, cos_roll) = sin_cos(mounting.roll.radians());
        // Columns: where the turned forward, left and up axes point in the world.
        let yaw = DMat3::from_cols(
            DVec3::new(cos_yaw, sin_yaw, 0.0),
            DVec3::new(-sin_yaw, cos_yaw, 0.0),
            DVec3::Z,
        );
        let pitch = DMat3::from_cols(
            DVec3::new(cos_pitch, 0.0, -sin_pitch),
            DVec3::Y,
            DVec3::new(sin_pitch, 0.0, cos_pitch),
        );
        let roll = DMat3::from_cols(
            DVec3::X,
            DVec3::new(0.0, cos_roll, sin_roll),
            DVec3::new(0.0, -sin_roll, cos_roll),
        );
        let body = yaw * pitch * roll;
        // The camera's axes in the turned body: right = -left, down = -up, forward.
        let camera_to_world = DMat3::from_cols(-body.y_axis, -body.z_axis, body.x_axis);
        let rotation = camera_to_world.transpose();
        let translation = -(rotation * DVec3::new(0.0, 0.0, mounting.height));
        Self::world_to_camera(
            rotation.transpose().to_cols_array_2d(),
            translation.to_array(),
        )
    }

    /// `R`, rows.
    pub fn rotation(&self) -> [[f64; 3]; 3] {
        self.rotation.transpose().to_cols_array_2d()
    }

    /// `T`, metres.
    pub const fn translation(&self) -> [f64; 3] {
        self.translation.to_array()
    }

    /// `R^-1`.
    pub(crate) const fn inverse_rotation(&self) -> DMat3 {
        self.inverse
    }

    /// `R p + T`.
    pub fn to_camera(&self, point: Point<WorldFrame>) -> Point<CameraFrame> {
        Point::from_vector(self.rotation * point.vector() + self.translation)
    }

    /// `R^-1 (p - T)`.
    pub fn to_world(&self, point: Point<CameraFrame>) -> Point<WorldFrame> {
        Point::from_vector(self.inverse * (point.vector() - self.translation))
    }

    /// Where the camera's centre of projection is in the world: `B = -R^-1 T`.
    pub fn camera_position(&self) -> Point<WorldFrame> {
        self.to_world(Point::from_vector(DVec3::ZERO))
    }
}
