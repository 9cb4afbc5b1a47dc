//! Which tests inform and observe each state (theory §5, the paper's 2.3).
//!
//! A test informs a state when the measurements of the test depend on the state (row of J not zero), and observes the
//! state when the test alone could estimate it (the unit vector of the state is in the range of J). The mean of a state
//! is then known from
//!
//! ```text
//! I = Σ_j W_j        variance of μ̂_i = u'Iu with u = I⁺e_i = Σ_j u'W_ju
//! ```
//!
//! on the free directions of μ: the share of test j of the information on the mean is the term u'W_ju of this sum. A
//! direction of the mean is weakly determined, that is nearly unobserved, when the condition index of the direction
//! (Belsley, Kuh, Welsch 1980), √(λ_max / λ) of I scaled to unit diagonal, exceeds [`WEAK`]. No share or condition
//! index depends on units.

use std::borrow::Cow;
use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use crate::direction::{ZERO_EIGENVALUE, in_units};
use crate::observed::{MAX_UNINFORMED_PART, column_norm, observe};
use kalfit_algebra::fold::fold;
use kalfit_algebra::symmetric;
use kalfit_estimate::{Classes, CoordinateForm, PhaseForm, Point, Problem, Summed, map_forms};
use kalfit_filter::reduce::Reductions;
use kalfit_model::remote::Coordinates;

/// Condition index beyond which a direction of the mean is weakly determined; 30 is Belsley, Kuh and Welsch's "strong".
pub const WEAK: f64 = 30.0;
/// Largest number of tests whose ids are listed.
pub const MOST_TESTS: usize = 20;
/// A column of R counts as rounding error if its norm is below this fraction of the largest norm of this column over
/// the tests.
const MIN_COLUMN_FRACTION: f64 = 1e-12;

/// How well the ensemble determines the estimated states and the mean.
#[derive(Debug, Clone, PartialEq)]
pub struct Observability {
    /// Observability of each element of μ.
    pub states: Vec<StateObservability>,
    /// Number of tests that inform both state i and state k, p × p by rows.
    pub together: Vec<Vec<usize>>,
    /// Weakly determined directions of the mean, the worst first.
    pub weak: Vec<WeakDirection>,
    /// Blocks of Σ that too few tests inform.
    pub shortages: Vec<Shortage>,
}

/// How well the ensemble determines one state.
#[derive(Debug, Clone, PartialEq)]
pub struct StateObservability {
    /// Number of tests whose measurements depend on the state.
    pub informed_by: usize,
    /// Number of tests each of which alone could estimate the state.
    pub observed_by: usize,
    /// Sorted ids of the tests that inform the state, for at most [`MOST_TESTS`] tests; else empty.
    pub tests: Vec<String>,
    /// The test with the largest share of the information on the state's mean; `None` where the mean is fixed or not
    /// identified. Regression coefficients are taken as known.
    pub leading: Option<Leading>,
}

/// A test, and the test's share of the information.
#[derive(Debug, Clone, PartialEq)]
pub struct Leading {
    /// Id of the test; among several with equal shares, the first by id.
    pub test: String,
    /// Share of the test, 0 to 1.
    pub share: f64,
}

/// A weakly determined direction of the mean.
#[derive(Debug, Clone, PartialEq)]
pub struct WeakDirection {
    /// A unit vector in the user's units (p).
    pub direction: Vec<f64>,
    /// Condition index of the direction.
    pub condition: f64,
    /// The test with the most information on the direction.
    pub leading: Option<Leading>,
}

/// A block of Σ whose estimate must be singular: `tests` tests allow at most rank `rank`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Shortage {
    /// Elements of the block that any test informs.
    pub states: Vec<usize>,
    /// Number of tests that inform any of these states.
    pub tests: usize,
    /// Highest rank that the block can have: one less than `tests` when a mean is free, for then Σ r_j = 0 in GΣ = 0.
    pub rank: usize,
}

/// The classes of the tests, and which states each class informs and observes.
struct ClassViews<'a> {
    classes: &'a Classes,
    reductions: &'a Reductions,
    /// Whether the class informs each state: p entries for each class in turn.
    informs: Vec<bool>,
    observes: Vec<bool>,
}

/// One class of tests, and which states the tests inform and observe.
struct ClassView<'a> {
    /// Indices of the tests, in the order of the tests' ids.
    tests: &'a [usize],
    informs: &'a [bool],
    observes: &'a [bool],
}

