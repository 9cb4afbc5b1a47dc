//! Expected standard errors of tests in groups: are more units needed, or more runs of each?

use std::sync::Arc;

use crate::plan::Quantity;
use crate::plan::{Expected, Plan, PlanError, Planned, Reason, quantities};
use kalfit_estimate::Structure;
use kalfit_filter::reduce::Reductions;
use kalfit_model::Population;
use kalfit_model::Reduction;
use kalfit_model::{Grouping, Label, Selection};

/// Largest number of tests in an arrangement.
const MOST_TESTS: usize = 200_000;

/// Number of groups in each group, and number of tests in each innermost group.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Arrangement {
    /// Number of levels of each crossed factor, which tests meet in turn.
    pub factors: Vec<usize>,
    /// Number of groups of each level in one group of the level above, the outermost level first.
    pub groups: Vec<usize>,
    /// Number of tests in each group of the innermost level.
    pub tests: usize,
}

impl Arrangement {
    /// Number of all tests.
    pub fn total(&self) -> usize {
        self.groups.iter().fold(self.tests, |product, groups| product.saturating_mul(*groups))
    }

    /// For each block of Σ (of the tests, then of the levels, the innermost first) and last for the mean: index of the
    /// first block that cannot be separated from the block. Variation within groups can be separated from variation
    /// between groups only where groups have several members.
    fn confounded_with(&self) -> Vec<usize> {
        let members = std::iter::once(self.tests).chain(self.groups.iter().rev().copied());
        let mut first = vec![0];
        first.extend(members.enumerate().scan(0, |least, (block, members)| {
            *least = if members == 1 { *least } else { block + 1 };
            Some(*least)
        }));
        first
    }

    /// The levels of the factors that a test meets, a level for each slot. Tests meet the levels of a factor in turn; each
    /// time that the levels of the factors before it have had their turns, a factor moves on by one, so that all levels
    /// of two factors meet. The members of one test are neighbours at first, then further apart.
    fn levels(&self, test: usize, slots: &[usize]) -> Vec<usize> {
        let mut before = 1;
        let mut met = Vec::new();
        for (&levels, &slots) in self.factors.iter().zip(slots) {
            // the place among the turns of the factors before it, moved on by one after each of their rounds
            let turn = test % before + test / before;
            let apart = 1 + (test / levels) % levels.saturating_sub(1).max(1);
            met.extend((0..slots.max(1)).map(|slot| (turn + slot * apart) % levels));
            before *= levels;
        }
        met
    }

    /// For each test, the index of the group at each level, among the groups within one group of the level above.
    fn paths(&self) -> Vec<Vec<usize>> {
        let start = vec![Vec::new()];
        let level = |paths: Vec<Vec<usize>>, &count: &usize| -> Vec<Vec<usize>> {
            let more = |path: &Vec<usize>, k: usize| path.iter().copied().chain([k]).collect();
            paths.iter().flat_map(|path| (0..count).map(move |k| more(path, k))).collect()
        };
        let groups = self.groups.iter().fold(start, level);
        groups.into_iter().flat_map(|path| std::iter::repeat_n(path, self.tests)).collect()
    }
}

/// Expected standard errors for each arrangement of tests like the tests of `reductions`, the design. `structure` is of
/// a model with levels; `population` has one block for the tests and one for each level. Group k of an arrangement is
/// like group k mod n of the n groups of the design, and test k of a group likewise; all tests of the design are one
/// group where the structure has no grouping.
///
/// # Errors
/// The errors of [`plan`](crate::plan::plan); arrangements of too many tests.
pub fn plan_groups(
    reductions: &Reductions,
    structure: &Structure<'_>,
    population: &Population,
    arrangements: &[Arrangement],
) -> Result<Plan, PlanError> {
    let regressions = structure.regressions().len();
    population.check_named(structure.dimension(), regressions, &|i| (i + 1).to_string())?;
    let ids: Vec<&str> = reductions.iter().map(|design| design.test).collect();
    let of_design = structure.grouping.as_deref();
    let nested = of_design.map_or(structure.phases.len() - 1, Grouping::nested);
    let groups = DesignGroups::new(&ids, of_design.filter(|_| nested > 0), nested);
    let slots: Vec<Vec<Arc<Selection>>> = of_design.map_or(Vec::new(), |grouping| {
        (nested..grouping.depth()).rev().map(|level| grouping.slots_of(level).to_vec()).collect()
    });
    let all: Vec<Expected> = arrangements
        .iter()
        .map(|one| {
            let (tests, grouping) = arranged(reductions, (&groups, &slots), one)?;
            Expected::of(&tests, &Structure { grouping: Some(grouping), ..structure.clone() }, population)
        })
        .collect::<Result<_, _>>()?;
    let own = structure.phases[0].mean.elements.len();
    let has_mean = |quantity: &Quantity| !matches!(quantity, Quantity::Mean(i) if *i >= own);
    let planned = |quantity: Quantity| {
        let errors: Vec<Result<f64, Reason>> = all
            .iter()
            .zip(arrangements)
            .map(|(found, one)| {
                let found = found.at(population);
                let error = found.error(quantity).ok_or_else(|| found.reason(quantity))?;
                if is_separable(quantity, own, population, &one.confounded_with()) {
                    Ok(error)
                } else {
                    Err(Reason::Unidentified)
                }
            })
            .collect();
        let known = errors.iter().any(Result::is_ok);
        let std_errors = match errors.iter().find_map(|error| error.err()) {
            Some(reason) if !known => Err(reason),
            _ => Ok(errors.into_iter().map(|error| error.unwrap_or(f64::INFINITY)).collect()),
        };
        Planned { quantity, value: all.first().and_then(|found| found.at(population).value(quantity)), std_errors }
    };
    let Some(first) = all.first() else { return Err(PlanError::ZeroTests) };
    let elements = &first.state.problem.covariance.elements;
    Ok(Plan {
        design_tests: reductions.len(),
        tests: arrangements.iter().map(Arrangement::total).collect(),
        arrangements: arrangements.to_vec(),
        quantities: quantities(elements, regressions).into_iter().filter(has_mean).map(planned).collect(),
    })
}

