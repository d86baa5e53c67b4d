//! `gedepth eval`: models against data sets with measured depth.

mod report;

use std::path::{Path, PathBuf};

use clap::Args;
use gedepth::evaluation::{
    CropRule, DataSet, Evaluator, Frame, GroundFrom, LEAST_DEPTH_M, Protocol, Scores,
};
use gedepth::{Calibration, Error, Estimator, Model, OutputSize, Picture};
use gedepth_core::fusion::DepthRange;
use indicatif::{ProgressBar, ProgressStyle};

use super::output::{check, write_together};
use super::size;
use report::Report;

/// Measures models on data sets.
///
/// A data set is a folder of frames, each a folder with image.png or image.jpg, depth.png (16 bits, metres x 256, 0 = not
/// measured) and calibration.json; with ground.png (0 = not ground) the ground is known, otherwise it is taken to be where
/// the measured depth is within 1.5 degrees of slope of the nominal plane. `road-scenes frames` writes such folders.
///
/// Prints tables in Markdown: errors over the picture, by distance, on the ground and off it, and the models' sizes and
/// times. Each number is the mean over pictures of that picture's metric; the JSON file also has the metrics over all
/// pixels together. Depth is made at the picture's size and clamped to the range that counts.
#[derive(Args)]
#[command(after_help = super::super::EXIT_CODES)]
pub(crate) struct Arguments {
    /// Folders of frames
    #[arg(required = true, value_name = "DATASET")]
    data_sets: Vec<PathBuf>,
    /// ONNX file with a gedepth contract; more than once to compare [default: the model inside the program]
    #[arg(long = "model", value_name = "FILE")]
    models: Vec<PathBuf>,
    /// Farthest measured depth that counts, metres
    #[arg(long, value_name = "METRES", default_value = "80", value_parser = cap)]
    cap: DepthRange,
    /// Part of the picture that counts: all, or the crop of Garg et al., as on KITTI
    #[arg(long, value_enum, default_value_t = CropRule::None)]
    crop: CropRule,
    /// Distance within which points match in F-score and IoU, metres
    #[arg(long, value_name = "METRES", default_value = "0.1", value_parser = positive)]
    cloud_threshold: f64,
    /// Takes the first N frames of each data set, by name
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    limit: Option<u32>,
    /// Size at which the networks run, instead of the one that each picture's proportions and each model ask for
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = size)]
    network_size: Option<(u32, u32)>,
    /// Writes the tables into this file, too
    #[arg(long, value_name = "FILE")]
    markdown: Option<PathBuf>,
    /// Writes all numbers into this file
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Writes each depth map to DIR/MODEL/DATASET/FRAME.f32: row by row at the picture's size, metres, f32 little-endian,
    /// 0 where the model does not look
    #[arg(long, value_name = "DIR")]
    save_depth: Option<PathBuf>,
}

fn cap(text: &str) -> Result<DepthRange, String> {
    let cap = text.parse().map_err(|_| "not a number".to_owned())?;
    DepthRange::new(LEAST_DEPTH_M, cap).map_err(|e| e.to_string())
}

fn positive(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(number) if number > 0.0 && f64::is_finite(number) => Ok(number),
        _ => Err("expected a positive number".to_owned()),
    }
}

/// A data set and how often its ground came from a mask.
struct Measured {
    set: DataSet,
    pictures: u64,
    masks: u64,
}

/// A model, its scores by data set, and its estimator for the size of picture and the camera seen last.
struct Candidate {
    name: String,
    model: Model,
    scores: Vec<Scores>,
    estimator: Option<((u32, u32), Calibration, Estimator)>,
}

impl Candidate {
    /// Most data sets have one camera, and planning a network takes longer than running it.
    fn estimator(
        &mut self,
        frame: &Frame,
        network_size: Option<(u32, u32)>,
    ) -> Result<&mut Estimator, Error> {
        let picture = frame.picture.dimensions();
        let (.., estimator) = match self.estimator.take() {
            Some(known) if known.0 == picture && known.1.same_camera(&frame.calibration) => {
                self.estimator.insert(known)
            }
            _ => {
                let calibration = frame.calibration.clone();
                let estimator = Estimator::new(
                    &self.model,
                    &calibration,
                    picture,
                    network_size,
                    OutputSize::Picture,
                )?;
                self.estimator.insert((picture, calibration, estimator))
            }
        };
        Ok(estimator)
    }
}

