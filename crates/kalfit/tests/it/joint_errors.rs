//! Standard errors and intervals of μ and Σ beside free parameters, and on the faces of the cone, against differences of the dense
//! likelihood and against fits with the quantity held.

use kalfit::build::{Columns, ModelBuilder, constant, free, measurement, name};
use kalfit::estimate::Silent;
use kalfit::infer::{Choices, IntervalKind, StdErrors};
use kalfit::model::{CovarianceKind, CovarianceStructure, Expression, Model, Parameter, PhasedModel, Value};
use kalfit::{Ensemble, Fit, Options};
use kalfit_fixtures::dense::Linear;
use kalfit_fixtures::near;
use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

/// Half of χ²₁'s 95 % quantile: by so much ℓ falls to the end of a profile interval.
const FALL: f64 = 1.920_729_410_347_062_2;

/// Rows (x, y) of one test.
type Rows = Vec<(f64, f64)>;

/// Tests of y = Σ_i ξ_i x^i + noise, ξ ~ N(μ, FF').
fn drawn(tests: usize, mean: &[f64], root: &DMatrix<f64>, noise: f64, seed: u64) -> Vec<Rows> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut one = |j: usize| {
        let z = DVector::<f64>::from_fn(root.ncols(), |_, _| rng.sample(StandardNormal));
        let xi = DVector::from_column_slice(mean) + root * z;
        let row = |k: usize| -0.9 + 0.37 * k as f64 + 0.05 * (j % 3) as f64;
        let mut y = |x: f64| {
            let e: f64 = rng.sample(StandardNormal);
            (0..xi.len()).map(|i| xi[i] * x.powi(i as i32)).sum::<f64>() + noise * e
        };
        (0..4 + j % 4).map(|k| (row(k), y(row(k)))).collect()
    };
    (0..tests).map(&mut one).collect()
}

fn columns(tests: &[Rows]) -> Vec<Columns> {
    let one = |(j, rows): (usize, &Rows)| {
        let powers = |i: i32| rows.iter().map(move |(x, _)| x.powi(i));
        let y = rows.iter().map(|(_, y)| *y);
        Columns::new(format!("t{j:03}")).numbers("x", powers(1)).numbers("xx", powers(2)).numbers("y", y)
    };
    tests.iter().enumerate().map(one).collect()
}

/// States a, b and c, as many as p says; the noise level s is free.
fn lines(p: usize) -> ModelBuilder {
    let mut equation = name("a") + name("b") * name("x");
    let mut builder = Model::builder("lines").state(constant("a")).state(constant("b"));
    if p > 2 {
        equation = equation + name("c") * name("xx");
        builder = builder.state(constant("c"));
    }
    builder.measurement(measurement("y", equation, "s")).parameter(free("s"))
}

fn fitted(model: &PhasedModel, tests: &[Rows], intervals: IntervalKind, std_errors: StdErrors) -> Fit {
    let ensemble = Ensemble::new(model, &columns(tests)).expect("columns of the model");
    let choices = Choices { intervals, std_errors, ..Choices::default() };
    let options = Options { choices, innovations: false, ..Options::default() };
    let fit = ensemble.fit_with(&options, &mut Silent).expect("a fit");
    assert!(fit.converged(), "{}", fit.record.reason);
    fit
}

/// log p of one test.
fn dense(rows: &Rows, mean: &[f64], sigma: &DMatrix<f64>, s: f64) -> f64 {
    let (n, p) = (rows.len(), mean.len());
    let law = Linear {
        residual: DVector::from_fn(n, |k, _| rows[k].1),
        sensitivity: DMatrix::from_fn(n, p, |k, i| rows[k].0.powi(i as i32)),
        covariance: DMatrix::identity(n, n) * (s * s),
    };
    law.log_density(&DVector::from_column_slice(mean), sigma)
}

/// Gradient by differences to both sides.
fn gradient(f: &dyn Fn(&[f64]) -> f64, at: &[f64]) -> DVector<f64> {
    let moved =
        |i: usize, h: f64| f(&at.iter().enumerate().map(|(k, x)| x + if k == i { h } else { 0.0 }).collect::<Vec<_>>());
    DVector::from_fn(at.len(), |i, _| {
        let h = 1e-3 * at[i].abs().max(0.1);
        (8.0 * (moved(i, h) - moved(i, -h)) - (moved(i, 2.0 * h) - moved(i, -2.0 * h))) / (12.0 * h)
    })
}

