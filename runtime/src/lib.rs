//! Metric depth from one camera picture and its calibration: runs quantized GEDepth networks ("Ground Embedding for
//! Monocular Depth Estimation", ICCV 2023) on the CPU.
//!
//! One way through the data: a [`Model`] (ONNX file with its [`contract`]) and a [`Calibration`] make an [`Estimator`],
//! which plans the network and builds the ground table, once. Then each [`Picture`] becomes an [`Estimate`]:
//! bytes, resampled planes, network, heads, fusion, depth.
//!
//! ```no_run
//! use std::path::Path;
//! use gedepth::{Calibration, Estimator, Model, OutputSize, Picture, picture};
//!
//! let image = picture::read(Path::new("image.png"))?;
//! let calibration = Calibration::read(Path::new("calibration.json"))?;
//! let mut estimator =
//!     Estimator::new(&Model::embedded()?, &calibration, image.dimensions(), None, OutputSize::Picture)?;
//! let estimate = estimator.run(Picture::new(image.dimensions(), image.as_raw())?)?;
//! let (width, height) = estimate.size;
//! println!("{:.1} m in the middle", estimate.depth[(height / 2 * width + width / 2) as usize]);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Features
//!
//! `files` (picture files, [`render`], [`evaluation`]) and `cli` (the command line) are on by default; without them the
//! crate takes pictures as bytes and depends on neither picture formats nor argument parsing.

pub mod contract;
#[cfg(feature = "files")]
pub mod evaluation;
#[cfg(feature = "files")]
pub mod picture;
#[cfg(feature = "files")]
pub mod render;

mod calibration;
mod engine;
mod error;
mod estimator;
mod ground;
mod heads;
mod inspection;
mod model;
mod pixel_format;
mod plausibility;
mod preprocess;
mod resample;
mod vectors;

/// The geometry and the maths: what [`Calibration`], [`Camera`] and errors are made of.
pub use gedepth_core;

pub use calibration::{Calibration, Camera, Distortion, Numbers, json, kitti};
pub use engine::{Engine, InspectedNode, Kernel, LayerTime, Place};
pub use error::Error;
pub use estimator::{Estimate, Estimator, Maps, OutputSize, StageTimes};
pub use inspection::{InspectedTensor, Inspection, PlanKind, Weights};
pub use model::{Model, Size};
pub use pixel_format::{Picture, PixelFormat, Plane, Yuv};
pub use plausibility::Plausibility;
pub use preprocess::Placement;
