//! Estimated states that are measured without noise (theory §13), against the dense joint Gaussian of all measurements.

use crate::dense::{ensemble_log_likelihood, log_density};

use kalfit::build::{Columns, constant, free, measurement, moving, name, phase, random_walk, when};
use kalfit::estimate::{Derivatives, Likelihood, Silent, Stop};
use kalfit::model::{Model, PhasedModel};
use kalfit::reduce::{Path, Plain, StepMatrices};
use kalfit::{Ensemble, Options, Reductions};
use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

type Random = ChaCha8Rng;

fn normal(rng: &mut Random) -> f64 {
    rng.sample(StandardNormal)
}

fn matrix(rng: &mut Random, rows: usize, columns: usize) -> DMatrix<f64> {
    DMatrix::from_fn(rows, columns, |_, _| normal(rng))
}

/// Tests of p states that rest and one that moves; of their measurements some are exact. `alike`: all have one design.
fn ensemble(rng: &mut Random, (p, tests): (usize, usize), alike: bool) -> Vec<Plain> {
    let shape = rng.random::<u64>();
    (0..tests)
        .map(|j| {
            let own = &mut Random::seed_from_u64(if alike { shape } else { shape.wrapping_add(j as u64) });
            let mut sensitivity = matrix(own, p + 1, p);
            sensitivity.row_mut(p).fill(0.0);
            let mut covariance = DMatrix::zeros(p + 1, p + 1);
            covariance[(p, p)] = 0.3;
            let mut test =
                Plain::new(format!("t{j}"), DVector::from_fn(p + 1, |_, _| normal(own)), sensitivity, covariance);
            let exact = own.random_range(0..=p);
            for k in 0..p + 2 {
                let mut h = matrix(own, 1, p + 1);
                let noise = if k < exact { 0.0 } else { 0.5 };
                if k < exact {
                    h[(0, p)] = 0.0;
                }
                let mut step =
                    StepMatrices::new(h, DMatrix::from_element(1, 1, noise), DVector::from_element(1, normal(rng)));
                if k > 0 {
                    let mut phi = DMatrix::identity(p + 1, p + 1) * 0.9;
                    phi[(0, p - 1)] += 0.2;
                    let mut q = DMatrix::zeros(p + 1, p + 1);
                    q[(p, p)] = 0.1;
                    step = step.moving(phi, q);
                }
                test.steps.push(step);
            }
            test
        })
        .collect()
}

#[test]
fn the_likelihood_and_its_derivatives_are_those_of_the_dense_law() {
    for seed in 0..12 {
        let rng = &mut Random::seed_from_u64(seed);
        let p = 1 + (seed as usize) % 3;
        let tests = ensemble(rng, (p, 4), seed % 2 == 0);
        let reductions: Reductions = tests.iter().map(|test| test.reduce().expect("sound")).collect();
        assert!(reductions.iter().all(|one| one.path == Path::SquareRoot || one.exact.is_none()));
        let (mean, root) = (DVector::from_fn(p, |_, _| normal(rng)), matrix(rng, p, p));
        let sigma = &root * root.transpose();
        let likelihood = Likelihood::new(&reductions, p);
        let found = likelihood.at(mean.as_slice(), &sigma, Derivatives::Second);
        let expected = ensemble_log_likelihood(&tests, &mean, &sigma);
        let off = (found.log_likelihood - expected).abs() / expected.abs().max(1.0);
        assert!(off < 1e-10, "seed {seed}: {} against {expected}", found.log_likelihood);
        let h = 1e-6;
        for i in 0..p {
            let mut step = DVector::zeros(p);
            step[i] = h;
            let at = |sign: f64| ensemble_log_likelihood(&tests, &(&mean + &step * sign), &sigma);
            let slope = (at(1.0) - at(-1.0)) / (2.0 * h);
            assert!((found.mean_score[i] - slope).abs() < 1e-4 * slope.abs().max(1.0), "seed {seed}: {slope}");
            for k in 0..=i {
                let mut change = DMatrix::zeros(p, p);
                (change[(i, k)], change[(k, i)]) = (h, h);
                let at = |sign: f64| ensemble_log_likelihood(&tests, &mean, &(&sigma + &change * sign));
                let slope = (at(1.0) - at(-1.0)) / (2.0 * h);
                let own = found.covariance_score[(i, k)] * if i == k { 1.0 } else { 2.0 };
                assert!((own - slope).abs() < 1e-4 * slope.abs().max(1.0), "seed {seed}: {own} against {slope}");
                let beside = |sign: f64| likelihood.at(mean.as_slice(), &(&sigma + &change * sign), Derivatives::First);
                let bend = (beside(1.0).covariance_score[(i, k)] - beside(-1.0).covariance_score[(i, k)]) / (2.0 * h);
                let place = i * (i + 1) / 2 + k;
                let information = found.covariance_information.as_ref().expect("asked for")[(place, place)];
                let own = -information / if i == k { 1.0 } else { 2.0 };
                assert!((own - bend).abs() < 1e-4 * bend.abs().max(1.0), "seed {seed}: {own} against {bend}");
            }
        }
    }
}

