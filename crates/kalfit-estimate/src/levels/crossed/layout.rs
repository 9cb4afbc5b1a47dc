//! Units, tests and the levels of crossed factors, by parts of the ensemble that have no level in common.

use std::collections::HashMap;
use std::sync::Arc;

use crate::frame::Frame;
use crate::levels::crossed::member::Member;
use crate::levels::design::Leaf;
use crate::levels::units::from_centre;
use kalfit_filter::reduce::Reductions;
use kalfit_model::{Grouping, Selection};

/// Tests in units, whose groups are eliminated one by one, and the levels of crossed factors, which are left in one
/// dense system for each part.
#[derive(Debug, Clone)]
pub(in crate::levels) struct Crossing {
    /// Block of Σ of each kind of group that is eliminated, the innermost first: the nested levels, or without any the
    /// largest factor of which each test has one level. Empty where there is none: each test is then a unit, in a group
    /// without an effect.
    pub(super) tree: Vec<usize>,
    /// Block of Σ of each factor of the dense systems.
    pub(super) factors: Vec<usize>,
    pub(super) parts: Vec<Part>,
}

/// Units that share levels of crossed factors with each other, and with no other unit.
#[derive(Debug, Clone)]
pub(super) struct Part {
    /// For each level that the tests of the part meet: index in [`Crossing::factors`], and index among the groups.
    pub(super) levels: Vec<(usize, usize)>,
    pub(super) units: Vec<Unit>,
}

/// A group of the outermost kind that is eliminated, with the groups and tests inside.
#[derive(Debug, Clone)]
pub(super) struct Unit {
    /// The groups, each before the group that contains it; the last group is the unit.
    pub(super) groups: Vec<TreeGroup>,
    pub(super) tests: Vec<CrossedTest>,
    /// Indices in [`Part::levels`] of the levels that tests of the unit meet, ascending.
    pub(super) met: Vec<usize>,
}

/// A group that is eliminated.
#[derive(Debug, Clone, Copy)]
pub(super) struct TreeGroup {
    /// Index in [`Crossing::tree`].
    pub(super) kind: usize,
    /// Index of the group that contains this group; the unit has the index of the unit.
    pub(super) parent: usize,
    /// Index among all groups of its level.
    pub(super) number: usize,
}

#[derive(Debug, Clone)]
pub(super) struct CrossedTest {
    /// Index of the design.
    pub(super) leaf: usize,
    /// Index of the reduction.
    pub(super) reduction: usize,
    /// Innermost group.
    pub(super) group: usize,
    /// The levels that the test meets, factor by factor.
    pub(super) members: Vec<Member>,
    /// d relative to the centre (p).
    pub(super) data: Vec<f64>,
}