pub(crate) fn observability(
    problem: &Problem,
    point: &Point,
    weight: &DMatrix<f64>,
    reductions: &Reductions,
) -> Observability {
    if problem.classes.remote.is_some() {
        return remote_observability(problem, weight);
    }
    let p = problem.classes.dimension();
    let classes = problem.classes.of(reductions);
    let designs = ClassViews::new(&classes, reductions);
    let shares = Shares { problem, point, designs: &designs };
    let (known, weak) = known_and_weak(problem, weight);
    let mut directions: Vec<DVector<f64>> = known.iter().flatten().cloned().collect();
    directions.extend(weak.iter().map(|(direction, _)| direction.clone()));
    let mut leading = shares.leading(&directions).into_iter();
    let states = (0..p)
        .map(|i| StateObservability {
            informed_by: designs.count(|d| d.informs[i]),
            observed_by: designs.count(|d| d.observes[i]),
            tests: designs.listed(|d| d.informs[i]),
            leading: known[i].as_ref().and_then(|_| leading.next().expect("one for each direction")),
        })
        .collect();
    let weak = weak.into_iter().map(|own| out(problem, own, leading.next().expect("one for each direction")));
    Observability {
        states,
        weak: weak.collect(),
        together: designs.together(p),
        shortages: shortages(problem, &designs),
    }
}

/// Observability from remote tests: numbers of tests only, without ids.
fn remote_observability(problem: &Problem, weight: &DMatrix<f64>) -> Observability {
    let p = problem.classes.dimension();
    let counts = problem
        .remote_counts()
        .filter(|numbers| numbers.len() == p * (p + 2))
        .unwrap_or_else(|| vec![0.0; p * (p + 2)]);
    let count = |at: usize| counts[at] as usize;
    let (_, weak) = known_and_weak(problem, weight);
    let state = |i: usize| StateObservability {
        informed_by: count(i),
        observed_by: count(p + i),
        tests: Vec::new(),
        leading: None,
    };
    let weak = weak.into_iter().map(|own| out(problem, own, None));
    Observability {
        states: (0..p).map(state).collect(),
        together: (0..p).map(|i| (0..p).map(|k| count(p * (2 + i) + k)).collect()).collect(),
        weak: weak.collect(),
        shortages: Vec::new(),
    }
}

/// A shard's answer to `Question::Observability`: number of tests that inform each state (p), that observe each state
/// (p), and that inform both of two states (p × p by rows); `None` where `frame` does not fit the model of the shard.
pub fn observability_counts(summed: &mut Summed, frame: &Coordinates) -> Option<Vec<f64>> {
    let p = frame.centre.len();
    let reductions = summed.reductions.clone();
    let classes = summed.apart(frame)?;
    let designs = ClassViews::new(&classes, &reductions);
    let informed = (0..p).map(|i| designs.count(|d| d.informs[i]));
    let observed = (0..p).map(|i| designs.count(|d| d.observes[i]));
    let together = designs.together(p);
    Some(informed.chain(observed).chain(together.into_iter().flatten()).map(|n| n as f64).collect())
}

impl Observability {
    /// Sorted ids of the tests that inform any of these states, for at most [`MOST_TESTS`] tests; else empty.
    pub(super) fn tests_of(&self, states: &[usize]) -> Vec<String> {
        let of = || states.iter().map(|&i| &self.states[i]);
        if of().any(|state| state.informed_by > MOST_TESTS) {
            return Vec::new();
        }
        let mut all: Vec<String> = of().flat_map(|state| state.tests.iter().cloned()).collect();
        all.sort();
        all.dedup();
        if all.len() > MOST_TESTS { Vec::new() } else { all }
    }
}