/// One row of exact values each, without gaps: the estimate is the mean and the covariance of the sample.
#[test]
fn values_that_are_all_exact_have_the_law_of_the_sample() {
    let rng = &mut Random::seed_from_u64(7);
    let root = DMatrix::from_row_slice(3, 3, &[2.0, 0.0, 0.0, 0.7, 1.0, 0.0, -0.4, 0.3, 1e-3]);
    let drawn: Vec<DVector<f64>> = (0..40)
        .map(|_| &root * DVector::from_fn(3, |_, _| normal(rng)) + DVector::from_vec(vec![1e3, 2.0, -0.5]))
        .collect();
    let mut model = Model::builder("exact");
    for state in ["a", "b", "c"] {
        model = model.state(constant(state)).measurement(measurement(format!("z{state}"), state, 0.0));
    }
    let columns = drawn.iter().enumerate().map(|(j, x)| {
        let one = Columns::new(format!("t{j:02}")).numbers("za", [x[0]]);
        one.numbers("zb", [x[1]]).numbers("zc", [x[2]])
    });
    let model: PhasedModel = model.build().expect("a model");
    let ensemble = Ensemble::new(&model, &columns.collect::<Vec<_>>()).expect("columns of the model");
    let fit = ensemble.fit_with(&Options::default(), &mut Silent).expect("a fit");
    assert_eq!(fit.estimate.stop, Stop::Certified, "{}", fit.record.reason);
    let mean = drawn.iter().sum::<DVector<f64>>() / 40.0;
    let covariance = drawn.iter().map(|x| (x - &mean) * (x - &mean).transpose()).sum::<DMatrix<f64>>() / 40.0;
    for i in 0..3 {
        let found = fit.estimate.mean[i];
        assert!((found - mean[i]).abs() < 1e-9 * mean[i].abs(), "{found} against {}", mean[i]);
        for k in 0..3 {
            let (found, size) = (fit.estimate.covariance[(i, k)], (covariance[(i, i)] * covariance[(k, k)]).sqrt());
            assert!((found - covariance[(i, k)]).abs() < 1e-8 * size, "{found} against {}", covariance[(i, k)]);
        }
    }
    // ℓ of a sample at its own law
    let expected = -0.5 * 40.0 * (3.0 * std::f64::consts::TAU.ln() + covariance.determinant().ln() + 3.0);
    let found = fit.estimate.log_likelihood;
    assert!((found - expected).abs() < 1e-8 * expected.abs(), "{found} against {expected}");
}

/// A walk that is seen exactly from its start on, with what it starts from and its noise to be estimated: closed forms.
#[test]
fn a_walk_that_is_seen_exactly_has_closed_forms() {
    let rng = &mut Random::seed_from_u64(3);
    let drawn: Vec<Vec<f64>> = (0..20)
        .map(|_| {
            let start = 5.0 + 2.0 * normal(rng);
            (0..6)
                .scan(start, |x, k| {
                    if k > 0 {
                        *x += 0.3 * normal(rng)
                    }
                    Some(*x)
                })
                .collect()
        })
        .collect();
    let model =
        Model::builder("walk").time("t").state(random_walk("x", name("q"))).measurement(measurement("y", "x", 0.0));
    let model = model.parameter(free("q")).build().expect("a model");
    let columns: Vec<Columns> = drawn
        .iter()
        .enumerate()
        .map(|(j, x)| {
            Columns::new(format!("t{j:02}")).numbers("t", (0..6).map(f64::from)).numbers("y", x.iter().copied())
        })
        .collect();
    let ensemble = Ensemble::new(&model, &columns).expect("columns of the model");
    let fit = ensemble.fit_with(&Options::default(), &mut Silent).expect("a fit");
    assert!(fit.converged(), "{}", fit.record.reason);
    let steps: Vec<f64> = drawn.iter().flat_map(|x| x.windows(2).map(|pair| (pair[1] - pair[0]).powi(2))).collect();
    let variance = steps.iter().sum::<f64>() / steps.len() as f64;
    let mean = drawn.iter().map(|x| x[0]).sum::<f64>() / 20.0;
    let spread = drawn.iter().map(|x| (x[0] - mean).powi(2)).sum::<f64>() / 20.0;
    let found = (fit.estimate.mean[0], fit.estimate.covariance[(0, 0)], fit.record.parameters[0].estimate);
    for (found, expected) in [(found.0, mean), (found.1, spread), (found.2, variance.sqrt())] {
        assert!((found - expected).abs() < 1e-6 * expected, "{found} against {expected}");
    }
}

