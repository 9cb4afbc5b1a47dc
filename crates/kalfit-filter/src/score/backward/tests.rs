//! Adjoints, compared with differences of the likelihood; and every path through a record, compared with the plain one.

use std::ops::Range;
use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use super::*;
use crate::reduce::{
    DENSE, Data, DataWorkspace, Design, Gains, GainsWork, Pattern, StateFrame, information_gains, outcome, root_gains,
};
use crate::reduce::{Terminal, Transition};
use crate::score::InitialLaw;
use crate::score::backward::work::SegmentLengths;
use crate::score::by_differences::likelihood;
use crate::score::moments::{Moments, moments};
use crate::score::smoother::{PhaseLaws, SmootherPlan};
use kalfit_fixtures::{near, slope};
use kalfit_model::Path;
use kalfit_model::Reduction;
use kalfit_model::{Inherited, PhaseReduction};

/// A test by hand with four states, of which the first two are noisy, and three unknowns; no two steps share
/// coefficients.
#[derive(Debug, Clone)]
struct Numbers {
    phi: Vec<Vec<f64>>,
    q: Vec<Vec<f64>>,
    h: Vec<f64>,
    noise: Vec<f64>,
    values: Vec<f64>,
    inputs: Vec<f64>,
    start: Vec<f64>,
    variance: Vec<f64>,
}

const STEPS: usize = 5;

fn design(numbers: &Numbers) -> (Design, Data) {
    let mut sensitivity = vec![0.0; 12];
    sensitivity[0] = 1.0;
    sensitivity[2 * 3 + 1] = 1.0;
    sensitivity[3 * 3 + 2] = 1.0;
    part(numbers, 0..STEPS, sensitivity)
}

/// A test of some of the steps, with the given sensitivities to the unknowns; the known start belongs to step 0.
fn part(numbers: &Numbers, steps: Range<usize>, sensitivity: Vec<f64>) -> (Design, Data) {
    let mut pattern = Pattern::default();
    pattern.push(0, 2, [0, 1, 3].into_iter());
    pattern.push(1, 2, [0, 1].into_iter());
    pattern.push(2, 2, [2, 3].into_iter());
    pattern.pairs = vec![(0, 0), (1, 0), (1, 1)];
    let pattern = Arc::new(pattern.seal());
    let p = sensitivity.len() / 4;
    let frame = StateFrame { n: 4, p, r: 2, rows: vec![DENSE; 4], sensitivity, driven: vec![0, 2], digest: 0 };
    let mut design = Design::new(Arc::new(frame.seal()));
    if steps.start == 0 {
        design.variance.copy_from_slice(&numbers.variance);
    }
    for k in steps.clone() {
        let (phi, q) = (numbers.phi[k].clone(), numbers.q[k].clone());
        let transition = (k > 0).then(|| Arc::new(Transition::new(pattern.clone(), phi, q)));
        for row in 2 * k..2 * k + 2 {
            design.states.extend(if row % 2 == 0 { vec![0, 1, 2] } else { vec![0, 3] });
            design.ends.push(design.states.len());
        }
        design.push_step(transition.as_ref());
    }
    let rows = 2 * steps.start..2 * steps.end;
    design.h = numbers.h[5 * steps.start..5 * steps.end].to_vec();
    design.noise = numbers.noise[rows.clone()].to_vec();
    let start = if steps.start == 0 { numbers.start.clone() } else { vec![0.0; 4] };
    let inputs = numbers.inputs[2 * steps.start.max(1)..2 * steps.end].to_vec();
    let values = numbers.values[rows.clone()].to_vec();
    (design, Data { start, inputs, values, sizes: vec![1.0; rows.len()] })
}

/// Work space of a design pass that keeps P and Ψ.
fn with_paths() -> GainsWork {
    GainsWork { keeps_paths: true, every_row: true, ..GainsWork::default() }
}

fn reduced(numbers: &Numbers) -> (Design, Data, Gains, Reduction) {
    let (design, data) = design(numbers);
    reduction_of(design, data)
}

fn reduction_of(design: Design, data: Data) -> (Design, Data, Gains, Reduction) {
    let plain = information_gains(&design, None, &mut with_paths());
    let gains = plain.unwrap_or_else(|| root_gains(&design, None, true).expect("semidefinite")); // a part need not determine its unknowns
    let reduction = reduction_by(&gains, &design, &data);
    (design, data, gains, reduction)
}

