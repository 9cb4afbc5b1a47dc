//! Reductions of tests given in matrices, against the dense joint Gaussian of all measurements.

use crate::dense;

use dense::{dense, twofold};
use kalfit::build::{constant, measurement, name};
use kalfit::reduce::{Path, Plain, ReduceErrorKind, Reducer, Reduction, StepMatrices};
use kalfit::{Alpha, Model, Source, Test};
use kalfit_fixtures::dense::marginal;
use kalfit_fixtures::near;
use nalgebra::{DMatrix, DVector};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

fn normal(rng: &mut impl Rng) -> f64 {
    rng.sample(StandardNormal)
}

fn matrix(rng: &mut impl Rng, rows: usize, columns: usize) -> DMatrix<f64> {
    DMatrix::from_fn(rows, columns, |_, _| normal(rng))
}

fn vector(rng: &mut impl Rng, rows: usize) -> DVector<f64> {
    DVector::from_fn(rows, |_, _| normal(rng))
}

/// A covariance: zero, of rank 1, diagonal with zeros, full, or huge.
fn covariance(rng: &mut impl Rng, n: usize, huge: bool) -> DMatrix<f64> {
    match rng.random_range(0..if huge { 5 } else { 4 }) {
        0 => DMatrix::zeros(n, n),
        1 => {
            // Small whole numbers, so that it is singular to the last bit.
            let v = DVector::from_fn(n, |_, _| f64::from(rng.random_range(-2..=2)));
            &v * v.transpose()
        }
        2 => DMatrix::from_diagonal(&DVector::from_fn(n, |_, _| if rng.random() { rng.random::<f64>() } else { 0.0 })),
        3 => {
            let root = matrix(rng, n, n);
            &root * root.transpose()
        }
        _ => DMatrix::identity(n, n) * 1e12,
    }
}

fn sensitivity(rng: &mut impl Rng, n: usize, p: usize) -> DMatrix<f64> {
    match rng.random_range(0..3) {
        0 => DMatrix::identity(n, p),
        1 => matrix(rng, n, p),
        // Columns that repeat or vanish: J is singular.
        _ => {
            let column = vector(rng, n);
            DMatrix::from_fn(n, p, |i, j| if j == 1 { 0.0 } else { column[i] })
        }
    }
}

fn measurement_noise(rng: &mut impl Rng, m: usize) -> DMatrix<f64> {
    let scale = 10f64.powi(rng.random_range(-3..=1));
    let noise = match rng.random_range(0..5) {
        0 => {
            let root = matrix(rng, m, m);
            &root * root.transpose()
        }
        1 => DMatrix::from_element(m, m, 1.0), // one noise for all: singular
        2 => DMatrix::from_diagonal(&DVector::from_fn(m, |i, _| if i == 0 { 0.0 } else { 1.0 })),
        _ => DMatrix::identity(m, m),
    };
    noise * scale * scale
}

fn step(rng: &mut impl Rng, n: usize) -> StepMatrices {
    let m = rng.random_range(0..=3);
    let noise = measurement_noise(rng, m);
    let mut step = StepMatrices::new(matrix(rng, m, n), noise, DVector::zeros(m)).with_constant(vector(rng, m));
    if rng.random_bool(0.3) {
        step.measurement = DMatrix::from_fn(m, n, |i, j| f64::from(i == j));
    }
    if rng.random_bool(0.8) {
        let mut phi = DMatrix::identity(n, n);
        for i in 0..n {
            if rng.random() {
                (0..n).for_each(|j| phi[(i, j)] = if rng.random() { 0.6 * normal(rng) } else { 0.0 });
            }
        }
        let q = covariance(rng, n, false) * rng.random::<f64>();
        step = step.moving(phi, q);
    }
    if rng.random() {
        step = step.with_input(vector(rng, n));
    }
    step
}

/// A draw from N(0, `covariance`), exactly in its range.
fn draw(rng: &mut impl Rng, covariance: &DMatrix<f64>) -> DVector<f64> {
    if covariance.is_empty() {
        return DVector::zeros(0);
    }
    let eigen = covariance.clone().symmetric_eigen();
    let most = eigen.eigenvalues.max();
    let root = eigen.eigenvalues.map(|x| if x > 1e-13 * most { x.sqrt() } else { 0.0 });
    let g = vector(rng, root.len());
    eigen.eigenvectors * root.component_mul(&g)
}

