//! What the levels of crossed factors can tell, in sentences.

use std::collections::{BTreeMap, BTreeSet};

use kalfit_algebra::symmetric::pair;
use kalfit_filter::reduce::{ReductionRef, Reductions};
use kalfit_model::{CovarianceStructure, GroupLevel, Grouping, PhasedModel};

/// Differences between levels below which a note says that their variance is only roughly known: with five, its relative
/// standard error is √(2/5) = 63 %.
const FEW_DIFFERENCES: usize = 5;

/// How two partitions of the tests stand to each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Relation {
    Cross,
    /// Every group of the first meets one group of the second only.
    Inside,
    /// Every group of the second meets one group of the first only.
    Around,
    Same,
}

/// Notes on crossed factors, in sentences without a full stop: factors that do not cross, and variances that rest on few
/// differences. Empty where the tests are not here.
pub fn factor_notes(model: &PhasedModel, grouping: &Grouping, reductions: &Reductions) -> Vec<String> {
    if grouping.tests() == 0 {
        return Vec::new();
    }
    let mut notes = nameless(model, grouping, reductions);
    let level_of = |at: usize| model.levels.len() - 1 - at;
    for (at, factor) in model.factors().iter().enumerate() {
        notes.extend(few(factor, grouping.groups(level_of(at)).len(), model.dimension()));
        for (beside, other) in model.levels.iter().enumerate().skip(at + 1) {
            // a factor crosses a nested level if it crosses the outermost one; the inner ones say nothing new
            let is_outermost = other.crossed || beside == model.factors().len();
            let has_slots = [factor, other].iter().any(|level| !level.members.is_empty());
            if is_outermost && !has_slots {
                notes.extend(relation_note(factor, other, relation(grouping, level_of(at), level_of(beside))));
            }
        }
    }
    notes
}

/// Slots without a name in tests that measure their states.
fn nameless(model: &PhasedModel, grouping: &Grouping, reductions: &Reductions) -> Vec<String> {
    let mut notes = Vec::new();
    for (at, factor) in model.factors().iter().enumerate() {
        let level = model.levels.len() - 1 - at;
        for member in &factor.members {
            let is_nameless = |test: &ReductionRef<'_>| {
                let Some(number) = grouping.number(test.test) else { return false };
                let is_empty = grouping.members(number, level).all(|own| own.selection != Some(&member.selection));
                let informs = |state: usize| test.factor[pair(state, 0)..][..=state].iter().any(|x| *x != 0.0);
                is_empty && member.selection.pairs().iter().any(|&(state, _)| informs(state))
            };
            let tests: Vec<&str> = reductions.iter().filter(is_nameless).map(|test| test.test).collect();
            if let Some(first) = tests.iter().min() {
                let others = match tests.len() {
                    1 => String::new(),
                    count => format!(", and in {} other tests", count - 1),
                };
                notes.push(format!(
                    "slot `{}` of `{}` has no name in test `{first}`{others}, but is measured there: what is in it is taken as \
                     one without an effect of its own",
                    member.slot, factor.name
                ));
            }
        }
    }
    notes
}

/// How the groups of one level stand to those of another.
fn relation(grouping: &Grouping, one: usize, other: usize) -> Relation {
    let mut met: [BTreeMap<usize, BTreeSet<usize>>; 2] = Default::default();
    for test in 0..grouping.tests() {
        let groups = [grouping.group_of(test, one), grouping.group_of(test, other)];
        met[0].entry(groups[0]).or_default().insert(groups[1]);
        met[1].entry(groups[1]).or_default().insert(groups[0]);
    }
    let each_meets_one = |of: &BTreeMap<usize, BTreeSet<usize>>| of.values().all(|others| others.len() == 1);
    match (each_meets_one(&met[0]), each_meets_one(&met[1])) {
        (true, true) => Relation::Same,
        (true, false) => Relation::Inside,
        (false, true) => Relation::Around,
        (false, false) => Relation::Cross,
    }
}

fn relation_note(factor: &GroupLevel, other: &GroupLevel, relation: Relation) -> Option<String> {
    let (own, name) = (&factor.name, &other.name);
    match relation {
        Relation::Cross => None,
        Relation::Same => Some(format!(
            "`{own}` and `{name}` divide the tests alike: of states that vary with both, only the sum of their effects is known"
        )),
        Relation::Around => Some(format!(
            "`{own}` does not cross `{name}`: every `{name}` meets one `{own}` only, so `{own}` is a level around it"
        )),
        Relation::Inside => {
            Some(format!("`{own}` does not cross `{name}`: every `{own}` meets one `{name}` only, so it nests in it"))
        }
    }
}

/// What a factor with few levels can tell.
fn few(factor: &GroupLevel, levels: usize, states: usize) -> Option<String> {
    let (name, differences) = (&factor.name, levels.checked_sub(1).filter(|differences| *differences > 0)?);
    let varying = states - still(&factor.covariance).len();
    if varying == 0 || differences >= FEW_DIFFERENCES {
        return None;
    }
    let rests = match differences {
        1 => format!("`{name}` has 2 levels: each of its variances rests on one difference"),
        _ => format!("`{name}` has {levels} levels: each of its variances rests on {differences} differences"),
    };
    let rank = match varying > differences {
        true => format!("; a covariance of {varying} states is then singular whatever the states are"),
        false => String::new(),
    };
    Some(format!(
        "{rests}, so that its standard error is a rough guide{rank}; `--intervals profile` gives intervals, and a \
         `regression` on a column of 0 and 1 for each level takes its effects as fixed"
    ))
}

/// The states that do not vary.
fn still(covariance: &CovarianceStructure) -> BTreeSet<usize> {
    let zero = covariance.fixed.iter().filter(|element| element.i == element.j && element.value == 0.0);
    zero.map(|element| element.i).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use kalfit_model::Label;

    #[test]
    fn partitions_are_told_apart() {
        let path = |names: [usize; 2]| names.map(Label::literal).to_vec();
        let of = |tests: &[[usize; 2]]| {
            let ids: Vec<String> = (0..tests.len()).map(|j| j.to_string()).collect();
            let named = ids.iter().zip(tests).map(|(id, names)| (id.as_str(), path(*names)));
            relation(&Grouping::crossed((2, 0), named), 1, 0)
        };
        assert_eq!(of(&[[0, 0], [0, 1], [1, 0]]), Relation::Cross);
        assert_eq!(of(&[[0, 0], [0, 1], [1, 2]]), Relation::Around);
        assert_eq!(of(&[[0, 0], [1, 0], [2, 1]]), Relation::Inside);
        assert_eq!(of(&[[0, 5], [1, 6], [0, 5]]), Relation::Same);
    }
}
