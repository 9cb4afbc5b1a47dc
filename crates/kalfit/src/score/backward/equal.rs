//! Many equal steps of one scalar measurement, of few moving states: back through them with sums, and without renewing N and ρ
//! where these no longer change.

use kalfit_lanes::Real;

use crate::reduce::{GainSpan, SteadyState, Stretch, moving};
use crate::score::backward::data_adjoint::{DataAdjoint, DataSums, PriorVariances};
use crate::score::backward::design_sums::{DesignAdjoint, DesignSums, FilterCovariance, Gain};
use crate::score::backward::filtered::FilteredMoments;
use crate::score::backward::run::BackwardInput;
use crate::score::backward::steady::StepCoefficients;
use crate::score::backward::work::Segment;
use crate::score::backward::work::{BackwardWork, Kernel};

impl Kernel {
    fn new<const N: usize, const C: usize>() -> Kernel {
        Kernel { forward: forward::<N, C>, backward: backward::<N, C> }
    }

    fn columns<const N: usize>(c: usize) -> Option<Kernel> {
        Some(match c {
            0 => Kernel::new::<N, 0>(),
            1 => Kernel::new::<N, 1>(),
            2 => Kernel::new::<N, 2>(),
            3 => Kernel::new::<N, 3>(),
            _ => return None,
        })
    }
}

/// The kernel of a stretch, if there is one. The model must have no driven states.
pub(super) fn kernel(run: &BackwardInput<'_>, stretch: &Stretch<'_>) -> Option<Kernel> {
    let c = run.moments.columns;
    if stretch.lines.len() != 1 {
        return None;
    }
    match moving(run.design, stretch) {
        0 => Kernel::columns::<0>(c),
        1 => Kernel::columns::<1>(c),
        2 => Kernel::columns::<2>(c),
        3 => Kernel::columns::<3>(c),
        4 => Kernel::columns::<4>(c),
        _ => None,
    }
}

/// A stretch with its gains: from `moving` steps on none of them changes, from `gains` on S and K do not.
#[derive(Debug)]
pub(crate) struct EqualStretch<'a> {
    run: &'a BackwardInput<'a>,
    pub(crate) stretch: Stretch<'a>,
    pub(crate) piece: &'a GainSpan,
    moving: usize,
    gains: usize,
    pub(crate) block: usize,
    /// States that move, and P of these at the beginning of each block; empty where nobody wants it.
    pub(crate) states: usize,
    marks: Vec<f64>,
}

