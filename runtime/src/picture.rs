//! Picture files: RGB, 8 bits, row by row from the top left.

use std::fs::File;
use std::io::{self, BufRead, BufReader, ErrorKind, Read, Seek};
use std::path::Path;

use image::{DynamicImage, ImageFormat, ImageReader, Limits, RgbImage};

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
    let file = File::open(path).map_err(|reason| Error::PictureRead {
        path: path.to_owned(),
        reason,
    })?;
    let mut limits = Limits::no_limits();
    limits.max_image_width = Some(MAX_SIDE);
    limits.max_image_height = Some(MAX_SIDE);
    limits.max_alloc = Some(MAX_MEMORY);
    let opened = || {
        let mut reader = ImageReader::new(BufReader::new(file)).with_guessed_format()?;
        if reader.format() == Some(ImageFormat::Jpeg) {
            let mut file = reader.into_inner();
            find_end_of_jpeg(&mut file)?;
            file.rewind()?;
            reader = ImageReader::with_format(file, ImageFormat::Jpeg);
        }
        reader.limits(limits);
        Ok(reader)
    };
    opened()
        .map_err(image::ImageError::IoError)
        .and_then(ImageReader::decode)
        .map_err(|reason| Error::PictureDecode {
            path: path.to_owned(),
            reason,
        })
}

/// Reads a JPEG file up to its end-of-image marker. What is missing of one that was cut off the decoder makes up, without a word.
fn find_end_of_jpeg(file: &mut impl BufRead) -> io::Result<()> {
    let mut find = || loop {
        file.skip_until(0xFF)?;
        let mut marker = [0xFF];
        while marker == [0xFF] {
            file.read_exact(&mut marker)?;
        }
        match marker[0] {
            0xD9 => return Ok(()),
            // A byte of 255 among the pixels, restarts among them, the picture's start: without a length.
            0x00 | 0x01 | 0xD0..=0xD8 => {}
            _ => {
                let mut length = [0; 2];
                file.read_exact(&mut length)?;
                let rest = u64::from(u16::from_be_bytes(length)).saturating_sub(2);
                io::copy(&mut file.by_ref().take(rest), &mut io::sink())?;
            }
        }
    };
    find().map_err(|error: io::Error| match error.kind() {
        ErrorKind::UnexpectedEof => {
            io::Error::new(error.kind(), "the file ends before the picture does")
        }
        _ => error,
    })
}
