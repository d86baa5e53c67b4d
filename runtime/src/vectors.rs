//! Loops of plain Rust, compiled for the vectors that this CPU has: core's, which has no `unsafe` and no run-time
//! detection, and preprocessing's.

/// Work with loops in it that gain from wider vectors.
pub(crate) trait Loops {
    /// What it gives.
    type Output;

    /// Does it. To be `#[inline(always)]`, as all that it calls: what is not inlined into [`widest`] is compiled for
    /// the narrow vectors of the baseline. (That is why this is no closure: nothing makes those inline.)
    fn run(self) -> Self::Output;
}

/// Runs `work` from a function that may use the CPU's widest common vectors. The result does not depend on the width:
/// the loops hold only integers, or plain additions and multiplications of f32 in a fixed order.
#[inline(always)]
pub(crate) fn widest<L: Loops>(work: L) -> L::Output {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2")]
        fn avx2<L: Loops>(work: L) -> L::Output {
            work.run()
        }
        #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl")]
        fn avx512<L: Loops>(work: L) -> L::Output {
            work.run()
        }
        use std::arch::is_x86_feature_detected as has;
        if has!("avx512f") && has!("avx512bw") && has!("avx512dq") && has!("avx512vl") {
            // SAFETY: the only condition on calling `avx512` is that the CPU has these, which was just asked.
            return unsafe { avx512(work) };
        }
        if has!("avx2") {
            // SAFETY: the only condition on calling `avx2` is that the CPU has it, which was just asked.
            return unsafe { avx2(work) };
        }
    }
    // On aarch64 NEON is part of the baseline.
    work.run()
}
