//! The design of a test: everything that S, K, T, P and J depend on, with the states in kernel order.
//!
//! Kernel order: noise-reachable states first (states that P0 or process noise ever reaches; P has rows for these
//! alone), then other states that move, then states that never move. Random constants that never move enter only
//! through Ψ.

mod identity;

pub(crate) use identity::DesignDigest;

use std::ops::Range;
use std::sync::Arc;

use crate::reduce::digest::Digest;
use crate::reduce::entries::Common;
use crate::reduce::equal_steps::{MAX_UNSCANNED_STEPS, is_majority};
use nalgebra::DMatrix;

/// Marks a row of Ψ that is dense.
pub(crate) const DENSE: u32 = u32::MAX;
/// Marks a row of Ψ that is always zero.
pub(crate) const ZERO: u32 = u32::MAX - 1;

/// The states of a model in kernel order, and A.
#[derive(Debug, Clone, PartialEq)]
pub struct StateFrame {
    /// n, number of states.
    pub n: usize,
    /// p, number of uncertain initial values ξ.
    pub p: usize,
    /// Number of noise-reachable states.
    pub r: usize,
    /// For each state: k if the row of Ψ is always unit vector k, else [`DENSE`] or [`ZERO`].
    pub(crate) rows: Vec<u32>,
    /// A, n × p, row-major.
    pub sensitivity: Vec<f64>,
    /// Positions of the states with a known input b, in kernel order.
    pub driven: Vec<u32>,
    /// Digest of n, p, r, `rows` and `sensitivity`.
    pub(crate) digest: u128,
}

impl StateFrame {
    pub(crate) fn seal(mut self) -> StateFrame {
        let mut digest = Digest::new();
        digest.count(self.n);
        digest.count(self.p);
        digest.count(self.r);
        self.rows.iter().for_each(|&row| digest.word(u64::from(row)));
        digest.numbers(&self.sensitivity);
        self.digest = digest.finish();
        self
    }

    /// The frame of these states without ξ: p = 0.
    pub(crate) fn without_unknowns(&self) -> StateFrame {
        let frame = StateFrame { p: 0, rows: vec![ZERO; self.n], sensitivity: Vec::new(), ..self.clone() };
        frame.seal()
    }
}

/// A row of φ that is not a row of the identity.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct TransitionRow {
    pub(crate) state: u32,
    /// The terms of the row are start..end; terms before `reach` belong to noise-reachable states.
    pub(crate) start: u32,
    pub(crate) reach: u32,
    pub(crate) end: u32,
}

/// Positions of the entries of φ and Q that a transition stores, without rows of the identity and zeros. All
/// transitions of a model share one pattern.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Pattern {
    /// Rows of φ that are not rows of the identity, in ascending order of state.
    pub(crate) moved: Vec<TransitionRow>,
    pub(crate) columns: Vec<u32>,
    /// Indices (i, j), i ≥ j, of the stored entries of Q.
    pub(crate) pairs: Vec<(u32, u32)>,
    diagonal: bool,
    digest: u128,
}

impl Pattern {
    /// Appends row `state` of φ. `reachable`: number of noise-reachable states; `terms`: states of the terms,
    /// ascending.
    pub(crate) fn push(&mut self, state: usize, reachable: usize, terms: impl Iterator<Item = usize>) {
        let start = self.columns.len() as u32;
        self.columns.extend(terms.map(|term| term as u32));
        let reach = self.columns[start as usize..].iter().filter(|&&term| (term as usize) < reachable).count() as u32;
        self.moved.push(TransitionRow {
            state: state as u32,
            start,
            reach: start + reach,
            end: self.columns.len() as u32,
        });
    }

    pub(crate) fn seal(mut self) -> Pattern {
        let mut digest = Digest::new();
        digest.count(self.moved.len());
        for row in &self.moved {
            digest.word(u64::from(row.state) << 32 | u64::from(row.end - row.start));
        }
        self.columns.iter().for_each(|&column| digest.word(u64::from(column)));
        self.pairs.iter().for_each(|&(i, j)| digest.word(u64::from(i) << 32 | u64::from(j)));
        self.digest = digest.finish();
        let own = |row: &TransitionRow| self.columns[row.start as usize..row.end as usize] == [row.state];
        self.diagonal = self.moved.iter().all(own);
        self
    }

