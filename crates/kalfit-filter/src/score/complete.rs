//! The E-step of EM: moments of the states and noises of a test given all data of the test, at known α, μ and Σ.

use std::sync::Arc;

use crate::reduce::{ReduceError, Transition, Workspace};
use crate::score::Scorer;
use crate::score::backward::{
    AdjointsWanted, BackwardInput, BackwardWork, Smoothed, SmoothedNoise, SmoothedTest, TerminalAdjoint,
};
use crate::score::moments::Moments;
use kalfit_model::Test;

/// Moments of the complete data of a test (states and noises), given all that was measured.
#[derive(Debug, Clone, Default)]
pub struct Complete {
    /// Moments of x_0, then of the state after each step.
    pub(crate) states: Vec<Smoothed>,
    /// Whether each scalar measurement had noise.
    pub(crate) noisy: Vec<bool>,
    /// The transition to each step; `None` where the step has no transition.
    pub(crate) transitions: Vec<Option<SmoothedTransition>>,
    pub(crate) start: InitialMoments,
}

/// A transition at the α of the moments, and the moments of the noise of the transition.
#[derive(Debug, Clone)]
pub(crate) struct SmoothedTransition {
    pub(crate) transition: Arc<Transition>,
    /// b of the driven states.
    pub(crate) input: Vec<f64>,
    pub(crate) noise: SmoothedNoise,
}

/// The law of x_0 = a + Aξ + ζ at the α of the moments, and the moments of ζ.
#[derive(Debug, Clone, Default)]
pub(crate) struct InitialMoments {
    /// a, n numbers.
    pub(crate) known: Vec<f64>,
    /// P0, r × r, both triangles.
    pub(crate) variance: Vec<f64>,
    /// E[ζ] (r).
    pub(crate) mean: Vec<f64>,
    /// E[ζζ'] (r × r).
    pub(crate) second: Vec<f64>,
}

impl InitialMoments {
    /// E[ζ] = P0 r and E[ζζ'] = P0 + 2 P0 G P0, with r = ∂ℓ/∂a and G = ∂ℓ/∂P0.
    fn set_noise_moments(&mut self, adjoint: &[f64], bar: &[f64]) {
        let r = self.variance.len().isqrt();
        let entry = |i: usize, j: usize| self.variance[i * r + j];
        self.mean = (0..r).map(|i| (0..r).map(|j| entry(i, j) * adjoint[j]).sum()).collect();
        let half: Vec<f64> =
            (0..r * r).map(|ij| (0..r).map(|k| entry(ij / r, k) * bar[k * r + ij % r]).sum::<f64>()).collect();
        self.second = (0..r * r)
            .map(|ij| {
                let (i, j) = (ij / r, ij % r);
                entry(i, j) + 2.0 * (0..r).map(|k| half[i * r + k] * entry(k, j)).sum::<f64>()
            })
            .collect();
    }
}

impl Complete {
    /// Moments of the complete data of the test in the work space.
    fn of(work: &Workspace, moments: SmoothedTest) -> Complete {
        let (design, data) = (&work.design, &work.data);
        let (r, driven) = (design.frame.r, design.frame.driven.len());
        let mut at = 0;
        let mut transitions = Vec::with_capacity(design.steps());
        for (step, noise) in design.each_step().zip(moments.noises) {
            transitions.push(step.transition.zip(noise).map(|(transition, noise)| {
                let input = data.inputs[at..at + driven].to_vec();
                at += driven;
                SmoothedTransition { transition: transition.clone(), input, noise }
            }));
        }
        let variance = (0..r * r).map(|ij| design.variance[(ij / r).max(ij % r) * r + (ij / r).min(ij % r)]).collect();
        let mut start = InitialMoments { known: data.start.clone(), variance, ..InitialMoments::default() };
        start.set_noise_moments(&moments.mean, &moments.variance);
        let noisy = design.each_step().flat_map(|step| step.lines).map(|line| design.noise[line] > 0.0).collect();
        Complete { noisy, states: moments.states, transitions, start }
    }
}

impl Scorer<'_> {
    /// Moments of the complete data of a test at the α of the reducer. `moments`: moments of ξ of the test; `ending`:
    /// adjoints of the last state of the test, from later phases.
    pub(crate) fn complete(
        &self,
        test: &Test,
        (moments, ending): (&Moments, Option<&TerminalAdjoint>),
        (work, backward): (&mut Workspace, &mut BackwardWork),
    ) -> Result<Complete, ReduceError> {
        let wanted = AdjointsWanted { motion: true, equation: false };
        self.reducer.with_gains(test, work, |gains, work| {
            let run = BackwardInput::of((work, gains), (moments, ending), wanted);
            Complete::of(work, run.smooth(backward))
        })
    }
}
