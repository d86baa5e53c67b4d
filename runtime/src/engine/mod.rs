//! The quantized engine: runs the int8 parts of a network faster than tract does, with the same meaning.
//!
//! [`qlinear`] and [`tidy`] bring what different tools write into one form; [`recognize`] finds layers between
//! QuantizeLinear and DequantizeLinear in the ONNX graph; [`island`] gathers them and
//! replaces each gathering by one operator of tract ([`operator`]); [`layer`] says exactly what a layer means, [`functions`] which
//! of them are one table;
//! [`stages`] says which layers run as one, [`schedule`] lays out their memory and shares out their rows among
//! [`threads`]; [`kernels`] are the inner loops; a network that is all one island runs without tract ([`whole`]). What is
//! not recognized stays with tract, with a reason ([`inspection`]), and where an island cannot be planned, the whole model
//! does.
//!
//! # Panics
//! None on any model or picture. `unsafe` is in [`kernels`], [`arena`] and [`threads`] only, and where [`schedule`]'s
//! `run.rs` calls the arena's accessors.

mod arena;
mod expression;
mod functions;
mod inspection;
mod island;
mod kernels;
mod layer;
mod operator;
mod pixels;
mod profile;
mod qlinear;
mod recognize;
mod schedule;
mod stages;
mod threads;
mod tidy;
mod whole;

use tract_onnx::pb::ModelProto;

use crate::Error;

pub use inspection::{InspectedNode, Place};
pub(crate) use island::ISLAND;
pub use kernels::Kernel;
pub(crate) use operator::register;
pub use profile::LayerTime;
pub(crate) use qlinear::to_qdq;
pub(crate) use recognize::graph::Reader;
pub(crate) use whole::{Entrance, Results, Threads, Whole};

/// How a model's quantized layers are run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Engine {
    /// By tract, like everything else: the reference.
    Tract,
    /// By this crate's kernels, on a fixed set of threads. The result does not depend on either.
    Quantized {
        /// Instruction set; one that [`Kernel::is_supported`] says yes to.
        kernel: Kernel,
        /// Number of threads, the caller's included, at most [`Engine::MAX_THREADS`]; 0 counts as 1.
        threads: usize,
    },
}

impl Default for Engine {
    /// The fastest kernels that the processor has, on at most two of its cores. The portable kernels are there to be
    /// compared with and are slower than tract, which runs everything where there are no others (x86-64 without AVX2,
    /// 32-bit processors).
    fn default() -> Self {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        match Kernel::best() {
            Kernel::Portable => Engine::Tract,
            kernel => Engine::Quantized {
                kernel,
                threads: cores.min(2),
            },
        }
    }
}

impl Engine {
    /// Greatest number of threads.
    pub const MAX_THREADS: usize = 64;

    /// Whether it can be had here; tract would run the network in its place, and in other roundings.
    pub(crate) fn check(self) -> Result<(), Error> {
        let reason = match self {
            Engine::Quantized { kernel, .. } if !kernel.is_supported() => {
                format!("this processor does not have the instructions of {kernel:?}")
            }
            Engine::Quantized { threads, .. } if threads > Self::MAX_THREADS => format!(
                "{threads} threads were asked for; at most {} are made",
                Self::MAX_THREADS
            ),
            _ => return Ok(()),
        };
        Err(Error::Engine { reason })
    }

    /// The model with what this engine runs taken out; `None` where that is nothing.
    pub(crate) fn split(self, model: &ModelProto) -> Option<ModelProto> {
        let Engine::Quantized { kernel, threads } = self else {
            return None;
        };
        let mut model = island::replace_islands(model)?;
        let graph = model.graph.as_mut()?;
        for node in graph
            .node
            .iter_mut()
            .filter(|node| node.op_type == island::ISLAND)
        {
            operator::configure(node, kernel, threads.max(1));
        }
        Some(model)
    }
}

#[cfg(test)]
mod tests;
