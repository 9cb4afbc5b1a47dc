//! The subjects of errors, and the coefficients of a model at α.

use crate::reduce::error::{ReduceError, ReduceErrorKind};
use kalfit_model::Test;
use kalfit_model::{Alpha, EvaluationError, Expression, Level, Model, Scope};

/// [`Subject::Test`] in words.
pub(crate) const WHOLE: &str = "the test";

/// The quantity whose computation fails, for error messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Subject {
    /// Derivative of a state, by its number.
    Derivative(usize),
    /// Next value of a state, by its number.
    Next(usize),
    /// Process noise variance of a state, by its number.
    ProcessNoise(usize),
    /// Process noise covariance of two states, by their numbers.
    ProcessCovariance(usize, usize),
    /// Transition of a step.
    Transition,
    /// Equation of a measurement, by its number.
    Equation(usize),
    /// Noise variance of a measurement, by its number.
    Noise(usize),
    /// Condition `where` of a measurement, by its number.
    Filter(usize),
    /// Measured value of a measurement, by its number.
    Value(usize),
    /// Noise covariance of two measurements, by their numbers.
    NoiseCovariance(usize, usize),
    /// Noise covariance of all measurements of a step.
    StepNoise,
    /// Initial mean of a state, by its number.
    InitialMean(usize),
    /// Initial variance of a state, by its number.
    InitialVariance(usize),
    /// Stationary start of a state, by its number.
    StationaryLaw(usize),
    /// Offset of a state, by its number.
    Offset(usize),
    /// Known covariance of the initial states.
    KnownCovariance,
    /// Value that a state, by its number, inherits from the phase before.
    Carry(usize),
    /// Initial time.
    InitialTime,
    /// Time of a row.
    Time,
    /// Regression of the mean, by its number.
    Regression(usize),
    /// The whole test.
    Test,
}

impl Subject {
    /// The subject in words, with the names of the model.
    pub fn words(self, model: &Model) -> String {
        let state = |i: usize| &model.states[i].name;
        let meter = |i: usize| &model.measurements[i].name;
        match self {
            Subject::Derivative(i) => format!("derivative of state `{}`", state(i)),
            Subject::Next(i) => format!("next value of state `{}`", state(i)),
            Subject::ProcessNoise(i) => format!("process noise variance of state `{}`", state(i)),
            Subject::ProcessCovariance(i, j) => {
                format!("process noise covariance of states `{}` and `{}`", state(i), state(j))
            }
            Subject::Transition => "transition of a step".to_owned(),
            Subject::Equation(i) => format!("equation of measurement `{}`", meter(i)),
            Subject::Noise(i) => format!("noise variance of measurement `{}`", meter(i)),
            Subject::Filter(i) => format!("`where` of measurement `{}`", meter(i)),
            Subject::Value(i) => format!("measurement `{}`", meter(i)),
            Subject::NoiseCovariance(i, j) => {
                format!("noise covariance of measurements `{}` and `{}`", meter(i), meter(j))
            }
            Subject::StepNoise => "noise covariance of a step".to_owned(),
            Subject::InitialMean(i) => format!("initial mean of state `{}`", state(i)),
            Subject::InitialVariance(i) => format!("initial variance of state `{}`", state(i)),
            Subject::StationaryLaw(i) => format!("stationary start of state `{}`", state(i)),
            Subject::Offset(i) => format!("offset of state `{}`", state(i)),
            Subject::KnownCovariance => "known covariance of the initial states".to_owned(),
            Subject::Carry(i) => format!("carry of state `{}`", state(i)),
            Subject::InitialTime => "initial time".to_owned(),
            Subject::Time => "time of a row".to_owned(),
            Subject::Regression(r) => {
                let element = model.mean.regression[r].element;
                format!("regression of the mean of state `{}`", state(model.estimated[element]))
            }
            Subject::Test => WHOLE.to_owned(),
        }
    }
}

/// An error before the names of model and test are filled in.
#[derive(Debug, Clone, PartialEq)]
pub struct Fault {
    pub(crate) subject: Subject,
    /// Row of the test.
    pub(crate) row: Option<usize>,
    pub(crate) kind: ReduceErrorKind,
}

impl Fault {
    /// The error of a subject, without a row.
    pub fn new(subject: Subject, kind: impl Into<ReduceErrorKind>) -> Box<Fault> {
        Box::new(Fault { subject, row: None, kind: kind.into() })
    }

    pub(crate) fn on(mut self: Box<Fault>, row: usize) -> Box<Fault> {
        self.row = Some(row);
        self
    }

    /// The error with the names of the model, and with id and source row where a test is given.
    pub fn name(self, model: &Model, test: Option<&Test>) -> ReduceError {
        ReduceError {
            test: test.map(|test| test.id.to_string()),
            row: test.zip(self.row).map(|(test, row)| test.source(row)),
            what: self.subject.words(model),
            kind: Box::new(self.kind),
        }
    }
}

