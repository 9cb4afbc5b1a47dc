//! The whole model in plain words.

use kalfit::TestKey;
use kalfit::model::{Filter, Membership, Model, Phase};

use crate::figure::figure;
use crate::show;
use crate::spec::Spec;
use crate::words::ModelWords;

impl Spec {
    /// The model in plain words, one fact a line: tests and steps, states with their motion and start, measurements,
    /// parameters, the order of μ and Σ, the constraints on them, the levels of groups, and the filter. Of a model in phases, what belongs to a phase
    /// follows a line that names it.
    pub fn describe(&self) -> Vec<String> {
        let words = ModelWords { model: self.model.shared() };
        let parameters = words.model.parameters.iter().map(|parameter| words.parameter(parameter));
        let mut lines = vec![self.tests()];
        if self.phase_span(&self.model.phases[0].name).is_some() {
            lines.extend([words.steps(None), self.phases()]);
            lines.extend(parameters);
            for (i, phase) in self.model.phases.iter().enumerate() {
                let before = i.checked_sub(1).map(|before| &self.model.phases[before]);
                lines.extend(block(phase, before));
            }
        } else {
            let phase = &self.model.phases[0];
            lines.push(words.steps(Some("the first row")));
            lines.extend(motion(&phase.model));
            lines.extend(measured(&phase.model));
            lines.extend(parameters);
            let within = self.model.nested().last().map(|level| format!(" from test to test of one `{}`", level.name));
            lines.extend(population(&phase.model, &within.unwrap_or_default()));
            lines.extend(self.levels());
            lines.extend(filter(phase));
        }
        lines
    }

    /// What varies from group to group, level by level, and from level to level of each crossed factor.
    fn levels(&self) -> Vec<String> {
        let words = ModelWords { model: self.model.shared() };
        let states = self.model.shared().estimated_names();
        let mut lines = Vec::new();
        for (depth, level) in self.model.nested().iter().enumerate() {
            let groups = format!("one group for each value of {}", columns(&self.layout.levels[..=depth]));
            lines.push(format!("level `{}`: {groups}", level.name));
            let facts = words.structure("covariance Σ from group to group", &level.covariance, &states);
            lines.extend(facts.into_iter().map(|fact| format!("level `{}`: {fact}", level.name)));
        }
        for factor in self.model.factors() {
            let name = &factor.name;
            let column = |column: usize| &self.model.shared().text_columns[column].name;
            let slot = |member: &Membership| format!("`{}` in slot `{}`", column(member.column), member.slot);
            let of = match &factor.members[..] {
                [] => format!("column `{name}`"),
                members => format!("columns {}", members.iter().map(slot).collect::<Vec<_>>().join(", ")),
            };
            lines.push(format!("crossed factor `{name}`: one effect for each value of {of}"));
            let what = format!("covariance Σ from {name} to {name}");
            // that a state without an effect has no variance is no constraint
            let mut covariance = factor.covariance.clone();
            covariance.fixed.retain(|element| factor.has_effect(element.i) && factor.has_effect(element.j));
            let facts = words.structure(&what, &covariance, &factor.effect_names(&states));
            lines.extend(facts.into_iter().map(|fact| format!("crossed factor `{name}`: {fact}")));
        }
        lines
    }

    fn tests(&self) -> String {
        let group = self.model.shared().group.map_or(String::new(), |column| {
            format!("; reports are grouped by column `{}`", self.model.shared().text_columns[column].name)
        });
        match &self.layout.test {
            TestKey::Single => format!("tests: all rows are one test{group}"),
            TestKey::Column(name) => {
                let names = [&self.layout.levels[..], std::slice::from_ref(name)].concat();
                format!("tests: one for each value of {}{group}", columns(&names))
            }
            TestKey::File => format!("tests: one for each file{group}"),
            TestKey::Row => format!("tests: each row is one test{group}"),
        }
    }

    fn phases(&self) -> String {
        let names: Vec<String> = self.model.phases.iter().map(|phase| format!("`{}`", phase.name)).collect();
        let told = self.model.column.map_or(String::new(), |column| {
            format!("; column `{}` tells the phase of a row", self.model.shared().text_columns[column].name)
        });
        format!("phases: {}{told}", names.join(", then "))
    }
}

/// "column `lot`", or "columns `lot` and `serial` together".
fn columns(names: &[String]) -> String {
    let quoted: Vec<String> = names.iter().map(|name| format!("`{name}`")).collect();
    match quoted.as_slice() {
        [only] => format!("column {only}"),
        [before @ .., last] => format!("columns {} and {last} together", before.join(", ")),
        [] => String::new(),
    }
}

/// One phase: where it starts, its states, what they inherit, its measurements, its part of μ and Σ, and its filter.
fn block(phase: &Phase, before: Option<&Phase>) -> Vec<String> {
    let words = ModelWords { model: &phase.model };
    let mut lines = vec![format!("phase `{}`: {}", phase.name, words.start("its first row"))];
    lines.extend(motion(&phase.model));
    lines.extend(before.iter().flat_map(|before| carried(phase, before)));
    lines.extend(measured(&phase.model));
    lines.extend(population(&phase.model, ""));
    lines.extend(filter(phase));
    lines
}

fn motion(model: &Model) -> Vec<String> {
    let words = ModelWords { model };
    let states = model.states.iter().map(|state| words.state(state));
    states.chain(words.process_noise_covariance()).collect()
}

fn measured(model: &Model) -> Vec<String> {
    let words = ModelWords { model };
    let measurements = model.measurements.iter().map(|measurement| words.measurement(measurement));
    measurements.chain(words.noise_covariance()).collect()
}

fn population(model: &Model, place: &str) -> Vec<String> {
    let words = ModelWords { model };
    [vec![words.order()], words.mean(), words.covariance(place)].concat()
}

fn carried(phase: &Phase, before: &Phase) -> Vec<String> {
    if phase.carry.is_empty() {
        return vec![format!("nothing is inherited from phase `{}`", before.name)];
    }
    let inherits = |state: usize, from: String| {
        format!("state `{}` inherits {from}, as phase `{}` ends", phase.model.states[state].name, before.name)
    };
    phase.carry.iter().map(|carry| inherits(carry.state, show::linear(&before.model, &carry.from))).collect()
}

fn filter(phase: &Phase) -> Vec<String> {
    let Some(Filter { consider, mean, covariance, parameters }) = &phase.filter else { return Vec::new() };
    let names = |states: &mut dyn Iterator<Item = usize>| {
        let names: Vec<String> = states.map(|state| format!("`{}`", phase.model.states[state].name)).collect();
        if names.is_empty() { "no state".to_owned() } else { names.join(", ") }
    };
    let estimated = names(&mut (0..mean.len()).filter(|state| !consider.contains(state)));
    let considered = names(&mut consider.iter().copied());
    let list =
        |numbers: &mut dyn Iterator<Item = f64>| format!("[{}]", numbers.map(figure).collect::<Vec<_>>().join(", "));
    let rows: Vec<String> = covariance.row_iter().map(|row| list(&mut row.iter().copied())).collect();
    let mut lines = vec![
        "filter: Kalman-Schmidt; its estimates stand for the measurements".to_owned(),
        format!("filter: estimates {estimated}; considers {considered}"),
        format!("filter: prior mean {}, prior covariance [{}]", list(&mut mean.iter().copied()), rows.join(", ")),
    ];
    for (parameter, value) in parameters {
        lines.push(format!(
            "filter: believes that `{}` is {}",
            phase.model.parameters[*parameter].name,
            figure(*value)
        ));
    }
    lines
}
