//! Ground embedding for monocular depth.
#![no_std]
#![forbid(unsafe_code)]
