//! Noise of measurements, and motion of states: random walks and Gauss-Markov pairs.

use crate::datasheet::figure::{FigureForm, Reader, ShownFigure};
use crate::datasheet::units::{ShownUnit, UnitQuantity, shown_time};
use kalfit_apply::export::ExportError;
use kalfit_model::{Expression, Initial, Linear, Model, Motion};
use kalfit_record::EntryRecord;

/// Collects the entries of one phase.
#[derive(Debug)]
pub(super) struct EntryCollector<'a> {
    pub(super) phase: &'a str,
    pub(super) reader: Reader<'a>,
    pub(super) entries: Vec<EntryRecord>,
}

/// Name and definition of an entry.
struct NoiseMeaning {
    name: &'static str,
    definition: &'static str,
}

const MEASUREMENT_NOISE: NoiseMeaning = NoiseMeaning {
    name: "measurement noise",
    definition: "standard deviation of the white noise of one measured value",
};
const ANGLE_WALK: NoiseMeaning = NoiseMeaning {
    name: "angle random walk",
    definition: "N: standard deviation of the integrated white noise of the rate, per square root of time; for a measurement, its standard deviation times the square root of the step",
};
const VELOCITY_WALK: NoiseMeaning = NoiseMeaning {
    name: "velocity random walk",
    definition: "N: standard deviation of the integrated white noise of the acceleration, per square root of time; for a measurement, its standard deviation times the square root of the step",
};
const WHITE_NOISE: NoiseMeaning = NoiseMeaning {
    name: "white noise",
    definition: "N: standard deviation of one measured value times the square root of the step, which is that of its integral per square root of time",
};
const RATE_WALK: NoiseMeaning = NoiseMeaning {
    name: "rate random walk",
    definition: "K: standard deviation that the rate gains as a random walk, per square root of time",
};
const ACCELERATION_WALK: NoiseMeaning = NoiseMeaning {
    name: "acceleration random walk",
    definition: "K: standard deviation that the acceleration gains as a random walk, per square root of time",
};
const RANDOM_WALK: NoiseMeaning = NoiseMeaning {
    name: "random walk",
    definition: "standard deviation that the driving noise adds to the state, per square root of time (of the number of steps, if rows have no times)",
};
const SIGMA: NoiseMeaning = NoiseMeaning {
    name: "Gauss-Markov sigma",
    definition: "standard deviation of a state with finite memory, in its stationary distribution",
};
const TAU: NoiseMeaning = NoiseMeaning {
    name: "Gauss-Markov time constant",
    definition: "correlation time of a state with finite memory: its correlation falls as exp(-t/tau), for second order as (1 + t/tau) exp(-t/tau)",
};

impl<'a> EntryCollector<'a> {
    /// Adds the white noise of a measurement; `step`: time between successive values.
    pub(super) fn measurement(&mut self, m: usize, step: Option<f64>) -> Result<(), ExportError> {
        let model = self.reader.model;
        let measurement = &model.measurements[m];
        let of = [&measurement.noise_variance];
        if is_zero(of[0]) {
            return Ok(());
        }
        let unit = ShownUnit::shown(measured_unit(model, m).as_deref());
        let timed = model.clock.time.is_some()
            && matches!(unit.quantity, UnitQuantity::Rate | UnitQuantity::Acceleration | UnitQuantity::Other);
        let (meaning, factor, label) = if timed {
            let (factor, label) = unit.white(model.clock.unit.as_deref());
            (
                match unit.quantity {
                    UnitQuantity::Rate => &ANGLE_WALK,
                    UnitQuantity::Acceleration => &VELOCITY_WALK,
                    _ => &WHITE_NOISE,
                },
                factor,
                label,
            )
        } else {
            (&MEASUREMENT_NOISE, unit.factor, unit.label.clone())
        };
        let figures = match (timed, step) {
            (true, None) => vec![ShownFigure { varies_with: vec!["step".to_owned()], ..ShownFigure::default() }],
            (true, Some(length)) => self.reader.figures(&of, step, &|v| factor * (v[0] * length).sqrt())?,
            (false, _) => self.reader.figures(&of, step, &|v| factor * v[0].sqrt())?,
        };
        self.add(meaning, ("measurement", &measurement.name.clone()), &label, figures);
        Ok(())
    }

