//! The backward pass: adjoints of all coefficients that the likelihood of a test depends on, from the last step of the
//! test to the first (theory §6).
//!
//! ξ is not known but has the posterior mean x̂ and covariance V = CC'. The forward filter runs from x_0 = a + Ax̂, so
//! that the innovations are ē = e - Tx̂ and the states x̄ = x̂_k + Ψx̂; the columns of C are propagated as
//! sensitivities. Then
//!
//! ```text
//! u = ē/S - K'r        υ = TC/S - K'ρ        D = 1/S + K'NK
//! ∂ℓ/∂R = ½(u² + υυ' - D)        ∂ℓ/∂d = u
//! r ← r + hu        ρ ← ρ + hυ
//! ∂ℓ/∂h = u (x̄⁻ + P⁻r) - (Ψ⁻C - P⁻ρ)υ' - P⁻(h/S - (I-Kh')'NK)
//! N ← hh'/S + (I-Kh')'N(I-Kh')
//! ∂ℓ/∂Q = ½(rr' + ρρ' - N)        ∂ℓ/∂b = r
//! ∂ℓ/∂φ = r (x̄ + Pφ'r)' - ρ(ΨC - Pφ'ρ)' - NφP
//! r ← φ'r        ρ ← φ'ρ        N ← φ'Nφ
//! ```
//!
//! These lines apply from top to bottom, starting with the r, ρ, N of later steps, to one scalar measurement after the
//! other, the last one first (the line of ∂ℓ/∂φ reads r and ρ before they become φ'r and φ'ρ); r, u, ρ, υ are the
//! theory's r̄, ū, ρC, υC. After the last step r, ρ and N are zero, or the adjoints of the last state from later phases
//! ([`TerminalAdjoint`]).
//!
//! Single steps on flat arrays are in `kernel`, `filtered` and `adjoint`, for one test and for lanes (`batch`).
//!
//! Of the forward filter only the innovations and the state at intervals are stored; the backward pass runs the filter
//! again over the steps in between. Many equal steps go through kernels of fixed size (`equal_backward`), which sum the
//! adjoints of the steps and stop updating N and ρ once N and ρ are constant; P and Ψ before each of the equal steps
//! are known from the design pass.
#![expect(non_snake_case, reason = "the letters of the theory: P, Psi, N, K, T, S, D")]

mod adjoint;
mod batch;
mod cut;
mod data_adjoint;
mod design_adjoint;
mod equal;
mod equal_backward;
mod filtered;
mod forward;
mod input;
mod kernel;
mod record_segments;
mod scalar_measurement;
mod sink;
mod smooth;
#[cfg(test)]
mod tests;
mod work;

use crate::reduce::DesignStep;
use adjoint::{Adjoint, ScalarAdjoint};
use work::{Segment, SegmentKind};

pub(crate) use batch::{BatchAdjoints, BatchBackward};
pub(crate) use data_adjoint::DataSums;
pub(crate) use equal::EqualStretch;
pub use filtered::FilterSnapshot;
pub use input::AdjointsWanted;
pub use input::BackwardInput;
pub(crate) use input::TerminalAdjoint;
pub(crate) use kernel::{absorb, advance_transposed, smoothing_error};
pub(crate) use record_segments::{RecordSegment, RecordSegments};
pub(crate) use sink::{MeasurementAdjoint, Sink, TransitionAdjoint};
pub use smooth::Smoothed;
pub(crate) use smooth::{SmoothedNoise, SmoothedTest};
pub use work::BackwardWork;

