//! Picture files: RGB, 8 bits, row by row from the top left.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use image::{DynamicImage, ImageReader, Limits, RgbImage};

use crate::Error;

/// Longest side that is accepted, pixels.
pub const MAX_SIDE: u32 = crate::estimator::MAX_SIDE;
/// Greatest memory that decoding may take, bytes.
const MAX_MEMORY: u64 = 1 << 30;

/// Reads a PNG or JPEG picture. Its orientation tag is not applied: a calibration is for the stored pixels.
pub fn read(path: &Path) -> Result<RgbImage, Error> {
    Ok(read_any(path)?.into_rgb8())
}

/// Reads a PNG or JPEG file with the pixels that it has.
pub(crate) fn read_any(path: &Path) -> Result<DynamicImage, Error> {
    let file = File::open(path).map_err(|source| Error::PictureRead {
        path: path.to_owned(),
        source,
    })?;
    let mut limits = Limits::no_limits();
    limits.max_image_width = Some(MAX_SIDE);
    limits.max_image_height = Some(MAX_SIDE);
    limits.max_alloc = Some(MAX_MEMORY);
    let mut reader = ImageReader::new(BufReader::new(file));
    reader.limits(limits);
    reader
        .with_guessed_format()
        .map_err(image::ImageError::IoError)
        .and_then(ImageReader::decode)
        .map_err(|source| Error::PictureDecode {
            path: path.to_owned(),
            source,
        })
}