    /// Whether φ and Q are diagonal.
    pub(crate) fn is_diagonal(&self) -> bool {
        self.diagonal && self.pairs.iter().all(|(i, j)| i == j)
    }

    /// The states that move, if φ is diagonal on them; `None` if a row has a term of another state.
    #[inline(always)]
    pub(crate) fn diagonal(&self) -> Option<impl Iterator<Item = usize>> {
        self.diagonal.then(|| self.moved.iter().map(|row| row.state as usize))
    }
}

/// φ and Q of one step: the entries at the positions of a pattern.
#[derive(Debug, Clone)]
pub struct Transition {
    pub(crate) pattern: Arc<Pattern>,
    pub(crate) phi: Vec<f64>,
    pub(crate) q: Vec<f64>,
}

/// A transition for the kernels: φ and Q of one test, or of tests in lanes.
#[derive(Debug, Clone, Copy)]
pub struct TransitionView<'a, E> {
    pub(crate) pattern: &'a Pattern,
    pub(crate) phi: E,
    pub(crate) q: E,
}

impl Transition {
    /// View for kernels of a single test.
    pub(crate) fn view(&self) -> TransitionView<'_, &[f64]> {
        TransitionView { pattern: &self.pattern, phi: &self.phi, q: &self.q }
    }

    /// View for lanes that share the transition.
    #[inline(always)]
    pub(crate) fn common(&self) -> TransitionView<'_, Common<'_>> {
        TransitionView { pattern: &self.pattern, phi: Common(&self.phi), q: Common(&self.q) }
    }

    /// (row, column, entry) of the rows of φ that are not rows of the identity.
    pub(crate) fn entries(&self) -> impl Iterator<Item = (usize, usize, f64)> {
        let row_entries = move |row: &TransitionRow| {
            let (state, terms) = (row.state as usize, row.start as usize..row.end as usize);
            terms.map(move |k| (state, self.pattern.columns[k] as usize, self.phi[k]))
        };
        self.pattern.moved.iter().flat_map(row_entries)
    }

    /// φ, n × n; `state` maps a position in kernel order to a state.
    pub fn dense_phi(&self, n: usize, state: impl Fn(usize) -> usize) -> DMatrix<f64> {
        let mut phi = DMatrix::identity(n, n);
        self.pattern.moved.iter().for_each(|row| phi.row_mut(state(row.state as usize)).fill(0.0));
        self.entries().for_each(|(i, j, x)| phi[(state(i), state(j))] = x);
        phi
    }

    /// Q, n × n; `state` maps a position in kernel order to a state.
    pub fn dense_noise(&self, n: usize, state: impl Fn(usize) -> usize) -> DMatrix<f64> {
        let mut noise = DMatrix::zeros(n, n);
        for (&(i, j), &q) in self.pattern.pairs.iter().zip(&self.q) {
            let (i, j) = (state(i as usize), state(j as usize));
            noise[(i, j)] += q;
            if i != j {
                noise[(j, i)] += q;
            }
        }
        noise
    }

    pub(crate) fn new(pattern: Arc<Pattern>, phi: Vec<f64>, q: Vec<f64>) -> Transition {
        Transition { pattern, phi, q }
    }

    /// Digest of the pattern, φ and Q.
    pub(crate) fn digest(&self) -> u128 {
        let mut digest = Digest::new();
        digest.wide(self.pattern.digest);
        digest.numbers(&self.phi);
        digest.numbers(&self.q);
        digest.finish()
    }

    fn same(&self, other: &Transition) -> bool {
        (Arc::ptr_eq(&self.pattern, &other.pattern) || self.pattern == other.pattern)
            && same_bits(&self.phi, &other.phi)
            && same_bits(&self.q, &other.q)
    }
}

/// A run of consecutive equal steps: a transition, then scalar measurements, `count` times.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct EqualSteps {
    /// Index of the transition, see [`Design::transition`]; `None` if no transition leads to the steps.
    pub(crate) transition: Option<u32>,
    /// End of the lines of one step, which begin where the lines of the previous run end.
    pub(crate) lines: usize,
    /// Number of steps of the run.
    pub(crate) count: usize,
    /// End of the rows of the run among the rows of the test.
    pub(crate) rows: usize,
    /// End of the steps of the run among the steps of the test.
    pub(crate) steps: usize,
}

