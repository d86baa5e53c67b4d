//! The numbers of results are held: never changed, never used again.
#![allow(clippy::unwrap_used)]

use std::collections::BTreeSet;
use std::ffi::CStr;

use gedepth_core::Error;
use gedepth_core::camera::ImageSize;
use gedepth_core::fusion::Head;
use gedepth_core_ffi::result::*;

fn text(result: i32) -> &'static str {
    // SAFETY: texts are static and end with a zero.
    unsafe { CStr::from_ptr(gedepth_core_result_text(result)) }
        .to_str()
        .unwrap()
}

#[test]
fn numbers_of_the_interface() {
    let numbers = [
        (GEDEPTH_CORE_OK, 0),
        (GEDEPTH_CORE_NULL_POINTER, 1),
        (GEDEPTH_CORE_MISALIGNED, 2),
        (GEDEPTH_CORE_OVERLAP, 3),
        (GEDEPTH_CORE_TOO_LONG, 4),
        (GEDEPTH_CORE_CAMERA_NOT_SET, 5),
        (GEDEPTH_CORE_POSE_NOT_SET, 6),
        (GEDEPTH_CORE_UNKNOWN_CHOICE, 7),
        (GEDEPTH_CORE_UNUSED_NOT_ZERO, 8),
        (GEDEPTH_CORE_NOT_A_PINHOLE, 9),
        (GEDEPTH_CORE_NO_VANISHING_LINE, 10),
        (GEDEPTH_CORE_NO_RAY, 11),
        (GEDEPTH_CORE_NOT_FINITE, 12),
        (GEDEPTH_CORE_ZERO_POINT, 13),
    ];
    for (constant, number) in numbers {
        assert_eq!(constant, number);
    }
}

