//! Sizes of noise and lengths of time in the data, as first guesses of parameters.

use std::collections::BTreeSet;

use rayon::prelude::*;

use kalfit_model::Test;
use kalfit_model::{Evidence, PhasedTest};
use kalfit_model::{Expression, Operator, PhasedModel, Site};

/// Maximal number of rows of one test that are read.
const ROWS_OF_A_TEST: usize = 20_000;
/// Minimal number of tests that a thread reads together.
const MIN_TESTS: usize = 256;
/// Relative accuracy of measured values and of what is computed from them.
const ROUNDING: f64 = 1e-12;
/// Least relative rounding ε that is returned: 1/ε² is still finite.
const MIN_RELATIVE_ROUNDING: f64 = 1e-60;

/// Sizes of noise and lengths of time in the data.
#[derive(Debug)]
pub(crate) struct Scales {
    /// Root mean square differences of successive measured values over √2, by phase and measurement.
    noise: Vec<Vec<f64>>,
    /// Median length of a step.
    step: f64,
    /// Median length of a phase of a test.
    span: f64,
}

impl Scales {
    /// The sizes in the tests of a model, summed in `order`, so that a search does not depend on the order of `tests`.
    pub(crate) fn of(model: &PhasedModel, tests: &[PhasedTest], order: &[usize]) -> Scales {
        let noise_of = |at: usize| -> Vec<f64> {
            let (columns, rows) = (model.phases[at].model.measurements.iter(), phase_rows(tests, order, at));
            columns.map(|m| difference_size(&rows, m.column)).collect()
        };
        let noise = (0..model.phases.len()).map(noise_of).collect();
        let (mut steps, mut spans) = (Vec::new(), Vec::new());
        for (at, phase) in model.phases.iter().enumerate() {
            let Some(time) = phase.model.clock.time else { continue };
            for test in phase_rows(tests, order, at) {
                let times: Vec<f64> = (0..test.rows().min(ROWS_OF_A_TEST)).map(|row| test.numbers(row)[time]).collect();
                steps.extend(times.windows(2).map(|pair| pair[1] - pair[0]).filter(|d| *d > 0.0));
                let last = test.rows().checked_sub(1).map(|row| test.numbers(row)[time]);
                spans.extend(last.zip(times.first()).map(|(last, first)| last - first).filter(|d| *d > 0.0));
            }
        }
        Scales { noise, step: median(steps).unwrap_or(1.0), span: median(spans).unwrap_or(1.0) }
    }

    /// Times from `part` × the median length of a step to `spans` × the median length of a phase of a test, each
    /// `factor` × the time before.
    pub(crate) fn times_between(&self, part: f64, spans: f64, factor: f64) -> impl Iterator<Item = f64> + use<> {
        let (first, last) = (part * self.step, spans * self.span.max(self.step));
        (0..).map(move |k| first * factor.powi(k)).take_while(move |time| *time <= last)
    }

    /// `spans` × the median length of a phase of a test: times far longer than a record.
    pub(crate) fn long_times<const N: usize>(&self, spans: [f64; N]) -> [f64; N] {
        spans.map(|spans| spans * self.span.max(self.step))
    }

    /// First guess of a positive parameter.
    pub(crate) fn guess(&self, model: &PhasedModel, parameter: usize) -> f64 {
        if time_constants(model).contains(&parameter) {
            return (self.step * self.span).sqrt();
        }
        let measurements =
            model.phases.iter().zip(&self.noise).flat_map(|(p, noise)| p.model.measurements.iter().zip(noise));
        let own = measurements.into_iter().find(|(m, _)| m.noise_variance.mentions(parameter));
        if let Some((measurement, &size)) = own {
            // the variance is the square of the parameter, or the parameter itself
            let as_variance = !is_square(&measurement.noise_variance);
            return if as_variance { size * size } else { size };
        }
        let sizes = self.noise.iter().flatten().copied().filter(|size| *size > 0.0);
        let all = median(sizes.collect()).unwrap_or(1.0);
        let is_variance = |(site, expression): (Site, &Expression)| {
            matches!(site, Site::ProcessNoise(_)) && *expression == Expression::Parameter(parameter)
        };
        if expressions(model).any(is_variance) { all * all } else { all }
    }
}

/// [`ROUNDING`] × the root mean square of measured values over the size of successive differences, the largest over all
/// measurements.
pub(super) fn relative_rounding(model: &PhasedModel, tests: &[PhasedTest], order: &[usize]) -> f64 {
    let of_phase = |at: usize| {
        let rows = phase_rows(tests, order, at);
        let of = |column: usize| ROUNDING * size(&rows, column) / difference_size(&rows, column);
        model.phases[at].model.measurements.iter().map(|m| of(m.column)).fold(0.0, f64::max)
    };
    (0..model.phases.len()).map(of_phase).fold(MIN_RELATIVE_ROUNDING, f64::max)
}

/// The expressions of the models of all phases.
fn expressions(model: &PhasedModel) -> impl Iterator<Item = (Site, &Expression)> {
    model.phases.iter().flat_map(|phase| phase.model.expressions())
}