impl EqualSteps {
    /// (end of the lines, end of the rows, end of the steps) of the run.
    fn ends(&self) -> (usize, usize, usize) {
        (self.lines, self.rows, self.steps)
    }
}

/// The design of a test; the scalar measurements are whitened.
///
/// A *row* is a scalar measurement of the test. Rows of equal steps share one *line*, which stores terms and noise once
/// for all of them.
#[derive(Debug, Clone)]
pub struct Design {
    /// The states in kernel order, and A.
    pub frame: Arc<StateFrame>,
    /// P0 on the noise-reachable states, r × r, row-major; only the lower triangle is read.
    pub variance: Vec<f64>,
    /// The transitions, each stored once for consecutive runs that share it.
    pub(crate) moves: Vec<Arc<Transition>>,
    pub(crate) runs: Vec<EqualSteps>,
    /// End of the terms of each line in `states` and `h`.
    pub(crate) ends: Vec<usize>,
    /// States of the terms, ascending within a line.
    pub(crate) states: Vec<u32>,
    /// Coefficients h of the terms.
    pub(crate) h: Vec<f64>,
    /// R, one variance for each line.
    pub noise: Vec<f64>,
    /// True if all steps are processed one by one, as in lanes, because most steps are in no long stretch of equal
    /// steps.
    pub(crate) stepwise: bool,
}

/// A run of equal steps, with the ranges of lines and rows of the run.
#[derive(Debug, Clone)]
pub struct Stretch<'a> {
    pub(crate) transition: Option<&'a Arc<Transition>>,
    pub(crate) lines: Range<usize>,
    pub(crate) count: usize,
    /// Rows of the run, step after step.
    pub(crate) rows: Range<usize>,
}

/// One step of a test.
#[derive(Debug, Clone)]
pub struct DesignStep<'a> {
    /// Transition that leads to the step; `None` if there is none.
    pub transition: Option<&'a Arc<Transition>>,
    /// Lines of the scalar measurements of the step; a line has terms h and a variance R.
    pub lines: Range<usize>,
    /// Rows of the step: row `rows.start + i` has line `lines.start + i`.
    pub rows: Range<usize>,
}

impl<'a> Stretch<'a> {
    /// The steps of the run, in order.
    pub(crate) fn steps(&self) -> impl DoubleEndedIterator<Item = DesignStep<'a>> + use<'a> {
        let (transition, lines, row) = (self.transition, self.lines.clone(), self.rows.start);
        let width = lines.len();
        (0..self.count).map(move |k| {
            let first = row + k * width;
            DesignStep { transition, lines: lines.clone(), rows: first..first + width }
        })
    }
}

impl Design {
    /// The pattern of the first transition. All transitions of a model share one pattern.
    pub(crate) fn pattern(&self) -> Option<&Arc<Pattern>> {
        self.moves.first().map(|transition| &transition.pattern)
    }

    /// Number of states that noise reaches or that move in a stretch: the first states in kernel order.
    pub(crate) fn moving(&self, stretch: &Stretch<'_>) -> usize {
        let last = stretch.transition.and_then(|transition| transition.pattern.moved.last());
        self.frame.r.max(last.map_or(0, |row| row.state as usize + 1))
    }

    /// `moving` of a stretch of more than `few` equal steps with one scalar measurement and no known inputs; else
    /// `None`.
    pub(crate) fn moving_in_equal_steps(&self, stretch: &Stretch<'_>, few: usize) -> Option<usize> {
        let is_scannable = stretch.count > few && stretch.lines.len() == 1 && self.frame.driven.is_empty();
        is_scannable.then(|| self.moving(stretch))
    }

    pub(crate) fn new(frame: Arc<StateFrame>) -> Design {
        let variance = vec![0.0; frame.r * frame.r];
        Design {
            frame,
            variance,
            moves: Vec::new(),
            runs: Vec::new(),
            ends: Vec::new(),
            states: Vec::new(),
            h: Vec::new(),
            noise: Vec::new(),
            stepwise: false,
        }
    }

