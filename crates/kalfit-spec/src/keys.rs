//! The keys of a model file: the parser accepts these and no other, and the JSON Schema for editors is made from them.

/// A key of a table.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Key {
    pub(crate) name: &'static str,
    pub(crate) takes: Takes,
    /// What it says, in one sentence.
    pub(crate) text: &'static str,
}

/// The kind of value that a key has.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Takes {
    Text,
    Number,
    Truth,
    /// A number, or a text in the expression language.
    Expression,
    /// A number, or the name of a column.
    NumberOrColumn,
    /// One of some words.
    Word(&'static [&'static str]),
    Texts,
    /// Lists of lists of texts.
    TextLists,
    /// A table of numbers by name.
    Numbers,
    /// A table of expressions by name.
    Expressions,
    /// A table of lists of texts by name.
    TextsByName,
    /// A table of texts by name.
    TextByName,
    /// A matrix of expressions.
    Matrix,
    /// A matrix of numbers.
    NumberMatrix,
    /// The start of a state: a word, or its mean and standard deviation.
    Start,
    /// A table with these keys.
    Table(&'static [Key]),
    /// A table of tables with these keys, by names that the user gives.
    Tables(&'static [Key]),
    /// A table of parameters: numbers, or tables with these keys.
    Parameters(&'static [Key]),
}

const fn key(name: &'static str, takes: Takes, text: &'static str) -> Key {
    Key { name, takes, text }
}

/// Of the file.
pub(crate) const ROOT: &[Key] = &[
    key("title", Takes::Text, "Title of the model, printed above its results."),
    key("data", Takes::Table(DATA), "How rows form tests and steps."),
    key("states", Takes::Tables(STATE), "The states x, by name, and how they move."),
    key(
        "process_noise_covariance",
        Takes::Expressions,
        "Covariances between the noises of two states, as in `\"a, b\" = \"q\"`.",
    ),
    key("measurements", Takes::Tables(MEASUREMENT), "What is measured, by name: z = h'x + d + noise."),
    key(
        "noise_covariance",
        Takes::Expressions,
        "Covariances between the noises of two measurements of one step, as in `\"y1, y2\" = 0.002`.",
    ),
    key(
        "parameters",
        Takes::Parameters(PARAMETER),
        "Dynamic parameters: a number is fixed, a table without `value` is free.",
    ),
    key("mean", Takes::Table(MEAN), "Constraints on the mean μ of the initial state, and its regressions."),
    key(
        "covariance",
        Takes::Table(COVARIANCE_IN_GROUPS),
        "Structure and constraints of Σ, the covariance from test to test.",
    ),
    key("levels", Takes::Tables(LEVEL), "The covariance from group to group, by the column of `levels` in `[data]`."),
    key(
        "crossed",
        Takes::Tables(FACTOR),
        "The covariance of the effects of a crossed factor, by the column of `crossed` in `[data]`, and its slots.",
    ),
    key(
        "phases",
        Takes::Tables(PHASE),
        "Phases of a test, in their order; each takes what it has not from the top level.",
    ),
    key("filter", Takes::Table(FILTER), "The suboptimal filter that processed the measurements."),
];

/// Of `[data]`.
pub(crate) const DATA: &[Key] = &[
    key(
        "test",
        Takes::Text,
        "Column that names the test of a row, or `@file`: each file is one test, or `@row`: each row is one.",
    ),
    key("levels", Takes::Texts, "Columns of groups of tests, the outermost first."),
    key("crossed", Takes::Texts, "Columns of factors that cross: stations, days or operators that any test can meet."),
    key("time", Takes::Text, "Column of times."),
    key("time_unit", Takes::Text, "Unit of time: a label, or with dates one of s, ms, us, ns, min, h, d."),
    key("initial_time", Takes::NumberOrColumn, "Time of the initial state, or a column with it."),
    key("step_first", Takes::Truth, "Whether a transition precedes the first row, in models with `next`."),
    key("inputs", Takes::Word(&["current", "previous"]), "Whose row's inputs a step uses."),
    key("group", Takes::Text, "Column by whose texts results are compared."),
    key("missing", Takes::Texts, "Texts that stand for missing values, besides empty cells."),
    key("comment", Takes::Text, "What lines of comments begin with."),
    key("phase", Takes::Text, "Column that names the phase of a row."),
];

/// Of a state.
pub(crate) const STATE: &[Key] = &[
    key("unit", Takes::Text, "Unit, a label."),
    key(
        "process",
        Takes::Word(&["constant", "random-walk", "gauss-markov", "gauss-markov-2", "integral"]),
        "Kind of process.",
    ),
    key("time_constant", Takes::Expression, "Time constant of a Gauss-Markov process."),
    key("sigma", Takes::Expression, "Stationary standard deviation of a Gauss-Markov process."),
    key("noise_density", Takes::Expression, "Square root of the spectral density of the driving noise."),
    key("step_noise", Takes::Expression, "Standard deviation of the noise of a step."),
    key("derivative", Takes::Expression, "dx/dt, linear in the states."),
    key("next", Takes::Expression, "x of the next row, linear in the states."),
    key("of", Takes::Expression, "What an integral is the integral of."),
    key("initial", Takes::Start, "Law of the state at the start of a test."),
    key("offset", Takes::Expression, "Known part of the initial state, constant within a test."),
    key("random", Takes::Truth, "Whether the state differs from test to test."),
];

/// Of the start of a state that is given.
pub(crate) const START: &[Key] = &[
    key("mean", Takes::Expression, "Mean of the initial state."),
    key("sigma", Takes::Expression, "Standard deviation of the initial state."),
];

/// Of a measurement.
pub(crate) const MEASUREMENT: &[Key] = &[
    key("column", Takes::Text, "Column of the measured values."),
    key("where", Takes::Text, "Condition on the rows that it is read from."),
    key("equation", Takes::Expression, "What is measured, linear in the states."),
    key("noise", Takes::Expression, "Standard deviation of the noise."),
    key("variance", Takes::Expression, "Variance of the noise, instead of `noise`."),
];

/// Of a parameter.
pub(crate) const PARAMETER: &[Key] = &[
    key("value", Takes::Number, "Its value; the parameter is then fixed."),
    key("start", Takes::Number, "Where the search starts."),
    key("unit", Takes::Text, "Unit, a label."),
    key("lower", Takes::Number, "Lower bound."),
    key("upper", Takes::Number, "Upper bound."),
    key("per", Takes::Text, "Column by whose texts it has values of their own."),
    key("fixed", Takes::Numbers, "Values at some of these texts."),
];

/// Of `[mean]`.
pub(crate) const MEAN: &[Key] = &[
    key("fixed", Takes::Numbers, "Means that are given, by state."),
    key("start", Takes::Numbers, "Where the search starts, by state."),
    key("tied", Takes::Expressions, "Means that are combinations of others, by state."),
    key("proportional_to", Takes::Numbers, "Weights of means that share one factor, by state."),
    key(
        "regression",
        Takes::TextsByName,
        "Columns, each constant within a test, that a mean is regressed on, by state.",
    ),
];

/// Of `[covariance]` where tests are in no groups.
pub(crate) const COVARIANCE: &[Key] = &[STRUCTURE, ORDER, BLOCKS, MATRIX, FIXED, EQUAL, KNOWN, START_MATRIX];
/// The same where tests stand in groups: what varies from test to test can be less than what varies at all.
pub(crate) const COVARIANCE_IN_GROUPS: &[Key] =
    &[STRUCTURE, ORDER, BLOCKS, MATRIX, FIXED, EQUAL, KNOWN, START_MATRIX, VARYING];
/// Of the covariance of a level of groups.
pub(crate) const COVARIANCE_OF_LEVEL: &[Key] = &[STRUCTURE, BLOCKS, MATRIX, FIXED, EQUAL, START_MATRIX, VARYING];

/// Structures of a covariance.
pub(crate) const STRUCTURES: [&str; 6] = ["full", "diagonal", "blocks", "proportional", "correlation", "fixed"];

const STRUCTURE: Key = key("structure", Takes::Word(&STRUCTURES), "Structure of the matrix.");
const ORDER: Key = key("order", Takes::Texts, "Order of all estimated states, in matrices and results.");
const BLOCKS: Key = key("blocks", Takes::TextLists, "Lists of states that are correlated among each other only.");
const MATRIX: Key =
    key("matrix", Takes::Matrix, "The matrix that Σ is, is proportional to, or has the correlations of.");
const FIXED: Key = key("fixed", Takes::Numbers, "Elements that are given, as in `\"a, b\" = 0`.");
const EQUAL: Key = key("equal", Takes::TextLists, "Lists of elements that are equal, as in `[[\"a, a\", \"b, b\"]]`.");
const KNOWN: Key = key("known", Takes::Matrix, "A known covariance that is added for each test.");
const START_MATRIX: Key = key("start", Takes::NumberMatrix, "Where the search starts.");
const VARYING: Key = key("states", Takes::Texts, "The states that differ within the groups; none for `[]`.");

/// Of a level of groups.
pub(crate) const LEVEL: &[Key] = &[BETWEEN_GROUPS];
const BETWEEN_GROUPS: Key =
    key("covariance", Takes::Table(COVARIANCE_OF_LEVEL), "Structure and constraints of the covariance between groups.");

/// Of a crossed factor.
pub(crate) const FACTOR: &[Key] = &[
    key(
        "as",
        Takes::TextByName,
        "Columns of the factor by slot, as in `{ A = \"serial_a\", B = \"serial_b\" }`, where a test has several members.",
    ),
    BETWEEN_GROUPS,
];

/// Of a suboptimal filter.
pub(crate) const FILTER: &[Key] = &[
    key("kind", Takes::Word(&["kalman-schmidt"]), "Kind of filter."),
    key("consider", Takes::Texts, "States whose uncertainty is considered and that are not estimated."),
    key("mean", Takes::Numbers, "Mean of the initial state that the filter takes, by state."),
    key("covariance", Takes::NumberMatrix, "Covariance of the initial state that the filter takes."),
    key("parameters", Takes::Numbers, "Values of parameters that the filter takes, by parameter."),
];

/// Tables that a phase has itself or takes from the top level.
pub(crate) fn phase_tables() -> impl Iterator<Item = &'static str> {
    ROOT.iter().map(|key| key.name).filter(|name| PHASE.iter().any(|own| own.name == *name))
}

/// Of a phase.
pub(crate) const PHASE: &[Key] = &[
    ROOT_STATES,
    key("process_noise_covariance", Takes::Expressions, "Covariances between the noises of two states."),
    key("measurements", Takes::Tables(MEASUREMENT), "What is measured in this phase, by name."),
    key("noise_covariance", Takes::Expressions, "Covariances between the noises of two measurements of one step."),
    key("mean", Takes::Table(MEAN), "Constraints on the mean of this phase's initial state."),
    key("covariance", Takes::Table(COVARIANCE_IN_GROUPS), "Structure and constraints of this phase's Σ."),
    key("filter", Takes::Table(FILTER), "The suboptimal filter that processed this phase."),
    key("carry", Takes::Expressions, "What the states start with, in the states at the end of the phase before."),
    key("initial_time", Takes::NumberOrColumn, "Time of the phase's initial state, or a column with it."),
    key("step_first", Takes::Truth, "Whether a transition precedes the first row of the phase."),
];
const ROOT_STATES: Key = key("states", Takes::Tables(STATE), "The states of this phase, by name, and how they move.");

/// Of an output.
pub(crate) const OUTPUT: &[Key] = &[
    key("equation", Takes::Expression, "The output, linear in the states."),
    key("unit", Takes::Text, "Unit, a label."),
    key("phase", Takes::Text, "Phase that it belongs to."),
];

/// The names of keys.
pub(crate) fn names(keys: &'static [Key]) -> Vec<&'static str> {
    keys.iter().map(|key| key.name).collect()
}