/// -∂²f by differences of gradients.
fn information(f: &dyn Fn(&[f64]) -> f64, at: &[f64]) -> DMatrix<f64> {
    let n = at.len();
    let columns: Vec<DVector<f64>> = (0..n)
        .map(|i| {
            let h = 1e-4 * at[i].abs().max(0.1);
            let moved = |h: f64| {
                gradient(f, &at.iter().enumerate().map(|(k, x)| x + if k == i { h } else { 0.0 }).collect::<Vec<_>>())
            };
            (moved(-h) - moved(h)) / (2.0 * h)
        })
        .collect();
    DMatrix::from_fn(n, n, |i, j| 0.5 * (columns[i][j] + columns[j][i]))
}

/// Standard error of q by the delta method.
fn error(law: &DMatrix<f64>, q: &dyn Fn(&[f64]) -> f64, at: &[f64]) -> f64 {
    let g = gradient(q, at);
    g.dot(&(law * &g)).sqrt()
}

#[track_caller]
fn close(found: Option<f64>, expected: f64, relative: f64, what: &str) {
    let found = found.unwrap_or_else(|| panic!("{what}: found none, expected {expected}"));
    near::relative(what, found, expected, relative);
}

/// The model of lines with the correlation `rho`, a parameter.
fn with_correlation() -> PhasedModel {
    let mut model = lines(2).build().expect("a model");
    let own = &mut model.phases[0].model;
    let rho = Parameter {
        name: "rho".to_owned(),
        unit: None,
        value: Value::Free { start: Some(0.0) },
        per: None,
        fixed_levels: Default::default(),
        lower: Some(-0.99),
        upper: Some(0.99),
        positive: false,
    };
    own.parameters.push(rho);
    let (one, rho) = (Expression::Number(1.0), Expression::Parameter(own.parameters.len() - 1));
    let entries = vec![vec![one.clone(), rho.clone()], vec![rho, one]];
    own.covariance = CovarianceStructure { kind: CovarianceKind::Correlation(entries), ..CovarianceStructure::full() };
    model
}

/// (μ_a, μ_b, sd a, sd b, ρ, log s) as a vector of values.
fn of_correlation(tests: &[Rows]) -> (impl Fn(&[f64], usize) -> f64 + '_, usize) {
    let one = |t: &[f64], j: usize| {
        let cov = t[4] * t[2] * t[3];
        let sigma = DMatrix::from_row_slice(2, 2, &[t[2] * t[2], cov, cov, t[3] * t[3]]);
        dense(&tests[j], &t[..2], &sigma, t[5].exp())
    };
    (one, tests.len())
}

#[test]
fn errors_beside_a_parameter_in_the_matrix_of_the_covariance_are_joint() {
    let root = DMatrix::from_row_slice(2, 2, &[1.0, 0.0, 0.5, 0.6]);
    let tests = drawn(25, &[1.0, -0.5], &root, 0.4, 11);
    let model = with_correlation();
    let (one, count) = of_correlation(&tests);
    let all = |t: &[f64]| (0..count).map(|j| one(t, j)).sum::<f64>();
    for kind in [StdErrors::Observed, StdErrors::Sandwich] {
        let fit = fitted(&model, &tests, IntervalKind::Wald, kind);
        let phase = &fit.record.phases[0];
        let rho = phase.correlation.estimate[1][0].expect("both vary");
        let s = fit.record.parameters.iter().find(|p| p.name == "s").expect("it is free");
        let (mean, sd) = (&phase.mean.estimate, &phase.std_dev.estimate);
        let at = [mean[0], mean[1], sd[0], sd[1], rho, s.estimate.ln()];
        let bread = information(&all, &at).try_inverse().expect("regular");
        let law = match kind {
            StdErrors::Sandwich => {
                let mut meat = DMatrix::zeros(6, 6);
                for j in 0..count {
                    let score = gradient(&|t| one(t, j), &at);
                    meat += &score * score.transpose();
                }
                &bread * meat * &bread
            }
            _ => bread,
        };
        let say = |what: &str| format!("{kind:?}: {what}");
        for i in 0..2 {
            close(phase.mean.std_error[i], error(&law, &|t| t[i], &at), 1e-4, &say("mean"));
            close(phase.std_dev.std_error[i], error(&law, &|t| t[2 + i], &at), 1e-4, &say("standard deviation"));
            close(phase.covariance.std_error[i][i], error(&law, &|t| t[2 + i].powi(2), &at), 1e-4, &say("variance"));
        }
        let covariance = error(&law, &|t| t[4] * t[2] * t[3], &at);
        close(phase.covariance.std_error[1][0], covariance, 1e-4, &say("covariance"));
        close(phase.correlation.std_error[1][0], error(&law, &|t| t[4], &at), 1e-4, &say("correlation"));
        close(s.std_error, error(&law, &|t| t[5].exp(), &at), 1e-4, &say("noise level"));
        assert!(phase.correlation.interval95[1][0].is_some(), "a correlation with a standard error has an interval");
    }
}

