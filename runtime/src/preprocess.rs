//! From the picture to the network's input: which part of the picture, at which size, and its normalised planes.

use fast_image_resize::images::{TypedImage, TypedImageRef};
use fast_image_resize::pixels::U8x3;
use fast_image_resize::{FilterType, ResizeAlg, ResizeOptions, Resizer};

use crate::Error;
use crate::contract::{Channel, Contract, Fit};
use crate::model::{Model, Size};

/// A picture: RGB, 8 bits, row by row from the top left, without padding.
#[derive(Clone, Copy, Debug)]
pub struct Picture<'a> {
    size: Size,
    rgb: &'a [u8],
}

impl<'a> Picture<'a> {
    /// A picture over `3 * width * height` bytes; `None` if there are more or fewer, or none.
    pub fn new((width, height): Size, rgb: &'a [u8]) -> Option<Self> {
        let bytes = u64::from(width) * u64::from(height) * 3;
        (bytes > 0 && rgb.len() as u64 == bytes).then_some(Self {
            size: (width, height),
            rgb,
        })
    }

    /// Width and height, pixels.
    pub fn size(&self) -> Size {
        self.size
    }
}

impl<'a> From<&'a image::RgbImage> for Picture<'a> {
    fn from(image: &'a image::RgbImage) -> Self {
        Self {
            size: image.dimensions(),
            rgb: image.as_raw(),
        }
    }
}

/// Which part of the picture the network sees, and at which size.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Placement {
    /// First column of the region, pixels of the picture.
    pub left: u32,
    /// First row of the region, pixels of the picture.
    pub top: u32,
    /// Width and height of the region, pixels of the picture.
    pub region: Size,
    /// Width and height of the network's input, pixels.
    pub network: Size,
}

impl Placement {
    /// Places a picture of the size `picture`.
    ///
    /// The network's size is the one that its file fixes, or `asked` for, or for a model that resizes: the nominal
    /// width, and the height that keeps the picture's proportions to the nearest multiple that the model takes. The
    /// whole picture is then squeezed into it by less than one such multiple; where the proportions differ more, the
    /// bottom-centre part with the right proportions is taken.
    pub fn new(model: &Model, picture: Size, asked: Option<Size>) -> Result<Self, Error> {
        let contract = model.contract();
        let unfit = |reason| Error::PictureUnfit {
            actual: picture,
            reason,
        };
        let multiple = contract.size_multiple;
        let proportional_height = |width: u32| {
            let exact = f64::from(picture.1) * f64::from(width) / f64::from(picture.0);
            let multiples = (exact / f64::from(multiple)).round().clamp(1.0, 65536.0);
            (multiples as u32).saturating_mul(multiple)
        };
        let network = match (model.fixed_size(), asked) {
            (Some(fixed), Some(asked)) if fixed != asked => {
                return Err(Error::NetworkSize {
                    asked,
                    reason: format!("the model is fixed to {fixed:?}"),
                });
            }
            (Some(fixed), _) => fixed,
            (None, Some(asked)) => {
                if [asked.0, asked.1]
                    .iter()
                    .any(|&side| side == 0 || side % multiple != 0)
                {
                    return Err(Error::NetworkSize {
                        asked,
                        reason: format!("the model takes multiples of {multiple}"),
                    });
                }
                asked
            }
            (None, None) => match contract.fit {
                Fit::Crop => contract.nominal_size,
                Fit::Resize => (
                    contract.nominal_size.0,
                    proportional_height(contract.nominal_size.0),
                ),
            },
        };
        let region = match contract.fit {
            Fit::Crop if picture.0 < network.0 || picture.1 < network.1 => {
                return Err(unfit(format!(
                    "the model takes a crop of {network:?}; give a larger picture"
                )));
            }
            Fit::Crop => network,
            Fit::Resize if proportional_height(network.0) == network.1 => picture,
            Fit::Resize => {
                let ratio = |a: u32, b: u32, c: u32| {
                    (f64::from(a) * f64::from(b) / f64::from(c))
                        .round()
                        .max(1.0) as u32
                };
                let width = ratio(picture.1, network.0, network.1);
                if width <= picture.0 {
                    (width, picture.1)
                } else {
                    (
                        picture.0,
                        ratio(picture.0, network.1, network.0).min(picture.1),
                    )
                }
            }
        };
        Ok(Self {
            left: (picture.0 - region.0) / 2,
            top: picture.1 - region.1,
            region,
            network,
        })
    }
}

/// Resamples and normalises pictures for one network at one placement; owns the memory for it.
pub(crate) struct Preprocessor {
    options: ResizeOptions,
    resizer: Resizer,
    /// The region at the network's size.
    resized: TypedImage<'static, U8x3>,
    /// For each channel of the input: the colour's place in a pixel, the factor and the summand; `None` for the ground.
    channels: Vec<Option<(usize, f32, f32)>>,
}

impl Preprocessor {
    pub(crate) fn new(contract: &Contract, placement: Placement) -> Self {
        let (width, height) = placement.network;
        let colour = |i: usize| {
            Some((
                i,
                1.0 / contract.std[i],
                -contract.mean[i] / contract.std[i],
            ))
        };
        Self {
            // A triangle filter as wide as the reduction: no aliasing.
            options: ResizeOptions::new()
                .resize_alg(ResizeAlg::Convolution(FilterType::Bilinear))
                .use_alpha(false)
                .crop(
                    placement.left.into(),
                    placement.top.into(),
                    placement.region.0.into(),
                    placement.region.1.into(),
                ),
            resizer: Resizer::new(),
            resized: TypedImage::new(width, height),
            channels: contract
                .channels
                .iter()
                .map(|channel| match channel {
                    Channel::Red => colour(0),
                    Channel::Green => colour(1),
                    Channel::Blue => colour(2),
                    Channel::Ground(_) => None,
                })
                .collect(),
        }
    }

    /// Writes the colour planes of `input`, `[channels, height, width]`; planes of the ground are left as they are.
    pub(crate) fn fill(&mut self, picture: Picture<'_>, input: &mut [f32]) -> Result<(), Error> {
        let (width, height) = picture.size;
        let unfit = |reason: String| Error::PictureUnfit {
            actual: picture.size,
            reason,
        };
        let source = TypedImageRef::<U8x3>::from_buffer(width, height, picture.rgb)
            .map_err(|e| unfit(e.to_string()))?;
        // Typed, because the untyped call compiles every pixel format there is.
        self.resizer
            .resize_typed(&source, &mut self.resized, &self.options)
            .map_err(|e| unfit(e.to_string()))?;
        let pixels = self.resized.pixels();
        let plane_len = pixels.len();
        for (channel, plane) in self.channels.iter().zip(input.chunks_exact_mut(plane_len)) {
            if let &Some((colour, scale, shift)) = channel {
                for (value, pixel) in plane.iter_mut().zip(pixels) {
                    *value = f32::from(pixel.0[colour]) * scale + shift;
                }
            }
        }
        Ok(())
    }
}
