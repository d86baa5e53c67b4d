//! What one core can do at best: multiply-adds of int8 in registers, and bytes read and written.
//!
//! ```text
//! cargo run --release -p gedepth-benches --bin roofs
//! ```
//!
//! Prints `peak GMAC/s`, where there is AVX-512 VNNI, then lines `bandwidth BYTES GB/s` for memory of so many bytes, of which
//! each byte counts twice. The best of many turns, since nothing but a disturbance makes one slower. `roofline.py` draws it.

use std::hint::black_box;
use std::time::Instant;

use gedepth_benches::{MULTIPLY_ADDS, multiply_add, read_and_write};

/// In the cores' own caches, in the one that they share, in none.
const SIZES: [usize; 3] = [256 << 10, 8 << 20, 256 << 20];
const TURNS: usize = 50;
/// Bytes of a turn: so many that the clock costs nothing.
const TURN: usize = 256 << 20;

fn main() {
    if multiply_add() {
        let seconds = best(&mut || {
            multiply_add();
        });
        println!("peak {:.1}", MULTIPLY_ADDS as f64 / seconds / 1e9);
    }
    for size in SIZES {
        let mut memory = vec![1_u64; size / size_of::<u64>()];
        let seconds = best(&mut || {
            for _ in 0..TURN / size {
                read_and_write(black_box(&mut memory));
            }
        });
        println!("bandwidth {size} {:.1}", 2.0 * TURN as f64 / seconds / 1e9);
    }
}

/// Seconds.
fn best(work: &mut dyn FnMut()) -> f64 {
    let time = |_| {
        let clock = Instant::now();
        work();
        clock.elapsed().as_secs_f64()
    };
    (0..TURNS).map(time).fold(f64::INFINITY, f64::min)
}
