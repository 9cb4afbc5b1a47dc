//! Floating-point operations of the design pass and the data pass. A run of the kernels counts the operations of the
//! design pass.
#![expect(non_snake_case, reason = "the letters of the theory: P, Psi, G, K, T")]

use crate::reduce::design::{DENSE, Pattern, StateFrame, TransitionView};
use crate::reduce::kernel::{FilterState, advance, measure, predict};
use crate::reduce::sums::InformationSums;
use kalfit_lanes::{Counted, Flops};

/// Floating-point operations of (the design pass, the data pass) for a test with n states, of which r are noisy
/// and n - r constant, and p uncertain initial values, if every row measures all states.
pub fn reduction_flops(n: usize, r: usize, p: usize, rows: usize) -> (u64, u64) {
    let design = design_pass(n, r, p, rows);
    // operations per row: φx̂, z - h'x̂, x̂ + Ke, y + T'S⁻¹e, e'S⁻¹e
    let data = rows * (2 * r * r + 2 * n + 1 + 2 * r + 2 * p + 3);
    (design.add + design.mul + 2 * design.fma + design.div, data as u64)
}

/// Operations of a design pass over n states, of which the first r are noisy and coupled and the last p uncertain;
/// every step measures the sum of all states.
fn design_pass(n: usize, r: usize, p: usize, steps: usize) -> Flops {
    let sensitivity = (0..n * p).map(|at| if at / p == at % p + n - p { 1.0 } else { 0.0 }).collect();
    let rows = (0..n).map(|i| if i < r { DENSE } else { (i + p - n) as u32 }).collect();
    let frame = StateFrame { n, p, r, rows, sensitivity, driven: Vec::new(), digest: 0 };
    let mut pattern = Pattern::default();
    (0..r).for_each(|i| pattern.push(i, r, 0..r));
    pattern.pairs.extend((0..r as u32).map(|i| (i, i)));
    let phi: Vec<Counted> = (0..r * r).map(|at| Counted(0.1 + f64::from(at / r == at % r))).collect();
    let q = vec![Counted(1.0); r];
    let transition = TransitionView { pattern: &pattern, phi: &*phi, q: &*q };
    let (states, h): (Vec<u32>, Vec<Counted>) = ((0..n as u32).collect(), vec![Counted(1.0); n]);
    let zeros = |count: usize| vec![Counted(0.0); count];
    let mut Psi: Vec<Counted> = frame.sensitivity.iter().map(|&x| Counted(x)).collect();
    let (mut P, mut G, mut K, mut T) = (zeros(r * r), zeros(r), zeros(r), zeros(p));
    let (mut sums, mut work) = (InformationSums::new(p), Vec::new());
    Counted::count(|| {
        for _ in 0..steps {
            predict(&mut P, r, transition, &mut work);
            advance(&mut Psi, p, transition, &mut work);
            let filter_state = FilterState { P: &mut P, Psi: &mut Psi, J: &mut sums.J };
            let update = measure(&frame, (&states, &*h, Counted(1.0)), filter_state, (&mut G, &mut K, &mut T));
            sums.count(update.S, update.margin);
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(flops: Flops) -> String {
        format!("add {} mul {} fma {} div {}", flops.add, flops.mul, flops.fma, flops.div)
    }

    #[test]
    fn the_steps_of_the_design_pass_keep_their_flop_budget() {
        // n, r, p of a model of random coefficients, of an inertial instrument, and of a model in which all states are
        // noisy.
        insta::assert_snapshot!(line(design_pass(2, 0, 2, 10)), @"add 30 mul 30 fma 40 div 10");
        insta::assert_snapshot!(line(design_pass(15, 2, 13, 10)), @"add 160 mul 210 fma 2370 div 10");
        insta::assert_snapshot!(line(design_pass(4, 4, 4, 10)), @"add 50 mul 180 fma 2930 div 10");
    }
}