impl BackwardInput<'_> {
    /// The forward and the backward pass of the test; the adjoints go to the sink.
    pub(crate) fn backward<S: Sink>(&self, work: &mut BackwardWork, sink: &mut S) -> Result<(), S::Error> {
        self.forward(work, sink);
        self.back(work, sink)
    }

    /// The backward pass, to be called after the forward pass.
    pub(crate) fn back<S: Sink>(&self, work: &mut BackwardWork, sink: &mut S) -> Result<(), S::Error> {
        work.adjoint.begin(&self.posterior(), self.after());
        for at in (0..work.parts.len()).rev() {
            let segment = work.parts[at];
            match segment.kind {
                SegmentKind::Equal(pass) => {
                    if self.needs_covariance() {
                        work.now.load(&work.marks[segment.mark..][..self.stride()], self.sizes());
                    }
                    pass(self, &segment, work);
                    sink.measured(segment.steps.0, &work.measured)?;
                    if self.design.stretch(segment.stretch).transition.is_some() {
                        sink.moved(segment.steps.0, &work.moved)?;
                    }
                }
                SegmentKind::Cut => {
                    self.back_cut(&segment, work);
                    sink.measured(segment.steps.0, &work.measured)?;
                    if self.design.stretch(segment.stretch).transition.is_some() {
                        sink.moved(segment.steps.0, &work.moved)?;
                    }
                }
                SegmentKind::Steps => self.steps_back(&segment, at + 1 < work.parts.len(), work, sink)?,
            }
        }
        work.adjoint.start_covariance_adjoint(&self.posterior(), &mut work.variance);
        sink.started(&work.adjoint.r, &work.variance)
    }

    /// The backward pass through a segment, step by step. `again`: whether the forward filter has moved on to later
    /// segments, and must first run over this segment again.
    fn steps_back<S: Sink>(
        &self,
        segment: &Segment,
        again: bool,
        work: &mut BackwardWork,
        sink: &mut S,
    ) -> Result<(), S::Error> {
        if again && self.needs_covariance() {
            work.now.load(&work.marks[segment.mark..][..self.stride()], self.sizes());
            self.forward_steps(segment, work);
        }
        let BackwardWork { e, left, before, adjoint, measured, moved, .. } = work;
        let stride = self.stride();
        let seen = |kept: &'_ [f64], at: usize| at * stride..kept.len().min((at + 1) * stride);
        let (mut transitions, mut rows) = (left.len() / stride.max(1), before.len() / stride.max(1));
        let mut k = segment.steps.1;
        for step in segment.steps(self.design).rev() {
            k -= 1;
            if !step.rows.is_empty() {
                rows = rows.saturating_sub(step.rows.len());
                let first = rows;
                let before = |place: usize| FilterSnapshot::new(&before[seen(before, first + place)], self.sizes());
                self.measured_back(&step, e.values(), before, (adjoint, measured));
                sink.measured(k, measured)?;
            }
            if let Some(transition) = step.transition {
                transitions = transitions.saturating_sub(1);
                let left =
                    self.wanted.motion.then(|| FilterSnapshot::new(&left[seen(left, transitions)], self.sizes()));
                adjoint.moved(&self.posterior(), transition.view(), left, moved);
                sink.moved(k, moved)?;
            }
        }
        Ok(())
    }

    /// The backward pass through the measurements of one step, the last first. `before`: the state of the filter before
    /// a measurement, by index of the measurement in the step.
    fn measured_back<'s>(
        &self,
        step: &DesignStep<'_>,
        e: &[f64],
        before: impl Fn(usize) -> FilterSnapshot<'s>,
        (adjoint, bar): (&mut Adjoint, &mut MeasurementAdjoint),
    ) {
        let (n, m) = (self.design.frame.n, step.rows.len());
        let equations = if self.wanted.equation { m * n } else { 0 };
        for (list, size) in [(&mut bar.noise, m), (&mut bar.value, m), (&mut bar.h, equations)] {
            list.clear();
            list.resize(size, 0.0);
        }
        for (place, (line, row)) in step.lines.clone().zip(step.rows.clone()).enumerate().rev() {
            let line = self.line((line, row));
            if line.weight == 0.0 {
                continue; // no information: K and T are zero
            }
            let h = if self.wanted.equation { Some((&mut bar.h[place * n..][..n], before(place))) } else { None };
            let bar = ScalarAdjoint { noise: &mut bar.noise[place], value: &mut bar.value[place], h };
            adjoint.measured(&line, e[row], &self.posterior(), bar);
        }
    }

    /// [r, ρ, N] after the last step; `None` where all three are zero.
    fn after(&self) -> Option<[&[f64]; 3]> {
        self.ending.map(|ending| [&*ending.r, &*ending.rho, &*ending.N])
    }

    /// Whether adjoints of φ or h are wanted, so that P and ΨC are needed.
    fn needs_covariance(&self) -> bool {
        self.posterior().needs_covariance()
    }
}
