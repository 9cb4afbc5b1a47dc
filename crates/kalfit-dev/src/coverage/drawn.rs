//! Ensembles of a model, a design and a population, and fits of them.

use kalfit::estimate::{self, Criterion};
use kalfit::infer::{Choices, DeletionChoice, TestsChoice};
use kalfit::{Alpha, Ensemble, FitRecord, Labels, Options, PhasedTest, Population, Source, Test};
use kalfit_spec::Spec;
use nalgebra::DMatrix;

/// A model, a design and a population.
#[derive(Clone, Copy)]
pub(super) struct Drawn {
    /// With its parameters at the truth; those named in `free` are free in fits.
    pub(super) model: &'static str,
    pub(super) free: &'static str,
    pub(super) units: usize,
    pub(super) tests: usize,
    /// Values of `x`, one a row.
    pub(super) rows: &'static [f64],
    pub(super) mean: &'static [f64],
    /// Standard deviations of each level, the tests' own first; states are independent.
    pub(super) std_dev: &'static [&'static [f64]],
    pub(super) restricted: bool,
}

pub(super) const CONSTANT: &str = r#"
[data]
test = "test"
time = "x"
[states]
level = {}
[measurements.y]
column = "y"
equation = "level"
noise = "sigma"
[parameters]
sigma = 0.01
"#;

pub(super) const NOISY: &str = r#"
[data]
test = "test"
time = "x"
[states]
level = {}
[measurements.y]
column = "y"
equation = "level"
noise = "sigma"
[parameters]
sigma = 3.4641
"#;

pub(super) const LINE: &str = r#"
[data]
test = "test"
[states]
level = {}
slope = {}
[measurements.y]
column = "y"
equation = "level + slope * x"
noise = "sigma"
[parameters]
sigma = 20
"#;

pub(super) const WALK: &str = r#"
[data]
test = "test"
time = "x"
initial_time = 0
[states]
level = {}
walk = { process = "random-walk", noise_density = "q", initial = { mean = 0, sigma = 0 } }
[measurements.y]
column = "y"
equation = "level + walk"
noise = "sigma"
[parameters]
q = 1
sigma = 0.5
"#;

pub(super) const UNITS: &str = r#"
[data]
test = "test"
levels = ["unit"]
[states]
level = {}
[measurements.y]
column = "y"
equation = "level"
noise = "sigma"
[parameters]
sigma = 20
"#;

impl Drawn {
    pub(super) fn spec(&self, is_free: bool) -> Spec {
        let free = |line: &str| {
            let name = line.split(" = ").next().unwrap_or_default();
            if is_free && self.free.split(' ').any(|free| free == name) {
                format!("{name} = {{}}")
            } else {
                line.to_owned()
            }
        };
        let (head, parameters) = self.model.split_once("[parameters]\n").expect("every set-up has parameters");
        let parameters: Vec<String> = parameters.lines().map(free).collect();
        Spec::parse("set-up", &format!("{head}[parameters]\n{}\n", parameters.join("\n"))).expect("a set-up is sound")
    }

    pub(super) fn population(&self) -> Population {
        let p = self.mean.len();
        let all = self.std_dev.concat();
        let covariance = DMatrix::from_fn(all.len(), all.len(), |i, k| if i == k { all[i] * all[i] } else { 0.0 });
        let mean = [self.mean, &vec![0.0; all.len() - p]].concat();
        Population { mean, coefficients: Vec::new(), covariance }
    }

    pub(super) fn design(&self, spec: &Spec) -> Ensemble {
        let shared = spec.model.shared();
        let mut labels = Labels::new(&shared.literals);
        let mut tests = Vec::new();
        for unit in 0..self.units {
            let name = labels.intern(&format!("u{unit}"));
            for test in 0..self.tests {
                let texts = vec![name; shared.text_columns.len()];
                tests.push(rows(spec, &format!("u{unit}/{test}"), self.rows, &texts));
            }
        }
        Ensemble::of_tests(&spec.model, labels, tests)
    }

    pub(super) fn fit(&self, free: &Spec, drawn: &Ensemble) -> FitRecord {
        let choices = Choices { deletion: DeletionChoice::None, tests: TestsChoice::None, ..Choices::default() };
        let mut options = Options { choices, innovations: false, ..Options::default() };
        if self.restricted {
            options.settings.criterion = Criterion::Reml;
        }
        let ensemble = Ensemble::of_tests(&free.model, drawn.labels().clone(), drawn.tests().to_vec());
        ensemble.fit_with(&options, &mut estimate::Silent).expect("a legal problem").record
    }
}

/// A test with a zero for every value that is drawn.
pub(super) fn rows(spec: &Spec, id: &str, x: &[f64], texts: &[kalfit::Label]) -> PhasedTest {
    let shared = spec.model.shared();
    let mut rows = Test::new(id.to_owned(), shared.columns.len(), shared.text_columns.len());
    for &x in x {
        let cells: Vec<f64> = shared.columns.iter().map(|column| if column.name == "x" { x } else { 0.0 }).collect();
        rows.push(&cells, texts, Source::default());
    }
    rows.into()
}

/// The parameters of a fit.
pub(super) fn values(known: &Spec, record: &FitRecord) -> Alpha {
    let mut spec = known.clone();
    for parameter in &record.parameters {
        spec.set(&format!("{}={}", parameter.name, parameter.estimate)).expect("it is a parameter");
    }
    Alpha::fixed(&spec.model.shared().parameters).expect("all are known")
}
