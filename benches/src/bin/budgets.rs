//! The budgets of ground embedding, as a gate: what vanilla and adaptive may cost over the same network without any.
//!
//! ```text
//! cargo run --release -p gedepth-benches --bin budgets [-- --models FOLDER]
//! ```
//!
//! Baseline, vanilla and adaptive take turns in one process, from picture bytes to depth at 1216x352 on two threads. Each round
//! gives one ratio over the baseline's time in the same round, so that a machine that slows down slows both; what counts is
//! the median ratio and its 95 % confidence interval, over all rounds: whoever stops as soon as an interval is clear of the budget
//! is wrong more often than it says. Exit status 1: a budget is exceeded; what a noisy machine could not tell is said.
#![allow(clippy::expect_used)]

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant};

use gedepth::{
    Calibration, Engine, Estimator, Kernel, Model, Numbers, OutputSize, Picture, picture,
};

const MODES: [&str; 3] = ["baseline", "vanilla", "adaptive"];

/// What a mode may cost over the baseline, as a share of the baseline.
struct Budget {
    /// Index in [`MODES`].
    mode: usize,
    time: f64,
    parameters: f64,
}

/// The paper's Table 8: latency 179, 182, 185 ms; 0.4 % and 1.1 % more parameters.
const BUDGETS: [Budget; 2] = [
    Budget {
        mode: 1,
        time: 0.017,
        parameters: 0.004,
    },
    Budget {
        mode: 2,
        time: 0.034,
        parameters: 0.011,
    },
];
/// Of picture, network and depth.
const SIZE: (u32, u32) = (1216, 352);
const WARM_UP: usize = 3;
/// In a round.
const TURNS: usize = 12;
const ROUNDS: usize = 200;

fn main() -> ExitCode {
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fixtures");
    let models = match std::env::args().skip(1).collect::<Vec<_>>().as_slice() {
        [] => fixtures.join("models"),
        [flag, folder] if flag == "--models" => PathBuf::from(folder),
        _ => {
            eprintln!("usage: budgets [--models FOLDER]");
            return ExitCode::from(2);
        }
    };
    let engine = Engine::Quantized {
        kernel: Kernel::best(),
        threads: 2,
    };
    let models = MODES.map(|mode| {
        Model::from_file(&models.join(format!("{mode}-int8.onnx")))
            .expect("a model of each mode")
            .with_engine(engine)
    });
    let mut held = true;
    for Budget {
        mode, parameters, ..
    } in BUDGETS
    {
        let [more, all] = [mode, 0].map(|mode| models[mode].parameters() as f64);
        let excess = more / all - 1.0;
        held &= report(mode, "parameters", [excess; 3], parameters);
    }

    let (bytes, calibration) = scene(&fixtures.join("scenes/street"));
    let picture = Picture::new(SIZE, &bytes).expect("three bytes a pixel");
    let round = |number| Round::new(number, &models, &calibration, picture);
    let rounds: Vec<Round> = (0..ROUNDS).map(round).collect();
    for (mode, name) in MODES.iter().enumerate() {
        let time = median(rounds.iter().map(|round| round.times[mode]).collect());
        let pictures = rounds.len() * TURNS;
        let [preprocess, network, fusion] =
            [0, 1, 2].map(|stage| median(rounds.iter().map(|r| r.stages[mode][stage]).collect()));
        println!(
            "{name}: {time:.3} ms (preprocessing {preprocess:.3}, network {network:.3}, fusion {fusion:.3}), \
             median of {pictures} pictures"
        );
    }
    for Budget { mode, time, .. } in BUDGETS {
        held &= report(mode, "time", excess(&rounds, mode), time);
    }
    ExitCode::from(u8::from(!held))
}

