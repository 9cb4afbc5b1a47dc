//! Innovations against the joint Gaussian of the measurements, against the likelihood of the fit, and by simulation.

use crate::dense;

use kalfit::estimate::{self, Settings, Silent, Solver, Structure};
use kalfit::innovations::{Innovations, innovations};
use kalfit::model::Population;
use kalfit::model::{
    Clock, Column, CovarianceStructure, Initial, Linear, MeanStructure, Measurement, Motion, Regression, State,
};
use kalfit::reduce::{PhasedTest, Plain, ReduceErrorKind, Reducer, StepMatrices};
use kalfit::{Alpha, Expression, Model, Source, Test, infer};
use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

const TAU: f64 = 4.0;
const DRIFT: f64 = 0.6;
const NOISE: [f64; 2] = [0.25, 0.16];
const COVARIANCE: f64 = 0.1;
const EMPTY: f64 = f64::NAN;

fn number(x: f64) -> Expression {
    Expression::Number(x)
}

fn linear(terms: Vec<(usize, Expression)>) -> Linear {
    Linear { terms, constant: number(0.0) }
}

/// bias and scale are estimated, drift is Gauss-Markov from its stationary distribution; y1 = bias + scale u + drift and y2 = scale
/// have correlated noise. The mean of bias moves with column w. Columns: t, y1, y2, u, w.
fn model() -> Model {
    let state = |name: &str, motion, initial| State {
        name: name.to_owned(),
        unit: None,
        motion,
        initial,
        offset: None,
        random: true,
    };
    let drift = Motion::Continuous {
        derivative: linear(vec![(2, number(-1.0 / TAU))]),
        noise_variance: number(2.0 * DRIFT * DRIFT / TAU),
    };
    let measurement = |name: &str, column, terms, noise| Measurement {
        name: name.to_owned(),
        column,
        filter: None,
        equation: linear(terms),
        noise_variance: number(noise),
    };
    let one = || number(1.0);
    Model {
        title: String::new(),
        columns: ["t", "y1", "y2", "u", "w"].map(|n| Column { name: n.to_owned(), used_in: String::new() }).to_vec(),
        text_columns: Vec::new(),
        literals: Vec::new(),
        parameters: Vec::new(),
        states: vec![
            state("bias", Motion::Constant, Initial::Estimated),
            state("scale", Motion::Constant, Initial::Estimated),
            state("drift", drift, Initial::Stationary),
        ],
        process_noise_covariance: Vec::new(),
        measurements: vec![
            measurement("y1", 1, vec![(0, one()), (1, Expression::Column(3)), (2, one())], NOISE[0]),
            measurement("y2", 2, vec![(1, one())], NOISE[1]),
        ],
        noise_covariance: vec![(0, 1, number(COVARIANCE))],
        clock: Clock { time: Some(0), ..Clock::default() },
        group: None,
        estimated: vec![0, 1],
        mean: MeanStructure { regression: vec![Regression { element: 0, column: 4 }], ..MeanStructure::free(2) },
        covariance: CovarianceStructure::full(),
    }
}

type Rows = Vec<[f64; 5]>;

fn test(id: &str, rows: &Rows) -> Test {
    let mut test = Test::new(id, 5, 0);
    rows.iter().enumerate().for_each(|(k, row)| test.push(row, &[], Source { file: 0, row: k as u64 + 2 }));
    test
}

/// The same test by hand, drift's law written from its closed form.
fn plain(id: &str, rows: &Rows) -> Plain {
    let sensitivity = DMatrix::from_row_slice(3, 2, &[1.0, 0.0, 0.0, 1.0, 0.0, 0.0]);
    let start = DMatrix::from_diagonal(&DVector::from_vec(vec![0.0, 0.0, DRIFT * DRIFT]));
    let mut test = Plain::new(id, DVector::zeros(3), sensitivity, start);
    for (k, row) in rows.iter().enumerate() {
        let measurement = DMatrix::from_row_slice(2, 3, &[1.0, row[3], 1.0, 0.0, 1.0, 0.0]);
        let measurement = measurement.map(|x| if x.is_nan() { 0.0 } else { x });
        let noise = DMatrix::from_row_slice(2, 2, &[NOISE[0], COVARIANCE, COVARIANCE, NOISE[1]]);
        let mut step = StepMatrices::new(measurement, noise, DVector::from_vec(vec![row[1], row[2]]));
        if k > 0 {
            let phi = (-(row[0] - rows[k - 1][0]) / TAU).exp();
            let mut transition = DMatrix::identity(3, 3);
            transition[(2, 2)] = phi;
            let mut q = DMatrix::zeros(3, 3);
            q[(2, 2)] = DRIFT * DRIFT * (1.0 - phi * phi);
            step = step.moving(transition, q);
        }
        test.steps.push(step);
    }
    test
}

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    rng.sample(StandardNormal)
}