/// A test whose values are drawn from its own law at ξ of size `truth`, with missing ones.
fn random_test(seed: u64, truth: f64) -> (Plain, DVector<f64>) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let rng = &mut rng;
    let (n, p) = (rng.random_range(1..=6), rng.random_range(0..=4));
    let a = vector(rng, n);
    let spread = sensitivity(rng, n, p);
    let mut test = Plain::new(format!("seed {seed}"), a, spread, covariance(rng, n, true));
    for _ in 0..rng.random_range(1..=8) {
        test.steps.push(step(rng, n));
    }
    let xi = vector(rng, p) * truth;
    let mut x = &test.offset + &test.sensitivity * &xi + draw(rng, &test.covariance);
    for step in &mut test.steps {
        if let (Some(phi), Some(q)) = (&step.transition, &step.process_noise) {
            x = phi * x + draw(rng, q);
        }
        if let Some(input) = &step.input {
            x += input;
        }
        let z = &step.measurement * &x + &step.constant + draw(rng, &step.noise);
        step.values = z.map(|z| if rng.random_bool(0.2) { f64::NAN } else { z });
    }
    (test, xi)
}

fn log_likelihood(reduction: &Reduction, xi: &DVector<f64>) -> f64 {
    let p = xi.len();
    let left =
        |i: usize| reduction.data[i] - (i..p).map(|k| reduction.factor[i + k * (k + 1) / 2] * xi[k]).sum::<f64>();
    reduction.constant - 0.5 * (0..p).map(|i| left(i).powi(2)).sum::<f64>()
}

/// What a log-likelihood may be off by when z and d are rounded to doubles, z with a least conditional variance of `pivot`
/// times its variance.
fn rounding(reduction: &Reduction, pivot: f64) -> f64 {
    let size = reduction.data.iter().fold(1.0, |sum: f64, d| sum.hypot(*d));
    4.0 * f64::EPSILON * (size + 10.0 / pivot.sqrt())
}

#[test]
fn the_reduction_equals_the_joint_gaussian_for_every_xi() {
    let (mut compared, mut paths, mut failures) = (0, [0, 0], Vec::new());
    for seed in 0..6000 {
        let truth = if seed % 5 == 0 { 1e4 } else { 1.0 };
        let (test, xi) = random_test(seed, truth);
        let reduction = test.reduce();
        let Some((expected, pivot)) = twofold::log_likelihood(&test, &xi) else { continue };
        if pivot < 1e-20 {
            continue; // degenerate: what is left of it is rounding of the drawn values
        }
        let reduction = match reduction {
            Ok(reduction) => reduction,
            Err(error) => {
                failures.push(format!("seed {seed}, pivot {pivot:.1e}: {error}"));
                continue;
            }
        };
        compared += 1;
        paths[usize::from(reduction.path == Path::SquareRoot)] += 1;
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let other = &xi + vector(&mut rng, xi.len());
        let far = twofold::log_likelihood(&test, &other).expect("not degenerate").0;
        for (xi, expected) in [(&xi, expected), (&other, far)] {
            let bound = (1e-9 + rounding(&reduction, pivot)) * (1.0 + f64::abs(expected));
            if let Err(message) = near::error(log_likelihood(&reduction, xi), expected, bound) {
                failures.push(format!("seed {seed}, {:?}, pivot {pivot:.1e}: {message}", reduction.path));
            }
        }
    }
    assert!(failures.is_empty(), "{} of {compared} ({paths:?}):\n{}", failures.len(), failures.join("\n"));
    assert!(compared > 4000 && paths[0] > 500 && paths[1] > 500, "{compared} compared, {paths:?}");
}

/// Random tests whose measurements are far from degenerate, with their ξ.
fn ordinary_tests(count: usize) -> Vec<(Plain, DVector<f64>)> {
    let sound = |(test, xi): &(Plain, DVector<f64>)| {
        twofold::log_likelihood(test, xi).is_some_and(|(_, pivot)| pivot > 1e-9) && test.covariance.max() < 1e6
    };
    (100_000..).map(|seed| random_test(seed, 1.0)).filter(sound).take(count).collect()
}

