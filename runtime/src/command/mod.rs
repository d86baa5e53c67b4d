//! The subcommands, one file each, and what they share: what they are given, and how outputs are written.

use std::io::{ErrorKind, Write, stdout};

use gedepth::Error;

/// Prints a line, as `println!`, but for readers who have seen enough (`gedepth inspect | head`): they are no error.
macro_rules! say {
    ($($line:tt)*) => { $crate::command::say(format_args!($($line)*)) };
}

pub(crate) mod bench;
pub(crate) mod eval;
pub(crate) mod inputs;
pub(crate) mod inspect;
pub(crate) mod output;
pub(crate) mod run;

fn say(line: std::fmt::Arguments<'_>) -> Result<(), Error> {
    match writeln!(stdout(), "{line}") {
        Err(e) if e.kind() != ErrorKind::BrokenPipe => Err(Error::Write {
            path: "standard output".into(),
            reason: e.to_string(),
        }),
        _ => Ok(()),
    }
}

/// Parses `WIDTHxHEIGHT`.
fn size(text: &str) -> Result<(u32, u32), String> {
    text.split_once('x')
        .and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)))
        .ok_or_else(|| "expected WIDTHxHEIGHT, for example 640x192".to_owned())
}
