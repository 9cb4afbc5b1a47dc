//! The design pass over designs of one shape side by side: the steps of [`design_pass`](crate::reduce::design_pass), a design in each
//! lane.
#![expect(non_snake_case, reason = "the letters of the theory: P, Psi, G = P h, K, T, S, J, R")]

use std::sync::Arc;

use kalfit_lanes::{Kernel, Lanes};

use crate::linalg::symmetric::pairs;
use crate::reduce::design::{Design, EqualSteps, Pattern, Transition};
use crate::reduce::gains::{GainSpan, Gains};
use crate::reduce::kernel::{self, FilterState};
use crate::reduce::lanes::numbers::{DataView, Numbers, at, put};
use crate::reduce::lanes::pass::innovate;
use crate::reduce::lanes::squares;
use crate::reduce::lanes::workspace::DataWorkspace;
use crate::reduce::sums::InformationSums;
use crate::reduce::terminal::TerminalRoot;

/// Designs of one shape and all that their pass leaves, in lanes.
#[derive(Debug, Clone, Default)]
pub(crate) struct DesignBatch {
    /// P0, h, R, φ and Q.
    pub(crate) variance: Vec<f64>,
    pub(crate) h: Vec<f64>,
    pub(crate) noise: Vec<f64>,
    pub(crate) phi: Vec<f64>,
    pub(crate) q: Vec<f64>,
    /// The transition of each run, any if it has none: φ is so many times `terms` numbers; Q likewise.
    moves: Vec<usize>,
    terms: usize,
    /// 1/S and K, T of each row.
    gains: Vec<f64>,
    sensitivities: Vec<f64>,
    /// 1 + r, p.
    stride: usize,
    p: usize,
    factor: Vec<f64>,
    /// R and Σ log S of each design; none where square-root arrays are called for.
    pub(crate) found: Vec<Option<(Vec<f64>, f64)>>,
    /// What was added up.
    sums: Vec<f64>,
    /// Where the designs end is wanted too.
    pub(crate) with_ends: bool,
    /// P and Ψ after the last step of each design, if they are wanted.
    last: (Vec<f64>, Vec<f64>),
}

/// The design pass over designs whose numbers are in lanes, so many of them and of the shape of `design`; then the data pass, if there
/// are data.
pub(super) struct DesignPassKernel<'a> {
    pub(super) design: &'a Design,
    pub(super) tests: usize,
    pub(super) data: Option<DataView<'a>>,
    pub(super) gained: &'a mut DesignBatch,
    pub(super) room: &'a mut DataWorkspace,
}

impl Kernel for DesignPassKernel<'_> {
    type Output = ();

    #[inline(always)]
    fn run<T: Lanes>(self) {
        let DesignPassKernel { design, tests, data, gained, room } = self;
        let sums = gained.filter::<T>(design);
        gained.finish(&sums, tests);
        if let Some(data) = data {
            let square = innovate::<T, _, _>(design, gained, data, room, &mut ());
            squares::solve::<T, _>(gained, design.frame.p, square, room);
        }
    }
}

impl DesignBatch {
    /// Of designs that are all as long as this one, each step a run: numbers of zero, but noises of one.
    pub(super) fn blank(&mut self, design: &Design, lanes: usize) {
        let (terms, pairs) = pattern(design).map_or((0, 0), |pattern| (pattern.columns.len(), pattern.pairs.len()));
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
        self.terms = terms;
    }

    /// The numbers of one design, in the first lane.
    pub(super) fn load(&mut self, design: &Design, lanes: usize) {
        let DesignBatch { variance, h, noise, moves, phi, q, .. } = self;
        let first = |column: &mut Vec<f64>, numbers: &mut dyn Iterator<Item = f64>, rest: f64| {
            column.clear();
            for x in numbers {
                column.push(x);
                column.resize(column.len() + lanes - 1, rest);
            }
        };
        let transitions = || design.moves.iter();
        first(variance, &mut design.variance.iter().copied(), 0.0);
        first(h, &mut design.h.iter().copied(), 0.0);
        first(noise, &mut design.noise.iter().copied(), 1.0);
        first(phi, &mut transitions().flat_map(|transition| transition.phi.iter().copied()), 0.0);
        first(q, &mut transitions().flat_map(|transition| transition.q.iter().copied()), 0.0);
        let mut number = 0;
        moves.clear();
        moves.extend(design.runs.iter().map(|run| {
            number = run.transition.unwrap_or(number);
            number as usize
        }));
        self.terms = pattern(design).map_or(0, |pattern| pattern.columns.len());
    }