#[test]
fn both_paths_give_the_same_reduction() {
    let mut both = 0;
    for (test, xi) in ordinary_tests(1000) {
        let (plain, root) = (test.reduce().expect("sound"), test.reduce_square_root().expect("sound"));
        assert_eq!((root.path, root.design), (Path::SquareRoot, plain.design));
        both += usize::from(plain.path == Path::Information);
        near::mixed(&test.id, log_likelihood(&plain, &xi), log_likelihood(&root, &xi), 1e-9);
        for (k, (a, b)) in plain.factor.iter().zip(&root.factor).enumerate() {
            let size = root.factor.iter().fold(0.0, |most: f64, x| most.max(x.abs()));
            // Of an ill-conditioned J the root is determined to √(ε × condition).
            assert!((a - b).abs() <= 1e-5 * size, "{}, entry {k} of R: {a} against {b}", test.id);
        }
    }
    assert!(both > 300, "{both} tests took the fast path");
}

#[test]
fn singular_information_leaves_rows_of_zeros() {
    let mut test = Plain::new("sum", DVector::zeros(2), DMatrix::identity(2, 2), DMatrix::zeros(2, 2));
    for k in 0..5 {
        let row = DMatrix::from_row_slice(1, 2, &[0.1, 0.3]);
        test.steps.push(StepMatrices::new(row, DMatrix::identity(1, 1) * 0.04, DVector::from_element(1, f64::from(k))));
    }
    let reduction = test.reduce().expect("sound");
    assert_eq!(reduction.path, Path::SquareRoot);
    assert_eq!(reduction.factor[2], 0.0, "{:?}", reduction.factor);
    assert_eq!(reduction.data[1], 0.0, "{:?}", reduction.data);
    let xi = DVector::from_vec(vec![3.0, -2.0]);
    let expected = dense(&test).log_likelihood(&xi);
    near::mixed("log-likelihood", log_likelihood(&reduction, &xi), expected, 1e-13);
}

#[test]
fn the_terminal_triple_is_the_law_of_the_last_state() {
    for (test, xi) in ordinary_tests(500) {
        let (_, terminal) = test.reduce_with_terminal().expect("sound");
        let (mean, covariance) = dense(&test).last_given(&xi);
        let found = &terminal.mean + &terminal.sensitivity * &xi;
        let size = 1.0 + mean.amax() + terminal.mean.amax();
        assert!((&found - &mean).amax() <= 1e-6 * size, "{}: {found} against {mean}", test.id);
        let size = 1.0 + covariance.amax();
        let error = (terminal.covariance() - &covariance).amax();
        assert!(error <= 1e-6 * size, "{}: {} against {covariance}", test.id, terminal.covariance());
    }
}

#[test]
fn an_ensemble_of_reductions_has_the_likelihood_of_the_data() {
    for seed in 0..50 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let tests: Vec<Plain> =
            ordinary_tests(60).into_iter().map(|(test, _)| test).filter(|test| test.sensitivity.ncols() == 3).collect();
        let (mu, root) = (vector(&mut rng, 3), matrix(&mut rng, 3, 2));
        let sigma = &root * root.transpose();
        let expected = dense::ensemble_log_likelihood(&tests, &mu, &sigma);
        let found: f64 = tests
            .iter()
            .map(|test| {
                let reduction = test.reduce().expect("sound");
                marginal(reduction.view(), &mu, &sigma)
            })
            .sum();
        assert!(tests.len() > 3, "{} tests", tests.len());
        near::mixed(format_args!("seed {seed}"), found, expected, 1e-9);
    }
}

#[test]
fn the_order_of_measurements_in_a_step_changes_nothing() {
    for (test, xi) in ordinary_tests(500) {
        let mut turned = test.clone();
        for step in &mut turned.steps {
            let m = step.values.len();
            let from = |i: usize| m - 1 - i;
            let old = step.clone();
            step.values = DVector::from_fn(m, |i, _| old.values[from(i)]);
            step.constant = DVector::from_fn(m, |i, _| old.constant[from(i)]);
            step.measurement = DMatrix::from_fn(m, old.measurement.ncols(), |i, j| old.measurement[(from(i), j)]);
            step.noise = DMatrix::from_fn(m, m, |i, j| old.noise[(from(i), from(j))]);
        }
        let (a, b) = (test.reduce().expect("sound"), turned.reduce().expect("sound"));
        near::mixed(&test.id, log_likelihood(&b, &xi), log_likelihood(&a, &xi), 2e-9);
    }
}