impl<'a> EqualStretch<'a> {
    pub(super) fn new(run: &'a BackwardInput<'a>, part: &Segment, block: usize) -> EqualStretch<'a> {
        let stretch = run.design.stretch(part.stretch);
        let first = stretch.rows.start;
        let piece = &run.gains.pieces[run.gains.piece(first)];
        let moving = (piece.row + piece.moving()).saturating_sub(first).min(stretch.count);
        let gains = piece.moving_gains(first).min(stretch.count);
        EqualStretch { run, stretch, piece, moving, gains, block, states: 0, marks: Vec::new() }
    }

    /// With P at the beginning of each block.
    pub(super) fn with_marks(self, states: usize, marks: Vec<f64>) -> EqualStretch<'a> {
        EqualStretch { states, marks, ..self }
    }

    fn row(&self, step: usize) -> usize {
        self.stretch.rows.start + step
    }

    /// Steps from which on nothing changes.
    pub(crate) fn moving(&self) -> usize {
        self.moving
    }

    /// Its blocks: from and to.
    pub(crate) fn blocks(&self) -> impl DoubleEndedIterator<Item = (usize, usize)> + ExactSizeIterator + use<> {
        let (count, block) = (self.stretch.count, self.block);
        (0..count).step_by(block).map(move |from| (from, count.min(from + block)))
    }

    /// The coefficients of other data; `x`: their filter before these steps.
    #[inline(always)]
    pub(crate) fn data_adjoint<T: Real, const N: usize>(&self, x: &[T]) -> DataAdjoint<T, N> {
        DataAdjoint::new(self.run, &self.stretch, x)
    }

    /// 1/S and K of a step.
    #[inline(always)]
    pub(crate) fn weighted<const N: usize>(&self, step: usize) -> (f64, [f64; N]) {
        let (weight, own, _) = self.run.gains.of(self.piece, self.row(step));
        let mut K = [0.0; N];
        K[..own.len()].copy_from_slice(own);
        (weight, K)
    }

    /// P ahead of the steps of a block as long as it changes; the last one is that of all others.
    pub(crate) fn ahead<const N: usize>(&self, (from, to): (usize, usize)) -> Vec<PriorVariances<N>> {
        let mut P = [[0.0; N]; N];
        if self.marks.is_empty() {
            return vec![PriorVariances { left: P, arrived: P }];
        }
        P.as_flattened_mut().copy_from_slice(&self.marks[from / self.block * N * N..][..N * N]);
        let rests = FilteredMoments::zero(self.run.design.frame.n);
        let step = StepCoefficients::<N, 0>::new(self.run, &self.stretch, &rests);
        let mut all = Vec::with_capacity(to - from);
        for k in from..to.min(self.moving) {
            all.push(step.ahead(&P));
            if k < self.gains {
                P = step.updated(&P, self.run.gains.of(self.piece, self.row(k)).0);
            }
        }
        if to > self.moving {
            all.push(step.ahead(&P));
        }
        all
    }

    #[inline(always)]
    fn gain<const N: usize, const C: usize>(&self, step: usize) -> Gain<N, C> {
        let (weight, own, sensitivity) = self.run.gains.of(self.piece, self.row(step));
        let (mut K, mut T) = ([0.0; N], [0.0; C]);
        K[..own.len()].copy_from_slice(own);
        for (sensitivity, root) in sensitivity.iter().zip(self.run.moments.root.chunks_exact(C.max(1))) {
            for j in 0..C {
                T[j] += sensitivity * root[j];
            }
        }
        Gain { weight, K, T }
    }

    /// From a state of the filter, over steps `from..to`: x̄ before each, P and ΨC too as long as they change.
    fn again<const N: usize, const C: usize>(
        &self,
        step: &StepCoefficients<N, C>,
        (mut x, mut spread): ([f64; N], FilterCovariance<N, C>),
        (from, to): (usize, usize),
        e: &[f64],
        (xs, spreads): (&mut Vec<[f64; N]>, &mut Vec<FilterCovariance<N, C>>),
    ) {
        xs.clear();
        spreads.clear();
        for k in from..to.min(self.moving) {
            xs.push(x);
            spreads.push(spread);
            let gain = self.gain(k);
            spread = step.advance(&spread, &gain, k < self.gains);
            x = step.data.filter.state(&x, &gain.K, e[self.row(k)]);
        }
        if to > self.moving && self.run.blank {
            spreads.push(spread);
            xs.resize(to - from, [0.0; N]);
        } else if to > self.moving {
            spreads.push(spread);
            let (from, gain) = (from.max(self.moving), self.gain::<N, C>(self.moving));
            xs.extend(e[self.row(from)..self.row(to)].iter().map(|&e| {
                let before = x;
                x = step.data.filter.state(&x, &gain.K, e);
                before
            }));
        }
    }
}

