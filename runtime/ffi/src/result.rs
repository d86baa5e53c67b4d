//! Numbered results, the text of the last error, and the boundary that no panic crosses.
//!
//! Numbers are never changed nor used again: those from 101 to 799 are `gedepth_core::Error::code`, those from 801 on
//! `gedepth::Error::code`, those below 100 belong to C interfaces, core's and this one.

use std::cell::UnsafeCell;
use std::ffi::{CStr, c_char};
use std::fmt::{self, Write};
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Why a call failed: a number of this file that is not 0. Its text is that of [`gedepth_last_error`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Failure(i32);

pub(crate) type Result<T> = std::result::Result<T, Failure>;

impl Failure {
    /// A failure with nothing more to say than what its number means.
    pub(crate) fn plain(number: i32) -> Self {
        match TEXTS.iter().find(|(known, _)| *known == number) {
            Some((_, text)) => Self::new(number, format_args!("{}", text.to_string_lossy())),
            None => Self::new(number, format_args!("result {number}")),
        }
    }

    /// A failure of this number; allocates nothing.
    pub(crate) fn new(number: i32, text: fmt::Arguments<'_>) -> Self {
        TEXT.with(|buffer| {
            // SAFETY: the thread's own, and no other reference to it exists: `write_fmt` below calls nothing of this
            // file, and what C holds is a pointer.
            let bytes = unsafe { &mut *buffer.get() };
            let mut text_of = Text { bytes, end: 0 };
            // It only ends early, where the buffer is full.
            let _ = text_of.write_fmt(text);
            let end = text_of.end;
            bytes[end] = 0;
        });
        Self(number)
    }
}

impl From<gedepth::Error> for Failure {
    fn from(error: gedepth::Error) -> Self {
        Self::new(error.code().into(), format_args!("{error}"))
    }
}

impl From<gedepth::gedepth_core::Error> for Failure {
    fn from(error: gedepth::gedepth_core::Error) -> Self {
        Self::new(error.code().into(), format_args!("{error}"))
    }
}

/// Longest text of an error, bytes, the closing zero included.
const TEXT_LEN: usize = 512;

thread_local! {
    // By thread rather than by handle: what fails to open has no handle, and no thread reads another's text. Without a
    // destructor and made before the program runs, so that it costs no allocation.
    static TEXT: UnsafeCell<[u8; TEXT_LEN]> = const { UnsafeCell::new([0; TEXT_LEN]) };
}

/// Writes what fits, whole characters only.
struct Text<'a> {
    bytes: &'a mut [u8; TEXT_LEN],
    end: usize,
}

impl Write for Text<'_> {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        for character in text.chars() {
            let mut encoded = [0; 4];
            let encoded = character.encode_utf8(&mut encoded).as_bytes();
            let end = self.end + encoded.len();
            if end >= TEXT_LEN {
                return Err(fmt::Error);
            }
            self.bytes[self.end..end].copy_from_slice(encoded);
            self.end = end;
        }
        Ok(())
    }
}

/// Runs the body of an exported function: a panic becomes [`GEDEPTH_PANICKED`].
pub(crate) fn guarded(body: impl FnOnce() -> Result<()>) -> i32 {
    match catch_unwind(AssertUnwindSafe(body)) {
        Ok(Ok(())) => GEDEPTH_OK,
        Ok(Err(Failure(number))) => number,
        Err(payload) => {
            // Dropping it could panic again.
            std::mem::forget(payload);
            Failure::plain(GEDEPTH_PANICKED).0
        }
    }
}

