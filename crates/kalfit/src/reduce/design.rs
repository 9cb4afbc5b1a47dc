//! The design of a test: all that S, K, T, P and J depend on, in the order of states that suits the kernels.
//!
//! Kernel order: noise-reachable states first (those that P0 or process noise ever reaches; P lives on them alone),
//! then other states that move, then those that never move. Random constants of the last kind live only in Ψ.

use std::sync::Arc;

use crate::linalg::real::Real;
use crate::reduce::digest::Digest;

/// Row of Ψ that is dense.
pub(crate) const DENSE: u32 = u32::MAX;
/// Row of Ψ that is zero, always.
pub(crate) const ZERO: u32 = u32::MAX - 1;

/// What the tests of a model share.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Frame {
    /// n, number of states.
    pub(crate) n: usize,
    /// p, number of uncertain initial values ξ.
    pub(crate) p: usize,
    /// Number of noise-reachable states.
    pub(crate) r: usize,
    /// For each state the column of ξ whose unit vector its row of Ψ always is, or [`DENSE`], or [`ZERO`].
    pub(crate) rows: Vec<u32>,
    /// A, n × p, row-major.
    pub(crate) sensitivity: Vec<f64>,
    /// States with a known input b.
    pub(crate) driven: Vec<u32>,
    /// Digest of the rest.
    pub(crate) digest: u128,
}

impl Frame {
    pub(crate) fn seal(mut self) -> Frame {
        let mut digest = Digest::new();
        digest.count(self.n);
        digest.count(self.p);
        digest.count(self.r);
        self.rows.iter().for_each(|&row| digest.word(u64::from(row)));
        digest.numbers(&self.sensitivity);
        self.digest = digest.finish();
        self
    }

    /// The same states without ξ.
    pub(crate) fn without_unknowns(&self) -> Frame {
        let frame = Frame { p: 0, rows: vec![ZERO; self.n], sensitivity: Vec::new(), ..self.clone() };
        frame.seal()
    }
}

/// A row of φ that is not a row of the identity.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Moved {
    pub(crate) state: u32,
    /// Terms start..end; those up to `reach` are of noise-reachable states.
    pub(crate) start: u32,
    pub(crate) reach: u32,
    pub(crate) end: u32,
}

/// Which entries of φ and Q a step has: no identity rows, no zeros. All transitions of a model have one.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Pattern {
    /// In ascending order of state.
    pub(crate) moved: Vec<Moved>,
    pub(crate) columns: Vec<u32>,
    /// Entries i ≥ j of Q.
    pub(crate) pairs: Vec<(u32, u32)>,
    digest: u128,
}

impl Pattern {
    /// Appends row `state` of φ, with terms of these states, ascending.
    pub(crate) fn push(&mut self, state: usize, reachable: usize, terms: impl Iterator<Item = usize>) {
        let start = self.columns.len() as u32;
        self.columns.extend(terms.map(|term| term as u32));
        let reach = self.columns[start as usize..].iter().filter(|&&term| (term as usize) < reachable).count() as u32;
        self.moved.push(Moved { state: state as u32, start, reach: start + reach, end: self.columns.len() as u32 });
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
        self
    }
}

/// φ and Q of one step.
#[derive(Debug, Clone)]
pub(crate) struct Transition<R = f64> {
    pub(crate) pattern: Arc<Pattern>,
    pub(crate) phi: Vec<R>,
    pub(crate) q: Vec<R>,
    pub(crate) digest: u128,
}

impl Transition<f64> {
    pub(crate) fn new(pattern: Arc<Pattern>, phi: Vec<f64>, q: Vec<f64>) -> Transition {
        let mut digest = Digest::new();
        digest.wide(pattern.digest);
        digest.numbers(&phi);
        digest.numbers(&q);
        Transition { digest: digest.finish(), pattern, phi, q }
    }

