//! What the subcommands that run a network are given: a picture, its calibration, a model, and how to run it.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use clap::Args;
use gedepth::{Calibration, Engine, Error, Estimator, Model, OutputSize, Picture, picture};
use image::RgbImage;

use super::size;

#[derive(Args)]
pub(crate) struct Inputs {
    /// PNG or JPEG file, as the camera made it: unscaled and uncropped
    picture: PathBuf,
    /// Calibration: this project's JSON file; KITTI object, tracking or odometry; or KITTI raw's calib_cam_to_cam.txt,
    /// with calib_velo_to_cam.txt beside it. Of KITTI's it is camera 2, over a ground 1.65 m below the LiDAR
    #[arg(long, value_name = "FILE")]
    calibration: PathBuf,
    /// ONNX file with a gedepth contract [default: a quantized adaptive model inside the program]
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Size at which the network runs, instead of the one that the picture's proportions and the model ask for
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = size)]
    network_size: Option<(u32, u32)>,
    /// Number of threads that run the quantized layers [default: 2, or 1 on one core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=Engine::MAX_THREADS as i64))]
    threads: Option<u8>,
    /// Keep each of these threads on one core: numbers of cores, separated by commas
    #[arg(long, value_name = "CORES", value_delimiter = ',')]
    cores: Vec<usize>,
    /// Let tract run everything, to compare
    #[arg(long, conflicts_with_all = ["threads", "cores"])]
    tract: bool,
}

/// The inputs, read, and an estimator for them.
pub(crate) struct Opened {
    pub(crate) image: RgbImage,
    pub(crate) model: Model,
    pub(crate) estimator: Estimator,
    /// How long the picture took to decode.
    pub(crate) decode: Duration,
    /// How long the model took, from file to ready.
    pub(crate) prepare: Duration,
}

impl Inputs {
    /// The files that are read.
    pub(crate) fn files(&self) -> impl Iterator<Item = &PathBuf> {
        [&self.picture, &self.calibration]
            .into_iter()
            .chain(&self.model)
    }

    pub(crate) fn open(&self, output: OutputSize) -> Result<Opened, Error> {
        let clock = Instant::now();
        let image = picture::read(&self.picture)?;
        let decode = clock.elapsed();
        let calibration = Calibration::read(&self.calibration)?;
        let clock = Instant::now();
        let model = match &self.model {
            Some(path) => Model::from_file(path)?,
            None => Model::embedded()?,
        };
        let model = match (self.threads, Engine::default()) {
            _ if self.tract => model.with_engine(Engine::Tract),
            (Some(threads), Engine::Quantized { kernel, .. }) => {
                model.with_engine(Engine::Quantized {
                    kernel,
                    threads: threads.into(),
                })
            }
            _ => model,
        };
        let size = Picture::from(&image).size();
        let mut estimator = Estimator::new(&model, &calibration, size, self.network_size, output)?;
        if !self.cores.is_empty() {
            estimator.pin_threads(&self.cores)?;
        }
        Ok(Opened {
            image,
            model,
            estimator,
            decode,
            prepare: clock.elapsed(),
        })
    }
}
