//! Standard errors from the expected information beside free parameters, against the dense law of the data.

use kalfit::build::{Columns, constant, free, gauss_markov, measurement, name};
use kalfit::estimate::Silent;
use kalfit::infer::{Choices, StdErrors};
use kalfit::model::Model;
use kalfit::{Ensemble, Options};
use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

/// Times, inputs and values of a test.
struct Drawn {
    times: Vec<f64>,
    inputs: Vec<f64>,
    values: Vec<f64>,
}

/// μ of bias and gain, their standard deviations, τ and σ of the drift, the noise, and the input's own coefficient.
const TRUTH: [f64; 8] = [1.0, -0.5, 0.7, 0.4, 1.5, 0.6, 0.3, 0.8];

/// Mean and covariance of a test at such values: y = bias + gain u + drift + c u² + noise.
fn law(test: &Drawn, at: &[f64]) -> (DVector<f64>, DMatrix<f64>) {
    let [bias, gain, bias_spread, gain_spread, tau, sigma, noise, own] = *at else { panic!("eight values") };
    let (t, u, n) = (&test.times, &test.inputs, test.times.len());
    let mean = DVector::from_fn(n, |k, _| bias + gain * u[k] + own * u[k] * u[k]);
    let variance = DMatrix::from_fn(n, n, |k, l| {
        bias_spread.powi(2)
            + gain_spread.powi(2) * u[k] * u[l]
            + sigma * sigma * (-(t[k] - t[l]).abs() / tau).exp()
            + if k == l { noise * noise } else { 0.0 }
    });
    (mean, variance)
}

fn drawn() -> Vec<Drawn> {
    let mut rng = ChaCha8Rng::seed_from_u64(31);
    let mut one = |j: usize| {
        let n = 9 + j % 5;
        let mut time = 0.0;
        let times: Vec<f64> = (0..n)
            .map(|_| {
                time += rng.random_range(0.1..0.9);
                time
            })
            .collect();
        let inputs: Vec<f64> = (0..n).map(|_| rng.random_range(-1.0..1.0)).collect();
        let mut test = Drawn { times, inputs, values: Vec::new() };
        let (mean, variance) = law(&test, &TRUTH);
        let z = DVector::<f64>::from_fn(n, |_, _| rng.sample(StandardNormal));
        test.values = (mean + variance.cholesky().expect("positive").l() * z).as_slice().to_vec();
        test
    };
    (0..40).map(&mut one).collect()
}

/// Σ_j m_a'V⁻¹m_b + ½ tr(V⁻¹V_aV⁻¹V_b), by differences.
fn information(tests: &[Drawn], at: &[f64]) -> DMatrix<f64> {
    let k = at.len();
    let mut sum = DMatrix::zeros(k, k);
    for test in tests {
        let inverse = law(test, at).1.try_inverse().expect("positive");
        let slope = |i: usize| {
            let h = 1e-4 * at[i].abs();
            let moved = |sign: f64| {
                let mut there = at.to_vec();
                there[i] += sign * h;
                law(test, &there)
            };
            let ((m, v), (other, w)) = (moved(1.0), moved(-1.0));
            ((m - other) / (2.0 * h), &inverse * (v - w) / (2.0 * h))
        };
        let slopes: Vec<_> = (0..k).map(slope).collect();
        sum += DMatrix::from_fn(k, k, |a, b| {
            let ((m, v), (other, w)) = (&slopes[a], &slopes[b]);
            m.dot(&(&inverse * other)) + 0.5 * (v * w).trace()
        });
    }
    sum
}

#[test]
fn expected_errors_beside_a_time_constant_are_those_of_the_dense_law() {
    let tests = drawn();
    let columns: Vec<Columns> = tests
        .iter()
        .enumerate()
        .map(|(j, test)| {
            let [t, u, y] = [&test.times, &test.inputs, &test.values].map(|column| column.iter().copied());
            Columns::new(format!("t{j:02}")).numbers("t", t).numbers("u", u).numbers("y", y)
        })
        .collect();
    let equation = name("bias") + name("gain") * name("u") + name("drift") + name("c") * name("u") * name("u");
    let mut builder = Model::builder("drift")
        .time("t")
        .state(constant("bias"))
        .state(constant("gain"))
        .state(gauss_markov("drift", "tau", "s"))
        .measurement(measurement("y", equation, "r"))
        .diagonal();
    for parameter in ["tau", "s", "r", "c"] {
        builder = builder.parameter(free(parameter));
    }
    let ensemble = Ensemble::new(&builder.build().expect("a model"), &columns).expect("columns of the model");
    let choices = Choices { std_errors: StdErrors::Expected, ..Choices::default() };
    let options = Options { choices, innovations: false, ..Options::default() };
    let fit = ensemble.fit_with(&options, &mut Silent).expect("a fit");
    assert!(fit.converged(), "{}", fit.record.reason);
    let means = ["bias", "gain"].map(|state| fit.mean(state).expect("a state"));
    let spreads = ["bias", "gain"].map(|state| fit.std_dev(state).expect("a state"));
    let parameters = ["tau", "s", "r", "c"].map(|name| fit.parameter(name).expect("a parameter"));
    let found: Vec<_> = means.into_iter().chain(spreads).chain(parameters).collect();
    let at: Vec<f64> = found.iter().map(|figure| figure.estimate).collect();
    let expected = information(&tests, &at).try_inverse().expect("everything is identified");
    for (i, figure) in found.iter().enumerate() {
        let (error, expected) = (figure.std_error.unwrap_or(f64::NAN), expected[(i, i)].sqrt());
        assert!((error / expected - 1.0).abs() < 1e-5, "figure {i}: found {error}, expected {expected}");
    }
}

#[test]
fn expected_errors_beside_a_noise_covariance_are_refused() {
    let model = Model::builder("two instruments")
        .state(constant("level"))
        .measurement(measurement("y", "level", "r"))
        .measurement(measurement("z", "level", 0.4))
        .noise_covariance("y", "z", 0.02)
        .parameter(free("r"));
    let columns: Vec<Columns> = (0..6)
        .map(|j| {
            let values = |shift: f64| (0..5).map(move |k| (f64::from(j) + shift * f64::from(k)).sin());
            Columns::new(format!("t{j}")).numbers("y", values(1.3)).numbers("z", values(0.7))
        })
        .collect();
    let ensemble = Ensemble::new(&model.build().expect("a model"), &columns).expect("columns of the model");
    let choices = Choices { std_errors: StdErrors::Expected, ..Choices::default() };
    let error = ensemble.fit_with(&Options { choices, ..Options::default() }, &mut Silent).expect_err("refused");
    assert!(error.to_string().contains("(`r`)"), "{error}");
}
