//! Ensembles of a model, a design and a population, and fits of them.

use kalfit::estimate::{self, Criterion};
use kalfit::infer::{Choices, DeletionChoice, TestsChoice};
use kalfit::{Alpha, Ensemble, FitRecord, Labels, Options, PhasedModel, PhasedTest, Population, Source, Test};
use kalfit_spec::Spec;

use crate::setup;

/// A model, a design and a population.
#[derive(Clone, Copy)]
pub(super) struct DrawnSetup {
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

/// Levels that their tests determine all but exactly.
pub(super) const CONSTANT: DrawnSetup = DrawnSetup {
    model: r#"
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
"#,
    free: "",
    units: 1,
    tests: 5,
    rows: &[0.0, 1.0],
    mean: &[1.0],
    std_dev: &[&[1.0]],
    restricted: false,
};

/// Levels that their tests determine with an error as large as their spread.
pub(super) const NOISY: DrawnSetup = DrawnSetup {
    model: r#"
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
"#,
    free: "sigma",
    units: 1,
    tests: 30,
    rows: &[0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0],
    mean: &[1.0],
    std_dev: &[&[1.0]],
    restricted: false,
};

/// Random lines.
pub(super) const LINE: DrawnSetup = DrawnSetup {
    model: r#"
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
"#,
    free: "sigma",
    units: 1,
    tests: 18,
    rows: &[0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0],
    mean: &[250.0, 10.0],
    std_dev: &[&[24.0, 6.0]],
    restricted: false,
};

/// Random walks from a random level.
pub(super) const WALK: DrawnSetup = DrawnSetup {
    model: r#"
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
"#,
    free: "q sigma",
    units: 1,
    tests: 12,
    rows: &[
        1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0, 15.0, 16.0, 17.0, 18.0, 19.0, 20.0,
    ],
    mean: &[1.0],
    std_dev: &[&[4.0]],
    restricted: false,
};

/// Levels of units, and of their tests.
pub(super) const UNITS: DrawnSetup = DrawnSetup {
    model: r#"
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
"#,
    free: "sigma",
    units: 10,
    tests: 3,
    rows: &[0.0, 1.0, 2.0, 3.0],
    mean: &[250.0],
    std_dev: &[&[12.0], &[24.0]],
    restricted: false,
};

impl DrawnSetup {
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
        setup::independent(self.mean, &[], self.std_dev)
    }

    pub(super) fn design(&self, spec: &Spec) -> Ensemble {
        design(&spec.model, (self.units, self.tests), self.rows)
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

/// So many units of so many tests, with a zero for every value that is drawn.
pub(super) fn design(model: &PhasedModel, (units, tests): (usize, usize), x: &[f64]) -> Ensemble {
    let shared = model.shared();
    let mut labels = Labels::new(&shared.literals);
    let mut all = Vec::new();
    for unit in 0..units {
        let texts = vec![labels.intern(&format!("u{unit}")); shared.text_columns.len()];
        all.extend((0..tests).map(|test| rows(model, &format!("u{unit}/{test}"), x, &texts)));
    }
    Ensemble::of_tests(model, labels, all)
}

/// A test with a zero for every value that is drawn.
pub(super) fn rows(model: &PhasedModel, id: &str, x: &[f64], texts: &[kalfit::Label]) -> PhasedTest {
    let shared = model.shared();
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