/// Done.
pub const GEDEPTH_OK: i32 = 0;
/// A pointer that must not be null is.
pub const GEDEPTH_NULL_POINTER: i32 = 1;
/// A pointer is not aligned for its type.
pub const GEDEPTH_MISALIGNED: i32 = 2;
/// Memory that is written overlaps other memory of the same call.
pub const GEDEPTH_OVERLAP: i32 = 3;
/// An array is longer than memory.
pub const GEDEPTH_TOO_LONG: i32 = 4;
/// A number that chooses among named values is none of them.
pub const GEDEPTH_UNKNOWN_CHOICE: i32 = 7;
/// Something that is not used must be 0 and is not.
pub const GEDEPTH_UNUSED_NOT_ZERO: i32 = 8;
/// The run took longer than its deadline. Its maps and its report are complete, and the next run is sound.
pub const GEDEPTH_DEADLINE: i32 = 30;
/// This processor does not have the kernel's instructions.
pub const GEDEPTH_KERNEL_NOT_SUPPORTED: i32 = 31;
/// More than 64 threads.
pub const GEDEPTH_THREADS: i32 = 32;
/// The attention is asked for, but the model has none.
pub const GEDEPTH_NO_ATTENTION: i32 = 33;
/// Another thread is using the camera. Nothing was done.
pub const GEDEPTH_BUSY: i32 = 34;
/// A fault of this library, caught. A camera that it happened in gives this ever after: close it.
pub const GEDEPTH_PANICKED: i32 = 35;
/// A picture's bytes are fewer than its size and stride need, or its stride is shorter than a row.
pub const GEDEPTH_PICTURE_LENGTH: i32 = 36;
/// A path is not UTF-8, on a system where it must be.
pub const GEDEPTH_PATH: i32 = 37;
/// The statistics would keep more than 1000000 runs.
pub const GEDEPTH_STATISTICS_LENGTH: i32 = 38;
/// A picture has no pixel, or a side longer than 65535.
pub const GEDEPTH_IMAGE_SIZE: i32 = 101;
/// Focal length.
pub const GEDEPTH_FOCAL_LENGTH: i32 = 102;
/// Principal point.
pub const GEDEPTH_PRINCIPAL_POINT: i32 = 103;
/// Skew.
pub const GEDEPTH_SKEW: i32 = 104;
/// K of a file is not [fx s cx; 0 fy cy; 0 0 1].
pub const GEDEPTH_INTRINSIC_MATRIX: i32 = 105;
/// Distortion coefficient.
pub const GEDEPTH_DISTORTION_COEFFICIENT: i32 = 106;
/// The plane's normal has no direction.
pub const GEDEPTH_DIRECTION_WITHOUT_LENGTH: i32 = 201;
/// R is no rotation.
pub const GEDEPTH_NOT_A_ROTATION: i32 = 202;
/// R mirrors.
pub const GEDEPTH_REFLECTION: i32 = 203;
/// Translation.
pub const GEDEPTH_TRANSLATION: i32 = 204;
/// An angle.
pub const GEDEPTH_ANGLE_NOT_FINITE: i32 = 205;
/// Offset of the ground plane.
pub const GEDEPTH_PLANE_OFFSET: i32 = 301;
/// Height over the ground.
pub const GEDEPTH_CAMERA_NOT_ABOVE_GROUND: i32 = 302;
/// A map is shorter than its size and stride need, or its stride is shorter than a row.
pub const GEDEPTH_OUTPUT_LENGTH: i32 = 607;
/// The picture has another size than the camera.
pub const GEDEPTH_PICTURE_SIZE: i32 = 803;
/// Pictures of this size do not fit the network, or have a side longer than 16384.
pub const GEDEPTH_PICTURE_UNFIT: i32 = 804;
/// The network does not take the size that was asked for.
pub const GEDEPTH_NETWORK_SIZE: i32 = 805;
/// The camera's threads cannot be kept on these cores.
pub const GEDEPTH_CORES: i32 = 806;
/// A calibration file cannot be read.
pub const GEDEPTH_CALIBRATION_READ: i32 = 821;
/// A calibration file is malformed.
pub const GEDEPTH_CALIBRATION_FORMAT: i32 = 822;
/// A model file cannot be read.
pub const GEDEPTH_MODEL_READ: i32 = 841;
/// A model says nothing, or nonsense, about itself.
pub const GEDEPTH_CONTRACT: i32 = 842;
/// A model is not ONNX, or does not do what it says, or cannot be run.
pub const GEDEPTH_MODEL: i32 = 843;

