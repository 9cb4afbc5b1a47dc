//! The machine's own limit: multiply-adds a second on data that never leave the widest registers.

use std::hint::black_box;
use std::time::Instant;

use kalfit_lanes::{Isa, Kernel, Lanes};

/// Independent chains: enough to hide the latency of the multiply-add, few enough for the registers.
const CHAINS: usize = 12;

const ROUNDS: usize = 2_000_000;

/// Chains of multiply-adds, side by side; the sum of what they come to.
struct MultiplyAddChains {
    factor: f64,
    addend: f64,
}

impl Kernel for MultiplyAddChains {
    type Output = f64;

    #[inline(always)]
    fn run<T: Lanes>(self) -> f64 {
        let (factor, addend) = (T::splat(self.factor), T::splat(self.addend));
        let mut chains = [T::splat(1.0); CHAINS];
        for (k, chain) in chains.iter_mut().enumerate() {
            // chains that start alike would be computed once
            *chain = T::splat(1.0 + k as f64 * self.addend);
        }
        for _ in 0..ROUNDS {
            for chain in &mut chains {
                *chain = chain.fma(factor, addend);
            }
        }
        let mut sum = 0.0;
        for chain in chains {
            sum += chain.sum();
        }
        sum
    }
}

/// Floating-point operations a second of one core, the best of several runs.
pub(crate) fn flops_per_second() -> f64 {
    (0..15).map(|_| run()).fold(0.0, f64::max)
}

/// The registers that it is measured with.
pub(crate) fn registers() -> &'static str {
    Isa::best().name()
}

fn run() -> f64 {
    let isa = Isa::best();
    let chains = MultiplyAddChains { factor: black_box(0.999_999_9), addend: black_box(1e-9) };
    let started = Instant::now();
    black_box(isa.run(chains));
    (2 * isa.lanes() * CHAINS * ROUNDS) as f64 / started.elapsed().as_secs_f64()
}
