//! The subcommands, one file each, and what they share: what they are given, and how outputs are written.

pub(crate) mod bench;
pub(crate) mod eval;
pub(crate) mod inputs;
pub(crate) mod inspect;
pub(crate) mod output;
pub(crate) mod run;

/// Parses `WIDTHxHEIGHT`.
fn size(text: &str) -> Result<(u32, u32), String> {
    text.split_once('x')
        .and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)))
        .ok_or_else(|| "expected WIDTHxHEIGHT, for example 640x192".to_owned())
}
