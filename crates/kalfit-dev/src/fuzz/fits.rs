//! Whole small fits, whose log-likelihood is worked out once more from the dense law of all measurements of a test.

use std::fmt::Write;
use std::path::Path;

use kalfit::FitRecord;
use kalfit::infer::DeletionChoice;
use kalfit_data::Datum;
use kalfit_job::{Document, FitJob, ModelJob, Unwatched};
use nalgebra::{DMatrix, DVector};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// Names of the states, and what each is multiplied with in the only measurement.
const STATES: [(&str, &str); 3] = [("a", "1"), ("b", "x"), ("c", "z")];
/// Most passes of a fit: one that has not converged by then is compared as it is.
const PASSES: usize = 100;
/// What the two log-likelihoods may differ by, as a part of their size.
const EQUAL: f64 = 1e-9;
/// Nor may a step of the mean raise it by more, where the fit says that it is the largest.
const RISES: f64 = 1e-6;
/// A dense law that loses so much has no digit of the noise left.
const ALL_LOST: f64 = 1e9;
/// Eigenvalues of Σ are zero to this part of the largest.
const ROUNDING: f64 = 1e-12;

/// A model of one to three states, and rows of a few tests; now and then covariates that are all zero, or tests that are all alike.
pub(super) fn drawn(random: &mut ChaCha8Rng) -> (String, String) {
    let normal = |random: &mut ChaCha8Rng| -> f64 { StandardNormal.sample(random) };
    let (states, noise) = (random.random_range(1..4_usize), [1e-3, 0.3, 10.0][random.random_range(0..3_usize)]);
    let mut text = "[data]\ntest = \"id\"\n".to_owned();
    let terms: Vec<String> = STATES[..states].iter().map(|(name, by)| format!("{name} * {by}")).collect();
    STATES[..states].iter().for_each(|(name, _)| text += &format!("[states.{name}]\n"));
    text += &format!("[measurements.y]\ncolumn = \"y\"\nequation = \"{}\"\nnoise = {noise:?}\n", terms.join(" + "));
    let spread = [0.0, 1e-4, 1.0, 1e3][random.random_range(0..4_usize)];
    let (flat, alike) = (random.random_bool(0.1), random.random_bool(0.2));
    let mut rows = "id,x,z,y\n".to_owned();
    for test in 0..random.random_range(2..9_u32) {
        let own: Vec<f64> = (0..states).map(|_| 1.0 + spread * normal(random)).collect();
        for row in 0..random.random_range(1..5_u32) {
            let x = if flat {
                0.0
            } else if alike {
                f64::from(row)
            } else {
                normal(random)
            };
            let z = if alike { f64::from(row * row) } else { normal(random) };
            let y = [1.0, x, z].iter().zip(&own).map(|(x, a)| x * a).sum::<f64>() + noise * normal(random);
            let _ = writeln!(rows, "{test},{x:?},{z:?},{y:?}");
        }
    }
    (text, rows)
}

/// Whether the rows were fitted, and why the result cannot be right.
pub(super) fn compared(text: &str, data: &Path) -> Result<bool, String> {
    let Ok(record) = fit(model(text), data) else { return Ok(false) };
    let tests = tests(text, data)?;
    let phase = &record.phases[0];
    let (p, mean) = (phase.mean.estimate.len(), DVector::from_column_slice(&phase.mean.estimate));
    let sigma = DMatrix::from_fn(p, p, |i, k| phase.covariance.estimate[i][k]);
    let at = |mean: &DVector<f64>| -> Option<f64> { tests.iter().map(|test| test.log_density(mean, &sigma)).sum() };
    let lost = conditioned(&tests, &sigma);
    let found = record.log_likelihood;
    let Some(expected) = at(&mean) else {
        // its covariances have no factor where noise is beyond their digits, whatever Σ is
        let values = sigma.symmetric_eigenvalues();
        let sound = lost > ALL_LOST && values.min() >= -ROUNDING * values.max();
        return if sound { Ok(true) } else { Err("Σ is not positive semidefinite".to_owned()) };
    };
    let apart = (found - expected).abs();
    if apart.is_nan() || apart > EQUAL * (1.0 + expected.abs()) * lost {
        return Err(format!("the log-likelihood is {found}, that of the dense law {expected}"));
    }
    for i in (0..p).filter(|_| record.converged) {
        let step = phase.mean.std_error[i].unwrap_or(0.0) * 0.1;
        for step in [-step, step] {
            let mut moved = mean.clone();
            moved[i] += step;
            let risen = at(&moved).unwrap_or(f64::NEG_INFINITY) - expected;
            if risen > RISES * (1.0 + expected.abs()) {
                return Err(format!("a step of {step} in mean {i} raises {expected} by {risen}"));
            }
        }
    }
    Ok(true)
}