fn reduction_by(gains: &Gains, design: &Design, data: &Data) -> Reduction {
    let found = outcome(design, gains, data, &mut DataWorkspace::default()).expect("possible");
    Reduction {
        test: String::new(),
        constant: found.constant,
        residual: None,
        data: found.data,
        factor: gains.factor.clone(),
        covariates: Vec::new(),
        steps: design.steps(),
        observations: design.rows(),
        path: Path::Information,
        design: 0,
        chain: None,
        exact: None,
    }
}

fn law() -> InitialLaw {
    let root = DMatrix::from_row_slice(3, 2, &[0.8, 0.1, -0.3, 0.9, 0.4, 0.2]);
    InitialLaw::known(DVector::from_vec(vec![0.3, -0.2, 0.5]), root)
}

/// ℓ = log ∫ p(z | ξ) N(ξ; μ, FF') dξ, densely.
fn dense(numbers: &Numbers) -> f64 {
    likelihood(reduced(numbers).3.view(), &law())
}

#[derive(Default)]
struct AllAdjoints {
    noise: Vec<(usize, f64)>,
    value: Vec<(usize, f64)>,
    h: Vec<(usize, Vec<f64>)>,
    moved: Vec<(usize, TransitionAdjoint)>,
    mean: Vec<f64>,
    variance: Vec<f64>,
}

impl Sink for AllAdjoints {
    type Error = std::convert::Infallible;
    fn accepts_sums(&mut self, _: Range<usize>) -> bool {
        false
    }
    fn measured(&mut self, k: usize, bar: &MeasurementAdjoint) -> Result<(), Self::Error> {
        for i in 0..2 {
            self.noise.push((2 * k + i, bar.noise[i]));
            self.value.push((2 * k + i, bar.value[i]));
            self.h.push((2 * k + i, bar.h[i * 4..][..4].to_vec()));
        }
        Ok(())
    }
    fn moved(&mut self, k: usize, bar: &TransitionAdjoint) -> Result<(), Self::Error> {
        self.moved.push((k, bar.clone()));
        Ok(())
    }
    fn started(&mut self, mean: &[f64], variance: &[f64]) -> Result<(), Self::Error> {
        (self.mean, self.variance) = (mean.to_vec(), variance.to_vec());
        Ok(())
    }
}

fn numbers() -> Numbers {
    let mut seed = 7u64;
    let mut next = || {
        seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (seed >> 40) as f64 / f64::from(1 << 24) - 0.5
    };
    let mut list = |n: usize| (0..n).map(|_| next()).collect::<Vec<f64>>();
    Numbers {
        phi: (0..STEPS).map(|_| list(7)).collect(),
        q: (0..STEPS).map(|_| list(3).iter().zip([1.0, 0.1, 1.0]).map(|(x, m)| m * (x + 0.8)).collect()).collect(),
        h: list(5 * STEPS),
        noise: list(2 * STEPS).iter().map(|x| x + 0.7).collect(),
        values: list(2 * STEPS),
        inputs: list(2 * STEPS),
        start: list(4),
        variance: vec![0.5, 0.0, 0.1, 0.4],
    }
}

