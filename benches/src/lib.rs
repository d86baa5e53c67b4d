//! What the processor could do at best, for the bench `engine` and for `roofs`.

const ROUNDS: u64 = 10_000;
/// As many as hide how long each sum takes.
const SUMS: usize = 16;
/// What [`multiply_add`] does: 64 an instruction.
pub const MULTIPLY_ADDS: u64 = ROUNDS * SUMS as u64 * 64;

/// Has one core's VNNI unit, in 512 bits, do [`MULTIPLY_ADDS`]: independent sums in registers, no memory. `false` where there is
/// no such unit.
pub fn multiply_add() -> bool {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::*;

        #[target_feature(enable = "avx512f,avx512vnni")]
        fn vpdpbusd(bytes: __m512i, weights: __m512i) {
            let mut sums = [_mm512_setzero_si512(); SUMS];
            for _ in 0..ROUNDS {
                for sum in &mut sums {
                    // SAFETY: arithmetic on registers. In assembly, not `pure`, so that the compiler leaves every one of them.
                    unsafe {
                        std::arch::asm!("vpdpbusd {}, {}, {}", inout(zmm_reg) *sum, in(zmm_reg) bytes, in(zmm_reg) weights,
                            options(nomem, nostack));
                    }
                }
            }
        }

        if is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512vnni") {
            // SAFETY: the processor has the instructions, as was just asked.
            unsafe { vpdpbusd(_mm512_set1_epi8(3), _mm512_set1_epi8(5)) };
            return true;
        }
    }
    false
}

/// Reads and writes all of `memory` once, in vectors of 32 bytes where the processor has them.
pub fn read_and_write(memory: &mut [u64]) {
    #[inline(always)]
    fn change(memory: &mut [u64]) {
        for word in memory {
            *word ^= 1;
        }
    }
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2")]
        fn avx2(memory: &mut [u64]) {
            change(memory);
        }
        if is_x86_feature_detected!("avx2") {
            // SAFETY: the only condition on calling `avx2` is that the CPU has it, which was just asked.
            return unsafe { avx2(memory) };
        }
    }
    change(memory);
}
