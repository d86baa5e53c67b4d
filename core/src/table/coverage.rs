//! How much of a picture shows ground.

use super::{GroundRows, MIN_INVERSE_DEPTH};
use crate::Error;

/// How much of a picture shows ground, and from where on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Coverage {
    /// The share of pixels that see the ground plane, 0 to 1; those at 90 degrees and more from the axis, which have no
    /// depth, do not count.
    pub share: f64,
    /// The least planar depth of ground in the picture, metres; `None` if no pixel sees any.
    pub nearest: Option<f32>,
}

impl Coverage {
    /// Looks at all rows of `ground`; `scratch` holds one of them.
    ///
    /// # Errors
    /// [`Error::ScratchLength`] if `scratch` is shorter than the picture is wide; [`Error::GroundRow`].
    pub fn of<G: GroundRows + ?Sized>(ground: &G, scratch: &mut [f32]) -> Result<Self, Error> {
        let size = ground.size();
        let given = scratch.len();
        let row = scratch
            .get_mut(..size.width() as usize)
            .ok_or(Error::ScratchLength {
                needed: size.width() as usize,
                given,
            })?;
        let (mut seen, mut largest) = (0_usize, 0.0_f32);
        for v in 0..size.height() {
            ground.write_row(v, row)?;
            for inverse in row.iter().filter(|inverse| **inverse > MIN_INVERSE_DEPTH) {
                seen += 1;
                largest = largest.max(*inverse);
            }
        }
        Ok(Self {
            share: seen as f64 / size.pixels() as f64,
            nearest: (seen > 0).then(|| 1.0 / largest),
        })
    }
}
