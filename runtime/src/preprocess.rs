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
        let bytes = u128::from(width) * u128::from(height) * 3;
        (bytes > 0 && rgb.len() as u128 == bytes).then_some(Self {
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
        Self::choose(model.contract(), model.fixed_size(), picture, asked)
    }

    fn choose(
        contract: &Contract,
        fixed: Option<Size>,
        picture: Size,
        asked: Option<Size>,
    ) -> Result<Self, Error> {
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
        let network = match (fixed, asked) {
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

#[cfg(test)]
#[allow(clippy::expect_used)]
mod tests {
    use super::*;
    use crate::contract::GroundChannel;

    fn contract(entries: &[(&str, &str)]) -> Contract {
        let all = [
            ("gedepth.contract", "1"),
            ("gedepth.mode", "baseline"),
            ("gedepth.fusion", "graph"),
            ("gedepth.input", "input"),
            ("gedepth.channels", "blue,green,red"),
            ("gedepth.mean", "10,20,30"),
            ("gedepth.std", "2,4,8"),
            ("gedepth.size_multiple", "32"),
            ("gedepth.nominal_size", "640x192"),
            ("gedepth.residual", "depth"),
            ("gedepth.depth_range_m", "0.5,80"),
        ];
        Contract::from_metadata(all.into_iter().chain(entries.iter().copied())).expect("a contract")
    }

    fn place(
        contract: &Contract,
        picture: Size,
        fixed: Option<Size>,
        asked: Option<Size>,
    ) -> Result<Placement, Error> {
        Placement::choose(contract, fixed, picture, asked)
    }

    #[test]
    fn a_picture_of_the_networks_size_is_only_normalised() {
        let contract = contract(&[]);
        let placement = Placement {
            left: 0,
            top: 0,
            region: (32, 32),
            network: (32, 32),
        };
        let bytes: Vec<u8> = (0..32 * 32 * 3).map(|i| (i * 7 % 256) as u8).collect();
        let picture = Picture::new((32, 32), &bytes).expect("a picture");
        let mut planes = vec![0.0; 3 * 32 * 32];
        Preprocessor::new(&contract, placement)
            .fill(picture, &mut planes)
            .expect("filled");
        for (i, pixel) in bytes.chunks_exact(3).enumerate() {
            // Blue first, as the contract says; mean and deviation stay with their colours.
            let expected = [
                (f64::from(pixel[2]) - 30.0) / 8.0,
                (f64::from(pixel[1]) - 20.0) / 4.0,
                (f64::from(pixel[0]) - 10.0) / 2.0,
            ];
            for (channel, expected) in expected.into_iter().enumerate() {
                assert!((f64::from(planes[channel * 1024 + i]) - expected).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn planes_of_the_ground_are_left_alone() {
        let mut contract = contract(&[]);
        contract
            .channels
            .insert(1, Channel::Ground(GroundChannel::InverseDepth));
        let placement = Placement {
            left: 0,
            top: 0,
            region: (64, 64),
            network: (32, 32),
        };
        let bytes = vec![200; 64 * 64 * 3];
        let mut planes = vec![-7.0; 4 * 32 * 32];
        let picture = Picture::new((64, 64), &bytes).expect("a picture");
        Preprocessor::new(&contract, placement)
            .fill(picture, &mut planes)
            .expect("filled");
        assert!(planes[1024..2048].iter().all(|&x| x == -7.0));
        assert!(
            planes[..1024]
                .iter()
                .all(|&x| (x - (200.0 - 30.0) / 8.0).abs() < 1e-5)
        );
    }

    /// A picture whose brightness grows linearly stays linear, at the pixel centres that the intrinsics assume.
    #[test]
    fn resampling_keeps_pixel_centres() {
        let contract = contract(&[]);
        let placement = Placement {
            left: 64,
            top: 32,
            region: (192, 96),
            network: (64, 32),
        };
        let bytes: Vec<u8> = (0..128_u32)
            .flat_map(|v| (0..256_u32).flat_map(move |u| [u as u8, (2 * v) as u8, 0]))
            .collect();
        let picture = Picture::new((256, 128), &bytes).expect("a picture");
        let mut planes = vec![0.0; 3 * 64 * 32];
        Preprocessor::new(&contract, placement)
            .fill(picture, &mut planes)
            .expect("filled");
        for v in 2..30 {
            for u in 2..62 {
                // Where the pixel's centre was in the picture.
                let (at_u, at_v) = (
                    64.0 + (u as f32 + 0.5) * 3.0 - 0.5,
                    32.0 + (v as f32 + 0.5) * 3.0 - 0.5,
                );
                let at = v * 64 + u;
                let red = planes[2 * 2048 + at] * 2.0 + 10.0;
                let green = planes[2048 + at] * 4.0 + 20.0;
                assert!((red - at_u).abs() <= 1.0, "({u}, {v}): {red} {at_u}");
                assert!(
                    (green - 2.0 * at_v).abs() <= 1.0,
                    "({u}, {v}): {green} {at_v}"
                );
            }
        }
    }

    #[test]
    fn proportions_within_a_multiple_are_squeezed() {
        let contract = contract(&[]);
        for (picture, network) in [
            ((1242, 375), (640, 192)),
            ((1936, 1216), (640, 416)),
            ((1600, 900), (640, 352)),
            ((1, 1), (640, 640)),
        ] {
            let placement = place(&contract, picture, None, None).expect("a placement");
            assert_eq!(
                placement,
                Placement {
                    left: 0,
                    top: 0,
                    region: picture,
                    network
                }
            );
        }
    }

    #[test]
    fn other_proportions_are_cropped_to_the_bottom_centre() {
        let contract = contract(&[]);
        let tall = place(&contract, (640, 640), Some((640, 192)), None).expect("a placement");
        assert_eq!(
            tall,
            Placement {
                left: 0,
                top: 448,
                region: (640, 192),
                network: (640, 192)
            }
        );
        let wide = place(&contract, (1280, 192), None, Some((320, 192))).expect("a placement");
        assert_eq!(
            wide,
            Placement {
                left: 480,
                top: 0,
                region: (320, 192),
                network: (320, 192)
            }
        );
    }

    #[test]
    fn a_cropping_model_takes_the_bottom_centre_unscaled() {
        let contract = contract(&[("gedepth.fit", "crop")]);
        let placement =
            place(&contract, (1242, 375), Some((1216, 352)), None).expect("a placement");
        assert_eq!(
            placement,
            Placement {
                left: 13,
                top: 23,
                region: (1216, 352),
                network: (1216, 352)
            }
        );
        assert!(matches!(
            place(&contract, (1215, 375), Some((1216, 352)), None),
            Err(Error::PictureUnfit { .. })
        ));
    }

    #[test]
    fn sizes_that_the_model_does_not_take_are_refused() {
        let contract = contract(&[]);
        for (fixed, asked) in [
            (Some((640, 192)), (320, 96)),
            (None, (100, 96)),
            (None, (0, 96)),
        ] {
            let placement = place(&contract, (1242, 375), fixed, Some(asked));
            assert!(
                matches!(placement, Err(Error::NetworkSize { .. })),
                "{placement:?}"
            );
        }
    }

    #[test]
    fn a_picture_has_exactly_its_bytes() {
        assert!(Picture::new((2, 2), &[0; 12]).is_some());
        assert!(Picture::new((2, 2), &[0; 11]).is_none());
        assert!(Picture::new((2, 2), &[0; 13]).is_none());
        assert!(Picture::new((0, 2), &[]).is_none());
        assert!(Picture::new((u32::MAX, u32::MAX), &[0; 3]).is_none());
    }
}
