//! Frames as types: a point or a direction says whether it is in the camera's or the world's frame.
//!
//! Values are `f64` (`glam::DVec3`): calibrations are evaluated once, in full precision.
//! Points are metres; directions have unit length. Nothing here panics.

use core::marker::PhantomData;

use glam::DVec3;

use crate::Error;

mod sealed {
    pub trait Sealed {}
    impl Sealed for super::CameraFrame {}
    impl Sealed for super::WorldFrame {}
}

/// A coordinate frame; sealed.
pub trait Frame: sealed::Sealed + Copy {}

/// The camera's frame: x right, y down, z forward along the optical axis; origin in the centre of projection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CameraFrame;

/// The frame that the extrinsics lead from: a LiDAR's, a vehicle's, the paper's y-down world.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WorldFrame;

impl Frame for CameraFrame {}
impl Frame for WorldFrame {}

/// A point, in metres, in frame `F`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point<F: Frame> {
    xyz: DVec3,
    frame: PhantomData<F>,
}

impl<F: Frame> Point<F> {
    /// The point with these coordinates, in metres.
    pub const fn new(x: f64, y: f64, z: f64) -> Self {
        Self::from_vector(DVec3::new(x, y, z))
    }

    /// The point at `xyz`, in metres.
    pub const fn from_vector(xyz: DVec3) -> Self {
        Self {
            xyz,
            frame: PhantomData,
        }
    }

    /// The coordinates, in metres.
    pub const fn vector(self) -> DVec3 {
        self.xyz
    }
}

/// A direction of unit length in frame `F`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Direction<F: Frame> {
    unit: DVec3,
    frame: PhantomData<F>,
}

impl<F: Frame> Direction<F> {
    /// The direction of the vector `(x, y, z)`, of any length.
    ///
    /// # Errors
    /// [`Error::DirectionWithoutLength`] if the vector is zero, not finite, or longer than 1e154 or
    /// shorter than 1.5e-154.
    pub fn new(x: f64, y: f64, z: f64) -> Result<Self, Error> {
        Self::from_vector(DVec3::new(x, y, z))
    }

    /// The direction of `vector`, of any length. See [`Self::new`].
    ///
    /// # Errors
    /// See [`Self::new`].
    pub fn from_vector(vector: DVec3) -> Result<Self, Error> {
        // Below, the squared length has few bits left.
        let long_enough = vector.length_squared() >= f64::MIN_POSITIVE;
        match vector.try_normalize().filter(|_| long_enough) {
            Some(unit) => Ok(Self::from_unit(unit)),
            None => Err(Error::DirectionWithoutLength {
                x: vector.x,
                y: vector.y,
                z: vector.z,
            }),
        }
    }

    /// `unit` must have unit length.
    pub(crate) const fn from_unit(unit: DVec3) -> Self {
        Self {
            unit,
            frame: PhantomData,
        }
    }

    /// The components; their squares sum to 1.
    pub const fn vector(self) -> DVec3 {
        self.unit
    }
}
