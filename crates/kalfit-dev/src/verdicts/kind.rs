//! Kinds of models of which correct ensembles are drawn, each with a random design.

use kalfit::model::Column;
use kalfit::simulate::{Designs, Simulator};
use kalfit::{Alpha, Evidence, Labels, PhasedModel, PhasedTest, Population, Source, Test};
use kalfit_spec::Spec;
use nalgebra::DMatrix;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// Share of measured values that are missing where a kind has gaps.
const GAPS: f64 = 0.15;
/// Units of one site.
const UNITS_OF_A_SITE: usize = 4;

/// A model, a population and ranges of which a design is drawn. Columns are known by their names: `t` increases from row
/// to row, `x` is uniform, `ramp` runs from -1 to 1 along each test, `se` is a known standard deviation, `age` belongs to
/// the test, `y` and `z` are measured.
#[derive(Debug, Clone, Copy)]
pub(super) struct Kind {
    pub(super) name: &'static str,
    /// The model with its parameters at the truth, each on a line of its own after `[parameters]`.
    text: &'static str,
    mean: &'static [f64],
    coefficients: &'static [f64],
    /// Standard deviations of the states of all phases, of the tests first, then of each level, the innermost first.
    std_dev: &'static [&'static [f64]],
    /// Least and largest number of units; 1 without levels.
    units: [usize; 2],
    /// Least and largest number of tests of a unit.
    tests: [usize; 2],
    /// Least and largest number of rows of a phase.
    rows: [usize; 2],
    /// Whether all tests have the same times.
    shared_times: bool,
    gaps: bool,
}

const PLAIN: Kind = Kind {
    name: "",
    text: "",
    mean: &[],
    coefficients: &[],
    std_dev: &[],
    units: [1, 1],
    tests: [10, 60],
    rows: [5, 20],
    shared_times: false,
    gaps: false,
};

const LINES: &str = r#"
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
sigma = 0.5
"#;

const UNITS: &str = r#"
[data]
test = "test"
levels = ["unit"]
[states]
level = {}
slope = {}
[measurements.y]
column = "y"
equation = "level + slope * ramp"
noise = "sigma"
[parameters]
sigma = 0.5
"#;

/// Gyros on a rate table, with times that all tests share.
pub(super) const GYROS: Kind = Kind {
    name: "gyros on a rate table, common times",
    text: r#"
[data]
test = "test"
time = "t"
[states]
bias = {}
scale = {}
[measurements.y]
column = "y"
equation = "bias + scale * x"
noise = "sigma"
[parameters]
sigma = 0.3
"#,
    mean: &[0.5, 10.0],
    std_dev: &[&[1.0, 1.0]],
    tests: [8, 40],
    rows: [12, 60],
    shared_times: true,
    ..PLAIN
};

