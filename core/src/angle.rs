//! Angles that say their unit.

/// A plane angle, kept in radians.
///
/// Any `f64` is accepted; functions that need a finite or bounded angle report [`crate::Error`].
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd, Default)]
pub struct Angle(f64);

impl Angle {
    /// No rotation.
    pub const ZERO: Self = Self(0.0);

    /// An angle given in radians.
    pub const fn from_radians(radians: f64) -> Self {
        Self(radians)
    }

    /// An angle given in degrees.
    pub const fn from_degrees(degrees: f64) -> Self {
        Self(degrees.to_radians())
    }

    /// The angle in radians.
    pub const fn radians(self) -> f64 {
        self.0
    }

    /// The angle in degrees.
    pub const fn degrees(self) -> f64 {
        self.0.to_degrees()
    }
}
