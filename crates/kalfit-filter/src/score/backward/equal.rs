//! Many equal steps of one scalar measurement, and the forward pass over them. P and Ψ before each step are known from
//! the design pass.

use kalfit_lanes::{Isa, Kernel, Lanes, Real};

use crate::reduce::{GainSpan, MomentPath, Scan, Stretch};
use crate::score::backward::data_adjoint::{PriorVariances, StepCoefficients};
use crate::score::backward::design_adjoint::{Gain, PriorMoments};
use crate::score::backward::input::BackwardInput;
use crate::score::backward::work::{BackwardWork, Segment};
use crate::score::moments::Moments;

/// A stretch of equal steps, and the gains of the steps; from step `moving` on, the gains are constant.
#[derive(Debug)]
pub(crate) struct EqualStretch<'a> {
    pub(super) input: &'a BackwardInput<'a>,
    pub(crate) stretch: Stretch<'a>,
    pub(crate) piece: &'a GainSpan,
    moving: usize,
    /// Number of states that move.
    pub(crate) states: usize,
    pub(crate) block: usize,
    /// P and Ψ before each step, where adjoints of φ or h are wanted.
    path: Option<&'a MomentPath>,
}

impl<'a> EqualStretch<'a> {
    pub(super) fn new(input: &'a BackwardInput<'a>, segment: &Segment, block: usize) -> EqualStretch<'a> {
        let stretch = input.design.stretch(segment.stretch);
        let first = stretch.rows.start;
        let piece = &input.gains.pieces[input.gains.piece(first)];
        let changing = (piece.row + piece.moving()).saturating_sub(first).min(stretch.count);
        let states = input.design.moving(&stretch);
        let path = input.gains.path(first).filter(|_| input.needs_covariance());
        EqualStretch { input, stretch, piece, moving: changing, states, block, path }
    }

    fn row(&self, step: usize) -> usize {
        self.stretch.rows.start + step
    }

    /// Number of steps after which the gains, P and Ψ are constant.
    pub(crate) fn moving(&self) -> usize {
        self.moving
    }

    /// (first step, first step after the block) of each block of the stretch.
    pub(crate) fn blocks(&self) -> impl DoubleEndedIterator<Item = (usize, usize)> + ExactSizeIterator + use<> {
        let (count, block) = (self.stretch.count, self.block);
        (0..count).step_by(block).map(move |from| (from, count.min(from + block)))
    }

    /// The coefficients of a step for other data; `x`: x̄ before the stretch, with the other data.
    #[inline(always)]
    pub(crate) fn coefficients<T: Real, const N: usize>(&self, x: &[T]) -> StepCoefficients<T, N> {
        StepCoefficients::new(self.input, &self.stretch, x)
    }

    /// 1/S and K of a step.
    #[inline(always)]
    pub(crate) fn weight_and_gain<const N: usize>(&self, step: usize) -> (f64, [f64; N]) {
        let (weight, own, _) = self.input.gains.of(self.piece, self.row(step));
        let mut K = [0.0; N];
        K[..own.len()].copy_from_slice(own);
        (weight, K)
    }

    /// 1/S, K and TC of a step.
    #[inline(always)]
    pub(super) fn gain<const N: usize, const C: usize>(&self, step: usize) -> Gain<N, C> {
        let (sensitivity, mut T) = (self.input.gains.sensitivity_row(self.piece, self.row(step)), [0.0; C]);
        for (k, sensitivity) in sensitivity.iter().enumerate() {
            for j in 0..C {
                T[j] += sensitivity * self.input.moments.root[k * C + j];
            }
        }
        Gain { own: self.weight_and_gain(step), T }
    }

    /// P before a step, and before the measurement of the step.
    #[inline(always)]
    pub(crate) fn variances<const N: usize>(&self, step: usize, (weight, K): &(f64, [f64; N])) -> PriorVariances<N> {
        let r = self.input.design.frame.r;
        let load = |step: usize| {
            let mut P = [[0.0; N]; N];
            if let Some(path) = self.path {
                let own = path.before(step).0;
                (0..r).for_each(|i| P[i][..r].copy_from_slice(&own[i * r..][..r]));
            }
            P
        };
        let before_step = load(step);
        if !self.input.wanted.equation || *weight == 0.0 {
            return PriorVariances { before_step, before_measurement: before_step };
        }
        // the measurement has reduced P by KSK'
        let (mut before_measurement, S) = (load(step + 1), weight.recip());
        for i in 0..N {
            for j in 0..N {
                before_measurement[i][j] += S * K[i] * K[j];
            }
        }
        PriorVariances { before_step, before_measurement }
    }

    /// P and ΨC before a step, and before the measurement of the step.
    #[inline(always)]
    pub(super) fn prior<const N: usize, const C: usize>(&self, step: usize, gain: &Gain<N, C>) -> PriorMoments<N, C> {
        let load = |step: usize| {
            let mut Psi = [[0.0; C]; N];
            if let Some(path) = self.path {
                psi_times_root((path.before(step).1, N), self.input.moments, Psi.as_flattened_mut());
            }
            Psi
        };
        let (P, before_step) = (self.variances(step, &gain.own), load(step));
        if !self.input.wanted.equation {
            return PriorMoments { P, before_step, before_measurement: before_step };
        }
        // the measurement has reduced ΨC by KTC
        let mut before_measurement = load(step + 1);
        for i in 0..N {
            for j in 0..C {
                before_measurement[i][j] += gain.own.1[i] * gain.T[j];
            }
        }
        PriorMoments { P, before_step, before_measurement }
    }
}

