//! Allan's variance, compared with closed forms, simulated records and double loops.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::allan::{Estimate, estimate, median_step, spans, stretches, variance};
use crate::export::{Exported, Wanted, export};
use kalfit_fixtures::near;
use kalfit_model::build::{constant, gauss_markov, integral, measurement, name, random_walk};
use kalfit_model::{Alpha, Model, Population};

const STEP: f64 = 0.5;

/// A gyro with white noise `noise`, a random walk of density `walk`, and a Gauss-Markov state of deviation `sigma` and
/// time constant 20 s; each part with value 0 is absent.
fn gyro(noise: f64, walk: f64, sigma: f64) -> Exported {
    let model = Model::builder("gyro")
        .time("t")
        .state(constant("bias"))
        .state(random_walk("walk", walk).known(0.0, 0.0))
        .state(gauss_markov("drift", 20.0, sigma))
        .measurement(measurement("y", name("bias") + name("walk") + name("drift"), noise))
        .build()
        .expect("it is sound");
    filter(&model, 7.0, 100.0)
}

fn filter(model: &kalfit_model::PhasedModel, mean: f64, variance: f64) -> Exported {
    let alpha = Alpha::fixed(&model.shared().parameters).expect("all are known");
    let covariance = nalgebra::DMatrix::from_element(1, 1, variance);
    let population = Population { mean: vec![mean], coefficients: vec![], covariance };
    export(model, &alpha, &population, &Wanted { step: Some(STEP), ..Wanted::default() }).expect("it is constant")
}

#[test]
fn spans_go_by_one_two_five() {
    assert_eq!(spans(120), [1, 2, 5, 10, 20, 50, 100]);
    assert!(spans(0).is_empty());
}

#[test]
fn white_noise_falls_with_the_span_and_constants_drop_out() {
    let filter = gyro(0.3, 0.0, 0.0);
    for m in spans(100_000) {
        near::relative(format_args!("m = {m}"), variance(&filter, 0, m).expect("a value"), 0.09 / m as f64, 1e-9);
    }
}

#[test]
fn a_random_walk_gives_the_exact_sum_and_its_limit() {
    let filter = gyro(0.0, 0.2, 0.0);
    for m in spans(10_000) {
        let found = variance(&filter, 0, m).expect("a value");
        let (q, n) = (0.04 * STEP, m as f64);
        // the k-th of the 2m - 1 steps moves the difference of the means by min(k, 2m - k)/m
        let exact: f64 = (1..2 * m).map(|k| (k.min(2 * m - k) as f64 / n).powi(2)).sum::<f64>() * q / 2.0;
        near::relative(format_args!("m = {m}"), found, exact, 1e-9);
        if m >= 100 {
            near::relative(format_args!("limit, m = {m}"), found, 0.04 * STEP * n / 3.0, 1e-3);
        }
    }
}

#[test]
fn a_gauss_markov_state_gives_the_exact_sum_and_its_limit() {
    let filter = gyro(0.0, 0.0, 0.4);
    let covariance = |lag: usize| 0.16 * (-(STEP * lag as f64) / 20.0).exp();
    for m in spans(500) {
        let found = variance(&filter, 0, m).expect("a value");
        let weight = |k: usize| if k < m { -1.0 } else { 1.0 };
        let pairs = (0..2 * m).flat_map(|i| (0..2 * m).map(move |k| (i, k)));
        let sum: f64 = pairs.map(|(i, k)| weight(i) * weight(k) * covariance(i.abs_diff(k))).sum();
        near::relative(format_args!("m = {m}"), found, 0.5 * sum / (m as f64).powi(2), 1e-9);
        let x = STEP * m as f64 / 20.0;
        let limit = 0.16 / (x * x) * (2.0 * x - 3.0 + 4.0 * (-x).exp() - (-2.0 * x).exp());
        if m >= 50 {
            near::relative(format_args!("limit, m = {m}"), found, limit, 1e-2);
        }
    }
}

