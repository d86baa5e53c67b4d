//! The `gedepth` command.
fn main() {}