/// The innovations of a stretch; the state of the filter is kept at the beginning of every block but the first.
fn forward<const N: usize, const C: usize>(run: &BackwardInput<'_>, part: &Segment, work: &mut BackwardWork) {
    let steps = EqualStretch::new(run, part, work.cut.block);
    let BackwardWork { e, marks, now, .. } = work;
    let step = StepCoefficients::<N, C>::new(run, &steps.stretch, now);
    let (mut x, mut spread) = load::<N, C>(run, now);
    let tracked = run.tracked();
    let values = &run.values[steps.stretch.rows.clone()];
    for (from, to) in steps.blocks() {
        if tracked && from > 0 {
            save(&x, &spread, marks);
        }
        for k in from..to.min(steps.moving) {
            let gain = steps.gain::<N, C>(k);
            let innovation = step.data.filter.innovation(&x, values[k]);
            if tracked {
                spread = step.advance(&spread, &gain, k < steps.gains);
            }
            x = step.data.filter.state(&x, &gain.K, innovation);
            e.push(innovation);
        }
        if to > steps.moving && run.blank {
            e.resize(e.len() + to - from.max(steps.moving), 0.0);
        } else if to > steps.moving {
            let gain = steps.gain::<N, C>(steps.moving);
            e.extend(values[from.max(steps.moving)..to].iter().map(|&z| {
                let innovation = step.data.filter.innovation(&x, z);
                x = step.data.filter.state(&x, &gain.K, innovation);
                innovation
            }));
        }
    }
    store(run, (&x, &spread), now);
}

fn save<const N: usize, const C: usize>(x: &[f64; N], spread: &FilterCovariance<N, C>, marks: &mut Vec<f64>) {
    marks.extend_from_slice(x);
    marks.extend_from_slice(spread.P.as_flattened());
    marks.extend_from_slice(spread.Psi.as_flattened());
}

fn load<const N: usize, const C: usize>(
    run: &BackwardInput<'_>,
    now: &FilteredMoments,
) -> ([f64; N], FilterCovariance<N, C>) {
    let r = run.design.frame.r;
    let (mut x, mut spread) = ([0.0; N], FilterCovariance { P: [[0.0; N]; N], Psi: [[0.0; C]; N] });
    x.copy_from_slice(&now.x[..N]);
    if run.tracked() {
        (0..r).for_each(|i| spread.P[i][..r].copy_from_slice(&now.P[i * r..][..r]));
        spread.Psi.as_flattened_mut().copy_from_slice(&now.Psi[..N * C]);
    }
    (x, spread)
}

fn store<const N: usize, const C: usize>(
    run: &BackwardInput<'_>,
    (x, spread): (&[f64; N], &FilterCovariance<N, C>),
    now: &mut FilteredMoments,
) {
    let r = run.design.frame.r;
    now.x[..N].copy_from_slice(x);
    if run.tracked() {
        (0..r).for_each(|i| now.P[i * r..][..r].copy_from_slice(&spread.P[i][..r]));
        now.Psi[..N * C].copy_from_slice(spread.Psi.as_flattened());
    }
}

fn marked<const N: usize, const C: usize>(mut kept: &[f64]) -> ([f64; N], FilterCovariance<N, C>) {
    let (mut x, mut spread) = ([0.0; N], FilterCovariance { P: [[0.0; N]; N], Psi: [[0.0; C]; N] });
    for part in [&mut x, spread.P.as_flattened_mut(), spread.Psi.as_flattened_mut()] {
        let (own, rest) = kept.split_at(part.len());
        part.copy_from_slice(own);
        kept = rest;
    }
    (x, spread)
}

/// The way back over a stretch: its state, and whether N and ρ rest.
struct EqualBackward<const N: usize, const C: usize> {
    step: StepCoefficients<N, C>,
    r: [f64; N],
    bars: DesignAdjoint<N, C>,
    answers: DataSums<f64, N>,
    sums: DesignSums<N, C>,
    /// P where it rests, and what each step adds to the sums while N and ρ rest too: so many steps so far.
    still: Option<(PriorVariances<N>, DesignSums<N, C>)>,
    rested: usize,
    watched: bool,
}

