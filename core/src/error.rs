//! Everything that can go wrong, in one numbered enum.

use core::fmt;

use crate::camera::ImageSize;

/// What was wrong, with which value, and what would be right.
///
/// [`Error::code`] numbers are part of the interface: they are never changed nor used again for something else.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Error {
    /// A picture has no pixel, or a side longer than [`crate::camera::ImageSize::MAX_SIDE`].
    ImageSize {
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// A focal length is not finite or not in [0.01, 1e7] pixels.
    FocalLength(f64),
    /// A coordinate of the principal point is not finite or beyond 1e6 pixels.
    PrincipalPoint(f64),
    /// The skew is not finite or beyond 1e6 pixels.
    Skew(f64),
    /// An entry of the intrinsic matrix that must be 0 (or 1 in the last place) is not.
    IntrinsicMatrix {
        /// Row, from 0.
        row: u8,
        /// Column, from 0.
        column: u8,
        /// What it is.
        value: f64,
    },
    /// A distortion coefficient is not finite or beyond 1e6.
    DistortionCoefficient {
        /// Its place among the coefficients, from 0.
        index: u8,
        /// What it is.
        value: f64,
    },
    /// A crop reaches beyond the picture.
    CropOutsidePicture {
        /// First column.
        left: u32,
        /// First row.
        top: u32,
        /// Columns asked for.
        width: u32,
        /// Rows asked for.
        height: u32,
    },
    /// Binning by 0, or by more pixels than a side has.
    Binning(u32),
    /// A vector that must have a direction is zero, not finite, or of unrepresentable length.
    DirectionWithoutLength {
        /// First component.
        x: f64,
        /// Second component.
        y: f64,
        /// Third component.
        z: f64,
    },
    /// A rotation matrix differs from an orthonormal one by more than 1e-3, or holds a NaN.
    NotARotation {
        /// Largest entry of `|R R^T - I|`.
        deviation: f64,
    },
    /// An orthonormal matrix that mirrors: its determinant is -1.
    Reflection {
        /// The determinant.
        determinant: f64,
    },
    /// A translation is not finite or beyond 1e9 m.
    Translation(f64),
    /// A mounting or slope angle is not finite (radians).
    AngleNotFinite(f64),
    /// The offset of a ground plane is not finite or beyond 1e9 m.
    PlaneOffset(f64),
    /// The camera is under the ground plane or on it (closer than 1 mm), or higher than 100 km.
    CameraNotAboveGround {
        /// Height over the plane, metres.
        height: f64,
    },
    /// Memory for a table is too small, or a finished table has another length than its size says.
    TableLength {
        /// Values needed.
        needed: usize,
        /// Values given.
        given: usize,
    },
    /// A table is read that was never built.
    TableNotBuilt,
    /// One value per row would be too coarse: the camera rolls.
    RollTooLarge {
        /// The relative error that it would make.
        relative_error: f64,
    },
    /// A ground source gave no row, or one of another width.
    GroundRow {
        /// The row.
        row: u32,
    },
    /// No slope class, or more than the capacity.
    SlopeClassCount {
        /// Classes given.
        given: usize,
        /// Capacity.
        capacity: usize,
    },
    /// A slope angle beyond +-30 degrees, not finite, or not above the one before it.
    SlopeAngle {
        /// Its place, from 0.
        index: usize,
        /// What it is, degrees.
        degrees: f64,
    },
    /// Another number of logits, or of channels, than slope classes.
    SlopeLogitCount {
        /// Slope classes.
        classes: usize,
        /// Logits or channels given.
        given: usize,
    },
    /// A slope logit is NaN or infinite.
    SlopeLogitNotFinite {
        /// Its class, from 0.
        index: usize,
    },
    /// A head's data does not fill its channels, rows and columns.
    HeadLength {
        /// Values needed.
        needed: usize,
        /// Values given.
        given: usize,
    },
    /// A head has another size than it must have.
    HeadSize {
        /// The size it must have.
        needed: ImageSize,
        /// Its size.
        given: ImageSize,
    },
    /// A head that must have one channel has more.
    HeadChannels {
        /// Channels given.
        given: usize,
    },
    /// A head holds a NaN or a value beyond +-1e37: differences of those would not be finite, and upsampling takes them.
    HeadNotFinite(
        /// Which head.
        Head,
    ),
    /// The scale of an 8-bit head is not positive, or so large that values would be beyond +-1e37.
    QuantizationScale(f32),
    /// A depth range that is not `0 < min < max`, all finite.
    DepthRange {
        /// Least depth, metres.
        min: f32,
        /// Largest depth, metres.
        max: f32,
    },
    /// The distance beyond which ground counts as none is not finite or not positive.
    GroundLimit(f32),
    /// An output slice has another length than the output's pixels.
    OutputLength {
        /// Values needed.
        needed: usize,
        /// Values given.
        given: usize,
    },
    /// The scratch memory is too short.
    ScratchLength {
        /// Values needed.
        needed: usize,
        /// Values given.
        given: usize,
    },
    /// Upper limits of distance intervals that do not ascend from 0, or that differ between merged accumulators.
    DistanceIntervals {
        /// The place of the limit, from 0.
        index: usize,
        /// The limit, metres.
        limit: f32,
    },
    /// The threshold for comparing point clouds is not finite or not positive.
    CloudThreshold(f64),
}