    fn same(&self, other: &Transition) -> bool {
        self.digest == other.digest
            && (Arc::ptr_eq(&self.pattern, &other.pattern) || self.pattern == other.pattern)
            && same_bits(&self.phi, &other.phi)
            && same_bits(&self.q, &other.q)
    }
}

/// One step: a transition, then scalar measurements.
#[derive(Debug, Clone)]
pub(crate) struct Step<R = f64> {
    pub(crate) transition: Option<Arc<Transition<R>>>,
    /// End of its rows in [`Design::rows`].
    pub(crate) rows: usize,
}

/// The design of a test, scalar measurements whitened.
#[derive(Debug, Clone)]
pub(crate) struct Design<R = f64> {
    pub(crate) frame: Arc<Frame>,
    /// P0 on the reachable states, r × r, row-major; the lower triangle counts.
    pub(crate) variance: Vec<R>,
    pub(crate) steps: Vec<Step<R>>,
    /// End of the terms of each scalar measurement.
    pub(crate) rows: Vec<usize>,
    /// States of the terms, ascending within a measurement.
    pub(crate) states: Vec<u32>,
    /// Their coefficients h.
    pub(crate) h: Vec<R>,
    /// R, one variance per scalar measurement.
    pub(crate) noise: Vec<R>,
}

impl<R: Real> Design<R> {
    pub(crate) fn new(frame: Arc<Frame>) -> Design<R> {
        let variance = vec![R::splat(0.0); frame.r * frame.r];
        Design {
            frame,
            variance,
            steps: Vec::new(),
            rows: Vec::new(),
            states: Vec::new(),
            h: Vec::new(),
            noise: Vec::new(),
        }
    }

    pub(crate) fn clear(&mut self) {
        self.variance.fill(R::splat(0.0));
        self.steps.clear();
        self.rows.clear();
        self.states.clear();
        self.h.clear();
        self.noise.clear();
    }

    /// (states, coefficients) of a scalar measurement.
    #[inline(always)]
    pub(crate) fn terms(&self, row: usize) -> (&[u32], &[R]) {
        let start = if row == 0 { 0 } else { self.rows[row - 1] };
        (&self.states[start..self.rows[row]], &self.h[start..self.rows[row]])
    }
}

impl Design<f64> {
    pub(crate) fn digest(&self) -> u128 {
        let mut digest = Digest::new();
        digest.wide(self.frame.digest);
        digest.numbers(&self.variance);
        digest.count(self.steps.len());
        for step in &self.steps {
            digest.count(step.rows);
            if let Some(transition) = &step.transition {
                digest.wide(transition.digest);
            }
        }
        for row in 0..self.rows.len() {
            let (states, h) = self.terms(row);
            states.iter().for_each(|&state| digest.word(u64::from(state)));
            digest.numbers(h);
        }
        digest.numbers(&self.noise);
        digest.finish()
    }

    /// Equal bit for bit.
    pub(crate) fn same(&self, other: &Design) -> bool {
        let same_steps = |(a, b): (&Step, &Step)| {
            a.rows == b.rows
                && match (&a.transition, &b.transition) {
                    (Some(a), Some(b)) => Arc::ptr_eq(a, b) || a.same(b),
                    (None, None) => true,
                    _ => false,
                }
        };
        (Arc::ptr_eq(&self.frame, &other.frame) || self.frame == other.frame)
            && self.steps.len() == other.steps.len()
            && self.steps.iter().zip(&other.steps).all(same_steps)
            && self.rows == other.rows
            && self.states == other.states
            && same_bits(&self.variance, &other.variance)
            && same_bits(&self.h, &other.h)
            && same_bits(&self.noise, &other.noise)
    }

    /// Bytes it occupies, transitions apart.
    pub(crate) fn bytes(&self) -> usize {
        8 * (self.variance.len() + 2 * self.steps.len() + self.rows.len() + 2 * self.h.len() + self.noise.len()) + 200
    }
}

fn same_bits(a: &[f64], b: &[f64]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(x, y)| x.to_bits() == y.to_bits())
}
