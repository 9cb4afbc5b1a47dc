//! A model with numbers for coefficients, and the terms of the known inputs.

use crate::export::ExportError;
use crate::export::bind::Binder;
use crate::export::terms::{ONE, Terms, terms};
use kalfit_filter::reduce::Subject;
use kalfit_model::{Expression, Initial, Linear, Model, Motion};

/// A model at fixed columns, parameters and length of step: only known inputs read the data.
#[derive(Debug)]
pub(super) struct PlainModel {
    pub(super) model: Model,
    /// Terms of the known input of each state.
    pub(super) state_inputs: Vec<Terms>,
    /// Terms of the known input of each measurement.
    pub(super) offsets: Vec<Terms>,
    /// Condition `where` of each measurement; `None` where the condition holds on all rows.
    pub(super) filters: Vec<Option<Expression>>,
}

impl PlainModel {
    /// Replaces the coefficients of a model by numbers; what differs from row to row is noted in the binder. `starts`:
    /// whether the law of x_0 is wanted.
    pub(super) fn new(model: &Model, binder: &mut Binder<'_>, starts: bool) -> Result<PlainModel, ExportError> {
        let mut plain =
            PlainModel { model: model.clone(), state_inputs: Vec::new(), offsets: Vec::new(), filters: Vec::new() };
        plain.model.clock.initial_time = None;
        plain.states(binder, starts)?;
        plain.measurements(binder)?;
        let unread: Vec<bool> = plain.filters.iter().map(reads_no_row).collect();
        let own = &mut plain.model;
        for (i, j, covariance) in &mut own.process_noise_covariance {
            set_number(binder, covariance, Subject::ProcessCovariance(*i, *j))?;
        }
        own.noise_covariance.retain(|(i, j, _)| !unread[*i] && !unread[*j]);
        for (i, j, covariance) in &mut own.noise_covariance {
            set_number(binder, covariance, Subject::NoiseCovariance(*i, *j))?;
        }
        for entry in own.covariance.known.iter_mut().flatten().flatten() {
            set_start_number(binder, entry, Subject::KnownCovariance, starts)?;
        }
        plain.drop_unread(&unread)?;
        Ok(plain)
    }

    fn states(&mut self, binder: &mut Binder<'_>, starts: bool) -> Result<(), ExportError> {
        for (i, state) in self.model.states.iter_mut().enumerate() {
            let mut drive = Terms::new();
            let (form, variance, subject) = match &mut state.motion {
                Motion::Constant => (None, None, Subject::Next(i)),
                Motion::Continuous { derivative, noise_variance } => {
                    (Some(derivative), Some(noise_variance), Subject::Derivative(i))
                }
                Motion::Discrete { next, noise_variance } => (Some(next), Some(noise_variance), Subject::Next(i)),
            };
            if let Some(form) = form {
                drive = linear(binder, form, subject)?;
            }
            if let Some(variance) = variance {
                set_number(binder, variance, Subject::ProcessNoise(i))?;
            }
            self.state_inputs.push(drive);
            if let Initial::Known { mean, variance } = &mut state.initial {
                set_start_number(binder, mean, Subject::InitialMean(i), starts)?;
                set_start_number(binder, variance, Subject::InitialVariance(i), starts)?;
            }
            if let Some(offset) = &mut state.offset {
                set_start_number(binder, offset, Subject::Offset(i), starts)?;
            }
        }
        Ok(())
    }

    fn measurements(&mut self, binder: &mut Binder<'_>) -> Result<(), ExportError> {
        for (m, measurement) in self.model.measurements.iter_mut().enumerate() {
            let filter = measurement.filter.take().map(|filter| binder.bind(&filter));
            // a measurement that reads no row at the fixed values is ignored
            self.filters.push(filter);
            if reads_no_row(&self.filters[m]) {
                self.offsets.push(Terms::new());
                continue;
            }
            self.offsets.push(linear(binder, &mut measurement.equation, Subject::Equation(m))?);
            set_number(binder, &mut measurement.noise_variance, Subject::Noise(m))?;
        }
        Ok(())
    }

    /// Leaves out measurements that read no row.
    fn drop_unread(&mut self, unread: &[bool]) -> Result<(), ExportError> {
        if !unread.contains(&false) {
            let measurements = self.model.measurements.iter().map(|measurement| measurement.name.clone()).collect();
            return Err(ExportError::NothingMeasured { measurements });
        }
        let place = |m: usize| unread[..m].iter().filter(|unread| !**unread).count();
        let is_read = |m: usize| !unread[m];
        self.model.measurements = retained(&self.model.measurements, &is_read);
        self.offsets = retained(&self.offsets, &is_read);
        self.filters = retained(&self.filters, &is_read);
        // a condition that holds on every row at the fixed values is dropped
        self.filters.iter_mut().for_each(|filter| *filter = filter.take().filter(|own| own.as_number().is_none()));
        self.model.noise_covariance.iter_mut().for_each(|(i, j, _)| (*i, *j) = (place(*i), place(*j)));
        Ok(())
    }
}

/// Whether a measurement with this condition reads no row at the fixed values.
fn reads_no_row(filter: &Option<Expression>) -> bool {
    filter.as_ref().is_some_and(|own| own.as_number() == Some(0.0))
}

fn retained<T: Clone>(all: &[T], is_read: &dyn Fn(usize) -> bool) -> Vec<T> {
    all.iter().enumerate().filter(|(m, _)| is_read(*m)).map(|(_, one)| one.clone()).collect()
}

/// Replaces the coefficients of states by numbers, and splits the known input into terms.
fn linear(binder: &mut Binder<'_>, form: &mut Linear, subject: Subject) -> Result<Terms, ExportError> {
    for (_, coefficient) in &mut form.terms {
        set_number(binder, coefficient, subject)?;
    }
    form.constant = binder.bind(&form.constant);
    if form.constant.as_number().is_some() {
        return Ok(terms(&form.constant));
    }
    // an input may depend on columns, but not on levels or an unknown step
    let open = |part: &Expression| matches!(part, Expression::Parameter(_) | Expression::Step);
    binder.open(&form.constant.clone(), subject, &mut |part| open(part))?;
    let own = terms(&form.constant);
    if own.iter().any(|(coefficient, _)| !coefficient.is_finite()) {
        return Err(binder.not_finite(subject));
    }
    if own.iter().all(|(_, term)| *term == ONE) {
        form.constant = Expression::Number(own.iter().map(|(x, _)| x).sum());
    }
    Ok(own)
}

fn set_number(binder: &mut Binder<'_>, expression: &mut Expression, subject: Subject) -> Result<(), ExportError> {
    *expression = Expression::Number(binder.number(expression, subject)?);
    Ok(())
}

/// Replaces a coefficient of the start by a number: by the value, or by zero where the start is not wanted.
fn set_start_number(
    binder: &mut Binder<'_>,
    expression: &mut Expression,
    subject: Subject,
    wanted: bool,
) -> Result<(), ExportError> {
    match wanted {
        true => set_number(binder, expression, subject),
        false => {
            *expression = Expression::Number(0.0);
            Ok(())
        }
    }
}
