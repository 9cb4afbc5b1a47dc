//! Drawn ensembles against the joint Gaussian of the model, written down by hand.

use crate::dense;

use dense::dense;
use kalfit::model::{
    Clock, Column, CovarianceStructure, Initial, Linear, MeanStructure, Measurement, Motion, Operator, Regression,
    State,
};
use kalfit::reduce::{Evidence, Plain, Reducer, StepMatrices};
use kalfit::simulate::{Designs, Drawn, SimulateError, Simulator};
use kalfit::{Alpha, Expression, Model, Population, Source, Test};
use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

const EMPTY: f64 = f64::NAN;

fn number(x: f64) -> Expression {
    Expression::Number(x)
}

fn linear(terms: Vec<(usize, Expression)>, constant: Expression) -> Linear {
    Linear { terms, constant }
}

fn state(name: &str, motion: Motion, initial: Initial) -> State {
    State { name: name.to_owned(), unit: None, motion, initial, offset: None, random: true }
}

fn meter(name: &str, column: usize, equation: Linear, noise: f64) -> Measurement {
    Measurement { name: name.to_owned(), column, filter: None, equation, noise_variance: number(noise) }
}

/// Columns t, z1, z2, u, c.
fn model(states: Vec<State>, measurements: Vec<Measurement>) -> Model {
    let estimated: Vec<usize> = (0..states.len()).filter(|&i| states[i].initial == Initial::Estimated).collect();
    let named = |name: &&str| Column { name: (*name).to_owned(), used_in: String::new() };
    Model {
        title: String::new(),
        columns: ["t", "z1", "z2", "u", "c"].iter().map(named).collect(),
        text_columns: Vec::new(),
        literals: Vec::new(),
        parameters: Vec::new(),
        process_noise_covariance: Vec::new(),
        measurements,
        noise_covariance: Vec::new(),
        clock: Clock { time: Some(0), ..Clock::default() },
        group: None,
        mean: MeanStructure::free(estimated.len()),
        covariance: CovarianceStructure::full(),
        estimated,
        states,
    }
}

fn test(id: &str, rows: &[[f64; 5]]) -> Test {
    let mut test = Test::new(id, 5, 0);
    rows.iter().for_each(|row| test.push(row, &[], Source::default()));
    test
}

/// t, z1, z2, u, c. Two rows of one step, a step without measurements, unequal steps.
const ROWS: [[f64; 5]; 6] = [
    [0.0, 9.0, 9.0, 0.5, 1.5],
    [0.4, 9.0, EMPTY, -1.0, 1.5],
    [0.4, EMPTY, 9.0, EMPTY, 1.5],
    [1.1, EMPTY, EMPTY, 0.8, 1.5],
    [1.5, 9.0, 9.0, 2.0, 1.5],
    [3.0, EMPTY, 9.0, 0.1, 1.5],
];

/// The numbers of a random model.
#[derive(Debug, Clone, Copy)]
struct Numbers {
    tau: f64,
    sigma: f64,
    walk: f64,
    cross: f64,
    f: f64,
    step: f64,
    noise: [f64; 2],
    joint: f64,
    start: (f64, f64),
    offset: f64,
    coefficient: f64,
}

impl Numbers {
    fn random(random: &mut ChaCha8Rng) -> Numbers {
        let mut between = |a: f64, b: f64| a + (b - a) * random.random::<f64>();
        let (tau, sigma, walk) = (between(0.3, 4.0), between(0.2, 1.5), between(0.05, 0.5));
        let noise = [between(0.05, 0.5), between(0.05, 0.5)];
        Numbers {
            tau,
            sigma,
            walk,
            cross: between(-0.9, 0.9) * (walk * 2.0 * sigma * sigma / tau).sqrt(),
            f: between(-0.9, 0.9),
            step: between(0.0, 0.3),
            noise,
            joint: between(-0.95, 0.95) * (noise[0] * noise[1]).sqrt(),
            start: (between(-1.0, 1.0), between(0.0, 0.5)),
            offset: between(-2.0, 2.0),
            coefficient: between(-1.0, 1.0),
        }
    }