/// Mean and covariance of one test at (μ_a, μ_b, Σ_aa, Σ_ab, Σ_bb, log s).
fn moments(rows: &Rows, t: &[f64]) -> (DVector<f64>, DMatrix<f64>) {
    let n = rows.len();
    let design = DMatrix::from_fn(n, 2, |k, i| rows[k].0.powi(i as i32));
    let sigma = DMatrix::from_row_slice(2, 2, &[t[2], t[3], t[3], t[4]]);
    let variance = &design * sigma * design.transpose() + DMatrix::identity(n, n) * (2.0 * t[5]).exp();
    (&design * DVector::from_column_slice(&t[..2]), variance)
}

/// The expected information Σ_j m_a'V⁻¹m_b + ½ tr(V⁻¹V_aV⁻¹V_b), by differences of the moments.
fn expected_information(tests: &[Rows], at: &[f64]) -> DMatrix<f64> {
    let n = at.len();
    let mut sum = DMatrix::zeros(n, n);
    for rows in tests {
        let slope = |a: usize| {
            let h = 1e-5 * at[a].abs().max(0.1);
            let moved = |h: f64| {
                moments(rows, &at.iter().enumerate().map(|(k, x)| if k == a { x + h } else { *x }).collect::<Vec<_>>())
            };
            let ((up, wide), (down, narrow)) = (moved(h), moved(-h));
            ((up - down) / (2.0 * h), (wide - narrow) / (2.0 * h))
        };
        let slopes: Vec<(DVector<f64>, DMatrix<f64>)> = (0..n).map(slope).collect();
        let inverse = moments(rows, at).1.try_inverse().expect("regular");
        sum += DMatrix::from_fn(n, n, |a, b| {
            let ((m, v), (w, u)) = (&slopes[a], &slopes[b]);
            m.dot(&(&inverse * w)) + 0.5 * (&inverse * v * &inverse * u).trace()
        });
    }
    sum
}

/// What the dense likelihood says of the score test of element `held` of (μ_a, μ_b, Σ_aa, Σ_ab, Σ_bb, log s), all others adapting:
/// score, statistic and expected change; and the statistic without what the element shares with s.
fn dense_score_test(all: &dyn Fn(&[f64]) -> f64, information: &DMatrix<f64>, at: &[f64], held: usize) -> [f64; 4] {
    let score = gradient(all, at)[held];
    let left_beside = |free: &[usize]| {
        let law = information.select_rows(free).select_columns(free).try_inverse().expect("regular");
        let cross = DVector::from_iterator(free.len(), free.iter().map(|&k| information[(k, held)]));
        information[(held, held)] - cross.dot(&(&law * &cross))
    };
    let free: Vec<usize> = (0..at.len()).filter(|&k| k != held).collect();
    let (left, without) = (left_beside(&free), left_beside(&free[..free.len() - 1]));
    [score, score * score / left, score / left, score * score / without]
}