impl<'a> ClassViews<'a> {
    fn new(classes: &'a Classes, reductions: &'a Reductions) -> ClassViews<'a> {
        let (p, count) = (classes.dimension(), classes.len());
        let first = |class: usize| class_factor(classes, reductions, class);
        let mut norms = vec![0.0; count * p];
        norms.par_chunks_mut(p.max(1)).enumerate().for_each(|(class, norms)| {
            let factor = first(class);
            norms.iter_mut().enumerate().for_each(|(k, to)| *to = column_norm(&factor, k));
        });
        let mut largest = vec![0.0_f64; p];
        for norms in norms.chunks_exact(p.max(1)) {
            largest.iter_mut().zip(norms).for_each(|(most, norm)| *most = most.max(*norm));
        }
        let informs: Vec<bool> =
            norms.iter().enumerate().map(|(at, norm)| *norm > MIN_COLUMN_FRACTION * largest[at % p]).collect();
        let mut observes = informs.clone();
        observes.par_chunks_mut(p.max(1)).enumerate().for_each(|(class, observes)| {
            observe(&first(class), &informs[class * p..][..p], observes);
        });
        ClassViews { classes, reductions, informs, observes }
    }

    /// Iterator over the classes.
    fn iter(&self) -> impl Iterator<Item = ClassView<'_>> {
        let p = self.classes.dimension();
        (0..self.classes.len()).map(move |class| ClassView {
            tests: self.classes.tests_of(class),
            informs: &self.informs[class * p..][..p],
            observes: &self.observes[class * p..][..p],
        })
    }

    /// Number of tests in the classes that `of` selects.
    fn count(&self, of: impl Fn(&ClassView<'_>) -> bool) -> usize {
        self.iter().filter(of).map(|design| design.tests.len()).sum()
    }

    /// Sorted ids of the tests in the classes that `of` selects, for at most [`MOST_TESTS`] tests; else empty.
    fn listed(&self, of: impl Fn(&ClassView<'_>) -> bool) -> Vec<String> {
        let tests = self.iter().filter(of).flat_map(|design| design.tests).take(MOST_TESTS + 1);
        let mut ids: Vec<String> = tests.map(|&test| self.reductions.id(test).to_owned()).collect();
        if ids.len() > MOST_TESTS {
            return Vec::new();
        }
        ids.sort();
        ids
    }

    /// Number of tests that inform both state i and state k, p × p.
    fn together(&self, p: usize) -> Vec<Vec<usize>> {
        let mut count_by_pattern: BTreeMap<&[bool], usize> = BTreeMap::new();
        self.iter().for_each(|design| *count_by_pattern.entry(design.informs).or_default() += design.tests.len());
        let both = |i: usize, k: usize| {
            count_by_pattern.iter().filter(|(informs, _)| informs[i] && informs[k]).map(|(_, tests)| tests).sum()
        };
        (0..p).map(|i| (0..p).map(|k| both(i, k)).collect()).collect()
    }
}

/// R of a class, packed by columns; exact measurements of the class's tests count as rows of R.
fn class_factor<'a>(classes: &Classes, reductions: &'a Reductions, class: usize) -> Cow<'a, [f64]> {
    let first = classes.tests_of(class)[0];
    if reductions.exact(first).is_none() {
        return Cow::Borrowed(reductions.factor(first));
    }
    let (p, scale) = (classes.dimension(), &classes.frame.scale);
    let mut rows = classes.single(reductions, first).factor;
    let mut upper = vec![0.0; p * p];
    fold(&mut upper, &mut rows, p);
    (0..p).flat_map(|k| (0..=k).map(move |i| (i, k))).map(|(i, k)| upper[i * p + k] / scale[k]).collect()
}

/// A direction of the mean in η and its condition index.
type ConditionedDirection = (DVector<f64>, f64);

/// A weak direction in the user's units.
fn out(problem: &Problem, (direction, condition): ConditionedDirection, leading: Option<Leading>) -> WeakDirection {
    WeakDirection { direction: in_units(&direction, problem.classes.frame.scale.iter()), condition, leading }
}

/// For each element of μ the direction I⁺e_i, `None` unless the element is free and identified; and the weak
/// directions, all in η.
fn known_and_weak(problem: &Problem, weight: &DMatrix<f64>) -> (Vec<Option<DVector<f64>>>, Vec<ConditionedDirection>) {
    let basis = &problem.mean.basis;
    let (p, q) = basis.shape();
    let information = basis.transpose() * weight * basis;
    let scale = DVector::from_fn(q, |i, _| match information[(i, i)] {
        own if own > 0.0 => own.sqrt().recip(),
        _ => 0.0,
    });
    let scaled = DMatrix::from_fn(q, q, |i, k| scale[i] * information[(i, k)] * scale[k]);
    let (values, vectors) = symmetric::eigen(&scaled);
    let largest = values.last().copied().unwrap_or(0.0);
    let seen = |k: &usize| values[*k] >= ZERO_EIGENVALUE;
    let out = |v: DVector<f64>| basis * v.component_mul(&scale);
    let weak = (0..q).filter(seen).map(|k| (k, (largest / values[k]).sqrt())).filter(|(_, index)| *index > WEAK);
    let weak = weak.map(|(k, index)| (out(vectors.column(k).into()), index)).collect();
    let known = |i: usize| {
        let element: DVector<f64> = basis.row(i).transpose().component_mul(&scale);
        let mut solution = DVector::zeros(q);
        let mut residual = element.clone();
        for k in (0..q).filter(seen) {
            let along = vectors.column(k).dot(&element);
            solution.axpy(along / values[k], &vectors.column(k), 1.0);
            residual.axpy(-along, &vectors.column(k), 1.0);
        }
        let identified = basis.row(i).norm() > 0.0
            && element.norm() > 0.0
            && residual.norm() <= MAX_UNINFORMED_PART * element.norm();
        identified.then(|| out(solution))
    };
    ((0..p).map(known).collect(), weak)
}

