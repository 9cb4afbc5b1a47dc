//! The rows of a segment: the covariance filter over equal steps from a known state, P = 0 and Ψ = I.
#![expect(non_snake_case, reason = "the letters of the theory: P, Psi, J, K, T, S")]

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use kalfit_lanes::{Isa, Kernel, Lanes};

use crate::reduce::covariance_filter::CovarianceFilter;
use crate::reduce::design::{DENSE, Design, StateFrame, Stretch, ZERO};
use crate::reduce::digest::Digest;
use crate::reduce::entries::Common;
use crate::reduce::segments::{MAX_STATES, Square};

/// Magnitude of Ψ below which an entry is set to zero: smaller numbers underflow in products, and underflowing numbers
/// are slow.
const FADED: f64 = 1e-150;

/// Gains and moments of the first rows of a segment. As every segment of equal steps starts from a known state,
/// segments of all lengths up to that of the prefix share its numbers.
#[derive(Debug, Clone)]
pub(crate) struct Prefix {
    /// The states of a segment, by position in kernel order, ascending: N states that noise reaches, that move, or that
    /// the measurement or a moving state depends on.
    pub(crate) states: Vec<usize>,
    /// φ, N × N, row-major.
    pub(crate) phi: Vec<f64>,
    /// Whether φ and Q are diagonal.
    pub(crate) diagonal: bool,
    /// h, N numbers.
    pub(crate) h: Vec<f64>,
    /// (K, T'/S, 1/S) of each row, 2N + 1 numbers.
    pub(crate) gains: Vec<f64>,
    /// (P, Ψ, J) after each number of rows, beginning with none, 3N² numbers.
    moments: Vec<f64>,
    /// Σ log S over the first rows, beginning with none.
    log_determinants: Vec<f64>,
}

/// Moments after the first rows of a segment.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PrefixMoments<const N: usize> {
    /// Covariance of the state.
    pub(crate) P: Square<N>,
    /// Sensitivity of the filtered state to the state before the rows.
    pub(crate) Psi: Square<N>,
    /// Information of the rows about the state before them.
    pub(crate) J: Square<N>,
}

impl Prefix {
    /// The prefix of `rows` rows of the steps of a stretch; `None` where plain covariances lose too many digits, or S
    /// vanishes.
    pub(super) fn new(design: &Design, stretch: &Stretch<'_>, rows: usize) -> Option<Prefix> {
        let states = states_of(design, stretch).filter(|states| states.len() <= MAX_STATES)?;
        let N = states.len();
        let mut prefix = Prefix {
            phi: phi_of(stretch, &states),
            diagonal: stretch.transition.is_none_or(|transition| transition.pattern.is_diagonal()),
            h: vec![0.0; N],
            gains: Vec::with_capacity(rows * (2 * N + 1)),
            moments: Vec::with_capacity((rows + 1) * 3 * N * N),
            log_determinants: Vec::with_capacity(rows + 1),
            states,
        };
        let (terms, h) = design.terms(stretch.lines.start);
        for (&state, &h) in terms.iter().zip(h) {
            let at = prefix.place(state as usize).expect("the states of a segment include those of the measurement");
            prefix.h[at] = h;
        }
        let frame = prefix.frame(&design.frame);
        let is_accurate =
            Isa::best().alone().run(PrefixPass { design, stretch, frame: &frame, rows, out: &mut prefix });
        is_accurate.then_some(prefix)
    }

    /// N, number of states.
    pub(crate) fn size(&self) -> usize {
        self.states.len()
    }

    /// Number of rows.
    pub(crate) fn rows(&self) -> usize {
        self.log_determinants.len() - 1
    }

    /// Place of a state, given by its position in kernel order, among the states of a segment.
    pub(crate) fn place(&self, state: usize) -> Option<usize> {
        self.states.binary_search(&state).ok()
    }

    /// Moments after the first `rows` rows.
    pub(crate) fn after<const N: usize>(&self, rows: usize) -> PrefixMoments<N> {
        let size = N * N;
        let square = |k: usize| Square::from_row_slice(&self.moments[(3 * rows + k) * size..][..size]);
        PrefixMoments { P: square(0), Psi: square(1), J: square(2) }
    }

    /// P after the first `rows` rows, N × N, by rows.
    pub(crate) fn variance(&self, rows: usize) -> &[f64] {
        let size = self.size() * self.size();
        &self.moments[3 * rows * size..][..size]
    }

    /// Ψ after the first `rows` rows, N × N, by rows.
    pub(crate) fn sensitivity(&self, rows: usize) -> &[f64] {
        let size = self.size() * self.size();
        &self.moments[(3 * rows + 1) * size..][..size]
    }

    /// Σ log S over the first `rows` rows.
    pub(crate) fn log_determinant(&self, rows: usize) -> f64 {
        self.log_determinants[rows]
    }

    /// Memory in bytes.
    pub(crate) fn bytes(&self) -> usize {
        8 * (self.gains.len() + self.moments.len() + self.log_determinants.len() + 2 * self.phi.len())
    }

    /// The frame of a segment, in which the state before the segment is the unknown ξ.
    fn frame(&self, frame: &StateFrame) -> StateFrame {
        let N = self.size();
        let (mut rows, mut sensitivity) = (vec![ZERO; frame.n], vec![0.0; frame.n * N]);
        for (k, &state) in self.states.iter().enumerate() {
            sensitivity[state * N + k] = 1.0;
            let constant = state >= frame.r && (0..N).all(|j| self.phi[k * N + j] == f64::from(u8::from(j == k)));
            rows[state] = if constant { k as u32 } else { DENSE };
        }
        StateFrame { p: N, rows, sensitivity, ..frame.clone() }.seal()
    }
}