/// Whether a quantity of Σ can be separated from the mean and from every other block of Σ in which the state varies.
/// Each block has `own` states.
fn is_separable(quantity: Quantity, own: usize, population: &Population, confounded_with: &[usize]) -> bool {
    let (Quantity::StdDev(i) | Quantity::Correlation(i, _) | Quantity::Covariance(i, _)) = quantity else {
        return true;
    };
    let (block, mean) = (i / own, confounded_with.len() - 1);
    if block >= mean {
        return true; // of a factor: whether it can be separated is seen in the information
    }
    let varies =
        |other: usize| other == mean || population.covariance[(other * own + i % own, other * own + i % own)] > 0.0;
    (0..confounded_with.len())
        .all(|other| other == block || confounded_with[other] != confounded_with[block] || !varies(other))
}

/// Indices of the members of each group of a design.
struct DesignGroups {
    /// For each level, the outermost first, and each group of the level above (for the outermost level, one root):
    /// indices of the groups within the group.
    inner: Vec<Vec<Vec<usize>>>,
    /// Indices of the tests of each group of the innermost level.
    tests: Vec<Vec<usize>>,
}

impl DesignGroups {
    /// Groups of the tests `ids` in `levels` levels; all tests are in one group where `grouping` is `None`.
    fn new(ids: &[&str], grouping: Option<&Grouping>, levels: usize) -> DesignGroups {
        let Some(own) = grouping else {
            return DesignGroups { inner: vec![vec![vec![0]]; levels], tests: vec![(0..ids.len()).collect()] };
        };
        let mut inner = vec![vec![(0..own.groups(levels - 1).len()).collect()]];
        for level in (1..levels).rev() {
            let mut groups = vec![Vec::new(); own.groups(level).len()];
            for (number, group) in own.groups(level - 1).iter().enumerate() {
                groups[group.parent.expect("there is a level above")].push(number);
            }
            inner.push(groups);
        }
        let mut tests = vec![Vec::new(); own.groups(0).len()];
        for (number, id) in ids.iter().enumerate() {
            let place = own.number(id).expect("it was grouped");
            tests[own.group_of(place, 0)].push(number);
        }
        DesignGroups { inner, tests }
    }

    /// Index of the test of the design that test `number` of the group at `path` is like.
    fn like(&self, path: &[usize], number: usize) -> usize {
        let group = path.iter().zip(&self.inner).fold(0, |group, (&at, inner)| {
            let own = &inner[group];
            own[at % own.len()]
        });
        let tests = &self.tests[group];
        tests[number % tests.len()]
    }
}