#[test]
fn adjoints_equal_differences_of_the_likelihood() {
    let all = numbers();
    let (design, data, gains, reduction) = reduced(&all);
    let moments = moments(reduction.view(), &law());
    let kept = adjoints(&design, &data, &gains, (&moments, None));
    let check = |what: &str, found: f64, change: &dyn Fn(&mut Numbers, f64)| {
        let at = |x: f64| {
            let mut moved = all.clone();
            change(&mut moved, x);
            dense(&moved)
        };
        let expected = slope(at, 1e-4);
        assert!((found - expected).abs() <= 2e-9 * (1.0 + expected.abs()), "{what}: {found} against {expected}");
    };
    for &(row, bar) in &kept.noise {
        check(&format!("R of {row}"), bar, &|n, x| n.noise[row] += x);
    }
    for &(row, bar) in &kept.value {
        check(&format!("z of {row}"), bar, &|n, x| n.values[row] += x);
    }
    for (row, bar) in &kept.h {
        let (states, _) = design.terms(*row);
        let first = design.ends[*row] - states.len();
        for (i, &state) in states.iter().enumerate() {
            check(&format!("h of {row} on {state}"), bar[state as usize], &|n, x| n.h[first + i] += x);
        }
    }
    for (k, bar) in &kept.moved {
        for (i, &phi) in bar.phi.iter().enumerate() {
            check(&format!("φ {i} of step {k}"), phi, &|n, x| n.phi[*k][i] += x);
        }
        for (i, &q) in bar.q.iter().enumerate() {
            check(&format!("Q {i} of step {k}"), q, &|n, x| n.q[*k][i] += x);
        }
        for (i, &b) in bar.input.iter().enumerate() {
            check(&format!("b {i} of step {k}"), b, &|n, x| n.inputs[2 * k + i] += x);
        }
    }
    for (i, &a) in kept.mean.iter().enumerate() {
        check(&format!("a {i}"), a, &|n, x| n.start[i] += x);
    }
    for (i, j) in [(0, 0), (1, 0), (1, 1)] {
        let both = if i == j { kept.variance[i * 2 + j] } else { 2.0 * kept.variance[i * 2 + j] };
        check(&format!("P0 {i} {j}"), both, &|n, x| n.variance[i * 2 + j] += x);
    }
}

/// x̂_K, Ψ_K and P_K by textbook formulas.
fn terminal(design: &Design, data: &Data) -> Terminal {
    let frame = &design.frame;
    let (n, r) = (frame.n, frame.r);
    let mut x = DVector::from_vec(data.start.clone());
    let mut psi = DMatrix::from_row_slice(n, frame.p, &frame.sensitivity);
    let mut P = DMatrix::zeros(n, n);
    P.view_mut((0, 0), (r, r)).copy_from(&DMatrix::from_fn(r, r, |i, j| design.variance[i.max(j) * r + i.min(j)]));
    let mut input = 0;
    for step in design.each_step() {
        if let Some(transition) = step.transition {
            let (mut phi, mut Q) = (DMatrix::identity(n, n), DMatrix::zeros(n, n));
            for row in &transition.pattern.moved {
                phi.row_mut(row.state as usize).fill(0.0);
                for k in row.start as usize..row.end as usize {
                    phi[(row.state as usize, transition.pattern.columns[k] as usize)] = transition.phi[k];
                }
            }
            for (&(i, j), &q) in transition.pattern.pairs.iter().zip(&transition.q) {
                (Q[(i as usize, j as usize)], Q[(j as usize, i as usize)]) = (q, q);
            }
            (x, psi, P) = (&phi * x, &phi * psi, &phi * P * phi.transpose() + Q);
            for &state in &frame.driven {
                x[state as usize] += data.inputs[input];
                input += 1;
            }
        }
        for (line, row) in step.lines.zip(step.rows) {
            let mut h = DVector::zeros(n);
            let (states, values) = design.terms(line);
            states.iter().zip(values).for_each(|(&state, &value)| h[state as usize] = value);
            let S = h.dot(&(&P * &h)) + design.noise[line];
            let K = &P * &h / S;
            (x, psi) = (&x + &K * (data.values[row] - h.dot(&x)), &psi - &K * (h.transpose() * &psi));
            P = &P - &K * K.transpose() * S;
        }
    }
    Terminal { mean: x, sensitivity: psi, root: kalfit_algebra::symmetric::square_root(&P) }
}

fn run<'a>(
    (design, data, gains): (&'a Design, &'a Data, &'a Gains),
    (moments, ending): (&'a Moments, Option<&'a TerminalAdjoint>),
    wanted: AdjointsWanted,
) -> BackwardInput<'a> {
    let (start, inputs, values) = (&data.start, &data.inputs, &data.values);
    BackwardInput { design, gains, start, inputs, values, zero_data: false, moments, ending, wanted }
}

/// All adjoints of a test.
fn adjoints(
    design: &Design,
    data: &Data,
    gains: &Gains,
    (moments, ending): (&Moments, Option<&TerminalAdjoint>),
) -> AllAdjoints {
    let run = run((design, data, gains), (moments, ending), ALL);
    let mut kept = AllAdjoints::default();
    let Ok(()) = run.backward(&mut BackwardWork::default(), &mut kept);
    kept
}

