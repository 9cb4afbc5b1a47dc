//! Tests with gaps, each its own, and with rows of equal times, beside one another: a regression of which the law is dense.

use kalfit::build::{Columns, constant, measurement, name};
use kalfit::estimate::Silent;
use kalfit::model::Model;
use kalfit::{Ensemble, Options};
use kalfit_fixtures::dense::Linear;
use kalfit_fixtures::near;
use nalgebra::{DMatrix, DVector};

const NOISE: f64 = 0.3;

/// A row: time, input, value or a gap.
type Row = (f64, f64, Option<f64>);

/// Tests of five rows. Which of them are measured are the bits of a number; `equal`: some have the time of the row before.
fn rows(test: u32, equal: bool) -> Vec<Row> {
    let (mut time, gaps) = (0.0, 7 * test % 32);
    let row = |k: u32| {
        let wave = f64::from(test * 5 + k);
        time += if equal && (test / 32 + k).is_multiple_of(3) && k > 0 { 0.0 } else { 0.4 + 0.1 * f64::from(k) };
        let is_measured = (gaps >> k) & 1 == 0 || k == 4 - test % 2;
        (time, (1.7 * wave).sin(), is_measured.then(|| 0.8 + (2.3 * wave).cos()))
    };
    (0..5).map(row).collect()
}

/// The model of all rows, fitted, has the figures of the dense law for each test.
fn agree(equal: bool) {
    let model = Model::builder("regression")
        .time("t")
        .state(constant("a"))
        .state(constant("b"))
        .measurement(measurement("y", name("a") + name("b") * name("u"), NOISE));
    let columns: Vec<Columns> = (0..160)
        .map(|j| {
            let rows = rows(j, equal);
            let y = rows.iter().map(|row| row.2.unwrap_or(f64::NAN));
            let all = Columns::new(format!("t{j:03}")).numbers("t", rows.iter().map(|row| row.0));
            all.numbers("u", rows.iter().map(|row| row.1)).numbers("y", y)
        })
        .collect();
    let ensemble = Ensemble::new(&model.build().expect("a model"), &columns).expect("columns of the model");
    let fit = ensemble.fit_with(&Options::default(), &mut Silent).expect("a fit");
    assert!(fit.converged(), "{}", fit.record.reason);
    let mean = DVector::from_column_slice(&fit.estimate.mean);
    let covariance = &fit.estimate.covariance;
    for (j, test) in fit.record.tests.iter().enumerate() {
        let seen: Vec<Row> = rows(j as u32, equal).into_iter().filter(|row| row.2.is_some()).collect();
        let n = seen.len();
        let h = DMatrix::from_fn(n, 2, |k, i| if i == 0 { 1.0 } else { seen[k].1 });
        let law = Linear {
            residual: DVector::from_fn(n, |k, _| seen[k].2.unwrap_or(f64::NAN)),
            sensitivity: h,
            covariance: DMatrix::identity(n, n) * NOISE.powi(2),
        };
        let e = law.error(&mean);
        let nis = e.dot(&law.total(covariance).cholesky().expect("positive").solve(&e));
        let innovations = test.innovations.as_ref().expect("innovations");
        assert_eq!(innovations.count, n, "test {j}");
        near::absolute(format_args!("ℓ of test {j}"), test.log_likelihood, law.log_density(&mean, covariance), 1e-9);
        near::absolute(format_args!("NIS of test {j}"), innovations.nis.unwrap_or(f64::NAN), nis, 1e-9);
    }
}

#[test]
fn tests_with_gaps_of_their_own_have_the_figures_of_the_dense_law() {
    agree(false);
}

#[test]
fn tests_with_rows_of_equal_times_have_the_figures_of_the_dense_law() {
    agree(true);
}
