//! Numbered results. Numbers are never changed nor used again: those from 101 on are `gedepth_core::Error::code`, those
//! below belong to C interfaces.

use core::ffi::{CStr, c_char};

use gedepth_core::Error;

/// Why a call failed: a number of this file that is not 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Failure(pub(crate) i32);

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        Self(error.code().into())
    }
}

pub(crate) type Result<T> = core::result::Result<T, Failure>;

/// What goes back to C.
#[inline(always)]
pub(crate) fn number(result: Result<()>) -> i32 {
    match result {
        Ok(()) => GEDEPTH_CORE_OK,
        Err(Failure(number)) => number,
    }
}

/// Done.
pub const GEDEPTH_CORE_OK: i32 = 0;
/// A pointer that must not be null is.
pub const GEDEPTH_CORE_NULL_POINTER: i32 = 1;
/// A pointer is not aligned for its type.
pub const GEDEPTH_CORE_MISALIGNED: i32 = 2;
/// Memory that is written overlaps other memory of the same call.
pub const GEDEPTH_CORE_OVERLAP: i32 = 3;
/// An array is longer than memory.
pub const GEDEPTH_CORE_TOO_LONG: i32 = 4;
/// The camera has no lens yet.
pub const GEDEPTH_CORE_CAMERA_NOT_SET: i32 = 5;
/// The camera has no ground yet.
pub const GEDEPTH_CORE_POSE_NOT_SET: i32 = 6;
/// A number that chooses among named values is none of them.
pub const GEDEPTH_CORE_UNKNOWN_CHOICE: i32 = 7;
/// Something that is not used must be 0 and is not.
pub const GEDEPTH_CORE_UNUSED_NOT_ZERO: i32 = 8;
/// Only a camera without distortion can do this.
pub const GEDEPTH_CORE_NOT_A_PINHOLE: i32 = 9;
/// The picture does not show the vanishing line: all ground or all sky. Not a fault.
pub const GEDEPTH_CORE_NO_VANISHING_LINE: i32 = 10;
/// The camera has no ray with a depth there. Not a fault.
pub const GEDEPTH_CORE_NO_RAY: i32 = 11;
/// An argument is not finite, or a depth not positive.
pub const GEDEPTH_CORE_NOT_FINITE: i32 = 12;
/// A zero point is outside its 8-bit type.
pub const GEDEPTH_CORE_ZERO_POINT: i32 = 13;
/// A picture has no pixel, or a side longer than 65535.
pub const GEDEPTH_CORE_IMAGE_SIZE: i32 = 101;
/// Focal length.
pub const GEDEPTH_CORE_FOCAL_LENGTH: i32 = 102;
/// Principal point.
pub const GEDEPTH_CORE_PRINCIPAL_POINT: i32 = 103;
/// Skew.
pub const GEDEPTH_CORE_SKEW: i32 = 104;
/// Not used by the C interface.
pub const GEDEPTH_CORE_INTRINSIC_MATRIX: i32 = 105;
/// Distortion coefficient.
pub const GEDEPTH_CORE_DISTORTION_COEFFICIENT: i32 = 106;
/// Not used by the C interface.
pub const GEDEPTH_CORE_CROP_OUTSIDE_PICTURE: i32 = 107;
/// Not used by the C interface.
pub const GEDEPTH_CORE_BINNING: i32 = 108;
/// The plane's normal has no direction.
pub const GEDEPTH_CORE_DIRECTION_WITHOUT_LENGTH: i32 = 201;
/// R is no rotation.
pub const GEDEPTH_CORE_NOT_A_ROTATION: i32 = 202;
/// R mirrors.
pub const GEDEPTH_CORE_REFLECTION: i32 = 203;
/// Translation.
pub const GEDEPTH_CORE_TRANSLATION: i32 = 204;
/// Angle.
pub const GEDEPTH_CORE_ANGLE_NOT_FINITE: i32 = 205;
/// Offset of the ground plane.
pub const GEDEPTH_CORE_PLANE_OFFSET: i32 = 301;
/// Height over the ground.
pub const GEDEPTH_CORE_CAMERA_NOT_ABOVE_GROUND: i32 = 302;
/// Length of a table.
pub const GEDEPTH_CORE_TABLE_LENGTH: i32 = 401;
/// Not used by the C interface.
pub const GEDEPTH_CORE_TABLE_NOT_BUILT: i32 = 402;
/// One value a row would be wrong by more than the tolerance.
pub const GEDEPTH_CORE_ROLL_TOO_LARGE: i32 = 403;
/// Not reached through the C interface.
pub const GEDEPTH_CORE_GROUND_ROW: i32 = 404;
/// Number of slope classes.
pub const GEDEPTH_CORE_SLOPE_CLASS_COUNT: i32 = 501;
/// Angle of a slope class.
pub const GEDEPTH_CORE_SLOPE_ANGLE: i32 = 502;
/// Number of slope logits.
pub const GEDEPTH_CORE_SLOPE_LOGIT_COUNT: i32 = 503;
/// A slope logit is NaN or infinite.
pub const GEDEPTH_CORE_SLOPE_LOGIT_NOT_FINITE: i32 = 504;
/// Length of a head.
pub const GEDEPTH_CORE_HEAD_LENGTH: i32 = 601;
/// Channels of a head.
pub const GEDEPTH_CORE_HEAD_CHANNELS: i32 = 602;
/// A value of a head is NaN or beyond +-1e37.
pub const GEDEPTH_CORE_HEAD_NOT_FINITE: i32 = 603;
/// Scale of an 8-bit head.
pub const GEDEPTH_CORE_QUANTIZATION_SCALE: i32 = 604;
/// Depth range.
pub const GEDEPTH_CORE_DEPTH_RANGE: i32 = 605;
/// Ground limit.
pub const GEDEPTH_CORE_GROUND_LIMIT: i32 = 606;
/// Length of an output.
pub const GEDEPTH_CORE_OUTPUT_LENGTH: i32 = 607;
/// Length of the scratch memory.
pub const GEDEPTH_CORE_SCRATCH_LENGTH: i32 = 608;
/// Not used by the C interface.
pub const GEDEPTH_CORE_HEAD_SIZE: i32 = 609;
/// Not used by the C interface.
pub const GEDEPTH_CORE_DISTANCE_INTERVALS: i32 = 701;
/// Not used by the C interface.
pub const GEDEPTH_CORE_CLOUD_THRESHOLD: i32 = 702;

