//! Random tests in several phases: as a model in phases, and as matrices of one long test written down independently.
#![allow(dead_code, reason = "each test module uses its own part of it")]

use kalfit::model::{
    Carry, Clock, Column, CovarianceStructure, Expression, Initial, Linear, MeanStructure, Measurement, Model, Motion,
    Phase, PhasedModel, State,
};
use kalfit::reduce::{Evidence, PhasedTest, Plain, Reduction, StepMatrices};
use kalfit::{Label, Source, Test};
use kalfit_fixtures::dense::unpacked;
use nalgebra::{DMatrix, DVector};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

/// Numeric columns: three measured values, an input, an offset, a coefficient of the carry.
const COLUMNS: usize = 6;
const INPUT: usize = 3;
const OFFSET: usize = 4;
const COEFFICIENT: usize = 5;
const MISSING: f64 = f64::NAN;

/// A phase in numbers.
#[derive(Debug, Clone)]
pub(crate) struct PhaseMatrices {
    /// Which states are estimated, and which inherit.
    pub(crate) estimated: Vec<usize>,
    pub(crate) inheriting: Vec<usize>,
    /// a and the diagonal P0.
    pub(crate) start: DVector<f64>,
    pub(crate) variance: DVector<f64>,
    /// T and t.
    pub(crate) transition: DMatrix<f64>,
    pub(crate) input: DVector<f64>,
    pub(crate) phi: DMatrix<f64>,
    pub(crate) noise: DVector<f64>,
    /// The state that the input column drives.
    pub(crate) driven: Option<usize>,
    pub(crate) step_first: bool,
    pub(crate) h: DMatrix<f64>,
    pub(crate) constant: DVector<f64>,
    pub(crate) variances: DVector<f64>,
    /// Input and values of each row.
    pub(crate) rows: Vec<(f64, Vec<f64>)>,
    /// The coefficient column, which multiplies the first entry of the carry.
    pub(crate) coefficient: f64,
    pub(crate) offset: f64,
}

/// A model in phases, one test of it, and the same in matrices.
#[derive(Debug, Clone)]
pub(crate) struct Journey {
    pub(crate) model: PhasedModel,
    pub(crate) test: PhasedTest,
    /// All rows of the test, those of the phases shuffled into each other.
    pub(crate) mixed: Test,
    pub(crate) phases: Vec<PhaseMatrices>,
    /// Phases that the test has.
    pub(crate) present: usize,
}

pub(crate) fn normal(rng: &mut impl Rng) -> f64 {
    rng.sample(StandardNormal)
}

fn number(x: f64) -> Expression {
    Expression::Number(x)
}

fn product(x: f64, column: usize) -> Expression {
    Expression::Binary(kalfit::model::Operator::Multiply, Box::new(number(x)), Box::new(Expression::Column(column)))
}

fn linear(row: &[f64], constant: Expression) -> Linear {
    let terms = row.iter().enumerate().filter(|(_, x)| **x != 0.0).map(|(j, &x)| (j, number(x))).collect();
    Linear { terms, constant }
}

impl PhaseMatrices {
    pub(crate) fn n(&self) -> usize {
        self.phi.nrows()
    }

