//! Digests: of a text, and of what reductions depend on.

use std::fmt::Write;

use kalfit::model::{Clock, Expression, Filter, Initial, Linear, Model, Motion, Phase, PhasedModel};
use sha2::{Digest, Sha256};

use crate::spec::Spec;
use crate::vocabulary::{function, symbol};

/// First line of the text that is digested; another one when what stands there changes.
const VERSION: &str = "kalfit-reduction/1";

/// `sha256:` and 64 hexadecimal digits.
pub(crate) fn of_text(text: &str) -> String {
    let bytes = Sha256::digest(text.as_bytes());
    let hex: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
    format!("sha256:{hex}")
}

impl Spec {
    /// `sha256:` and 64 hexadecimal digits: the digest of all that the reductions of a test depend on beside its data and the
    /// values of the parameters, for telling whether reductions or estimates were made with this model.
    ///
    /// In it are, by name, of each phase: states with motion, start and offset, measurements, noises, clock, the order of the
    /// estimated states, the `known` covariance, regression columns, `carry` and `filter`. Not in it are titles, units of
    /// states, constraints on μ and Σ, values, start values and bounds of parameters, how rows become tests, and the levels of
    /// groups that these stand in: the reduction of a test is the same whatever group it is of.
    pub fn reduction_digest(&self) -> String {
        of_text(&canonical(&self.model))
    }

    /// 16 hexadecimal digits: a digest of this model file and the name of a group, for telling whether two places that have the same
    /// file have the same group.
    pub fn group_digest(&self, group: &str) -> String {
        let digest = of_text(&format!("{}\n{group}", self.digest));
        digest.chars().skip("sha256:".len()).take(16).collect()
    }
}

/// The text that is digested: the same for models whose reductions are the same thing, wherever their columns, texts and
/// parameters stand in their lists.
fn canonical(model: &PhasedModel) -> String {
    let mut text = format!("{VERSION}\n");
    let mut before = None;
    for phase in &model.phases {
        DigestWriter { model: &phase.model, text: &mut text }.phase(phase, before);
        before = Some(&phase.model);
    }
    text
}

struct DigestWriter<'w> {
    model: &'w Model,
    text: &'w mut String,
}