/// A model and α, from which coefficients are evaluated.
#[derive(Debug, Clone, Copy)]
pub struct ModelAt<'a> {
    pub(crate) model: &'a Model,
    pub(crate) alpha: &'a Alpha,
    /// Whether each parameter is free; empty where no derivatives are requested.
    pub(crate) free: &'a [bool],
}

impl ModelAt<'_> {
    /// The coefficient that an expression gives at α.
    pub(crate) fn coefficient(&self, expression: &Expression, subject: Subject) -> Result<Coefficient, Box<Fault>> {
        if self.varies(expression) {
            return Ok(Coefficient::Varying(expression.clone(), subject));
        }
        let scope = Scope { numbers: &[], texts: &[], step: 0.0, alpha: self.alpha };
        let value = self.finite(expression.evaluate(&scope), subject)?;
        Ok(if self.depends(expression) {
            Coefficient::Free(value, expression.clone(), subject)
        } else {
            Coefficient::Fixed(value)
        })
    }

    /// True when an expression mentions a free parameter.
    pub(crate) fn depends(&self, expression: &Expression) -> bool {
        self.free_parameter(expression).is_some()
    }

    /// The first free parameter that an expression mentions.
    pub(crate) fn free_parameter(&self, expression: &Expression) -> Option<usize> {
        let mut free_index = None;
        expression.any(&mut |part| {
            if let Expression::Parameter(index) = part
                && self.free.get(*index).copied().unwrap_or(false)
            {
                free_index = Some(*index);
            }
            free_index.is_some()
        });
        free_index
    }

    /// As [`ModelAt::coefficient`], for the expression of a variance, which must not be negative.
    pub(crate) fn variance(&self, expression: &Expression, subject: Subject) -> Result<Coefficient, Box<Fault>> {
        let coefficient = self.coefficient(expression, subject)?;
        if let Some(value) = coefficient.constant() {
            not_negative(value, subject)?;
        }
        Ok(coefficient)
    }

    /// True when the value of an expression can differ from row to row.
    fn varies(&self, expression: &Expression) -> bool {
        expression.any(&mut |part| match part {
            Expression::Column(_) | Expression::Step | Expression::TextEquals { .. } => true,
            Expression::Parameter(index) => matches!(self.alpha.values[*index], Level::Each { .. }),
            _ => false,
        })
    }

    pub(crate) fn finite(&self, value: Result<f64, EvaluationError>, subject: Subject) -> Result<f64, Box<Fault>> {
        match value {
            Ok(value) if value.is_finite() => Ok(value),
            Ok(_) | Err(EvaluationError::NotFinite) => Err(Fault::new(subject, ReduceErrorKind::NotFinite)),
            Err(EvaluationError::MissingNumber { column }) => {
                let column = self.model.columns[column].name.clone();
                Err(Fault::new(subject, ReduceErrorKind::MissingCell { column }))
            }
            Err(EvaluationError::MissingText { column }) => {
                let column = self.model.text_columns[column].name.clone();
                Err(Fault::new(subject, ReduceErrorKind::MissingCell { column }))
            }
            Err(EvaluationError::NoLevel { parameter, level }) => {
                let parameter = self.model.parameters[parameter].name.clone();
                Err(Fault::new(subject, ReduceErrorKind::NoLevel { parameter, level }))
            }
        }
    }

    /// The number in a cell that must not be missing.
    pub(crate) fn cell(&self, numbers: &[f64], column: usize, subject: Subject) -> Result<f64, Box<Fault>> {
        let value = numbers[column];
        if value.is_finite() {
            return Ok(value);
        }
        let column = self.model.columns[column].name.clone();
        let kind = if value.is_nan() {
            ReduceErrorKind::MissingCell { column }
        } else {
            ReduceErrorKind::InfiniteCell { column, value }
        };
        Err(Fault::new(subject, kind))
    }

    /// Value of a coefficient on a row.
    #[inline(always)]
    pub(crate) fn value(&self, coefficient: &Coefficient, scope: &Scope<'_>) -> Result<f64, Box<Fault>> {
        match coefficient {
            Coefficient::Fixed(value) | Coefficient::Free(value, ..) => Ok(*value),
            Coefficient::Varying(Expression::Column(column), _) if scope.numbers[*column].is_finite() => {
                Ok(scope.numbers[*column])
            }
            Coefficient::Varying(expression, subject) => self.evaluated(expression, *subject, scope),
        }
    }

    fn evaluated(&self, expression: &Expression, subject: Subject, scope: &Scope<'_>) -> Result<f64, Box<Fault>> {
        match expression.evaluate(scope) {
            Ok(value) if value.is_finite() => Ok(value),
            // An unknown first step is NaN, and so is every value that depends on it.
            Err(EvaluationError::NotFinite) if scope.step.is_nan() && mentions_step(expression) => {
                Err(Fault::new(subject, ReduceErrorKind::UnknownFirstStep))
            }
            other => self.finite(other, subject),
        }
    }

    /// Value, on a row, of a coefficient that is a variance and must not be negative.
    #[inline]
    pub(crate) fn variance_value(&self, coefficient: &Coefficient, scope: &Scope<'_>) -> Result<f64, Box<Fault>> {
        let value = self.value(coefficient, scope)?;
        if let Coefficient::Varying(_, subject) = coefficient {
            not_negative(value, *subject)?;
        }
        Ok(value)
    }
}

