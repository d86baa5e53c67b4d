//! What can go wrong between files and depth. Each message is one line: what, in which file, what to do.

use std::path::PathBuf;

use crate::contract::ContractError;
use crate::pixel_format::PixelFormat;

/// An error of the runtime.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The picture's file cannot be read.
    #[error("{path}: cannot read the picture: {reason}")]
    PictureRead {
        /// The picture's file.
        path: PathBuf,
        /// Why.
        reason: std::io::Error,
    },
    /// The picture's file is not a picture, is broken, or is too large.
    #[cfg(feature = "files")]
    #[error("{path}: cannot decode the picture: {reason}; give a PNG or JPEG of at most {max} x {max} pixels", max = crate::picture::MAX_SIDE)]
    PictureDecode {
        /// The picture's file.
        path: PathBuf,
        /// Why.
        reason: image::ImageError,
    },
    /// The picture is not of the size that the calibration, or the estimator, was made for.
    #[error(
        "the picture is {actual:?} (width, height), but its camera's are {expected:?}, by the calibration or by what the estimator was made for; give them unscaled and uncropped"
    )]
    PictureSize {
        /// Width and height of the picture, pixels.
        actual: (u32, u32),
        /// Width and height that it was made for.
        expected: (u32, u32),
    },
    /// A picture's bytes are not those of its size and format.
    #[error(
        "the picture of {size:?} (width, height), {format:?}, has in plane {plane} {rows} rows of {row} bytes, but {bytes} bytes with a stride of {stride} are given; the stride must be at least a row, and all rows, the last without padding, must be there"
    )]
    PictureBytes {
        /// Width and height of the picture, pixels.
        size: (u32, u32),
        /// What the bytes are to be.
        format: PixelFormat,
        /// The plane that is wrong: 0, or 1 for chroma.
        plane: usize,
        /// Rows that it has; 0 where there is no such plane.
        rows: u64,
        /// Bytes of a row.
        row: u64,
        /// How many bytes are given.
        bytes: usize,
        /// From the start of a row to the start of the next, bytes.
        stride: usize,
    },
    /// The picture cannot be brought to the network's size.
    #[error("the picture of {actual:?} (width, height) does not fit the network: {reason}")]
    PictureUnfit {
        /// Width and height of the picture, pixels.
        actual: (u32, u32),
        /// Why not, and what to do.
        reason: String,
    },
    /// The network was asked to run at a size that it does not take.
    #[error("the network cannot run at {asked:?} (width, height): {reason}")]
    NetworkSize {
        /// Width and height asked for, pixels.
        asked: (u32, u32),
        /// Which sizes it takes.
        reason: String,
    },
    /// The engine that was asked for cannot be had here.
    #[error("the engine cannot be had: {reason}")]
    Engine {
        /// Why not.
        reason: String,
    },
    /// The threads cannot be kept on these cores.
    #[error("cannot keep the threads on the cores {cores:?}: {reason}")]
    Cores {
        /// The cores asked for.
        cores: Vec<usize>,
        /// Why not.
        reason: String,
    },
    /// A calibration file cannot be read.
    #[error("{path}: cannot read the calibration: {reason}")]
    CalibrationRead {
        /// The calibration's file.
        path: PathBuf,
        /// Why.
        reason: std::io::Error,
    },
    /// A calibration file is malformed.
    #[error("{path}: not a calibration: {reason}")]
    CalibrationFormat {
        /// The calibration's file.
        path: PathBuf,
        /// What is missing or malformed.
        reason: String,
    },
    /// The numbers of a calibration are no camera over a ground.
    #[error("{path}: {reason}")]
    Calibration {
        /// The calibration's file.
        path: PathBuf,
        /// Which value is wrong, and what would be right.
        reason: gedepth_core::Error,
    },
    /// The model's file cannot be read.
    #[error("{path}: cannot read the model: {reason}")]
    ModelRead {
        /// The model's file.
        path: PathBuf,
        /// Why.
        reason: std::io::Error,
    },
    /// The model says nothing, or nonsense, about itself.
    #[error("{path}: {reason}")]
    Contract {
        /// The model's file.
        path: PathBuf,
        /// What is wrong.
        reason: ContractError,
    },
    /// The model is not ONNX, or does not do what its contract says, or tract cannot run it.
    #[error("{path}: cannot run the model: {reason}")]
    Model {
        /// The model's file.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// A data set cannot be used.
    #[error("{path}: {reason}")]
    DataSet {
        /// The folder or file.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// A model and a frame of a data set do not go together.
    #[error("{frame} with {model}: {reason}")]
    Frame {
        /// The frame's folder.
        frame: PathBuf,
        /// The model's file.
        model: PathBuf,
        /// Why.
        reason: Box<Error>,
    },
    /// An output cannot be written.
    #[error("{path}: cannot write: {reason}")]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// Why.
        reason: String,
    },
}