    /// bias and gain are estimated; drift is stationary; angle' = bias + 0.5 drift + u + noise; memory is discrete.
    fn model(&self) -> Model {
        let white = 2.0 * self.sigma * self.sigma / self.tau;
        let drift = linear(vec![(2, number(-1.0 / self.tau))], number(0.0));
        let angle = linear(vec![(0, number(1.0)), (2, number(0.5))], Expression::Column(3));
        let scaled = Expression::Binary(Operator::Multiply, Box::new(number(0.3)), Box::new(Expression::Column(3)));
        let memory = linear(vec![(4, number(self.f))], scaled);
        let known = Initial::Known { mean: number(self.start.0), variance: number(self.start.1) };
        let mut bias = state("bias", Motion::Constant, Initial::Estimated);
        bias.offset = Some(number(self.offset));
        let states = vec![
            bias,
            state("gain", Motion::Constant, Initial::Estimated),
            state(
                "drift",
                Motion::Continuous { derivative: drift, noise_variance: number(white) },
                Initial::Stationary,
            ),
            state("angle", Motion::Continuous { derivative: angle, noise_variance: number(self.walk) }, known),
            state(
                "memory",
                Motion::Discrete { next: memory, noise_variance: number(self.step) },
                Initial::Known { mean: number(0.0), variance: number(0.0) },
            ),
        ];
        let first = linear(vec![(2, number(1.0)), (3, number(1.0))], number(0.25));
        let second = linear(vec![(1, Expression::Column(3)), (4, number(1.0))], Expression::Column(4));
        let mut model = model(states, vec![meter("a", 1, first, self.noise[0]), meter("b", 2, second, self.noise[1])]);
        // the second row of a step has no input of its own
        model.measurements[1].equation.terms[0].1 = number(1.7);
        model.process_noise_covariance.push((2, 3, number(self.cross)));
        model.noise_covariance.push((0, 1, number(self.joint)));
        model.mean.regression.push(Regression { element: 1, column: 4 });
        model
    }

    /// The same in matrices, over [`ROWS`].
    fn plain(&self) -> Plain {
        let offset = DVector::from_vec(vec![self.offset, 0.0, 0.0, self.start.0, 0.0]);
        let sensitivity = DMatrix::from_fn(5, 2, |i, j| f64::from(u8::from(i == j)));
        let variance = [0.0, 0.0, self.sigma * self.sigma, self.start.1, 0.0];
        let start = DMatrix::from_diagonal(&DVector::from_row_slice(&variance));
        let mut plain = Plain::new("", offset, sensitivity, start);
        let step = |dt: f64, u: f64, z: [f64; 2]| {
            let h = DMatrix::from_row_slice(2, 5, &[0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.7, 0.0, 0.0, 1.0]);
            let noise = DMatrix::from_row_slice(2, 2, &[self.noise[0], self.joint, self.joint, self.noise[1]]);
            let step = StepMatrices::new(h, noise, DVector::from_row_slice(&z));
            let step = step.with_constant(DVector::from_row_slice(&[0.25, 1.5]));
            if dt == 0.0 { step } else { self.moving(step, dt, u) }
        };
        plain.steps.push(step(0.0, 0.5, [9.0, 9.0]));
        plain.steps.push(step(0.4, -1.0, [9.0, 9.0]));
        plain.steps.push(step(1.1 - 0.4, 0.8, [EMPTY, EMPTY]));
        plain.steps.push(step(1.5 - 1.1, 2.0, [9.0, 9.0]));
        plain.steps.push(step(1.5, 0.1, [EMPTY, 9.0]));
        plain
    }

