//! Calibrations as numbers, and read from files.

use std::ffi::c_char;
use std::path::Path;

use gedepth::gedepth_core::Ground;
use gedepth::{Calibration, Distortion, Numbers};

use crate::memory::{self, Array};
use crate::result::{Failure, GEDEPTH_UNKNOWN_CHOICE, GEDEPTH_UNUSED_NOT_ZERO, Result, guarded};

/// No distortion.
pub const GEDEPTH_PINHOLE: u32 = 1;
/// Brown-Conrady: k1, k2, p1, p2, k3, and k4, k5, k6 of the rational form or 0; OpenCV's order, ROS `plumb_bob` and
/// `rational_polynomial`.
pub const GEDEPTH_BROWN_CONRADY: u32 = 2;
/// Kannala-Brandt fisheye: k1, k2, k3, k4; OpenCV `fisheye`, ROS `equidistant`.
pub const GEDEPTH_KANNALA_BRANDT: u32 = 3;

/// A camera, where it is, and where the ground is. Pixels have integer coordinates at their centres, u right, v down:
/// u = fx x + skew y + cx, v = fy y + cy. p_camera = R p_world + T in metres, the camera's frame x right, y down, z forward,
/// the world's any; the ground is the plane n . p_world = plane_offset, n the unit vector along plane_up.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct gedepth_calibration {
    /// Columns of the pictures, 1 to 16384; gedepth_calibration_read gives 0 where the file does not say.
    pub width: u32,
    /// Rows, the same.
    pub height: u32,
    /// GEDEPTH_PINHOLE, GEDEPTH_BROWN_CONRADY or GEDEPTH_KANNALA_BRANDT.
    pub distortion: u32,
    /// 0.
    pub reserved: u32,
    /// Focal length in columns, 0.01 to 1e7.
    pub fx: f64,
    /// Focal length in rows, 0.01 to 1e7.
    pub fy: f64,
    /// Principal point, column, within +-1e6.
    pub cx: f64,
    /// Principal point, row, within +-1e6.
    pub cy: f64,
    /// Skew, pixels, within +-1e6.
    pub skew: f64,
    /// Of the distortion, each within +-1e6; those that it has not are 0.
    pub coefficients: [f64; 8],
    /// R, rows; orthonormal to 1e-3.
    pub r: [f64; 9],
    /// T, metres, each within +-1e9.
    pub t: [f64; 3],
    /// The plane's normal, of any length, pointing out of the ground.
    pub plane_up: [f64; 3],
    /// Metres, within +-1e9.
    pub plane_offset: f64,
}

impl gedepth_calibration {
    /// The same camera, checked.
    pub(crate) fn checked(&self) -> Result<Calibration> {
        if self.reserved != 0 {
            return Err(Failure::new(
                GEDEPTH_UNUSED_NOT_ZERO,
                format_args!("calibration: reserved is {}, must be 0", self.reserved),
            ));
        }
        let c = self.coefficients;
        let (distortion, used) = match self.distortion {
            GEDEPTH_PINHOLE => (Distortion::None, 0),
            GEDEPTH_BROWN_CONRADY => (Distortion::RationalPolynomial(c), 8),
            GEDEPTH_KANNALA_BRANDT => (Distortion::Equidistant([c[0], c[1], c[2], c[3]]), 4),
            unknown => {
                return Err(Failure::new(
                    GEDEPTH_UNKNOWN_CHOICE,
                    format_args!(
                        "calibration: distortion {unknown} is none of GEDEPTH_PINHOLE (1), GEDEPTH_BROWN_CONRADY (2), GEDEPTH_KANNALA_BRANDT (3)"
                    ),
                ));
            }
        };
        if let Some(index) = (used..8).find(|&index| c[index] != 0.0) {
            return Err(Failure::new(
                GEDEPTH_UNUSED_NOT_ZERO,
                format_args!(
                    "calibration: coefficient {index} is {}, but the distortion has {used}; must be 0",
                    c[index]
                ),
            ));
        }
        let numbers = self.numbers(distortion);
        Ok(Calibration::new(Path::new("calibration"), &numbers)?)
    }

    /// What R, T and the plane give.
    pub(crate) fn ground(&self) -> Result<Ground> {
        Ok(self.numbers(Distortion::None).ground()?)
    }

    fn numbers(&self, distortion: Distortion) -> Numbers {
        let r = self.r;
        Numbers {
            size: Some((self.width, self.height)),
            k: [
                [self.fx, self.skew, self.cx],
                [0.0, self.fy, self.cy],
                [0.0, 0.0, 1.0],
            ],
            distortion,
            r: [[r[0], r[1], r[2]], [r[3], r[4], r[5]], [r[6], r[7], r[8]]],
            t: self.t,
            up: self.plane_up,
            offset: self.plane_offset,
        }
    }
}

impl From<Numbers> for gedepth_calibration {
    fn from(numbers: Numbers) -> Self {
        let (width, height) = numbers.size.unwrap_or((0, 0));
        let mut coefficients = [0.0; 8];
        let (distortion, used): (_, &[f64]) = match &numbers.distortion {
            Distortion::None => (GEDEPTH_PINHOLE, &[]),
            Distortion::PlumbBob(c) => (GEDEPTH_BROWN_CONRADY, c),
            Distortion::RationalPolynomial(c) => (GEDEPTH_BROWN_CONRADY, c),
            Distortion::Equidistant(c) => (GEDEPTH_KANNALA_BRANDT, c),
        };
        coefficients[..used.len()].copy_from_slice(used);
        let ([k0, k1, _], [r0, r1, r2]) = (numbers.k, numbers.r);
        Self {
            width,
            height,
            distortion,
            reserved: 0,
            fx: k0[0],
            fy: k1[1],
            cx: k0[2],
            cy: k1[2],
            skew: k0[1],
            coefficients,
            r: [
                r0[0], r0[1], r0[2], r1[0], r1[1], r1[2], r2[0], r2[1], r2[2],
            ],
            t: numbers.t,
            plane_up: numbers.up,
            plane_offset: numbers.offset,
        }
    }
}

/// Reads a calibration file and checks it: this project's JSON, or KITTI's (object, tracking, odometry; of raw the path of
/// calib_cam_to_cam.txt, beside which calib_velo_to_cam.txt is). KITTI's do not say where the ground is: it is 1.65 m below the
/// LiDAR then, and the camera is number 2. `path` ends with a zero. Where the file has no size of
/// pictures (KITTI but raw), width and height are 0, for the caller to fill in.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gedepth_calibration_read(
    path: *const c_char,
    calibration: *mut gedepth_calibration,
) -> i32 {
    guarded(|| {
        let calibration = Array::one(calibration)?;
        // SAFETY: the crate's contract.
        let path = unsafe { memory::path(path) }?;
        let numbers = Numbers::read(path)?;
        Calibration::new(path, &numbers)?;
        // SAFETY: the crate's contract.
        unsafe { calibration.write(0, &[numbers.into()]) };
        Ok(())
    })
}