/// The forward pass over a stretch; stores the innovations, and x̄ at the start of every block.
pub(super) fn forward(input: &BackwardInput<'_>, segment: &Segment, work: &mut BackwardWork) {
    let steps = EqualStretch::new(input, segment, work.cut.block);
    let BackwardWork { e, marks, now, .. } = work;
    if let Some(path) = steps.path {
        let (P, Psi) = path.before(steps.moving);
        now.P.copy_from_slice(P);
        psi_times_root((Psi, steps.states), input.moments, &mut now.Psi);
    }
    let e = e.next(steps.stretch.count);
    if input.zero_data {
        e.fill(0.0);
    } else {
        e.copy_from_slice(&input.values[steps.stretch.rows.clone()]);
        Isa::best().alone().run(EqualForward { steps: &steps, x: &mut now.x, e, marks });
    }
}

/// Sets `out` to ΨC of the first `states` states, by rows.
#[inline]
pub(super) fn psi_times_root((Psi, states): (&[f64], usize), moments: &Moments, out: &mut [f64]) {
    let (c, p) = (moments.columns, moments.mean.len());
    for i in 0..states {
        for k in 0..c {
            out[i * c + k] = (0..p).map(|j| Psi[i * p + j] * moments.root[j * c + k]).sum();
        }
    }
}

struct EqualForward<'a> {
    steps: &'a EqualStretch<'a>,
    x: &'a mut [f64],
    e: &'a mut [f64],
    marks: &'a mut Vec<f64>,
}

impl Kernel for EqualForward<'_> {
    type Output = ();

    #[inline(always)]
    fn run<T: Lanes>(self) {
        let EqualForward { steps, x, e, marks } = self;
        let (mut own, mut kept) = (splatted::<T>(x), Vec::<T>::new());
        let (input, gains) = (steps.input, (steps.input.gains, steps.piece));
        let blocks = input.needs_covariance().then_some((&mut kept, steps.block));
        Scan { design: input.design, stretch: &steps.stretch, gains, x: &mut own, e, marks: blocks }.run(steps.states);
        for x in &kept {
            marks.push(x.lane(0));
        }
        for (x, own) in x.iter_mut().zip(&own) {
            *x = own.lane(0);
        }
    }
}

/// Each of `numbers`, repeated in all lanes.
#[inline(always)]
pub(super) fn splatted<T: Lanes>(numbers: &[f64]) -> Vec<T> {
    let mut own = Vec::with_capacity(numbers.len());
    for &x in numbers {
        own.push(T::splat(x));
    }
    own
}
