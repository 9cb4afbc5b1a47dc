//! The design pass over designs of one shape: the steps of [`design_pass`](crate::reduce::design_pass), one design per
//! lane.

use kalfit_lanes::{Kernel, Lanes};

use crate::reduce::covariance_filter::CovarianceFilter;
use crate::reduce::design::{Design, EqualSteps, TransitionView};
use crate::reduce::entries::{Entries, SideBySide};
use crate::reduce::lanes::least_squares;
use crate::reduce::lanes::numbers::{DataView, Numbers, at, put};
use crate::reduce::lanes::pass::run_innovations;
use crate::reduce::lanes::workspace::DataWorkspace;
use crate::reduce::sums::InformationSums;
use crate::reduce::terminal::TerminalRoot;
use kalfit_algebra::symmetric::pairs;

/// Designs of one shape and the results of the design pass, in lanes.
#[derive(Debug, Clone, Default)]
pub(crate) struct DesignBatch {
    /// P0, h, R, φ and Q, in lanes.
    pub(crate) variance: Vec<f64>,
    pub(crate) h: Vec<f64>,
    pub(crate) noise: Vec<f64>,
    pub(crate) phi: Vec<f64>,
    pub(crate) q: Vec<f64>,
    /// Index of the transition of each run; without meaning for a run without a transition.
    moves: Vec<usize>,
    /// (1/S, K) of each row, and T of each row, in lanes.
    gains: Vec<f64>,
    sensitivities: Vec<f64>,
    /// 1 + r, the length of (1/S, K), and p.
    stride: usize,
    p: usize,
    factor: Vec<f64>,
    /// (R, Σ log S) of each design; `None` if the design needs square-root arrays.
    pub(crate) found: Vec<Option<(Vec<f64>, f64)>>,
    /// Sums of the pass, in lanes.
    sums: Vec<f64>,
    /// True if the last states of the designs are wanted.
    pub(crate) with_ends: bool,
    /// P and Ψ after the last step of each design, in lanes; written only if `with_ends`.
    last_moments: (Vec<f64>, Vec<f64>),
}

/// The design pass over `tests` designs in lanes, all of the shape of `design`, and then the data pass.
pub(super) struct BatchPasses<'a> {
    pub(super) design: &'a Design,
    pub(super) tests: usize,
    pub(super) data: DataView<'a>,
    pub(super) designs: &'a mut DesignBatch,
    pub(super) scratch: &'a mut DataWorkspace,
}

impl Kernel for BatchPasses<'_> {
    type Output = ();

    #[inline(always)]
    fn run<T: Lanes>(self) {
        let BatchPasses { design, tests, data, designs, scratch } = self;
        let sums = designs.covariance_pass::<T>(design);
        designs.finish(&sums, tests);
        let square = run_innovations::<T, _, _>(design, designs, data, scratch, &mut ());
        least_squares::solve::<T, _>((&*designs, design), (square, data.values), scratch);
    }
}

impl DesignBatch {
    /// Resets the batch to designs of this shape, in which each step is a run: R is one, all other numbers are zero.
    pub(super) fn blank(&mut self, design: &Design, lanes: usize) {
        let (terms, pairs) = design.pattern().map_or((0, 0), |pattern| (pattern.columns.len(), pattern.pairs.len()));
        let DesignBatch { variance, h, noise, moves, phi, q, .. } = self;
        let mut transitions = 0_usize;
        let number = |run: &EqualSteps| {
            transitions += usize::from(run.transition.is_some());
            transitions.saturating_sub(1)
        };
        moves.clear();
        moves.extend(design.runs.iter().map(number));
        let numbers = [
            (variance, design.variance.len(), 0.0),
            (h, design.states.len(), 0.0),
            (noise, design.rows(), 1.0),
            (phi, transitions * terms, 0.0),
            (q, transitions * pairs, 0.0),
        ];
        for (column, numbers, x) in numbers {
            column.clear();
            column.resize(numbers * lanes, x);
        }
    }

    /// Runs the covariance filter over all designs.
    #[inline(always)]
    fn covariance_pass<T: Lanes>(&mut self, design: &Design) -> InformationSums<T> {
        let frame = &*design.frame;
        (self.p, self.stride) = (frame.p, 1 + frame.r);
        self.gains.resize(design.rows() * self.stride * T::COUNT, 0.0);
        self.sensitivities.resize(design.rows() * self.p * T::COUNT, 0.0);
        if self.with_ends {
            self.last_moments.0.resize(frame.r * frame.r * T::COUNT, 0.0);
            self.last_moments.1.resize(frame.sensitivity.len() * T::COUNT, 0.0);
        }
        let mut filter = CovarianceFilter::<T>::new(frame, SideBySide(&self.variance));
        let (mut first, mut row) = (0, 0);
        for (at_run, run) in design.runs.iter().enumerate() {
            for _ in 0..run.count {
                if let Some(transition) = Numbers::<T>::transition(&*self, design, at_run) {
                    filter.predict(frame, transition);
                }
                for line in first..run.lines {
                    self.measure(&mut filter, design, (line, row));
                    row += 1;
                }
            }
            first = run.lines;
        }
        if self.with_ends {
            for (from, to) in [(&filter.P, &mut self.last_moments.0), (&filter.Psi, &mut self.last_moments.1)] {
                for (k, x) in from.iter().enumerate() {
                    put(to, k, *x);
                }
            }
        }
        filter.sums
    }

