use nalgebra::{DMatrix, DVector};

use crate::face::{Ensemble, Fit, Options, fit_matrices, fit_reductions};
use crate::fit;
use kalfit_estimate::Silent;
use kalfit_filter::reduce::{Plain, StepMatrices};
use kalfit_model::Model;
use kalfit_model::build::{Columns, constant, free, measurement, name};
use kalfit_search::Method;

const LINES: [(f64, f64); 6] = [(1.0, 2.1), (0.2, 0.3), (1.9, 4.2), (0.8, 0.9), (1.1, 3.0), (0.4, 1.2)];

fn values((start, end): (f64, f64)) -> [(f64, f64); 4] {
    [(0.0, start), (4.0, 0.6 * start + 0.4 * end + 0.1), (5.0, 0.5 * (start + end) - 0.1), (10.0, end)]
}

fn columns() -> Vec<Columns> {
    let one = |(j, line): (usize, &(f64, f64))| {
        let (t, y): (Vec<f64>, Vec<f64>) = values(*line).into_iter().unzip();
        Columns::new(format!("{j}")).numbers("t", t).numbers("y", y)
    };
    LINES.iter().enumerate().map(one).collect()
}

fn builder(noise: &str) -> kalfit_model::build::ModelBuilder {
    Model::builder("lines").state(constant("start")).state(constant("slope")).measurement(measurement(
        "y",
        name("start") + name("slope") * name("t"),
        noise,
    ))
}

fn known() -> Fit {
    let columns: Vec<Columns> = columns().into_iter().map(|c| c.every_number("noise", 0.1)).collect();
    fit(&builder("noise").build().unwrap(), &columns).unwrap()
}

#[test]
fn columns_and_matrices_give_one_fit() {
    let test = |(j, line): (usize, &(f64, f64))| {
        let step = |(t, z): (f64, f64)| {
            let (line, noise) = (DMatrix::from_row_slice(1, 2, &[1.0, t]), DMatrix::from_element(1, 1, 0.1 * 0.1));
            StepMatrices::new(line, noise, DVector::from_element(1, z))
        };
        Plain::constants(format!("{j}"), values(*line).map(step))
    };
    let tests: Vec<Plain> = LINES.iter().enumerate().map(test).collect();
    let matrices = fit_matrices(&Model::unknowns(["start", "slope"]).unwrap(), &tests).unwrap();
    let columns = known();
    assert!(columns.converged() && matrices.converged());
    let apart = (&columns.estimate.covariance - &matrices.estimate.covariance).amax();
    assert!(apart < 1e-12, "{apart:e}");
    assert!((columns.log_likelihood() - matrices.log_likelihood()).abs() < 1e-10);
}

#[test]
fn free_parameters_are_found_by_every_method() {
    let model = builder("sigma").parameter(free("sigma")).build().unwrap();
    let ensemble = Ensemble::new(&model, &columns()).unwrap();
    let by = |method| ensemble.fit_with(&Options { method, ..Options::default() }, &mut Silent).unwrap();
    let [hybrid, em] = [Method::Hybrid, Method::Em].map(by);
    assert!(hybrid.converged() && em.converged());
    let sigma = |fit: &Fit| fit.parameter("sigma").unwrap();
    // balanced random lines: the residual variance is the residual sum of squares over the 4 - 2 degrees of freedom per
    // test
    let left = LINES.iter().map(|line| residual(values(*line))).sum::<f64>();
    let expected = (left / (2.0 * LINES.len() as f64)).sqrt();
    assert!((sigma(&hybrid).estimate / expected - 1.0).abs() < 1e-6, "{} {expected}", sigma(&hybrid).estimate);
    assert!((sigma(&em).estimate / expected - 1.0).abs() < 1e-6, "{} {expected}", sigma(&em).estimate);
    assert!(sigma(&hybrid).std_error.is_some());
}

/// Residual sum of squares Σ (y - a - bt)² of the least-squares line.
fn residual(points: [(f64, f64); 4]) -> f64 {
    let mean = |f: &dyn Fn((f64, f64)) -> f64| points.iter().map(|&p| f(p)).sum::<f64>() / 4.0;
    let (t, y) = (mean(&|p| p.0), mean(&|p| p.1));
    let (tt, ty) = (mean(&|p| (p.0 - t).powi(2)), mean(&|p| (p.0 - t) * (p.1 - y)));
    let slope = ty / tt;
    points.iter().map(|p| (p.1 - y - slope * (p.0 - t)).powi(2)).sum()
}

#[test]
fn figures_are_found_by_name_and_others_are_refused() {
    let fit = known();
    assert_eq!(fit.mean("slope").unwrap().estimate, fit.estimate.mean[1]);
    let correlation = fit.correlation("slope", "start").unwrap().expect("both vary");
    assert!(correlation.estimate.abs() < 1.0);
    let said = fit.std_dev("slop").unwrap_err().to_string();
    assert_eq!(said, "the fit has no estimated state `slop`; it has start, slope");
    assert_eq!(fit.posterior("3").unwrap().mean.len(), 2);
    assert_eq!(fit.posterior("6").unwrap_err().known.len(), 6);
}

#[test]
fn innovations_are_of_the_fit() {
    let fit = known();
    let all: usize = fit.record.tests.iter().filter_map(|test| test.innovations).map(|i| i.count).sum();
    assert_eq!(all, 24);
}

#[test]
fn reductions_of_another_model_and_free_parameters_are_refused() {
    let fit = known();
    let one = Model::unknowns(["start"]).unwrap();
    let said = fit_reductions(&one, fit.reductions.clone(), &Options::default()).unwrap_err().to_string();
    assert_eq!(said, "test `0` has 2 unknown numbers, expected 1: start");
    let free = builder("sigma").parameter(free("sigma")).build().unwrap();
    let said = fit_reductions(&free, fit.reductions, &Options::default()).unwrap_err().to_string();
    assert_eq!(said, "free parameters: sigma");
    assert_eq!(crate::fit(&free, &[]).unwrap_err().to_string(), "there are no tests");
}
