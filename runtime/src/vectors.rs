//! Core's loops, compiled for the vectors that this CPU has. Core itself has no `unsafe` and no run-time detection.

/// Calls `work` from a function that may use the CPU's widest common vectors; what is inlined into it may too.
/// The result does not depend on the width: core's fusion promises the same bytes.
#[inline(always)]
pub(crate) fn widest<R>(work: impl FnOnce() -> R) -> R {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2")]
        fn avx2<R>(work: impl FnOnce() -> R) -> R {
            work()
        }
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the only condition on calling `avx2` is that the CPU has it, which was just asked.
            return unsafe { avx2(work) };
        }
    }
    // On aarch64 NEON is part of the baseline.
    work()
}
