//! Models: opened once, shared by any number of cameras.

use std::ffi::c_char;
use std::path::Path;

use gedepth::{Engine, Kernel, Model};

use crate::memory::{self, Array, close, open};
use crate::result::{
    Failure, GEDEPTH_KERNEL_NOT_SUPPORTED, GEDEPTH_THREADS, GEDEPTH_UNKNOWN_CHOICE, Result, guarded,
};

/// The fastest kernels that this processor has; tract where they would be the portable ones.
pub const GEDEPTH_KERNEL_BEST: u32 = 0;
/// tract, the reference: slower; its number of threads is one.
pub const GEDEPTH_KERNEL_TRACT: u32 = 1;
/// Plain code, for any processor: slower than tract.
pub const GEDEPTH_KERNEL_PORTABLE: u32 = 2;
/// x86-64 with AVX2.
pub const GEDEPTH_KERNEL_AVX2: u32 = 3;
/// x86-64 with AVX-VNNI.
pub const GEDEPTH_KERNEL_AVX_VNNI: u32 = 4;
/// x86-64 with AVX-512 VNNI.
pub const GEDEPTH_KERNEL_AVX512_VNNI: u32 = 5;
/// AArch64.
pub const GEDEPTH_KERNEL_NEON: u32 = 6;
/// AArch64 with the dot product.
pub const GEDEPTH_KERNEL_NEON_DOTPROD: u32 = 7;
/// AArch64 with 8-bit matrix products.
pub const GEDEPTH_KERNEL_NEON_I8MM: u32 = 8;

/// Most threads that a camera's network runs on.
const MAX_THREADS: u32 = Engine::MAX_THREADS as u32;

/// A network and what it says about itself. Made by gedepth_model_open_*, never changed afterwards: any number of threads may
/// open cameras with it at the same time. Cameras keep what they need of it; it may be closed before them.
pub struct gedepth_model {
    pub(crate) model: Model,
}

impl gedepth_model {
    fn new(model: std::result::Result<Model, gedepth::Error>, engine: Engine) -> Result<Self> {
        Ok(Self {
            model: model?.with_engine(engine),
        })
    }
}

/// What runs the quantized layers.
fn engine(kernel: u32, threads: u32) -> Result<Engine> {
    if threads > MAX_THREADS {
        return Err(Failure::new(
            GEDEPTH_THREADS,
            format_args!("{threads} threads: must be at most {MAX_THREADS}"),
        ));
    }
    let default_threads = std::thread::available_parallelism().map_or(1, |n| n.get().min(2));
    let threads = match threads {
        0 => default_threads,
        given => given as usize,
    };
    let kernel = match kernel {
        GEDEPTH_KERNEL_BEST => {
            return Ok(match Engine::default() {
                Engine::Tract => Engine::Tract,
                Engine::Quantized { kernel, .. } => Engine::Quantized { kernel, threads },
            });
        }
        GEDEPTH_KERNEL_TRACT => return Ok(Engine::Tract),
        GEDEPTH_KERNEL_PORTABLE => Kernel::Portable,
        GEDEPTH_KERNEL_AVX2 => Kernel::Avx2,
        GEDEPTH_KERNEL_AVX_VNNI => Kernel::AvxVnni,
        GEDEPTH_KERNEL_AVX512_VNNI => Kernel::Avx512Vnni,
        GEDEPTH_KERNEL_NEON => Kernel::Neon,
        GEDEPTH_KERNEL_NEON_DOTPROD => Kernel::NeonDotprod,
        GEDEPTH_KERNEL_NEON_I8MM => Kernel::NeonI8mm,
        unknown => {
            return Err(Failure::new(
                GEDEPTH_UNKNOWN_CHOICE,
                format_args!("kernel {unknown} is none of GEDEPTH_KERNEL_*"),
            ));
        }
    };
    if !kernel.is_supported() {
        return Err(Failure::new(
            GEDEPTH_KERNEL_NOT_SUPPORTED,
            format_args!("this processor does not have the instructions of {kernel:?}"),
        ));
    }
    Ok(Engine::Quantized { kernel, threads })
}

/// Opens the quantized adaptive model inside the library. `kernel` is one of GEDEPTH_KERNEL_*; `threads` the number of
/// threads of each camera's network, the caller's included, 0 for the usual (2, or 1 on one core). The depth does not
/// depend on either, but for GEDEPTH_KERNEL_TRACT, which rounds in another order. `*model` is written on success only.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gedepth_model_open_embedded(
    kernel: u32,
    threads: u32,
    model: *mut *mut gedepth_model,
) -> i32 {
    guarded(|| {
        let make = || gedepth_model::new(Model::embedded(), engine(kernel, threads)?);
        // SAFETY: the crate's contract.
        unsafe { open(model, make) }
    })
}

/// Opens an ONNX file with a contract in its metadata. `path` ends with a zero; the rest as gedepth_model_open_embedded.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gedepth_model_open_file(
    path: *const c_char,
    kernel: u32,
    threads: u32,
    model: *mut *mut gedepth_model,
) -> i32 {
    guarded(|| {
        // SAFETY: the crate's contract.
        let path = unsafe { memory::path(path) }?;
        let engine = engine(kernel, threads)?;
        // SAFETY: the crate's contract.
        unsafe { open(model, || gedepth_model::new(Model::from_file(path), engine)) }
    })
}

/// Opens the bytes of an ONNX file, which are not needed afterwards; the rest as gedepth_model_open_embedded.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gedepth_model_open_memory(
    bytes: *const u8,
    bytes_len: usize,
    kernel: u32,
    threads: u32,
    model: *mut *mut gedepth_model,
) -> i32 {
    guarded(|| {
        let bytes = Array::new(bytes, bytes_len)?;
        let engine = engine(kernel, threads)?;
        let make = || {
            // SAFETY: the crate's contract.
            let bytes = unsafe { bytes.slice() };
            gedepth_model::new(Model::from_bytes(Path::new("model"), bytes), engine)
        };
        // SAFETY: the crate's contract.
        unsafe { open(model, make) }
    })
}

/// Closes a model; null is none. No other call may be using it.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gedepth_model_close(model: *mut gedepth_model) {
    guarded(|| {
        // SAFETY: the crate's contract.
        unsafe { close(model) };
        Ok(())
    });
}