/// The bottom centre of the street picture, KITTI's crop, and the camera that would take it.
fn scene(folder: &Path) -> (Vec<u8>, Calibration) {
    let image = picture::read(&folder.join("image.png")).expect("the shipped picture");
    let path = folder.join("calibration.json");
    let mut numbers = Numbers::read(&path).expect("its calibration");
    let (left, top) = ((image.width() - SIZE.0) / 2, image.height() - SIZE.1);
    numbers.size = Some(SIZE);
    numbers.k[0][2] -= f64::from(left);
    numbers.k[1][2] -= f64::from(top);
    let calibration = Calibration::new(&path, &numbers).expect("a camera");
    let rows = image.as_raw().chunks_exact(3 * image.width() as usize);
    let row = 3 * left as usize..3 * (left + SIZE.0) as usize;
    let cropped = rows.skip(top as usize).flat_map(|all| &all[row.clone()]);
    (cropped.copied().collect(), calibration)
}

/// Says on which side of the budget an excess is, from its lowest to its highest; false where that is beyond it.
fn report(mode: usize, what: &str, [low, middle, high]: [f64; 3], budget: f64) -> bool {
    let interval = if low < high {
        format!(" ({:.2} to {:.2})", 100.0 * low, 100.0 * high)
    } else {
        String::new()
    };
    println!(
        "{} {what}: {:+.2} %{interval} over the baseline, budget {:.1} %: {}",
        MODES[mode],
        100.0 * middle,
        100.0 * budget,
        if high <= budget {
            "held"
        } else if low <= budget {
            "the machine is too noisy to tell"
        } else {
            "EXCEEDED"
        },
    );
    low <= budget
}

/// Three new estimators and what they took.
struct Round {
    /// Median times, milliseconds, by mode.
    times: [f64; 3],
    /// Of preprocessing, network, fusion, by mode.
    stages: [[f64; 3]; 3],
}

impl Round {
    fn new(
        number: usize,
        models: &[Model; 3],
        calibration: &Calibration,
        picture: Picture<'_>,
    ) -> Self {
        // Where an estimator's memory happens to lie makes up to 3 % of its time. So each round has new ones, and makes them
        // in another order: memory that was freed is given again, in the same order.
        let mut estimators = [const { None }; 3];
        for mode in (0..3).map(|next| (number + next) % 3) {
            estimators[mode] = Some(
                Estimator::new(
                    &models[mode],
                    calibration,
                    SIZE,
                    Some(SIZE),
                    OutputSize::Picture,
                )
                .expect("an estimator"),
            );
        }
        let mut estimators = estimators.map(|made| made.expect("one of each mode"));
        let mut times: [Vec<f64>; 3] = Default::default();
        let mut stages: [[Vec<f64>; 3]; 3] = Default::default();
        for turn in 0..WARM_UP + TURNS {
            // Another mode begins each turn, so that none always follows the same one.
            for mode in (0..3).map(|next| (turn + next) % 3) {
                let start = Instant::now();
                let taken = estimators[mode].run(picture).expect("depth").times;
                times[mode].push(milliseconds(start.elapsed()));
                let taken = [taken.preprocess, taken.network, taken.fusion];
                for (stage, taken) in stages[mode].iter_mut().zip(taken) {
                    stage.push(milliseconds(taken));
                }
            }
        }
        let middle = |times: Vec<f64>| median(times[WARM_UP..].to_vec());
        Self {
            times: times.map(middle),
            stages: stages.map(|stages| stages.map(middle)),
        }
    }
}

/// What a mode takes over the baseline, as a share of the baseline: median of the rounds, between the ends of its 95 %
/// confidence interval (order statistics: no assumption about the distribution).
fn excess(rounds: &[Round], mode: usize) -> [f64; 3] {
    let mut ratios: Vec<f64> = rounds
        .iter()
        .map(|round| round.times[mode] / round.times[0] - 1.0)
        .collect();
    ratios.sort_by(f64::total_cmp);
    let n = ratios.len() as f64;
    let off = 1.96 * n.sqrt() / 2.0;
    [n / 2.0 - off, n / 2.0, n / 2.0 + off].map(|rank| ratios[rank.floor() as usize])
}

fn milliseconds(time: Duration) -> f64 {
    1e3 * time.as_secs_f64()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