    pub(crate) fn clear(&mut self) {
        self.variance.fill(0.0);
        self.moves.clear();
        self.runs.clear();
        self.ends.clear();
        self.states.clear();
        self.h.clear();
        self.noise.clear();
        self.stepwise = false;
    }

    /// Sets `stepwise`, once all steps are appended.
    pub(crate) fn complete(&mut self) {
        let long_steps = self.runs.iter().map(|run| run.count).filter(|&count| count > MAX_UNSCANNED_STEPS).sum();
        self.stepwise = !is_majority(long_steps, self.steps());
    }

    /// True if a stretch of `count` equal steps is processed at once, not step by step.
    #[inline(always)]
    pub(crate) fn is_long(&self, count: usize) -> bool {
        count > MAX_UNSCANNED_STEPS && !self.stepwise
    }

    /// (States, coefficients h) of the terms of a line.
    #[inline(always)]
    pub fn terms(&self, line: usize) -> (&[u32], &[f64]) {
        let start = if line == 0 { 0 } else { self.ends[line - 1] };
        (&self.states[start..self.ends[line]], &self.h[start..self.ends[line]])
    }

    /// End of the rows in the block of `steps` steps that contains `row`. Blocks do not depend on the other tests of a
    /// batch.
    pub(crate) fn block_end(&self, row: usize, steps: usize) -> usize {
        let start = |run: usize| if run == 0 { (0, 0, 0) } else { self.runs[run - 1].ends() };
        let run = self.runs.partition_point(|run| run.rows <= row);
        let ((lines, rows, first), own) = (start(run), &self.runs[run]);
        let step = first + (row - rows) / (own.lines - lines);
        let last = (step / steps + 1) * steps;
        let run = self.runs.partition_point(|run| run.steps <= last);
        let ((lines, rows, first), Some(own)) = (start(run), self.runs.get(run)) else { return self.rows() };
        rows + (last - first) * (own.lines - lines)
    }

    /// The transition of a run.
    #[inline(always)]
    pub(crate) fn transition(&self, run: &EqualSteps) -> Option<&Arc<Transition>> {
        run.transition.map(|number| &self.moves[number as usize])
    }

    /// Number of scalar measurements.
    pub(crate) fn rows(&self) -> usize {
        self.runs.last().map_or(0, |run| run.rows)
    }

    /// Number of steps.
    pub fn steps(&self) -> usize {
        self.runs.last().map_or(0, |run| run.steps)
    }

