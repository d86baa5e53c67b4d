//! The `gedepth` command.

mod command;

use std::io::Write;
use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// Metric depth from one camera picture and its calibration, on the CPU.
#[derive(Parser)]
#[command(version, arg_required_else_help = true, after_help = EXIT_CODES)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Run(command::run::Arguments),
    Eval(command::eval::Arguments),
    Bench(command::bench::Arguments),
    Inspect(command::inspect::Arguments),
}

const EXIT_CODES: &str = "\
Exit codes:
  0  done
  2  wrong call
  3  the picture cannot be used
  4  the calibration cannot be used
  5  the model cannot be used
  6  an output cannot be written
  7  the data set cannot be used";

fn main() -> ExitCode {
    let result = match Arguments::parse().command {
        Command::Run(arguments) => command::run::run(&arguments),
        Command::Eval(arguments) => command::eval::run(&arguments),
        Command::Bench(arguments) => command::bench::run(&arguments),
        Command::Inspect(arguments) => command::inspect::run(&arguments),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // A log that is full must not change the exit code.
            let _ = writeln!(std::io::stderr(), "gedepth: {error}");
            ExitCode::from(error.exit_code())
        }
    }
}
