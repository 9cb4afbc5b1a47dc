//! Directions in the space of all estimates, split into phases, with named elements.

use crate::cut::BlockCut;
use crate::diagnosis::{named, words};
use crate::number::plain;
use crate::{EnteredRecord, InformationRecord, UnidentifiedRecord, WeakRecord};
use kalfit_infer::{Direction, Explanation, Observability, PhaseObservability, Quantity, WeakDirection};
use kalfit_model::PhasedModel;

/// Largest number of terms of a direction that are written out.
const MOST_TERMS: usize = 6;
/// Largest number of entries of a direction that are all listed, zeros too.
const MOST_LISTED: usize = 500;

/// Phases and names of the entries of a direction.
struct Entries {
    /// Phase of each entry.
    phase: Vec<usize>,
    /// Name of each entry without the name of the phase.
    own: Vec<String>,
    /// Names of the phases.
    blocks: Vec<String>,
    /// Name of each entry among all phases, as in a combination: `align.bias`, `cov(align.bias, align.tilt)`.
    full: Vec<String>,
}

/// Entries of the quantities that directions belong to, each made once.
struct EntriesOf {
    mean: Entries,
    covariance: Option<Entries>,
}

impl EntriesOf {
    fn new(model: &PhasedModel, directions: &[Direction]) -> EntriesOf {
        let of_covariance = directions.iter().any(|direction| direction.quantity == Quantity::Covariance);
        EntriesOf { mean: Entries::mean(model, true), covariance: of_covariance.then(|| Entries::covariance(model)) }
    }

    fn get(&self, quantity: Quantity) -> &Entries {
        match (quantity, &self.covariance) {
            (Quantity::Covariance, Some(covariance)) => covariance,
            _ => &self.mean,
        }
    }
}

/// The part of a direction in one phase.
struct PhaseDirection {
    phase: usize,
    direction: Vec<f64>,
    /// Names of the phases that the direction mixes; empty when there is only one.
    phases: Vec<String>,
}

impl Entries {
    /// Elements of μ, then regression coefficients as `state per column`.
    fn mean(model: &PhasedModel, coefficients: bool) -> Entries {
        let mut entries = Entries::none(model);
        let (cuts, full) = (BlockCut::blocks(model), model.element_names());
        for cut in &cuts {
            for (own, k) in cut.states().into_iter().zip(cut.elements.clone()) {
                entries.add(cut, own, full[k].clone());
            }
        }
        for cut in cuts.iter().filter(|cut| coefficients && cut.level.is_none()) {
            let states = cut.states();
            for r in &cut.phase.model.mean.regression {
                let column = &cut.phase.model.columns[r.column].name;
                let full = &full[cut.elements.start + r.element];
                entries.add(cut, format!("{} per {column}", states[r.element]), format!("{full} per {column}"));
            }
        }
        entries
    }

    /// Elements of Σ within a phase, as `first, second`.
    fn covariance(model: &PhasedModel) -> Entries {
        let mut entries = Entries::none(model);
        let full = model.element_names();
        for cut in BlockCut::blocks(model) {
            let (own, full) = (cut.states(), &full[cut.elements.clone()]);
            for (i, j) in (0..own.len()).flat_map(|i| (0..=i).map(move |j| (i, j))) {
                let whole = match i == j {
                    true => format!("var({})", full[i]),
                    false => format!("cov({}, {})", full[j], full[i]),
                };
                entries.add(&cut, format!("{}, {}", own[j], own[i]), whole);
            }
        }
        entries
    }

    fn none(model: &PhasedModel) -> Entries {
        let blocks = BlockCut::blocks(model).iter().map(|cut| cut.name().to_owned()).collect();
        Entries { phase: Vec::new(), own: Vec::new(), blocks, full: Vec::new() }
    }

    fn add(&mut self, cut: &BlockCut<'_>, own: String, full: String) {
        self.phase.push(cut.index);
        self.own.push(own);
        self.full.push(full);
    }

    /// Names of the entries of one phase, without the name of the phase.
    fn names(&self, phase: usize) -> Vec<String> {
        let own = self.own.iter().zip(&self.phase).filter(|(_, of)| **of == phase);
        own.map(|(name, _)| name.clone()).collect()
    }

    /// A direction in one phase with the names of its entries; of very many entries only those that take part.
    fn listed(&self, phase: usize, direction: Vec<f64>) -> (Vec<f64>, Vec<String>) {
        if direction.len() <= MOST_LISTED {
            return (direction, self.names(phase));
        }
        let own = self.own.iter().zip(&self.phase).filter(|(_, of)| **of == phase);
        let part = own.zip(&direction).filter(|(_, weight)| **weight != 0.0);
        part.map(|((name, _), weight)| (*weight, name.clone())).unzip()
    }

    /// The phases that a direction involves.
    fn mixed(&self, direction: &[f64]) -> Vec<usize> {
        let mut involved = vec![self.blocks.len() == 1; self.blocks.len()];
        let own = direction.iter().zip(&self.phase).filter(|(weight, _)| **weight != 0.0);
        own.for_each(|(_, &phase)| involved[phase] = true);
        (0..involved.len()).filter(|&phase| involved[phase]).collect()
    }

    /// The part of a direction in each phase that the direction involves.
    fn parts(&self, direction: &[f64]) -> Vec<PhaseDirection> {
        let mixed = self.mixed(direction);
        let names: Vec<String> = mixed.iter().map(|&i| self.blocks[i].clone()).collect();
        let part = |&phase: &usize| {
            let own = direction.iter().zip(&self.phase).filter(|(_, of)| **of == phase);
            let direction = own.map(|(weight, _)| *weight).collect();
            PhaseDirection { phase, direction, phases: if names.len() > 1 { names.clone() } else { Vec::new() } }
        };
        mixed.iter().map(part).collect()
    }

