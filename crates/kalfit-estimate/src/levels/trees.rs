//! Groups and tests of each unit as a tree, in an order that does not depend on the order of the tests.

use std::cmp::Ordering;
use std::collections::HashMap;

use rayon::prelude::*;

use crate::levels::design::{UnitGroup, UnitTest};
use kalfit_filter::reduce::Reductions;
use kalfit_model::Grouping;

/// A group with its inner groups and tests, in an order that does not depend on the order of the tests.
pub(super) struct GroupTree {
    /// Index of the group among all groups of the level.
    group: usize,
    level: usize,
    /// Index of the group's design: equal for groups of equal design.
    pub(super) kind: usize,
    /// Position of the group's first test in the order of the ids.
    first: usize,
    inner: Vec<GroupTree>,
    /// Tests that are in no inner group: (leaf, position in the order of the ids, index of the reduction).
    tests: Vec<(usize, usize, usize)>,
}

/// The trees of all units, in the order of each unit's first test.
pub(super) fn trees(
    reductions: &Reductions,
    leaf_of: &[usize],
    (grouping, numbers): (&Grouping, &[usize]),
) -> Vec<GroupTree> {
    let mut by_id: Vec<usize> = (0..reductions.len()).collect();
    by_id.par_sort_unstable_by(|&a, &b| reductions.id(a).cmp(reductions.id(b)));
    let mut groups: Vec<HashMap<usize, GroupTree>> = (0..grouping.depth()).map(|_| HashMap::new()).collect();
    for (position, &j) in by_id.iter().enumerate() {
        let group = grouping.group_of(numbers[j], 0);
        let tree = groups[0].entry(group).or_insert_with(|| GroupTree::empty(group, 1, position));
        tree.tests.push((leaf_of[j], position, j));
    }
    let mut kinds: HashMap<Vec<usize>, usize> = HashMap::new();
    for level in 0..grouping.depth() {
        let mut trees: Vec<GroupTree> = std::mem::take(&mut groups[level]).into_values().collect();
        trees.sort_unstable_by_key(|tree| tree.first);
        trees.iter_mut().for_each(|tree| tree.sort_and_classify(&mut kinds));
        if level + 1 == grouping.depth() {
            return trees;
        }
        for tree in trees {
            let parent = grouping.groups(level)[tree.group].parent.expect("an inner level");
            let above = groups[level + 1].entry(parent);
            let above = above.or_insert_with(|| GroupTree::empty(parent, level + 2, tree.first));
            above.first = above.first.min(tree.first);
            above.inner.push(tree);
        }
    }
    Vec::new()
}

impl GroupTree {
    fn empty(group: usize, level: usize, first: usize) -> GroupTree {
        GroupTree { group, level, kind: 0, first, inner: Vec::new(), tests: Vec::new() }
    }

    /// Sorts the inner groups and tests, and determines the kind.
    fn sort_and_classify(&mut self, kinds: &mut HashMap<Vec<usize>, usize>) {
        self.tests.sort_unstable();
        let by_kind = |a: &GroupTree, b: &GroupTree| -> Ordering { a.kind.cmp(&b.kind).then(a.first.cmp(&b.first)) };
        self.inner.sort_unstable_by(by_kind);
        let members = self.tests.iter().map(|test| test.0).chain(self.inner.iter().map(|tree| tree.kind));
        let signature: Vec<usize> = std::iter::once(self.level).chain(members).collect();
        let next = kinds.len();
        self.kind = *kinds.entry(signature).or_insert(next);
    }

    /// Appends the inner groups, this group and the tests to `unit`; returns the index of this group in `unit`.
    fn visit(&self, unit: &mut FlatUnit) -> usize {
        let inner: Vec<usize> = self.inner.iter().map(|tree| tree.visit(unit)).collect();
        let own = unit.groups.len();
        unit.groups.push((UnitGroup { level: self.level, parent: own }, self.group));
        inner.iter().for_each(|&child| unit.groups[child].0.parent = own);
        unit.tests.extend(self.tests.iter().map(|&(leaf, _, j)| (UnitTest { leaf, group: own }, j)));
        own
    }
}

/// Groups and tests of a unit as flat lists, with the index of each group among all groups of a level and of each
/// test's reduction.
#[derive(Default)]
pub(super) struct FlatUnit {
    pub(super) groups: Vec<(UnitGroup, usize)>,
    pub(super) tests: Vec<(UnitTest, usize)>,
}

impl FlatUnit {
    pub(super) fn of(tree: &GroupTree) -> FlatUnit {
        let mut flat = FlatUnit::default();
        tree.visit(&mut flat);
        flat
    }
}
