//! The total log-likelihood of a state-space ensemble at known parameters: the filter alone, in memory.

use std::fmt::Write as _;
use std::hint::black_box;
use std::path::{Path, PathBuf};

use kalfit::estimate::{Derivatives, Likelihood};
use kalfit::model::Alpha;
use kalfit::reduce::Reducer;
use kalfit::{Source, Test};
use nalgebra::DMatrix;
use rand::RngExt;
use rand_distr::StandardNormal;

use super::agreement::KalfitAnswer;
use super::clock::{self, TimeTaken};
use super::ensemble;
use crate::bench::bench_model;
use crate::seed::random;

/// Two random constants and a stationary drift.
const STATES: usize = 3;

/// Rows of a test.
pub(super) const ROWS: usize = 100;

/// An ensemble: rows of z and the inputs, test by test.
#[derive(Debug)]
pub(super) struct SpaceEnsemble {
    tests: Vec<Vec<[f64; STATES]>>,
}

impl SpaceEnsemble {
    /// Tests with inputs of their own, or all with those of the first.
    pub(super) fn draw(tests: usize, shared: bool) -> SpaceEnsemble {
        let mut rng = random();
        let mut test =
            || -> Vec<[f64; STATES]> { (0..ROWS).map(|_| [(); STATES].map(|()| rng.sample(StandardNormal))).collect() };
        let mut tests: Vec<Vec<[f64; STATES]>> = (0..tests).map(|_| test()).collect();
        if let (true, [first, others @ ..]) = (shared, &mut tests[..]) {
            for (row, model) in others.iter_mut().flat_map(|test| test.iter_mut().zip(first.iter())) {
                row[1..].copy_from_slice(&model[1..]);
            }
        }
        SpaceEnsemble { tests }
    }

    /// Writes the ensemble as the peers read it.
    pub(super) fn write(&self, folder: &Path) -> Result<PathBuf, String> {
        let mut text = "test,z,u1,u2\n".to_owned();
        for (j, test) in self.tests.iter().enumerate() {
            for [z, u1, u2] in test {
                writeln!(text, "{j},{z},{u1},{u2}").expect("a string takes all");
            }
        }
        let file = folder.join("space.csv");
        ensemble::write(&file, &text)?;
        Ok(file)
    }

    fn tests(&self) -> Vec<Test> {
        let test = |(j, rows): (usize, &Vec<[f64; STATES]>)| {
            let mut test = Test::new(format!("{j:08}"), STATES, 0);
            for row in rows {
                test.push(row, &[], Source::default());
            }
            test
        };
        self.tests.iter().enumerate().map(test).collect()
    }

    /// kalfit's log-likelihood with a prior N(0, I) of the constants, and the time of the reduction and the value together.
    pub(super) fn ours(&self) -> Result<(KalfitAnswer, TimeTaken), String> {
        let (model, tests) = (bench_model(STATES), self.tests());
        let p = STATES - 1;
        let value = || {
            let reducer = Reducer::new(&model, &Alpha::default()).map_err(|error| error.to_string())?;
            let reductions = reducer.reduce(&tests).map_err(|error| error.to_string())?;
            let likelihood = Likelihood::new(&reductions, p);
            Ok::<f64, String>(likelihood.at(&vec![0.0; p], &DMatrix::identity(p, p), Derivatives::First).log_likelihood)
        };
        let log_likelihood = value()?;
        let taken = clock::repeated(|| {
            black_box(value().is_ok());
        })?;
        Ok((KalfitAnswer { log_likelihood, estimates: Vec::new() }, taken))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tests_share_their_inputs_when_asked_and_never_what_was_measured() {
        for shared in [false, true] {
            let space = SpaceEnsemble::draw(2, shared);
            let same = |k: usize| space.tests[0].iter().zip(&space.tests[1]).all(|(a, b)| a[k] == b[k]);
            assert_eq!([same(0), same(1), same(2)], [false, shared, shared]);
        }
    }

    #[test]
    fn the_value_is_that_of_another_filter() {
        // sum of the normal densities of the rows of one test, by the textbook's covariance filter
        let space = SpaceEnsemble::draw(1, false);
        let (mut mean, mut covariance) = (nalgebra::Vector3::zeros(), nalgebra::Matrix3::identity());
        let dynamics = nalgebra::Matrix3::from_diagonal(&nalgebra::Vector3::new(1.0, 1.0, 0.9));
        let noise = nalgebra::Matrix3::from_diagonal(&nalgebra::Vector3::new(0.0, 0.0, 0.19));
        let mut expected = 0.0;
        for [z, u1, u2] in &space.tests[0] {
            let h = nalgebra::RowVector3::new(*u1, *u2, 1.0);
            let variance = (h * covariance * h.transpose())[0] + 0.01;
            let innovation = z - (h * mean)[0];
            expected -= 0.5 * (innovation * innovation / variance + (std::f64::consts::TAU * variance).ln());
            let gain = covariance * h.transpose() / variance;
            mean = dynamics * (mean + gain * innovation);
            covariance = dynamics * (covariance - gain * h * covariance) * dynamics.transpose() + noise;
        }
        let (model, tests) = (bench_model(STATES), space.tests());
        let reductions = Reducer::new(&model, &Alpha::default()).unwrap().reduce(&tests).unwrap();
        let likelihood = Likelihood::new(&reductions, 2);
        let found = likelihood.at(&[0.0, 0.0], &DMatrix::identity(2, 2), Derivatives::First).log_likelihood;
        assert!((found - expected).abs() < 1e-8 * expected.abs(), "found {found}, expected {expected}");
    }
}