impl DigestWriter<'_> {
    fn phase(&mut self, phase: &Phase, before: Option<&Model>) {
        self.word(&format!("phase {}", quote(&phase.name)));
        self.clock();
        self.states();
        self.measurements();
        self.population();
        for carry in &phase.carry {
            let before = before.expect("the first phase carries nothing");
            self.word(&format!("carry {}", quote(&self.model.states[carry.state].name)));
            self.linear(before, &carry.from);
        }
        if let Some(filter) = &phase.filter {
            self.filter(filter);
        }
    }

    fn clock(&mut self) {
        let Clock { time, unit, initial_time, step_first, previous_inputs } = &self.model.clock;
        let time = time.map_or("none".to_owned(), |column| quote(&self.model.columns[column].name));
        let unit = unit.as_ref().map_or("none".to_owned(), |unit| quote(unit));
        self.word(&format!("clock {time} {unit} {step_first} {previous_inputs}"));
        self.maybe(initial_time.as_ref());
    }

    fn states(&mut self) {
        for state in &self.model.states {
            self.word(&format!("state {}", quote(&state.name)));
            match &state.motion {
                Motion::Constant => self.word("constant"),
                Motion::Continuous { derivative, noise_variance } => {
                    self.word("derivative");
                    self.linear(self.model, derivative);
                    self.expression(noise_variance);
                }
                Motion::Discrete { next, noise_variance } => {
                    self.word("next");
                    self.linear(self.model, next);
                    self.expression(noise_variance);
                }
            }
            match &state.initial {
                Initial::Estimated => self.word("estimated"),
                Initial::Stationary => self.word("stationary"),
                Initial::Known { mean, variance } => {
                    self.word("known");
                    self.expression(mean);
                    self.expression(variance);
                }
            }
            self.maybe(state.offset.as_ref());
        }
        self.covariances("process", &self.model.process_noise_covariance);
    }

    fn measurements(&mut self) {
        for measurement in &self.model.measurements {
            self.word(&format!("measurement {}", quote(&self.model.columns[measurement.column].name)));
            self.maybe(measurement.filter.as_ref());
            self.linear(self.model, &measurement.equation);
            self.expression(&measurement.noise_variance);
        }
        self.covariances("noise", &self.model.noise_covariance);
    }

    fn covariances(&mut self, what: &str, covariances: &[(usize, usize, Expression)]) {
        let mut sorted: Vec<_> = covariances.iter().collect();
        sorted.sort_by_key(|(i, j, _)| (*i, *j));
        for (i, j, value) in sorted {
            self.word(&format!("{what} {i} {j}"));
            self.expression(value);
        }
    }

    fn population(&mut self) {
        let order: Vec<String> = self.model.estimated_names().iter().map(|name| quote(name)).collect();
        self.word(&format!("order {}", order.join(" ")));
        for entry in self.model.covariance.known.iter().flatten().flatten() {
            self.expression(entry);
        }
        for regression in &self.model.mean.regression {
            let column = quote(&self.model.columns[regression.column].name);
            self.word(&format!("regression {} {column}", regression.element));
        }
    }

    fn filter(&mut self, Filter { consider, mean, covariance, parameters }: &Filter) {
        self.word(&format!("filter {consider:?} {mean:?} {:?}", covariance.as_slice()));
        let mut believed: Vec<(&str, f64)> =
            parameters.iter().map(|(i, value)| (self.model.parameters[*i].name.as_str(), *value)).collect();
        believed.sort_by_key(|(name, _)| *name);
        for (name, value) in believed {
            self.word(&format!("believes {} {value:?}", quote(name)));
        }
    }

    /// A linear form in the states of `of`.
    fn linear(&mut self, of: &Model, form: &Linear) {
        for (state, coefficient) in &form.terms {
            self.word(&format!("of {}", quote(&of.states[*state].name)));
            self.expression(coefficient);
        }
        self.expression(&form.constant);
    }

    fn maybe(&mut self, expression: Option<&Expression>) {
        match expression {
            None => self.word("none"),
            Some(expression) => self.expression(expression),
        }
    }

    /// In prefix form.
    fn expression(&mut self, a: &Expression) {
        match a {
            Expression::Number(x) => self.word(&format!("{x:?}")),
            Expression::Column(column) => self.word(&format!("column {}", quote(&self.model.columns[*column].name))),
            Expression::Step => self.word("dt"),
            Expression::Parameter(index) => {
                let parameter = &self.model.parameters[*index];
                let per = parameter.per.map(|column| quote(&self.model.text_columns[column].name));
                self.word(&format!("parameter {} {}", quote(&parameter.name), per.as_deref().unwrap_or("none")));
            }
            Expression::TextEquals { column, literal } => {
                let (column, literal) = (&self.model.text_columns[*column].name, &self.model.literals[*literal]);
                self.word(&format!("text {} {}", quote(column), quote(literal)));
            }
            Expression::Negate(a) => self.parts("negate", &[a]),
            Expression::Not(a) => self.parts("not", &[a]),
            Expression::Binary(operator, a, b) => self.parts(symbol(*operator), &[a, b]),
            Expression::Call(called, arguments) => {
                self.parts(function(*called), &arguments.iter().collect::<Vec<_>>());
            }
            Expression::If(a, b, c) => self.parts("if", &[a, b, c]),
        }
    }

    fn parts(&mut self, head: &str, parts: &[&Expression]) {
        self.word(&format!("({head}"));
        for part in parts {
            self.expression(part);
        }
        self.word(")");
    }

    fn word(&mut self, word: &str) {
        writeln!(self.text, "{word}").expect("a string takes all that is written");
    }
}

/// A name with its length, so that no name can look like what stands around it.
fn quote(name: &str) -> String {
    format!("{}:{name}", name.len())
}
