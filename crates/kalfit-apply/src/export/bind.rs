//! Expressions at fixed columns, parameters and length of step.

use std::collections::BTreeMap;

use crate::export::{ExportError, Varies};
use kalfit_filter::reduce::{Fault, ReduceErrorKind, Subject};
use kalfit_model::Label;
use kalfit_model::{Alpha, Expression, Level, Model, Operator, Scope, Site};

/// Known values of columns, parameters and step, to be substituted in expressions, and a list of the quantities that
/// differ from row to row.
#[derive(Debug)]
pub struct Binder<'a> {
    model: &'a Model,
    alpha: &'a Alpha,
    step: Option<f64>,
    numbers: BTreeMap<usize, f64>,
    texts: BTreeMap<usize, (Label, String)>,
    pub(super) varies: Vec<Varies>,
}

impl<'a> Binder<'a> {
    /// A binder at `alpha`. `at`: (name of a column, value of the column).
    pub fn new(
        (model, alpha): (&'a Model, &'a Alpha),
        step: Option<f64>,
        at: &[(String, String)],
    ) -> Result<Binder<'a>, ExportError> {
        let (mut numbers, mut texts) = (BTreeMap::new(), BTreeMap::new());
        let read = columns_read(model);
        for (k, (name, value)) in at.iter().enumerate() {
            if at[..k].iter().any(|(other, _)| other == name) {
                return Err(ExportError::GivenTwice { column: name.clone() });
            }
            if !read.contains(name) {
                return Err(ExportError::NoEffect { column: name.clone(), columns: read });
            }
            if let Some(column) = model.columns.iter().position(|column| column.name == *name) {
                let number = value.trim().parse::<f64>().ok().filter(|number| number.is_finite());
                let refused = || ExportError::NotANumber { column: name.clone(), found: value.clone() };
                numbers.insert(column, number.ok_or_else(refused)?);
            }
            if let Some(column) = model.text_columns.iter().position(|column| column.name == *name) {
                // a text that is no literal of the model gets a label after the labels of all literals
                let literal = model.literals.iter().position(|literal| literal == value);
                let label = Label::literal(literal.unwrap_or(model.literals.len()));
                texts.insert(column, (label, value.clone()));
            }
        }
        Ok(Binder { model, alpha, step, numbers, texts, varies: Vec::new() })
    }

    /// The expression with all known values substituted. Parts without a finite value stay as they are.
    pub fn bind(&self, expression: &Expression) -> Expression {
        use Expression as E;
        let bind_boxed = |part: &Expression| Box::new(self.bind(part));
        match expression {
            E::Number(_) => expression.clone(),
            E::Column(column) => self.numbers.get(column).map_or(expression.clone(), |&x| E::Number(x)),
            E::Step => self.step.map_or(E::Step, E::Number),
            E::Parameter(index) => self.parameter(*index).map_or(expression.clone(), E::Number),
            E::TextEquals { column, literal } => match self.texts.get(column) {
                Some((label, _)) => E::Number(f64::from(u8::from(label.index() == *literal))),
                None => expression.clone(),
            },
            E::Negate(a) => folded(E::Negate(bind_boxed(a))),
            E::Not(a) => folded(E::Not(bind_boxed(a))),
            E::Binary(operator, a, b) => combined(*operator, bind_boxed(a), bind_boxed(b)),
            E::Call(function, arguments) => {
                folded(E::Call(*function, arguments.iter().map(|argument| self.bind(argument)).collect()))
            }
            E::If(condition, a, b) => match self.bind(condition) {
                E::Number(x) => self.bind(if x != 0.0 { a } else { b }),
                condition => E::If(Box::new(condition), bind_boxed(a), bind_boxed(b)),
            },
        }
    }

    /// The value of the expression, if equal on all rows; otherwise zero, and the columns that the expression depends
    /// on are noted.
    pub(super) fn number(&mut self, expression: &Expression, subject: Subject) -> Result<f64, ExportError> {
        let bound = self.bind(expression);
        match bound.as_number() {
            Some(x) => Ok(x),
            None => self.open(&bound, subject, &mut |_| true).map(|()| 0.0),
        }
    }

    /// Notes the columns that `bound`, an expression that is not a number, depends on. `counts`: whether a dependence
    /// on a given part of the expression is noted.
    pub(super) fn open(
        &mut self,
        bound: &Expression,
        subject: Subject,
        counts: &mut dyn FnMut(&Expression) -> bool,
    ) -> Result<(), ExportError> {
        let what = subject.words(self.model);
        let mut leaves = Vec::new();
        bound.any(&mut |part| {
            if matches!(
                part,
                Expression::Column(_) | Expression::Step | Expression::TextEquals { .. } | Expression::Parameter(_)
            ) {
                leaves.push(part.clone());
            }
            false
        });
        if leaves.is_empty() {
            return Err(self.not_finite(subject));
        }
        for leaf in leaves.iter().filter(|leaf| counts(leaf)) {
            let (column, parameter) = match leaf {
                Expression::Step => return Err(ExportError::NoStep { what }),
                Expression::Column(column) => (&self.model.columns[*column].name, None),
                Expression::TextEquals { column, .. } => (&self.model.text_columns[*column].name, None),
                Expression::Parameter(index) => {
                    let Level::Each { column, values, .. } = &self.alpha.values[*index] else { continue };
                    let (name, parameter) =
                        (&self.model.text_columns[*column].name, &self.model.parameters[*index].name);
                    if let Some((_, level)) = self.texts.get(column) {
                        let text = |label: &Label| self.model.literals.get(label.index()).cloned();
                        let levels = values.keys().filter_map(text).collect();
                        let (parameter, column, level) = (parameter.clone(), name.clone(), level.clone());
                        return Err(ExportError::NoLevel { parameter, column, level, levels });
                    }
                    (name, Some(parameter.clone()))
                }
                _ => continue,
            };
            let one = Varies { what: what.clone(), column: column.clone(), parameter };
            if !self.varies.contains(&one) {
                self.varies.push(one);
            }
        }
        Ok(())
    }

    pub(super) fn not_finite(&self, subject: Subject) -> ExportError {
        Fault::new(subject, ReduceErrorKind::NotFinite).name(self.model, None).into()
    }

    /// The value of a numeric column, if fixed; otherwise zero, and the dependence of `subject` on the column is noted.
    pub(super) fn column_value(&mut self, column: usize, subject: Subject) -> Result<f64, ExportError> {
        self.number(&Expression::Column(column), subject)
    }

    fn parameter(&self, index: usize) -> Option<f64> {
        match &self.alpha.values[index] {
            Level::Common(value) => Some(*value),
            Level::Each { column, values, other } => {
                let (label, _) = self.texts.get(column)?;
                values.get(label).copied().or(*other)
            }
        }
    }
}

