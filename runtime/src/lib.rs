//! Runs quantized GEDepth networks on the CPU.