/// Every result and what it means.
const TEXTS: &[(i32, &CStr)] = &[
    (GEDEPTH_CORE_OK, c"done"),
    (GEDEPTH_CORE_NULL_POINTER, c"a pointer is null"),
    (GEDEPTH_CORE_MISALIGNED, c"a pointer is not aligned for its type"),
    (GEDEPTH_CORE_OVERLAP, c"memory that is written overlaps other memory of the call"),
    (GEDEPTH_CORE_TOO_LONG, c"an array reaches beyond the end of memory"),
    (GEDEPTH_CORE_CAMERA_NOT_SET, c"the camera's lens was not set"),
    (GEDEPTH_CORE_POSE_NOT_SET, c"the camera's extrinsics or mounting were not set"),
    (GEDEPTH_CORE_UNKNOWN_CHOICE, c"a choice is none of the named values"),
    (GEDEPTH_CORE_UNUSED_NOT_ZERO, c"an unused or reserved field is not 0"),
    (GEDEPTH_CORE_NOT_A_PINHOLE, c"the camera has distortion: use a table with a value a pixel"),
    (GEDEPTH_CORE_NO_VANISHING_LINE, c"the vanishing line does not cross the picture"),
    (GEDEPTH_CORE_NO_RAY, c"the camera has no forward ray at that pixel"),
    (GEDEPTH_CORE_NOT_FINITE, c"an argument is not finite, or a depth is not positive"),
    (GEDEPTH_CORE_ZERO_POINT, c"a zero point is outside the range of its 8-bit type"),
    (GEDEPTH_CORE_IMAGE_SIZE, c"picture size: each side must be 1 to 65535"),
    (GEDEPTH_CORE_FOCAL_LENGTH, c"focal length: must be 0.01 to 1e7 pixels"),
    (GEDEPTH_CORE_PRINCIPAL_POINT, c"principal point: must be within +-1e6 pixels"),
    (GEDEPTH_CORE_SKEW, c"skew: must be within +-1e6 pixels"),
    (GEDEPTH_CORE_INTRINSIC_MATRIX, c"K must be [fx s cx; 0 fy cy; 0 0 1]"),
    (GEDEPTH_CORE_DISTORTION_COEFFICIENT, c"distortion coefficient: must be within +-1e6"),
    (GEDEPTH_CORE_CROP_OUTSIDE_PICTURE, c"the crop reaches beyond the picture"),
    (GEDEPTH_CORE_BINNING, c"binning: must be at least 1 and leave a pixel"),
    (GEDEPTH_CORE_DIRECTION_WITHOUT_LENGTH, c"a vector without direction: zero, not finite, or of unrepresentable length"),
    (GEDEPTH_CORE_NOT_A_ROTATION, c"R is no rotation: R R^T differs from the identity by more than 1e-3"),
    (GEDEPTH_CORE_REFLECTION, c"R mirrors: its determinant is -1, a rotation has +1"),
    (GEDEPTH_CORE_TRANSLATION, c"translation: must be within +-1e9 m"),
    (GEDEPTH_CORE_ANGLE_NOT_FINITE, c"an angle is not finite"),
    (GEDEPTH_CORE_PLANE_OFFSET, c"ground plane offset: must be within +-1e9 m"),
    (GEDEPTH_CORE_CAMERA_NOT_ABOVE_GROUND, c"the camera's height over the ground must be 0.001 to 1e5 m; check the plane's sign (its normal points up)"),
    (GEDEPTH_CORE_TABLE_LENGTH, c"a table's memory is too short, or a finished table has another length than its size says"),
    (GEDEPTH_CORE_TABLE_NOT_BUILT, c"the table was never built"),
    (GEDEPTH_CORE_ROLL_TOO_LARGE, c"one value a row would be too wrong: the camera rolls, use another form of table"),
    (GEDEPTH_CORE_GROUND_ROW, c"the ground source gave no row of the output's width"),
    (GEDEPTH_CORE_SLOPE_CLASS_COUNT, c"slope classes: must be 1 to 64"),
    (GEDEPTH_CORE_SLOPE_ANGLE, c"slope angles must be within +-30 degrees and ascend"),
    (GEDEPTH_CORE_SLOPE_LOGIT_COUNT, c"more or fewer slope logits or channels than classes"),
    (GEDEPTH_CORE_SLOPE_LOGIT_NOT_FINITE, c"a slope logit is not finite"),
    (GEDEPTH_CORE_HEAD_LENGTH, c"a head's values do not fill its channels, rows and columns"),
    (GEDEPTH_CORE_HEAD_CHANNELS, c"a residual or attention head must have one channel"),
    (GEDEPTH_CORE_HEAD_NOT_FINITE, c"a head holds a NaN or a value beyond +-1e37"),
    (GEDEPTH_CORE_QUANTIZATION_SCALE, c"quantization scale: must be positive, and 255 of it at most 1e37"),
    (GEDEPTH_CORE_DEPTH_RANGE, c"depth range: must be 0 < min < max, finite"),
    (GEDEPTH_CORE_GROUND_LIMIT, c"ground limit: must be positive and finite"),
    (GEDEPTH_CORE_OUTPUT_LENGTH, c"an output has another length than the picture's pixels"),
    (GEDEPTH_CORE_SCRATCH_LENGTH, c"the scratch memory is too short"),
    (GEDEPTH_CORE_HEAD_SIZE, c"a head has another size than it must have"),
    (GEDEPTH_CORE_DISTANCE_INTERVALS, c"distance intervals must ascend from 0, and be the same to merge"),
    (GEDEPTH_CORE_CLOUD_THRESHOLD, c"point cloud threshold: must be positive and finite"),
];

/// All results.
pub fn all() -> impl Iterator<Item = i32> {
    TEXTS.iter().map(|(result, _)| *result)
}

/// What a result means, in English, in static memory; never null.
#[unsafe(no_mangle)]
pub extern "C" fn gedepth_core_result_text(result: i32) -> *const c_char {
    TEXTS
        .iter()
        .find(|(known, _)| *known == result)
        .map_or(c"unknown result", |(_, text)| text)
        .as_ptr()
}