/// What fades away with a time constant that is sought, and its offset, seen exactly in one row and with noise in others: the exact
/// row depends on the time constant.
#[test]
fn a_time_constant_in_exact_rows_is_found() {
    const NOISE: f64 = 0.1;
    let rng = &mut Random::seed_from_u64(5);
    let drawn: Vec<Vec<f64>> = (0..25)
        .map(|_| {
            let (a, b) = (5.0 + normal(rng), 1.0 + 0.7 * normal(rng));
            let seen =
                |k: i32| a * (-0.3 * f64::from(k) / 1.7).exp() + b + if k == 2 { 0.0 } else { NOISE * normal(rng) };
            (0..6).map(seen).collect()
        })
        .collect();
    let noise = when(name("exact").equals(1.0), 0.0, NOISE);
    let model =
        Model::builder("fading").time("t").state(moving("a", -(name("a") / name("tau")), 0.0)).state(constant("b"));
    let model = model.measurement(measurement("y", name("a") + name("b"), noise)).parameter(free("tau").start(1.0));
    let columns: Vec<Columns> = drawn
        .iter()
        .enumerate()
        .map(|(j, y)| {
            let all = Columns::new(format!("t{j:02}")).numbers("t", (0..6).map(|k| 0.3 * f64::from(k)));
            all.numbers("y", y.iter().copied()).numbers("exact", (0..6).map(|k| f64::from(u8::from(k == 2))))
        })
        .collect();
    let ensemble = Ensemble::new(&model.build().expect("a model"), &columns).expect("columns of the model");
    let fit = ensemble.fit_with(&Options::default(), &mut Silent).expect("a fit");
    assert!(fit.converged(), "{}", fit.record.reason);
    let (mean, sigma) = (DVector::from_column_slice(&fit.estimate.mean), &fit.estimate.covariance);
    let dense = |tau: f64| -> f64 {
        let h = DMatrix::from_fn(6, 2, |k, i| if i == 0 { (-0.3 * k as f64 / tau).exp() } else { 1.0 });
        let noise = DVector::from_fn(6, |k, _| if k == 2 { 0.0 } else { NOISE * NOISE });
        let variance = &h * sigma * h.transpose() + DMatrix::from_diagonal(&noise);
        drawn.iter().map(|y| log_density(&(DVector::from_column_slice(y) - &h * &mean), &variance)).sum()
    };
    let tau = fit.record.parameters[0].estimate;
    let (here, h) = (dense(tau), 1e-4 * tau);
    let off = (fit.estimate.log_likelihood - here).abs();
    assert!(off < 1e-9 * here.abs(), "{} against {here}", fit.estimate.log_likelihood);
    let (slope, bend) =
        ((dense(tau + h) - dense(tau - h)) / (2.0 * h), (dense(tau + h) + dense(tau - h) - 2.0 * here) / (h * h));
    let error = (-bend).sqrt().recip();
    assert!((slope * error).abs() < 1e-4, "{slope} at {tau}, which is known to {error}");
}

/// Phases take no exact rows, and where Σ collapses along them there is no maximum.
#[test]
fn exact_rows_are_refused_where_they_are_not_handled() {
    let columns = |phased: bool| -> Vec<Columns> {
        let one = |j: u32| Columns::new(format!("t{j}")).numbers("y", [1.0, 1.5 + f64::from(j)]);
        (0..3).map(|j| if phased { one(j).texts("phase", ["one", "two"]) } else { one(j) }).collect()
    };
    let exact = Model::builder("").state(constant("x")).measurement(measurement("y", "x", 0.0));
    let phases = PhasedModel::builder("phase").phase(phase("one", &exact)).phase(phase("two", &exact));
    let ensemble = Ensemble::new(&phases.build().expect("a model"), &columns(true)).expect("columns of the model");
    let said = ensemble.fit_with(&Options::default(), &mut Silent).expect_err("refused").to_string();
    assert!(said.contains("test `t0`") && said.contains("measured without any noise"), "{said}");
    let equal: Vec<Columns> = (0..3).map(|j| Columns::new(format!("t{j}")).numbers("y", [2.0])).collect();
    let ensemble = Ensemble::new(&exact.build().expect("a model"), &equal).expect("columns of the model");
    let said = ensemble.fit_with(&Options::default(), &mut Silent).expect_err("refused").to_string();
    assert!(said.contains("has no maximum"), "{said}");
}
