//! The machine's own limit: multiply-adds a second on data that never leave the registers.

use std::hint::black_box;
use std::time::Instant;

/// Independent chains: enough to hide the latency of the multiply-add at any vector width.
const CHAINS: usize = 96;

/// Floating-point operations a second of one core, the best of several runs.
pub(crate) fn flops_per_second() -> f64 {
    (0..7).map(|_| run(2_000_000)).fold(0.0, f64::max)
}

fn run(rounds: usize) -> f64 {
    let mut chains = [black_box(1.0_f64); CHAINS];
    let (factor, addend) = (black_box(0.999_999_9), black_box(1e-9));
    let started = Instant::now();
    for _ in 0..rounds {
        for chain in &mut chains {
            *chain = multiply_add(*chain, factor, addend);
        }
    }
    black_box(chains);
    (2 * CHAINS * rounds) as f64 / started.elapsed().as_secs_f64()
}

#[inline(always)]
fn multiply_add(x: f64, factor: f64, addend: f64) -> f64 {
    // without the instruction `mul_add` is a library call, and the peak is a multiplication and an addition
    if cfg!(target_feature = "fma") { x.mul_add(factor, addend) } else { x * factor + addend }
}