/// The adjoints of a stretch, summed, into `measured` and `moved` of the work space. `now` is the filter before it.
fn backward<const N: usize, const C: usize>(run: &BackwardInput<'_>, part: &Segment, work: &mut BackwardWork) {
    let steps = EqualStretch::new(run, part, work.cut.block);
    let mut back = EqualBackward::<N, C>::new(&steps, work);
    let (mut xs, mut spreads) = (Vec::new(), Vec::new());
    for (from, to) in steps.blocks().rev() {
        if run.blank && back.still.is_some() && from >= steps.moving {
            back.rested += to - from;
            continue;
        }
        if run.tracked() {
            let start = if from == 0 {
                load(run, &work.now)
            } else {
                let size = N + N * N + N * C;
                marked(&work.marks[part.mark + run.stride() + (from / steps.block - 1) * size..])
            };
            steps.again(&back.step, start, (from, to), &work.e, (&mut xs, &mut spreads));
        } else {
            xs.resize(steps.block, [0.0; N]);
            spreads.resize(1, FilterCovariance { P: [[0.0; N]; N], Psi: [[0.0; C]; N] });
        }
        back.block(&steps, (from, to), (&xs, &spreads), work);
    }
    back.settle();
    back.finish(&steps, work);
}

impl<const N: usize, const C: usize> EqualBackward<N, C> {
    fn new(steps: &EqualStretch<'_>, work: &mut BackwardWork) -> EqualBackward<N, C> {
        let (r, adjoint) = (steps.run.design.frame.r, &work.adjoint);
        let mut bars = DesignAdjoint { rho: [[0.0; C]; N], N: [[0.0; N]; N] };
        bars.rho.as_flattened_mut().copy_from_slice(&adjoint.rho[..N * C]);
        (0..r).for_each(|i| bars.N[i][..r].copy_from_slice(&adjoint.N[i * r..][..r]));
        work.settling.start(bars.rho.as_flattened());
        EqualBackward {
            step: StepCoefficients::new(steps.run, &steps.stretch, &work.now),
            r: std::array::from_fn(|i| adjoint.r[i]),
            bars,
            answers: DataSums::none(),
            sums: DesignSums::ZERO,
            still: None,
            rested: 0,
            watched: work.settling.begin(steps.stretch.count - steps.moving),
        }
    }

    /// Back over steps `from..to`.
    fn block(
        &mut self,
        steps: &EqualStretch<'_>,
        (from, to): (usize, usize),
        (xs, spreads): (&[[f64; N]], &[FilterCovariance<N, C>]),
        work: &mut BackwardWork,
    ) {
        let e = &work.e[steps.stretch.rows.clone()];
        let (mut k, low) = (to, from.max(steps.moving));
        while k > low {
            let gain = steps.gain::<N, C>(k - 1);
            if let Some((ahead, _)) = &self.still {
                let (mut r, mut answers) = (self.r, self.answers);
                for (&e, x) in e[low..k].iter().zip(&xs[low - from..k - from]).rev() {
                    self.step.data.back(&mut r, (gain.weight, &gain.K), e, (x, ahead), &mut answers);
                }
                (self.r, self.answers) = (r, answers);
                self.rested += k - low;
                k = low;
                continue;
            }
            let count = steps.stretch.count;
            let until = if self.watched { low.max(count.saturating_sub(work.settling.next_look())) } else { low };
            let spread = spreads[spreads.len() - 1];
            for k in (until..k).rev() {
                self.step(&gain, e[k], (&xs[k - from], &spread));
            }
            k = until;
            if self.watched && self.looks(steps, count - k, &mut work.settling) {
                self.still = Some((self.step.ahead(&spread.P), self.step.rested(&self.bars, &gain, &spread)));
            }
        }
        if from < steps.moving {
            self.settle();
        }
        for k in (from..k.min(to)).rev() {
            let spread = &spreads[(k - from).min(spreads.len() - 1)];
            self.step(&steps.gain(k), e[k], (&xs[k - from], spread));
        }
    }

    #[inline(always)]
    fn step(&mut self, gain: &Gain<N, C>, e: f64, (x, spread): (&[f64; N], &FilterCovariance<N, C>)) {
        let EqualBackward { step, r, bars, answers, sums, .. } = self;
        let ahead = step.ahead(&spread.P);
        step.data.back(r, (gain.weight, &gain.K), e, (x, &ahead), answers);
        step.back(bars, gain, (spread, &ahead), sums);
    }

