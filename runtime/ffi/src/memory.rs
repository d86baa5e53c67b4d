//! From C's pointers to references and slices: everything that can be checked, checked once, here.

use std::ffi::{CStr, c_char};
use std::path::Path;

use crate::result::{
    Failure, GEDEPTH_MISALIGNED, GEDEPTH_NULL_POINTER, GEDEPTH_OVERLAP, GEDEPTH_TOO_LONG, Result,
};

/// Addresses from the first to one past the last byte.
#[derive(Clone, Copy)]
pub(crate) struct Span {
    start: usize,
    end: usize,
}

/// An array of C: not null, aligned, and not longer than memory.
pub(crate) struct Array<T> {
    start: *mut T,
    len: usize,
}

impl<T> Array<T> {
    pub(crate) fn new(start: *const T, len: usize) -> Result<Self> {
        if start.is_null() {
            return Err(Failure::plain(GEDEPTH_NULL_POINTER));
        }
        if !start.is_aligned() {
            return Err(Failure::plain(GEDEPTH_MISALIGNED));
        }
        let in_memory = len
            .checked_mul(size_of::<T>())
            .filter(|bytes| *bytes <= isize::MAX as usize)
            .is_some_and(|bytes| start.addr().checked_add(bytes).is_some());
        if !in_memory {
            return Err(Failure::plain(GEDEPTH_TOO_LONG));
        }
        Ok(Self {
            start: start.cast_mut(),
            len,
        })
    }

    pub(crate) fn one(start: *const T) -> Result<Self> {
        Self::new(start, 1)
    }

    pub(crate) fn span(&self) -> Span {
        let start = self.start.addr();
        // No overflow: `new` has seen to that.
        Span {
            start,
            end: start.wrapping_add(self.len.wrapping_mul(size_of::<T>())),
        }
    }

    /// # Safety
    /// The memory is valid for reads and written by nobody while `'a` lasts; its bits are a `T`'s.
    pub(crate) unsafe fn slice<'a>(&self) -> &'a [T] {
        // SAFETY: not null, aligned, not beyond the end of memory: `new`; the rest is the caller's promise.
        unsafe { std::slice::from_raw_parts(self.start, self.len) }
    }

    /// Overwrites elements from `at` on.
    ///
    /// # Safety
    /// The memory is valid for writes and used by nobody else meanwhile.
    pub(crate) unsafe fn write(&self, at: usize, values: &[T])
    where
        T: Copy,
    {
        assert!(at <= self.len && values.len() <= self.len - at);
        // SAFETY: within the array (asserted), which is not null, aligned and in memory (`new`); `values` is a reference,
        // so that no promise-keeping caller's array overlaps it.
        unsafe { std::ptr::copy_nonoverlapping(values.as_ptr(), self.start.add(at), values.len()) };
    }
}

/// Copies the struct that C passed.
///
/// # Safety
/// If `start` is not null it leads to a `T`.
pub(crate) unsafe fn read<T: Copy>(start: *const T) -> Result<T> {
    let array = Array::one(start)?;
    // SAFETY: not null and aligned; the rest is the caller's promise.
    Ok(unsafe { array.start.read() })
}

/// Looks into a handle.
///
/// # Safety
/// If `handle` is not null it leads to a `T` that nobody writes or closes while `'a` lasts.
pub(crate) unsafe fn look<'a, T>(handle: *const T) -> Result<&'a T> {
    let array = Array::one(handle)?;
    // SAFETY: not null and aligned; the rest is the caller's promise.
    Ok(unsafe { &*array.start })
}

/// Gives a new handle to C, which must give it back to [`close`]. What is made after a check of where it goes to.
///
/// # Safety
/// If `place` is not null it is valid for a write.
pub(crate) unsafe fn open<T>(place: *mut *mut T, make: impl FnOnce() -> Result<T>) -> Result<()> {
    let place = Array::one(place)?;
    let handle = Box::into_raw(Box::new(make()?));
    // SAFETY: the caller's promise.
    unsafe { place.write(0, &[handle]) };
    Ok(())
}

/// Closes a handle; null is none.
///
/// # Safety
/// `handle` is null or from [`open`], closed once, and in use by nobody.
pub(crate) unsafe fn close<T>(handle: *mut T) {
    if !handle.is_null() {
        // SAFETY: the caller's promise.
        drop(unsafe { Box::from_raw(handle) });
    }
}

/// A path of C.
///
/// # Safety
/// If `path` is not null it leads to a string that ends with a zero and stays while `'a` lasts.
pub(crate) unsafe fn path<'a>(path: *const c_char) -> Result<&'a Path> {
    Array::one(path)?;
    // SAFETY: the caller's promise.
    let path = unsafe { CStr::from_ptr(path) };
    #[cfg(unix)]
    {
        use std::os::unix::ffi::OsStrExt;
        Ok(Path::new(std::ffi::OsStr::from_bytes(path.to_bytes())))
    }
    #[cfg(not(unix))]
    path.to_str()
        .map(Path::new)
        .map_err(|_| Failure::plain(crate::result::GEDEPTH_PATH))
}

/// Errs if memory that is written overlaps any other.
pub(crate) fn check_disjoint<'a>(
    written: impl Iterator<Item = &'a Span> + Clone,
    read: &'a [Span],
) -> Result<()> {
    let overlap = |a: &Span, b: &Span| a.start < b.end && b.start < a.end;
    let mut rest = written;
    while let Some(first) = rest.next() {
        if rest.clone().chain(read).any(|other| overlap(first, other)) {
            return Err(Failure::plain(GEDEPTH_OVERLAP));
        }
    }
    Ok(())
}