    /// The covariance filter.
    #[inline(always)]
    fn filter<T: Lanes>(&mut self, design: &Design) -> InformationSums<T> {
        let frame = &*design.frame;
        (self.p, self.stride) = (frame.p, 1 + frame.r);
        self.gains.resize(design.rows() * self.stride * T::COUNT, 0.0);
        self.sensitivities.resize(design.rows() * self.p * T::COUNT, 0.0);
        if self.with_ends {
            self.last.0.resize(frame.r * frame.r * T::COUNT, 0.0);
            self.last.1.resize(frame.sensitivity.len() * T::COUNT, 0.0);
        }
        let mut state = CovarianceState::<T>::new(self, design);
        let (mut first, mut row) = (0, 0);
        let mut now = None;
        for (at_run, run) in design.runs.iter().enumerate() {
            let number = self.moves[at_run];
            if run.transition.is_some() && now != Some(number) {
                self.take(at_run, &mut state.transition);
                now = Some(number);
            }
            for _ in 0..run.count {
                if run.transition.is_some() {
                    kernel::predict(&mut state.P, frame.r, &state.transition, &mut state.rows);
                    kernel::advance(&mut state.Psi, frame.p, &state.transition, &mut state.rows);
                }
                for line in first..run.lines {
                    state.measure(self, design, (line, row));
                    row += 1;
                }
            }
            first = run.lines;
        }
        if self.with_ends {
            for (from, to) in [(&state.P, &mut self.last.0), (&state.Psi, &mut self.last.1)] {
                for (k, x) in from.iter().enumerate() {
                    put(to, k, *x);
                }
            }
        }
        state.sums
    }

    /// R and Σ log S of each design.
    #[inline(always)]
    fn finish<T: Lanes>(&mut self, sums: &InformationSums<T>, designs: usize) {
        sums.lanes(&mut self.sums);
        self.found.resize(designs, None);
        self.factor.clear();
        self.factor.resize(pairs(self.p) * T::COUNT, 0.0);
        let mut own = InformationSums::new(self.p);
        for (lane, found) in self.found.iter_mut().enumerate() {
            own.take_lane(&self.sums, lane, T::COUNT);
            let room = found.take().map_or_else(Vec::new, |(factor, _)| factor);
            *found = own.root_in(room, &[]);
            if let Some((factor, _)) = &*found {
                factor.iter().enumerate().for_each(|(k, &x)| self.factor[k * T::COUNT + lane] = x);
            }
        }
    }

    /// Where one design ends, its states these; `None` where that calls for square-root arrays.
    pub(crate) fn end(&self, (lane, lanes): (usize, usize), states: &[usize]) -> Option<TerminalRoot> {
        let own = |all: &[f64]| -> Vec<f64> { all.iter().skip(lane).step_by(lanes).copied().collect() };
        TerminalRoot::of_covariance(states, &own(&self.last.1), &own(&self.last.0), self.stride - 1)
    }

    /// Takes the transition of a run that has one.
    #[inline(always)]
    pub(super) fn take<T: Lanes>(&self, run: usize, transition: &mut Transition<T>) {
        let Transition { phi, q, .. } = transition;
        let number = self.moves[run];
        for k in 0..phi.len() {
            phi[k] = at(&self.phi, number * phi.len() + k);
        }
        for k in 0..q.len() {
            q[k] = at(&self.q, number * q.len() + k);
        }
    }

    /// 1/S of so many measurements of one design.
    pub(crate) fn weights(&self, (lane, lanes): (usize, usize), rows: usize) -> impl Iterator<Item = f64> + use<'_> {
        self.gains.iter().skip(lane).step_by(lanes * self.stride).take(rows).copied()
    }

    /// The gains of one design by themselves; `None` where square-root arrays are called for.
    pub(crate) fn gains(&self, (lane, lanes): (usize, usize), rows: usize) -> Option<Gains> {
        let (factor, log_determinant) = self.found[lane].clone()?;
        let own = |all: &[f64], numbers: usize| -> Vec<f64> {
            all.iter().skip(lane).step_by(lanes).take(numbers).copied().collect()
        };
        Some(Gains {
            r: self.stride - 1,
            p: self.p,
            gains: own(&self.gains, rows * self.stride),
            sensitivities: own(&self.sensitivities, rows * self.p),
            pieces: vec![GainSpan::all(rows)],
            factor,
            log_determinant,
            active: rows,
            turns: None,
            end: None,
        })
    }
}