    /// Van Loan's exponential with the input as one more state.
    fn moving(&self, step: StepMatrices, dt: f64, u: f64) -> StepMatrices {
        let mut f = DMatrix::zeros(6, 6);
        (f[(2, 2)], f[(3, 0)], f[(3, 2)], f[(3, 5)]) = (-1.0 / self.tau, 1.0, 0.5, u);
        let mut g = DMatrix::zeros(6, 6);
        (g[(2, 2)], g[(3, 3)]) = (2.0 * self.sigma * self.sigma / self.tau, self.walk);
        (g[(2, 3)], g[(3, 2)]) = (self.cross, self.cross);
        let mut block = DMatrix::zeros(12, 12);
        block.view_mut((0, 0), (6, 6)).copy_from(&(&f * -dt));
        block.view_mut((0, 6), (6, 6)).copy_from(&(g * dt));
        block.view_mut((6, 6), (6, 6)).copy_from(&(f.transpose() * dt));
        let power = exponential(&block);
        let whole = power.view((6, 6), (6, 6)).transpose();
        let q = &whole * power.view((0, 6), (6, 6));
        let mut phi = whole.view((0, 0), (5, 5)).clone_owned();
        let mut input = whole.view((0, 5), (5, 1)).column(0).clone_owned();
        (phi[(4, 4)], input[4]) = (self.f, 0.3 * u);
        let mut q = q.view((0, 0), (5, 5)).clone_owned();
        q[(4, 4)] = self.step;
        step.moving(phi, (&q + q.transpose()) * 0.5).with_input(input)
    }
}

/// Independent exponential: Taylor over 2^-20 of the step, squared.
fn exponential(f: &DMatrix<f64>) -> DMatrix<f64> {
    let small = f / 1_048_576.0;
    let mut sum = DMatrix::identity(f.nrows(), f.nrows());
    let mut power = sum.clone();
    for k in 1..8 {
        power = &power * &small / f64::from(k);
        sum += &power;
    }
    (0..20).fold(sum, |x, _| &x * &x)
}

fn simulator(model: &Model, population: Population, seed: u64) -> Simulator {
    Simulator::new(&model.clone().into(), &Alpha::default(), population, seed).expect("a sound model and population")
}

/// The rows of a test in one phase.
fn rows(drawn: &Drawn) -> &Test {
    let [Evidence::Rows(rows)] = &drawn.test.phases[..] else { panic!("{} phases", drawn.test.phases.len()) };
    rows
}

fn draw(simulator: &Simulator, design: Test, count: u64) -> Vec<Drawn> {
    let designs = Designs::new(vec![design.into()]).expect("one test");
    simulator.draw(&designs, 0..count).expect("a sound design")
}

/// Measured values in the order of steps and, within a step, of rows.
fn values(test: &Test) -> DVector<f64> {
    let cells = (0..test.rows()).flat_map(|row| [test.numbers(row)[1], test.numbers(row)[2]]);
    DVector::from_vec(cells.filter(|z| !z.is_nan()).collect())
}

/// Mean and covariance of a sample lie within 4 standard errors of those of a normal law.
#[track_caller]
pub(crate) fn assert_law(what: &str, sample: &[DVector<f64>], mean: &DVector<f64>, covariance: &DMatrix<f64>) {
    let (n, count) = (mean.len(), sample.len() as f64);
    let found = sample.iter().fold(DVector::zeros(n), |sum, z| sum + z) / count;
    let spread = sample.iter().fold(DMatrix::zeros(n, n), |sum, z| sum + (z - mean) * (z - mean).transpose()) / count;
    for i in 0..n {
        let unit = (covariance[(i, i)] / count).sqrt() + 1e-12;
        let away = (found[i] - mean[i]) / unit;
        assert!(away.abs() < 4.0, "{what}, mean {i}: {} against {}, {away:.1} sigma", found[i], mean[i]);
        for j in 0..=i {
            let (a, b) = (spread[(i, j)], covariance[(i, j)]);
            let unit = ((covariance[(i, i)] * covariance[(j, j)] + b * b) / count).sqrt() + 1e-12;
            let away = (a - b) / unit;
            assert!(away.abs() < 4.0, "{what}, covariance {i},{j}: {a} against {b}, {away:.1} sigma");
        }
    }
}