    /// Adds the entries of a state that varies with time. `step`: length of the steps of states that move from row to
    /// row.
    pub(super) fn motion(&mut self, i: usize, step: Option<f64>) -> Result<(), ExportError> {
        let model = self.reader.model;
        let state = &model.states[i];
        match &state.motion {
            Motion::Constant => Ok(()),
            Motion::Continuous { derivative, noise_variance } => {
                if let [(own, decay)] = derivative.terms.as_slice()
                    && *own == i
                    && is_zero(&derivative.constant)
                    && (state.initial == Initial::Stationary || !is_zero(noise_variance))
                {
                    return self.add_gauss_markov(
                        i,
                        &[decay, noise_variance],
                        step,
                        (&|v| -1.0 / v[0], &|v| (-0.5 * v[1] / v[0]).sqrt()),
                    );
                }
                if let Some((damping, noise)) = self.second_order(i, derivative) {
                    let own = [damping, noise];
                    let beta = |v: &[f64]| -0.5 * v[0];
                    return self.add_gauss_markov(
                        i,
                        &own,
                        step,
                        (&|v| 1.0 / beta(v), &|v| (0.25 * v[1] / beta(v).powi(3)).sqrt()),
                    );
                }
                let hidden = i > 0 && self.is_second_order(i - 1);
                if hidden || is_zero(noise_variance) {
                    Ok(())
                } else {
                    self.walk(i, noise_variance, step, &|v| v[0].sqrt())
                }
            }
            Motion::Discrete { next, noise_variance } => {
                if is_zero(noise_variance) {
                    return Ok(());
                }
                let timed = model.clock.time.is_some();
                let length = if timed { step } else { Some(1.0) };
                if let [(own, decay_factor)] = next.terms.as_slice()
                    && *own == i
                    && is_zero(&next.constant)
                    && self
                        .reader
                        .number(decay_factor, step)?
                        .is_some_and(|decay_factor| decay_factor > 0.0 && decay_factor < 1.0)
                {
                    let length = length.unwrap_or(f64::NAN);
                    let tau = |v: &[f64]| -length / v[0].ln();
                    let sigma = |v: &[f64]| (v[1] / (1.0 - v[0] * v[0])).sqrt();
                    return self.add_gauss_markov(i, &[decay_factor, noise_variance], step, (&tau, &sigma));
                }
                match length {
                    Some(length) => self.walk(i, noise_variance, step, &|v| (v[0] / length).sqrt()),
                    None => {
                        let figure = ShownFigure { varies_with: vec!["step".to_owned()], ..ShownFigure::default() };
                        self.add_walk(i, vec![figure]);
                        Ok(())
                    }
                }
            }
        }
    }

    fn add_gauss_markov(
        &mut self,
        i: usize,
        of: &[&Expression],
        step: Option<f64>,
        (tau, sigma): (FigureForm<'_>, FigureForm<'_>),
    ) -> Result<(), ExportError> {
        let model = self.reader.model;
        let (name, unit) = (model.states[i].name.clone(), ShownUnit::shown(model.states[i].unit.as_deref()));
        let figures = self.reader.figures(of, step, &|v| unit.factor * sigma(v))?;
        self.add(&SIGMA, ("state", &name), &unit.label, figures);
        let time = if model.clock.time.is_some() { model.clock.unit.as_deref() } else { Some("steps") };
        let (factor, time) = shown_time(time);
        let figures = self.reader.figures(&of[..1], step, &|v| factor * tau(v))?;
        self.add(&TAU, ("state", &name), &time, figures);
        Ok(())
    }

    fn walk(
        &mut self,
        i: usize,
        noise: &Expression,
        step: Option<f64>,
        form: FigureForm<'_>,
    ) -> Result<(), ExportError> {
        let figures = self.reader.figures(&[noise], step, form)?;
        self.add_walk(i, figures);
        Ok(())
    }