/// One of the three outputs of a network.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Head {
    /// The residual depth.
    Residual,
    /// The ground attention.
    Attention,
    /// The slope logits.
    Slope,
}

impl Error {
    /// The number of this kind of error; stable over all versions.
    pub const fn code(&self) -> u16 {
        match self {
            Self::ImageSize { .. } => 101,
            Self::FocalLength(_) => 102,
            Self::PrincipalPoint(_) => 103,
            Self::Skew(_) => 104,
            Self::IntrinsicMatrix { .. } => 105,
            Self::DistortionCoefficient { .. } => 106,
            Self::CropOutsidePicture { .. } => 107,
            Self::Binning(_) => 108,
            Self::DirectionWithoutLength { .. } => 201,
            Self::NotARotation { .. } => 202,
            Self::Reflection { .. } => 203,
            Self::Translation(_) => 204,
            Self::AngleNotFinite(_) => 205,
            Self::PlaneOffset(_) => 301,
            Self::CameraNotAboveGround { .. } => 302,
            Self::TableLength { .. } => 401,
            Self::TableNotBuilt => 402,
            Self::RollTooLarge { .. } => 403,
            Self::GroundRow { .. } => 404,
            Self::SlopeClassCount { .. } => 501,
            Self::SlopeAngle { .. } => 502,
            Self::SlopeLogitCount { .. } => 503,
            Self::SlopeLogitNotFinite { .. } => 504,
            Self::HeadLength { .. } => 601,
            Self::HeadChannels { .. } => 602,
            Self::HeadNotFinite(_) => 603,
            Self::QuantizationScale(_) => 604,
            Self::DepthRange { .. } => 605,
            Self::GroundLimit(_) => 606,
            Self::OutputLength { .. } => 607,
            Self::ScratchLength { .. } => 608,
            Self::HeadSize { .. } => 609,
            Self::DistanceIntervals { .. } => 701,
            Self::CloudThreshold(_) => 702,
        }
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::ImageSize { width, height } => write!(
                f,
                "picture size {width}x{height}: each side must be 1 to {}",
                ImageSize::MAX_SIDE
            ),
            Self::FocalLength(value) => {
                write!(f, "focal length {value} px: must be in 0.01 to 1e7")
            }
            Self::PrincipalPoint(value) => {
                write!(f, "principal point {value} px: must be within +-1e6")
            }
            Self::Skew(value) => write!(f, "skew {value} px: must be within +-1e6"),
            Self::IntrinsicMatrix { row, column, value } => write!(
                f,
                "intrinsic matrix entry [{row}][{column}] is {value}: K must be [fx s cx; 0 fy cy; 0 0 1]"
            ),
            Self::DistortionCoefficient { index, value } => write!(
                f,
                "distortion coefficient {index} is {value}: must be within +-1e6"
            ),
            Self::CropOutsidePicture {
                left,
                top,
                width,
                height,
            } => write!(
                f,
                "crop {width}x{height} at column {left}, row {top} reaches beyond the picture"
            ),
            Self::Binning(factor) => write!(
                f,
                "binning by {factor}: must be at least 1 and leave a pixel"
            ),
            Self::DirectionWithoutLength { x, y, z } => {
                write!(f, "vector ({x}, {y}, {z}) has no direction")
            }
            Self::NotARotation { deviation } => write!(
                f,
                "R is no rotation: R R^T differs from the identity by {deviation}, at most 1e-3 is accepted"
            ),
            Self::Reflection { determinant } => write!(
                f,
                "R mirrors: its determinant is {determinant}, a rotation has +1"
            ),
            Self::Translation(value) => {
                write!(f, "translation {value} m: must be within +-1e9")
            }
            Self::AngleNotFinite(value) => write!(f, "angle {value} rad is not finite"),
            Self::PlaneOffset(value) => {
                write!(f, "ground plane offset {value} m: must be within +-1e9")
            }
            Self::CameraNotAboveGround { height } => write!(
                f,
                "camera height over the ground plane is {height} m: must be 0.001 to 1e5; check the plane's sign \
                 (its normal points up)"
            ),
            Self::TableLength { needed, given } => {
                write!(f, "table memory holds {given} values, {needed} are needed")
            }
            Self::TableNotBuilt => write!(f, "the table was never built"),
            Self::RollTooLarge { relative_error } => write!(
                f,
                "one value per row would be wrong by {relative_error} of the depth: the camera rolls, use a full table"
            ),
            Self::GroundRow { row } => {
                write!(
                    f,
                    "the ground source gave no row {row} of the output's width"
                )
            }
            Self::SlopeClassCount { given, capacity } => {
                write!(f, "{given} slope classes: must be 1 to {capacity}")
            }
            Self::SlopeAngle { index, degrees } => write!(
                f,
                "slope angle {index} is {degrees} degrees: must be within +-30 and ascend"
            ),
            Self::SlopeLogitCount { classes, given } => {
                write!(f, "{given} slope logits for {classes} classes")
            }
            Self::SlopeLogitNotFinite { index } => {
                write!(f, "slope logit {index} is not finite")
            }
            Self::HeadLength { needed, given } => {
                write!(f, "head holds {given} values, its shape needs {needed}")
            }
            Self::HeadSize { needed, given } => write!(
                f,
                "head is {}x{}, must be {}x{}",
                given.width(),
                given.height(),
                needed.width(),
                needed.height()
            ),
            Self::HeadChannels { given } => {
                write!(f, "head has {given} channels, must have 1")
            }
            Self::HeadNotFinite(head) => write!(
                f,
                "the {} head holds a NaN or a value beyond +-1e37",
                match head {
                    Head::Residual => "residual",
                    Head::Attention => "attention",
                    Head::Slope => "slope",
                }
            ),
            Self::QuantizationScale(scale) => {
                write!(
                    f,
                    "quantization scale {scale}: must be positive, and 255 of it at most 1e37"
                )
            }
            Self::DepthRange { min, max } => write!(
                f,
                "depth range {min} to {max} m: must be 0 < min < max, finite"
            ),
            Self::GroundLimit(limit) => {
                write!(f, "ground limit {limit} m: must be positive and finite")
            }
            Self::OutputLength { needed, given } => {
                write!(f, "output holds {given} values, {needed} are needed")
            }
            Self::ScratchLength { needed, given } => {
                write!(f, "scratch holds {given} values, {needed} are needed")
            }
            Self::DistanceIntervals { index, limit } => write!(
                f,
                "upper limit {index} of the distance intervals is {limit} m: limits must ascend from 0, and be the same to merge"
            ),
            Self::CloudThreshold(value) => {
                write!(
                    f,
                    "point cloud threshold {value} m: must be positive and finite"
                )
            }
        }
    }
}

impl core::error::Error for Error {}