/// The rows of one phase, over the tests that have rows in that phase.
fn phase_rows<'a>(tests: &'a [PhasedTest], order: &[usize], at: usize) -> Vec<&'a Test> {
    let evidence = order.iter().filter_map(|&j| tests[j].phases.get(at));
    evidence.filter_map(|evidence| if let Evidence::Rows(rows) = evidence { Some(rows) } else { None }).collect()
}

/// Whether a parameter occurs, in some phase, at a site that `at` accepts.
fn occurs(model: &PhasedModel, parameter: usize, at: impl Fn(Site) -> bool) -> bool {
    expressions(model).any(|(site, expression)| at(site) && expression.mentions(parameter))
}

/// Whether a parameter occurs in the variance of a measurement's noise.
pub(super) fn measures(model: &PhasedModel, parameter: usize) -> bool {
    occurs(model, parameter, |site| matches!(site, Site::Noise(_)))
}

/// Whether a parameter occurs in the variance of the noise of some motion.
pub(super) fn drives(model: &PhasedModel, parameter: usize) -> bool {
    occurs(model, parameter, |site| matches!(site, Site::ProcessNoise(_)))
}

/// Whether the noise of a process with this time constant depends on no other free parameter.
pub(super) fn has_known_size(model: &PhasedModel, time_constant: usize, is_free: &dyn Fn(usize) -> bool) -> bool {
    let noises =
        expressions(model).filter(|(site, e)| matches!(site, Site::ProcessNoise(_)) && e.mentions(time_constant));
    let depends = |e: &Expression| e.parameters().into_iter().any(|other| other != time_constant && is_free(other));
    noises.into_iter().any(|(_, e)| !depends(e))
}

/// Whether a parameter occurs in variances only as a factor beside other parameters, which give their size.
pub(super) fn is_ratio(model: &PhasedModel, parameter: usize) -> bool {
    let is_variance = |site: &Site| matches!(site, Site::Noise(_) | Site::ProcessNoise(_));
    let mut uses = expressions(model).filter(|(site, e)| is_variance(site) && e.mentions(parameter)).peekable();
    uses.peek().is_some() && uses.all(|(_, e)| e.exponent(parameter).is_some() && e.parameters().len() > 1)
}

/// Whether a variance is a product e × e, as made from a standard deviation e.
fn is_square(variance: &Expression) -> bool {
    matches!(variance, Expression::Binary(Operator::Multiply, a, b) if a == b)
}

/// Root mean square of the differences of successive values within tests, over √2; where all differences are zero, the
/// standard deviation of all values; 1 where that is zero, too.
fn difference_size(tests: &[&Test], column: usize) -> f64 {
    let of_test = |test: &&Test| {
        let (mut sum, mut count, mut last) = (0.0, 0.0, f64::NAN);
        for row in 0..test.rows().min(ROWS_OF_A_TEST) {
            let value = test.numbers(row)[column];
            if !value.is_nan() {
                if !last.is_nan() {
                    sum += (value - last).powi(2);
                    count += 2.0;
                }
                last = value;
            }
        }
        (sum, count)
    };
    let parts: Vec<(f64, f64)> = tests.par_iter().with_min_len(MIN_TESTS).map(of_test).collect();
    let (sum, count) = parts.iter().fold((0.0, 0.0), |(sum, n), (part, more)| (sum + part, n + more));
    let size: f64 = if sum > 0.0 { f64::sqrt(sum / count) } else { standard_deviation(tests, column) };
    if size > 0.0 && size.is_finite() { size } else { 1.0 }
}

/// Standard deviation of the values of a column over all tests.
fn standard_deviation(tests: &[&Test], column: usize) -> f64 {
    let rows = tests.iter().flat_map(|test| (0..test.rows().min(ROWS_OF_A_TEST)).map(|row| test.numbers(row)[column]));
    let values: Vec<f64> = rows.filter(|x| !x.is_nan()).collect();
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    (values.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / count).sqrt()
}

/// Root mean square of the values of a column.
fn size(tests: &[&Test], column: usize) -> f64 {
    let rows = tests.iter().flat_map(|test| (0..test.rows().min(ROWS_OF_A_TEST)).map(|row| test.numbers(row)[column]));
    let (sum, count) = rows.filter(|x| !x.is_nan()).fold((0.0, 0.0), |(sum, n), x| (sum + x * x, n + 1.0));
    if count > 0.0 { f64::sqrt(sum / count) } else { 0.0 }
}

fn median(mut list: Vec<f64>) -> Option<f64> {
    list.sort_by(f64::total_cmp);
    list.get(list.len() / 2).copied()
}

/// Indices of the positive parameters that the coefficients of a motion depend on.
pub(crate) fn time_constants(model: &PhasedModel) -> Vec<usize> {
    let rates = expressions(model).filter(|(site, _)| matches!(site, Site::Rate { .. }));
    let used: BTreeSet<usize> = rates.flat_map(|(_, rate)| rate.parameters()).collect();
    used.into_iter().filter(|&p| model.shared().parameters[p].positive).collect()
}
