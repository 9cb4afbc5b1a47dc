//! The design pass: one covariance run per design class leaves a schedule of weights, gains and sensitivities.
#![expect(non_snake_case, reason = "the letters of the theory: P, Psi, G = P h, K, T, S, J")]

use std::sync::Arc;

use crate::reduce::design::{Design, StateFrame, Stretch};
use crate::reduce::gains::{GainSpan, Gains};
use crate::reduce::kernel::{self, FilterState};
use crate::reduce::schedule::{GainSchedule, GainsWork};
use crate::reduce::settling::SteadyState;
use crate::reduce::sums::InformationSums;
use crate::reduce::terminal::TerminalRoot;
use kalfit_lanes::Real;

/// The design pass in plain covariance and information arithmetic; `None` where that would lose too much. `states`: the state of the
/// model at each place of the kernels, where the last state is wanted.
pub(crate) fn information_gains(design: &Design, states: Option<&[usize]>, work: &mut GainsWork) -> Option<Gains> {
    let frame = &*design.frame;
    let (p, r) = (frame.p, frame.r);
    work.P.clone_from(&design.variance);
    work.Psi.clone_from(&frame.sensitivity);
    work.G.clear();
    work.G.resize(r, 0.0);
    work.settling.start(&work.Psi);
    let mut out = GainSchedule {
        gains: Vec::with_capacity((1 + r) * design.ends.len()),
        sensitivities: Vec::with_capacity(p * design.ends.len()),
        pieces: vec![GainSpan::all(0)],
        sums: InformationSums::new(p),
        many: Vec::new(),
    };
    for stretch in design.stretches() {
        out.stretch(design, &stretch, work);
    }
    let mut gains = out.finish((r, p), design.rows())?;
    if let Some(states) = states {
        gains.end = Some(Arc::new(TerminalRoot::of_covariance(states, &work.Psi, &work.P, r)?));
    }
    Some(gains)
}

impl GainSchedule {
    /// Equal steps: in full until P no longer changes, then Ψ alone until it does not change either, then all others at once.
    fn stretch(&mut self, design: &Design, stretch: &Stretch<'_>, work: &mut GainsWork) {
        let frame = &*design.frame;
        let (gain, sensitivity) = (self.gains.len() / (1 + frame.r), self.sensitivities.len() / frame.p.max(1));
        let watched = work.settling.begin(stretch.count);
        let (mut frozen, mut gain_steps, mut done) = (SteadyState::Nothing, 0, 0);
        while done < stretch.count && frozen != SteadyState::All {
            let before = done;
            done = if watched { work.settling.next_look().min(stretch.count) } else { stretch.count };
            if frozen == SteadyState::Nothing {
                (before..done).for_each(|_| self.step(design, stretch, work));
                gain_steps = done;
            } else {
                (before..done).for_each(|_| self.sensitivities(design, stretch, work));
            }
            if watched {
                frozen = work.settling.look(done, (&work.P, frame.r), &work.Psi, frozen);
            }
        }
        self.repeat(frame, stretch.lines.len(), stretch.count - done);
        let piece = GainSpan {
            row: stretch.rows.start,
            width: stretch.lines.len(),
            gain,
            gain_steps,
            sensitivity,
            sensitivity_steps: done,
        };
        self.note(piece, stretch);
    }

    /// A step in full.
    fn step(&mut self, design: &Design, stretch: &Stretch<'_>, work: &mut GainsWork) {
        let frame = &*design.frame;
        let (p, r) = (frame.p, frame.r);
        if let Some(transition) = stretch.transition {
            kernel::predict(&mut work.P, r, transition, &mut work.rows);
            kernel::advance(&mut work.Psi, p, transition, &mut work.rows);
        }
        for line in stretch.lines.clone() {
            let (states, h) = design.terms(line);
            let (weight, K) = append(&mut self.gains, 1 + r).split_first_mut().expect("stride is positive");
            let T = append(&mut self.sensitivities, p);
            let of = FilterState { P: &mut work.P, Psi: &mut work.Psi, J: &mut self.sums.J };
            let update = kernel::measure(frame, (states, h, design.noise[line]), of, (&mut work.G, K, T));
            *weight = update.weight;
            self.sums.count(update.S, update.kept);
        }
    }

    /// A step under the gains of the last one.
    fn sensitivities(&mut self, design: &Design, stretch: &Stretch<'_>, work: &mut GainsWork) {
        let frame = &*design.frame;
        let (p, stride) = (frame.p, 1 + frame.r);
        if let Some(transition) = stretch.transition {
            kernel::advance(&mut work.Psi, p, transition, &mut work.rows);
        }
        let last = self.gains.len() - stride * stretch.lines.len();
        for (gain, line) in self.gains[last..].chunks_exact(stride).zip(stretch.lines.clone()) {
            let (states, h) = design.terms(line);
            let T = append(&mut self.sensitivities, p);
            kernel::sensitivity(frame, states, h, &work.Psi, T);
            kernel::correct(p, &gain[1..], T, &mut work.Psi);
            kernel::inform(T, gain[0], &mut self.sums.J);
            self.sums.scale(gain[0].recip_or_zero());
        }
    }

    /// So many more steps of `lines` measurements under the gains and sensitivities of the last one: J += m TT'/S.
    fn repeat(&mut self, frame: &StateFrame, lines: usize, many: usize) {
        if many == 0 {
            return;
        }
        let (p, stride) = (frame.p, 1 + frame.r);
        for back in (1..=lines).rev() {
            let weight = self.gains[self.gains.len() - back * stride];
            let T = &self.sensitivities[self.sensitivities.len() - back * p..][..p];
            kernel::inform(T, weight * many as f64, &mut self.sums.J);
            self.many.push((weight.recip_or_zero().or_one(), many));
        }
    }
}

/// Room for so many more numbers, and those.
fn append(numbers: &mut Vec<f64>, many: usize) -> &mut [f64] {
    let start = numbers.len();
    numbers.resize(start + many, 0.0);
    &mut numbers[start..]
}