/// All kinds.
pub(super) const KINDS: [Kind; 15] = [
    GYROS,
    Kind { name: "lines", text: LINES, mean: &[1.0, 2.0], std_dev: &[&[1.0, 0.5]], rows: [3, 40], ..PLAIN },
    Kind {
        name: "lines, five to nine tests",
        text: LINES,
        mean: &[1.0, 2.0],
        std_dev: &[&[1.0, 0.5]],
        tests: [5, 9],
        rows: [8, 12],
        ..PLAIN
    },
    Kind {
        name: "levels of tests of two to six rows",
        text: r#"
[data]
test = "test"
[states]
level = {}
[measurements.y]
column = "y"
equation = "level"
noise = "sigma"
[parameters]
sigma = 1
"#,
        mean: &[3.0],
        std_dev: &[&[0.7]],
        rows: [2, 6],
        ..PLAIN
    },
    Kind {
        name: "cubics, independent states",
        text: r#"
[data]
test = "test"
[states]
a = {}
b = {}
c = {}
d = {}
[measurements.y]
column = "y"
equation = "a + b * ramp + c * (2 * ramp^2 - 1) + d * (4 * ramp^3 - 3 * ramp)"
noise = "sigma"
[covariance]
structure = "diagonal"
[parameters]
sigma = 0.3
"#,
        mean: &[1.0, 0.0, 0.0, 0.0],
        std_dev: &[&[1.0, 1.0, 1.0, 1.0]],
        rows: [8, 16],
        ..PLAIN
    },
    Kind {
        name: "studies with known errors",
        text: r#"
[data]
test = "test"
[states]
effect = {}
[measurements.y]
column = "y"
equation = "effect"
noise = "se"
[parameters]
"#,
        mean: &[0.4],
        std_dev: &[&[0.5]],
        rows: [1, 1],
        ..PLAIN
    },
    Kind {
        name: "a mean that depends on age",
        text: r#"
[data]
test = "test"
[states]
level = {}
slope = {}
[mean.regression]
level = ["age"]
[measurements.y]
column = "y"
equation = "level + slope * ramp"
noise = "sigma"
[parameters]
sigma = 0.5
"#,
        mean: &[1.0, 2.0],
        coefficients: &[0.8],
        std_dev: &[&[1.0, 0.5]],
        ..PLAIN
    },
    Kind {
        name: "a drift with a time constant",
        text: r#"
[data]
test = "test"
time = "t"
[states]
level = {}
drift = { process = "gauss-markov", time_constant = "tau", sigma = "size" }
[measurements.y]
column = "y"
equation = "level + drift"
noise = "sigma"
[parameters]
tau = 4
size = 1
sigma = 0.4
"#,
        mean: &[1.0],
        std_dev: &[&[2.0]],
        tests: [8, 25],
        rows: [20, 60],
        ..PLAIN
    },
    Kind {
        name: "a random walk",
        text: r#"
[data]
test = "test"
time = "t"
[states]
level = { process = "random-walk", noise_density = "q" }
[measurements.y]
column = "y"
equation = "level"
noise = "sigma"
[parameters]
q = 0.5
sigma = 0.5
"#,
        mean: &[1.0],
        std_dev: &[&[2.0]],
        rows: [10, 30],
        ..PLAIN
    },
    Kind {
        name: "a recursion from row to row",
        text: r#"
[data]
test = "test"
[states]
deviation = { next = "rho * deviation", step_noise = "q", initial = { mean = 0, sigma = 1 } }
level = {}
[measurements.y]
column = "y"
equation = "level + deviation"
noise = 0.3
[parameters]
rho = 0.6
q = 0.8
"#,
        mean: &[1.0],
        std_dev: &[&[2.0]],
        rows: [15, 40],
        ..PLAIN
    },
    Kind {
        name: "two instruments with gaps",
        text: r#"
[data]
test = "test"
[states]
level = {}
slope = {}
[measurements.y]
column = "y"
equation = "level + slope * ramp"
noise = "sigma"
[measurements.z]
column = "z"
equation = "level"
noise = "fine"
[parameters]
sigma = 0.5
fine = 0.2
"#,
        mean: &[1.0, 2.0],
        std_dev: &[&[1.0, 0.5]],
        gaps: true,
        ..PLAIN
    },
    Kind {
        name: "units of three tests",
        text: UNITS,
        mean: &[1.0, 2.0],
        std_dev: &[&[0.5, 0.3], &[1.0, 0.5]],
        units: [8, 24],
        tests: [3, 3],
        rows: [6, 12],
        ..PLAIN
    },
    Kind {
        name: "units of one to twelve tests",
        text: UNITS,
        mean: &[1.0, 2.0],
        std_dev: &[&[0.5, 0.3], &[1.0, 0.5]],
        units: [6, 15],
        tests: [1, 12],
        rows: [4, 12],
        ..PLAIN
    },
    Kind {
        name: "sites of four units of tests",
        text: r#"
[data]
test = "test"
levels = ["site", "unit"]
[states]
level = {}
[measurements.y]
column = "y"
equation = "level"
noise = "sigma"
[parameters]
sigma = 0.5
"#,
        mean: &[1.0],
        std_dev: &[&[0.4], &[0.6], &[1.0]],
        units: [20, 40],
        tests: [1, 4],
        rows: [3, 8],
        ..PLAIN
    },
    Kind {
        name: "two phases",
        text: r#"
[data]
test = "test"
phase = "phase"
[states]
level = {}
slope = {}
[phases.first.measurements.y]
column = "y"
equation = "level + slope * ramp"
noise = "sigma"
[phases.second.carry]
level = "level"
slope = "slope"
[phases.second.measurements.z]
column = "z"
equation = "level + slope * ramp"
noise = "fine"
[parameters]
sigma = 0.5
fine = 0.3
"#,
        mean: &[1.0, 2.0, 0.3, 0.0],
        std_dev: &[&[1.0, 0.5, 0.4, 0.3]],
        rows: [5, 12],
        ..PLAIN
    },
];

/// A test as cells.
#[derive(Debug, Clone)]
pub(super) struct DrawnTest {
    pub(super) id: String,
    /// Rows of each phase.
    pub(super) phases: Vec<Vec<Vec<f64>>>,
    texts: Vec<kalfit::Label>,
}

/// An ensemble that was drawn from its model.
#[derive(Debug, Clone)]
pub(super) struct DrawnEnsemble {
    /// The model with its parameters free.
    pub(super) model: PhasedModel,
    pub(super) labels: Labels,
    pub(super) tests: Vec<DrawnTest>,
}