/// A test of the model, with bias ~ N(1 + 0.5 w, 2), scale ~ N(-2, 0.1), drift scaled by `drift`, noise by `noise`.
fn simulated(seed: u64, steps: usize, noise: f64, drift: f64, gaps: bool) -> Rows {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let w = normal(&mut rng);
    let bias = 1.0 + 0.5 * w + 2f64.sqrt() * normal(&mut rng);
    let scale = -2.0 + 0.1f64.sqrt() * normal(&mut rng);
    let (mut d, mut t) = (DRIFT * normal(&mut rng), 0.0);
    let corner = (NOISE[1] - COVARIANCE * COVARIANCE / NOISE[0]).sqrt();
    let row = |k: usize| {
        if k > 0 {
            let step = 0.5 + rng.random::<f64>();
            let phi = (-step / TAU).exp();
            d = phi * d + DRIFT * (1.0 - phi * phi).sqrt() * normal(&mut rng);
            t += step;
        }
        let (a, b, u) = (normal(&mut rng), normal(&mut rng), normal(&mut rng));
        let y1 = bias + scale * u + drift * d + noise * NOISE[0].sqrt() * a;
        let y2 = scale + noise * (COVARIANCE / NOISE[0].sqrt() * a + corner * b);
        let lost = |p: f64, rng: &mut ChaCha8Rng| gaps && rng.random::<f64>() < p;
        let (one, two) = (lost(0.2, &mut rng), lost(0.3, &mut rng));
        [t, if one { EMPTY } else { y1 }, if two { EMPTY } else { y2 }, u, w]
    };
    (0..steps).map(row).collect()
}

fn truth() -> Population {
    Population {
        mean: vec![1.0, -2.0],
        coefficients: vec![0.5],
        covariance: DMatrix::from_diagonal(&DVector::from_vec(vec![2.0, 0.1])),
    }
}

fn run(model: &Model, initial: &Population, tests: &[Test]) -> Vec<Innovations> {
    let tests: Vec<PhasedTest> = tests.iter().cloned().map(Into::into).collect();
    let found = innovations(&model.clone().into(), &Alpha::default(), initial, &tests).expect("sound");
    found.into_iter().map(|one| one.expect("rows")).collect()
}

/// (residuals whitened by Cholesky of their joint covariance, residual given those before, its variance)
fn oracle(rows: &Rows, initial: &Population) -> Vec<(f64, f64)> {
    let law = dense::dense(&plain("t", rows));
    let mut mu = DVector::from_column_slice(&initial.mean);
    mu[0] += initial.coefficients[0] * rows[0][4];
    let omega = &law.covariance + &law.sensitivity * &initial.covariance * law.sensitivity.transpose();
    let factor = omega.cholesky().expect("positive definite").l();
    let white = factor.solve_lower_triangular(&(&law.values - &law.mean - &law.sensitivity * mu)).expect("regular");
    white.iter().zip(factor.diagonal().iter()).map(|(&z, &l)| (z, l * l)).collect()
}