impl Crossing {
    /// The tests of `reductions`, with `leaf_of` the design of each, in the order of their ids.
    pub(in crate::levels) fn new(
        reductions: &Reductions,
        leaf_of: &[usize],
        (grouping, numbers): (&Grouping, &[usize]),
        (frame, p): (&Frame, usize),
    ) -> Crossing {
        let (tree, factors) = kinds(grouping);
        let mut order: Vec<usize> = (0..reductions.len()).collect();
        order.sort_by(|&a, &b| reductions.id(a).cmp(reductions.id(b)));
        let mut unit_of: HashMap<usize, usize> = HashMap::new();
        let mut tests_of_units: Vec<Vec<usize>> = Vec::new();
        let outermost = tree.last().map(|block| block - 1);
        for &j in &order {
            let group = outermost.map_or(j, |level| grouping.group_of(numbers[j], level));
            let unit = *unit_of.entry(group).or_insert(tests_of_units.len());
            if unit == tests_of_units.len() {
                tests_of_units.push(Vec::new());
            }
            tests_of_units[unit].push(j);
        }
        let all = Arc::new(Selection::all(p));
        let members = |j: usize| {
            factors.iter().enumerate().flat_map(move |(factor, block)| {
                let members = grouping.members(numbers[j], block - 1);
                members.map(move |member| ((factor, member.group), member.selection))
            })
        };
        let met = |tests: &Vec<usize>| -> Vec<(usize, usize)> {
            tests.iter().flat_map(|&j| members(j).map(|(level, _)| level)).collect()
        };
        let met_by_unit: Vec<Vec<(usize, usize)>> = tests_of_units.iter().map(met).collect();
        let parts = connected(&met_by_unit).into_iter().map(|units| {
            let mut levels: Vec<(usize, usize)> = Vec::new();
            let mut place: HashMap<(usize, usize), usize> = HashMap::new();
            for &level in units.iter().flat_map(|&unit| &met_by_unit[unit]) {
                place.entry(level).or_insert_with(|| {
                    levels.push(level);
                    levels.len() - 1
                });
            }
            let units = units.iter().map(|&unit| {
                let groups = Tree::of(&tests_of_units[unit], (grouping, numbers), &tree);
                let mut met: Vec<usize> = met_by_unit[unit].iter().map(|level| place[level]).collect();
                met.sort_unstable();
                met.dedup();
                let test = |(&j, &group): (&usize, &usize)| CrossedTest {
                    leaf: leaf_of[j],
                    reduction: j,
                    group,
                    members: members(j)
                        .map(|(level, selection)| Member {
                            level: met.binary_search(&place[&level]).expect("the unit meets it"),
                            selection: selection.unwrap_or(&all).clone(),
                        })
                        .collect(),
                    data: (0..p).map(|i| from_centre(reductions.get(j), frame, i)).collect(),
                };
                let tests = tests_of_units[unit].iter().zip(&groups.of_test).map(test).collect();
                Unit { groups: groups.groups, tests, met }
            });
            let units = units.collect();
            Part { levels, units }
        });
        let parts = parts.collect();
        Crossing { tree, factors, parts }
    }

    /// Blocks of Σ of the tests, of the groups from the innermost on, and of the factors.
    pub(super) fn order(&self) -> Vec<usize> {
        std::iter::once(0).chain(self.tree.iter().chain(&self.factors).copied()).collect()
    }

    /// Block of Σ of a group that is eliminated; `None` where it has no effect.
    pub(super) fn block_of(&self, group: &TreeGroup) -> Option<usize> {
        self.tree.get(group.kind).copied()
    }

    /// Number of pairs of an innermost group and a level, and of two levels, of one part.
    pub(super) fn effect_covariances(&self) -> usize {
        let of = |part: &Part| {
            let groups = part.units.iter().flat_map(|unit| &unit.groups).filter(|group| group.kind == 0).count();
            let levels = part.levels.len();
            levels * (groups + levels) // twice as many pairs of levels as there are
        };
        self.parts.iter().map(of).sum()
    }

    /// Number of levels of the part that meets most.
    pub(in crate::levels) fn largest(&self) -> usize {
        self.parts.iter().map(|part| part.levels.len()).max().unwrap_or(0)
    }

    /// Number of tests, then number of groups of each level that tests are in.
    pub(in crate::levels) fn counts(&self) -> Vec<f64> {
        let mut counts = vec![0.0; 1 + self.tree.len() + self.factors.len()];
        for part in &self.parts {
            part.levels.iter().for_each(|(factor, _)| counts[self.factors[*factor]] += 1.0);
            for unit in &part.units {
                counts[0] += unit.tests.len() as f64;
                unit.groups.iter().filter_map(|group| self.block_of(group)).for_each(|block| counts[block] += 1.0);
            }
        }
        counts
    }

