//! Calibration files: the camera, where it is, and where the ground is.
//!
//! [`Calibration::read`] knows the project's own file ([`json`]) and KITTI's ([`kitti`]) by their content.

mod camera;
pub mod json;
pub mod kitti;

use std::io::Read;
use std::path::{Path, PathBuf};

use gedepth_core::camera::{ImageSize, Intrinsics};
use gedepth_core::{Direction, Extrinsics, Ground, GroundPlane};

pub use camera::{Camera, Distortion};

use crate::Error;
use crate::model::Size;

/// A larger file is no calibration.
const MAX_FILE_BYTES: u64 = 1 << 20;

/// The numbers of a calibration, before they are checked: every format of file is brought to this.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Numbers {
    /// Width and height of the pictures in pixels, where they are known.
    pub size: Option<Size>,
    /// Intrinsics, rows, pixels; integer coordinates are pixel centres.
    pub k: [[f64; 3]; 3],
    /// The lens.
    pub distortion: Distortion,
    /// World to camera, `p_camera = R p_world + T`: the rows of R.
    pub r: [[f64; 3]; 3],
    /// T, metres.
    pub t: [f64; 3],
    /// The ground in the world, `up . p_world = offset`: its normal, pointing up.
    pub up: [f64; 3],
    /// Metres.
    pub offset: f64,
}

impl Numbers {
    /// Reads a calibration file. For KITTI raw, `path` is `calib_cam_to_cam.txt`, and `calib_velo_to_cam.txt` is read
    /// beside it.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let text = read_text(path)?;
        // Some editors begin a file with a byte order mark.
        let text = text.trim_start_matches('\u{feff}');
        let malformed = |path: &Path| {
            let path = path.to_owned();
            move |reason| Error::CalibrationFormat { path, reason }
        };
        let numbers = if text.trim_start().starts_with('{') {
            json::parse(text)
        } else {
            let entries = kitti::Entries::parse(text);
            if entries.has("P_rect_02") {
                let beside = path.with_file_name("calib_velo_to_cam.txt");
                let lidar = kitti::lidar(&kitti::Entries::parse(&read_text(&beside)?))
                    .map_err(malformed(&beside))?;
                kitti::raw(&entries, lidar)
            } else if entries.has("P2") {
                kitti::single(&entries)
            } else {
                Err(
                    "neither this project's JSON nor one of KITTI's (no `P2`, no `P_rect_02`)"
                        .to_owned(),
                )
            }
        };
        numbers.map_err(malformed(path))
    }

    /// The ground as the camera sees it: what R, T and the plane give. The camera itself is not checked.
    ///
    /// # Errors
    /// Those of [`GroundPlane::new`], [`Extrinsics::world_to_camera`] and [`Ground::seen_by`].
    pub fn ground(&self) -> Result<Ground, gedepth_core::Error> {
        let [x, y, z] = self.up;
        let plane = GroundPlane::new(Direction::new(x, y, z)?, self.offset)?;
        let extrinsics = Extrinsics::world_to_camera(self.r, self.t)?;
        Ground::seen_by(&extrinsics, &plane)
    }
}

/// A calibrated camera over its ground, checked.
#[derive(Clone, Debug)]
pub struct Calibration {
    path: PathBuf,
    size: Option<Size>,
    k: [[f64; 3]; 3],
    distortion: Distortion,
    ground: Ground,
}

impl Calibration {
    /// Reads a calibration file: [`Numbers::read`], checked.
    pub fn read(path: &Path) -> Result<Self, Error> {
        Self::new(path, &Numbers::read(path)?)
    }

    /// Checks the numbers; `path` names them in errors.
    pub fn new(path: &Path, numbers: &Numbers) -> Result<Self, Error> {
        Self::checked(path, numbers).map_err(|reason| Error::Calibration {
            path: path.to_owned(),
            reason,
        })
    }

    fn checked(path: &Path, numbers: &Numbers) -> Result<Self, gedepth_core::Error> {
        let calibration = Self {
            path: path.to_owned(),
            size: numbers.size,
            k: numbers.k,
            distortion: numbers.distortion,
            ground: numbers.ground()?,
        };
        // Where the file has no size the numbers are still checked, against any.
        calibration.camera_of(numbers.size.unwrap_or((1, 1)))?;
        Ok(calibration)
    }

    /// The camera for a picture of `picture` pixels.
    pub fn camera(&self, picture: Size) -> Result<Camera, Error> {
        if let Some(expected) = self.size.filter(|&size| size != picture) {
            return Err(Error::PictureSize {
                actual: picture,
                expected,
            });
        }
        self.camera_of(picture)
            .map_err(|reason| Error::Calibration {
                path: self.path.clone(),
                reason,
            })
    }

    fn camera_of(&self, (width, height): Size) -> Result<Camera, gedepth_core::Error> {
        Camera::new(
            Intrinsics::from_matrix(ImageSize::new(width, height)?, self.k)?,
            self.distortion,
        )
    }

    /// Width and height of the pictures in pixels, where the file says so.
    pub fn size(&self) -> Option<Size> {
        self.size
    }

    /// Whether both are the same camera over the same ground, whichever files they came from.
    pub fn same_camera(&self, other: &Self) -> bool {
        self.size == other.size
            && self.k == other.k
            && self.distortion == other.distortion
            && self.ground == other.ground
    }

    /// The ground as the camera sees it.
    pub fn ground(&self) -> &Ground {
        &self.ground
    }

    /// The file it came from.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

fn read_text(path: &Path) -> Result<String, Error> {
    let read = || {
        let mut text = String::new();
        let file = std::fs::File::open(path)?;
        if file.take(MAX_FILE_BYTES + 1).read_to_string(&mut text)? as u64 > MAX_FILE_BYTES {
            return Err(std::io::Error::other("larger than 1 MiB, no calibration"));
        }
        Ok(text)
    };
    read().map_err(|reason| Error::CalibrationRead {
        path: path.to_owned(),
        reason,
    })
}
