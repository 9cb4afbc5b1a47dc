//! The backward pass through many equal steps of one scalar measurement with few moving states: adjoints are summed,
//! and N and ρ are no longer updated once they are constant.

use kalfit_lanes::{Isa, Kernel, Lanes};

use crate::reduce::{MomentPath, SteadyState, SteadyStateMonitor, Stretch};
use crate::score::backward::data_adjoint::{DataSums, PriorVariances, StepCoefficients};
use crate::score::backward::design_adjoint::{DesignAdjoint, DesignSums, Gain, PriorMoments};
use crate::score::backward::equal::{EqualStretch, splatted};
use crate::score::backward::filtered::FilteredMoments;
use crate::score::backward::input::BackwardInput;
use crate::score::backward::work::{BackwardWork, Segment, SegmentPass};

fn columns<const N: usize>(c: usize) -> Option<SegmentPass> {
    Some(match c {
        0 => backward::<N, 0>,
        1 => backward::<N, 1>,
        2 => backward::<N, 2>,
        3 => backward::<N, 3>,
        _ => return None,
    })
}

/// The backward pass over a stretch; `None` where no kernel has the size of the stretch.
pub(super) fn kernel(input: &BackwardInput<'_>, stretch: &Stretch<'_>) -> Option<SegmentPass> {
    let c = input.moments.columns;
    let known = !input.needs_covariance() || input.gains.path(stretch.rows.start).is_some();
    match MomentPath::states(input.design, stretch).filter(|_| known)? {
        0 => columns::<0>(c),
        1 => columns::<1>(c),
        2 => columns::<2>(c),
        3 => columns::<3>(c),
        4 => columns::<4>(c),
        _ => None,
    }
}

/// State of the backward pass over a stretch of equal steps.
struct EqualBackward<T, const N: usize, const C: usize> {
    step: StepCoefficients<T, N>,
    r: [T; N],
    bars: DesignAdjoint<T, N, C>,
    data: DataSums<T, N>,
    sums: DesignSums<T, N, C>,
    /// The constant P, and the contribution of each step to the sums, once P, N and ρ are constant.
    steady: Option<(PriorVariances<N>, DesignSums<T, N, C>)>,
    /// Number of steps with constant N and ρ that are not in the sums yet.
    rested: usize,
    monitored: bool,
}

/// Writes the summed adjoints of a stretch to `work.measured` and `work.moved`; `work.now` must be the state of the
/// filter before the stretch.
fn backward<const N: usize, const C: usize>(input: &BackwardInput<'_>, segment: &Segment, work: &mut BackwardWork) {
    Isa::best().alone().run(EqualPass::<N, C> { input, segment, work });
}

struct EqualPass<'a, const N: usize, const C: usize> {
    input: &'a BackwardInput<'a>,
    segment: &'a Segment,
    work: &'a mut BackwardWork,
}

impl<const N: usize, const C: usize> Kernel for EqualPass<'_, N, C> {
    type Output = ();

    #[inline(always)]
    fn run<T: Lanes>(self) {
        let EqualPass { input, segment, work } = self;
        let steps = EqualStretch::new(input, segment, work.cut.block);
        let mut back = EqualBackward::<T, N, C>::new(&steps, work);
        let mut xs = vec![[T::splat(0.0); N]; steps.block.min(steps.stretch.count)];
        for (from, to) in steps.blocks().rev() {
            if input.zero_data && back.steady.is_some() && from >= steps.moving() {
                back.rested += to - from;
                continue;
            }
            if input.needs_covariance() && !input.zero_data {
                let mark = segment.mark + input.stride() + from / steps.block * N;
                let first = std::array::from_fn(|i| T::splat(work.marks[mark + i]));
                let e = &work.e.values()[steps.stretch.rows.clone()];
                back.recompute_means(&steps, first, (from, to), (e, &mut xs));
            }
            back.block(&steps, (from, to), &xs, work);
        }
        back.add_steady_steps();
        back.finish(&steps, work);
    }
}