    /// Adds a random walk whose density is known in the units of the model.
    fn add_walk(&mut self, i: usize, mut figures: Vec<ShownFigure>) {
        let model = self.reader.model;
        let unit = ShownUnit::shown(model.states[i].unit.as_deref());
        let time = if model.clock.time.is_some() { model.clock.unit.as_deref() } else { Some("step") };
        let (factor, label) = unit.walk(time);
        for figure in &mut figures {
            figure.value = figure.value.map(|value| factor * value);
            figure.interval = figure.interval.map(|ends| ends.map(|end| end.map(|end| factor * end)));
        }
        let meaning = match unit.quantity {
            UnitQuantity::Rate => &RATE_WALK,
            UnitQuantity::Acceleration => &ACCELERATION_WALK,
            UnitQuantity::Angle => &ANGLE_WALK,
            UnitQuantity::Velocity => &VELOCITY_WALK,
            _ => &RANDOM_WALK,
        };
        self.add(meaning, ("state", &model.states[i].name.clone()), &label, figures);
    }

    /// The damping -2β of the rate of a second-order Gauss-Markov state and the noise 4β³σ² that drives it.
    fn second_order(&self, i: usize, derivative: &Linear) -> Option<(&'a Expression, &'a Expression)> {
        let model = self.reader.model;
        let [(hidden, one)] = derivative.terms.as_slice() else { return None };
        let Motion::Continuous { derivative: own, noise_variance } = &model.states.get(i + 1)?.motion else {
            return None;
        };
        let [(first, stiffness), (second, damping)] = own.terms.as_slice() else { return None };
        let number = |of: &Expression| self.reader.number(of, None).ok().flatten();
        let (stiffness, beta) = (number(stiffness), number(damping).map(|damping| -0.5 * damping));
        // where the numbers differ from row to row the form alone decides
        let critical = stiffness.zip(beta).is_none_or(|(k, beta)| (k + beta * beta).abs() <= 1e-9 * beta * beta);
        let same = *hidden == i + 1 && (*first, *second) == (i, i + 1) && one.as_number() == Some(1.0);
        (same && critical && model.states[i].initial == Initial::Stationary && !is_zero(noise_variance))
            .then_some((damping, noise_variance))
    }

    fn is_second_order(&self, i: usize) -> bool {
        match &self.reader.model.states[i].motion {
            Motion::Continuous { derivative, .. } => self.second_order(i, derivative).is_some(),
            _ => false,
        }
    }

    fn add(
        &mut self,
        meaning: &NoiseMeaning,
        (kind, of): (&str, &str),
        unit: &Option<String>,
        figures: Vec<ShownFigure>,
    ) {
        let entry = |figure: ShownFigure| EntryRecord {
            name: meaning.name.to_owned(),
            of: of.to_owned(),
            kind: kind.to_owned(),
            phase: self.phase.to_owned(),
            level: None,
            at: figure.at.map(|(column, level)| format!("{column}={level}")),
            value: figure.value,
            unit: unit.clone(),
            interval95: figure.interval,
            definition: meaning.definition.to_owned(),
            from: figure.from,
            varies_with: figure.varies_with,
        };
        self.entries.extend(figures.into_iter().map(entry));
    }
}

fn is_zero(expression: &Expression) -> bool {
    expression.as_number() == Some(0.0)
}

/// Unit label of a measurement: the unit of the parameter that is the standard deviation of the noise, otherwise the
/// unit of the first state that is measured with coefficient ±1.
pub(super) fn measured_unit(model: &Model, m: usize) -> Option<String> {
    let measurement = &model.measurements[m];
    let noise = match &measurement.noise_variance {
        Expression::Binary(kalfit_model::Operator::Multiply, a, b) if a == b => match **a {
            Expression::Parameter(index) => model.parameters[index].unit.clone(),
            _ => None,
        },
        _ => None,
    };
    let own = measurement.equation.terms.iter().filter(|(_, a)| a.as_number().is_some_and(|a| a.abs() == 1.0));
    noise.or_else(|| own.filter_map(|(state, _)| model.states[*state].unit.clone()).next())
}
