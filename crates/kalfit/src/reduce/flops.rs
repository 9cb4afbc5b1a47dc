//! What the passes of the filter cost, counted as they run.

use std::sync::Arc;

use crate::reduce::design::{DENSE, Design, Frame, Pattern, Transition};
use crate::reduce::design_pass::schedule;
use crate::reduce::schedule::GainsWork;
use kalfit_lanes::{Counted, Flops};

/// Floating-point operations of (the design pass, the data pass) for a test of n states, r of them noisy, p uncertain and
/// the others constant, whose every row measures all states.
pub fn reduction_flops(n: usize, r: usize, p: usize, rows: usize) -> (u64, u64) {
    let design = design_pass(n, r, p, rows);
    // a row: φx̂, z - h'x̂, x̂ + Ke, y + T'S⁻¹e, e'S⁻¹e
    let data = rows * (2 * r * r + 2 * n + 1 + 2 * r + 2 * p + 3);
    (design.add + design.mul + 2 * design.fma + design.div, data as u64)
}

/// n states, the first r of them noisy and coupled, p uncertain; every step measures the sum of all states.
pub(crate) fn design_pass(n: usize, r: usize, p: usize, steps: usize) -> Flops {
    let sensitivity = (0..n * p).map(|at| if at / p == at % p + n - p { 1.0 } else { 0.0 }).collect();
    let rows = (0..n).map(|i| if i < r { DENSE } else { (i + p - n) as u32 }).collect();
    let frame = Arc::new(Frame { n, p, r, rows, sensitivity, driven: Vec::new(), digest: 0 });
    let mut pattern = Pattern::default();
    (0..r).for_each(|i| pattern.push(i, r, 0..r));
    pattern.pairs.extend((0..r as u32).map(|i| (i, i)));
    let phi = (0..r * r).map(|at| Counted(0.1 + f64::from(at / r == at % r))).collect();
    let transition = Transition { pattern: Arc::new(pattern), phi, q: vec![Counted(1.0); r] };
    let transition = Arc::new(transition);
    let mut design = Design::new(frame);
    for _ in 0..steps {
        design.states.extend(0..n as u32);
        design.h.extend(vec![Counted(1.0); n]);
        design.ends.push(design.states.len());
        design.noise.push(Counted(1.0));
        design.push_step(Some(&transition));
    }
    Counted::count(|| {
        schedule(&design, &mut GainsWork::default());
    })
}
