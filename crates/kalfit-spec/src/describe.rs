//! The model in plain words.

use kalfit::TestKey;
use kalfit::model::{
    Clock, CovarianceKind, Expression, Initial, MeanElement, Measurement, Motion, Parameter, State, Value,
};

use crate::Spec;
use crate::expression::is_zero;
use crate::show::{self, figure};

impl Spec {
    /// The model in plain words, one fact a line: tests and steps, states with their motion and start, measurements,
    /// parameters, the order of μ and Σ, and the constraints on them.
    pub fn describe(&self) -> Vec<String> {
        let mut lines = vec![self.tests(), self.steps()];
        lines.extend(self.model.shared().states.iter().map(|state| self.state(state)));
        lines.extend(self.covariances("process noise", &self.model.shared().process_noise_covariance, &|i| {
            self.model.shared().states[i].name.clone()
        }));
        lines.extend(self.model.shared().measurements.iter().map(|measurement| self.measurement(measurement)));
        lines.extend(self.covariances("measurement noise", &self.model.shared().noise_covariance, &|i| {
            self.model.shared().measurements[i].name.clone()
        }));
        lines.extend(self.model.shared().parameters.iter().map(|parameter| self.parameter(parameter)));
        lines.push(self.order());
        lines.extend(self.mean());
        lines.extend(self.covariance());
        lines
    }

    fn tests(&self) -> String {
        let group = self.model.shared().group.map_or(String::new(), |column| {
            format!("; reports are grouped by column `{}`", self.model.shared().text_columns[column].name)
        });
        match &self.layout.test {
            TestKey::Single => format!("tests: all rows are one test{group}"),
            TestKey::Column(name) => format!("tests: one for each value of column `{name}`{group}"),
            TestKey::File => format!("tests: one for each file{group}"),
        }
    }

    fn steps(&self) -> String {
        let Clock { time, unit, initial_time, step_first, previous_inputs } = &self.model.shared().clock;
        let unit = unit.as_ref().map_or(String::new(), |unit| format!(" [{unit}]"));
        let steps = match time {
            Some(column) => {
                format!("steps: rows of equal time, column `{}`{unit}", self.model.shared().columns[*column].name)
            }
            None => "steps: one for each row".to_owned(),
        };
        let start = match initial_time {
            Some(time) => format!("x_0 is at time {}", self.shown(time)),
            None if *step_first => "one step from x_0 to the first row".to_owned(),
            None => "x_0 is at the first row".to_owned(),
        };
        let inputs = if *previous_inputs { "; a step uses the columns of the row it starts from" } else { "" };
        format!("{steps}; {start}{inputs}")
    }

    fn state(&self, state: &State) -> String {
        let motion = match &state.motion {
            Motion::Constant => "constant".to_owned(),
            Motion::Continuous { derivative, noise_variance } => {
                let driven = self.driven(noise_variance, ["per unit of time", "per square root of a unit of time"]);
                format!("d/dt = {}{driven}", show::linear(self.model.shared(), derivative))
            }
            Motion::Discrete { next, noise_variance } => {
                let driven = self.driven(noise_variance, ["per step"; 2]);
                format!("next = {}{driven}", show::linear(self.model.shared(), next))
            }
        };
        let start = match &state.initial {
            Initial::Estimated if state.random => "start estimated".to_owned(),
            Initial::Estimated => "start estimated, one value common to all tests".to_owned(),
            Initial::Stationary => "start in its stationary law".to_owned(),
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
        let (noise, deviation) = show::noise(self.model.shared(), variance);
        format!(" + {noise} {}", per[usize::from(deviation)])
    }

    fn measurement(&self, measurement: &Measurement) -> String {
        let rows = measurement.filter.as_ref();
        let rows = rows.map_or(String::new(), |filter| format!(" (rows where {})", self.shown(filter)));
        let column = &self.model.shared().columns[measurement.column].name;
        let noise = match is_zero(&measurement.noise_variance) {
            true => "without noise".to_owned(),
            false => show::noise(self.model.shared(), &measurement.noise_variance).0,
        };
        let equation = show::linear(self.model.shared(), &measurement.equation);
        format!("measurement `{}`: column `{column}`{rows} reads {equation}; {noise}", measurement.name)
    }

    fn covariances(
        &self,
        what: &str,
        covariances: &[(usize, usize, Expression)],
        name: &dyn Fn(usize) -> String,
    ) -> Vec<String> {
        covariances
            .iter()
            .map(|(i, j, value)| {
                format!("{what} of `{}` and `{}`: covariance {}", name(*j), name(*i), self.shown(value))
            })
            .collect()
    }

    fn parameter(&self, parameter: &Parameter) -> String {
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
        facts.extend(parameter.per.map(|column| {
            format!("one value for each value of column `{}`", self.model.shared().text_columns[column].name)
        }));
        for (literal, value) in &parameter.fixed_levels {
            facts.push(format!("fixed at {} for '{}'", figure(*value), self.model.shared().literals[*literal]));
        }
        format!("parameter `{}`{}: {}", parameter.name, unit(parameter.unit.as_deref()), facts.join(", "))
    }

    fn order(&self) -> String {
        let names = self.model.estimated_names();
        if names.is_empty() {
            return "no state has an estimated start: there is no μ and no Σ".to_owned();
        }
        format!("order of μ and Σ: {}", names.join(", "))
    }

    fn mean(&self) -> Vec<String> {
        let (mean, names) = (&self.model.shared().mean, self.model.estimated_names());
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
            let column = &self.model.shared().columns[regression.column].name;
            lines.push(format!("mean of `{}`: moves with column `{column}`", names[regression.element]));
        }
        lines
    }

    fn covariance(&self) -> Vec<String> {
        let (covariance, names) = (&self.model.shared().covariance, self.model.estimated_names());
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
        let mut lines = vec![format!("covariance Σ: {kind}")];
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
            lines.push("covariance Σ: starts at the given matrix".to_owned());
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
        show::expression(self.model.shared(), expression)
    }
}

fn unit(unit: Option<&str>) -> String {
    unit.map_or(String::new(), |unit| format!(" [{unit}]"))
}