fn mentions_step(expression: &Expression) -> bool {
    expression.any(&mut |part| matches!(part, Expression::Step))
}

fn not_negative(value: f64, subject: Subject) -> Result<(), Box<Fault>> {
    if value < 0.0 { Err(Fault::new(subject, ReduceErrorKind::NegativeVariance { value })) } else { Ok(()) }
}

/// A coefficient of the model at α.
#[derive(Debug, Clone, PartialEq)]
pub enum Coefficient {
    /// Value that is the same on every row.
    Fixed(f64),
    /// Value that is the same on every row and depends on free parameters: a value of zero at this α need not be zero
    /// at the next α.
    Free(f64, Expression, Subject),
    /// Expression that is evaluated on each row.
    Varying(Expression, Subject),
}

impl Coefficient {
    /// Whether the coefficient is zero on every row, whatever the free parameters are.
    pub(crate) fn is_zero(&self) -> bool {
        matches!(self, Coefficient::Fixed(value) if *value == 0.0)
    }

    /// Value of the coefficient, where the value is the same on every row; else `None`.
    pub(crate) fn constant(&self) -> Option<f64> {
        match self {
            Coefficient::Fixed(value) | Coefficient::Free(value, ..) => Some(*value),
            Coefficient::Varying(..) => None,
        }
    }

    /// Expression and subject of the coefficient; `None` for a fixed value.
    pub(crate) fn source(&self) -> Option<(&Expression, Subject)> {
        match self {
            Coefficient::Fixed(_) => None,
            Coefficient::Free(_, expression, subject) | Coefficient::Varying(expression, subject) => {
                Some((expression, *subject))
            }
        }
    }
}

/// Columns that expressions read, ascending.
#[derive(Debug, Clone, Default)]
pub struct Uses {
    pub(crate) numbers: Vec<usize>,
    pub(crate) texts: Vec<usize>,
}

impl Uses {
    pub(crate) fn number(&mut self, column: usize) {
        insert(&mut self.numbers, column);
    }

    /// Adds the columns of `others`.
    pub(crate) fn extend(&mut self, others: &Uses) {
        others.numbers.iter().for_each(|&column| insert(&mut self.numbers, column));
        others.texts.iter().for_each(|&column| insert(&mut self.texts, column));
    }

    pub(crate) fn add(&mut self, coefficient: &Coefficient, alpha: &Alpha) {
        if let Coefficient::Varying(expression, _) = coefficient {
            self.expression(expression, alpha);
        }
    }

    /// True when there are no columns.
    pub(crate) fn is_empty(&self) -> bool {
        self.numbers.is_empty() && self.texts.is_empty()
    }

    pub(crate) fn expression(&mut self, expression: &Expression, alpha: &Alpha) {
        expression.any(&mut |part| {
            match part {
                Expression::Column(column) => insert(&mut self.numbers, *column),
                Expression::TextEquals { column, .. } => insert(&mut self.texts, *column),
                Expression::Parameter(index) => {
                    if let Level::Each { column, .. } = &alpha.values[*index] {
                        insert(&mut self.texts, *column);
                    }
                }
                _ => {}
            }
            false
        });
    }

    /// True when the cells of these columns in `rows` equal, bit for bit, the cells in as many rows directly before
    /// `rows`.
    #[inline]
    pub(crate) fn repeat(&self, test: &Test, rows: &std::ops::Range<usize>) -> bool {
        self.is_empty()
            || rows.clone().all(|row| {
                let (now, before) = (test.numbers(row), test.numbers(row - rows.len()));
                let (texts, texts_before) = (test.texts(row), test.texts(row - rows.len()));
                self.numbers.iter().all(|&column| now[column].to_bits() == before[column].to_bits())
                    && self.texts.iter().all(|&column| texts[column] == texts_before[column])
            })
    }
}

fn insert(columns: &mut Vec<usize>, column: usize) {
    if let Err(at) = columns.binary_search(&column) {
        columns.insert(at, column);
    }
}

/// True when the value of a coefficient is read from the data, except for the levels of parameters.
pub(crate) fn reads_data(coefficient: &Coefficient) -> bool {
    let Coefficient::Varying(expression, _) = coefficient else { return false };
    expression.any(&mut |part| matches!(part, Expression::Column(_) | Expression::Step | Expression::TextEquals { .. }))
}
