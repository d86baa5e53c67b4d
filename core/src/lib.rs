//! Ground embedding for monocular depth (GEDepth, ICCV 2023, arXiv 2309.09975): the ground as a
//! camera sees it, road slope, and the fusion of both with what a network predicts.
//!
//! `no_std`, no allocation, no `unsafe`: everything is written into memory that the caller owns.
//!
//! # Frames, units and signs
//!
//! - **Camera frame** ([`CameraFrame`]): x right, y down, z forward along the optical axis, metres.
//! - **World frame** ([`WorldFrame`]): whatever frame the calibration's `R`, `T` lead from, metres;
//!   a [`GroundPlane`] says which way is up in it.
//! - **Depth** is planar: `z` in the camera frame, not the distance along the ray. A ray at 90 degrees or
//!   more from the axis has no depth.
//! - **Inverse ground depth** `1 / z`, in 1/m, is what tables hold. It is positive below the vanishing line,
//!   zero on it and negative above it; the depth itself is 0 on and above the line.
//! - **Pixels** ([`camera::Pixel`]): u right, v down, integer coordinates are pixel *centres*; pictures and tables are
//!   row-major, `index = v * width + u`.
//! - **Angles** are [`Angle`]s. A **slope** is positive where the road falls away (downhill), the paper's Eq. 6.
//!
//! # From a calibration to metric depth
//!
//! ```
//! use gedepth_core::camera::{ImageSize, Intrinsics, Pinhole};
//! use gedepth_core::{Angle, Ground, table::GroundLut};
//!
//! // A camera 1.65 m over the road, looking 2 degrees down.
//! let size = ImageSize::new(160, 120)?;
//! let camera = Pinhole::new(Intrinsics::centred(size, 150.0)?);
//! let ground = Ground::from_mounting(1.65, Angle::from_degrees(2.0), Angle::ZERO)?;
//!
//! // Capacity fixed at compile time; fits a `static`.
//! let mut lut = GroundLut::<{ 160 * 120 }>::new();
//! let view = lut.build(&camera, &ground)?;
//! assert_eq!(view.depth(80, 20), Some(0.0)); // above the vanishing line
//! assert!((view.depth(80, 119).unwrap() - 3.82).abs() < 0.01); // the lowest row
//! # Ok::<(), gedepth_core::Error>(())
//! ```
//!
//! # Memory
//!
//! Tables and scratch are the caller's, their lengths `const fn`s. Types are small: `KannalaBrandt` 312 bytes,
//! `SlopeClasses` 264, all others at most 168, but for owned tables and binned accumulators; `tests/footprint.rs`
//! asserts every one. No call recurses. Optimized for x86-64, cameras, tables, the vanishing line and metrics take at
//! most 4 KiB of stack, fusion at most 6 KiB, its callers' frames included; asserted too.
//!
//! # Panics
//!
//! Nothing in this crate panics, whatever the arguments: what cannot be done is an [`Error`], what a camera does
//! not see is `None`.
#![no_std]
#![forbid(unsafe_code)]

pub mod camera;
pub mod fusion;
pub mod metrics;
pub mod slope;
pub mod table;

mod angle;
mod error;
mod frame;
mod ground;
mod polynomial;
mod pose;
mod scalar;

/// The vectors of this interface.
pub use glam;

pub use angle::Angle;
pub use error::Error;
pub use frame::{CameraFrame, Direction, Frame, Point, WorldFrame};
pub use ground::{Ground, GroundPlane};
pub use pose::{Extrinsics, Mounting};
