//! The parts of one model in plain words.

use kalfit::Model;
use kalfit::model::{
    Clock, CovarianceKind, CovarianceStructure, Expression, Initial, MeanElement, Measurement, Motion, Parameter,
    State, Value,
};

use crate::expression::is_zero;
use crate::figure::figure;
use crate::show;

/// Says what a model is, one fact a line.
pub(crate) struct ModelWords<'m> {
    pub(crate) model: &'m Model,
}

impl ModelWords<'_> {
    /// What a step is, and where x_0 is unless phases say so; `row` is the row at which it is when nothing else is said.
    pub(crate) fn steps(&self, row: Option<&str>) -> String {
        let clock = &self.model.clock;
        let unit = clock.unit.as_ref().map_or(String::new(), |unit| format!(" [{unit}]"));
        let steps = match clock.time {
            Some(column) => format!("steps: rows of equal time, column `{}`{unit}", self.model.columns[column].name),
            None => "steps: one for each row".to_owned(),
        };
        let start = row.map_or(String::new(), |row| format!("; {}", self.start(row)));
        let inputs = if clock.previous_inputs { "; a step uses the columns of the row it starts from" } else { "" };
        format!("{steps}{start}{inputs}")
    }

    /// Where x_0 is; `row` is the row at which it is when nothing else is said.
    pub(crate) fn start(&self, row: &str) -> String {
        match &self.model.clock {
            Clock { initial_time: Some(time), .. } => format!("x_0 is at time {}", self.shown(time)),
            Clock { step_first: true, .. } => format!("one step from x_0 to {row}"),
            _ => format!("x_0 is at {row}"),
        }
    }

    pub(crate) fn state(&self, state: &State) -> String {
        let motion = match &state.motion {
            Motion::Constant => "constant".to_owned(),
            Motion::Continuous { derivative, noise_variance } => {
                let driven = self.driven(noise_variance, ["per unit of time", "per square root of a unit of time"]);
                format!("d/dt = {}{driven}", show::linear(self.model, derivative))
            }
            Motion::Discrete { next, noise_variance } => {
                let driven = self.driven(noise_variance, ["per step"; 2]);
                format!("next = {}{driven}", show::linear(self.model, next))
            }
        };
        let start = match &state.initial {
            Initial::Estimated if state.random => "start estimated".to_owned(),
            Initial::Estimated => "start estimated, one value common to all tests".to_owned(),
            Initial::Stationary => "start in its stationary distribution".to_owned(),
            Initial::Known { mean, variance } => {
                format!("start known, mean {}, variance {}", self.shown(mean), self.shown(variance))
            }
        };
        let offset = state.offset.as_ref().map_or(String::new(), |offset| format!(", plus {}", self.shown(offset)));
        format!("state `{}`{}: {motion}; {start}{offset}", state.name, unit(state.unit.as_deref()))
    }

    fn driven(&self, variance: &Expression, per: [&str; 2]) -> String {
        if is_zero(variance) {
            return String::new();
        }
        let (noise, deviation) = show::noise(self.model, variance);
        format!(" + {noise} {}", per[usize::from(deviation)])
    }

    pub(crate) fn measurement(&self, measurement: &Measurement) -> String {
        let rows = measurement.filter.as_ref();
        let rows = rows.map_or(String::new(), |filter| format!(" (rows where {})", self.shown(filter)));
        let column = &self.model.columns[measurement.column].name;
        let noise = match is_zero(&measurement.noise_variance) {
            true => "without noise".to_owned(),
            false => show::noise(self.model, &measurement.noise_variance).0,
        };
        let equation = show::linear(self.model, &measurement.equation);
        format!("measurement `{}`: column `{column}`{rows} reads {equation}; {noise}", measurement.name)
    }

    /// Covariances between noises of states and of measurements.
    pub(crate) fn process_noise_covariance(&self) -> Vec<String> {
        let name = |i: usize| &self.model.states[i].name;
        let words = |(i, j, value): &(usize, usize, Expression)| {
            format!("process noise of `{}` and `{}`: covariance {}", name(*j), name(*i), self.shown(value))
        };
        self.model.process_noise_covariance.iter().map(words).collect()
    }

    pub(crate) fn noise_covariance(&self) -> Vec<String> {
        let name = |i: usize| &self.model.measurements[i].name;
        let words = |(i, j, value): &(usize, usize, Expression)| {
            format!("measurement noise of `{}` and `{}`: covariance {}", name(*j), name(*i), self.shown(value))
        };
        self.model.noise_covariance.iter().map(words).collect()
    }

    pub(crate) fn parameter(&self, parameter: &Parameter) -> String {
        let mut facts = Vec::new();
        match parameter.value {
            Value::Fixed(value) => facts.push(format!("fixed at {}", figure(value))),
            Value::Free { start: Some(start) } => facts.push(format!("free, start {}", figure(start))),
            Value::Free { start: None } => facts.push("free".to_owned()),
        }
        if parameter.positive {
            facts.push("not negative".to_owned());
        }
        facts.extend(parameter.lower.map(|lower| format!("at least {}", figure(lower))));
        facts.extend(parameter.upper.map(|upper| format!("at most {}", figure(upper))));
        facts.extend(
            parameter
                .per
                .map(|column| format!("one value for each value of column `{}`", self.model.text_columns[column].name)),
        );
        for (literal, value) in &parameter.fixed_levels {
            facts.push(format!("fixed at {} for '{}'", figure(*value), self.model.literals[*literal]));
        }
        format!("parameter `{}`{}: {}", parameter.name, unit(parameter.unit.as_deref()), facts.join(", "))
    }

    pub(crate) fn order(&self) -> String {
        let names = self.model.estimated_names();
        if names.is_empty() {
            return "no state has an estimated start: there is no μ and no Σ".to_owned();
        }
        format!("order of μ and Σ: {}", names.join(", "))
    }

    pub(crate) fn mean(&self) -> Vec<String> {
        let (mean, names) = (&self.model.mean, self.model.estimated_names());
        let mut lines = Vec::new();
        for (i, element) in mean.elements.iter().enumerate() {
            let fact = match element {
                MeanElement::Free => match mean.start[i] {
                    None => continue,
                    Some(start) => format!("free, start {}", figure(start)),
                },
                MeanElement::Fixed(value) => format!("fixed at {}", figure(*value)),
                MeanElement::Proportional(weight) => format!("the common scale times {}", figure(*weight)),
                MeanElement::Tied { constant, terms } => {
                    let term = |(k, weight): &(usize, f64)| format!("{} × mean of `{}`", figure(*weight), names[*k]);
                    let mut parts: Vec<String> = terms.iter().map(term).collect();
                    if *constant != 0.0 {
                        parts.push(figure(*constant));
                    }
                    format!("tied to {}", show::sum(&parts))
                }
            };
            lines.push(format!("mean of `{}`: {fact}", names[i]));
        }
        for regression in &mean.regression {
            let column = &self.model.columns[regression.column].name;
            lines.push(format!("mean of `{}`: moves with column `{column}`", names[regression.element]));
        }
        lines
    }

    /// `place` says where the states vary so, with a space in front, when there is more than one such place.
    pub(crate) fn covariance(&self, place: &str) -> Vec<String> {
        let names = self.model.estimated_names();
        self.structure(&format!("covariance Σ{place}"), &self.model.covariance, &names)
    }

    /// What is said of a covariance of what has these names, which is called `title`.
    pub(crate) fn structure(&self, title: &str, covariance: &CovarianceStructure, names: &[String]) -> Vec<String> {
        if names.is_empty() {
            return Vec::new();
        }
        let kind = match &covariance.kind {
            CovarianceKind::Full => "full".to_owned(),
            CovarianceKind::Diagonal => "diagonal".to_owned(),
            CovarianceKind::Blocks(blocks) => {
                let block =
                    |members: &Vec<usize>| members.iter().map(|&i| names[i].as_str()).collect::<Vec<_>>().join(", ");
                format!("blocks ({})", blocks.iter().map(block).collect::<Vec<_>>().join("; "))
            }
            CovarianceKind::Proportional(matrix) => format!("a common scale times {}", self.matrix(matrix)),
            CovarianceKind::Correlation(matrix) => format!("correlations known, {}", self.matrix(matrix)),
            CovarianceKind::Fixed(matrix) => format!("known, {}", self.matrix(matrix)),
            CovarianceKind::Linear { generators, .. } => {
                format!("linear in {} free quantities", generators.len())
            }
        };
        let mut lines = vec![format!("{title}: {kind}")];
        for fixed in &covariance.fixed {
            let element = match fixed.i == fixed.j {
                true => format!("variance of `{}`", names[fixed.i]),
                false => format!("covariance of `{}, {}`", names[fixed.j], names[fixed.i]),
            };
            lines.push(format!("{element}: fixed at {}", figure(fixed.value)));
        }
        for group in &covariance.equal {
            let elements: Vec<String> = group.iter().map(|(i, j)| format!("`{}, {}`", names[*j], names[*i])).collect();
            lines.push(format!("covariances of {}: equal", elements.join(" and ")));
        }
        if let Some(known) = &covariance.known {
            lines.push(format!("known covariance added to Σ: {}", self.matrix(known)));
        }
        if covariance.start.is_some() {
            lines.push(format!("{title}: starts at the given matrix"));
        }
        lines
    }

    fn matrix(&self, matrix: &[Vec<Expression>]) -> String {
        let row = |row: &Vec<Expression>| {
            let entries: Vec<String> = row.iter().map(|entry| self.shown(entry)).collect();
            format!("[{}]", entries.join(", "))
        };
        format!("[{}]", matrix.iter().map(row).collect::<Vec<_>>().join(", "))
    }

    fn shown(&self, expression: &Expression) -> String {
        show::expression(self.model, expression)
    }
}

fn unit(unit: Option<&str>) -> String {
    unit.map_or(String::new(), |unit| format!(" [{unit}]"))
}
