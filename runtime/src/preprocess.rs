//! From the picture to the network's input: which part of the picture, at which size, and its normalised planes.

use std::sync::{Mutex, PoisonError};

use gedepth_core::table::{GroundRows, MIN_INVERSE_DEPTH, depth_from_inverse};

use crate::Error;
use crate::contract::{Channel, Contract, Fit, GroundChannel, MAX_SIDE};
use crate::engine::Entrance;
use crate::model::{MAX_PIXELS, Model, Size};
use crate::pixel_format::Picture;
use crate::resample::{Resampler, Scratch};

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
        if picture.0 == 0 || picture.1 == 0 {
            return Err(unfit("it has no pixels".to_owned()));
        }
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
        if u64::from(network.0) * u64::from(network.1) > MAX_PIXELS
            || network.0.max(network.1) > MAX_SIDE
        {
            return Err(match asked {
                Some(asked) => Error::NetworkSize {
                    asked,
                    reason: format!("more than {MAX_PIXELS} pixels, or {MAX_SIDE} along a side"),
                },
                None => unfit(format!(
                    "the network would run at {network:?}, more than {MAX_PIXELS} pixels or {MAX_SIDE} along a side; give it a size"
                )),
            });
        }
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
    resampler: Resampler,
    network: [usize; 2],
    /// For each channel of the input, where it comes from.
    channels: Vec<Source>,
    /// Room for a row of the ground.
    ground_row: Vec<f32>,
    /// What each of the network's threads resamples with.
    scratch: Vec<Mutex<Scratch>>,
}

/// Where a channel of the input comes from.
enum Source {
    /// A colour: its place in a pixel, and what each byte of it becomes.
    Colour(usize, Box<[f32; 256]>),
    /// The ground: the same for every picture, until another is set.
    Ground(GroundChannel),
}

impl Preprocessor {
    /// For pictures of the size `picture`.
    pub(crate) fn new(contract: &Contract, picture: Size, placement: &Placement) -> Self {
        let colour = |i: usize| {
            let (scale, shift) = (1.0 / contract.std[i], -contract.mean[i] / contract.std[i]);
            let mut values = Box::new([0.0; 256]);
            for (byte, value) in (0..=255_u8).zip(&mut *values) {
                *value = f32::from(byte) * scale + shift;
            }
            Source::Colour(i, values)
        };
        let source = |channel: &Channel| match channel {
            Channel::Red => colour(0),
            Channel::Green => colour(1),
            Channel::Blue => colour(2),
            Channel::Ground(form) => Source::Ground(*form),
        };
        Self {
            resampler: Resampler::new(picture, placement),
            network: [placement.network.1, placement.network.0].map(|side| side as usize),
            channels: contract.channels.iter().map(source).collect(),
            ground_row: vec![0.0; placement.network.0 as usize],
            scratch: Vec::new(),
        }
    }

    /// Writes what depends on neither picture nor ground.
    pub(crate) fn prepare(&mut self, entrance: Entrance<'_>) {
        let mut threads = 1;
        if let Entrance::Pixels(entrance) = entrance {
            for (channel, source) in self.channels.iter().enumerate() {
                if let Source::Colour(colour, values) = source {
                    let value = |byte| values[usize::from(byte)];
                    entrance.pixels.set_colour(channel, *colour, value);
                }
            }
            threads = entrance.threads();
        }
        self.scratch = (0..threads)
            .map(|_| Mutex::new(self.resampler.scratch()))
            .collect();
    }

    /// Writes the channel of the ground, if there is one; `ground` is that of the network's pixels. Allocates nothing.
    pub(crate) fn set_ground<G: GroundRows>(
        &mut self,
        contract: &Contract,
        ground: &G,
        mut entrance: Entrance<'_>,
    ) -> Result<(), gedepth_core::Error> {
        let [height, width] = self.network;
        for (channel, source) in self.channels.iter().enumerate() {
            let &Source::Ground(form) = source else {
                continue;
            };
            for (v, y) in (0..).zip(0..height) {
                ground.write_row(v, &mut self.ground_row)?;
                for value in &mut self.ground_row {
                    *value = ground_value(form, *value, contract);
                }
                match &mut entrance {
                    Entrance::Planes(planes) => planes[(channel * height + y) * width..][..width]
                        .copy_from_slice(&self.ground_row),
                    Entrance::Pixels(entrance) => {
                        let row = &self.ground_row;
                        entrance.pixels.set_constant_row(channel, y, row);
                    }
                }
            }
        }
        Ok(())
    }