impl Kind {
    /// Draws a design and an ensemble.
    pub(super) fn draw(&self, random: &mut ChaCha8Rng) -> Result<DrawnEnsemble, String> {
        let (known, free) = (self.model(false)?, self.model(true)?);
        let mut labels = Labels::new(&known.shared().literals);
        let mut tests = self.design(&known, &mut labels, random);
        let alpha = Alpha::fixed(&known.shared().parameters).map_err(|error| error.to_string())?;
        let designs: Vec<PhasedTest> = tests.iter().map(DrawnTest::rows).collect();
        let designs = Designs::of(&known, designs).map_err(|error| error.to_string())?;
        let simulator = Simulator::new(&known, &alpha, self.population(), random.random::<u64>() >> 1);
        let simulator = simulator.map_err(|error| error.to_string())?;
        let drawn = simulator.draw(&designs, 0..tests.len() as u64).map_err(|error| error.to_string())?;
        for (test, drawn) in tests.iter_mut().zip(drawn) {
            for (cells, evidence) in test.phases.iter_mut().zip(&drawn.test.phases) {
                let Evidence::Rows(rows) = evidence else { continue };
                *cells = (0..rows.rows()).map(|row| rows.numbers(row).to_vec()).collect();
            }
        }
        Ok(DrawnEnsemble { model: free, labels, tests })
    }

    /// The model with its parameters free, or at the truth.
    pub(super) fn model(&self, is_free: bool) -> Result<PhasedModel, String> {
        let (head, parameters) = self.text.split_once("[parameters]\n").unwrap_or((self.text, ""));
        let free = |line: &str| match line.split_once(" = ") {
            Some((name, _)) if is_free => format!("{name} = {{}}\n"),
            _ => format!("{line}\n"),
        };
        let text = format!("{head}[parameters]\n{}", parameters.lines().map(free).collect::<String>());
        Ok(Spec::parse(self.name, &text).map_err(|error| format!("{}: {}", self.name, error.message))?.model)
    }

    fn population(&self) -> Population {
        let std_dev = self.std_dev.concat();
        let p = std_dev.len();
        let covariance = DMatrix::from_fn(p, p, |i, k| if i == k { std_dev[i] * std_dev[i] } else { 0.0 });
        let mean = [self.mean, &vec![0.0; p - self.mean.len()]].concat();
        Population { mean, coefficients: self.coefficients.to_vec(), covariance }
    }

    fn design(&self, model: &PhasedModel, labels: &mut Labels, random: &mut ChaCha8Rng) -> Vec<DrawnTest> {
        let [least, most] = self.rows;
        let mut within = |[least, most]: [usize; 2]| random.random_range(least..=most);
        let tests_of_unit: Vec<usize> = (0..within(self.units)).map(|_| within(self.tests)).collect();
        let ends = tests_of_unit.iter().enumerate().flat_map(|(unit, tests)| (0..*tests).map(move |test| (unit, test)));
        let mut all = Vec::new();
        for (unit, test) in ends {
            let text = |column: &Column| match column.name.as_str() {
                "site" => format!("s{}", unit / UNITS_OF_A_SITE),
                _ => format!("u{unit}"),
            };
            let texts = model.shared().text_columns.iter().map(|name| labels.intern(&text(name))).collect();
            let phase = |_| {
                let rows = random.random_range(least..=most);
                self.cells(model, rows, random)
            };
            let phases = (0..model.phases.len()).map(phase).collect();
            all.push(DrawnTest { id: format!("u{unit:02}-{test:02}"), phases, texts });
        }
        all
    }

    fn cells(&self, model: &PhasedModel, rows: usize, random: &mut ChaCha8Rng) -> Vec<Vec<f64>> {
        let age: f64 = StandardNormal.sample(random);
        let mut time = 0.0;
        let mut row = |k: usize| {
            time += if self.shared_times { 0.25 } else { random.random_range(0.2..1.5) };
            let mut cell = |name: &str| match name {
                "t" => time,
                "x" => random.random_range(-1.0..1.0),
                "ramp" => 2.0 * (k as f64 + 0.5) / rows as f64 - 1.0,
                "se" => random.random_range(0.2..1.0),
                "age" => age,
                _ if self.gaps && random.random_bool(GAPS) => f64::NAN,
                _ => 0.0,
            };
            model.shared().columns.iter().map(|column| cell(&column.name)).collect()
        };
        (0..rows).map(&mut row).collect()
    }
}

impl DrawnTest {
    fn rows(&self) -> PhasedTest {
        let phase = |cells: &Vec<Vec<f64>>| {
            let width = cells.first().map_or(0, Vec::len);
            let mut rows = Test::new(self.id.as_str(), width, self.texts.len());
            cells.iter().for_each(|row| rows.push(row, &self.texts, Source::default()));
            Evidence::Rows(rows)
        };
        PhasedTest { id: self.id.as_str().into(), phases: self.phases.iter().map(phase).collect() }
    }
}

impl DrawnEnsemble {
    /// The tests as they are read.
    pub(super) fn tests(&self) -> Vec<PhasedTest> {
        self.tests.iter().map(DrawnTest::rows).collect()
    }

    /// Index of a column.
    pub(super) fn column(&self, name: &str) -> Option<usize> {
        self.model.shared().columns.iter().position(|column| column.name == name)
    }
}