pub(crate) fn run(arguments: &Arguments) -> Result<(), Error> {
    let protocol = Protocol {
        range: arguments.cap,
        crop: arguments.crop,
        cloud_threshold_m: arguments.cloud_threshold,
    };
    let mut sets = data_sets(&arguments.data_sets, arguments.limit)?;
    let mut candidates = candidates(&arguments.models, sets.len())?;
    let outputs = [&arguments.markdown, &arguments.json];
    check(outputs.into_iter().flatten(), &arguments.models)?;
    let mut evaluator = Evaluator::new(protocol);
    let progress = progress(&sets);
    for (index, measured) in sets.iter_mut().enumerate() {
        for path in &measured.set.frames {
            let frame = Frame::read(path)?;
            measured.pictures += 1;
            measured.masks += u64::from(frame.ground_from == GroundFrom::Mask);
            for candidate in &mut candidates {
                let scores = score(candidate, &frame, arguments.network_size, &mut evaluator)
                    .map_err(|reason| Error::Frame {
                        frame: path.clone(),
                        model: candidate.model.path().to_owned(),
                        reason: Box::new(reason),
                    })?;
                candidate.scores[index].merge(&scores);
                if let Some(dir) = &arguments.save_depth {
                    let mut name = path.file_name().unwrap_or_default().to_owned();
                    name.push(".f32");
                    let file = dir
                        .join(&candidate.name)
                        .join(&measured.set.name)
                        .join(name);
                    let bytes = evaluator.depth().iter().flat_map(|z| z.to_le_bytes());
                    write_together(&[(file, bytes.collect())])?;
                }
            }
            progress.inc(1);
        }
    }
    progress.finish_and_clear();

    let report = Report::new(&protocol, &sets, &candidates);
    let tables = report.markdown();
    let mut files = Vec::new();
    if let Some(path) = &arguments.markdown {
        files.push((path.clone(), tables.clone().into_bytes()));
    }
    if let Some(path) = &arguments.json {
        files.push((path.clone(), report.json().into_bytes()));
    }
    // First what cannot fail: it took long.
    let said = say!("{}", tables.trim_end());
    write_together(&files)?;
    said
}

fn score(
    candidate: &mut Candidate,
    frame: &Frame,
    network_size: Option<(u32, u32)>,
    evaluator: &mut Evaluator,
) -> Result<Scores, Error> {
    let estimator = candidate.estimator(frame, network_size)?;
    let estimate = estimator.run(Picture::from(&frame.picture))?;
    evaluator.score(frame, &estimate).map_err(|e| Error::Model {
        path: candidate.model.path().to_owned(),
        reason: e.to_string(),
    })
}

fn data_sets(paths: &[PathBuf], limit: Option<u32>) -> Result<Vec<Measured>, Error> {
    let mut sets: Vec<Measured> = Vec::new();
    for path in paths {
        let mut set = DataSet::open(path)?;
        if sets.iter().any(|other| other.set.name == set.name) {
            return Err(Error::DataSet {
                path: path.clone(),
                reason: format!("another data set is called `{}`, too; rename one", set.name),
            });
        }
        set.frames
            .truncate(limit.map_or(usize::MAX, |n| n as usize));
        sets.push(Measured {
            set,
            pictures: 0,
            masks: 0,
        });
    }
    Ok(sets)
}

fn candidates(paths: &[PathBuf], sets: usize) -> Result<Vec<Candidate>, Error> {
    let mut candidates: Vec<Candidate> = Vec::new();
    let mut add = |name: String, model: Model| {
        if candidates.iter().any(|other| other.name == name) {
            return Err(Error::Model {
                path: model.path().to_owned(),
                reason: format!("another model is called `{name}`, too; rename one"),
            });
        }
        candidates.push(Candidate {
            name,
            model,
            scores: vec![Scores::default(); sets],
            estimator: None,
        });
        Ok(())
    };
    if paths.is_empty() {
        add("embedded".to_owned(), Model::embedded()?)?;
    }
    for path in paths {
        let name = stem(path);
        if name == "." || name == ".." {
            return Err(Error::Model {
                path: path.clone(),
                reason: format!("`{name}` is no name for a model; rename it"),
            });
        }
        add(name, Model::from_file(path)?)?;
    }
    Ok(candidates)
}

/// A file's name without its extension.
fn stem(path: &Path) -> String {
    path.file_stem()
        .map_or_else(String::new, |stem| stem.to_string_lossy().into_owned())
}

/// A bar on standard error, where that is a terminal.
fn progress(sets: &[Measured]) -> ProgressBar {
    let frames = sets.iter().map(|measured| measured.set.frames.len() as u64);
    let bar = ProgressBar::new(frames.sum());
    match ProgressStyle::with_template("{wide_bar} {pos} of {len} pictures, {eta} left") {
        Ok(style) => bar.with_style(style),
        Err(_) => bar,
    }
}
