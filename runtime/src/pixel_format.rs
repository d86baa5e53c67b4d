//! Pictures as cameras give them: which bytes are a pixel, where rows begin, and what luma and chroma are in red, green, blue.

use crate::Error;
use crate::model::Size;

/// Rows of bytes, from the top.
#[derive(Clone, Copy, Debug, Default)]
pub struct Plane<'a> {
    /// All of them. What lies between a row's end and the next row's start is not read.
    pub bytes: &'a [u8],
    /// Bytes from the start of a row to the start of the next.
    pub stride: usize,
}

/// Which bytes are a pixel; every value has 8 bits. In brackets, the name that V4L2 has for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PixelFormat {
    /// Red, green, blue (RGB3).
    Rgb,
    /// Blue, green, red (BGR3).
    Bgr,
    /// Red, green, blue, and a byte that is not read (RGBX32, RGBA32).
    Rgbx,
    /// Blue, green, red, and a byte that is not read (XBGR32, ABGR32).
    Bgrx,
    /// One grey value (GREY).
    Grey,
    /// Two pixels in four bytes: luma, Cb, luma, Cr (YUYV).
    Yuyv(Yuv),
    /// Two pixels in four bytes: Cb, luma, Cr, luma (UYVY).
    Uyvy(Yuv),
    /// A plane of luma, then one of Cb, Cr with a pair for every two by two pixels (NV12).
    Nv12(Yuv),
}

/// What luma and chroma are in red, green, blue. Chroma is taken to lie in the middle of the pixels that share it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Yuv {
    /// ITU-R BT.601, luma 16 to 235, chroma 16 to 240.
    Bt601Limited,
    /// ITU-R BT.601, 0 to 255 (JFIF).
    Bt601Full,
    /// ITU-R BT.709, luma 16 to 235, chroma 16 to 240.
    Bt709Limited,
    /// ITU-R BT.709, 0 to 255.
    Bt709Full,
}

impl PixelFormat {
    /// Bytes of a row, and number of rows, of each plane of a picture of this size; zeros where there is no second plane.
    pub fn planes(self, (width, height): Size) -> [(u64, u64); 2] {
        let (width, height) = (u64::from(width), u64::from(height));
        let pairs = width.div_ceil(2);
        match self {
            Self::Rgb | Self::Bgr => [(3 * width, height), (0, 0)],
            Self::Rgbx | Self::Bgrx => [(4 * width, height), (0, 0)],
            Self::Grey => [(width, height), (0, 0)],
            Self::Yuyv(_) | Self::Uyvy(_) => [(4 * pairs, height), (0, 0)],
            Self::Nv12(_) => [(width, height), (2 * pairs, height.div_ceil(2))],
        }
    }

    /// Bytes of the first plane that two neighbouring pixels take.
    pub(crate) fn pair_bytes(self) -> usize {
        match self {
            Self::Rgb | Self::Bgr => 6,
            Self::Rgbx | Self::Bgrx => 8,
            Self::Grey | Self::Nv12(_) => 2,
            Self::Yuyv(_) | Self::Uyvy(_) => 4,
        }
    }

    /// Whether a pixel is three values of the first plane, one after the other.
    pub(crate) fn is_triple(self) -> bool {
        matches!(self, Self::Rgb | Self::Bgr)
    }

    /// Three values for each pixel, from two pixels' values in the first plane and, where there is a second, in that.
    #[inline(always)]
    pub(crate) fn triples(self, first: &[i16], second: &[i16], triples: &mut [i16]) {
        let pairs = triples.as_chunks_mut::<6>().0;
        let (twos, chroma) = (first.as_chunks::<2>().0, second.as_chunks::<2>().0);
        let fours = first.as_chunks::<4>().0;
        match self {
            // As they are already.
            Self::Rgb | Self::Bgr => {}
            Self::Rgbx | Self::Bgrx => {
                for (pair, &[a, b, c, _, d, e, f, _]) in pairs.iter_mut().zip(first.as_chunks().0) {
                    *pair = [a, b, c, d, e, f];
                }
            }
            Self::Grey => {
                for (pair, &[a, b]) in pairs.iter_mut().zip(twos) {
                    *pair = [a, a, a, b, b, b];
                }
            }
            Self::Yuyv(_) => {
                for (pair, &[a, u, b, v]) in pairs.iter_mut().zip(fours) {
                    *pair = [a, u, v, b, u, v];
                }
            }
            Self::Uyvy(_) => {
                for (pair, &[u, a, v, b]) in pairs.iter_mut().zip(fours) {
                    *pair = [a, u, v, b, u, v];
                }
            }
            Self::Nv12(_) => {
                for (pair, (&[a, b], &[u, v])) in pairs.iter_mut().zip(twos.iter().zip(chroma)) {
                    *pair = [a, u, v, b, u, v];
                }
            }
        }
    }

