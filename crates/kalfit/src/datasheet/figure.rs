//! A number computed from expressions of the model, with the interval of the parameter that the number depends on.

use kalfit_apply::export::ExportError;
use kalfit_apply::export::bind::Binder;
use kalfit_infer::Interval;
use kalfit_model::Label;
use kalfit_model::{Alpha, Expression, Level, Model};
use kalfit_record::ParameterRecord;

/// Model and values that numbers are computed from.
#[derive(Debug)]
pub(super) struct Reader<'a> {
    pub(super) model: &'a Model,
    pub(super) alpha: &'a Alpha,
    /// Columns that have one value on all rows, as (name, value).
    pub(super) at: &'a [(String, String)],
    /// Results of the parameters; empty for values that were merely given.
    pub(super) known: &'a [ParameterRecord],
}

/// A number of the datasheet, with the interval of the number and the parameters that the number depends on.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct ShownFigure {
    /// The value; `None` where the value differs from row to row.
    pub(super) value: Option<f64>,
    pub(super) interval: Interval,
    /// Names of the parameters that the value depends on.
    pub(super) from: Vec<String>,
    /// Names of the columns, or `step`, with which the value differs.
    pub(super) varies_with: Vec<String>,
    /// (column, level) of the value, where the value differs with the levels of one column only.
    pub(super) at: Option<(String, String)>,
}

/// Computes a number from the values of expressions.
pub(super) type FigureForm<'a> = &'a dyn Fn(&[f64]) -> f64;