#[test]
fn drawn_measurements_have_the_law_of_the_joint_gaussian() {
    for seed in 0..6 {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let numbers = Numbers::random(&mut random);
        let mut normal = || random.sample::<f64, _>(StandardNormal);
        let rank = 1 + (seed % 2) as usize; // singular covariances too
        let root = DMatrix::from_fn(2, rank, |_, _| normal());
        let mean = vec![normal(), normal()];
        let covariance = &root * root.transpose();
        let mut at = mean.clone();
        at[1] += numbers.coefficient * 1.5;
        let population = Population { mean, coefficients: vec![numbers.coefficient], covariance: covariance.clone() };
        let drawn = draw(&simulator(&numbers.model(), population, 100 + seed), test("a", &ROWS), 4000);
        let law = dense(&numbers.plain());
        let z: Vec<DVector<f64>> = drawn.iter().map(|drawn| values(rows(drawn))).collect();
        let mu = DVector::from_vec(at);
        let total = &law.covariance + &law.sensitivity * &covariance * law.sensitivity.transpose();
        assert_law(&format!("seed {seed}, z"), &z, &(&law.mean + &law.sensitivity * &mu), &total);
        let xi: Vec<DVector<f64>> = drawn.iter().map(|d| DVector::from_row_slice(&d.initial)).collect();
        assert_law(&format!("seed {seed}, xi"), &xi, &mu, &covariance);
        // what is left of z once its own ξ is known is the noise, independent of it
        let left: Vec<DVector<f64>> = z.iter().zip(&xi).map(|(z, xi)| z - &law.mean - &law.sensitivity * xi).collect();
        assert_law(&format!("seed {seed}, noise"), &left, &DVector::zeros(law.mean.len()), &law.covariance);
    }
}

#[test]
fn the_model_that_is_drawn_is_the_one_that_is_reduced() {
    // Drawn tests and the matrices of the oracle have one log-likelihood at the true ξ.
    let numbers = Numbers::random(&mut ChaCha8Rng::seed_from_u64(11));
    let population = Population { mean: vec![1.0, 2.0], coefficients: vec![0.0], covariance: DMatrix::identity(2, 2) };
    let drawn = draw(&simulator(&numbers.model(), population, 5), test("a", &ROWS), 3);
    let tests: Vec<Test> = drawn.iter().map(|drawn| rows(drawn).clone()).collect();
    let reductions = Reducer::new(&numbers.model(), &Alpha::default()).expect("sound").reduce(&tests).expect("sound");
    for (reduction, drawn) in reductions.iter().zip(&drawn) {
        let law = dense(&numbers.plain());
        let xi = DVector::from_row_slice(&drawn.initial);
        let left = values(rows(drawn)) - &law.mean - &law.sensitivity * &xi;
        let expected = dense::log_density(&left, &law.covariance);
        let r = &reduction.factor;
        let residual = [reduction.data[0] - r[0] * xi[0] - r[1] * xi[1], reduction.data[1] - r[2] * xi[1]];
        let found = reduction.constant - 0.5 * residual.iter().map(|x| x * x).sum::<f64>();
        assert!((found - expected).abs() < 1e-10 * (1.0 + expected.abs()), "{found} against {expected}");
    }
}

#[test]
fn draws_do_not_depend_on_threads_or_batches() {
    let numbers = Numbers::random(&mut ChaCha8Rng::seed_from_u64(3));
    let population = Population { mean: vec![0.0, 1.0], coefficients: vec![0.2], covariance: DMatrix::identity(2, 2) };
    let simulator = simulator(&numbers.model(), population, 9);
    let designs = Designs::new(vec![test("a", &ROWS).into(), test("b", &ROWS[..4]).into()]).expect("two tests");
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| simulator.draw(&designs, 0..50)).expect("sound")
    };
    let bits = |drawn: &[Drawn]| -> Vec<u64> {
        drawn
            .iter()
            .flat_map(|d| values(rows(d)).iter().chain(&d.initial).map(|x| x.to_bits()).collect::<Vec<_>>())
            .collect()
    };
    let (one, two) = (run(1), run(2));
    assert_eq!(bits(&one), bits(&two), "one thread and two");
    let part = simulator.draw(&designs, 17..23).expect("sound");
    assert_eq!(bits(&part), bits(&one[17..23]), "a part of the ensemble");
    assert_eq!(part[0].test.id, "b#9");
    assert_ne!(bits(&one[..2]), bits(&one[2..4]), "rounds differ");
}