#[test]
fn the_adjoints_of_two_parts_are_those_of_the_whole() {
    let all = numbers();
    let law = law();
    let (design, data, gains, reduction) = reduced(&all);
    let whole = adjoints(&design, &data, &gains, (&moments(reduction.view(), &law), None));
    for at in 1..STEPS {
        let sensitivity = design.frame.sensitivity.clone();
        let (d1, n1) = part(&all, 0..at, sensitivity);
        let last = terminal(&d1, &n1);
        let (d1, n1, g1, r1) = reduction_of(d1, n1);
        let (d2, n2) = part(&all, at..STEPS, DMatrix::<f64>::identity(4, 4).as_slice().to_vec());
        let (d2, n2, g2, r2) = reduction_of(d2, n2);
        let same = Inherited { transition: DMatrix::identity(4, 4), input: DVector::zeros(4) };
        let pieces = [
            PhaseReduction { reduction: r1, terminal: Some(last), inherited: None, groups: Vec::new() },
            PhaseReduction { reduction: r2, terminal: None, inherited: Some(same), groups: Vec::new() },
        ];
        let laws = PhaseLaws::new(&law, &[0..3, 3..3], &[]);
        let plan = SmootherPlan::new(&pieces, &laws);
        let (found, expected) = (plan.likelihood(&pieces, &laws), dense(&all));
        assert!((found - expected).abs() < 1e-12, "ℓ split at {at}: {found} against {expected}");
        let smooth = plan.smooth(&pieces, &laws);
        let later = smooth[0].later.as_ref().expect("a phase follows");
        let ending = TerminalAdjoint {
            r: later.r.as_slice().to_vec(),
            rho: later.rho.transpose().as_slice().to_vec(),
            N: later.N.view((0, 0), (2, 2)).into_owned().as_slice().to_vec(),
        };
        let first = adjoints(&d1, &n1, &g1, (&smooth[0].moments, Some(&ending)));
        let second = adjoints(&d2, &n2, &g2, (&smooth[1].moments, None));
        let both = second.after(first, at);
        both.check(&whole, at);
    }
}

impl AllAdjoints {
    /// The adjoints of the steps from `at` on, together with those of the steps before (`first`).
    fn after(mut self, first: AllAdjoints, at: usize) -> AllAdjoints {
        self.noise.iter_mut().chain(&mut self.value).for_each(|(row, _)| *row += 2 * at);
        self.h.iter_mut().for_each(|(row, _)| *row += 2 * at);
        self.moved.iter_mut().for_each(|(k, _)| *k += at);
        self.noise.extend(first.noise);
        self.value.extend(first.value);
        self.h.extend(first.h);
        self.moved.extend(first.moved);
        (self.mean, self.variance) = (first.mean, first.variance);
        self
    }

    fn check(&self, whole: &AllAdjoints, at: usize) {
        let check = |what: &str, a: &[f64], b: &[f64]| {
            assert_eq!(a.len(), b.len(), "{what}");
            a.iter().zip(b).for_each(|(a, b)| near::mixed(format_args!("split at {at}, {what}"), *a, *b, 1e-11));
        };
        for (what, a, b) in [("R", &self.noise, &whole.noise), ("z", &self.value, &whole.value)] {
            let (mut a, mut b) = (a.clone(), b.clone());
            a.sort_by_key(|x| x.0);
            b.sort_by_key(|x| x.0);
            a.iter().zip(&b).for_each(|(a, b)| check(&format!("{what} of {}", b.0), &[a.1], &[b.1]));
        }
        let (mut a, mut b) = (self.h.clone(), whole.h.clone());
        a.sort_by_key(|x| x.0);
        b.sort_by_key(|x| x.0);
        a.iter().zip(&b).for_each(|(a, b)| check(&format!("h of {}", b.0), &a.1, &b.1));
        let (mut a, mut b) = (self.moved.clone(), whole.moved.clone());
        a.sort_by_key(|x| x.0);
        b.sort_by_key(|x| x.0);
        for ((k, a), (l, b)) in a.iter().zip(&b) {
            assert_eq!(k, l, "steps");
            check(&format!("φ of step {k}"), &a.phi, &b.phi);
            check(&format!("Q of step {k}"), &a.q, &b.q);
            check(&format!("b of step {k}"), &a.input, &b.input);
        }
        check("a", &self.mean, &whole.mean);
        check("P0", &self.variance, &whole.variance);
    }
}

