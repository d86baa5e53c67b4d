//! Memory that a team writes together: each member its own rows.
//!
//! The borrow checker cannot see that rows of one buffer are shared out between threads and that buffers whose lifetimes
//! overlap have separate places. The two accessors of [`Shared`] are where that is asserted instead of proved; the
//! schedule's `run.rs` is their only caller.

use std::marker::PhantomData;
use std::ops::Range;

/// As much as the widest vector load likes, and a cache line.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
struct Line([u8; 64]);

/// Bytes for every tensor of an island, at places that the schedule chose.
#[derive(Debug)]
pub(crate) struct Arena(Vec<Line>);

impl Arena {
    /// `bytes` bytes, zero.
    pub(crate) fn new(bytes: usize) -> Self {
        Self(vec![Line([0; 64]); bytes.div_ceil(64)])
    }

    /// The bytes.
    pub(crate) fn bytes(&mut self) -> &mut [u8] {
        let length = self.0.len() * 64;
        // SAFETY: a `Line` is 64 bytes without padding, any of which may hold any value; the borrow is passed on.
        unsafe { std::slice::from_raw_parts_mut(self.0.as_mut_ptr().cast(), length) }
    }
}

/// A slice that several threads write parts of.
#[derive(Debug)]
pub(crate) struct Shared<'a, T> {
    start: *mut T,
    length: usize,
    slice: PhantomData<&'a mut [T]>,
}

// SAFETY: it is a `&mut [T]` in parts; who may touch which part is for the callers of the accessors to keep.
unsafe impl<T: Send> Send for Shared<'_, T> {}
// SAFETY: as above.
unsafe impl<T: Send + Sync> Sync for Shared<'_, T> {}

impl<'a, T> Shared<'a, T> {
    /// Shares a slice.
    pub(crate) fn new(slice: &'a mut [T]) -> Self {
        Self {
            start: slice.as_mut_ptr(),
            length: slice.len(),
            slice: PhantomData,
        }
    }

    /// A part to read. Panics where `range` is not in the slice.
    ///
    /// # Safety
    /// Nobody writes that part while the result lives.
    pub(crate) unsafe fn read(&self, range: Range<usize>) -> &'a [T] {
        assert!(range.start <= range.end && range.end <= self.length);
        // SAFETY: the part is in the slice, which is borrowed for 'a; the caller keeps writers away.
        unsafe { std::slice::from_raw_parts(self.start.add(range.start), range.len()) }
    }

    /// A part to write. Panics where `range` is not in the slice.
    ///
    /// # Safety
    /// Nobody else reads or writes that part while the result lives.
    pub(crate) unsafe fn write(&self, range: Range<usize>) -> &'a mut [T] {
        assert!(range.start <= range.end && range.end <= self.length);
        // SAFETY: the part is in the slice, which is borrowed for 'a; the caller has it alone.
        unsafe { std::slice::from_raw_parts_mut(self.start.add(range.start), range.len()) }
    }
}
