//! Standard errors from the expected information beside free parameters, against the dense law of the data.

use kalfit::build::{Columns, ModelBuilder, constant, free, gauss_markov, measurement, name, phase, random_walk};
use kalfit::estimate::{Progress, Silent, Step};
use kalfit::infer::{Choices, StdErrors};
use kalfit::model::{Column, CovarianceStructure, GroupLevel, Model};
use kalfit::{Ensemble, Figure, Fit, Options, PhasedModel};
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

/// Mean and covariance of all that is measured in unit j, at such values.
type Law<'a> = &'a dyn Fn(usize, &[f64]) -> (DVector<f64>, DMatrix<f64>);

/// Σ_j m_a'V⁻¹m_b + ½ tr(V⁻¹V_aV⁻¹V_b) over so many units, by differences.
fn information((units, law): (usize, Law<'_>), at: &[f64]) -> DMatrix<f64> {
    let k = at.len();
    let mut sum = DMatrix::zeros(k, k);
    for unit in 0..units {
        let inverse = law(unit, at).1.try_inverse().expect("positive");
        let slope = |i: usize| {
            let h = 1e-4 * at[i].abs();
            let moved = |sign: f64| {
                let mut there = at.to_vec();
                there[i] += sign * h;
                law(unit, &there)
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

/// Fits, and compares the expected standard errors of these figures with those of the dense law.
fn agree(model: &PhasedModel, columns: &[Columns], (units, law): (usize, Law<'_>), of: &dyn Fn(&Fit) -> Vec<Figure>) {
    let ensemble = Ensemble::new(model, columns).expect("columns of the model");
    let choices = Choices { std_errors: StdErrors::Expected, ..Choices::default() };
    let options = Options { choices, innovations: false, ..Options::default() };
    let fit = ensemble.fit_with(&options, &mut Silent).expect("a fit");
    assert!(fit.converged(), "{}", fit.record.reason);
    let found = of(&fit);
    let at: Vec<f64> = found.iter().map(|figure| figure.estimate).collect();
    let expected = information((units, law), &at).try_inverse().expect("everything is identified");
    for (i, figure) in found.iter().enumerate() {
        let (error, expected) = (figure.std_error.unwrap_or(f64::NAN), expected[(i, i)].sqrt());
        let near = (error / expected - 1.0).abs() < 1e-5;
        assert!(near, "figure {i}, {}: found {error}, expected {expected}", figure.estimate);
    }
}

/// Values of a unit, from the law.
fn values(law: Law<'_>, unit: usize, truth: &[f64], rng: &mut ChaCha8Rng) -> Vec<f64> {
    let (mean, variance) = law(unit, truth);
    let z = DVector::<f64>::from_fn(mean.len(), |_, _| rng.sample(StandardNormal));
    (mean + variance.cholesky().expect("positive").l() * z).as_slice().to_vec()
}

/// So many times, some way apart.
fn moments(n: usize, mut time: f64, rng: &mut ChaCha8Rng) -> Vec<f64> {
    let mut next = || {
        time += rng.random_range(0.1..0.9);
        time
    };
    (0..n).map(|_| next()).collect()
}

fn gauss_markov_covariance(s: f64, tau: f64, lag: f64) -> f64 {
    s * s * (-lag.abs() / tau).exp()
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
    let figures = |fit: &Fit| {
        let means = ["bias", "gain"].map(|state| fit.mean(state).expect("a state"));
        let spreads = ["bias", "gain"].map(|state| fit.std_dev(state).expect("a state"));
        let parameters = ["tau", "s", "r", "c"].map(|name| fit.parameter(name).expect("a parameter"));
        means.into_iter().chain(spreads).chain(parameters).collect()
    };
    let law = |j: usize, at: &[f64]| law(&tests[j], at);
    agree(&builder.build().expect("a model"), &columns, (tests.len(), &law), &figures);
}

/// A bias and a drift in the first phase, which the walk of the second one begins with in part, beside a rate.
#[test]
fn expected_errors_over_phases_are_those_of_the_dense_law() {
    let truth = [1.0, 0.4, 0.7, 0.5, 1.5, 0.6, 0.3, 0.4, 0.35, 0.8];
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let first: Vec<Vec<f64>> = (0..60).map(|j| moments(6 + j % 3, 0.0, &mut rng)).collect();
    let after = |j: usize| first[j].last().copied().unwrap_or(0.0);
    // every fifth test ends after the first phase
    let second: Vec<Vec<f64>> =
        (0..60).map(|j| moments(if j % 5 == 4 { 0 } else { 6 + j % 2 }, after(j), &mut rng)).collect();
    let input = |k: usize| f64::from(k as u32 % 4) - 1.0;
    let law = |j: usize, at: &[f64]| {
        let [bias, rate, bias_spread, rate_spread, tau, s, r, q, late, part] = *at else { panic!("ten values") };
        let (t, v) = (&first[j], &second[j]);
        let n = t.len();
        let mean = DVector::from_fn(n + v.len(), |k, _| match k.checked_sub(n) {
            None => bias,
            Some(k) => part * bias + 0.1 + rate * input(k),
        });
        // how much of the bias, and of the drift at what time, is in a row
        let of = |k: usize| if k < n { (1.0, 1.0, t[k]) } else { (part, 0.5, after(j)) };
        let variance = DMatrix::from_fn(n + v.len(), n + v.len(), |k, l| {
            let ((b, d, at), (c, e, then)) = (of(k), of(l));
            let carried = b * c * bias_spread.powi(2) + d * e * gauss_markov_covariance(s, tau, at - then);
            let noise = if k == l { if k < n { r * r } else { late * late } } else { 0.0 };
            let own = match (k.checked_sub(n), l.checked_sub(n)) {
                (Some(k), Some(l)) => {
                    0.04 + q * q * (v[k].min(v[l]) - v[0]) + rate_spread.powi(2) * input(k) * input(l)
                }
                _ => 0.0,
            };
            carried + own + noise
        });
        (mean, variance)
    };
    let column = |j: usize| {
        let (n, m) = (first[j].len(), second[j].len());
        let phase = (0..n + m).map(|k| if k < n { "bench" } else { "flight" });
        let inputs = (0..n + m).map(|k| input(k.saturating_sub(n)));
        let times = first[j].iter().chain(&second[j]).copied();
        let all = Columns::new(format!("t{j:02}")).texts("when", phase).numbers("t", times).numbers("u", inputs);
        all.numbers("y", values(&law, j, &truth, &mut ChaCha8Rng::seed_from_u64(j as u64)))
    };
    let columns: Vec<Columns> = (0..60).map(column).collect();
    let bench = Model::builder("bench and flight")
        .time("t")
        .state(constant("bias"))
        .state(gauss_markov("drift", "tau", "s"))
        .measurement(measurement("y", name("bias") + name("drift"), "r"));
    let flight = Model::builder("bench and flight")
        .time("t")
        .state(random_walk("angle", "q").known(0.0, 0.2))
        .state(constant("rate"))
        .measurement(measurement("y", name("angle") + name("rate") * name("u"), "late"));
    let with = |builder: ModelBuilder, names: &[&str]| names.iter().fold(builder, |b, name| b.parameter(free(*name)));
    let carried = name("part") * name("bias") + 0.5 * name("drift") + 0.1;
    let model = PhasedModel::builder("when")
        .phase(phase("bench", &with(bench, &["tau", "s", "r"])))
        .phase(phase("flight", &with(flight, &["q", "late", "part"])).carry("angle", carried))
        .build()
        .expect("a model");
    let figures = |fit: &Fit| {
        let states = ["bench.bias", "flight.rate"];
        let means = states.map(|state| fit.mean(state).expect("a state"));
        let spreads = states.map(|state| fit.std_dev(state).expect("a state"));
        let names = ["tau", "s", "r", "q", "late", "part"];
        let parameters = names.map(|name| fit.parameter(name).expect("a parameter"));
        means.into_iter().chain(spreads).chain(parameters).collect()
    };
    agree(&model, &columns, (60, &law), &figures);
}

/// Two walks whose noises are correlated, and two instruments whose noises are, one of which has gaps.
#[test]
fn expected_errors_beside_covariances_of_noises_are_those_of_the_dense_law() {
    let truth = [1.0, 0.7, 0.5, 0.4, 0.1, 0.3, 0.35, 0.06];
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let times: Vec<Vec<f64>> = (0..50).map(|j| moments(8 + j % 3, 0.0, &mut rng)).collect();
    let is_measured = |j: usize, k: usize| !(j + k).is_multiple_of(3);
    // rows with their instrument, the second one where it measures
    let rows = |j: usize| -> Vec<(usize, usize)> {
        let both = |k: usize| [(k, 0), (k, 1)].into_iter().filter(move |&(k, of)| of == 0 || is_measured(j, k));
        (0..times[j].len()).flat_map(both).collect()
    };
    let law = |j: usize, at: &[f64]| {
        let [bias, spread, one, other, shared, r, own, c] = *at else { panic!("eight values") };
        let (t, rows) = (&times[j], rows(j));
        let weight = [1.0, 0.5];
        let mean = DVector::from_fn(rows.len(), |i, _| weight[rows[i].1] * bias);
        let walk = [[one * one, shared], [shared, other * other]];
        let noise = [[r * r, c], [c, own * own]];
        let variance = DMatrix::from_fn(rows.len(), rows.len(), |i, l| {
            let ((k, of), (m, to)) = (rows[i], rows[l]);
            let same = if k == m { noise[of][to] } else { 0.0 };
            weight[of] * weight[to] * spread * spread + walk[of][to] * (t[k].min(t[m]) - t[0]) + same
        });
        (mean, variance)
    };
    let column = |j: usize| {
        let drawn = values(&law, j, &truth, &mut ChaCha8Rng::seed_from_u64(j as u64));
        let of = |instrument: usize| {
            let cell = |k: usize| rows(j).iter().position(|row| *row == (k, instrument)).map_or(f64::NAN, |i| drawn[i]);
            (0..times[j].len()).map(cell).collect::<Vec<f64>>()
        };
        let all = Columns::new(format!("t{j:02}")).numbers("t", times[j].iter().copied());
        all.numbers("y", of(0)).numbers("z", of(1))
    };
    let columns: Vec<Columns> = (0..50).map(column).collect();
    let names = ["one", "other", "shared", "r", "own", "c"];
    let model = Model::builder("two instruments")
        .time("t")
        .state(constant("bias"))
        .state(random_walk("a", "one").known(0.0, 0.0))
        .state(random_walk("b", "other").known(0.0, 0.0))
        .measurement(measurement("y", name("bias") + name("a"), "r"))
        .measurement(measurement("z", 0.5 * name("bias") + name("b"), "own"))
        .process_noise_covariance("a", "b", "shared")
        .noise_covariance("y", "z", "c");
    let model = names.into_iter().fold(model, |model, name| model.parameter(free(name))).build().expect("a model");
    let figures = |fit: &Fit| {
        let bias = [fit.mean("bias").expect("a state"), fit.std_dev("bias").expect("a state")];
        bias.into_iter().chain(names.map(|name| fit.parameter(name).expect("a parameter"))).collect()
    };
    agree(&model, &columns, (50, &law), &figures);
}

/// A bias that lots and units within them have in part in common, and a drift of each test.
#[test]
fn expected_errors_over_levels_of_groups_are_those_of_the_dense_law() {
    const TESTS: usize = 120;
    let truth = [1.0, 0.5, 0.4, 0.6, 1.5, 0.6, 0.3];
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let times: Vec<Vec<f64>> = (0..TESTS).map(|j| moments(5 + j % 3, 0.0, &mut rng)).collect();
    // names of groups that the order of the tests does not follow
    let groups = |j: usize| (j % 15, j / 15 % (2 + j % 2));
    let tests_of = |lot: usize| (0..TESTS).filter(move |&j| groups(j).0 == lot);
    let rows = |lot: usize| -> Vec<(usize, f64)> {
        tests_of(lot).flat_map(|j| times[j].iter().map(move |&t| (j, t))).collect()
    };
    let law = |lot: usize, at: &[f64]| {
        let [bias, own, unit, of_lot, tau, s, r] = *at else { panic!("seven values") };
        let rows = rows(lot);
        let variance = DMatrix::from_fn(rows.len(), rows.len(), |k, l| {
            let ((i, t), (j, u)) = (rows[k], rows[l]);
            let unit = if groups(i).1 == groups(j).1 { unit * unit } else { 0.0 };
            let test = if i == j { own * own + gauss_markov_covariance(s, tau, t - u) } else { 0.0 };
            of_lot * of_lot + unit + test + if k == l { r * r } else { 0.0 }
        });
        (DVector::repeat(rows.len(), bias), variance)
    };
    let drawn: Vec<Vec<f64>> = (0..15).map(|lot| values(&law, lot, &truth, &mut rng)).collect();
    let column = |j: usize| {
        let lot = groups(j).0;
        let own = rows(lot).into_iter().zip(&drawn[lot]).filter(|((test, _), _)| *test == j).map(|(_, y)| *y);
        let names = [("lot", format!("L{lot}")), ("unit", format!("U{}", groups(j).1))];
        let all = Columns::new(format!("t{j:03}")).numbers("t", times[j].iter().copied()).numbers("y", own);
        names.into_iter().fold(all, |all, (level, name)| all.every_text(level, name))
    };
    let columns: Vec<Columns> = (0..TESTS).map(column).collect();
    let model = Model::builder("lots")
        .time("t")
        .state(constant("bias"))
        .state(gauss_markov("drift", "tau", "s"))
        .measurement(measurement("y", name("bias") + name("drift"), "r"));
    let names = ["tau", "s", "r"];
    let mut model = names.into_iter().fold(model, |model, name| model.parameter(free(name))).build().expect("a model");
    let text = |name: &str| Column { name: name.to_owned(), used_in: "levels".to_owned() };
    model.phases[0].model.text_columns = vec![text("lot"), text("unit")];
    let level = |(column, name): (usize, &str)| GroupLevel {
        name: name.to_owned(),
        column,
        crossed: false,
        covariance: CovarianceStructure::full(),
        members: Vec::new(),
    };
    model.levels = ["lot", "unit"].into_iter().enumerate().map(level).collect();
    let figures = |fit: &Fit| {
        let spread = |name: &str| {
            let level = fit.record.levels.iter().find(|level| level.name == name).expect("a level");
            let (all, interval95) = (&level.std_dev, level.std_dev.interval95[0]);
            Figure { estimate: all.estimate[0], std_error: all.std_error[0], interval95 }
        };
        let bias = [fit.mean("bias").expect("a state"), spread("tests"), spread("unit"), spread("lot")];
        bias.into_iter().chain(names.map(|name| fit.parameter(name).expect("a parameter"))).collect()
    };
    agree(&model, &columns, (15, &law), &figures);
}

#[test]
fn expected_errors_beside_values_of_many_single_tests_are_refused() {
    let model = Model::builder("instruments with noise of their own")
        .state(constant("level"))
        .measurement(measurement("y", "level", "r"))
        .parameter(free("r").per("instrument"));
    let columns: Vec<Columns> = (0..30)
        .map(|j| {
            let values = (0..5).map(move |k| (f64::from(j) + 1.3 * f64::from(k)).sin());
            Columns::new(format!("t{j:02}")).numbers("y", values).every_text("instrument", format!("i{j}"))
        })
        .collect();
    let ensemble = Ensemble::new(&model.build().expect("a model"), &columns).expect("columns of the model");
    let choices = Choices { std_errors: StdErrors::Expected, ..Choices::default() };
    let error = ensemble.fit_with(&Options { choices, ..Options::default() }, &mut Silent).expect_err("refused");
    assert!(error.to_string().contains("(`r`)"), "{error}");
}

/// Asks for the end at once.
struct Impatient;

impl Progress for Impatient {
    fn step(&mut self, _: Step) {}

    fn stops(&self) -> bool {
        true
    }
}

#[test]
fn errors_are_from_the_observed_information_where_nobody_waits_for_the_expected_one() {
    let model = Model::builder("drift")
        .time("t")
        .state(constant("bias"))
        .state(gauss_markov("drift", "tau", "s"))
        .measurement(measurement("y", name("bias") + name("drift"), "r"));
    let model = ["tau", "s", "r"].into_iter().fold(model, |model, name| model.parameter(free(name)));
    let columns: Vec<Columns> = drawn()
        .iter()
        .enumerate()
        .map(|(j, test)| {
            let [t, y] = [&test.times, &test.values].map(|column| column.iter().copied());
            Columns::new(format!("t{j:02}")).numbers("t", t).numbers("y", y)
        })
        .collect();
    let ensemble = Ensemble::new(&model.build().expect("a model"), &columns).expect("columns of the model");
    let choices = Choices { std_errors: StdErrors::Expected, ..Choices::default() };
    let options = Options { choices, innovations: false, ..Options::default() };
    let of = |progress: &mut dyn Progress| ensemble.fit_with(&options, progress).expect("a fit").record;
    let (waited, ended) = (of(&mut Silent), of(&mut Impatient));
    assert_eq!([&*waited.std_errors, &*ended.std_errors], ["expected", "observed"]);
    assert!(!ended.converged, "{}", ended.reason);
}
