//! The C interface of `gedepth`: `libgedepth.a`, `libgedepth.so` and `gedepth.h`.
//!
//! A [`gedepth_model`](model::gedepth_model) and a [`gedepth_calibration`](calibration::gedepth_calibration) make a
//! [`gedepth_camera`](camera::gedepth_camera); that takes pictures and writes depth into the caller's memory, without an
//! allocation. Every function that can fail returns a numbered result ([`result`]). The header, `include/gedepth.h`, is
//! made from this crate by cbindgen; for those who link it, `README.md` says what holds.
//!
//! # What every function checks
//!
//! Pointers for null and alignment, lengths (in **elements**, never bytes) for what is needed, written memory for overlap
//! with all other memory of the call, and every number. Nothing is written before all of it holds. No panic leaves a
//! function: one becomes [`GEDEPTH_PANICKED`](result::GEDEPTH_PANICKED).
//!
//! # Safety
//!
//! What no function can check is the caller's part, and the same for all: pointers that are not null lead to memory of
//! the given number of elements that stays valid, and is written by nobody else, until the call returns. Handles come from
//! this library and were not closed.
// Names are those of the C header.
#![allow(non_camel_case_types)]
// Said once, above.
#![allow(clippy::missing_safety_doc)]

pub mod calibration;
pub mod camera;
pub mod ground;
pub mod model;
pub mod result;
pub mod statistics;

mod memory;

use std::ffi::c_char;

/// The version of the binary interface: changes when something that was is no more, or means something else.
/// Additions do not change it.
pub const GEDEPTH_ABI_VERSION: u32 = 1;

/// The library's GEDEPTH_ABI_VERSION; compare it with the header's before the first call.
#[unsafe(no_mangle)]
pub extern "C" fn gedepth_abi_version() -> u32 {
    GEDEPTH_ABI_VERSION
}

/// The library's version, "major.minor.patch", in static memory.
#[unsafe(no_mangle)]
pub extern "C" fn gedepth_version() -> *const c_char {
    concat!(env!("CARGO_PKG_VERSION"), "\0").as_ptr().cast()
}
