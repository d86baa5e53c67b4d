//! The estimator: one model bound to one calibrated camera. Everything that can be done once is done here once; then
//! each picture runs through preprocessing, network and fusion.

use std::time::{Duration, Instant};

use gedepth_core::Ground;
use gedepth_core::camera::{CameraModel, ImageSize};
use gedepth_core::fusion::{FusedMaps, Fusion, ResidualUnit};
use gedepth_core::table::write_depth;

use crate::Error;
use crate::calibration::Calibration;
use crate::contract::{Contract, ResidualForm};
use crate::engine::LayerTime;
use crate::ground::PixelGround;
use crate::heads::{fuse, outputs};
use crate::inspection::PlanKind;
use crate::model::{Model, Network, Size};
use crate::pixel_format::Picture;
use crate::plausibility::Plausibility;
use crate::preprocess::{Placement, Preprocessor};

/// Longest side of a picture, pixels.
pub(crate) const MAX_SIDE: u32 = 16384;

/// At which size the depth is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OutputSize {
    /// The picture's (the region's, where the model crops): the ground is exact in every pixel.
    Picture,
    /// The network's input: fewer pixels, faster.
    Network,
}

/// How long each stage of a run took.
#[derive(Clone, Copy, Debug, Default)]
pub struct StageTimes {
    /// Crop, resampling, normalisation.
    pub preprocess: Duration,
    /// The network.
    pub network: Duration,
    /// Upsampling of the heads, slope, fusion.
    pub fusion: Duration,
}

/// What a run gave. Maps are row-major from the top left.
#[derive(Clone, Copy, Debug)]
pub struct Estimate<'a> {
    /// Width and height of the maps.
    pub size: Size,
    /// Which part of the picture they cover.
    pub placement: Placement,
    /// Planar depth, metres, within the contract's `depth_range_m`: its end for sky and what is farther.
    pub depth: &'a [f32],
    /// How long the stages took.
    pub times: StageTimes,
}

/// The depth of a picture and what went into it, row-major from the top left.
#[derive(Clone, Copy, Debug)]
pub struct Maps<'a> {
    /// As [`Estimate::depth`].
    pub depth: &'a [f32],
    /// Ground depth as the mode sees it, metres; 0 where there is none within the model's range.
    pub ground: &'a [f32],
    /// Ground attention M, 0 to 1; `None` where the network has no such output.
    pub attention: Option<&'a [f32]>,
}

/// A model bound to a camera.
pub struct Estimator {
    contract: Contract,
    placement: Placement,
    picture: Size,
    preprocessor: Preprocessor,
    network: Network,
    fusion: Fusion,
    residual_unit: ResidualUnit,
    ground: Ground,
    /// As the network's pixels see it.
    network_ground: PixelGround,
    output: ImageSize,
    /// As the output's pixels see it.
    output_ground: PixelGround,
    /// Of each thread.
    scratch: Vec<Vec<f32>>,
    depth: Vec<f32>,
    ground_depth: Vec<f32>,
    attention: Vec<f32>,
    /// Whether `ground_depth` and `attention` are the last picture's.
    all_maps_made: bool,
}