impl Error {
    /// The number of this kind of error; stable over all versions, never used again for something else. One number space
    /// with [`gedepth_core::Error::code`] (101 to 799), which is what a calibration's wrong number gives, and with the C
    /// interfaces (1 to 99).
    pub fn code(&self) -> u16 {
        match self {
            Error::PictureRead { .. } => 801,
            #[cfg(feature = "files")]
            Error::PictureDecode { .. } => 802,
            Error::PictureSize { .. } => 803,
            Error::PictureUnfit { .. } => 804,
            Error::NetworkSize { .. } => 805,
            Error::Cores { .. } => 806,
            Error::Engine { .. } => 807,
            Error::PictureBytes { .. } => 808,
            Error::CalibrationRead { .. } => 821,
            Error::CalibrationFormat { .. } => 822,
            Error::Calibration { reason, .. } => reason.code(),
            Error::ModelRead { .. } => 841,
            Error::Contract { .. } => 842,
            Error::Model { .. } => 843,
            Error::DataSet { .. } => 861,
            Error::Frame { reason, .. } => reason.code(),
            Error::Write { .. } => 881,
        }
    }

    /// The exit code of the command line: 3 picture, 4 calibration, 5 model, 6 output, 7 data set. (2 is a wrong
    /// call.)
    pub fn exit_code(&self) -> u8 {
        match self {
            Error::NetworkSize { .. } | Error::Cores { .. } | Error::Engine { .. } => 2,
            #[cfg(feature = "files")]
            Error::PictureDecode { .. } => 3,
            Error::PictureRead { .. }
            | Error::PictureSize { .. }
            | Error::PictureBytes { .. }
            | Error::PictureUnfit { .. } => 3,
            Error::CalibrationRead { .. }
            | Error::CalibrationFormat { .. }
            | Error::Calibration { .. } => 4,
            Error::ModelRead { .. } | Error::Contract { .. } | Error::Model { .. } => 5,
            Error::Write { .. } => 6,
            Error::DataSet { .. } => 7,
            Error::Frame { reason, .. } => reason.exit_code(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Held: never changed, never used again.
    #[test]
    fn numbers_of_the_interface() {
        let path = PathBuf::new;
        let io = || std::io::Error::other("");
        let reason = String::new;
        let size = (1, 1);
        let contract = || ContractError::Absent;
        let errors = [
            (
                801,
                Error::PictureRead {
                    path: path(),
                    reason: io(),
                },
            ),
            #[cfg(feature = "files")]
            (
                802,
                Error::PictureDecode {
                    path: path(),
                    reason: image::ImageError::IoError(io()),
                },
            ),
            (
                803,
                Error::PictureSize {
                    actual: size,
                    expected: size,
                },
            ),
            (
                804,
                Error::PictureUnfit {
                    actual: size,
                    reason: reason(),
                },
            ),
            (
                805,
                Error::NetworkSize {
                    asked: size,
                    reason: reason(),
                },
            ),
            (
                806,
                Error::Cores {
                    cores: Vec::new(),
                    reason: reason(),
                },
            ),
            (807, Error::Engine { reason: reason() }),
            (
                808,
                Error::PictureBytes {
                    size,
                    format: PixelFormat::Rgb,
                    plane: 0,
                    rows: 1,
                    row: 3,
                    bytes: 0,
                    stride: 0,
                },
            ),
            (
                821,
                Error::CalibrationRead {
                    path: path(),
                    reason: io(),
                },
            ),
            (
                822,
                Error::CalibrationFormat {
                    path: path(),
                    reason: reason(),
                },
            ),
            (
                102,
                Error::Calibration {
                    path: path(),
                    reason: gedepth_core::Error::FocalLength(0.0),
                },
            ),
            (
                841,
                Error::ModelRead {
                    path: path(),
                    reason: io(),
                },
            ),
            (
                842,
                Error::Contract {
                    path: path(),
                    reason: contract(),
                },
            ),
            (
                843,
                Error::Model {
                    path: path(),
                    reason: reason(),
                },
            ),
            (
                861,
                Error::DataSet {
                    path: path(),
                    reason: reason(),
                },
            ),
            (
                842,
                Error::Frame {
                    frame: path(),
                    model: path(),
                    reason: Box::new(Error::Contract {
                        path: path(),
                        reason: contract(),
                    }),
                },
            ),
            (
                881,
                Error::Write {
                    path: path(),
                    reason: reason(),
                },
            ),
        ];
        for (number, error) in errors {
            assert_eq!(error.code(), number, "{error:?}");
            // The message says all: who prints sources after it would say it twice.
            assert!(std::error::Error::source(&error).is_none(), "{error:?}");
        }
    }
}