    /// A random phase after one with `before` states.
    pub(crate) fn random(rng: &mut impl Rng, before: Option<usize>) -> PhaseMatrices {
        let n = rng.random_range(1..=4);
        let mut choose = |chance: f64| -> Vec<usize> { (0..n).filter(|_| rng.random_bool(chance)).collect() };
        let estimated = choose(0.7);
        let inheriting = if before.is_some() { choose(0.7) } else { Vec::new() };
        let start = DVector::from_fn(n, |i, _| if estimated.contains(&i) { 0.0 } else { normal(rng) });
        let variance = DVector::from_fn(n, |i, _| {
            let known = rng.random_bool(if estimated.contains(&i) { 0.2 } else { 0.6 });
            if known { rng.random_range(0.1..3.0) } else { 0.0 }
        });
        let transition = DMatrix::from_fn(n, before.unwrap_or(0), |i, j| {
            if !inheriting.contains(&i) || rng.random_bool(0.3) { 0.0 } else { f64::from(i == j) + 0.5 * normal(rng) }
        });
        let input = DVector::from_fn(n, |i, _| if inheriting.contains(&i) { normal(rng) } else { 0.0 });
        let still: Vec<bool> = (0..n).map(|_| rng.random_bool(0.3)).collect();
        let phi = DMatrix::from_fn(n, n, |i, j| match still[i] {
            true => f64::from(i == j),
            false if rng.random_bool(0.3) => 0.0,
            false => 0.7 * f64::from(i == j) + 0.3 * normal(rng),
        });
        let noise = DVector::from_fn(n, |i, _| if still[i] || rng.random_bool(0.4) { 0.0 } else { rng.random() });
        let driven = (0..n).find(|&i| !still[i]).filter(|_| rng.random());
        let m = rng.random_range(0..=3);
        let rows = (0..rng.random_range(1..=7))
            .map(|_| {
                let value = |rng: &mut dyn FnMut() -> f64| rng();
                let mut draw = || if rng.random_bool(0.2) { MISSING } else { 2.0 * normal(rng) };
                let values = (0..m).map(|_| value(&mut draw)).collect();
                (normal(rng), values)
            })
            .collect();
        PhaseMatrices {
            h: DMatrix::from_fn(m, n, |_, _| if rng.random_bool(0.3) { 0.0 } else { normal(rng) }),
            constant: DVector::from_fn(m, |_, _| normal(rng)),
            variances: DVector::from_fn(m, |_, _| 10f64.powf(rng.random_range(-3.0..1.0))),
            step_first: rng.random_bool(0.3),
            coefficient: 1.0 + 0.3 * normal(rng),
            offset: normal(rng),
            estimated,
            inheriting,
            start,
            variance,
            transition,
            input,
            phi,
            noise,
            driven,
            rows,
        }
    }

    /// T and t with the coefficient column.
    pub(crate) fn carried(&self) -> (DMatrix<f64>, DVector<f64>) {
        let mut transition = self.transition.clone();
        if let Some(first) = self.scaled() {
            transition[first] *= self.coefficient;
        }
        (transition, self.input.clone())
    }

    /// The entry of T that the coefficient column multiplies.
    fn scaled(&self) -> Option<(usize, usize)> {
        let places = (0..self.n()).flat_map(|i| (0..self.transition.ncols()).map(move |j| (i, j)));
        places.into_iter().find(|&at| self.transition[at] != 0.0)
    }

    /// a: every state has the offset column too, but those that are estimated alone have it twice over.
    pub(crate) fn a(&self) -> DVector<f64> {
        DVector::from_fn(self.n(), |i, _| self.start[i] + if i == 0 { self.offset } else { 0.0 })
    }

    fn model(&self, name: &str) -> Model {
        let state = |i: usize| {
            let row: Vec<f64> = self.phi.row(i).iter().copied().collect();
            let input = if self.driven == Some(i) { Expression::Column(INPUT) } else { number(0.0) };
            let still = self.noise[i] == 0.0
                && self.driven != Some(i)
                && row.iter().enumerate().all(|(j, &x)| x == f64::from(i == j));
            State {
                name: format!("{name}{i}"),
                unit: None,
                motion: if still {
                    Motion::Constant
                } else {
                    Motion::Discrete { next: linear(&row, input), noise_variance: number(self.noise[i]) }
                },
                initial: if self.estimated.contains(&i) {
                    Initial::Estimated
                } else {
                    Initial::Known { mean: number(self.start[i]), variance: number(self.variance[i]) }
                },
                offset: (i == 0).then_some(Expression::Column(OFFSET)),
                random: true,
            }
        };
        let measurement = |k: usize| Measurement {
            name: format!("{name}z{k}"),
            column: k,
            filter: None,
            equation: linear(&self.h.row(k).iter().copied().collect::<Vec<_>>(), number(self.constant[k])),
            noise_variance: number(self.variances[k]),
        };
        let p = self.estimated.len();
        let entry = |i: usize, j: usize| number(if i == j { self.variance[self.estimated[i]] } else { 0.0 });
        let known: Vec<Vec<Expression>> = (0..p).map(|i| (0..p).map(|j| entry(i, j)).collect()).collect();
        let added = self.estimated.iter().any(|&i| self.variance[i] > 0.0);
        let named = |name: &&str| Column { name: (*name).to_owned(), used_in: String::new() };
        Model {
            title: String::new(),
            columns: ["z0", "z1", "z2", "u", "w", "c"].iter().map(named).collect(),
            text_columns: ["phase"].iter().map(named).collect(),
            literals: (0..5).map(|i| format!("leg{i}")).collect(),
            parameters: Vec::new(),
            states: (0..self.n()).map(state).collect(),
            process_noise_covariance: Vec::new(),
            measurements: (0..self.h.nrows()).map(measurement).collect(),
            noise_covariance: Vec::new(),
            clock: Clock { step_first: self.step_first, ..Clock::default() },
            group: None,
            estimated: self.estimated.clone(),
            mean: MeanStructure::free(p),
            covariance: CovarianceStructure { known: added.then_some(known), ..CovarianceStructure::full() },
        }
    }