    /// Makes a format's three values red, green, blue; the fourth byte is without meaning.
    #[inline(always)]
    pub(crate) fn colours(self, pixels: &mut [[u8; 4]]) {
        match self {
            Self::Rgb | Self::Rgbx | Self::Grey => {}
            Self::Bgr | Self::Bgrx => {
                for pixel in pixels {
                    *pixel = (u32::from_be_bytes(*pixel) >> 8).to_le_bytes();
                }
            }
            Self::Yuyv(yuv) | Self::Uyvy(yuv) | Self::Nv12(yuv) => yuv.colours(pixels),
        }
    }
}

/// Fraction bits of the factors between luma, chroma and colours.
const COLOUR_BITS: u32 = 14;

impl Yuv {
    /// Red, green, blue from luma, Cb, Cr: rounded (halves up), held within 0 to 255.
    #[inline(always)]
    fn colours(self, pixels: &mut [[u8; 4]]) {
        let (kr, kb) = match self {
            Self::Bt601Limited | Self::Bt601Full => (0.299, 0.114),
            Self::Bt709Limited | Self::Bt709Full => (0.2126, 0.0722),
        };
        let (black, luma, chroma) = match self {
            Self::Bt601Limited | Self::Bt709Limited => (16, 255.0 / 219.0, 255.0 / 224.0),
            Self::Bt601Full | Self::Bt709Full => (0, 1.0, 1.0),
        };
        let fixed = |factor: f64| (factor * f64::from(1 << COLOUR_BITS)).round() as i32;
        let (of_cr, of_cb) = (2.0 * (1.0 - kr) * chroma, 2.0 * (1.0 - kb) * chroma);
        let green = [of_cb * kb, of_cr * kr].map(|factor| fixed(factor / (1.0 - kr - kb)));
        let (luma, red, blue) = (fixed(luma), fixed(of_cr), fixed(of_cb));
        let convert = |bytes: u32| {
            let value = |place: u32| (bytes >> (8 * place) & 0xFF) as i32;
            let (cb, cr) = (value(1) - 128, value(2) - 128);
            let y = luma * (value(0) - black) + (1 << (COLOUR_BITS - 1));
            let byte = |sum: i32| (sum >> COLOUR_BITS).clamp(0, 255) as u32;
            let red = byte(y + red * cr);
            let green = byte(y - green[0] * cb - green[1] * cr);
            let blue = byte(y + blue * cb);
            red | green << 8 | blue << 16
        };
        // As one number a pixel: only so does it vectorize.
        for pixel in pixels {
            *pixel = convert(u32::from_le_bytes(*pixel)).to_le_bytes();
        }
    }
}

/// A picture: 8 bits a value, row by row from the top left.
#[derive(Clone, Copy, Debug)]
pub struct Picture<'a> {
    size: Size,
    format: PixelFormat,
    planes: [Plane<'a>; 2],
}

impl<'a> Picture<'a> {
    /// A picture over `3 * width * height` bytes: red, green, blue, without padding.
    ///
    /// # Errors
    /// [`Error::PictureBytes`] where there are fewer, or more, as of four bytes a pixel, or none.
    pub fn new(size: Size, rgb: &'a [u8]) -> Result<Self, Error> {
        let [(row, rows), _] = PixelFormat::Rgb.planes(size);
        let plane = Plane {
            bytes: rgb,
            stride: usize::try_from(row).unwrap_or(usize::MAX),
        };
        match rgb.len() as u128 > u128::from(row) * u128::from(rows) {
            true => Err(Self::unlike(size, PixelFormat::Rgb, 0, plane)),
            false => Self::with_format(size, PixelFormat::Rgb, &[plane]),
        }
    }