    /// Whether N and ρ have come to rest after so many steps.
    fn looks(&self, steps: &EqualStretch<'_>, done: usize, settling: &mut crate::reduce::SteadyStateMonitor) -> bool {
        if done < settling.next_look() {
            return false;
        }
        let r = steps.run.design.frame.r;
        let mut information = [0.0; 16];
        for i in 0..r {
            information[i * r..][..r].copy_from_slice(&self.bars.N[i][..r]);
        }
        let rho = self.bars.rho.as_flattened();
        settling.look(done, (&information[..r * r], r), rho, SteadyState::Nothing) == SteadyState::All
    }

    /// Sums what the steps have added since N and ρ came to rest.
    fn settle(&mut self) {
        if let Some((_, each)) = self.still.take() {
            self.sums.add(std::mem::take(&mut self.rested) as f64, &each);
        }
    }

    /// The adjoints of the states before the stretch, and of its coefficients.
    fn finish(&self, steps: &EqualStretch<'_>, work: &mut BackwardWork) {
        let (run, sums, answers) = (steps.run, &self.sums, &self.answers);
        let r = run.design.frame.r;
        let adjoint = &mut work.adjoint;
        adjoint.r[..N].copy_from_slice(&self.r);
        adjoint.rho[..N * C].copy_from_slice(self.bars.rho.as_flattened());
        (0..r).for_each(|i| adjoint.N[i * r..][..r].copy_from_slice(&self.bars.N[i][..r]));
        let mut add = |state: usize, factor: f64, u: f64, upsilon: &[f64; C]| {
            adjoint.r[state] += factor * u;
            (0..C).for_each(|j| adjoint.rho[state * C + j] += factor * upsilon[j]);
        };
        let (states, h) = run.design.terms(steps.stretch.lines.start);
        for (&state, &h) in states.iter().zip(h).filter(|(state, _)| **state as usize >= N) {
            add(state as usize, h, answers.u, &sums.upsilon);
        }
        let bar = &mut work.measured;
        bar.noise.clear();
        bar.noise.push(sums.noise + 0.5 * answers.uu);
        bar.value.clear();
        bar.value.push(-answers.u);
        bar.h.clear();
        if run.wanted.equation {
            bar.h.extend(sums.h.iter().zip(&answers.h).map(|(design, data)| design + data));
            bar.h.extend((N..run.design.frame.n).map(|s| resting(&work.now, s, answers.u, &sums.upsilon)));
        }
        let Some(transition) = steps.stretch.transition else { return };
        let (pattern, bar) = (&transition.pattern, &mut work.moved);
        bar.input.clear();
        bar.q.clear();
        bar.q.extend(pattern.pairs.iter().map(|&(i, j)| {
            let one = sums.q[i as usize][j as usize] + 0.5 * answers.rr[i as usize][j as usize];
            if i == j { one } else { 2.0 * one }
        }));
        bar.phi.clear();
        bar.phi.resize(transition.phi.len(), 0.0);
        for row in &pattern.moved {
            let i = row.state as usize;
            for k in row.start as usize..row.end as usize {
                let j = pattern.columns[k] as usize;
                if j >= N {
                    add(j, transition.phi[k], answers.r[i], &sums.rho[i]);
                }
                if run.wanted.motion {
                    let rests = || resting(&work.now, j, answers.r[i], &sums.rho[i]);
                    bar.phi[k] = if j < N { sums.phi[i][j] + answers.phi[i][j] } else { rests() };
                }
            }
        }
    }
}

/// ux - υ(ΨC)' of a state that rests.
fn resting<const C: usize>(now: &FilteredMoments, state: usize, u: f64, upsilon: &[f64; C]) -> f64 {
    let Psi = &now.Psi[state * C..][..C];
    u * now.x[state] - upsilon.iter().zip(Psi).map(|(upsilon, Psi)| upsilon * Psi).sum::<f64>()
}