impl<T: Lanes, const N: usize, const C: usize> EqualBackward<T, N, C> {
    #[inline(always)]
    fn new(steps: &EqualStretch<'_>, work: &mut BackwardWork) -> EqualBackward<T, N, C> {
        let (zero, r, adjoint) = (T::splat(0.0), steps.input.design.frame.r, &work.adjoint);
        let mut bars = DesignAdjoint { rho: [[zero; C]; N], N: [[zero; N]; N] };
        for i in 0..N {
            for j in 0..C {
                bars.rho[i][j] = T::splat(adjoint.rho[i * C + j]);
            }
            for j in 0..if i < r { r } else { 0 } {
                bars.N[i][j] = T::splat(adjoint.N[i * r + j]);
            }
        }
        work.monitor.start(&adjoint.rho[..N * C]);
        EqualBackward {
            step: StepCoefficients::new(steps.input, &steps.stretch, &splatted(&work.now.x)),
            r: std::array::from_fn(|i| T::splat(adjoint.r[i])),
            bars,
            data: DataSums::zeros(),
            sums: DesignSums::zeros(),
            steady: None,
            rested: 0,
            monitored: work.monitor.begin(steps.stretch.count - steps.moving()),
        }
    }

    /// Recomputes x̄ before each of the steps `from..to`, from x̄ = `x` before step `from`.
    #[inline(always)]
    fn recompute_means(
        &self,
        steps: &EqualStretch<'_>,
        mut x: [T; N],
        (from, to): (usize, usize),
        (e, xs): (&[f64], &mut Vec<[T; N]>),
    ) {
        xs.clear();
        for k in from..to {
            xs.push(x);
            x = self.step.filter.state(&x, &steps.weight_and_gain(k).1, T::splat(e[k]));
        }
    }

    /// The backward pass over the steps `from..to`; `xs`: x̄ before each of these steps.
    #[inline(always)]
    fn block(&mut self, steps: &EqualStretch<'_>, (from, to): (usize, usize), xs: &[[T; N]], work: &mut BackwardWork) {
        let e = &work.e.values()[steps.stretch.rows.clone()];
        let (mut k, low) = (to, from.max(steps.moving()));
        while k > low {
            let gain = steps.gain::<N, C>(k - 1);
            if let Some((P, _)) = &self.steady {
                let (mut r, mut data) = (self.r, self.data);
                for (&e, x) in e[low..k].iter().zip(&xs[low - from..k - from]).rev() {
                    self.step.back(&mut r, &gain.own, T::splat(e), (x, P), &mut data);
                }
                (self.r, self.data) = (r, data);
                self.rested += k - low;
                k = low;
                continue;
            }
            let count = steps.stretch.count;
            let until = if self.monitored { low.max(count.saturating_sub(work.monitor.next_look())) } else { low };
            let prior = steps.prior(k - 1, &gain);
            for k in (until..k).rev() {
                self.step(&gain, e[k], (&xs[k - from], &prior));
            }
            k = until;
            if self.monitored && self.is_steady(steps, count - k, &mut work.monitor) {
                self.steady = Some((prior.P, self.bars.rested(&self.step, &gain, &prior)));
            }
        }
        if from < steps.moving() {
            self.add_steady_steps();
        }
        for k in (from..k.min(to)).rev() {
            let gain = steps.gain(k);
            self.step(&gain, e[k], (&xs[k - from], &steps.prior(k, &gain)));
        }
    }

    #[inline(always)]
    fn step(&mut self, gain: &Gain<N, C>, e: f64, (x, prior): (&[T; N], &PriorMoments<N, C>)) {
        let EqualBackward { step, r, bars, data, sums, .. } = self;
        step.back(r, &gain.own, T::splat(e), (x, &prior.P), data);
        bars.back(step, gain, prior, sums);
    }