#[test]
fn score_tests_of_constraints_let_free_parameters_adapt() {
    let root = DMatrix::from_row_slice(2, 2, &[0.5, 0.0, 0.2, 0.3]);
    let tests = drawn(14, &[1.0, -0.5], &root, 0.5, 21);
    let cases = [
        ("covariance", lines(2).diagonal(), "covariance[a, b]", 3),
        ("variance", lines(2).fix_covariance("a", "a", 0.1), "covariance[a, a]", 2),
        ("mean", lines(2).fix_mean("b", -0.4), "mean[b]", 1),
    ];
    let mut shared: f64 = 0.0;
    for (what, model, element, held) in cases {
        let fit = fitted(&model.build().expect("a model"), &tests, IntervalKind::Wald, StdErrors::Observed);
        let (mean, sigma) = (&fit.record.phases[0].mean.estimate, &fit.estimate.covariance);
        let s = fit.record.parameters[0].estimate;
        let at = [mean[0], mean[1], sigma[(0, 0)], sigma[(1, 0)], sigma[(1, 1)], s.ln()];
        let all = |t: &[f64]| {
            let sigma = DMatrix::from_row_slice(2, 2, &[t[2], t[3], t[3], t[4]]);
            tests.iter().map(|rows| dense(rows, &t[..2], &sigma, t[5].exp())).sum::<f64>()
        };
        let found = fit.record.constraints.iter().find(|c| c.element == element).expect("it is held");
        let [score, statistic, change, without] = dense_score_test(&all, &expected_information(&tests, &at), &at, held);
        close(found.sensitivity, score, 1e-5, &format!("{what}: sensitivity"));
        close(found.score_statistic, statistic, 1e-5, &format!("{what}: statistic"));
        close(found.expected_change, change, 1e-5, &format!("{what}: expected change"));
        println!("{what}: statistic {statistic}, without what it shares with the noise level {without}");
        shared = shared.max((without / statistic - 1.0).abs());
    }
    assert!(shared > 1e-3, "no test shows that the noise level counts: {shared}");
}

/// Twice the fall of ℓ at the end of an interval, by a fit with the quantity held there, is χ²₁'s quantile.
fn ends_where_a_held_fit_says(
    best: &Fit,
    tests: &[Rows],
    interval: [Option<f64>; 2],
    held: &dyn Fn(f64) -> ModelBuilder,
) {
    for end in interval.into_iter().flatten().filter(|end| *end != 0.0) {
        let model = held(end).build().expect("a model");
        let fit = fitted(&model, tests, IntervalKind::Wald, StdErrors::Observed);
        let fall = best.log_likelihood() - fit.log_likelihood();
        assert!((fall - FALL).abs() < 1e-3, "at {end} ℓ is lower by {fall}, expected {FALL}");
    }
}

#[test]
fn profiles_of_mean_and_covariance_follow_free_parameters() {
    let root = DMatrix::from_row_slice(2, 2, &[0.5, 0.0, 0.2, 0.3]);
    let tests = drawn(14, &[1.0, -0.5], &root, 0.5, 21);
    let fit = fitted(&lines(2).build().expect("a model"), &tests, IntervalKind::Profile, StdErrors::Observed);
    let phase = &fit.record.phases[0];
    assert_eq!(fit.record.intervals, "profile");
    let mean = phase.mean.interval95[1].expect("it is free");
    ends_where_a_held_fit_says(&fit, &tests, mean, &|value| lines(2).fix_mean("b", value));
    let sd = phase.std_dev.interval95[0].expect("it is free");
    assert!(sd[1].is_some(), "{sd:?}");
    ends_where_a_held_fit_says(&fit, &tests, sd, &|value| lines(2).fix_covariance("a", "a", value * value));
    let covariance = phase.covariance.interval95[1][0].expect("it is free");
    ends_where_a_held_fit_says(&fit, &tests, covariance, &|value| lines(2).fix_covariance("a", "b", value));
}

