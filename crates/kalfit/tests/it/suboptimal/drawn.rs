//! Random phases with filters that are wrong in every way, and the same written out densely: all noises of a test stacked, the
//! truth and the filter as explicit linear maps of x_0 and of these noises.

use kalfit::model::{
    Alpha, Clock, Column, CovarianceStructure, Filter, Initial, Level, Linear, MeanStructure, Measurement, Motion,
    Operator, Parameter, Phase, State, Value,
};
use kalfit::reduce::Estimates;
use kalfit::{Expression, Model, PhasedModel, Source, Test};
use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Parameters of a drawn model; the filter may believe otherwise of each.
const FACTOR: usize = 0; // of φ
const PROCESS: usize = 1; // of Q
const SLOPE: usize = 2; // of M
const NOISE: usize = 3; // of R
const INPUT: usize = 4; // of b
const CONSTANT: usize = 5; // of d

/// What is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    /// The filter is the optimal one, of a prior of full rank.
    Optimal,
    /// It believes otherwise of parameters, and considers states.
    Wrong,
}

/// A phase and its matrices without parameters: each is the parameter's value × this.
#[derive(Debug, Clone)]
pub(crate) struct Drawn {
    pub(crate) phase: Phase,
    pub(crate) alpha: Alpha,
    pub(crate) test: Test,
    /// P0 and a: known starts, elsewhere zero.
    pub(crate) start: (DVector<f64>, DMatrix<f64>),
    phi: DMatrix<f64>,
    process: DMatrix<f64>,
    measurement: DMatrix<f64>,
    noise: DMatrix<f64>,
    step_first: bool,
}

/// The matrices of a model at some parameters.
struct At {
    phi: DMatrix<f64>,
    process: DMatrix<f64>,
    input: f64,
    measurement: DMatrix<f64>,
    noise: DMatrix<f64>,
    constant: f64,
}

