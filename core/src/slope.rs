//! Road slope: classes of angles, their expectation, labels from measured depth, and the adaptive ground depth.
//!
//! - Angles are radians inside, [`Angle`] at the edges, within +-30 degrees.
//! - A slope is **positive downhill** (the road falls away and depth grows): `y_w = tan(alpha) z_c + h`, the paper's
//!   Eq. 6. Classes of networks that count uphill as positive (the reference implementation) are turned over when the
//!   classes are made: [`SlopeSign`].
//! - Adaptive ground depth in inverse depth: `1 / z_slope = 1 / z_plane - tan(alpha) / H` (Eq. 7); it costs one
//!   subtraction.
//!
//! Nothing panics.

use heapless::Vec;

use crate::polynomial::exp;
use crate::scalar::{atan2, tan};
use crate::{Angle, Error, Ground};

/// Which sign a network's slope classes have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SlopeSign {
    /// Positive where the road falls away: the paper's Eq. 6.
    DownhillPositive,
    /// Positive where the road rises: the reference implementation's code.
    UphillPositive,
}

/// The slope angles of a network's slope classes, at most `N`, ascending in the network's own sign.
#[derive(Debug, Clone, PartialEq)]
pub struct SlopeClasses<const N: usize = 64> {
    /// Radians, positive downhill, in the order of the network's channels.
    angles: Vec<f32, N>,
}

impl<const N: usize> SlopeClasses<N> {
    /// The largest angle of a class, either way.
    pub const MAX_DEGREES: f64 = 30.0;

    /// Classes at the given angles, in the order of the network's channels.
    ///
    /// # Errors
    /// [`Error::SlopeClassCount`] if there is none or more than `N`; [`Error::SlopeAngle`] if an angle is not finite,
    /// beyond +-30 degrees, or not larger than the one before it.
    pub fn new(angles: &[Angle], sign: SlopeSign) -> Result<Self, Error> {
        let count_error = Error::SlopeClassCount {
            given: angles.len(),
            capacity: N,
        };
        if angles.is_empty() {
            return Err(count_error);
        }
        let mut downhill = Vec::new();
        let mut before = f64::NEG_INFINITY;
        for (index, angle) in angles.iter().enumerate() {
            let degrees = angle.degrees();
            // A little beyond: 30 degrees may come as radians.
            let allowed = degrees.abs() <= Self::MAX_DEGREES + 1e-9;
            if !allowed || angle.radians() <= before {
                return Err(Error::SlopeAngle { index, degrees });
            }
            before = angle.radians();
            let radians = match sign {
                SlopeSign::DownhillPositive => before,
                SlopeSign::UphillPositive => -before,
            };
            downhill.push(radians as f32).map_err(|_| count_error)?;
        }
        Ok(Self { angles: downhill })
    }

    /// `count` classes from `first` to `last` at equal distances; the paper's are 11 from -5 to 5 degrees.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn uniform(
        first: Angle,
        last: Angle,
        count: usize,
        sign: SlopeSign,
    ) -> Result<Self, Error> {
        let mut angles: Vec<Angle, N> = Vec::new();
        let steps = count.saturating_sub(1).max(1) as f64;
        for index in 0..count {
            let share = index as f64 / steps;
            let radians = first.radians() * (1.0 - share) + last.radians() * share;
            angles
                .push(Angle::from_radians(radians))
                .map_err(|_| Error::SlopeClassCount {
                    given: count,
                    capacity: N,
                })?;
        }
        Self::new(&angles, sign)
    }

    /// The angles in radians, **positive downhill**, in the order of the network's channels.
    pub fn radians(&self) -> &[f32] {
        &self.angles
    }

    /// The tangent of the steepest climb that any class has; 0 if none climbs.
    pub fn steepest_climb(&self) -> f32 {
        let steepest = self
            .angles
            .iter()
            .fold(0.0_f32, |most, angle| most.max(-angle));
        tan(f64::from(steepest)) as f32
    }

    /// The expected slope, radians, positive downhill: `sum_i p_i tau_i` with `p = softmax(logits)` (Eq. 8).
    ///
    /// Stable for all finite logits; equal logits give the mean angle.
    ///
    /// # Errors
    /// [`Error::SlopeLogitCount`] if there are more or fewer logits than classes, [`Error::SlopeLogitNotFinite`].
    pub fn expected_angle(&self, logits: &[f32]) -> Result<f32, Error> {
        if logits.len() != self.angles.len() {
            return Err(Error::SlopeLogitCount {
                classes: self.angles.len(),
                given: logits.len(),
            });
        }
        if let Some(index) = logits.iter().position(|logit| !logit.is_finite()) {
            return Err(Error::SlopeLogitNotFinite { index });
        }
        let largest = logits.iter().copied().fold(f32::MIN, f32::max);
        let (mut sum, mut weighted) = (0.0, 0.0);
        for (logit, angle) in logits.iter().zip(&self.angles) {
            let weight = exp(logit - largest);
            sum += weight;
            weighted += weight * angle;
        }
        Ok(weighted / sum)
    }

    /// The class whose angle is nearest to `slope` (radians, positive downhill): the label of Eq. 9 as a class. Angles
    /// beyond the last class belong to it, as in training labels. `None` for NaN.
    pub fn nearest_class(&self, slope: f32) -> Option<usize> {
        if slope.is_nan() {
            return None;
        }
        // Beyond all classes, and still so that distances to them differ.
        let slope = slope.clamp(-2.0, 2.0);
        let distance = |class: &usize| {
            self.angles
                .get(*class)
                .map_or(f32::MAX, |angle| (angle - slope).abs())
        };
        (0..self.angles.len()).min_by(|a, b| distance(a).total_cmp(&distance(b)))
    }
}

/// The adaptive inverse ground depth `1 / z_slope = 1 / z_plane - tan(alpha) / H` (Eq. 7), 1/m; `slope` in radians,
/// positive downhill. Ground is where it is positive: [`crate::table::depth_from_inverse`].
pub fn adaptive_inverse_depth(inverse_plane: f64, slope: f64, ground: &Ground) -> f64 {
    inverse_plane - tan(slope) / ground.height()
}

/// The slope at a measured planar depth (Eq. 9): the angle, positive downhill, at which the sloped ground of Eq. 6 has
/// depth `measured` (metres) on a ray whose inverse plane depth is `inverse_plane` (1/m).
///
/// `None` unless `measured` is positive and finite and `inverse_plane` finite.
pub fn slope_from_depth(inverse_plane: f64, measured: f64, ground: &Ground) -> Option<Angle> {
    let measurable = measured > 0.0 && measured.is_finite() && inverse_plane.is_finite();
    // Eq. 9: atan((b2 - h) / z + n . A [u v 1]) = atan(H (1/z_plane - 1/z)).
    measurable.then(|| {
        Angle::from_radians(atan2(
            (inverse_plane - 1.0 / measured) * ground.height(),
            1.0,
        ))
    })
}