#[test]
fn innovations_are_the_residuals_whitened_by_cholesky_of_their_joint_covariance() {
    let singular = DMatrix::from_row_slice(2, 2, &[4.0, -2.0, -2.0, 1.0]);
    let laws = [truth(), Population { covariance: singular, ..truth() }];
    let laws = laws.into_iter().chain([Population { covariance: DMatrix::zeros(2, 2), ..truth() }]);
    for initial in laws {
        for seed in 0..20 {
            let rows = simulated(seed, 3 + seed as usize, 1.0, 1.0, true);
            let expected = oracle(&rows, &initial);
            let found = run(&model(), &initial, &[test("t", &rows)]).remove(0);
            assert_eq!(found.summary.count, expected.len(), "seed {seed}");
            for (k, (one, (z, s))) in found.series.iter().zip(&expected).enumerate() {
                assert!((one.standardised - z).abs() < 1e-10, "seed {seed}, {k}: {} {z}", one.standardised);
                assert!((one.variance / s - 1.0).abs() < 1e-10, "seed {seed}, {k}: {} {s}", one.variance);
                assert!((one.value - z * s.sqrt()).abs() < 1e-10, "seed {seed}, {k}: {}", one.value);
                assert_eq!(one.time, Some(rows[one.step][0]), "seed {seed}, {k}");
                assert!(!rows[one.step][1 + one.measurement].is_nan(), "seed {seed}, {k}: it was measured");
            }
            let nis: f64 = expected.iter().map(|(z, _)| z * z).sum();
            assert!((found.summary.nis - nis).abs() < 1e-9 * (1.0 + nis), "seed {seed}: {} {nis}", found.summary.nis);
        }
    }
}

#[test]
fn innovations_add_up_to_the_likelihood_of_each_test_in_a_fit() {
    let model = model();
    for (scale, precise) in [(1.0, false), (1e6, true)] {
        let mut model = model.clone();
        // with noise far below the spread of the tests, plain covariance arithmetic is given up for square roots
        if precise {
            model.measurements.iter_mut().for_each(|m| m.noise_variance = number(1e-8));
            model.noise_covariance.clear();
        }
        let tests: Vec<Test> = (0..30)
            .map(|seed| {
                let mut rows = simulated(seed, 6, 1.0, 1.0, true);
                rows.iter_mut().for_each(|row| (row[1], row[2]) = (scale * row[1], scale * row[2]));
                test(&format!("t{seed}"), &rows)
            })
            .collect();
        let alpha = Alpha::default();
        let reductions = Reducer::new(&model, &alpha).expect("sound").reduce(&tests).expect("sound");
        let structure = Structure::single(&model.mean, &model.covariance, &alpha);
        let fit = estimate::fit(&reductions, &structure, &Settings::of(Solver::Newton), &mut Silent).expect("a fit");
        let posteriors = infer::posteriors(&fit, &reductions);
        let found = run(&model, &Population::from(&fit), &tests);
        for ((one, posterior), reduction) in found.iter().zip(posteriors.iter()).zip(&reductions) {
            let (a, b) = (one.log_likelihood, posterior.log_likelihood);
            assert!((a - b).abs() < 1e-9 * (1.0 + b.abs()), "scale {scale}, {}: {a} {b}", one.test);
            assert_eq!((&*one.test, one.summary.count), (reduction.test, reduction.observations));
        }
    }
}

#[test]
fn batches_order_and_threads_change_nothing() {
    let tests: Vec<Test> =
        (0..40).map(|seed| test(&format!("t{seed}"), &simulated(seed % 7, 8, 1.0, 1.0, true))).collect();
    let all = run(&model(), &truth(), &tests);
    let reversed: Vec<Test> = tests.iter().rev().cloned().collect();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool");
    let mut back = pool.install(|| run(&model(), &truth(), &reversed));
    back.reverse();
    assert_eq!(all, back);
    let single: Vec<Innovations> =
        tests.iter().flat_map(|test| run(&model(), &truth(), std::slice::from_ref(test))).collect();
    assert_eq!(all, single);
}