pub(crate) fn generator(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

pub(crate) fn uniform(random: &mut ChaCha8Rng) -> f64 {
    random.random_range(-1.0..1.0)
}

pub(crate) fn matrix(rows: usize, columns: usize, random: &mut ChaCha8Rng) -> DMatrix<f64> {
    DMatrix::from_fn(rows, columns, |_, _| uniform(random))
}

fn definite(n: usize, rank: usize, random: &mut ChaCha8Rng) -> DMatrix<f64> {
    let root = matrix(n, rank, random);
    &root * root.transpose()
}

fn times(parameter: usize, x: f64) -> Expression {
    let (value, number) = (Expression::Parameter(parameter), Expression::Number(x));
    Expression::Binary(Operator::Multiply, Box::new(value), Box::new(number))
}

/// Parameter × column 0, which is the known input u.
fn driven(parameter: usize) -> Expression {
    let (value, u) = (Expression::Parameter(parameter), Expression::Column(0));
    Expression::Binary(Operator::Multiply, Box::new(value), Box::new(u))
}

/// Columns: 0 the input u, then one for each measurement.
pub(crate) fn draw(seed: u64, kind: Kind) -> Drawn {
    let random = &mut generator(seed);
    let n = random.random_range(1..=4);
    let m = random.random_range(1..=3);
    let shaken: Vec<bool> = (0..n).map(|_| random.random_bool(0.6)).collect();
    let phi = DMatrix::identity(n, n) * 0.6 + matrix(n, n, random) * 0.4;
    let mut process = definite(n, n, random) + DMatrix::identity(n, n) * 0.05;
    for i in (0..n).filter(|&i| !shaken[i]) {
        process.row_mut(i).fill(0.0);
        process.column_mut(i).fill(0.0);
    }
    let (measurement, noise) = (matrix(m, n, random), definite(m, m, random) + DMatrix::identity(m, m) * 0.05);
    let known: Vec<bool> = (0..n).map(|i| i > 0 && random.random_bool(0.3)).collect();
    let start = DVector::from_fn(n, |i, _| if known[i] { uniform(random) } else { 0.0 });
    let spread =
        DVector::from_fn(
            n,
            |i, _| if known[i] && random.random_bool(0.7) { random.random_range(0.1..2.0) } else { 0.0 },
        );
    let state = |i: usize| State {
        name: format!("x{i}"),
        unit: None,
        motion: Motion::Discrete {
            next: Linear {
                terms: (0..n).map(|j| (j, times(FACTOR, phi[(i, j)]))).collect(),
                constant: if i == 0 { driven(INPUT) } else { Expression::Number(0.0) },
            },
            noise_variance: times(PROCESS, process[(i, i)]),
        },
        initial: if known[i] {
            Initial::Known { mean: Expression::Number(start[i]), variance: Expression::Number(spread[i]) }
        } else {
            Initial::Estimated
        },
        offset: None,
        random: true,
    };
    let meter = |i: usize| Measurement {
        name: format!("z{i}"),
        column: i + 1,
        filter: None,
        equation: Linear {
            terms: (0..n).map(|j| (j, times(SLOPE, measurement[(i, j)]))).collect(),
            constant: if i == 0 { driven(CONSTANT) } else { Expression::Number(0.0) },
        },
        noise_variance: times(NOISE, noise[(i, i)]),
    };
    let lower = |m: usize| (0..m).flat_map(|i| (0..i).map(move |j| (i, j)));
    let step_first = random.random_bool(0.5);
    let model = Model {
        title: String::new(),
        columns: (0..=m).map(|c| Column { name: format!("c{c}"), used_in: String::new() }).collect(),
        text_columns: vec![],
        literals: vec![],
        parameters: (0..6).map(parameter).collect(),
        states: (0..n).map(state).collect(),
        process_noise_covariance: lower(n).map(|(i, j)| (i, j, times(PROCESS, process[(i, j)]))).collect(),
        measurements: (0..m).map(meter).collect(),
        noise_covariance: lower(m).map(|(i, j)| (i, j, times(NOISE, noise[(i, j)]))).collect(),
        clock: Clock { step_first, ..Clock::default() },
        group: None,
        estimated: (0..n).filter(|&i| !known[i]).collect(),
        mean: MeanStructure::free(known.iter().filter(|known| !**known).count()),
        covariance: CovarianceStructure::full(),
    };
    let mut phase = PhasedModel::from(model).phases.remove(0);
    let wrong = kind == Kind::Wrong;
    phase.filter = Some(Filter {
        consider: (0..n).filter(|_| wrong && random.random_bool(0.25)).collect(),
        mean: (0..n).map(|_| uniform(random)).collect(),
        covariance: definite(n, if wrong { random.random_range(1..=n) } else { n }, random) * 3.0
            + DMatrix::identity(n, n) * if wrong { 0.0 } else { 0.5 },
        parameters: (0..6)
            .filter(|_| wrong && random.random_bool(0.5))
            .map(|p| (p, 1.0 + 0.4 * f64::from(p as u8 % 3)))
            .collect(),
    });
    let alpha = Alpha { values: (0..6).map(|p| Level::Common(1.0 + 0.1 * f64::from(p as u8))).collect() };
    let test = rows(m, random);
    let start = (start, DMatrix::from_diagonal(&spread));
    Drawn { phase, alpha, test, start, phi, process, measurement, noise, step_first }
}

fn parameter(p: usize) -> Parameter {
    Parameter {
        name: format!("p{p}"),
        unit: None,
        value: Value::Fixed(1.0),
        per: None,
        fixed_levels: Default::default(),
        lower: None,
        upper: None,
        positive: false,
    }
}

fn rows(m: usize, random: &mut ChaCha8Rng) -> Test {
    let mut test = Test::new("t", m + 1, 0);
    for row in 0..random.random_range(1..=7) {
        let mut numbers = vec![uniform(random)];
        numbers.extend((0..m).map(|_| if random.random_bool(0.25) { f64::NAN } else { 3.0 * uniform(random) }));
        test.push(&numbers, &[], Source { file: 0, row });
    }
    test
}

impl Drawn {
    /// The same with all of x_0 among the estimated.
    pub(crate) fn free(mut self) -> Drawn {
        let (model, n) = (&mut self.phase.model, self.phi.nrows());
        model.states.iter_mut().for_each(|state| state.initial = Initial::Estimated);
        (model.estimated, model.mean) = ((0..n).collect(), MeanStructure::free(n));
        self.start = (DVector::zeros(n), DMatrix::zeros(n, n));
        self
    }

    fn at(&self, own: bool) -> At {
        let filter = self.phase.filter.as_ref().expect("it was drawn");
        let value = |p: usize| {
            let believed =
                filter.parameters.iter().find(|(parameter, _)| own && *parameter == p).map(|(_, value)| *value);
            believed.unwrap_or(1.0 + 0.1 * p as f64)
        };
        At {
            phi: &self.phi * value(FACTOR),
            process: &self.process * value(PROCESS),
            input: value(INPUT),
            measurement: &self.measurement * value(SLOPE),
            noise: &self.noise * value(NOISE),
            constant: value(CONSTANT),
        }
    }

    /// The estimates, with a root of Γ as wide as there are noises.
    pub(crate) fn dense(&self) -> Estimates {
        let filter = self.phase.filter.as_ref().expect("it was drawn");
        let (truth, own, n) = (self.at(false), self.at(true), filter.mean.len());
        let (m, steps) = (self.measurement.nrows(), self.test.rows());
        let all = steps * (n + m);
        let (process, noise) = (root(&truth.process), root(&truth.noise));
        // [1, x_0, noises] → x, x̂, x̂_0; and with the measured values
        let width = 1 + n + all;
        let mut x = DMatrix::zeros(n, width);
        x.view_mut((0, 1), (n, n)).fill_with_identity();
        let mut estimate = DMatrix::zeros(2 * n, width);
        (0..2 * n).for_each(|i| estimate[(i, 0)] = filter.mean[i % n]);
        let mut found = DVector::from_fn(2 * n, |i, _| filter.mean[i % n]);
        let mut believed = DMatrix::from_fn(2 * n, 2 * n, |i, j| filter.covariance[(i % n, j % n)]);
        let first = |a: &DMatrix<f64>| {
            let mut whole = DMatrix::identity(2 * n, 2 * n);
            whole.view_mut((0, 0), (n, n)).copy_from(a);
            whole
        };
        let mut observations = 0;
        for k in 0..steps {
            let numbers = self.test.numbers(k);
            if k > 0 || self.step_first {
                x = &truth.phi * x;
                x[(0, 0)] += truth.input * numbers[0];
                let mut moved = x.view_mut((0, 1 + n + k * (n + m)), (n, n));
                moved += &process;
                let transition = first(&own.phi);
                estimate = &transition * estimate;
                found = &transition * found;
                estimate[(0, 0)] += own.input * numbers[0];
                found[0] += own.input * numbers[0];
                believed = &transition * believed * transition.transpose();
                let mut moved = believed.view_mut((0, 0), (n, n));
                moved += &own.process;
            }
            let taken: Vec<usize> = (0..m).filter(|&i| !numbers[1 + i].is_nan()).collect();
            observations += taken.len();
            if taken.is_empty() {
                continue;
            }
            let mut z = truth.measurement.select_rows(&taken) * &x;
            let mut added = z.view_mut((0, 1 + n + k * (n + m) + n), (taken.len(), m));
            added += noise.select_rows(&taken);
            let own_measurement = own.measurement.select_rows(&taken);
            let mut h = DMatrix::zeros(taken.len(), 2 * n);
            h.view_mut((0, 0), (taken.len(), n)).copy_from(&own_measurement);
            let r = own.noise.select_rows(&taken).select_columns(&taken);
            let s = &h * &believed * h.transpose() + &r;
            let mut gain = &believed * h.transpose() * s.try_inverse().expect("R is definite");
            for &state in &filter.consider {
                (0..taken.len()).for_each(|c| (gain[(state, c)], gain[(n + state, c)]) = (0.0, 0.0));
            }
            let left = DMatrix::identity(2 * n, 2 * n) - &gain * &h;
            believed = &left * believed * left.transpose() + &gain * r * gain.transpose();
            let values = DVector::from_fn(taken.len(), |i, _| {
                let d = if taken[i] == 0 { numbers[0] } else { 0.0 };
                z[(i, 0)] += truth.constant * d - own.constant * d;
                numbers[1 + taken[i]] - own.constant * d
            });
            found = &left * found + &gain * values;
            estimate = left * estimate + gain * z;
        }
        let mut joint = DMatrix::zeros(3 * n, all);
        joint.rows_mut(0, n).copy_from(&x.columns(1 + n, all));
        joint.rows_mut(n, 2 * n).copy_from(&estimate.columns(1 + n, all));
        Estimates {
            estimates: found,
            offsets: estimate.column(0).into_owned(),
            sensitivities: estimate.columns(1, n).into_owned(),
            transition: x.columns(1, n).into_owned(),
            drift: x.column(0).into_owned(),
            root: joint,
            constants: self.test.clone(),
            steps,
            observations,
        }
    }
}

/// F with FF' = a.
pub(crate) fn root(a: &DMatrix<f64>) -> DMatrix<f64> {
    let eigen = a.clone().symmetric_eigen();
    let size = eigen.eigenvalues.map(|value| value.max(0.0).sqrt());
    eigen.eigenvectors * DMatrix::from_diagonal(&size)
}