    /// Calls `on_moments` with the block of Σ, the state i, (y - Jμ)_i and J_ii of each test, and of the sum over each
    /// group and level.
    pub(in crate::levels) fn moments(
        &self,
        leaves: &[Leaf],
        (mean, scale): (&[f64], f64),
        on_moments: &mut dyn FnMut(usize, usize, f64, f64),
    ) {
        let p = mean.len();
        let none = vec![(0.0, 0.0); p];
        let add = |sum: &mut Vec<(f64, f64)>, own: &[(f64, f64)]| {
            sum.iter_mut().zip(own).for_each(|(sum, own)| *sum = (sum.0 + own.0, sum.1 + own.1));
        };
        for part in &self.parts {
            let mut levels = vec![none.clone(); part.levels.len()];
            let mut tell = |block: usize, sums: &[(f64, f64)]| {
                sums.iter().enumerate().for_each(|(i, (y, information))| on_moments(block, i, *y, *information));
            };
            for unit in &part.units {
                let mut groups = vec![none.clone(); unit.groups.len()];
                for test in &unit.tests {
                    let own = leaves[test.leaf].moments(&|row| scale * test.data[row], mean);
                    tell(0, &own);
                    add(&mut groups[test.group], &own);
                    test.members.iter().for_each(|member| member.add_sums(&mut levels[unit.met[member.level]], &own));
                }
                for (at, group) in unit.groups.iter().enumerate() {
                    let own = groups[at].clone();
                    self.block_of(group).iter().for_each(|block| tell(*block, &own));
                    if group.parent != at {
                        add(&mut groups[group.parent], &own);
                    }
                }
            }
            part.levels.iter().zip(&levels).for_each(|((factor, _), own)| tell(self.factors[*factor], own));
        }
    }
}

/// Blocks of Σ of the groups that are eliminated, and of the factors that are left.
fn kinds(grouping: &Grouping) -> (Vec<usize>, Vec<usize>) {
    let (nested, depth) = (grouping.nested(), grouping.depth());
    if nested > 0 {
        return ((1..=nested).collect(), (nested + 1..=depth).collect());
    }
    // the first of the largest
    let single = (0..depth).rev().filter(|&level| !grouping.has_slots(level));
    let largest = single.max_by_key(|&level| grouping.groups(level).len());
    let rest = (0..depth).filter(|&level| Some(level) != largest).map(|level| level + 1).collect();
    (largest.map(|level| level + 1).into_iter().collect(), rest)
}

/// Units that are connected by levels, as lists in the order of their first unit.
fn connected(met_by_unit: &[Vec<(usize, usize)>]) -> Vec<Vec<usize>> {
    let mut root: Vec<usize> = (0..met_by_unit.len()).collect();
    fn find(root: &mut [usize], mut at: usize) -> usize {
        while root[at] != at {
            root[at] = root[root[at]];
            at = root[at];
        }
        at
    }
    let mut first: HashMap<(usize, usize), usize> = HashMap::new();
    for (unit, met) in met_by_unit.iter().enumerate() {
        for level in met {
            let other = *first.entry(*level).or_insert(unit);
            let (a, b) = (find(&mut root, unit), find(&mut root, other));
            root[a.max(b)] = a.min(b);
        }
    }
    let mut parts: Vec<Vec<usize>> = vec![Vec::new(); met_by_unit.len()];
    for unit in 0..met_by_unit.len() {
        parts[find(&mut root, unit)].push(unit);
    }
    parts.retain(|units| !units.is_empty());
    parts
}

/// The groups of one unit, and the innermost group of each of its tests.
struct Tree {
    groups: Vec<TreeGroup>,
    of_test: Vec<usize>,
}

impl Tree {
    fn of(tests: &[usize], (grouping, numbers): (&Grouping, &[usize]), tree: &[usize]) -> Tree {
        let mut index: HashMap<(usize, usize), usize> = HashMap::new();
        let mut groups: Vec<TreeGroup> = Vec::new();
        let Some(innermost) = tree.first() else {
            let only = TreeGroup { kind: 0, parent: 0, number: 0 };
            return Tree { groups: vec![only], of_test: vec![0; tests.len()] };
        };
        for (kind, block) in tree.iter().enumerate() {
            for &j in tests {
                let number = grouping.group_of(numbers[j], block - 1);
                index.entry((kind, number)).or_insert_with(|| {
                    groups.push(TreeGroup { kind, parent: groups.len(), number });
                    groups.len() - 1
                });
            }
        }
        for &j in tests {
            for kind in 1..tree.len() {
                let at = |kind: usize| index[&(kind, grouping.group_of(numbers[j], tree[kind] - 1))];
                groups[at(kind - 1)].parent = at(kind);
            }
        }
        let of_test = tests.iter().map(|&j| index[&(0, grouping.group_of(numbers[j], innermost - 1))]).collect();
        Tree { groups, of_test }
    }
}