    fn phase(&self, at: usize) -> Phase {
        let scaled = self.scaled();
        let carry = |&state: &usize| {
            let term = |j: usize| {
                let x = self.transition[(state, j)];
                (j, if scaled == Some((state, j)) { product(x, COEFFICIENT) } else { number(x) })
            };
            let terms =
                (0..self.transition.ncols()).filter(|&j| self.transition[(state, j)] != 0.0).map(term).collect();
            Carry { state, from: Linear { terms, constant: number(self.input[state]) } }
        };
        Phase {
            name: format!("leg{at}"),
            label: Some(at),
            model: self.model(["a", "b", "c", "d", "e"][at]),
            carry: self.inheriting.iter().map(carry).collect(),
            filter: None,
        }
    }

    /// Cells of a row; the offset and the coefficient stand in the first row only.
    fn cells(&self, row: usize) -> [f64; COLUMNS] {
        let (input, values) = &self.rows[row];
        let mut cells = [MISSING; COLUMNS];
        cells[..values.len()].copy_from_slice(values);
        cells[INPUT] = *input;
        if row == 0 {
            (cells[OFFSET], cells[COEFFICIENT]) = (self.offset, self.coefficient);
        }
        cells
    }

    /// The steps of the phase, with `more` states behind its own that rest.
    pub(crate) fn steps(&self, n_max: usize, more: usize) -> Vec<StepMatrices> {
        let (n, width) = (self.n(), n_max + more);
        let mut phi = DMatrix::identity(width, width);
        phi.view_mut((0, 0), (n, n)).copy_from(&self.phi);
        let mut q = DMatrix::zeros(width, width);
        (0..n).for_each(|i| q[(i, i)] = self.noise[i]);
        let step = |(k, (input, values)): (usize, &(f64, Vec<f64>))| {
            let mut h = DMatrix::zeros(values.len(), width);
            h.view_mut((0, 0), (values.len(), n)).copy_from(&self.h);
            let noise = DMatrix::from_diagonal(&self.variances);
            let step =
                StepMatrices::new(h, noise, DVector::from_column_slice(values)).with_constant(self.constant.clone());
            if k == 0 && !self.step_first {
                return step;
            }
            let mut b = DVector::zeros(width);
            self.driven.iter().for_each(|&i| b[i] = *input);
            step.moving(phi.clone(), q.clone()).with_input(b)
        };
        self.rows.iter().enumerate().map(step).collect()
    }

    /// The phase by itself in its entering coordinates, in matrices.
    pub(crate) fn plain(&self) -> Plain {
        let mut entering = self.estimated.clone();
        entering.extend(self.inheriting.iter().filter(|i| !self.estimated.contains(i)));
        let e = DMatrix::from_fn(self.n(), entering.len(), |i, c| f64::from(entering[c] == i));
        let mut plain = Plain::new("t", self.a(), e, DMatrix::from_diagonal(&self.variance));
        plain.steps = self.steps(self.n(), 0);
        plain
    }
}

impl Journey {
    pub(crate) fn random(seed: u64) -> Journey {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let count = rng.random_range(2..=4);
        let mut phases: Vec<PhaseMatrices> = Vec::new();
        for _ in 0..count {
            let before = phases.last().map(PhaseMatrices::n);
            phases.push(PhaseMatrices::random(&mut rng, before));
        }
        let present = if rng.random_bool(0.3) { rng.random_range(1..=count) } else { count };
        Journey::new(phases, present, &mut rng)
    }

