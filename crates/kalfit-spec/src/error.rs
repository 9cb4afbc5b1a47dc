//! What can be wrong with a model file.

use std::ops::Range;

use crate::figure::figure;

/// Bytes `start..end` of the model file.
pub(crate) type Span = Range<usize>;

/// Longest message, in characters: a hostile name can be as long as the file.
const MAX_MESSAGE: usize = 1_000;

pub(crate) type Result<T> = std::result::Result<T, SpecError>;

/// What is wrong with a model file, where, and what may help.
///
/// `message` is one line without a final period; `span` is the place in the file (absent when the fault is not in the
/// text: an unreadable file, a bad `--set`), `label` says what is found there, `hint` what to write instead.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{message}")]
pub struct SpecError {
    /// The problem in one line.
    pub message: String,
    /// The problem in types.
    pub problem: Box<SpecProblem>,
    /// Bytes of the model file that it is about.
    pub span: Option<Range<usize>>,
    /// A few words to stand under the span.
    pub label: Option<String>,
    /// What to write instead.
    pub hint: Option<String>,
}

impl SpecError {
    pub(crate) fn new(problem: impl Into<SpecProblem>) -> SpecError {
        let problem = problem.into();
        let mut message = problem.to_string();
        if let Some((end, _)) = message.char_indices().nth(MAX_MESSAGE) {
            message.truncate(end);
            message.push('…');
        }
        SpecError { message, problem: Box::new(problem), span: None, label: None, hint: None }
    }

    pub(crate) fn at(mut self, span: Span) -> SpecError {
        self.span = Some(span);
        self
    }

    pub(crate) fn label(mut self, label: impl Into<String>) -> SpecError {
        self.label = Some(label.into());
        self
    }

    pub(crate) fn hint(mut self, hint: impl Into<String>) -> SpecError {
        self.hint = Some(hint.into());
        self
    }

    pub(crate) fn maybe_hint(mut self, hint: Option<String>) -> SpecError {
        self.hint = hint;
        self
    }
}