/// Tests like the tests of the design, in the groups of an arrangement.
fn arranged(
    design: &Reductions,
    (groups, slots): (&DesignGroups, &[Vec<Arc<Selection>>]),
    arrangement: &Arrangement,
) -> Result<(Reductions, Arc<Grouping>), PlanError> {
    let total = arrangement.total();
    if total == 0 || design.is_empty() || arrangement.factors.contains(&0) {
        return Err(PlanError::ZeroTests);
    }
    let slotted = arrangement.factors.iter().zip(slots);
    if let Some((&found, slots)) = slotted.into_iter().find(|(levels, slots)| **levels < slots.len()) {
        return Err(PlanError::TooFewLevels { found, slots: slots.len() });
    }
    if total > MOST_TESTS {
        return Err(PlanError::TooManyTests { found: total, most: MOST_TESTS });
    }
    let ids: Vec<String> = (0..total).map(|test| test.to_string()).collect();
    let paths = arrangement.paths();
    let like = |(test, id): (usize, &String)| {
        let number = groups.like(&paths[test], test % arrangement.tests);
        Reduction { test: id.clone(), ..design.get(number).into() }
    };
    let tests = ids.iter().enumerate().map(like).collect();
    let widths: Vec<usize> = slots.iter().map(Vec::len).collect();
    let names = |(test, path): (usize, &Vec<usize>)| {
        arrangement.levels(test, &widths).iter().chain(path).map(|&k| Label::literal(k)).collect()
    };
    let paths = ids.iter().map(String::as_str).zip(paths.iter().enumerate().map(names));
    Ok((tests, Arc::new(Grouping::with_slots(slots.to_vec(), arrangement.groups.len(), paths))))
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector};

    use super::{Arrangement, DesignGroups, is_separable};
    use crate::plan::Quantity;
    use kalfit_model::Population;
    use kalfit_model::{Grouping, Label};

    #[test]
    fn what_has_one_member_is_not_told_from_what_it_stands_in() {
        let of =
            |groups: &[usize], tests| Arrangement { factors: vec![], groups: groups.to_vec(), tests }.confounded_with();
        assert_eq!(of(&[8], 5), [0, 1, 2]);
        assert_eq!(of(&[8], 1), [0, 0, 2], "one test of each unit");
        assert_eq!(of(&[1], 5), [0, 1, 1], "one unit: its own part is not told from the mean");
        assert_eq!(of(&[4, 1], 3), [0, 1, 1, 3], "one unit of each lot");
    }

    #[test]
    fn groups_are_like_those_of_the_design_one_after_the_other() {
        // lot A has units of two runs and of one, lot B a unit of three
        let units = [("A", "a"), ("A", "a"), ("A", "b"), ("B", "a"), ("B", "a"), ("B", "a")];
        let ids = ["r0", "r1", "r2", "r3", "r4", "r5"];
        let name = |text: &str| Label::literal(usize::from(text.as_bytes()[0]));
        let paths = ids.into_iter().zip(units).map(|(id, (lot, unit))| (id, vec![name(lot), name(unit)]));
        let own = DesignGroups::new(&ids, Some(&Grouping::from_paths(2, paths)), 2);
        let like =
            |path: [usize; 2], tests: usize| (0..tests).map(|number| own.like(&path, number)).collect::<Vec<_>>();
        assert_eq!(like([0, 0], 3), [0, 1, 0]);
        assert_eq!(like([0, 1], 2), [2, 2]);
        assert_eq!(like([0, 2], 2), [0, 1], "the third unit of a lot of two is like its first");
        assert_eq!(like([1, 0], 4), [3, 4, 5, 3]);
        assert_eq!(like([2, 1], 1), [2], "the third lot is like the first");
        let alone = DesignGroups::new(&ids, None, 2);
        assert_eq!((0..8).map(|number| alone.like(&[1, 1], number)).collect::<Vec<_>>(), [0, 1, 2, 3, 4, 5, 0, 1]);
    }

    #[test]
    fn tests_meet_the_levels_of_factors_in_turn() {
        for factors in [vec![3, 3], vec![4, 5], vec![6, 10], vec![5, 4], vec![2, 3, 4], vec![3, 3, 3]] {
            let all: usize = factors.iter().product();
            let slots = vec![0; factors.len()];
            let arrangement = Arrangement { factors, groups: vec![all], tests: 1 };
            let met: std::collections::BTreeSet<Vec<usize>> =
                (0..all).map(|test| arrangement.levels(test, &slots)).collect();
            assert_eq!(met.len(), all, "all levels meet all others: {arrangement:?}");
        }
        // two members of one factor are never one level, and all pairs are tested together
        let pairs = Arrangement { factors: vec![5], groups: vec![], tests: 20 };
        let met: std::collections::BTreeSet<Vec<usize>> = (0..20).map(|test| pairs.levels(test, &[2])).collect();
        assert!(met.iter().all(|pair| pair[0] != pair[1]) && met.len() == 20, "{met:?}");
    }

    #[test]
    fn only_what_varies_in_both_is_untold() {
        // two states, one level; the second state varies from test to test only
        let variances = DVector::from_vec(vec![1.0, 2.0, 3.0, 0.0]);
        let covariance = DMatrix::from_diagonal(&variances);
        let population = Population { mean: vec![0.0; 4], coefficients: vec![], covariance };
        let told = |i: usize, tests: usize| {
            let arrangement = Arrangement { factors: vec![], groups: vec![8], tests };
            is_separable(Quantity::StdDev(i), 2, &population, &arrangement.confounded_with())
        };
        assert_eq!([0, 1, 2].map(|i| told(i, 1)), [false, true, false]);
        assert_eq!([0, 1, 2].map(|i| told(i, 2)), [true; 3]);
    }
}
