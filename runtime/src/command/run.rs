//! `gedepth run`: one picture and its calibration in, depth out.

use std::io::Cursor;
use std::path::PathBuf;

use clap::Args;
use gedepth::{Error, Estimate, Maps, OutputSize, Picture, StageTimes, render};
use image::{DynamicImage, ImageFormat};

use super::inputs::{Inputs, Opened};
use super::output::{check, remove, write_together};

/// The last is what a model without attention does not write.
const OUTPUTS: [&str; 4] = [
    "depth.png",
    "depth_colours.png",
    "ground.png",
    "attention.png",
];

/// Estimates the depth of one picture.
///
/// Grey, 16-bit and CMYK pictures are converted to RGB; transparency, and the orientation that a file may ask for, are ignored.
///
/// Writes into DIR: depth.png (16 bits, metres x 256, as KITTI's; every pixel has a depth, held within the model's range: sky and what is
/// farther read its end), depth_colours.png (with a scale
/// bar), ground.png (depth of the ground as the network's mode sees it, in the same colours; of a model that fuses within its graph the
/// plane's) and attention.png (white where the ground is trusted; a model without that output, as a baseline, removes an older one). depth.png and attention.png have
/// the picture's size; where the model crops, or --network-size has other proportions, the crop's; the scale bar makes the
/// other two higher. Nothing is written unless everything can be. No input is written over, nor a depth.png or ground.png
/// without a depth_colours.png of an earlier run beside it, which may be a data set's.
#[derive(Args)]
#[command(after_help = super::super::EXIT_CODES)]
pub(crate) struct Arguments {
    #[command(flatten)]
    inputs: Inputs,
    /// Folder for the outputs; made if it is not there
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

pub(crate) fn run(arguments: &Arguments) -> Result<(), Error> {
    let Opened {
        image,
        model,
        mut estimator,
        decode,
        prepare,
    } = arguments.inputs.open(OutputSize::Picture)?;
    let outputs = OUTPUTS.map(|name| arguments.out.join(name));
    check(&outputs, arguments.inputs.files())?;
    refuse_measured(&outputs)?;
    let picture = Picture::from(&image);
    let Estimate {
        size,
        placement,
        times,
        ..
    } = estimator.run(picture)?;
    let maps = estimator.maps()?;
    write_together(&rendered(maps, size.0, &outputs)?)?;
    if maps.attention.is_none() {
        let [.., attention] = &outputs;
        remove(attention)?;
    }

    let contract = model.contract();
    let ((pw, ph), (nw, nh), (w, h)) = (picture.size(), placement.network, size);
    let (near, far) = range(maps.depth);
    let pixels = maps.depth.len() as f32;
    let ground = maps.ground.iter().filter(|&&z| z > 0.0).count() as f32;
    say!("picture     {pw} x {ph}")?;
    say!(
        "network     {nw} x {nh}, {}, {}",
        contract.mode,
        contract.network
    )?;
    match placement.region == picture.size() {
        true => say!("depth       {w} x {h}, {near:.2} to {far:.2} m"),
        false => say!(
            "depth       {w} x {h} from column {}, row {} on, {near:.2} to {far:.2} m",
            placement.left,
            placement.top
        ),
    }?;
    say!(
        "ground      seen by {:.1} % of the pixels within {} m, from {:.2} m on",
        100.0 * ground / pixels,
        contract.depth_range.max(),
        range(maps.ground).0,
    )?;
    let StageTimes {
        preprocess,
        network,
        fusion,
    } = times;
    for (stage, time, note) in [
        ("decode", decode, ""),
        (
            "prepare",
            prepare,
            "  once per camera: plan of the network, ground table",
        ),
        ("preprocess", preprocess, ""),
        ("network", network, ""),
        ("fusion", fusion, ""),
    ] {
        say!("{stage:<10} {:>7.1} ms{note}", time.as_secs_f64() * 1e3)?;
    }
    say!("written to  {}", arguments.out.display())?;
    Ok(())
}

/// Least and greatest of the positive numbers; 0 where there are none.
fn range(metres: &[f32]) -> (f32, f32) {
    let measured = || metres.iter().copied().filter(|&z| z > 0.0);
    (
        measured().reduce(f32::min).unwrap_or(0.0),
        measured().reduce(f32::max).unwrap_or(0.0),
    )
}

/// A data set's frame has a depth.png and a ground.png, measured, and not by this program, which leaves depth_colours.png beside them.
fn refuse_measured([depth, colours, ground, _]: &[PathBuf; 4]) -> Result<(), Error> {
    match [depth, ground].into_iter().find(|path| path.is_file()) {
        Some(path) if !colours.exists() => Err(Error::Write {
            path: path.clone(),
            reason: "it is there, and no depth_colours.png of an earlier run beside it; choose another folder, or remove it if it \
                     is not measured"
                .to_owned(),
        }),
        _ => Ok(()),
    }
}

/// The outputs as encoded files: path and bytes.
fn rendered(
    maps: Maps<'_>,
    width: u32,
    paths: &[PathBuf; 4],
) -> Result<Vec<(PathBuf, Vec<u8>)>, Error> {
    let map = |values| render::Map { width, values };
    let pictures: [Option<DynamicImage>; 4] = [
        Some(render::depth_16bit(map(maps.depth)).into()),
        Some(render::depth_colours(map(maps.depth)).into()),
        Some(render::depth_colours(map(maps.ground)).into()),
        maps.attention
            .map(|attention| render::attention(map(attention)).into()),
    ];
    let made = pictures.into_iter().zip(paths);
    made.filter_map(|(picture, path)| picture.map(|picture| (picture, path)))
        .map(|(picture, path)| {
            let mut bytes = Cursor::new(Vec::new());
            picture
                .write_to(&mut bytes, ImageFormat::Png)
                .map_err(|e| Error::Write {
                    path: path.clone(),
                    reason: e.to_string(),
                })?;
            Ok((path.clone(), bytes.into_inner()))
        })
        .collect()
}