    /// Writes what depends on the picture; allocates nothing. After [`Preprocessor::prepare`] and [`Preprocessor::set_ground`],
    /// for the same network.
    ///
    /// # Panics
    /// Where the picture is not of the size that this was made for.
    pub(crate) fn fill(&self, picture: Picture<'_>, entrance: Entrance<'_>) -> Result<(), String> {
        match entrance {
            Entrance::Planes(planes) => {
                let [height, width] = self.network;
                for y in 0..height {
                    self.row(picture, y, 0, |pixels| {
                        let channels = self
                            .channels
                            .iter()
                            .zip(planes.chunks_exact_mut(height * width));
                        for (source, plane) in channels {
                            if let Source::Colour(colour, values) = source {
                                let row = plane[y * width..][..width].iter_mut();
                                for (value, pixel) in row.zip(pixels) {
                                    *value = values[usize::from(pixel[*colour])];
                                }
                            }
                        }
                    });
                }
                Ok(())
            }
            Entrance::Pixels(mut pixels) => pixels.write(|thread, y, row| {
                self.row(picture, y, thread, |pixels| row.write(pixels));
            }),
        }
    }

    /// Calls `put` with the pixels of row `y` at the network's size: red, green, blue, and a byte without meaning.
    fn row(&self, picture: Picture<'_>, y: usize, thread: usize, put: impl FnOnce(&[[u8; 4]])) {
        let mut scratch = self.scratch[thread]
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        put(self.resampler.row(&picture, y, &mut scratch));
    }
}

/// What a ground channel holds where the inverse ground depth is `inverse` (1/m).
#[inline(always)]
fn ground_value(form: GroundChannel, inverse: f32, contract: &Contract) -> f32 {
    let (scale, limit) = (contract.ground_scale_m, contract.ground_limit);
    match form {
        GroundChannel::InverseDepth => (scale * inverse).max(-limit).min(limit),
        GroundChannel::Depth => {
            let z = depth_from_inverse(inverse);
            if z <= limit { z / scale } else { 0.0 }
        }
        // On the vanishing line itself there is no depth, and infinity would spoil all that a window over it makes.
        GroundChannel::DepthUnfiltered if inverse.abs() < MIN_INVERSE_DEPTH => 0.0,
        GroundChannel::DepthUnfiltered => 1.0 / inverse,
    }
}

#[cfg(test)]
#[allow(clippy::expect_used)]
mod tests {
    use gedepth_core::camera::ImageSize;
    use gedepth_core::table::GroundView;

    use super::*;
    use crate::engine::{Engine, Kernel};
    use crate::model::Network;

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

    /// A ground whose inverse depth rises by 1/1024 from pixel to pixel, from -1.
    fn ramp(pixels: usize) -> Vec<f32> {
        (0..pixels).map(|i| i as f32 / 1024.0 - 1.0).collect()
    }

