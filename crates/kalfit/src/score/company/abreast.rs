//! The data's part of the backward pass of tests that share all else, a test in each lane.
//!
//! ```text
//! u = ē/S - K'r        ∂ℓ/∂R: ½u²        ∂ℓ/∂d: u        r ← r + hu        ∂ℓ/∂h: u (x̄⁻ + P⁻r)
//! ∂ℓ/∂Q: ½rr'        ∂ℓ/∂b: r        r ← φ'r        ∂ℓ/∂φ: r (x̄ + Pφ'r)'
//! ```
#![expect(non_snake_case, reason = "the letters of the theory: P, K")]

use kalfit_lanes::{Kernel, Lanes, MOST};

use crate::ensemble::Test;
use crate::reduce::{Design, Gains, Step, Transition};
use crate::score::backward::Spreads;
use crate::score::chain::{Entry, Response};

/// What tests share.
#[derive(Debug)]
pub(super) struct Shared<'a> {
    pub(super) design: &'a Design,
    pub(super) gains: &'a Gains,
    pub(super) start: &'a [f64],
    pub(super) inputs: &'a [f64],
    /// Cell and d of each scalar measurement.
    pub(super) cells: &'a [(usize, f64)],
    pub(super) spreads: &'a Spreads,
    pub(super) response: &'a Response,
    pub(super) steps: &'a [Step<'a>],
}

/// One of the tests: what it alone has.
#[derive(Debug, Clone, Copy)]
pub(super) struct Own<'a> {
    pub(super) test: &'a Test,
    /// x̂ of ξ.
    pub(super) mean: &'a [f64],
    /// r after the last step; empty where it is zero.
    pub(super) ending: &'a [f64],
}

/// Σ factor × adjoint of each test: as many numbers as slots answer, one test after the other.
pub(super) struct Abreast<'a> {
    pub(super) shared: &'a Shared<'a>,
    pub(super) tests: &'a [Own<'a>],
}

impl Kernel for Abreast<'_> {
    type Output = Vec<f64>;

    #[inline(always)]
    fn run<T: Lanes>(self) -> Vec<f64> {
        let slots = self.shared.response.slots.len();
        let mut found = vec![0.0; self.tests.len() * slots];
        let mut pass = Pass::<T>::new(self.shared);
        let mut lanes = [0.0; MOST];
        for (tests, found) in self.tests.chunks(T::COUNT).zip(found.chunks_mut((T::COUNT * slots).max(1))) {
            pass.forth(self.shared, tests);
            pass.back(self.shared, tests);
            for (slot, sum) in pass.sums.iter().enumerate() {
                sum.store(&mut lanes);
                for lane in 0..tests.len() {
                    found[lane * slots + slot] = lanes[lane];
                }
            }
        }
        found
    }
}

/// A block of tests on its way.
struct Pass<T> {
    /// x̄ on the way forth, r on the way back.
    x: Vec<T>,
    moved: Vec<T>,
    /// ē of each scalar measurement.
    e: Vec<T>,
    /// x̄ before each transition, and before each measurement, where P is wanted too.
    left: Vec<T>,
    before: Vec<T>,
    /// By slot.
    sums: Vec<T>,
}

/// The same number of each test; lanes beyond the last test are as the last one.
#[inline(always)]
fn each<T: Lanes>(tests: &[Own<'_>], mut number: impl FnMut(&Own<'_>) -> f64) -> T {
    let mut lanes = [0.0; MOST];
    for lane in 0..T::COUNT {
        lanes[lane] = number(&tests[lane.min(tests.len() - 1)]);
    }
    T::load(&lanes)
}

impl<T: Lanes> Pass<T> {
    fn new(shared: &Shared<'_>) -> Pass<T> {
        let (zero, n) = (T::splat(0.0), shared.design.frame.n);
        let transitions = shared.steps.iter().filter(|step| step.transition.is_some()).count();
        let wanted = |of: &[f64], many: usize| if of.is_empty() { 0 } else { many * n };
        Pass {
            x: vec![zero; n],
            moved: vec![zero; n],
            e: vec![zero; shared.cells.len()],
            left: vec![zero; wanted(&shared.spreads.left, transitions)],
            before: vec![zero; wanted(&shared.spreads.before, shared.cells.len())],
            sums: vec![zero; shared.response.slots.len()],
        }
    }