/// The same numbers as the Rust enum, and all of them.
#[test]
fn numbers_of_core() {
    let size = ImageSize::new(1, 1).unwrap();
    let (x, y, z) = (0.0, 0.0, 0.0);
    let (needed, given) = (1, 1);
    let errors = [
        (
            Error::ImageSize {
                width: 0,
                height: 0,
            },
            GEDEPTH_CORE_IMAGE_SIZE,
            101,
        ),
        (Error::FocalLength(0.0), GEDEPTH_CORE_FOCAL_LENGTH, 102),
        (
            Error::PrincipalPoint(0.0),
            GEDEPTH_CORE_PRINCIPAL_POINT,
            103,
        ),
        (Error::Skew(0.0), GEDEPTH_CORE_SKEW, 104),
        (
            Error::IntrinsicMatrix {
                row: 0,
                column: 0,
                value: 0.0,
            },
            GEDEPTH_CORE_INTRINSIC_MATRIX,
            105,
        ),
        (
            Error::DistortionCoefficient {
                index: 0,
                value: 0.0,
            },
            GEDEPTH_CORE_DISTORTION_COEFFICIENT,
            106,
        ),
        (
            Error::CropOutsidePicture {
                left: 0,
                top: 0,
                width: 0,
                height: 0,
            },
            GEDEPTH_CORE_CROP_OUTSIDE_PICTURE,
            107,
        ),
        (Error::Binning(0), GEDEPTH_CORE_BINNING, 108),
        (
            Error::DirectionWithoutLength { x, y, z },
            GEDEPTH_CORE_DIRECTION_WITHOUT_LENGTH,
            201,
        ),
        (
            Error::NotARotation { deviation: 0.0 },
            GEDEPTH_CORE_NOT_A_ROTATION,
            202,
        ),
        (
            Error::Reflection { determinant: 0.0 },
            GEDEPTH_CORE_REFLECTION,
            203,
        ),
        (Error::Translation(0.0), GEDEPTH_CORE_TRANSLATION, 204),
        (
            Error::AngleNotFinite(0.0),
            GEDEPTH_CORE_ANGLE_NOT_FINITE,
            205,
        ),
        (Error::PlaneOffset(0.0), GEDEPTH_CORE_PLANE_OFFSET, 301),
        (
            Error::CameraNotAboveGround { height: 0.0 },
            GEDEPTH_CORE_CAMERA_NOT_ABOVE_GROUND,
            302,
        ),
        (
            Error::TableLength { needed, given },
            GEDEPTH_CORE_TABLE_LENGTH,
            401,
        ),
        (Error::TableNotBuilt, GEDEPTH_CORE_TABLE_NOT_BUILT, 402),
        (
            Error::RollTooLarge {
                relative_error: 0.0,
            },
            GEDEPTH_CORE_ROLL_TOO_LARGE,
            403,
        ),
        (Error::GroundRow { row: 0 }, GEDEPTH_CORE_GROUND_ROW, 404),
        (
            Error::SlopeClassCount { given, capacity: 1 },
            GEDEPTH_CORE_SLOPE_CLASS_COUNT,
            501,
        ),
        (
            Error::SlopeAngle {
                index: 0,
                degrees: 0.0,
            },
            GEDEPTH_CORE_SLOPE_ANGLE,
            502,
        ),
        (
            Error::SlopeLogitCount { classes: 1, given },
            GEDEPTH_CORE_SLOPE_LOGIT_COUNT,
            503,
        ),
        (
            Error::SlopeLogitNotFinite { index: 0 },
            GEDEPTH_CORE_SLOPE_LOGIT_NOT_FINITE,
            504,
        ),
        (
            Error::HeadLength { needed, given },
            GEDEPTH_CORE_HEAD_LENGTH,
            601,
        ),
        (
            Error::HeadChannels { given },
            GEDEPTH_CORE_HEAD_CHANNELS,
            602,
        ),
        (
            Error::HeadNotFinite(Head::Slope),
            GEDEPTH_CORE_HEAD_NOT_FINITE,
            603,
        ),
        (
            Error::QuantizationScale(0.0),
            GEDEPTH_CORE_QUANTIZATION_SCALE,
            604,
        ),
        (
            Error::DepthRange { min: 0.0, max: 0.0 },
            GEDEPTH_CORE_DEPTH_RANGE,
            605,
        ),
        (Error::GroundLimit(0.0), GEDEPTH_CORE_GROUND_LIMIT, 606),
        (
            Error::OutputLength { needed, given },
            GEDEPTH_CORE_OUTPUT_LENGTH,
            607,
        ),
        (
            Error::ScratchLength { needed, given },
            GEDEPTH_CORE_SCRATCH_LENGTH,
            608,
        ),
        (
            Error::HeadSize {
                needed: size,
                given: size,
            },
            GEDEPTH_CORE_HEAD_SIZE,
            609,
        ),
        (
            Error::DistanceIntervals {
                index: 0,
                limit: 0.0,
            },
            GEDEPTH_CORE_DISTANCE_INTERVALS,
            701,
        ),
        (
            Error::CloudThreshold(0.0),
            GEDEPTH_CORE_CLOUD_THRESHOLD,
            702,
        ),
    ];
    for (error, constant, number) in errors {
        assert_eq!(
            (i32::from(error.code()), constant),
            (number, number),
            "{error}"
        );
    }
    // All of the interface's, and these, make up all there are: nothing was forgotten here.
    assert_eq!(all().count(), 14 + errors.len());
}

#[test]
fn every_number_is_used_once_and_has_a_text_of_its_own() {
    let texts: BTreeSet<&str> = all().map(text).collect();
    assert_eq!(all().collect::<BTreeSet<_>>().len(), all().count());
    assert_eq!(texts.len(), all().count());
    for unknown in [-1, 14, 100, 703, i32::MIN, i32::MAX] {
        assert_eq!(text(unknown), "unknown result");
    }
}

#[test]
fn versions() {
    assert_eq!(gedepth_core_ffi::gedepth_core_abi_version(), 2);
    // SAFETY: static, ends with a zero.
    let version = unsafe { CStr::from_ptr(gedepth_core_ffi::gedepth_core_version()) };
    assert_eq!(version.to_str().unwrap(), env!("CARGO_PKG_VERSION"));
}