    /// A picture of any format, without a copy. `planes` are as many as the format has; the last row needs no padding, and bytes
    /// after it are not read.
    ///
    /// # Errors
    /// [`Error::PictureBytes`] where planes, bytes or strides are too few, or there is no pixel.
    pub fn with_format(
        size: Size,
        format: PixelFormat,
        planes: &[Plane<'a>],
    ) -> Result<Self, Error> {
        let mut own = [Plane::default(); 2];
        // A third plane is one too many of every format.
        let wanted = format.planes(size).into_iter().chain([(0, 0)]);
        for (index, (row, rows)) in wanted.enumerate() {
            let plane = planes.get(index).copied().unwrap_or_default();
            let needed =
                u128::from(rows.saturating_sub(1)) * plane.stride as u128 + u128::from(row);
            let surplus = rows == 0 && planes.len() > index;
            let short =
                (plane.stride as u128) < u128::from(row) || (plane.bytes.len() as u128) < needed;
            if surplus || short || size.0 == 0 || size.1 == 0 {
                return Err(Self::unlike(size, format, index, plane));
            }
            if let Some(own) = own.get_mut(index) {
                *own = plane;
            }
        }
        Ok(Self {
            size,
            format,
            planes: own,
        })
    }

    /// What is wrong with a plane.
    fn unlike(size: Size, format: PixelFormat, index: usize, plane: Plane<'_>) -> Error {
        let planes = format.planes(size);
        let &(row, rows) = planes.get(index).unwrap_or(&(0, 0));
        Error::PictureBytes {
            size,
            format,
            plane: index,
            rows,
            row,
            bytes: plane.bytes.len(),
            stride: plane.stride,
        }
    }

    /// Width and height, pixels.
    pub fn size(&self) -> Size {
        self.size
    }

    /// Which bytes are a pixel.
    pub fn format(&self) -> PixelFormat {
        self.format
    }

    /// The rows; the second plane is empty where the format has one alone.
    pub(crate) fn planes(&self) -> &[Plane<'a>; 2] {
        &self.planes
    }
}

#[cfg(feature = "files")]
impl<'a> From<&'a image::RgbImage> for Picture<'a> {
    fn from(image: &'a image::RgbImage) -> Self {
        Self {
            size: image.dimensions(),
            format: PixelFormat::Rgb,
            planes: [
                Plane {
                    bytes: image.as_raw(),
                    stride: 3 * image.width() as usize,
                },
                Plane::default(),
            ],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: Size = (5, 3);

    #[test]
    fn a_picture_of_three_bytes_a_pixel_has_exactly_its_bytes() {
        assert!(Picture::new((2, 2), &[0; 12]).is_ok());
        for (size, bytes) in [
            ((2, 2), 11),
            ((2, 2), 13),
            ((0, 2), 0),
            ((u32::MAX, u32::MAX), 3),
        ] {
            let made = Picture::new(size, &[0; 16][..bytes]);
            assert!(matches!(made, Err(Error::PictureBytes { plane: 0, .. })));
        }
    }

    /// As many bytes as are needed, and one fewer, of every plane of every format.
    #[test]
    fn a_picture_has_all_its_rows() {
        let yuv = Yuv::Bt601Limited;
        let bytes = [0; 100];
        for (format, row, chroma_row) in [
            (PixelFormat::Rgb, 15, 0),
            (PixelFormat::Bgr, 15, 0),
            (PixelFormat::Rgbx, 20, 0),
            (PixelFormat::Bgrx, 20, 0),
            (PixelFormat::Grey, 5, 0),
            (PixelFormat::Yuyv(yuv), 12, 0),
            (PixelFormat::Uyvy(yuv), 12, 0),
            (PixelFormat::Nv12(yuv), 5, 6),
        ] {
            for padding in [0, 4] {
                let plane = |row: usize, rows: usize, missing: usize| Plane {
                    bytes: &bytes[..(rows - 1) * (row + padding) + row - missing],
                    stride: row + padding,
                };
                let planes = |missing| match chroma_row {
                    0 => vec![plane(row, 3, missing)],
                    _ => vec![plane(row, 3, 0), plane(chroma_row, 2, missing)],
                };
                let mut good = planes(0);
                let made = Picture::with_format(SIZE, format, &good);
                assert!(made.is_ok_and(|p| p.size() == SIZE && p.format() == format));
                let last = good.len() - 1;
                let is_wrong = |planes: &[Plane<'_>], index: usize| match Picture::with_format(
                    SIZE, format, planes,
                ) {
                    Err(Error::PictureBytes { plane, .. }) => plane == index,
                    _ => false,
                };
                assert!(is_wrong(&planes(1), last), "{format:?}");
                assert!(is_wrong(&good[..last], last), "{format:?}");
                let mut narrow = good.clone();
                narrow[last].stride = [row, chroma_row][last] - 1;
                assert!(is_wrong(&narrow, last), "{format:?}");
                // One plane more than there are.
                good.push(plane(row, 3, 0));
                assert!(is_wrong(&good, last + 1), "{format:?}");
            }
        }
        let plane = Plane {
            bytes: &bytes,
            stride: 20,
        };
        for size in [(0, 3), (5, 0), (u32::MAX, u32::MAX)] {
            assert!(Picture::with_format(size, PixelFormat::Grey, &[plane]).is_err());
        }
        assert!(
            Picture::with_format(
                (1, u32::MAX),
                PixelFormat::Rgb,
                &[Plane {
                    stride: usize::MAX,
                    ..plane
                }]
            )
            .is_err()
        );
    }
}