/// Every result and what it means.
const TEXTS: &[(i32, &CStr)] = &[
    (GEDEPTH_OK, c"done"),
    (GEDEPTH_NULL_POINTER, c"a pointer is null"),
    (GEDEPTH_MISALIGNED, c"a pointer is not aligned for its type"),
    (
        GEDEPTH_OVERLAP,
        c"memory that is written overlaps other memory of the call",
    ),
    (
        GEDEPTH_TOO_LONG,
        c"an array reaches beyond the end of memory",
    ),
    (
        GEDEPTH_UNKNOWN_CHOICE,
        c"a choice is none of the named values",
    ),
    (
        GEDEPTH_UNUSED_NOT_ZERO,
        c"an unused or reserved field is not 0",
    ),
    (
        GEDEPTH_DEADLINE,
        c"the run took longer than its deadline; its maps are complete",
    ),
    (
        GEDEPTH_KERNEL_NOT_SUPPORTED,
        c"this processor does not have the kernel's instructions",
    ),
    (GEDEPTH_THREADS, c"threads: must be at most 64"),
    (
        GEDEPTH_NO_ATTENTION,
        c"the attention is asked for, but the model has none",
    ),
    (GEDEPTH_BUSY, c"another thread is using the camera"),
    (
        GEDEPTH_PANICKED,
        c"a fault of the library: close the camera, and report it",
    ),
    (
        GEDEPTH_PICTURE_LENGTH,
        c"a picture's bytes are fewer than its size and stride need, or its stride is shorter than a row",
    ),
    (GEDEPTH_PATH, c"the path is not UTF-8"),
    (
        GEDEPTH_STATISTICS_LENGTH,
        c"statistics: must keep at most 1000000 runs",
    ),
    (
        GEDEPTH_IMAGE_SIZE,
        c"picture size: each side must be 1 to 65535",
    ),
    (
        GEDEPTH_FOCAL_LENGTH,
        c"focal length: must be 0.01 to 1e7 pixels",
    ),
    (
        GEDEPTH_PRINCIPAL_POINT,
        c"principal point: must be within +-1e6 pixels",
    ),
    (GEDEPTH_SKEW, c"skew: must be within +-1e6 pixels"),
    (
        GEDEPTH_INTRINSIC_MATRIX,
        c"K must be [fx s cx; 0 fy cy; 0 0 1]",
    ),
    (
        GEDEPTH_DISTORTION_COEFFICIENT,
        c"distortion coefficient: must be within +-1e6",
    ),
    (
        GEDEPTH_DIRECTION_WITHOUT_LENGTH,
        c"a vector without direction: zero, not finite, or of unrepresentable length",
    ),
    (
        GEDEPTH_NOT_A_ROTATION,
        c"R is no rotation: R R^T differs from the identity by more than 1e-3",
    ),
    (
        GEDEPTH_REFLECTION,
        c"R mirrors: its determinant is -1, a rotation has +1",
    ),
    (
        GEDEPTH_TRANSLATION,
        c"translation: must be within +-1e9 m",
    ),
    (GEDEPTH_ANGLE_NOT_FINITE, c"an angle is not finite"),
    (
        GEDEPTH_PLANE_OFFSET,
        c"ground plane offset: must be within +-1e9 m",
    ),
    (
        GEDEPTH_CAMERA_NOT_ABOVE_GROUND,
        c"the camera's height over the ground must be 0.001 to 1e5 m; check the plane's sign (its normal points up)",
    ),
    (
        GEDEPTH_OUTPUT_LENGTH,
        c"a map is shorter than its size and stride need, or its stride is shorter than a row",
    ),
    (
        GEDEPTH_PICTURE_SIZE,
        c"the picture has another size than the camera",
    ),
    (
        GEDEPTH_PICTURE_UNFIT,
        c"pictures of this size do not fit the network",
    ),
    (
        GEDEPTH_NETWORK_SIZE,
        c"the network does not take this size",
    ),
    (
        GEDEPTH_CORES,
        c"the threads cannot be kept on these cores",
    ),
    (
        GEDEPTH_CALIBRATION_READ,
        c"the calibration cannot be read",
    ),
    (GEDEPTH_CALIBRATION_FORMAT, c"not a calibration"),
    (GEDEPTH_MODEL_READ, c"the model cannot be read"),
    (
        GEDEPTH_CONTRACT,
        c"the model's metadata are no contract",
    ),
    (GEDEPTH_MODEL, c"the model cannot be run"),
];

/// All results.
pub fn all() -> impl Iterator<Item = i32> {
    TEXTS.iter().map(|(result, _)| *result)
}

/// What a result means, in English, in static memory; never null.
#[unsafe(no_mangle)]
pub extern "C" fn gedepth_result_text(result: i32) -> *const c_char {
    TEXTS
        .iter()
        .find(|(known, _)| *known == result)
        .map_or(c"unknown result", |(_, text)| text)
        .as_ptr()
}

/// What was wrong with which value in the last call of this thread that failed, in English, UTF-8, at most 511 bytes;
/// empty if none did. Never null. The memory is the thread's: valid until its next call that fails, or its end.
#[unsafe(no_mangle)]
pub extern "C" fn gedepth_last_error() -> *const c_char {
    TEXT.with(|text| text.get().cast())
}

#[cfg(test)]
#[allow(clippy::panic)]
mod tests {
    use super::*;

    fn last() -> String {
        // SAFETY: ends with a zero, and nothing fails meanwhile.
        unsafe { CStr::from_ptr(gedepth_last_error()) }
            .to_string_lossy()
            .into_owned()
    }

    #[test]
    fn no_panic_leaves() {
        assert_eq!(guarded(|| panic!("as a fault would")), GEDEPTH_PANICKED);
        assert!(last().starts_with("a fault of the library"));
        assert_eq!(guarded(|| Ok(())), GEDEPTH_OK);
    }

    #[test]
    fn texts_are_the_threads_own_and_cut_between_characters() {
        Failure::new(GEDEPTH_MODEL, format_args!("mine"));
        let other = std::thread::spawn(|| {
            let before = last();
            // 510 one-byte characters, then one of two bytes that does not fit with the closing zero.
            Failure::new(GEDEPTH_MODEL, format_args!("{}é!", "x".repeat(510)));
            (before, last())
        });
        let (before, after) = other.join().unwrap_or_default();
        assert_eq!(before, "");
        assert_eq!(after, "x".repeat(510));
        assert_eq!(last(), "mine");
    }
}