/// Sums of adjoints over each stretch.
#[derive(Debug, Default, Clone, PartialEq)]
struct Totals {
    ends: Vec<usize>,
    takes_sums: bool,
    /// [R̄, z̄, h̄, φ̄, Q̄] of each stretch, with the adjoints of each line separate.
    bars: std::collections::BTreeMap<usize, [Vec<f64>; 5]>,
    start: Vec<f64>,
}

impl Totals {
    fn new(design: &Design, takes_sums: bool) -> Totals {
        Totals { ends: design.runs.iter().map(|run| run.steps).collect(), takes_sums, ..Totals::default() }
    }

    fn add(&mut self, k: usize, what: usize, bars: &[f64]) {
        let at = self.ends.partition_point(|&end| end <= k);
        let list = &mut self.bars.entry(at).or_default()[what];
        list.resize(bars.len(), 0.0);
        list.iter_mut().zip(bars).for_each(|(sum, bar)| *sum += bar);
    }

    #[track_caller]
    fn check(&self, other: &Totals) {
        let check = |what: &str, a: &[f64], b: &[f64]| {
            let bound = 1e-10 * (1e-3 + near::largest(a));
            assert_eq!(a.len(), b.len(), "{what}");
            a.iter().zip(b).for_each(|(a, b)| near::absolute(what, *a, *b, bound));
        };
        assert_eq!(self.bars.len(), other.bars.len());
        for ((at, a), b) in self.bars.iter().zip(other.bars.values()) {
            for (what, (a, b)) in ["R", "z", "h", "φ", "Q"].iter().zip(a.iter().zip(b)) {
                check(&format!("{what} of stretch {at}"), a, b);
            }
        }
        check("start", &self.start, &other.start);
    }
}

impl Sink for Totals {
    type Error = std::convert::Infallible;
    fn accepts_sums(&mut self, _: Range<usize>) -> bool {
        self.takes_sums
    }
    fn measured(&mut self, k: usize, bar: &MeasurementAdjoint) -> Result<(), Self::Error> {
        [&bar.noise, &bar.value, &bar.h].iter().enumerate().for_each(|(what, bars)| self.add(k, what, bars));
        Ok(())
    }
    fn moved(&mut self, k: usize, bar: &TransitionAdjoint) -> Result<(), Self::Error> {
        [&bar.phi, &bar.q].iter().enumerate().for_each(|(what, bars)| self.add(k, 3 + what, bars));
        Ok(())
    }
    fn started(&mut self, mean: &[f64], variance: &[f64]) -> Result<(), Self::Error> {
        self.start = [mean, variance].concat();
        Ok(())
    }
}

/// Long stretches of equal steps with other steps between; the states are two noisy ones, one that a constant moves,
/// and the constant.
fn long() -> (Design, Data) {
    let mut pattern = Pattern::default();
    pattern.push(0, 2, [0, 1, 3].into_iter());
    pattern.push(1, 2, [1].into_iter());
    pattern.push(2, 2, [2, 3].into_iter());
    pattern.pairs = vec![(0, 0), (1, 0), (1, 1)];
    let pattern = Arc::new(pattern.seal());
    let mut sensitivity = vec![0.0; 12];
    (sensitivity[0], sensitivity[2 * 3 + 1], sensitivity[3 * 3 + 2]) = (1.0, 1.0, 1.0);
    let frame = StateFrame { n: 4, p: 3, r: 2, rows: vec![DENSE; 4], sensitivity, driven: Vec::new(), digest: 0 };
    let mut design = Design::new(Arc::new(frame.seal()));
    design.variance.copy_from_slice(&[0.5, 0.0, 0.1, 0.4]);
    let transition = |x: f64| {
        let phi = vec![0.8 + x, 0.1, 0.2, 0.9 - x, 0.7, 0.3 + x];
        Arc::new(Transition::new(pattern.clone(), phi, vec![0.3, 0.05 + x, 0.2 + x]))
    };
    let mut step = |transition: Option<Arc<Transition>>, lines: usize, count: usize| {
        for line in 0..lines {
            design.states.extend([0, 1, 2, 3]);
            design.h.extend([1.0, 0.5 - 0.3 * line as f64, -0.4, 0.6]);
            design.ends.push(design.states.len());
            design.noise.push(0.7 + 0.1 * line as f64);
        }
        design.push_step(transition.as_ref());
        design.repeat(count - 1);
    };
    step(None, 1, 1);
    step(Some(transition(0.0)), 1, 2600);
    step(Some(transition(0.05)), 2, 1);
    step(Some(transition(0.0)), 0, 3);
    step(Some(transition(0.02)), 1, 20);
    step(Some(transition(0.01)), 1, 2100);
    step(Some(transition(0.03)), 2, 700);
    let rows = design.rows();
    let values = (0..rows).map(|row| ((row * row) as f64 * 0.618_033_988_749_895).fract() * 4.0 - 1.5).collect();
    (design, Data { start: vec![0.1, -0.2, 0.3, 0.4], inputs: Vec::new(), values, sizes: vec![1.0; rows] })
}