/// Finds the tests with the largest share of the information on directions of the mean.
struct Shares<'a> {
    problem: &'a Problem,
    point: &'a Point,
    designs: &'a ClassViews<'a>,
}

impl Shares<'_> {
    /// For each direction u the test with the largest u'W_ju, and the share of this term of the sum over the tests.
    fn leading(&self, directions: &[DVector<f64>]) -> Vec<Option<Leading>> {
        let ClassViews { classes, reductions, .. } = self.designs;
        let p = classes.dimension();
        let mut all = InformationSums::none(directions.len());
        let directions = DMatrix::from_fn(p, directions.len(), |i, c| directions[c][i]);
        let (regressors, point) = (&self.problem.mean.regressors, self.point);
        let none = || InformationSums::none(directions.ncols());
        let parts = map_forms(classes, (regressors, point), &directions, &none, &|parts, k, forms| {
            let tests = classes.tests_of(k);
            for (c, &own) in forms.iter().enumerate() {
                parts.totals[c] += own * tests.len() as f64;
                parts.keep_larger(c, own, || reductions.id(tests[0]));
            }
        });
        parts.into_iter().for_each(|parts| all.add(parts));
        let InformationSums { totals, best } = all;
        let share = |(best, total): (Option<(f64, &str)>, f64)| {
            best.map(|(own, id)| Leading { test: id.to_owned(), share: (own / total).min(1.0) })
        };
        best.into_iter().zip(totals).map(share).collect()
    }
}

/// For each direction u the sum of u'W_ju over tests, and the largest term with the id of the test.
struct InformationSums<'a> {
    totals: Vec<f64>,
    best: Vec<Option<(f64, &'a str)>>,
}

impl<'a> InformationSums<'a> {
    fn none(directions: usize) -> InformationSums<'a> {
        InformationSums { totals: vec![0.0; directions], best: vec![None; directions] }
    }

    fn add(&mut self, other: InformationSums<'a>) {
        self.totals.iter_mut().zip(&other.totals).for_each(|(sum, part)| *sum += part);
        for (c, best) in other.best.into_iter().enumerate() {
            if let Some((own, test)) = best {
                self.keep_larger(c, own, || test);
            }
        }
    }

    /// Replaces the best term by a larger one, or by an equal one of a smaller id; `test` returns the id.
    fn keep_larger(&mut self, c: usize, own: f64, test: impl Fn() -> &'a str) {
        let better = |&(most, id): &(f64, &str)| own > most || (own >= most && test() < id);
        if own > 0.0 && self.best[c].as_ref().is_none_or(better) {
            self.best[c] = Some((own, test()));
        }
    }
}

/// Blocks of Σ, in parts without constraints, that too few tests inform for a regular estimate.
fn shortages(problem: &Problem, designs: &ClassViews<'_>) -> Vec<Shortage> {
    let map = &problem.covariance;
    let unconstrained = |part: &&PhaseForm| map.of_part(part).constraints.is_empty();
    let blocks = map.parts.iter().filter(unconstrained).flat_map(|part| match &part.form {
        CoordinateForm::Factor(blocks) => blocks.as_slice(),
        _ => &[],
    });
    let shortage = |block: &Vec<usize>| {
        let seen = |i: &usize| designs.count(|d| d.informs[*i]) > 0;
        let states: Vec<usize> = block.iter().copied().filter(seen).collect();
        let tests = designs.count(|d| states.iter().any(|&i| d.informs[i]));
        let free = states.iter().any(|&i| problem.mean.basis.row(i).norm() > 0.0);
        Shortage { states, tests, rank: tests.saturating_sub(usize::from(free)) }
    };
    blocks.map(shortage).filter(|s| s.tests > 0 && s.rank < s.states.len()).collect()
}