/// The value of the expression as a number, if finite and without columns, steps or parameters; otherwise the
/// expression.
fn folded(expression: Expression) -> Expression {
    let alpha = Alpha::default();
    let scope = Scope { numbers: &[], texts: &[], step: f64::NAN, alpha: &alpha };
    let open = expression.any(&mut |part| {
        matches!(
            part,
            Expression::Column(_) | Expression::Step | Expression::TextEquals { .. } | Expression::Parameter(_)
        )
    });
    match open {
        true => expression,
        false => expression.evaluate(&scope).map_or(expression, Expression::Number),
    }
}

/// a ∘ b, as a number if one side alone determines it.
fn combined(operator: Operator, a: Box<Expression>, b: Box<Expression>) -> Expression {
    let zero = |side: &Expression| side.as_number() == Some(0.0);
    let truth = |side: &Expression| side.as_number().is_some_and(|x| x != 0.0);
    match operator {
        Operator::Multiply | Operator::And if zero(&a) || zero(&b) => Expression::Number(0.0),
        Operator::Divide if zero(&a) && !zero(&b) => Expression::Number(0.0),
        Operator::Or if truth(&a) || truth(&b) => Expression::Number(1.0),
        _ => folded(Expression::Binary(operator, a, b)),
    }
}

/// Names of the columns that the filter of a phase can depend on, each once.
pub fn columns_read(model: &Model) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    let mut add = |name: &String| {
        if !names.contains(name) {
            names.push(name.clone());
        }
    };
    let bound = |site: &Site| !matches!(site, Site::InitialTime | Site::Structure { .. });
    for (_, expression) in model.expressions().into_iter().filter(|(site, _)| bound(site)) {
        expression.any(&mut |part| {
            match part {
                Expression::Column(column) => add(&model.columns[*column].name),
                Expression::TextEquals { column, .. } => add(&model.text_columns[*column].name),
                Expression::Parameter(index) => {
                    if let Some(column) = model.parameters[*index].per {
                        add(&model.text_columns[column].name);
                    }
                }
                _ => {}
            }
            false
        });
    }
    model.mean.regression.iter().for_each(|regression| add(&model.columns[regression.column].name));
    names
}