fn totals(cut: SegmentLengths, unfrozen: bool, wanted: AdjointsWanted, takes_sums: bool) -> Totals {
    totals_of(&long(), &law(), (cut, unfrozen), wanted, takes_sums)
}

fn totals_of(
    (design, data): &(Design, Data),
    law: &InitialLaw,
    (cut, unfrozen): (SegmentLengths, bool),
    wanted: AdjointsWanted,
    takes_sums: bool,
) -> Totals {
    let mut work = with_paths();
    work.settling.off = unfrozen;
    let gains = information_gains(design, None, &mut work).expect("well conditioned");
    let moments = moments(reduction_by(&gains, design, data).view(), law);
    let run = run((design, data, &gains), (&moments, None), wanted);
    let mut back = BackwardWork { cut, ..BackwardWork::default() };
    back.set_unfrozen(unfrozen);
    let mut totals = Totals::new(design, takes_sums);
    let Ok(()) = run.backward(&mut back, &mut totals);
    let first = totals.clone();
    totals = Totals::new(design, takes_sums);
    let Ok(()) = run.backward(&mut back, &mut totals); // nothing remains of the first pass
    assert_eq!(totals, first);
    totals
}

const ALL: AdjointsWanted = AdjointsWanted { motion: true, equation: true };

#[test]
fn blocks_have_the_bits_of_one_block() {
    let cut = |block: usize| SegmentLengths { block, ..SegmentLengths::default() };
    for wanted in [ALL, AdjointsWanted::default(), AdjointsWanted { motion: true, equation: false }] {
        for sums in [true, false] {
            let whole = totals(cut(1 << 20), false, wanted, sums);
            for block in [1, 37, 256] {
                assert_eq!(totals(cut(block), false, wanted, sums), whole, "{wanted:?}, {sums}, {block}");
            }
        }
    }
}

#[test]
fn equal_steps_summed_are_the_steps_one_by_one() {
    for wanted in [ALL, AdjointsWanted::default(), AdjointsWanted { motion: false, equation: true }] {
        let each = totals(SegmentLengths::default(), true, wanted, false);
        totals(SegmentLengths::default(), true, wanted, true).check(&each);
        totals(SegmentLengths { few: 1, ..SegmentLengths::default() }, true, wanted, true).check(&each);
    }
}

#[test]
fn frozen_equals_unfrozen() {
    for wanted in [ALL, AdjointsWanted::default()] {
        let each = totals(SegmentLengths::default(), true, wanted, false);
        totals(SegmentLengths::default(), false, wanted, true).check(&each);
        totals(SegmentLengths::default(), false, wanted, false).check(&each);
    }
}