/// The covariance filter of several designs on its way.
struct CovarianceState<T> {
    P: Vec<T>,
    Psi: Vec<T>,
    G: Vec<T>,
    K: Vec<T>,
    T: Vec<T>,
    h: Vec<T>,
    transition: Transition<T>,
    /// Work space of the kernels.
    rows: Vec<T>,
    sums: InformationSums<T>,
}

impl<T: Lanes> CovarianceState<T> {
    #[inline(always)]
    fn new(gained: &DesignBatch, design: &Design) -> CovarianceState<T> {
        let (frame, zero) = (&*design.frame, T::splat(0.0));
        let (mut P, mut Psi) = (vec![zero; frame.r * frame.r], vec![zero; frame.sensitivity.len()]);
        for k in 0..P.len() {
            P[k] = at(&gained.variance, k);
        }
        for k in 0..Psi.len() {
            Psi[k] = T::splat(frame.sensitivity[k]);
        }
        CovarianceState {
            P,
            Psi,
            G: vec![zero; frame.r],
            K: vec![zero; frame.r],
            T: vec![zero; frame.p],
            h: Vec::new(),
            transition: transition(design),
            rows: Vec::new(),
            sums: InformationSums::new(frame.p),
        }
    }

    /// A scalar measurement; what it leaves is kept.
    #[inline(always)]
    fn measure(&mut self, gained: &mut DesignBatch, design: &Design, (line, row): (usize, usize)) {
        let (frame, start) = (&*design.frame, if line == 0 { 0 } else { design.ends[line - 1] });
        self.h.clear();
        for term in start..design.ends[line] {
            self.h.push(at(&gained.h, term));
        }
        let (states, noise) = (&design.states[start..design.ends[line]], at(&gained.noise, line));
        let of = FilterState { P: &mut self.P, Psi: &mut self.Psi, J: &mut self.sums.J };
        let update = kernel::measure(frame, (states, &self.h, noise), of, (&mut self.G, &mut self.K, &mut self.T));
        self.sums.count(update.S, update.kept);
        let stride = 1 + frame.r;
        put(&mut gained.gains, row * stride, update.weight);
        for i in 0..frame.r {
            put(&mut gained.gains, row * stride + 1 + i, self.K[i]);
        }
        for k in 0..frame.p {
            put(&mut gained.sensitivities, row * frame.p + k, self.T[k]);
        }
    }
}

impl<T: Lanes> Numbers<T> for DesignBatch {
    #[inline(always)]
    fn phi(&self, run: usize, term: usize) -> T {
        at(&self.phi, self.moves[run] * self.terms + term)
    }

    #[inline(always)]
    fn h(&self, term: usize) -> T {
        at(&self.h, term)
    }

    #[inline(always)]
    fn gains(&self, row: usize) -> &[f64] {
        let stride = self.stride * T::COUNT;
        &self.gains[row * stride..][..stride]
    }

    #[inline(always)]
    fn sensitivities(&self, row: usize) -> &[f64] {
        let stride = self.p * T::COUNT;
        &self.sensitivities[row * stride..][..stride]
    }

    #[inline(always)]
    fn of(row: &[f64], k: usize) -> T {
        at(row, k)
    }

    #[inline(always)]
    fn R(&self, at_: usize) -> T {
        at(&self.factor, at_)
    }
}

/// Room for a transition of a design.
#[inline(always)]
pub(super) fn transition<T: Lanes>(design: &Design) -> Transition<T> {
    let pattern = pattern(design).cloned().unwrap_or_default();
    let (phi, q) = (vec![T::splat(0.0); pattern.columns.len()], vec![T::splat(0.0); pattern.pairs.len()]);
    Transition { pattern, phi, q }
}

/// The pattern of the transitions of a design: all have one.
#[inline(always)]
fn pattern(design: &Design) -> Option<&Arc<Pattern>> {
    design.moves.first().map(|transition| &transition.pattern)
}