    /// Whether N and ρ are constant after `done` steps.
    fn is_steady(&self, steps: &EqualStretch<'_>, done: usize, monitor: &mut SteadyStateMonitor) -> bool {
        if done < monitor.next_look() {
            return false;
        }
        let (r, bars) = (steps.input.design.frame.r, self.bars.one());
        let mut information = [0.0; 16];
        for i in 0..r {
            information[i * r..][..r].copy_from_slice(&bars.N[i][..r]);
        }
        let rho = bars.rho.as_flattened();
        monitor.look(done, (&information[..r * r], r), rho, SteadyState::Nothing) == SteadyState::All
    }

    /// Adds to the sums the steps that were passed with constant N and ρ.
    #[inline(always)]
    fn add_steady_steps(&mut self) {
        if let Some((_, each)) = self.steady.take() {
            self.sums.add(std::mem::take(&mut self.rested) as f64, &each);
        }
    }

    /// Writes the adjoints of the states before the stretch, and the adjoints of the coefficients of the stretch, to
    /// `work`.
    fn finish(&self, steps: &EqualStretch<'_>, work: &mut BackwardWork) {
        let (input, sums, data, bars) = (steps.input, self.sums.one(), self.data.one(), self.bars.one());
        let r = input.design.frame.r;
        let adjoint = &mut work.adjoint;
        (0..N).for_each(|i| adjoint.r[i] = self.r[i].lane(0));
        adjoint.rho[..N * C].copy_from_slice(bars.rho.as_flattened());
        (0..r).for_each(|i| adjoint.N[i * r..][..r].copy_from_slice(&bars.N[i][..r]));
        let mut add = |state: usize, factor: f64, u: f64, upsilon: &[f64; C]| {
            adjoint.r[state] += factor * u;
            (0..C).for_each(|j| adjoint.rho[state * C + j] += factor * upsilon[j]);
        };
        let (states, h) = input.design.terms(steps.stretch.lines.start);
        for (&state, &h) in states.iter().zip(h).filter(|(state, _)| **state as usize >= N) {
            add(state as usize, h, data.u, &sums.upsilon);
        }
        let bar = &mut work.measured;
        bar.noise.clear();
        bar.noise.push(sums.noise + 0.5 * data.uu);
        bar.value.clear();
        bar.value.push(-data.u);
        bar.h.clear();
        if input.wanted.equation {
            bar.h.extend(sums.h.iter().zip(&data.h).map(|(design, data)| design + data));
            bar.h
                .extend((N..input.design.frame.n).map(|s| constant_state_adjoint(&work.now, s, data.u, &sums.upsilon)));
        }
        let Some(transition) = steps.stretch.transition else { return };
        let (pattern, bar) = (&transition.pattern, &mut work.moved);
        bar.input.clear();
        bar.q.clear();
        bar.q.extend(pattern.pairs.iter().map(|&(i, j)| {
            let one = sums.q[i as usize][j as usize] + 0.5 * data.rr[i as usize][j as usize];
            if i == j { one } else { 2.0 * one }
        }));
        bar.phi.clear();
        bar.phi.resize(transition.phi.len(), 0.0);
        for row in &pattern.moved {
            let i = row.state as usize;
            for k in row.start as usize..row.end as usize {
                let j = pattern.columns[k] as usize;
                if j >= N {
                    add(j, transition.phi[k], data.r[i], &sums.rho[i]);
                }
                if input.wanted.motion {
                    let rests = || constant_state_adjoint(&work.now, j, data.r[i], &sums.rho[i]);
                    bar.phi[k] = if j < N { sums.phi[i][j] + data.phi[i][j] } else { rests() };
                }
            }
        }
    }
}

/// ux̄ - υ(ΨC)' of a constant state.
fn constant_state_adjoint<const C: usize>(now: &FilteredMoments, state: usize, u: f64, upsilon: &[f64; C]) -> f64 {
    let Psi = &now.Psi[state * C..][..C];
    u * now.x[state] - upsilon.iter().zip(Psi).map(|(upsilon, Psi)| upsilon * Psi).sum::<f64>()
}