    /// Takes a scalar measurement into the filter and stores 1/S, K and T.
    #[inline(always)]
    fn measure<T: Lanes>(&mut self, filter: &mut CovarianceFilter<T>, design: &Design, (line, row): (usize, usize)) {
        let frame = &*design.frame;
        let update = filter.measure(frame, self.line(design, line));
        let stride = 1 + frame.r;
        put(&mut self.gains, row * stride, update.weight);
        for i in 0..frame.r {
            put(&mut self.gains, row * stride + 1 + i, filter.K[i]);
        }
        for k in 0..frame.p {
            put(&mut self.sensitivities, row * frame.p + k, filter.T[k]);
        }
    }

    /// (states, h, R) of a line.
    #[inline(always)]
    pub(crate) fn line<'a, T: Lanes>(&'a self, design: &'a Design, line: usize) -> (&'a [u32], SideBySide<'a>, T) {
        let start = if line == 0 { 0 } else { design.ends[line - 1] };
        let h = Entries::<T>::skip(SideBySide(&self.h), start);
        (&design.states[start..design.ends[line]], h, at(&self.noise, line))
    }

    /// Computes R and Σ log S of each design from the sums.
    #[inline(always)]
    fn finish<T: Lanes>(&mut self, sums: &InformationSums<T>, designs: usize) {
        sums.lanes(&mut self.sums);
        self.found.resize(designs, None);
        self.factor.clear();
        self.factor.resize(pairs(self.p) * T::COUNT, 0.0);
        let mut own = InformationSums::new(self.p);
        for (lane, found) in self.found.iter_mut().enumerate() {
            own.take_lane(&self.sums, lane, T::COUNT);
            let scratch = found.take().map_or_else(Vec::new, |(factor, _)| factor);
            *found = own.root_in(scratch, &[]);
            if let Some((factor, _)) = &*found {
                factor.iter().enumerate().for_each(|(k, &x)| self.factor[k * T::COUNT + lane] = x);
            }
        }
    }

    /// Ψ_K and a root of P_K of the design in a lane; `None` if the root needs square-root arrays. `states`: the
    /// model's state at each position in kernel order.
    pub(crate) fn end(&self, (lane, lanes): (usize, usize), states: &[usize]) -> Option<TerminalRoot> {
        let own = |all: &[f64]| -> Vec<f64> { all.iter().skip(lane).step_by(lanes).copied().collect() };
        TerminalRoot::of_covariance(states, &own(&self.last_moments.1), &own(&self.last_moments.0), self.stride - 1)
    }

    /// 1/S of the first `rows` scalar measurements of the design in a lane.
    pub(crate) fn weights(&self, (lane, lanes): (usize, usize), rows: usize) -> impl Iterator<Item = f64> + use<'_> {
        self.gains.iter().skip(lane).step_by(lanes * self.stride).take(rows).copied()
    }
}

/// The numbers of designs in which each step is a run.
impl<T: Lanes> Numbers<T> for DesignBatch {
    type List<'a>
        = SideBySide<'a>
    where
        Self: 'a;

    #[inline(always)]
    fn transition<'a>(&'a self, design: &'a Design, run: usize) -> Option<TransitionView<'a, SideBySide<'a>>> {
        let pattern = &*design.transition(&design.runs[run])?.pattern;
        let transition_entries = |all, entries_per_transition: usize| {
            Entries::<T>::skip(SideBySide(all), self.moves[run] * entries_per_transition)
        };
        let (phi, q) =
            (transition_entries(&self.phi, pattern.columns.len()), transition_entries(&self.q, pattern.pairs.len()));
        Some(TransitionView { pattern, phi, q })
    }

    #[inline(always)]
    fn h(&self) -> SideBySide<'_> {
        SideBySide(&self.h)
    }

    #[inline(always)]
    fn gains(&self, row: usize) -> (T, SideBySide<'_>) {
        let gains = Entries::<T>::skip(SideBySide(&self.gains), row * self.stride);
        (gains.entry(0), Entries::<T>::skip(gains, 1))
    }

    #[inline(always)]
    fn sensitivities(&self, row: usize) -> SideBySide<'_> {
        Entries::<T>::skip(SideBySide(&self.sensitivities), row * self.p)
    }

    #[inline(always)]
    fn R(&self) -> SideBySide<'_> {
        SideBySide(&self.factor)
    }
}