#[test]
fn rescaled_states_give_the_same_likelihood() {
    for (test, xi) in ordinary_tests(500) {
        let n = test.offset.len();
        let scale = DMatrix::from_diagonal(&DVector::from_fn(n, |i, _| 10f64.powi(3 * i as i32 - 6)));
        let inverse = scale.map(|x| if x == 0.0 { 0.0 } else { 1.0 / x });
        let mut scaled = test.clone();
        scaled.offset = &scale * &test.offset;
        scaled.sensitivity = &scale * &test.sensitivity;
        scaled.covariance = &scale * &test.covariance * &scale;
        for step in &mut scaled.steps {
            step.transition = step.transition.take().map(|phi| &scale * phi * &inverse);
            step.process_noise = step.process_noise.take().map(|q| &scale * q * &scale);
            step.input = step.input.take().map(|b| &scale * b);
            step.measurement = &step.measurement * &inverse;
        }
        let (a, b) = (test.reduce().expect("sound"), scaled.reduce().expect("sound"));
        near::mixed(&test.id, log_likelihood(&b, &xi), log_likelihood(&a, &xi), 2e-9);
    }
}

#[test]
fn a_step_may_be_split_where_nothing_moves() {
    for (test, xi) in ordinary_tests(300) {
        let mut split = test.clone();
        split.steps = test
            .steps
            .iter()
            .flat_map(|step| {
                let mut first = StepMatrices::silent(test.offset.len());
                let mut second = step.clone();
                (first.transition, first.input, first.process_noise) =
                    (second.transition.take(), second.input.take(), second.process_noise.take());
                [first, second]
            })
            .collect();
        let (a, b) = (test.reduce().expect("sound"), split.reduce().expect("sound"));
        assert_eq!((a.constant, &a.data, &a.factor), (b.constant, &b.data, &b.factor), "{}", test.id);
        assert!(log_likelihood(&a, &xi).is_finite());
    }
}

#[test]
fn a_missing_measurement_is_one_of_infinite_variance() {
    for (test, _) in ordinary_tests(300) {
        let mut vague = test.clone();
        for step in &mut vague.steps {
            for i in 0..step.values.len() {
                if step.values[i].is_nan() {
                    step.noise.fill_row(i, 0.0);
                    step.noise.fill_column(i, 0.0);
                    (step.noise[(i, i)], step.values[i]) = (f64::INFINITY, 17.0);
                }
            }
        }
        assert_eq!(test.reduce(), vague.reduce());
    }
}

/// x = ξ + ζ, ζ ~ N(0, `variance`), measured without noise.
fn exact(variance: f64, values: &[f64]) -> Plain {
    let one = |x| DMatrix::from_element(1, 1, x);
    let mut test = Plain::new("exact", DVector::zeros(1), one(1.0), one(variance));
    let step = |&z: &f64| StepMatrices::new(one(1.0), one(0.0), DVector::from_element(1, z));
    test.steps.extend(values.iter().map(step));
    test
}

#[test]
fn what_is_measured_without_noise_is_taken_refused_or_ignored() {
    let kind = |test: &Plain| *test.reduce().expect_err("refused").kind;
    let known = exact(0.0, &[1.0, 1.0]).reduce().expect("sound");
    let rows = known.exact.expect("an exact row");
    assert_eq!((rows.coefficients, rows.values, known.observations), (vec![1.0], vec![1.0], 1));
    assert!(matches!(kind(&exact(0.0, &[1.0, 1.1])), ReduceErrorKind::Impossible { .. }));
    // The second time it says nothing, unless it says something else.
    let (once, twice) = (exact(2.0, &[1.5]).reduce().expect("sound"), exact(2.0, &[1.5, 1.5]).reduce().expect("sound"));
    let numbers = |found: &Reduction| [found.constant, found.data[0], found.factor[0]];
    for (once, twice) in numbers(&once).into_iter().zip(numbers(&twice)) {
        near::mixed("measured twice", once, twice, 1e-15);
    }
    assert_eq!((once.observations, once.path), (1, Path::Information), "of one state no digit is lost");
    assert_eq!((twice.observations, twice.path), (1, Path::SquareRoot));
    assert!(
        matches!(kind(&exact(2.0, &[1.5, 1.6])), ReduceErrorKind::Impossible { residual } if (residual - 0.1).abs() < 1e-12)
    );
    // rounding is no contradiction: a ten thousand millionth of what is added up, and no more
    for (off, sound) in [(1e-10, true), (1e-9, false), (1e-7, false)] {
        let found = exact(2.0, &[1.5, 1.5 + off]).reduce();
        assert_eq!(found.is_ok(), sound, "{off}: {found:?}");
    }
    let message = exact(0.0, &[1.0, 1.5]).reduce().expect_err("refused");
    assert_eq!(
        message.to_string(),
        "test `exact`: step 2: measured without any noise, the value is off by 5.000e-1, which is impossible"
    );
}

