//! The C interface of `gedepth-core`: `libgedepth_core.a` and `gedepth_core.h`.
//!
//! Nothing is kept between calls, nothing is allocated, nothing panics or unwinds; every function that can fail returns a
//! numbered result ([`result`]). The header, `include/gedepth_core.h`, is made from this crate by cbindgen; for those who
//! link it, `README.md` says what holds.
//!
//! # What every function checks
//!
//! Pointers for null and alignment, lengths (in **elements**, never bytes) for what is needed, written memory for overlap
//! with all other memory of the call, and every number. All of that comes before the first write: **after any result
//! but [`GEDEPTH_CORE_OK`](result::GEDEPTH_CORE_OK) no output has been touched**, scratch memory aside.
//!
//! # Safety
//!
//! What no function can check is the caller's part, and the same for all: pointers that are not null lead to memory of
//! the given number of elements that stays valid, and is written by nobody else, until the call returns.
//! [`gedepth_core_camera`](camera::gedepth_core_camera) was set by this library or zeroed.
#![cfg_attr(target_os = "none", no_std)]
// Names are those of the C header.
#![allow(non_camel_case_types)]
// Said once, above.
#![allow(clippy::missing_safety_doc)]

pub mod camera;
pub mod fusion;
pub mod result;
pub mod slope;
pub mod table;

mod memory;

use core::ffi::c_char;

/// The version of the binary interface: changes when something that was is no more, or means something else.
/// Additions do not change it.
pub const GEDEPTH_CORE_ABI_VERSION: u32 = 2;

/// The library's GEDEPTH_CORE_ABI_VERSION; compare it with the header's before the first call.
#[unsafe(no_mangle)]
pub extern "C" fn gedepth_core_abi_version() -> u32 {
    GEDEPTH_CORE_ABI_VERSION
}

/// The library's version, "major.minor.patch", in static memory.
#[unsafe(no_mangle)]
pub extern "C" fn gedepth_core_version() -> *const c_char {
    concat!(env!("CARGO_PKG_VERSION"), "\0").as_ptr().cast()
}

/// A static library must have one. Nothing in this one panics, so linkers drop it; `.ci/firmware` checks that they did.
#[cfg(all(target_os = "none", not(test)))]
#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    loop {
        core::hint::spin_loop();
    }
}