#[test]
fn tail_probabilities_are_uniform_when_the_model_is_right() {
    let tests: Vec<Test> =
        (0..2000).map(|seed| test(&format!("t{seed}"), &simulated(seed, 40, 1.0, 1.0, true))).collect();
    let found = run(&model(), &truth(), &tests);
    let part = |below: f64, p: &dyn Fn(&Innovations) -> f64| {
        found.iter().filter(|one| p(one) < below).count() as f64 / found.len() as f64
    };
    let statistics: f64 = found.iter().filter_map(|one| one.summary.whiteness).map(|w| w.statistic).sum();
    let freedom: usize = found.iter().filter_map(|one| one.summary.whiteness).map(|w| w.degrees_of_freedom).sum();
    let mean = statistics / freedom as f64;
    assert!((mean - 1.0).abs() < 0.03, "Ljung-Box statistic per degree of freedom: {mean}");
    for level in [0.05, 0.2, 0.5] {
        let error = 4.0 * (level * (1.0 - level) / found.len() as f64).sqrt();
        let nis = part(level, &|one| one.summary.p_value(0).expect("measured"));
        assert!((nis - level).abs() < error, "NIS below {level}: {nis}");
        let white = part(level, &|one| one.summary.whiteness.expect("long enough").p_value);
        assert!((white - level).abs() < error + 0.02, "whiteness below {level}: {white}");
        let mean = part(level, &|one| {
            let z = one.summary.mean.expect("measured") * (one.summary.count as f64).sqrt();
            statrs::function::erf::erfc(z.abs() / std::f64::consts::SQRT_2)
        });
        assert!((mean - level).abs() < error, "mean below {level}: {mean}");
    }
}

#[test]
fn noise_that_is_larger_smaller_or_coloured_is_found_out() {
    let one = |noise: f64, drift: f64| {
        run(&model(), &truth(), &[test("t", &simulated(7, 200, noise, drift, false))]).remove(0)
    };
    let (right, large, small, coloured) = (one(1.0, 1.0), one(1.5, 1.0), one(0.6, 1.0), one(1.0, 3.0));
    assert!(right.summary.p_value(0).expect("measured") > 0.01, "{:?}", right.summary.p_value(0));
    assert!(right.summary.whiteness.expect("long").p_value > 0.01, "{:?}", right.summary.whiteness);
    assert!(large.summary.upper_tail.expect("measured") < 1e-6, "{:?}", large.summary.upper_tail);
    assert!(small.summary.lower_tail.expect("measured") < 1e-6, "{:?}", small.summary.lower_tail);
    assert!(coloured.summary.whiteness.expect("long").p_value < 1e-3, "{:?}", coloured.summary.whiteness);
}

/// One test that determines its own mean leaves small innovations, which is no finding.
#[test]
fn innovations_that_the_estimate_absorbed_are_not_too_small() {
    let tests = [test("t", &simulated(3, 2, 1.0, 1.0, false))];
    let mut model = model();
    model.mean.regression.clear();
    let alpha = Alpha::default();
    let reductions = Reducer::new(&model, &alpha).expect("sound").reduce(&tests).expect("sound");
    let structure = Structure::single(&model.mean, &model.covariance, &alpha);
    let fit = estimate::fit(&reductions, &structure, &Settings::of(Solver::Newton), &mut Silent).expect("a fit");
    let found = run(&model, &Population::from(&fit), &tests).remove(0);
    let (known, estimated) = (found.summary.p_value(0).expect("measured"), found.summary.p_value(2).expect("measured"));
    assert!(found.summary.count == 4 && estimated > known && estimated > 0.05, "{known} {estimated}");
}

#[test]
fn a_test_without_measurements_has_no_figures() {
    let found = run(&model(), &truth(), &[test("t", &vec![[0.0, EMPTY, EMPTY, 0.0, 1.0]])]).remove(0);
    assert_eq!((found.summary.count, found.summary.nis, found.log_likelihood), (0, 0.0, 0.0));
    assert_eq!((found.summary.p_value(0), found.summary.mean, found.summary.whiteness), (None, None, None));
}

#[test]
fn an_initial_state_of_another_shape_is_refused() {
    let wrong = Population { mean: vec![0.0], ..truth() };
    let error = innovations(&model().into(), &Alpha::default(), &wrong, &[]).expect_err("refused");
    assert_eq!(*error.kind, ReduceErrorKind::Shape { found: (1, 1), expected: (2, 1) });
    let negative = Population { covariance: -truth().covariance, ..truth() };
    let error = innovations(&model().into(), &Alpha::default(), &negative, &[]).expect_err("refused");
    assert!(matches!(*error.kind, ReduceErrorKind::NotSemidefinite { .. }), "{error}");
}
