//! Data sets: folders of frames, each a folder with
//!
//! - `image.png` or `image.jpg`: the picture;
//! - `depth.png`: 16 bits, metres x 256, 0 = not measured (KITTI's convention), at the picture's size;
//! - `calibration.json`: see [`crate::json`];
//! - `ground.png`, if there: 8 bits, at the picture's size, 0 = not ground.

use std::path::{Path, PathBuf};

use gedepth_core::camera::{CameraModel, Pixel};
use gedepth_core::slope::slope_from_depth;
use glam::DVec2;
use image::{ColorType, DynamicImage, RgbImage};

use crate::{Calibration, Error, picture};

/// Without `ground.png`, a measured pixel is ground where the slope from the plane to it (Eq. 9) is within this, degrees.
const GROUND_SLOPE_DEG: f64 = 1.5;

/// A folder of frames.
#[derive(Clone, Debug)]
pub struct DataSet {
    /// The folder's own name.
    pub name: String,
    /// The frames' folders, by name.
    pub frames: Vec<PathBuf>,
}

impl DataSet {
    /// Lists the frames of a folder: all its folders but those whose name begins with a dot.
    pub fn open(path: &Path) -> Result<Self, Error> {
        let unusable = |reason: String| Error::DataSet {
            path: path.to_owned(),
            reason,
        };
        let list = || -> std::io::Result<Vec<PathBuf>> {
            let mut frames = Vec::new();
            for entry in std::fs::read_dir(path)? {
                let entry = entry?;
                let hidden = entry.file_name().as_encoded_bytes().starts_with(b".");
                if !hidden && entry.path().is_dir() {
                    frames.push(entry.path());
                }
            }
            frames.sort();
            Ok(frames)
        };
        let frames = list().map_err(|e| unusable(e.to_string()))?;
        if frames.is_empty() {
            return Err(unusable(
                "no frame in it; give a folder of frames, each a folder with image.png, depth.png and calibration.json"
                    .to_owned(),
            ));
        }
        // "." and ".." have a name, too.
        let name = path
            .canonicalize()
            .map_err(|e| unusable(e.to_string()))?
            .file_name()
            .map_or_else(
                || "data".to_owned(),
                |name| name.to_string_lossy().into_owned(),
            );
        Ok(Self { name, frames })
    }
}

/// How it is known which pixels are ground.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GroundFrom {
    /// From `ground.png`.
    Mask,
    /// From the measured depth: where the slope of Eq. 9 is within 1.5 degrees, that is, less than 2.6 % of the depth
    /// above or below the nominal plane. Low things far away pass for ground, and steep roads do not.
    Slope,
}

/// A picture with its measured depth and its calibration.
#[derive(Clone, Debug)]
pub struct Frame {
    /// The folder's own name.
    pub name: String,
    /// The picture.
    pub picture: RgbImage,
    /// Its camera and ground.
    pub calibration: Calibration,
    /// Measured planar depth, metres, row-major; 0 = not measured.
    pub depth: Vec<f32>,
    /// Which measured pixels are ground.
    pub on_ground: Vec<bool>,
    /// How that is known.
    pub ground_from: GroundFrom,
    /// Direction of each measured pixel in the camera's frame, at z = 1; NaN where there is none.
    pub(super) rays: Vec<DVec2>,
}

impl Frame {
    /// Reads a frame's folder.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let jpeg = path.join("image.jpg");
        let picture = picture::read(&match jpeg.exists() {
            true => jpeg,
            false => path.join("image.png"),
        })?;
        let size = picture.dimensions();
        let calibration = Calibration::read(&path.join("calibration.json"))?;
        let unusable = |e: Error| Error::DataSet {
            path: path.to_owned(),
            reason: e.to_string(),
        };
        let camera = calibration.camera(size).map_err(unusable)?;
        let depth = match read_map(&path.join("depth.png"), size, ColorType::L16)? {
            DynamicImage::ImageLuma16(steps) => steps
                .into_raw()
                .into_iter()
                .map(|steps| f32::from(steps) / 256.0)
                .collect::<Vec<_>>(),
            _ => Vec::new(),
        };
        let mask_path = path.join("ground.png");
        let mask = match mask_path.exists() {
            true => Some(read_map(&mask_path, size, ColorType::L8)?.into_luma8()),
            false => None,
        };

        let ground = calibration.ground();
        let mut rays = vec![DVec2::NAN; depth.len()];
        let mut on_ground = vec![false; depth.len()];
        for (index, &z) in depth.iter().enumerate().filter(|&(_, &z)| z > 0.0) {
            let (u, v) = (index % size.0 as usize, index / size.0 as usize);
            if let Some(ray) = camera.forward_ray(Pixel::new(u as f64, v as f64)) {
                rays[index] = ray;
                let slope = slope_from_depth(ground.inverse_depth(ray), f64::from(z), ground);
                on_ground[index] =
                    slope.is_some_and(|slope| slope.degrees().abs() <= GROUND_SLOPE_DEG);
            }
        }
        let ground_from = match mask {
            Some(mask) => {
                on_ground = mask.into_raw().into_iter().map(|label| label > 0).collect();
                GroundFrom::Mask
            }
            None => GroundFrom::Slope,
        };
        Ok(Self {
            name: path
                .file_name()
                .map_or_else(String::new, |name| name.to_string_lossy().into_owned()),
            picture,
            calibration,
            depth,
            on_ground,
            ground_from,
            rays,
        })
    }
}

/// A grey map of the picture's size.
fn read_map(path: &Path, size: (u32, u32), colour: ColorType) -> Result<DynamicImage, Error> {
    let map = picture::read_any(path)?;
    let unusable = |reason: String| {
        Err(Error::DataSet {
            path: path.to_owned(),
            reason,
        })
    };
    if map.color() != colour {
        return unusable(format!(
            "its pixels are {:?} instead of {colour:?}",
            map.color()
        ));
    }
    if (map.width(), map.height()) != size {
        return unusable(format!(
            "its size is {:?}, but the picture's is {size:?}",
            (map.width(), map.height())
        ));
    }
    Ok(map)
}