#[test]
fn matrices_that_do_not_fit_are_refused() {
    type Spoil = fn(&mut Plain);
    let cases: [(Spoil, &str); 8] = [
        (|t| t.covariance = DMatrix::zeros(1, 2), "covariance P0: found 1 x 2, expected 2 x 2"),
        (
            |t| t.covariance = DMatrix::from_row_slice(2, 2, &[1.0, 2.0, 2.0, 1.0]),
            "covariance P0: the covariance matrix is not",
        ),
        (|t| t.covariance[(0, 1)] = 0.5, "covariance P0: the matrix is not symmetric: 0.5 above the diagonal, 0 below"),
        (|t| t.offset[0] = f64::NAN, "offset a: the value is not a finite number"),
        (|t| t.steps[0].measurement = DMatrix::zeros(1, 3), "measurement of step 1: found 1 x 3, expected 1 x 2"),
        (|t| t.steps[0].noise[(0, 0)] = -1.0, "noise of step 1: found a variance of -1, expected 0 or more"),
        (|t| t.steps[0].noise = DMatrix::zeros(2, 1), "noise of step 1: found 2 x 1, expected 1 x 1"),
        (|t| t.steps[0].values[0] = f64::INFINITY, "values of step 1: the value is not a finite number"),
    ];
    for (spoil, message) in cases {
        let mut test = Plain::new("t", DVector::zeros(2), DMatrix::identity(2, 1), DMatrix::identity(2, 2));
        let row = DMatrix::from_row_slice(1, 2, &[1.0, 0.0]);
        test.steps.push(StepMatrices::new(row, DMatrix::identity(1, 1), DVector::zeros(1)));
        test.reduce().expect("sound");
        spoil(&mut test);
        let error = test.reduce().expect_err("refused").to_string();
        assert!(error.starts_with(&format!("test `t`: {message}")), "{error}");
    }
}

#[test]
fn overflow_is_an_error() {
    let mut test = exact(1.0, &[1.0]);
    test.steps[0].noise[(0, 0)] = 1.0;
    test.steps[0].measurement[(0, 0)] = 1e200;
    test.covariance[(0, 0)] = 1e300;
    let error = test.reduce().expect_err("refused");
    assert_eq!(*error.kind, ReduceErrorKind::NotFinite, "{error}");
}

#[test]
fn a_value_that_cannot_be_is_seen_among_many_equal_steps() {
    let model = Model::builder("")
        .state(constant("level").known(0.0, 2.0))
        .state(constant("offset"))
        .measurement(measurement("z", name("level") + name("offset"), 0.0));
    let model = model.build().expect("sound").phases.remove(0).model;
    let reducer = Reducer::new(&model, &Alpha::default()).expect("sound");
    let reduce = |wrong: Option<usize>| {
        let mut test = Test::new("one", model.columns.len(), 0);
        for row in 0..200 {
            let level = if Some(row) == wrong { 1.6 } else { 1.5 };
            test.push(&[level], &[], Source::default());
        }
        reducer.reduce(&[test])
    };
    assert_eq!(reduce(None).expect("sound").get(0).observations, 1);
    for wrong in [1, 100, 199] {
        let error = reduce(Some(wrong)).expect_err("it can only be 1.5");
        let off = match *error.kind {
            ReduceErrorKind::Impossible { residual } => residual - 0.1,
            ref other => panic!("row {wrong}: {other:?}"),
        };
        assert!(off.abs() < 1e-12, "row {wrong}: {off}");
    }
}