    pub(crate) fn new(phases: Vec<PhaseMatrices>, present: usize, rng: &mut impl Rng) -> Journey {
        let model = PhasedModel {
            phases: phases.iter().enumerate().map(|(at, phase)| phase.phase(at)).collect(),
            column: Some(0),
            levels: Vec::new(),
        };
        let mut tests: Vec<Test> = (0..present).map(|_| Test::new("t", COLUMNS, 1)).collect();
        let mut left: Vec<(usize, usize)> = phases[..present].iter().map(|phase| (0, phase.rows.len())).collect();
        let mut mixed = Test::new("t", COLUMNS, 1);
        let mut line = 2;
        while left.iter().any(|(row, rows)| row < rows) {
            let at = rng.random_range(0..present);
            let (row, rows) = left[at];
            if row < rows {
                let (cells, label, source) =
                    (phases[at].cells(row), [Label::literal(at)], Source { file: 0, row: line });
                mixed.push(&cells, &label, source);
                tests[at].push(&cells, &label, source);
                left[at].0 += 1;
                line += 1;
            }
        }
        let test = PhasedTest { id: "t".into(), phases: tests.into_iter().map(Evidence::Rows).collect() };
        Journey { model, test, mixed, phases, present }
    }

    /// Σ p_i.
    pub(crate) fn dimension(&self) -> usize {
        self.model.dimension()
    }

    /// The whole test as one of a single phase: the state is [x; ξ_1, …, ξ_I], x of the widest phase.
    pub(crate) fn whole(&self) -> Plain {
        let widest = self.phases.iter().map(PhaseMatrices::n).max().expect("phases");
        let (p, ranges) = (self.dimension(), self.model.ranges());
        let width = widest + p;
        let pad = |x: DVector<f64>| x.resize_vertically(width, 0.0);
        let own = |at: usize| {
            let mut a = DMatrix::zeros(widest, p);
            for (c, &state) in ranges[at].clone().zip(&self.phases[at].estimated) {
                a[(state, c)] = 1.0;
            }
            a
        };
        let mut sensitivity = DMatrix::zeros(width, p);
        sensitivity.view_mut((0, 0), (widest, p)).copy_from(&own(0));
        sensitivity.view_mut((widest, 0), (p, p)).fill_with_identity();
        let variance = |at: usize| DMatrix::from_diagonal(&pad(self.phases[at].variance.clone()));
        let mut whole = Plain::new("t", pad(self.phases[0].a()), sensitivity, variance(0));
        whole.steps = self.phases[0].steps(widest, p);
        for at in 1..self.present {
            let phase = &self.phases[at];
            let (transition, input) = phase.carried();
            let mut phi = DMatrix::zeros(width, width);
            phi.view_mut((0, 0), transition.shape()).copy_from(&transition);
            phi.view_mut((0, widest), (widest, p)).copy_from(&own(at));
            phi.view_mut((widest, widest), (p, p)).fill_with_identity();
            let link = StepMatrices::silent(width).moving(phi, variance(at)).with_input(pad(phase.a() + input));
            whole.steps.push(link);
            whole.steps.extend(phase.steps(widest, p));
        }
        whole
    }
}

/// log p(z | ξ) of a reduction.
pub(crate) fn log_likelihood(reduction: &Reduction, xi: &DVector<f64>) -> f64 {
    let d = DVector::from_column_slice(&reduction.data);
    reduction.constant - 0.5 * (d - unpacked(&reduction.factor, xi.len()) * xi).norm_squared()
}

/// A random (μ, Σ); Σ is zero, of rank 1, of full rank, or `huge`.
pub(crate) fn law(rng: &mut impl Rng, p: usize, huge: bool) -> (DVector<f64>, DMatrix<f64>) {
    let mu = DVector::from_fn(p, |_, _| normal(rng));
    let kind = rng.random_range(0..if huge { 4 } else { 3 });
    let rank = [0, 1, p, p][kind].min(p);
    let root = DMatrix::from_fn(p, rank, |_, _| if kind == 3 { 30.0 * normal(rng) } else { normal(rng) });
    (mu, &root * root.transpose())
}
