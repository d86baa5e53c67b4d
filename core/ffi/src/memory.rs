//! From C's pointers to slices: everything that can be checked, checked once, here.

use crate::result::{
    Failure, GEDEPTH_CORE_MISALIGNED, GEDEPTH_CORE_NULL_POINTER, GEDEPTH_CORE_OVERLAP,
    GEDEPTH_CORE_TOO_LONG, Result,
};

/// Addresses from the first to one past the last byte.
#[derive(Clone, Copy)]
pub(crate) struct Span {
    start: usize,
    end: usize,
}

impl Span {
    /// No memory.
    pub(crate) const NONE: Self = Self { start: 0, end: 0 };

    fn overlaps(self, other: Self) -> bool {
        self.start < other.end && other.start < self.end
    }
}

/// An array of C: not null, aligned, and not longer than memory.
pub(crate) struct Array<T> {
    start: *mut T,
    len: usize,
}

impl<T> Array<T> {
    pub(crate) fn new(start: *const T, len: usize) -> Result<Self> {
        if start.is_null() {
            return Err(Failure(GEDEPTH_CORE_NULL_POINTER));
        }
        if !start.is_aligned() {
            return Err(Failure(GEDEPTH_CORE_MISALIGNED));
        }
        let in_memory = len
            .checked_mul(size_of::<T>())
            .filter(|bytes| *bytes <= isize::MAX as usize)
            .is_some_and(|bytes| start.addr().checked_add(bytes).is_some());
        if !in_memory {
            return Err(Failure(GEDEPTH_CORE_TOO_LONG));
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
        unsafe { core::slice::from_raw_parts(self.start, self.len) }
    }

    /// # Safety
    /// As [`Self::slice`], and the memory is valid for writes and used by nobody else while `'a` lasts.
    pub(crate) unsafe fn slice_mut<'a>(&self) -> &'a mut [T] {
        // SAFETY: as above.
        unsafe { core::slice::from_raw_parts_mut(self.start, self.len) }
    }

    /// Copies the first element.
    ///
    /// # Safety
    /// As [`Self::slice`], for at least one element.
    pub(crate) unsafe fn read(&self) -> T
    where
        T: Copy,
    {
        // SAFETY: as above.
        unsafe { self.start.read() }
    }

    /// Overwrites the first element.
    ///
    /// # Safety
    /// As [`Self::slice_mut`], for at least one element.
    pub(crate) unsafe fn write(&self, value: T) {
        // SAFETY: as above.
        unsafe { self.start.write(value) }
    }
}

/// Copies the struct that C passed.
///
/// # Safety
/// If `start` is not null it leads to a `T`.
pub(crate) unsafe fn read<T: Copy>(start: *const T) -> Result<T> {
    let array = Array::one(start)?;
    // SAFETY: the caller's promise.
    Ok(unsafe { array.read() })
}

/// Errs if memory that is written overlaps any other.
pub(crate) fn check_disjoint(written: &[Span], read: &[Span]) -> Result<()> {
    let mut rest = written;
    while let Some((first, others)) = rest.split_first() {
        if others.iter().chain(read).any(|span| first.overlaps(*span)) {
            return Err(Failure(GEDEPTH_CORE_OVERLAP));
        }
        rest = others;
    }
    Ok(())
}