    /// The ground with these inverse depths.
    fn ground(values: &[f32], network: Size) -> GroundView<'_> {
        let size = ImageSize::new(network.0, network.1).expect("a size");
        GroundView::from_values(values, size, 1.5).expect("a ground")
    }

    /// Writes a picture, over [`ramp`].
    fn fill(contract: &Contract, placement: &Placement, picture: Picture<'_>, planes: &mut [f32]) {
        let values = ramp(planes.len() / contract.channels.len());
        let ground = ground(&values, placement.network);
        let mut preprocessor = Preprocessor::new(contract, picture.size(), placement);
        preprocessor.prepare(Entrance::Planes(planes));
        preprocessor
            .set_ground(contract, &ground, Entrance::Planes(planes))
            .expect("a ground");
        preprocessor
            .fill(picture, Entrance::Planes(planes))
            .expect("filled");
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
        fill(&contract, &placement, picture, &mut planes);
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
    fn planes_of_the_ground_show_the_ground() {
        let mut contract = contract(&[]);
        contract
            .channels
            .insert(1, Channel::Ground(GroundChannel::InverseDepth));
        (contract.ground_scale_m, contract.ground_limit) = (8.0, 100.0);
        let placement = Placement {
            left: 0,
            top: 0,
            region: (64, 64),
            network: (32, 32),
        };
        let bytes = vec![200; 64 * 64 * 3];
        let mut planes = vec![-7.0; 4 * 32 * 32];
        let picture = Picture::new((64, 64), &bytes).expect("a picture");
        fill(&contract, &placement, picture, &mut planes);
        let expected: Vec<f32> = ramp(1024).iter().map(|inverse| 8.0 * inverse).collect();
        assert_eq!(planes[1024..2048], expected);
        assert!(
            planes[..1024]
                .iter()
                .all(|&x| (x - (200.0 - 30.0) / 8.0).abs() < 1e-5)
        );
    }

    /// What each form of ground channel shows of ground 5 m away, nearer than the limit, and beyond the horizon.
    #[test]
    fn ground_channels_are_what_their_forms_say() {
        let mut contract = contract(&[]);
        contract.ground_scale_m = 8.0;
        contract.ground_limit = 2.5;
        let shown = |form| [0.2, 10.0, -10.0].map(|inverse| ground_value(form, inverse, &contract));
        assert_eq!(shown(GroundChannel::InverseDepth), [8.0 / 5.0, 2.5, -2.5]);
        assert_eq!(shown(GroundChannel::Depth), [0.0, 0.1 / 8.0, 0.0]);
        assert_eq!(shown(GroundChannel::DepthUnfiltered), [5.0, 0.1, -0.1]);
        // A row of pixels may lie on the vanishing line itself.
        assert_eq!(
            ground_value(GroundChannel::DepthUnfiltered, 0.0, &contract),
            0.0
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
        fill(&contract, &placement, picture, &mut planes);
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

    /// A column of pixels at the nominal width would be more than a network is run at.
    #[test]
    fn pictures_far_too_tall_or_without_pixels_are_refused() {
        for size in [(2, 4000), (0, 0), (5, 0), (0, 5)] {
            let placement = place(&contract(&[]), size, None, None);
            assert!(
                matches!(placement, Err(Error::PictureUnfit { .. })),
                "{placement:?}"
            );
        }
    }

    #[test]
    fn sizes_that_the_model_does_not_take_are_refused() {
        let contract = contract(&[]);
        for (fixed, asked) in [
            (Some((640, 192)), (320, 96)),
            (None, (100, 96)),
            (None, (0, 96)),
            (None, (8192, 4096)),
            (None, (65568, 32)),
        ] {
            let placement = place(&contract, (1242, 375), fixed, Some(asked));
            assert!(
                matches!(placement, Err(Error::NetworkSize { .. })),
                "{placement:?}"
            );
        }
    }

    /// The tables of bytes say what QuantizeLinear makes of the normalised planes, ground included.
    #[test]
    fn pixels_enter_the_network_as_its_first_layer_would_quantize_them() {
        let engine = Engine::Quantized {
            kernel: Kernel::Portable,
            threads: 2,
        };
        let model = Model::embedded().expect("a model").with_engine(engine);
        let contract = model.contract();
        let picture_size = (70, 50);
        let placement = Placement {
            left: 3,
            top: 2,
            region: (66, 48),
            network: (64, 32),
        };
        let bytes: Vec<u8> = (0..70 * 50 * 3).map(|i| (i * i / 7 % 256) as u8).collect();
        let picture = Picture::new(picture_size, &bytes).expect("a picture");
        let values: Vec<f32> = (0..64 * 32).map(|i| i as f32 * 4e-4 - 0.4).collect();
        let ground = ground(&values, placement.network);
        let mut preprocessor = Preprocessor::new(contract, picture_size, &placement);
        let mut planes = vec![0.0; contract.channels.len() * values.len()];
        preprocessor.prepare(Entrance::Planes(&mut planes));
        preprocessor
            .set_ground(contract, &ground, Entrance::Planes(&mut planes))
            .expect("a ground");
        preprocessor
            .fill(picture, Entrance::Planes(&mut planes))
            .expect("filled");
        let outputs = ["residual", "attention", "slope"];
        let mut network = Network::new(&model, placement.network, &outputs).expect("a network");
        let heads = |network: &mut Network| -> Vec<f32> {
            network.run().expect("a run");
            let (values, _) = network.outputs();
            let head = |index| values.head(index).expect("a head").0.to_vec();
            [0, 1, 2].map(head).concat()
        };
        network
            .fill_input(|entrance| {
                assert!(matches!(entrance, Entrance::Pixels(_)));
                entrance.write_planes(&planes)
            })
            .expect("filled");
        let from_planes = heads(&mut network);
        network
            .fill_input(|entrance| {
                preprocessor.prepare(entrance);
                Ok(())
            })
            .expect("filled");
        network
            .fill_input(|entrance| {
                let set = preprocessor.set_ground(contract, &ground, entrance);
                set.map_err(|e| e.to_string())
            })
            .expect("filled");
        network
            .fill_input(|entrance| preprocessor.fill(picture, entrance))
            .expect("filled");
        assert_eq!(heads(&mut network), from_planes);
    }
}