    /// The direction in words: `0.71 align.bias - 0.71 flight.bias`, the largest terms first.
    fn combination(&self, direction: &[f64]) -> String {
        let weights = direction.iter().zip(&self.full).filter(|(weight, _)| **weight != 0.0);
        let mut terms: Vec<(f64, &String)> = weights.map(|(weight, name)| (*weight, name)).collect();
        terms.sort_by(|a, b| b.0.abs().total_cmp(&a.0.abs()));
        let sign = terms.first().map_or(1.0, |(weight, _)| weight.signum());
        let mut text = String::new();
        for (i, (weight, name)) in terms.iter().take(MOST_TERMS).enumerate() {
            let joint = match (i, weight * sign < 0.0) {
                (0, _) => "",
                (_, true) => " - ",
                (_, false) => " + ",
            };
            let size = weight.abs();
            let shown = if size < 0.01 { format!("{size:.1e}") } else { format!("{size:.2}") };
            text.push_str(&format!("{joint}{shown} {name}"));
        }
        if terms.len() > MOST_TERMS { text + " + …" } else { text }
    }
}

impl UnidentifiedRecord {
    /// Directions with named elements, and reasons in words, by phase. A direction that mixes phases is listed in each
    /// phase, with the part of the phase; [`crossing_notes`] states the whole direction.
    pub fn by_phase(
        model: &PhasedModel,
        directions: &[Direction],
        explanations: &[Explanation],
    ) -> Vec<Vec<UnidentifiedRecord>> {
        let mut records = vec![Vec::new(); BlockCut::blocks(model).len()];
        let known = EntriesOf::new(model, directions);
        for (direction, explanation) in directions.iter().zip(explanations) {
            let entries = known.get(direction.quantity);
            for PhaseDirection { phase, direction: part, phases } in entries.parts(&direction.direction) {
                let (part, elements) = entries.listed(phase, part);
                records[phase].push(UnidentifiedRecord {
                    what: match direction.quantity {
                        Quantity::Mean => "mean".to_owned(),
                        Quantity::Covariance => "covariance".to_owned(),
                    },
                    direction: part,
                    elements,
                    tests: explanation.tests.clone(),
                    reason: words(model, &explanation.reason),
                    phases,
                });
            }
        }
        records
    }
}

impl WeakRecord {
    /// The weakly determined directions, by phase. A direction that mixes phases is listed in each phase, with the part
    /// of the phase; [`crossing_notes`] states the whole direction.
    pub fn by_phase(model: &PhasedModel, seen: &Observability) -> Vec<Vec<WeakRecord>> {
        let entries = Entries::mean(model, false);
        let mut records = vec![Vec::new(); BlockCut::blocks(model).len()];
        for weak in &seen.weak {
            for PhaseDirection { phase, direction, phases } in entries.parts(&weak.direction) {
                let (leading_test, leading_share) = named(&weak.leading);
                let condition = weak.condition;
                records[phase].push(WeakRecord { direction, condition, leading_test, leading_share, phases });
            }
        }
        records
    }
}

impl InformationRecord {
    /// Information that each phase adds; `None` where there is only one phase, or where the information is not known.
    pub fn by_phase(model: &PhasedModel, seen: &[PhaseObservability]) -> Vec<Option<InformationRecord>> {
        if model.is_single() || seen.len() != model.phases.len() {
            return vec![None; model.phases.len()];
        }
        let names = model.estimated_names();
        let record = |(cut, found): (BlockCut<'_>, &PhaseObservability)| InformationRecord {
            own_rank: found.own_rank,
            entering: cut.phase.entering().len(),
            rank_so_far: found.rank_so_far,
            of: cut.elements.end,
            entered: found.entered.iter().map(|weights| entered(&names, weights)).collect(),
        };
        BlockCut::all(model).into_iter().zip(seen).map(|pair| Some(record(pair))).collect()
    }
}

/// A combination of states, without the states of zero weight.
fn entered(names: &[String], weights: &[f64]) -> EnteredRecord {
    let counts = weights.iter().zip(names).filter(|(weight, _)| **weight != 0.0);
    let (direction, elements) = counts.map(|(weight, name)| (*weight, name.clone())).unzip();
    EnteredRecord { direction, elements }
}

/// Notes on directions that mix phases, each a sentence without a full stop.
pub fn crossing_notes(
    model: &PhasedModel,
    directions: &[Direction],
    explanations: &[Explanation],
    seen: &Observability,
) -> Vec<String> {
    let mut notes = Vec::new();
    let known = EntriesOf::new(model, directions);
    for (direction, explanation) in directions.iter().zip(explanations) {
        let entries = known.get(direction.quantity);
        if entries.mixed(&direction.direction).len() > 1 {
            let of = if direction.quantity == Quantity::Mean { " of the means" } else { "" };
            let of_what = if model.levels.is_empty() { "phases" } else { "tests" };
            notes.push(format!(
                "the {of_what} together do not determine the combination {}{of}: {}",
                entries.combination(&direction.direction),
                words(model, &explanation.reason)
            ));
        }
    }
    let entries = Entries::mean(model, false);
    let crosses = |weak: &&WeakDirection| entries.mixed(&weak.direction).len() > 1;
    notes.extend(seen.weak.iter().filter(crosses).map(|weak| {
        format!(
            "weakly determined over the phases: the combination {} of the means is known {} times less precisely than the best known one, in comparable units",
            entries.combination(&weak.direction),
            plain(weak.condition, 2)
        )
    }));
    notes
}