impl Reader<'_> {
    /// The number computed from expressions at a step; where it differs with one column alone, and parameters have
    /// values for levels of this column, one number for each level.
    pub(super) fn figures(
        &self,
        of: &[&Expression],
        step: Option<f64>,
        form: FigureForm<'_>,
    ) -> Result<Vec<ShownFigure>, ExportError> {
        let whole = self.figure(of, step, form)?;
        let levels = match whole.varies_with.as_slice() {
            [column] => self.levels(column),
            _ => Vec::new(),
        };
        if levels.is_empty() {
            return Ok(vec![whole]);
        }
        let one = |level: String| {
            let here = (whole.varies_with[0].clone(), level);
            let at = [self.at, std::slice::from_ref(&here)].concat();
            let figure = Reader { at: &at, ..*self }.figure(of, step, form)?;
            Ok(ShownFigure { at: Some(here), ..figure })
        };
        levels.into_iter().map(one).collect()
    }

    /// Levels of a text column for which parameters have values, in the order of the model; none for any other column.
    fn levels(&self, column: &str) -> Vec<String> {
        let Some(column) = self.model.text_columns.iter().position(|own| own.name == column) else { return Vec::new() };
        let mut labels: Vec<Label> = Vec::new();
        for (parameter, level) in self.model.parameters.iter().zip(&self.alpha.values) {
            if let (Some(per), Level::Each { values, .. }) = (parameter.per, level)
                && per == column
            {
                labels.extend(values.keys());
            }
        }
        labels.sort_unstable();
        labels.dedup();
        labels.iter().filter_map(|label| self.model.literals.get(label.index()).cloned()).collect()
    }

    /// The number computed from expressions at a step. Where it depends on one parameter alone, its interval is that of
    /// this parameter: a likelihood does not depend on the form in which a parameter is written.
    pub(super) fn figure(
        &self,
        of: &[&Expression],
        step: Option<f64>,
        form: FigureForm<'_>,
    ) -> Result<ShownFigure, ExportError> {
        let varies_with = self.varies_with(of, step);
        if !varies_with.is_empty() {
            return Ok(ShownFigure { varies_with, ..ShownFigure::default() });
        }
        let Some(value) = self.value_at(self.alpha, of, step, form)? else { return Ok(ShownFigure::default()) };
        let mut follows = Vec::new();
        for index in self.parameters(of) {
            let own = self.value(index)?;
            let moved = own + if own == 0.0 { 1.0 } else { 0.3 * own.abs() };
            let there = self.value_at(&self.alpha_with(index, moved), of, step, form)?;
            if there.is_none_or(|there| (there - value).abs() > 1e-9 * value.abs()) {
                follows.push((index, there.is_none_or(|there| there > value)));
            }
        }
        let interval = match follows.as_slice() {
            [(only, rises)] => self.interval(*only, *rises, &|alpha| self.value_at(alpha, of, step, form))?,
            _ => None,
        };
        let from = follows.iter().map(|(index, _)| self.name(*index)).collect();
        Ok(ShownFigure { value: Some(value), interval, from, varies_with, at: None })
    }

    /// Value of an expression; `None` where the expression is not a number after known values are inserted.
    pub(super) fn number(&self, of: &Expression, step: Option<f64>) -> Result<Option<f64>, ExportError> {
        Ok(Binder::new((self.model, self.alpha), step, self.at)?.bind(of).as_number())
    }

    /// Names of the columns that expressions read after known values are inserted, without duplicates; `step` where the
    /// step is not known.
    fn varies_with(&self, of: &[&Expression], step: Option<f64>) -> Vec<String> {
        let mut all: Vec<String> = Vec::new();
        let Ok(binder) = Binder::new((self.model, self.alpha), step, self.at) else { return all };
        for expression in of {
            binder.bind(expression).any(&mut |part| {
                let name = match part {
                    Expression::Column(column) => &self.model.columns[*column].name,
                    Expression::TextEquals { column, .. } => &self.model.text_columns[*column].name,
                    Expression::Parameter(index) => match self.model.parameters[*index].per {
                        Some(column) => &self.model.text_columns[column].name,
                        None => return false,
                    },
                    Expression::Step => "step",
                    _ => return false,
                };
                if !all.iter().any(|other| other == name) {
                    all.push(name.to_owned());
                }
                false
            });
        }
        all
    }

    fn value_at(
        &self,
        alpha: &Alpha,
        of: &[&Expression],
        step: Option<f64>,
        form: FigureForm<'_>,
    ) -> Result<Option<f64>, ExportError> {
        let binder = Binder::new((self.model, alpha), step, self.at)?;
        let values: Option<Vec<f64>> = of.iter().map(|expression| binder.bind(expression).as_number()).collect();
        Ok(values.map(|values| form(&values)).filter(|value| value.is_finite()))
    }

    /// Indices of the parameters that occur in expressions, without duplicates.
    fn parameters(&self, of: &[&Expression]) -> Vec<usize> {
        let mut all = Vec::new();
        for expression in of {
            expression.any(&mut |part| {
                if let Expression::Parameter(index) = part
                    && !all.contains(index)
                {
                    all.push(*index);
                }
                false
            });
        }
        all
    }

    fn value(&self, index: usize) -> Result<f64, ExportError> {
        Ok(self.number(&Expression::Parameter(index), None)?.unwrap_or(0.0))
    }

    fn alpha_with(&self, index: usize, value: f64) -> Alpha {
        let mut alpha = self.alpha.clone();
        alpha.values[index] = Level::Common(value);
        alpha
    }

    /// Level at which a parameter with several values is read.
    fn level(&self, index: usize) -> Option<&str> {
        let column = &self.model.text_columns[self.model.parameters[index].per?].name;
        self.at.iter().find(|(name, _)| name == column).map(|(_, level)| level.as_str())
    }

    fn name(&self, index: usize) -> String {
        let name = &self.model.parameters[index].name;
        self.level(index).map_or_else(|| name.clone(), |level| format!("{name}[{level}]"))
    }

    /// Interval of the number, from the ends of the interval of a parameter.
    fn interval(
        &self,
        index: usize,
        rises: bool,
        there: &dyn Fn(&Alpha) -> Result<Option<f64>, ExportError>,
    ) -> Result<Interval, ExportError> {
        let parameter = &self.model.parameters[index];
        let (value, level) = (self.value(index)?, self.level(index));
        let known = |record: &&ParameterRecord| record.name == parameter.name && record.level.as_deref() == level;
        // a value that differs from the estimate of the fit has no interval
        let known = self.known.iter().find(known).filter(|record| record.estimate == value);
        let Some(ends) = known.and_then(|record| record.interval95) else { return Ok(None) };
        let mut found = [None; 2];
        for (end, found) in ends.into_iter().zip(&mut found) {
            let Some(end) = end else { continue };
            let end = if parameter.positive { end.max(0.0) } else { end };
            *found = there(&self.alpha_with(index, end))?;
        }
        if !rises {
            found.reverse();
        }
        Ok(found.iter().any(Option::is_some).then_some(found))
    }
}