/// Positions of the states of a segment: those that noise reaches or that move, and those that the measurement or the
/// transition reads. `None` for a stretch that is not made of steps of one scalar measurement without known inputs.
fn states_of(design: &Design, stretch: &Stretch<'_>) -> Option<Vec<usize>> {
    let moving = design.moving_in_equal_steps(stretch, 0)?;
    let read = stretch.transition.iter().flat_map(|transition| transition.entries().map(|(_, j, _)| j));
    let measured = design.terms(stretch.lines.start).0.iter().map(|&state| state as usize);
    let mut states: Vec<usize> = (0..moving).chain(read).chain(measured).collect();
    states.sort_unstable();
    states.dedup();
    Some(states)
}

/// φ of the states of a segment, row-major.
fn phi_of(stretch: &Stretch<'_>, states: &[usize]) -> Vec<f64> {
    let N = states.len();
    let mut phi = vec![0.0; N * N];
    (0..N).for_each(|i| phi[i * N + i] = 1.0);
    let Some(transition) = stretch.transition else { return phi };
    let place = |state: usize| states.binary_search(&state).expect("the states include those of the transition");
    for row in &transition.pattern.moved {
        phi[place(row.state as usize) * N..][..N].fill(0.0);
    }
    for (i, j, x) in transition.entries() {
        phi[place(i) * N + place(j)] = x;
    }
    phi
}

/// The covariance filter over the rows of a prefix, as a kernel. The result is whether no digits were lost.
struct PrefixPass<'a> {
    design: &'a Design,
    stretch: &'a Stretch<'a>,
    frame: &'a StateFrame,
    rows: usize,
    out: &'a mut Prefix,
}

impl Kernel for PrefixPass<'_> {
    type Output = bool;

    #[inline(always)]
    fn run<T: Lanes>(self) -> bool {
        let PrefixPass { design, stretch, frame, rows, out } = self;
        let N = frame.p;
        let known = vec![0.0; frame.r * frame.r];
        let mut filter = CovarianceFilter::<T>::new(frame, Common(&known));
        let (terms, h) = design.terms(stretch.lines.start);
        let noise = T::splat(design.noise[stretch.lines.start]);
        let mut log_determinant = 0.0;
        out.push_moments(frame.r, &filter, log_determinant);
        for _ in 0..rows {
            if let Some(transition) = stretch.transition {
                filter.predict(frame, transition.common());
            }
            let update = filter.measure(frame, (terms, Common(h), noise));
            for Psi in &mut filter.Psi {
                if Psi.lane(0).abs() < FADED {
                    *Psi = T::splat(0.0);
                }
            }
            let weight = update.weight.lane(0);
            for k in 0..N {
                out.gains.push(if out.states[k] < frame.r { filter.K[out.states[k]].lane(0) } else { 0.0 });
            }
            for k in 0..N {
                out.gains.push(weight * filter.T[k].lane(0));
            }
            out.gains.push(weight);
            log_determinant += update.S.lane(0).ln();
            out.push_moments(frame.r, &filter, log_determinant);
        }
        let mut sums = Vec::new();
        filter.sums.lanes(&mut sums);
        let mut total = crate::reduce::sums::InformationSums::new(N);
        total.take_lane(&sums, 0, T::COUNT);
        total.is_accurate()
    }
}

impl Prefix {
    #[inline(always)]
    fn push_moments<T: Lanes>(&mut self, r: usize, filter: &CovarianceFilter<T>, log_determinant: f64) {
        let N = self.size();
        for &i in &self.states {
            for &j in &self.states {
                self.moments.push(if i.max(j) < r { filter.P[i.max(j) * r + i.min(j)].lane(0) } else { 0.0 });
            }
        }
        for &i in &self.states {
            for k in 0..N {
                self.moments.push(filter.Psi[i * N + k].lane(0));
            }
        }
        for i in 0..N {
            for j in 0..N {
                let (low, high) = (i.min(j), i.max(j));
                self.moments.push(filter.sums.J[low + high * (high + 1) / 2].lane(0));
            }
        }
        self.log_determinants.push(log_determinant);
    }
}

/// The prefixes of a model at α: steps of any designs that are equal share one.
#[derive(Debug, Default)]
pub(crate) struct Prefixes(Mutex<HashMap<u128, Option<Arc<Prefix>>>>);

impl Prefixes {
    /// The prefix of `rows` rows of the steps of a stretch.
    pub(super) fn of(&self, design: &Design, stretch: &Stretch<'_>, rows: usize) -> Option<Arc<Prefix>> {
        let key = digest(design, stretch, rows);
        let known = self.0.lock().unwrap_or_else(PoisonError::into_inner).get(&key).cloned();
        known.unwrap_or_else(|| {
            let prefix = Prefix::new(design, stretch, rows).map(Arc::new);
            self.0.lock().unwrap_or_else(PoisonError::into_inner).entry(key).or_insert(prefix).clone()
        })
    }
}

/// Digest of all that a prefix depends on.
fn digest(design: &Design, stretch: &Stretch<'_>, rows: usize) -> u128 {
    let mut digest = Digest::new();
    digest.wide(design.frame.digest);
    digest.wide(stretch.transition.map_or(0, |transition| transition.digest()));
    let (states, h) = design.terms(stretch.lines.start);
    states.iter().for_each(|&state| digest.word(u64::from(state)));
    digest.numbers(h);
    digest.numbers(&design.noise[stretch.lines.clone()]);
    digest.count(rows);
    digest.finish()
}