#[test]
fn segments_are_the_steps_one_by_one() {
    let (design, data) = long();
    let ending = TerminalAdjoint {
        r: vec![0.3, -0.5, 0.2, 0.7],
        rho: vec![0.2, -0.1, 0.4, 0.3, -0.6, 0.1, 0.5, 0.2],
        N: vec![0.9, 0.2, 0.2, 0.6],
    };
    let of = |every_row: bool, ending: Option<&TerminalAdjoint>, wanted: AdjointsWanted| {
        let mut work = GainsWork { every_row, ..with_paths() };
        work.settling.off = every_row;
        let gains = information_gains(&design, None, &mut work).expect("well conditioned");
        let reduction = reduction_by(&gains, &design, &data);
        let moments = moments(reduction.view(), &law());
        let (mut totals, mut back) = (Totals::new(&design, !every_row), BackwardWork::default());
        back.set_unfrozen(every_row);
        let Ok(()) = run((&design, &data, &gains), (&moments, ending), wanted).backward(&mut back, &mut totals);
        (gains.segments.len(), reduction, totals)
    };
    for ending in [None, Some(&ending)] {
        for wanted in [ALL, AdjointsWanted::default(), AdjointsWanted { motion: true, equation: false }] {
            let ((cut, found, totals), (none, expected, each)) = (of(false, ending, wanted), of(true, ending, wanted));
            assert_eq!((cut, none), (2, 0), "of three long stretches one has two measurements a step");
            near::relative("c", found.constant, expected.constant, 1e-12);
            for (list, other) in [(&found.data, &expected.data), (&found.factor, &expected.factor)] {
                list.iter().zip(other).for_each(|(x, y)| near::absolute("d, R", *x, *y, 1e-10 * near::largest(other)));
            }
            totals.check(&each);
        }
    }
}

#[test]
fn gains_of_rows_from_segments_are_those_of_the_steps() {
    let design = long().0;
    let of = |off: bool| {
        let mut work = GainsWork { every_row: true, ..GainsWork::default() };
        work.settling.off = off;
        information_gains(&design, None, &mut work).expect("well conditioned")
    };
    let (found, each) = (of(false), of(true));
    assert!(found.gains.len() < each.gains.len(), "the gains of the longest stretch become constant");
    for row in 0..design.rows() {
        let ((weight, K, T), (expected, expected_K, expected_T)) = (found.row(row), each.row(row));
        near::relative(format!("1/S of row {row}"), weight, expected, 1e-13);
        near::slices(format!("K of row {row}"), K, expected_K, 1e-13);
        near::slices(format!("T of row {row}"), T, expected_T, 1e-13);
    }
}

#[test]
fn without_paths_equal_steps_go_one_by_one() {
    let (design, data) = long();
    let mut work = with_paths();
    work.settling.off = true;
    let mut gains = information_gains(&design, None, &mut work).expect("well conditioned");
    let moments = moments(reduction_by(&gains, &design, &data).view(), &law());
    let of = |gains: &Gains| {
        let (mut totals, mut back) = (Totals::new(&design, true), BackwardWork::default());
        let Ok(()) = run((&design, &data, gains), (&moments, None), ALL).backward(&mut back, &mut totals);
        let is_equal = |part: &&Segment| matches!(part.kind, SegmentKind::Equal(_));
        (totals, back.parts.iter().filter(is_equal).count())
    };
    let (kept, summed) = of(&gains);
    assert_eq!((gains.paths.len(), summed), (3, 3), "of four long stretches one has two measurements a step");
    gains.paths.clear();
    let (each, summed) = of(&gains);
    assert_eq!(summed, 0);
    each.check(&kept);
}

/// Equal steps in which nothing moves and no noise reaches a state: two constants.
fn still() -> (Design, Data) {
    let sensitivity = vec![1.0, 0.0, 0.0, 1.0];
    let frame = StateFrame { n: 2, p: 2, r: 0, rows: vec![DENSE; 2], sensitivity, driven: Vec::new(), digest: 0 };
    let mut design = Design::new(Arc::new(frame.seal()));
    for (h, count) in [(0.5, 70), (-1.5, 90)] {
        design.states.extend([0, 1]);
        design.h.extend([1.0, h]);
        design.ends.push(design.states.len());
        design.noise.push(0.7);
        design.push_step(None);
        design.repeat(count - 1);
    }
    let values = (0..design.rows()).map(|row| ((row * row) as f64 * 0.618_033_988_749_895).fract() - 0.3).collect();
    let sizes = vec![1.0; design.rows()];
    (design, Data { start: vec![0.1, -0.2], inputs: Vec::new(), values, sizes })
}

#[test]
fn equal_steps_of_constants_alone_are_the_steps_one_by_one() {
    let root = DMatrix::from_row_slice(2, 2, &[0.8, 0.1, -0.3, 0.9]);
    let law = InitialLaw::known(DVector::from_vec(vec![0.3, -0.2]), root);
    for wanted in [ALL, AdjointsWanted::default()] {
        let of = |sums| totals_of(&still(), &law, (SegmentLengths::default(), false), wanted, sums);
        of(true).check(&of(false));
    }
}
