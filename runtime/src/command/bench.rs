//! `gedepth bench`: how long a model takes here, stage by stage.

use std::time::Duration;

use clap::Args;
use gedepth::{Error, LayerTime, OutputSize, Picture, StageTimes};

use super::inputs::Inputs;

/// Measures how long one picture takes, again and again.
///
/// Prints milliseconds of every stage: the least, the median, the 99th percentile, and that over the median.
#[derive(Args)]
#[command(after_help = super::super::EXIT_CODES)]
pub(crate) struct Arguments {
    #[command(flatten)]
    inputs: Inputs,
    /// How often the picture is run
    #[arg(long, value_name = "N", default_value_t = 500, value_parser = clap::value_parser!(u32).range(1..))]
    runs: u32,
    /// Make the depth at the network's size instead of the picture's
    #[arg(long)]
    network_output: bool,
    /// Print microseconds of preprocessing, network and fusion of every run instead
    #[arg(long)]
    raw: bool,
    /// Print how long each layer of the network takes, too
    #[arg(long, conflicts_with = "raw")]
    profile: bool,
}

pub(crate) fn run(arguments: &Arguments) -> Result<(), Error> {
    let output = match arguments.network_output {
        true => OutputSize::Network,
        false => OutputSize::Picture,
    };
    let mut opened = arguments.inputs.open(output)?;
    let picture = Picture::from(&opened.image);
    if arguments.profile {
        opened.estimator.measure_layers();
    }
    let times = (0..arguments.runs)
        .map(|_| {
            let StageTimes {
                preprocess,
                network,
                fusion,
            } = opened.estimator.run(picture)?.times;
            Ok([preprocess, network, fusion])
        })
        .collect::<Result<Vec<_>, Error>>()?;
    if arguments.raw {
        for run in times {
            let [preprocess, network, fusion] = run.map(|time| time.as_secs_f64() * 1e6);
            say!("{preprocess:.1} {network:.1} {fusion:.1}")?;
        }
        return Ok(());
    }
    let (width, height) = opened.estimator.placement().network;
    say!(
        "network {width} x {height}; prepare {:.1} ms",
        milliseconds(opened.prepare)
    )?;
    say!(
        "{:<10} {:>8} {:>8} {:>8} {:>10}",
        "ms",
        "least",
        "median",
        "p99",
        "p99/median"
    )?;
    for (stage, name) in ["preprocess", "network", "fusion"].into_iter().enumerate() {
        print(name, times.iter().map(|run| run[stage]))?;
    }
    print("all", times.iter().map(|run| run.iter().sum()))?;
    if arguments.profile && opened.estimator.layer_times().is_empty() {
        say!(
            "\ntract runs this network, alone or around islands of the engine: layers have no times"
        )?;
    } else if arguments.profile {
        print_layers(&opened.estimator.layer_times(), arguments.runs)?;
    }
    Ok(())
}

/// Mean times of the layers, what they do at least, and their throughput.
fn print_layers(layers: &[LayerTime], runs: u32) -> Result<(), Error> {
    say!(
        "\n{:>8} {:>7} {:>7} {:>7}  {:<34} {:>14}  output",
        "us",
        "MMAC",
        "MB",
        "GMAC/s",
        "operation",
        "shape"
    )?;
    for layer in layers {
        let seconds = layer.time.as_secs_f64() / f64::from(runs);
        let multiply_adds = layer.multiply_adds as f64;
        let [channels, height, width] = layer.shape;
        say!(
            "{:>8.1} {:>7.1} {:>7.3} {:>7.1}  {:<34} {:>14}  {}",
            seconds * 1e6,
            multiply_adds / 1e6,
            layer.bytes as f64 / 1e6,
            multiply_adds / seconds.max(1e-9) / 1e9,
            layer.operation,
            format!("{channels}x{height}x{width}"),
            layer.output,
        )?;
    }
    Ok(())
}

fn milliseconds(time: Duration) -> f64 {
    time.as_secs_f64() * 1e3
}

fn print(name: &str, times: impl Iterator<Item = Duration>) -> Result<(), Error> {
    let mut sorted: Vec<f64> = times.map(milliseconds).collect();
    sorted.sort_by(f64::total_cmp);
    let at = |part: f64| sorted[((sorted.len() - 1) as f64 * part).round() as usize];
    let (median, p99) = (at(0.5), at(0.99));
    say!(
        "{name:<10} {:>8.3} {median:>8.3} {p99:>8.3} {:>10.2}",
        at(0.0),
        p99 / median
    )
}