/// The kinds of problem. `place` is in words: "`[data]`", "state `drift`", "equation of measurement `gyro`".
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say what the fields are")]
pub enum SpecProblem {
    /// The file cannot be read.
    #[error("cannot read `{path}`: {reason}")]
    Unreadable { path: String, reason: String },
    /// The file is too large.
    #[error("the file has {found} bytes, expected at most {limit}")]
    TooLarge { found: u64, limit: u64 },
    /// The file is not text.
    #[error("the file is not UTF-8 text: byte {offset} is not part of a character")]
    NotText { offset: usize },
    /// The text is not TOML.
    #[error("not valid TOML: {what}")]
    Toml { what: String },
    /// A key that nothing reads.
    #[error("unknown key `{key}` in {place}")]
    UnknownKey { key: String, place: String },
    /// A key that must be there.
    #[error("{place} has no `{key}`")]
    MissingKey { key: String, place: String },
    /// A value of the wrong type.
    #[error("`{key}` of {place} is {found}, expected {expected}")]
    WrongType { key: String, place: String, found: &'static str, expected: &'static str },
    /// A word that is not one of those known.
    #[error("`{what}` of {place} is `{found}`, expected {expected}")]
    UnknownWord { what: String, place: String, found: String, expected: String },
    /// A key that would change nothing.
    #[error("`{key}` has no effect {why}")]
    NoEffect { key: String, why: String },
    /// Two keys of which there can be one.
    #[error("{place} has both `{first}` and `{second}`, expected one of them")]
    Both { place: String, first: String, second: String },
    /// Two keys of which there must be one.
    #[error("{place} has neither `{first}` nor `{second}`, expected one of them")]
    Neither { place: String, first: String, second: String },
    /// The model has too few or too many of something.
    #[error("the model has {found} {what}, expected {expected}")]
    Count { what: &'static str, found: usize, expected: String },
    /// A name that cannot be used.
    #[error("`{name}` cannot be the name of {}{what}: {why}", if what.starts_with('o') { "an " } else { "a " })]
    BadName { what: &'static str, name: String, why: &'static str },
    /// A name that stands for two things.
    #[error("`{name}` is the name of a state and of a parameter")]
    TakenName { name: String },
    /// A column of groups that is the column of tests.
    #[error("column `{name}` tells tests apart, so it cannot be a level of groups of them")]
    LevelOfTests { name: String },
    /// Groups of tests beside something that takes tests as independent of each other.
    #[error("`{key}` of `[data]` does not go with `[{beside}]`")]
    LevelsBeside { key: &'static str, beside: &'static str },
    /// A name that stands for nothing.
    #[error("unknown {what} `{name}` in {place}")]
    UnknownName { what: &'static str, name: String, place: String },
    /// A state that is not part of μ and Σ.
    #[error("state `{name}` in {place} is not estimated: its start is {start}")]
    NotEstimated { name: String, place: String, start: &'static str },
    /// A parameter without use.
    #[error("parameter `{name}` is not used")]
    Unused { name: String },
    /// A number that is infinite or not a number.
    #[error("{what} is {found}, expected a finite number")]
    NotFinite { what: String, found: String },
    /// A number where it cannot be.
    #[error("{what} is {}, expected {expected}", figure(*found))]
    OutOfRange { what: String, found: f64, expected: String },
    /// Motion in continuous time without time.
    #[error("{what} moves in continuous time, which needs `time` in `[data]`")]
    NoTime { what: String },
    /// A first step of unknown length.
    #[error("`step_first` gives the first step no length, which {what} needs")]
    FirstStepWithoutLength { what: String },
    /// A start in a stationary distribution that does not exist.
    #[error("state `{name}` has no stationary distribution: {why}")]
    NoStationaryLaw { name: String, why: String },
    /// A filter whose own belief of a parameter is not known.
    #[error("parameter `{name}` is free, but {place} uses it and does not say at which value")]
    FilterWithFree { name: String, place: String },
    /// `--set` with something that is not an assignment.
    #[error("`{found}` is not an assignment, expected `NAME=NUMBER` or `NAME[LEVEL]=NUMBER`")]
    NotAnAssignment { found: String },
    /// Something wrong in an expression.
    #[error(transparent)]
    Expression(#[from] ExpressionProblem),
    /// Constraints that cannot be.
    #[error(transparent)]
    Structure(#[from] StructureProblem),
}

/// What can be wrong with an expression.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say what the fields are")]
pub enum ExpressionProblem {
    /// A character that starts nothing.
    #[error("found `{found}`, which means nothing in an expression")]
    UnknownCharacter { found: char },
    /// A quote without its partner.
    #[error("{what} is not closed, expected {expected}")]
    Unclosed { what: &'static str, expected: &'static str },
    /// Something where something else must stand.
    #[error("found {found}, expected {expected}")]
    Unexpected { found: String, expected: &'static str },
    /// A text too long to be read.
    #[error("the expression has {found} characters, expected at most {limit}")]
    TooLong { found: usize, limit: usize },
    /// Too many levels.
    #[error("the expression is nested deeper than {limit} levels")]
    TooDeep { limit: usize },
    /// Too many parts.
    #[error("the expression has more than {limit} parts")]
    TooManyParts { limit: usize },
    /// All equations together are too much.
    #[error("the expanded equations of the model have more than {limit} parts")]
    ModelTooLarge { limit: usize },
    /// A function that does not exist.
    #[error("unknown function `{name}`")]
    UnknownFunction { name: String },
    /// A function without parentheses.
    #[error("`{name}` is a function, expected its arguments in parentheses")]
    NoArguments { name: String },
    /// The wrong number of arguments.
    #[error("`{name}` has {found} arguments, expected {expected}")]
    Arguments { name: String, found: usize, expected: &'static str },
    /// a < b < c.
    #[error("comparisons cannot be chained")]
    ChainedComparison,
    /// Text, number and truth mixed up.
    #[error("found {found}, expected {expected}")]
    Type { found: &'static str, expected: &'static str },
    /// A text compared with something other than a column.
    #[error("a text can only be compared with a column of the data, found {found}")]
    TextComparedWith { found: String },
    /// A text compared by size.
    #[error("texts can only be compared by `==` or `!=`, found `{found}`")]
    TextOrder { found: &'static str },
    /// A name of a kind that has no place here.
    #[error("{what} cannot stand in {place}")]
    NotAllowed { what: String, place: String },
    /// `dt` without time.
    #[error("`dt` needs `time` in `[data]`")]
    StepWithoutTime,
    /// A product of states.
    #[error("state `{first}` times state `{second}` is not linear in the states")]
    Product { first: String, second: String },
    /// A quotient of states.
    #[error("state `{first}` divided by state `{second}` is not linear in the states")]
    Quotient { first: String, second: String },
    /// Division by a state.
    #[error("a division by state `{name}` is not linear in the states")]
    DivisionByState { name: String },
    /// A power of a state.
    #[error("a power of state `{name}` is not linear in the states")]
    PowerOfState { name: String },
    /// A state in an exponent.
    #[error("state `{name}` in an exponent is not linear in the states")]
    StateInExponent { name: String },
    /// A function of a state.
    #[error("`{function}` of state `{name}` is not linear in the states")]
    FunctionOfState { function: String, name: String },
    /// A condition on a state.
    #[error("a condition on state `{name}` is not linear in the states")]
    ConditionOnState { name: String },
    /// Division by the constant zero.
    #[error("division by zero")]
    DivisionByZero,
    /// A constant that is no finite number.
    #[error("the value is not a finite number")]
    NotFinite,
    /// A parameter with levels where no row tells the level.
    #[error("parameter `{name}` has a value per `{per}`, but {place} is common to all tests")]
    LevelInCommon { name: String, per: String, place: String },
}

/// What can be wrong with constraints and matrices.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say what the fields are")]
pub enum StructureProblem {
    /// An element name that is not two names.
    #[error("`{found}` in {place} is not an element, expected two names as in `{example}`")]
    NotAnElement { found: String, place: String, example: String },
    /// A covariance of something with itself.
    #[error("`{found}` in {place} is a variance, expected two different names")]
    Variance { found: String, place: String },
    /// The same element twice, with different values.
    #[error("element `{element}` is given twice in {place}: {first} and {second}")]
    GivenTwice { element: String, place: String, first: String, second: String },
    /// The same name twice in a list.
    #[error("`{name}` stands twice in {place}")]
    ListedTwice { name: String, place: String },
    /// A slot of a factor that no state is of.
    #[error("no estimated state is named `{state}`, but {place} has a slot `{slot}`")]
    NoStateOfSlot { slot: String, place: String, state: String },
    /// States of two slots that one effect cannot act on.
    #[error("{place} makes one effect act on `{first}` and on `{second}`, but their {what} differ")]
    UnlikeSlots { first: String, second: String, what: &'static str, place: String },
    /// A name of a state where effects are named.
    #[error("{place} has no effect on `{name}` by itself: {}", hint.as_str())]
    NoEffectOf { name: String, place: String, hint: String },
    /// A name left out of a list that must be whole.
    #[error("`{name}` is missing in {place}")]
    NotListed { name: String, place: String },
    /// A matrix of the wrong shape.
    #[error("{place} has {found} {part}, expected {expected}")]
    Shape { place: String, part: String, found: usize, expected: usize },
    /// A list without anything in it, or a group of one.
    #[error("{place} has {found}, expected {expected}")]
    TooFew { place: String, found: &'static str, expected: &'static str },
    /// A matrix that is not symmetric.
    #[error("{place} is not symmetric: the entries of `{element}` differ")]
    NotSymmetric { place: String, element: String },
    /// A negative variance.
    #[error("the variance of `{name}` in {place} is {}, expected 0 or more", figure(*found))]
    NegativeVariance { name: String, place: String, found: f64 },
    /// A covariance where the variance is zero.
    #[error("the covariance of `{first}` and `{second}` in {place} is not 0, but the variance of `{first}` is")]
    CovarianceWithoutVariance { first: String, second: String, place: String },
    /// A correlation beyond one.
    #[error("the correlation of `{first}` and `{second}` in {place} is {found:.4}, expected -1 to 1")]
    Correlation { first: String, second: String, place: String, found: f64 },
    /// A matrix that is not positive semidefinite.
    #[error(
        "{place} is not positive semidefinite: scaled to unit diagonal, its smallest eigenvalue is {least:.3e}, \
         its largest {largest:.3e}"
    )]
    NotSemidefinite { place: String, least: f64, largest: f64 },
    /// A diagonal entry of a correlation matrix that is not one.
    #[error("the diagonal of a correlation matrix is 1, but the entry of `{name}` is not")]
    NotUnitDiagonal { name: String },
    /// A common value that varies.
    #[error("state `{name}` has `random = false`, but its {what} in {place} is not 0")]
    NotRandom { name: String, what: &'static str, place: String },
    /// A common value among those that vary.
    #[error("state `{name}` in {place} has `random = false`, so it does not vary")]
    Common { name: String, place: String },
    /// A state that is said not to vary, and varies.
    #[error("state `{name}` is not among {list}, but its {what} in {place} is not 0")]
    NotVarying { name: String, list: String, what: &'static str, place: String },
    /// An element that the structure makes zero, with another value.
    #[error("element `{element}` in {place} is {found}, but structure `{structure}` makes it 0")]
    StructuralZero { element: String, place: String, found: String, structure: &'static str },
    /// An element of `equal` that cannot be free.
    #[error("element `{element}` in `equal` is {why}, so it has no value to share")]
    NotFree { element: String, why: String },
    /// A start value that breaks a constraint.
    #[error("`start` has {} for element `{element}`, but {why}", figure(*found))]
    Start { element: String, found: f64, why: String },
    /// Two things said of one mean.
    #[error("the mean of `{name}` is {first} and {second}")]
    MeanTwice { name: String, first: &'static str, second: &'static str },
    /// A mean tied to one that is tied itself.
    #[error("the mean of `{name}` is tied to `{other}`, which is tied itself")]
    TiedToTied { name: String, other: String },
    /// A mean tied to itself.
    #[error("the mean of `{name}` is tied to itself")]
    TiedToItself { name: String },
    /// A mean tied to nothing.
    #[error("the mean of `{name}` is tied to no other mean")]
    TiedToNothing { name: String },
    /// A scale that scales nothing.
    #[error("{place} is zero throughout, so its scale has nothing to act on")]
    AllZero { place: String },
    /// Two noises of which one is per step and the other per unit of time.
    #[error("the noise of `{first}` is {first_kind} and that of `{second}` {second_kind}, so they have no covariance")]
    MixedNoise { first: String, first_kind: &'static str, second: String, second_kind: &'static str },
    /// A state that inherits and is stationary.
    #[error("state `{name}` inherits by `carry`, so it cannot start in its stationary distribution")]
    StationaryInherits { name: String },
    /// A state that inherits from nothing.
    #[error("`carry` of state `{name}` names no state of phase `{before}`")]
    InheritsNothing { name: String, before: String },
    /// A state of the phase itself, where the phase before it is meant.
    #[error("`{name}` is no state of phase `{before}`, from which `carry` inherits, but of the phase that inherits")]
    OwnStateInCarry { name: String, before: String },
    /// A second-order process that inherits from something without a rate.
    #[error("state `{name}` has a hidden rate, which cannot inherit from state `{other}`: it has none")]
    NoRate { name: String, other: String },
    /// Two measurements of one cell.
    #[error("measurements `{first}` and `{second}` both read every row of column `{column}`")]
    SameCells { first: String, second: String, column: String },
}