impl Estimator {
    /// Plans the model for pictures of `picture` pixels from this camera and builds its ground table: once per
    /// calibration. `network_size` overrides the size that [`Placement::new`] chooses: multiples of the contract's `size_multiple`, at
    /// most 16384 a side and 2^24 pixels, or the size that the file is fixed to. Runs a made-up picture, so that later ones find all
    /// memory mapped.
    ///
    /// # Errors
    /// [`Error::PictureUnfit`] for a side above 16384 or proportions that the network does not take, [`Error::PictureSize`] where the
    /// calibration is of another, [`Error::NetworkSize`], [`Error::Calibration`] where the camera does not fit that size,
    /// [`Error::Engine`], [`Error::Model`] for what cannot be planned or run, or gives no finite depth.
    pub fn new(
        model: &Model,
        calibration: &Calibration,
        picture: Size,
        network_size: Option<Size>,
        output_size: OutputSize,
    ) -> Result<Self, Error> {
        if picture.0 > MAX_SIDE || picture.1 > MAX_SIDE {
            return Err(Error::PictureUnfit {
                actual: picture,
                reason: format!("at most {MAX_SIDE} x {MAX_SIDE} pixels are taken"),
            });
        }
        let contract = model.contract().clone();
        let camera = calibration.camera(picture)?;
        let placement = Placement::new(model, picture, network_size)?;
        let unfit_camera = |reason| Error::Calibration {
            path: calibration.path().to_owned(),
            reason,
        };
        let unfit_model = |e: gedepth_core::Error| Error::Model {
            path: model.path().to_owned(),
            reason: e.to_string(),
        };
        let scaled = |(width, height): Size| {
            let region = ImageSize::new(placement.region.0, placement.region.1)?;
            camera.crop_and_resize(
                placement.left,
                placement.top,
                region,
                ImageSize::new(width, height)?,
            )
        };
        let ground = *calibration.ground();

        let mut network = Network::new(model, placement.network, &outputs(&contract))?;
        let network_camera = scaled(placement.network).map_err(unfit_camera)?;
        let network_ground = PixelGround::new(&network_camera, &ground).map_err(unfit_camera)?;
        let mut preprocessor = Preprocessor::new(&contract, picture, &placement);
        network.fill_input(|entrance| {
            preprocessor.prepare(entrance);
            Ok(())
        })?;

        let residual_unit = match contract.residual_form {
            ResidualForm::Depth => ResidualUnit::Metres,
            ResidualForm::LogDepth => ResidualUnit::LogMetres,
            ResidualForm::LogMetresPerPixel => ResidualUnit::LogMetresPerPixel {
                focal_length: network_camera.focal_length() as f32,
            },
        };
        let output_camera = match output_size {
            OutputSize::Network => network_camera,
            OutputSize::Picture => scaled(placement.region).map_err(unfit_camera)?,
        };
        let output = output_camera.size();
        let pixels = output.pixels();
        let output_ground = PixelGround::new(&output_camera, &ground).map_err(unfit_camera)?;
        let farthest = contract.depth_range.max();
        let mut estimator = Self {
            placement,
            picture,
            preprocessor,
            network,
            fusion: Fusion::new(contract.upsampling, contract.depth_range, farthest)
                .map_err(unfit_model)?,
            residual_unit,
            ground,
            network_ground,
            output,
            output_ground,
            scratch: Vec::new(),
            depth: vec![0.0; pixels],
            ground_depth: vec![0.0; pixels],
            attention: vec![
                0.0;
                if contract.attention.is_some() {
                    pixels
                } else {
                    0
                }
            ],
            all_maps_made: false,
            contract,
        };
        estimator.enter_ground()?;
        // So that no real picture waits for memory to be mapped, or grows a buffer. Not of one colour, which some networks
        // divide by the deviation of.
        let bytes: Vec<u8> = (0..=u8::MAX)
            .cycle()
            .take(3 * picture.0 as usize * picture.1 as usize)
            .collect();
        estimator.run(Picture::new(picture, &bytes)?)?;
        estimator.maps()?;
        Ok(estimator)
    }

    /// Which part of the picture the network sees, and at which size.
    pub fn placement(&self) -> &Placement {
        &self.placement
    }

    /// Width and height of the maps.
    pub fn map_size(&self) -> Size {
        (self.output.width(), self.output.height())
    }

    /// The ground that the next picture is fused with: the calibration's, unless [`Self::set_ground`] gave another.
    pub fn ground(&self) -> &Ground {
        &self.ground
    }

    /// The same camera over another ground, for the next picture on: a vehicle pitches, and its springs give under a load. Depth is
    /// then, byte for byte, that of a new estimator whose calibration has this ground. Until a picture has run,
    /// [`Self::maps`] and [`Self::plausibility`] are the last one's heads over the new ground. Allocates nothing where the
    /// engine runs the whole network. Takes 2 to 3 % of the time of a picture, with a lens 7.
    ///
    /// # Errors
    /// [`Error::Model`], after a fault in the engine that a run told of.
    pub fn set_ground(&mut self, ground: &Ground) -> Result<(), Error> {
        self.ground = *ground;
        let set = [&mut self.network_ground, &mut self.output_ground].map(|g| g.set(ground));
        for set in set {
            set.map_err(|e| self.network.outputs().0.unfit(e))?;
        }
        self.enter_ground()
    }

    /// Takes the ground into the network's input, and into the map of it where that is the same for every picture.
    fn enter_ground(&mut self) -> Result<(), Error> {
        let Self {
            contract,
            preprocessor,
            network_ground,
            ..
        } = self;
        self.network.fill_input(|entrance| {
            let set = preprocessor.set_ground(contract, network_ground, entrance);
            set.map_err(|e| e.to_string())
        })?;
        if self.contract.attention.is_none() {
            let farthest = self.contract.depth_range.max();
            let made = write_depth(&self.output_ground, farthest, &mut self.ground_depth);
            made.map_err(|e| self.network.outputs().0.unfit(e))?;
        }
        self.all_maps_made = false;
        Ok(())
    }

