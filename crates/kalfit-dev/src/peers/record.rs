//! The log-likelihood of one long record at irregular times: a Gauss-Markov process seen through noise, both known.

use std::fmt::Write as _;
use std::hint::black_box;
use std::path::{Path, PathBuf};

use kalfit::model::Alpha;
use kalfit::reduce::Reducer;
use kalfit::{Model, Source, Test};
use kalfit_spec::Spec;
use rand::RngExt;
use rand_distr::StandardNormal;

use super::agreement::KalfitAnswer;
use super::clock::{self, TimeTaken};
use super::ensemble;
use crate::seed::random;

/// Rows of the record.
pub(super) const ROWS: usize = 100_000;

/// Standard deviation 0.5 and time constant 3 of the process, noise 0.1: the peer's script has the same numbers.
const MODEL: &str = r#"
[data]
time = "t"
[states.drift]
process = "gauss-markov"
time_constant = 3
sigma = 0.5
[measurements.y]
column = "y"
equation = "drift"
noise = 0.1
"#;

/// Times and measured values.
#[derive(Debug)]
pub(super) struct DrawnRecord {
    rows: Vec<[f64; 2]>,
}

impl DrawnRecord {
    pub(super) fn draw() -> DrawnRecord {
        let mut rng = random();
        let (mut time, mut drift) = (0.0, 0.0);
        let row = || {
            let step: f64 = rng.random_range(0.05..0.3);
            let [w, v]: [f64; 2] = [(); 2].map(|()| rng.sample(StandardNormal));
            let kept = (-step / 3.0).exp();
            (time, drift) = (time + step, kept * drift + 0.5 * (1.0 - kept * kept).sqrt() * w);
            [time, drift + 0.1 * v]
        };
        DrawnRecord { rows: std::iter::repeat_with(row).take(ROWS).collect() }
    }

    /// Writes the record as the peer reads it.
    pub(super) fn write(&self, folder: &Path) -> Result<PathBuf, String> {
        let mut text = "t,y\n".to_owned();
        for [t, y] in &self.rows {
            writeln!(text, "{t},{y}").expect("a string takes all");
        }
        let file = folder.join("record.csv");
        ensemble::write(&file, &text)?;
        Ok(file)
    }

    /// The test with its cells where the model has them.
    fn test(&self, model: &Model) -> Test {
        let columns = &model.columns;
        let mut test = Test::new("record", columns.len(), 0);
        for [t, y] in &self.rows {
            let cells: Vec<f64> = columns.iter().map(|column| if column.name == "t" { *t } else { *y }).collect();
            test.push(&cells, &[], Source::default());
        }
        test
    }

    /// kalfit's log-likelihood, and its time.
    pub(super) fn ours(&self) -> Result<(KalfitAnswer, TimeTaken), String> {
        let model = model()?;
        let test = self.test(&model);
        let log_likelihood = value(&model, &test)?;
        let taken = clock::repeated(|| {
            black_box(value(&model, &test).is_ok());
        })?;
        Ok((KalfitAnswer { log_likelihood, estimates: Vec::new() }, taken))
    }
}

fn model() -> Result<Model, String> {
    let spec = Spec::parse("record", MODEL).map_err(|error| error.to_string())?;
    Ok(spec.model.shared().clone())
}

fn value(model: &Model, test: &Test) -> Result<f64, String> {
    let reducer = Reducer::new(model, &Alpha::default()).map_err(|error| error.to_string())?;
    let reductions = reducer.reduce(std::slice::from_ref(test)).map_err(|error| error.to_string())?;
    Ok(reductions.get(0).constant)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_value_is_that_of_the_textbook_filter() {
        let record = DrawnRecord { rows: DrawnRecord::draw().rows[..50].to_vec() };
        let (mut mean, mut variance, mut last, mut expected) = (0.0, 0.25, 0.0, 0.0);
        for &[t, y] in &record.rows {
            let kept = (-(t - last) / 3.0).exp();
            (mean, variance, last) = (kept * mean, kept * kept * variance + 0.25 * (1.0 - kept * kept), t);
            let total: f64 = variance + 0.01;
            let innovation = y - mean;
            expected -= 0.5 * (innovation * innovation / total + (std::f64::consts::TAU * total).ln());
            mean += variance / total * innovation;
            variance -= variance * variance / total;
        }
        let model = model().unwrap();
        let found = value(&model, &record.test(&model)).unwrap();
        assert!((found - expected).abs() < 1e-8 * expected.abs(), "found {found}, expected {expected}");
    }
}