    /// Step `k`, counted from 0.
    pub fn step(&self, k: usize) -> DesignStep<'_> {
        // without equal steps, step k is run k
        let own = self.runs.get(k).is_some_and(|run| run.steps == k + 1);
        let run_index = if own { k } else { self.runs.partition_point(|run| run.steps <= k) };
        let run = &self.runs[run_index];
        let (line, row) =
            if run_index == 0 { (0, 0) } else { (self.runs[run_index - 1].lines, self.runs[run_index - 1].rows) };
        let first = row + (k + run.count - run.steps) * (run.lines - line);
        let rows = first..first + run.lines - line;
        DesignStep { transition: self.transition(run), lines: line..run.lines, rows }
    }

    /// The runs as stretches, in order.
    pub(crate) fn stretches(&self) -> impl DoubleEndedIterator<Item = Stretch<'_>> {
        (0..self.runs.len()).map(|run_index| self.stretch(run_index))
    }

    /// The run with this index, counted from 0, as a stretch.
    pub(crate) fn stretch(&self, run_index: usize) -> Stretch<'_> {
        let run = &self.runs[run_index];
        let (line, row) =
            if run_index == 0 { (0, 0) } else { (self.runs[run_index - 1].lines, self.runs[run_index - 1].rows) };
        Stretch { transition: self.transition(run), lines: line..run.lines, count: run.count, rows: row..run.rows }
    }

    /// All steps, in order.
    pub fn each_step(&self) -> impl DoubleEndedIterator<Item = DesignStep<'_>> {
        self.stretches().flat_map(|stretch| stretch.steps())
    }

    /// Appends a step as a new run; the lines of the step are already appended.
    pub(crate) fn push_step(&mut self, transition: Option<&Arc<Transition>>) {
        let (line, row, step) = self.runs.last().map_or((0, 0, 0), |run| (run.lines, run.rows, run.steps));
        let lines = self.ends.len();
        let transition = transition.map(|transition| {
            if !self.is_last_transition(transition) {
                self.moves.push(transition.clone());
            }
            self.moves.len() as u32 - 1
        });
        self.runs.push(EqualSteps { transition, lines, count: 1, rows: row + lines - line, steps: step + 1 });
    }

    /// True if `transition` and the last transition are one object.
    ///
    /// Transitions with different coefficients, or over different times, can have equal entries but different
    /// derivatives.
    #[inline]
    fn is_last_transition(&self, transition: &Arc<Transition>) -> bool {
        self.moves.last().is_some_and(|last| Arc::ptr_eq(last, transition))
    }

    /// Appends `many` more steps equal to the last step.
    pub(crate) fn repeat(&mut self, many: usize) {
        let run_index = self.runs.len() - 1;
        let lines_before = if run_index == 0 { 0 } else { self.runs[run_index - 1].lines };
        let run = &mut self.runs[run_index];
        run.count += many;
        run.steps += many;
        run.rows += many * (run.lines - lines_before);
    }

    /// [`Design::push_step`], except that a step equal to the last step, with one transition object for both, joins the
    /// last run.
    #[inline]
    pub(crate) fn join_step(&mut self, transition: Option<&Arc<Transition>>) {
        if self.is_repeated(transition) {
            let line = self.runs[self.runs.len() - 1].lines;
            let term = if line == 0 { 0 } else { self.ends[line - 1] };
            self.ends.truncate(line);
            self.noise.truncate(line);
            self.states.truncate(term);
            self.h.truncate(term);
            self.repeat(1);
        } else {
            self.push_step(transition);
        }
    }

    /// True if `transition` and the lines that belong to no run yet equal the transition and the lines of the last run.
    #[inline]
    fn is_repeated(&self, transition: Option<&Arc<Transition>>) -> bool {
        let Some(run_index) = self.runs.len().checked_sub(1) else { return false };
        let (lines, appended_lines) = (self.stretch(run_index).lines, self.runs[run_index].lines..self.ends.len());
        let same_transition = match (self.runs[run_index].transition, transition) {
            (Some(_), Some(transition)) => self.is_last_transition(transition),
            (None, None) => true,
            _ => false,
        };
        let terms = |lines: &Range<usize>| {
            let start = |line: usize| if line == 0 { 0 } else { self.ends[line - 1] };
            start(lines.start)..start(lines.end)
        };
        let (old, new) = (terms(&lines), terms(&appended_lines));
        let same_shape = || {
            let length = |line: usize| self.terms(line).0.len();
            lines.clone().zip(appended_lines.clone()).all(|(a, b)| length(a) == length(b))
        };
        lines.len() == appended_lines.len()
            && same_transition
            && old.len() == new.len()
            && same_bits(&self.h[old.clone()], &self.h[new.clone()])
            && same_shape()
            && self.states[old] == self.states[new]
            && same_bits(&self.noise[lines], &self.noise[appended_lines])
    }

    /// True if the steps of two runs are equal, with one transition object for both.
    pub(crate) fn same_steps(&self, run: usize, other: usize) -> bool {
        let (one, two) = (self.stretch(run), self.stretch(other));
        let same_transition = match (one.transition, two.transition) {
            (Some(one), Some(two)) => Arc::ptr_eq(one, two),
            (one, two) => one.is_none() && two.is_none(),
        };
        let same_line = |(a, b)| {
            let ((states, h), (other_states, other_h)) = (self.terms(a), self.terms(b));
            states == other_states && same_bits(h, other_h) && same_bits(&self.noise[a..=a], &self.noise[b..=b])
        };
        same_transition && one.lines.len() == two.lines.len() && one.lines.zip(two.lines).all(same_line)
    }

    /// Memory in bytes, without the transitions.
    pub(crate) fn bytes(&self) -> usize {
        8 * (self.variance.len() + 6 * self.runs.len() + self.ends.len() + 2 * self.h.len() + self.noise.len()) + 200
    }
}

/// True if the numbers are equal bit for bit.
pub fn same_bits(a: &[f64], b: &[f64]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(x, y)| x.to_bits() == y.to_bits())
}