    /// Keeps each of the engine's threads on one of `cores` (numbers as Linux has them), in order, from the first again if there are more
    /// threads: that of the caller, which is one of them, on the first. Only where the engine runs the whole network.
    ///
    /// # Errors
    /// [`Error::Cores`] where that is not so, where there are no cores, or where the system refuses one; threads may then be on others
    /// of these cores.
    pub fn pin_threads(&mut self, cores: &[usize]) -> Result<(), Error> {
        self.network.pin(cores).map_err(|reason| Error::Cores {
            cores: cores.to_vec(),
            reason,
        })
    }

    /// From now on measures how long each layer of the network takes, where the engine runs the whole of it.
    pub fn measure_layers(&mut self) {
        self.network.measure();
    }

    /// Times of the network's layers, summed over the pictures since [`Estimator::measure_layers`]; empty where tract
    /// runs the network.
    pub fn layer_times(&self) -> Vec<LayerTime> {
        self.network.times()
    }

    /// What the last picture (before the first, a made-up one) says about the calibration. Makes
    /// [`Self::maps`]. Allocates nothing.
    ///
    /// # Errors
    /// As [`Self::maps`].
    pub fn plausibility(&mut self) -> Result<Plausibility, Error> {
        self.maps()?;
        let row = self.scratch.first_mut().map_or(&mut [][..], |s| s);
        Plausibility::of(
            &self.output_ground,
            row,
            self.contract.depth_range.max(),
            &self.depth,
            self.contract.attention.is_some().then_some(&self.attention),
        )
        .map_err(|e| self.network.outputs().0.unfit(e))
    }

    /// All maps of the last picture that ran (before the first, a made-up one). Most users want the depth alone, so ground
    /// and attention are made when asked for, by fusing once more. Allocates nothing where the engine runs the whole network.
    ///
    /// # Errors
    /// [`Error::Model`] where the last run gave it.
    pub fn maps(&mut self) -> Result<Maps<'_>, Error> {
        if !self.all_maps_made {
            self.fuse(true)?;
            self.all_maps_made = true;
        }
        Ok(Maps {
            depth: &self.depth,
            ground: &self.ground_depth,
            attention: self.contract.attention.is_some().then_some(&self.attention),
        })
    }

    /// Estimates the depth of a picture from this estimator's camera. Allocates nothing where the engine runs the whole network.
    ///
    /// # Errors
    /// [`Error::PictureSize`] for a picture of another size. [`Error::Model`] where a head has a value that is not finite; or for a fault
    /// in the engine, which then every later run gives.
    pub fn run(&mut self, picture: Picture<'_>) -> Result<Estimate<'_>, Error> {
        if picture.size() != self.picture {
            return Err(Error::PictureSize {
                actual: picture.size(),
                expected: self.picture,
            });
        }
        let start = Instant::now();
        self.network
            .fill_input(|entrance| self.preprocessor.fill(picture, entrance))?;
        let filled = Instant::now();
        self.all_maps_made = false;
        self.network.run()?;
        let inferred = Instant::now();
        self.fuse(false)?;
        let fused = Instant::now();
        Ok(Estimate {
            size: self.map_size(),
            placement: self.placement,
            depth: &self.depth,
            times: StageTimes {
                preprocess: filled - start,
                network: inferred - filled,
                fusion: fused - inferred,
            },
        })
    }

    /// Who runs the network.
    pub(crate) fn plan(&self) -> PlanKind {
        self.network.kind()
    }

    /// From the network's outputs to the depth, or to all maps.
    fn fuse(&mut self, all_maps: bool) -> Result<(), Error> {
        let (heads, threads) = self.network.outputs();
        let has_attention = self.contract.attention.is_some();
        let maps = FusedMaps {
            depth: &mut self.depth,
            attention: (all_maps && has_attention).then_some(self.attention.as_mut_slice()),
            // A baseline's is the plane, made with it.
            ground: (all_maps && has_attention).then_some(self.ground_depth.as_mut_slice()),
        };
        fuse(
            &self.contract,
            (&self.fusion, self.residual_unit),
            (&heads, threads),
            &self.output_ground,
            &mut self.scratch,
            maps,
        )
    }
}
