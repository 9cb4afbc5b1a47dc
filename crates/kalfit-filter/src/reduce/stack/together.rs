//! Tests with per-test designs, stacked in lanes together with the data of the tests.

use kalfit_lanes::{Isa, Kernel, Lanes, MAX_LANES};
use nalgebra::DMatrix;

use crate::reduce::root::UNINFORMED;
use crate::reduce::stack::join::{JoinWorkspace, per_test};
use crate::reduce::stack::{StackPhase, constant, given, half_log_determinants, links, settle_packed};

/// The stacked phases of one test.
#[derive(Debug, Clone)]
pub(crate) struct Stacked {
    /// R of all phases together, packed by columns.
    pub(crate) factor: Vec<f64>,
    /// (G, C) of each link, the first link first.
    pub(crate) links: Vec<(DMatrix<f64>, DMatrix<f64>)>,
    pub(crate) constant: f64,
    /// d of all phases together.
    pub(crate) data: Vec<f64>,
}

/// Stacks phases of tests of one shape.
pub(super) struct StackKernel<'a>(pub(super) &'a [&'a [StackPhase<'a>]]);

impl Kernel for StackKernel<'_> {
    type Output = Vec<Stacked>;

    #[inline(always)]
    fn run<T: Lanes>(self) -> Vec<Stacked> {
        let mut all = Vec::with_capacity(self.0.len());
        let mut room = (JoinWorkspace::default(), Vec::new());
        for tests in self.0.chunks(T::COUNT) {
            if tests.len() == 1 {
                stack_batch::<f64>(tests, &mut Default::default(), &mut all);
            } else {
                stack_batch::<T>(tests, &mut room, &mut all);
            }
        }
        all
    }
}

/// Stacks one batch of at most as many tests as there are lanes.
#[inline(always)]
fn stack_batch<T: Lanes>(
    tests: &[&[StackPhase<'_>]],
    (room, memory): &mut (JoinWorkspace<T>, Vec<T>),
    all: &mut Vec<Stacked>,
) {
    let phases = given::<T>(tests);
    let mut array = phases[phases.len() - 1].last(std::mem::take(memory));
    let (mut residual, mut diagonals) = (T::splat(0.0), Vec::new());
    for pair in phases.windows(2).rev() {
        let (rest, diagonal) = pair[0].join(&pair[1], array, &mut residual, room);
        diagonals.push(diagonal);
        array = rest;
    }
    let count = tests.len();
    let mut residuals = [0.0; MAX_LANES];
    residual.store(&mut residuals);
    let is_regular = array.is_regular(UNINFORMED);
    let factors = per_test(&array.packed(), count);
    let rest = links(&phases, count).into_iter().zip(half_log_determinants(&diagonals, count));
    for (((mut factor, (links, half_log_determinant)), phases), mut residual) in
        factors.into_iter().zip(rest).zip(tests).zip(residuals)
    {
        let mut d = factor.split_off(factor.len() - array.width);
        if !is_regular {
            let mut settled = Vec::new();
            settle_packed(&mut factor, array.width, &mut settled);
            settled.iter().for_each(|one| one.apply(&mut d, &mut residual));
        }
        all.push(Stacked { factor, links, constant: constant(phases, half_log_determinant, residual), data: d });
    }
    *memory = array.entries;
}

impl Stacked {
    /// Stacks the phases of tests of one shape. The result of a test has the same bits as when the test is stacked
    /// alone.
    pub(crate) fn all(tests: &[&[StackPhase<'_>]]) -> Vec<Stacked> {
        Isa::best().run(StackKernel(tests))
    }
}
