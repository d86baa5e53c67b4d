//! Depth against measurement, as papers report it: [`Frame`]s of a [`DataSet`] are scored one by one by an
//! [`Evaluator`], and [`Scores`] of pictures merge into those of a data set.
//!
//! What counts is [`Protocol`]'s: pixels that were measured between [`LEAST_DEPTH_M`] and the cap, inside the crop and
//! inside the part of the picture that the model sees. Predictions are clamped to the same range.
//!
//! Every metric comes in two ways: the mean over pictures of each picture's own metric, as most papers print it, and
//! pooled, over the pixels of all pictures together. A picture without such a pixel (in that interval, that region) has no
//! part in the mean.

mod frame;
mod scores;

pub use frame::{DataSet, Frame, GroundFrom};
pub use scores::{
    CloudScores, DISTANCE_LIMITS_M, ErrorScores, Metrics, Scores, StageScores, TimeScores,
};

use gedepth_core::camera::ImageSize;
use gedepth_core::fusion::DepthRange;
use gedepth_core::metrics::{
    ByDistance, ByRegion, CloudMatches, Crop, DepthErrors, Evaluation, cloud_scratch_len,
};
use gedepth_core::{CameraFrame, Point};

use crate::estimator::Estimate;

/// The least true depth that counts, metres.
pub const LEAST_DEPTH_M: f32 = 1e-3;

/// Which part of a picture counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum CropRule {
    /// All of it.
    None,
    /// The crop of Garg et al., as KITTI results are reported with it.
    Garg,
}

/// What counts, and how.
#[derive(Clone, Copy, Debug)]
pub struct Protocol {
    /// True depths that count, metres.
    pub range: DepthRange,
    /// Part of the picture that counts.
    pub crop: CropRule,
    /// Distance within which points of clouds match, metres; Ornek et al. use 0.1.
    pub cloud_threshold_m: f64,
}

/// Scores pictures one by one; its memory is that of the largest.
pub struct Evaluator {
    protocol: Protocol,
    depth: Vec<f32>,
    predicted: Vec<Point<CameraFrame>>,
    measured: Vec<Point<CameraFrame>>,
    scratch: Vec<u32>,
}

impl Evaluator {
    /// An evaluator by these rules.
    pub fn new(protocol: Protocol) -> Self {
        Self {
            protocol,
            depth: Vec::new(),
            predicted: Vec::new(),
            measured: Vec::new(),
            scratch: Vec::new(),
        }
    }

    /// The scores of one picture.
    ///
    /// # Errors
    /// When the protocol's threshold is not positive and finite, or the estimate is not of this picture at its size
    /// ([`OutputSize::Picture`](crate::OutputSize::Picture)).
    pub fn score(
        &mut self,
        frame: &Frame,
        estimate: &Estimate<'_>,
    ) -> Result<Scores, gedepth_core::Error> {
        let (width, height) = frame.picture.dimensions();
        let size = ImageSize::new(width, height)?;
        let (left, top) = (estimate.placement.left, estimate.placement.top);
        let (columns, rows) = estimate.size;
        let of_this_picture = columns <= width
            && rows <= height
            && (left, top) == ((width - columns) / 2, height - rows);
        if estimate.size != estimate.placement.region || !of_this_picture {
            return Err(gedepth_core::Error::OutputLength {
                needed: size.pixels(),
                given: estimate.depth.len(),
            });
        }
        self.depth.clear();
        self.depth.resize(size.pixels(), 0.0);
        for (line, row) in (top..).zip(estimate.depth.chunks_exact(columns as usize)) {
            let start = (line * width + left) as usize;
            self.depth[start..start + row.len()].copy_from_slice(row);
        }

        let whole = match self.protocol.crop {
            CropRule::None => Crop::whole(size),
            CropRule::Garg => Crop::garg(size),
        };
        let evaluation = Evaluation {
            crop: Crop {
                left: whole.left.max(left),
                top: whole.top.max(top),
                right: whole.right.min(left + columns),
                bottom: whole.bottom.min(top + rows),
            },
            range: self.protocol.range,
        };
        let mut errors = DepthErrors::new();
        let mut by_distance = ByDistance::new(DISTANCE_LIMITS_M)?;
        let mut by_region = ByRegion::<2>::new();
        self.predicted.clear();
        self.measured.clear();
        evaluation.pixels(
            size,
            &self.depth,
            &frame.depth,
            |index, predicted, truth| {
                errors.add(predicted, truth);
                by_distance.add(predicted, truth);
                by_region.add(usize::from(!frame.on_ground[index]), predicted, truth);
                let ray = frame.rays[index];
                if ray.is_finite() {
                    let at = |z: f32| Point::from_vector(ray.extend(1.0) * f64::from(z));
                    self.predicted.push(at(predicted));
                    self.measured.push(at(truth));
                }
            },
        )?;
        self.scratch.resize(
            cloud_scratch_len(self.predicted.len(), self.measured.len()),
            0,
        );
        let mut cloud = CloudMatches::new();
        cloud.add(
            &self.predicted,
            &self.measured,
            self.protocol.cloud_threshold_m,
            &mut self.scratch,
        )?;
        Ok(Scores::of_picture(
            &errors,
            &by_distance,
            &by_region,
            &cloud,
            estimate.times,
        ))
    }

    /// The depth of the picture scored last, at the picture's size, metres: as the model gave it, 0 outside the part
    /// that the model sees.
    pub fn depth(&self) -> &[f32] {
        &self.depth
    }
}