    /// x_0 = a + Ax̂ and the filter from there.
    #[inline(always)]
    fn forth(&mut self, shared: &Shared<'_>, tests: &[Own<'_>]) {
        let frame = &*shared.design.frame;
        let (n, p, r) = (frame.n, frame.p, frame.r);
        for i in 0..n {
            self.x[i] = T::splat(shared.start[i]);
        }
        for k in 0..p {
            let mean = each::<T>(tests, |own| own.mean[k]);
            for i in 0..n {
                let A = frame.sensitivity[i * p + k];
                if A != 0.0 {
                    self.x[i] = T::splat(A).fma(mean, self.x[i]);
                }
            }
        }
        let (mut transitions, mut input) = (0, 0);
        for step in shared.steps {
            if let Some(transition) = step.transition {
                if !self.left.is_empty() {
                    self.left[transitions * n..][..n].copy_from_slice(&self.x);
                }
                self.advance(transition);
                for &state in &frame.driven {
                    self.x[state as usize] = self.x[state as usize] + T::splat(shared.inputs[input]);
                    input += 1;
                }
                transitions += 1;
            }
            for (line, row) in step.lines.clone().zip(step.rows.clone()) {
                if !self.before.is_empty() {
                    self.before[row * n..][..n].copy_from_slice(&self.x);
                }
                let ((states, h), (_, K, _)) = (shared.design.terms(line), shared.gains.row(row));
                let (cell, d) = shared.cells[row];
                let mut e = each::<T>(tests, |own| own.test.all_numbers()[cell] - d);
                for (&state, &h) in states.iter().zip(h) {
                    e = T::splat(h).fnma(self.x[state as usize], e);
                }
                for i in 0..r {
                    self.x[i] = T::splat(K[i]).fma(e, self.x[i]);
                }
                self.e[row] = e;
            }
        }
    }

    /// x ← φx.
    #[inline(always)]
    fn advance(&mut self, transition: &Transition) {
        let pattern = &transition.pattern;
        for (place, row) in pattern.moved.iter().enumerate() {
            let mut sum = T::splat(0.0);
            for k in row.start as usize..row.end as usize {
                sum = T::splat(transition.phi[k]).fma(self.x[pattern.columns[k] as usize], sum);
            }
            self.moved[place] = sum;
        }
        for (place, row) in pattern.moved.iter().enumerate() {
            self.x[row.state as usize] = self.moved[place];
        }
    }

    /// From what later phases say of the last state back to x_0.
    #[inline(always)]
    fn back(&mut self, shared: &Shared<'_>, tests: &[Own<'_>]) {
        for i in 0..self.x.len() {
            self.x[i] = each::<T>(tests, |own| own.ending.get(i).copied().unwrap_or(0.0));
        }
        for sum in &mut self.sums {
            *sum = T::splat(0.0);
        }
        let response = shared.response;
        let mut transitions = response.moves.len();
        for step in shared.steps.iter().rev() {
            for (line, row) in step.lines.clone().zip(step.rows.clone()).rev() {
                self.measured(shared, (line, row));
            }
            if let Some(transition) = step.transition {
                transitions -= 1;
                self.moved(shared, transition, transitions);
            }
        }
        for entry in response.entries(&response.mean) {
            self.add(response, entry, self.x[entry.i]);
        }
        for entry in response.entries(&response.variance) {
            self.add(response, entry, T::splat(0.5) * self.x[entry.i] * self.x[entry.j]);
        }
    }

    /// A scalar measurement on its way back.
    #[inline(always)]
    fn measured(&mut self, shared: &Shared<'_>, (line, row): (usize, usize)) {
        let (weight, K, _) = shared.gains.row(row);
        if weight == 0.0 {
            return; // it can only be what it is
        }
        let (states, h) = shared.design.terms(line);
        let (response, own) = (shared.response, &shared.response.rows[row]);
        let mut u = self.e[row] * T::splat(weight);
        for (i, &K) in K.iter().enumerate() {
            u = T::splat(K).fnma(self.x[i], u);
        }
        self.add_span(response, own.noise, T::splat(0.5) * u * u);
        self.add_span(response, own.value, -u);
        for (&state, &h) in states.iter().zip(h) {
            self.x[state as usize] = T::splat(h).fma(u, self.x[state as usize]);
        }
        let (n, r) = (self.x.len(), K.len());
        for entry in response.entries(&own.h) {
            let P = shared.spreads.before.get((row * r + entry.i) * r..).unwrap_or(&[]);
            let smoothed = self.smoothed(self.before[row * n + entry.i], (entry.i < r).then_some(&P[..r]));
            self.add(response, entry, u * smoothed);
        }
    }

    /// A transition on its way back.
    #[inline(always)]
    fn moved(&mut self, shared: &Shared<'_>, transition: &Transition, number: usize) {
        let (response, own) = (shared.response, &shared.response.moves[number]);
        let (n, r, pattern) = (self.x.len(), shared.design.frame.r, &transition.pattern);
        for entry in response.entries(&own.input) {
            self.add(response, entry, self.x[entry.i]);
        }
        for entry in response.entries(&own.q) {
            let both = self.x[entry.i] * self.x[entry.j];
            self.add(response, entry, if entry.i == entry.j { T::splat(0.5) * both } else { both });
        }
        for (place, row) in pattern.moved.iter().enumerate() {
            self.moved[place] = self.x[row.state as usize];
            self.x[row.state as usize] = T::splat(0.0);
        }
        for (place, row) in pattern.moved.iter().enumerate() {
            for k in row.start as usize..row.end as usize {
                let column = pattern.columns[k] as usize;
                self.x[column] = T::splat(transition.phi[k]).fma(self.moved[place], self.x[column]);
            }
        }
        for entry in response.entries(&own.phi) {
            let P = shared.spreads.left.get((number * r + entry.j) * r..).unwrap_or(&[]);
            let smoothed = self.smoothed(self.left[number * n + entry.j], (entry.j < r).then_some(&P[..r]));
            self.add(response, entry, self.moved[entry.i] * smoothed);
        }
    }

    /// x̄ + P r of one state, with its row of P if it is a noisy one.
    #[inline(always)]
    fn smoothed(&self, x: T, P: Option<&[f64]>) -> T {
        let mut smoothed = x;
        if let Some(P) = P {
            for (l, &P) in P.iter().enumerate() {
                smoothed = T::splat(P).fma(self.x[l], smoothed);
            }
        }
        smoothed
    }

    #[inline(always)]
    fn add(&mut self, response: &Response, entry: &Entry, bar: T) {
        self.add_span(response, entry.span, bar);
    }

    #[inline(always)]
    fn add_span(&mut self, response: &Response, span: (u32, u32), bar: T) {
        for &(slot, factor) in response.factors(span) {
            let sum = &mut self.sums[slot as usize];
            *sum = T::splat(factor).fma(bar, *sum);
        }
    }
}
