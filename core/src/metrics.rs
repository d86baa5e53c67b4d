//! How good a depth map is: accumulators that take one pixel or one cloud after the other and can be merged.
//!
//! - Depth in metres, planar; maps row-major. Sums are kept in `f64`.
//! - [`DepthErrors`]: Abs Rel, Sq Rel, RMSE, RMSE log, SILog, delta 1.25^k; [`ByDistance`] and [`ByRegion`] keep one for
//!   each interval of the true depth or each region of the picture.
//! - [`Evaluation`]: which pixels count (crop, depth cap).
//! - [`CloudMatches`]: F-score and IoU of point clouds.
//!
//! Merging accumulators of parts gives, up to rounding, that of the whole. Nothing panics.

mod binned;
mod cloud;
mod depth_errors;
mod evaluation;

pub use binned::{ByDistance, ByRegion};
pub use cloud::{CloudMatches, CloudMetrics, cloud_scratch_len};
pub use depth_errors::{DepthErrors, DepthMetrics};
pub use evaluation::{Crop, Evaluation};
