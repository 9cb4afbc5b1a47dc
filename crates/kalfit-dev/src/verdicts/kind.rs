//! Kinds of models of which correct ensembles are drawn.

/// A model, a population and ranges of which a design is drawn. Columns are known by their names: `t` increases from row
/// to row, `x` is uniform, `ramp` runs from -1 to 1 along each test, `se` is a known standard deviation, `age` belongs to
/// the test, `y` and `z` are measured.
#[derive(Debug, Clone, Copy)]
pub(super) struct Kind {
    pub(super) name: &'static str,
    /// The model with its parameters at the truth, each on a line of its own after `[parameters]`.
    pub(super) text: &'static str,
    pub(super) mean: &'static [f64],
    pub(super) coefficients: &'static [f64],
    /// Standard deviations of the states of all phases, of the tests first, then of each level, the innermost first.
    pub(super) std_dev: &'static [&'static [f64]],
    /// Least and largest number of units; 1 without levels.
    pub(super) units: [usize; 2],
    /// Least and largest number of tests of a unit.
    pub(super) tests: [usize; 2],
    /// Least and largest number of rows of a phase.
    pub(super) rows: [usize; 2],
    /// Whether all tests have the same times.
    pub(super) shared_times: bool,
    pub(super) gaps: bool,
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