#[test]
fn a_variance_estimated_as_zero_has_an_upper_limit_beside_free_parameters() {
    let root = DMatrix::from_row_slice(2, 1, &[0.8, 0.0]);
    let of = |seed| drawn(10, &[1.0, -0.5], &root, 0.5, seed);
    let model = || lines(2).diagonal();
    let zero = |seed: &u64| {
        let fit = fitted(&model().build().expect("a model"), &of(*seed), IntervalKind::Wald, StdErrors::Observed);
        fit.record.phases[0].std_dev.estimate[1] == 0.0
    };
    let seed = (31..41).find(zero).expect("half of them have it at zero");
    let tests = of(seed);
    let fit = fitted(&model().build().expect("a model"), &tests, IntervalKind::Profile, StdErrors::Observed);
    let interval = fit.record.phases[0].std_dev.interval95[1].expect("on the boundary too");
    assert_eq!(interval[0], Some(0.0));
    assert!(interval[1].is_some_and(|upper| upper > 0.0), "{interval:?}");
    ends_where_a_held_fit_says(&fit, &tests, interval, &|value| model().fix_covariance("b", "b", value * value));
}

#[test]
fn on_a_face_of_the_cone_errors_are_those_of_matrices_of_its_rank() {
    for (p, rank) in [(2, 1), (3, 2)] {
        let full = DMatrix::from_row_slice(3, 2, &[1.0, 0.0, 0.6, 0.5, 0.3, -0.7]);
        let root = full.view((0, 0), (p, rank)).into_owned();
        let mean = &[1.0, -0.5, 0.3][..p];
        let model = lines(p).build().expect("a model");
        let on_face = |seed: &u64| {
            let fit = fitted(&model, &drawn(20, mean, &root, 0.3, *seed), IntervalKind::Wald, StdErrors::Observed);
            let boundary = &fit.record.phases[0].boundary;
            boundary.len() == 1 && boundary[0].rank == rank && boundary[0].zero_variances.is_empty()
        };
        let seed = (41..61).find(on_face).expect("about half of them are of this rank");
        let tests = drawn(20, mean, &root, 0.3, seed);
        let fit = fitted(&model, &tests, IntervalKind::Wald, StdErrors::Observed);
        compare_on_face(&fit, &tests, (p, rank));
    }
}

fn compare_on_face(fit: &Fit, tests: &[Rows], (p, rank): (usize, usize)) {
    // Σ = LL', L p × rank, lower triangular
    let places: Vec<(usize, usize)> = (0..p).flat_map(|i| (0..=i.min(rank - 1)).map(move |c| (i, c))).collect();
    let sigma = |t: &[f64]| {
        let mut root = DMatrix::zeros(p, rank);
        places.iter().zip(&t[p..]).for_each(|(at, x)| root[*at] = *x);
        &root * root.transpose()
    };
    let phase = &fit.record.phases[0];
    let found = &fit.estimate.covariance;
    let mut at = phase.mean.estimate.clone();
    let mut root = DMatrix::zeros(p, rank);
    for &(i, c) in &places {
        let done: f64 = (0..c).map(|k| root[(i, k)] * root[(c, k)]).sum();
        root[(i, c)] = if i == c { (found[(i, i)] - done).sqrt() } else { (found[(i, c)] - done) / root[(c, c)] };
        at.push(root[(i, c)]);
    }
    at.push(fit.record.parameters[0].estimate.ln());
    let all = |t: &[f64]| tests.iter().map(|rows| dense(rows, &t[..p], &sigma(t), t[t.len() - 1].exp())).sum::<f64>();
    let law = information(&all, &at).try_inverse().expect("regular on the face");
    for i in 0..p {
        let sd = error(&law, &|t| sigma(t)[(i, i)].sqrt(), &at);
        close(phase.std_dev.std_error[i], sd, 1e-4, &format!("rank {rank} of {p}: standard deviation {i}"));
        for j in 0..i {
            let what = format!("rank {rank} of {p}: element {i}, {j}");
            close(phase.covariance.std_error[i][j], error(&law, &|t| sigma(t)[(i, j)], &at), 1e-4, &what);
            let correlation = |t: &[f64]| sigma(t)[(i, j)] / (sigma(t)[(i, i)] * sigma(t)[(j, j)]).sqrt();
            match rank {
                1 => assert_eq!(phase.correlation.std_error[i][j], None, "a correlation of one does not move: {what}"),
                _ => close(phase.correlation.std_error[i][j], error(&law, &correlation, &at), 1e-4, &what),
            }
        }
    }
}