#[test]
fn a_ramp_is_its_mean_square() {
    // dx/dt = slope, of mean 7 and variance 100: the means of two spans are slope T apart
    let model = Model::builder("ramp").time("t").state(constant("slope"));
    let model =
        model.state(integral("x", name("slope") + 1.0).known(0.0, 0.0)).measurement(measurement("y", name("x"), 0.0));
    let filter = filter(&model.build().expect("it is sound"), 7.0, 100.0);
    for m in [1, 10, 1000] {
        let expected = 0.5 * (64.0 + 100.0) * (STEP * m as f64).powi(2);
        near::relative(format_args!("m = {m}"), variance(&filter, 0, m).expect("a value"), expected, 1e-9);
    }
}

/// Records of the gyro; each value is the sum of white noise, a walk and a drift.
fn simulated(records: usize, rows: usize) -> Vec<Vec<f64>> {
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
    let keep = (-STEP / 20.0_f64).exp();
    let mut record = |_| {
        let (bias, mut walk, mut drift) = (3.0 * normal(), 0.0, 0.4 * normal());
        let row = |_| {
            let value = bias + walk + drift + 0.3 * normal();
            walk += 0.02 * STEP.sqrt() * normal();
            drift = keep * drift + 0.4 * (1.0 - keep * keep).sqrt() * normal();
            value
        };
        (0..rows).map(row).collect()
    };
    (0..records).map(&mut record).collect()
}

#[test]
fn the_model_agrees_with_long_simulated_records() {
    let filter = gyro(0.3, 0.02, 0.4);
    let records = simulated(60, 4000);
    for m in spans(1000) {
        let Estimate { variance: found, degrees_of_freedom, .. } = estimate(&records, m).expect("it has spans");
        let expected = variance(&filter, 0, m).expect("a value");
        let bound = 4.0 * (2.0 / degrees_of_freedom).sqrt();
        println!("m = {m}: simulated {found}, model {expected}, bound {bound}");
        near::relative(format_args!("m = {m}"), found, expected, bound);
    }
}

#[test]
fn limits_hold_what_they_say() {
    let filter = gyro(0.3, 0.02, 0.4);
    let records = simulated(400, 400);
    for m in [1, 10, 50, 200] {
        let expected = variance(&filter, 0, m).expect("a value");
        let holds = |record: &Vec<f64>| {
            let [low, high] = estimate(std::slice::from_ref(record), m).expect("spans").interval95().expect("limits");
            low <= expected && expected <= high
        };
        let held = records.iter().filter(|record| holds(record)).count() as f64 / 400.0;
        println!("m = {m}: {held} of the limits hold the truth");
        assert!(held > 0.92, "m = {m}: {held}");
    }
}

#[test]
fn the_estimate_is_that_of_a_double_loop() {
    let mut records = simulated(2, 57);
    records[1].truncate(9);
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    for m in [1, 2, 5, 20] {
        let (mut sum, mut pairs) = (0.0, 0);
        for record in &records {
            for start in 0..record.len() {
                if start + 2 * m <= record.len() {
                    sum += (mean(&record[start + m..start + 2 * m]) - mean(&record[start..start + m])).powi(2) / 2.0;
                    pairs += 1;
                }
            }
        }
        let found = estimate(&records, m).expect("it has spans");
        assert_eq!(found.pairs, pairs, "m = {m}");
        near::relative(format_args!("m = {m}"), found.variance, sum / pairs as f64, 1e-12);
    }
    assert_eq!(estimate(&records, 29), None);
}

#[test]
fn gaps_split_records_and_jitter_does_not() {
    let times = [0.0, 1.05, 2.0, 3.0, 5.0, 6.0, 6.95];
    let record: Vec<(f64, f64)> = times.iter().map(|&t| (t, 10.0 * t)).collect();
    let step = median_step(std::slice::from_ref(&record)).expect("it is regular");
    assert_eq!(step, 1.0);
    assert_eq!(stretches(&record, step), [vec![0.0, 10.5, 20.0, 30.0], vec![50.0, 60.0, 69.5]]);
    let growing: Vec<(f64, f64)> = (0..20).map(|k| (1.3_f64.powi(k), 0.0)).collect();
    assert_eq!(median_step(&[growing]), None);
    assert_eq!(median_step(&[vec![(0.0, 1.0)], vec![]]), None);
}