/// How much of the digits the dense law loses: its covariances are squares of what is well known.
fn conditioned(tests: &[FuzzedTest], sigma: &DMatrix<f64>) -> f64 {
    let largest = |test: &FuzzedTest| (&test.design * sigma * test.design.transpose()).amax() / test.variance;
    1.0 + 1e-5 * tests.iter().map(largest).fold(0.0, f64::max)
}

/// One test: y = design × state + noise.
struct FuzzedTest {
    design: DMatrix<f64>,
    y: DVector<f64>,
    variance: f64,
}

impl FuzzedTest {
    /// log N(y; Xμ, XΣX' + R).
    fn log_density(&self, mean: &DVector<f64>, sigma: &DMatrix<f64>) -> Option<f64> {
        let n = self.y.len();
        let covariance = &self.design * sigma * self.design.transpose() + DMatrix::identity(n, n) * self.variance;
        let factor = covariance.cholesky()?;
        let away = &self.y - &self.design * mean;
        let log_det: f64 = factor.l_dirty().diagonal().iter().map(|x| 2.0 * x.ln()).sum();
        Some(-0.5 * (n as f64 * std::f64::consts::TAU.ln() + log_det + away.dot(&factor.solve(&away))))
    }
}

/// The tests of a file that [`drawn`] made.
fn tests(text: &str, data: &Path) -> Result<Vec<FuzzedTest>, String> {
    let noise = text.rsplit("noise = ").next().and_then(|noise| noise.trim().parse::<f64>().ok());
    let noise = noise.ok_or("the model has a noise")?;
    let states = text.matches("[states.").count();
    let rows = std::fs::read_to_string(data).map_err(|error| error.to_string())?;
    let mut all: Vec<(String, Vec<[f64; 3]>)> = Vec::new();
    for line in rows.lines().skip(1) {
        let mut cells = line.split(',');
        let id = cells.next().unwrap_or_default().to_owned();
        let numbers: Vec<f64> = cells.filter_map(|cell| cell.parse().ok()).collect();
        let row: [f64; 3] = numbers.try_into().map_err(|_| format!("a row `{line}`"))?;
        match all.last_mut() {
            Some((last, rows)) if *last == id => rows.push(row),
            _ => all.push((id, vec![row])),
        }
    }
    let of = |(_, rows): (String, Vec<[f64; 3]>)| FuzzedTest {
        design: DMatrix::from_fn(rows.len(), states, |i, k| [1.0, rows[i][0], rows[i][1]][k]),
        y: DVector::from_iterator(rows.len(), rows.iter().map(|row| row[2])),
        variance: noise * noise,
    };
    Ok(all.into_iter().map(of).collect())
}

/// A model from a text.
pub(super) fn model(text: &str) -> ModelJob {
    let document = Document::Text { name: "m.toml".to_owned(), text: text.to_owned(), file: None };
    ModelJob { document, set: Vec::new() }
}

/// A fit of a model to a file.
fn fit(model: ModelJob, data: &Path) -> Result<FitRecord, String> {
    let mut job = FitJob::new(model, vec![Datum::Named(data.display().to_string())]);
    (job.innovations, job.settings.max_passes) = (false, PASSES);
    job.choices.deletion = DeletionChoice::None;
    kalfit_job::fit(&job, &mut Unwatched).map(|done| done.record).map_err(|failure| failure.to_string())
}