#[test]
fn only_measured_cells_change() {
    let numbers = Numbers::random(&mut ChaCha8Rng::seed_from_u64(4));
    let population = Population { mean: vec![0.0, 1.0], coefficients: vec![0.2], covariance: DMatrix::identity(2, 2) };
    let drawn = draw(&simulator(&numbers.model(), population, 9), test("a", &ROWS), 1);
    for (row, before) in ROWS.iter().enumerate() {
        let after = rows(&drawn[0]).numbers(row);
        for column in 0..5 {
            let measured = (1..3).contains(&column) && !before[column].is_nan();
            let same = after[column].to_bits() == before[column].to_bits();
            assert_eq!(same, !measured, "row {row}, column {column}: {} after {}", after[column], before[column]);
        }
    }
}

#[test]
fn without_any_noise_the_path_is_exact() {
    let motion = Motion::Discrete { next: linear(vec![(0, number(2.0))], number(1.0)), noise_variance: number(0.0) };
    let equation = linear(vec![(0, number(1.0))], number(0.5));
    let model = model(vec![state("x", motion, Initial::Estimated)], vec![meter("z", 1, equation, 0.0)]);
    let population = Population { mean: vec![3.0], coefficients: vec![], covariance: DMatrix::zeros(1, 1) };
    let steps = [[0.0, 1.0, EMPTY, 0.0, 0.0], [1.0, 1.0, EMPTY, 0.0, 0.0], [2.0, 1.0, EMPTY, 0.0, 0.0]];
    let drawn = draw(&simulator(&model, population, 1), test("a", &steps), 1);
    assert_eq!(values(rows(&drawn[0])).as_slice(), [3.5, 7.5, 15.5]);
}

#[test]
fn what_cannot_be_drawn_is_refused() {
    let one = || linear(vec![(0, number(1.0))], number(0.0));
    let level = || vec![state("x", Motion::Constant, Initial::Estimated)];
    let population = |variance: f64| Population {
        mean: vec![3.0],
        coefficients: vec![],
        covariance: DMatrix::from_element(1, 1, variance),
    };
    let twice = model(level(), vec![meter("a", 1, one(), 1.0), meter("b", 1, one(), 1.0)]);
    let designs = Designs::new(vec![test("t", &ROWS).into()]).expect("one test");
    let refusal = simulator(&twice, population(1.0), 1).draw(&designs, 0..1).expect_err("a cell for two");
    assert!(
        matches!(&refusal, SimulateError::SharedCell { first, second, .. } if first == "a" && second == "b"),
        "{refusal}"
    );
    let feeds = model(level(), vec![meter("a", 1, linear(vec![(0, Expression::Column(1))], number(0.0)), 1.0)]);
    let refusal = Simulator::new(&feeds.into(), &Alpha::default(), population(1.0), 1).expect_err("an input is drawn");
    assert_eq!(refusal, SimulateError::MeasuredInput { column: "z1".to_owned() });
    let sound = model(level(), vec![meter("a", 1, one(), 1.0)]);
    for bad in [-1.0, f64::NAN, f64::INFINITY] {
        let refusal = Simulator::new(&sound.clone().into(), &Alpha::default(), population(bad), 1);
        assert!(matches!(refusal, Err(SimulateError::Population(_))), "a variance of {bad}: {refusal:?}");
    }
    let mut joint = model(level(), vec![meter("a", 1, one(), 1.0), meter("b", 2, one(), 1.0)]);
    joint.noise_covariance.push((0, 1, number(2.0)));
    let refusal = simulator(&joint, population(1.0), 1).draw(&designs, 0..1).expect_err("no covariance matrix");
    assert!(matches!(refusal, SimulateError::Reduce(_)), "{refusal}");
}
