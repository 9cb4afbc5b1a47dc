//! Groups of tests: levels of groups within groups (theory §11), and factors whose groups cross these (theory §16).

use std::collections::HashMap;
use std::sync::Arc;

use crate::ensemble::{Label, LevelSlots, Selection};

/// The groups that each test belongs to, level by level: the nested levels, the innermost first, then the crossed
/// factors, each as a level whose groups stand in no other group.
#[derive(Debug, Clone, PartialEq)]
pub struct Grouping {
    /// Index of each test, by the id of the test.
    numbers: HashMap<String, usize>,
    /// For each level the index in `groups` of the groups of each test, one after the other; [`NO_GROUP`] for a slot that
    /// is empty.
    of_test: Vec<Vec<usize>>,
    /// For each level which effects of the groups of a test act on its states; a level without slots has one group for
    /// each test, whose effects act state by state.
    slots: Vec<Vec<Arc<Selection>>>,
    /// The groups of each level; the groups of a level are in the order of first mention by tests.
    groups: Vec<Vec<Group>>,
    /// Number of nested levels.
    nested: usize,
}

/// The place of a group in a slot that is empty.
const NO_GROUP: usize = usize::MAX;

/// A group that a test meets.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Member<'a> {
    /// Index of the group among those of its level.
    pub group: usize,
    /// Which effects of the group act on the states of the test; `None` where each acts on its own state.
    pub selection: Option<&'a Arc<Selection>>,
}

impl Member<'_> {
    /// Adds Eb of the effects b of the group to the states of the test.
    pub fn add_effects(&self, effects: &[f64], states: &mut [f64]) {
        match self.selection {
            None => states.iter_mut().zip(effects).for_each(|(sum, effect)| *sum += effect),
            Some(selection) => selection.pairs().iter().for_each(|&(state, effect)| states[state] += effects[effect]),
        }
    }
}

/// A group of tests.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Group {
    /// Names of the groups that contain this group, the outermost first, then the name of this group.
    pub path: Vec<Label>,
    /// Index of the group of the next outer level that contains this group; `None` for the outermost level.
    pub parent: Option<usize>,
    /// Number of tests in the group.
    pub tests: usize,
}

impl Grouping {
    /// Groups tests, each given by (id, names of the `depth` groups of the test, the outermost first).
    pub fn from_paths<'a>(depth: usize, tests: impl IntoIterator<Item = (&'a str, Vec<Label>)>) -> Grouping {
        Grouping::crossed((0, depth), tests)
    }

    /// Groups tests, each given by (id, names of the groups of the test: one for each of the `factors` crossed factors,
    /// then one for each of the `nested` levels, the outermost first).
    pub fn crossed<'a>(
        (factors, nested): (usize, usize),
        tests: impl IntoIterator<Item = (&'a str, Vec<Label>)>,
    ) -> Grouping {
        Grouping::with_slots(vec![Vec::new(); factors], nested, tests)
    }

    /// Groups tests as [`crossed`](Self::crossed) does, where tests may have several groups of one factor: for each factor
    /// the effects that act in each of its slots, none for a factor with one group for each test. A test gives a name for
    /// each slot, [`Label::MISSING`] for a slot that is empty.
    pub fn with_slots<'a>(
        factors: Vec<Vec<Arc<Selection>>>,
        nested: usize,
        tests: impl IntoIterator<Item = (&'a str, Vec<Label>)>,
    ) -> Grouping {
        let depth = factors.len() + nested;
        let (of_test, groups) = (vec![Vec::new(); depth], vec![Vec::new(); depth]);
        let slots = std::iter::repeat_n(Vec::new(), nested).chain(factors.into_iter().rev()).collect();
        let mut grouping = Grouping { numbers: HashMap::new(), of_test, slots, groups, nested };
        let mut known: HashMap<(usize, Vec<Label>), usize> = HashMap::new();
        for (number, (id, path)) in tests.into_iter().enumerate() {
            grouping.numbers.insert(id.to_owned(), number);
            let mut path = &path[..];
            for level in (nested..depth).rev() {
                let (own, rest) = path.split_at(grouping.width(level));
                grouping.join_slots(&mut known, level, own);
                path = rest;
            }
            let mut parent = None;
            for names in 1..=nested {
                let own = path[..names].to_vec();
                let at = grouping.join(&mut known, nested - names, (own, parent));
                grouping.of_test[nested - names].push(at);
                parent = Some(at);
            }
        }
        grouping
    }

    /// Adds the next test to its groups of a factor; a group in two slots counts the test once.
    fn join_slots(&mut self, known: &mut HashMap<(usize, Vec<Label>), usize>, level: usize, names: &[Label]) {
        for (slot, name) in names.iter().enumerate() {
            let at = match name.is_missing() && names.len() > 1 {
                true => NO_GROUP,
                false => self.join(known, level, (vec![*name], None)),
            };
            if names[..slot].contains(name) && at != NO_GROUP {
                self.groups[level][at].tests -= 1;
            }
            self.of_test[level].push(at);
        }
    }

    /// Counts the next test in the group of a level that has this path; returns the index of the group.
    fn join(
        &mut self,
        known: &mut HashMap<(usize, Vec<Label>), usize>,
        level: usize,
        (path, parent): (Vec<Label>, Option<usize>),
    ) -> usize {
        let groups = &mut self.groups[level];
        let at = *known.entry((level, path)).or_insert_with_key(|(_, path)| {
            groups.push(Group { path: path.clone(), parent, tests: 0 });
            groups.len() - 1
        });
        groups[at].tests += 1;
        at
    }

    /// Number of levels of groups, crossed factors included.
    pub fn depth(&self) -> usize {
        self.groups.len()
    }

    /// Number of nested levels: levels from this index on are crossed factors.
    pub fn nested(&self) -> usize {
        self.nested
    }

    /// Whether groups of some level cross the groups of others, so that the tests of different groups of the outermost
    /// nested level are not independent.
    pub fn is_crossed(&self) -> bool {
        self.nested < self.depth()
    }

    /// Number of tests.
    pub fn tests(&self) -> usize {
        self.numbers.len()
    }

    /// The groups of a level, the innermost being level 0; crossed factors follow the outermost nested level.
    pub fn groups(&self, level: usize) -> &[Group] {
        &self.groups[level]
    }

    /// Index of the test with id `test`, in the order in which tests were grouped.
    pub fn number(&self, test: &str) -> Option<usize> {
        self.numbers.get(test).copied()
    }

    /// Index of the group of a test at a level with one group for each test, the innermost being level 0.
    pub fn group_of(&self, test: usize, level: usize) -> usize {
        debug_assert!(self.slots[level].is_empty(), "a test may have several groups");
        self.of_test[level][test]
    }

    /// The groups of a test at a level, slot by slot.
    pub fn members(&self, test: usize, level: usize) -> impl Iterator<Item = Member<'_>> {
        let width = self.width(level);
        let groups = self.of_test[level][test * width..(test + 1) * width].iter();
        let member = move |(slot, &group): (usize, &usize)| Member { group, selection: self.slots[level].get(slot) };
        groups.enumerate().filter(|(_, group)| **group != NO_GROUP).map(member)
    }

    /// Indices of the groups of a test at a level, ascending, each once.
    pub fn groups_of(&self, test: usize, level: usize) -> Vec<usize> {
        let mut groups: Vec<usize> = self.members(test, level).map(|member| member.group).collect();
        groups.sort_unstable();
        groups.dedup();
        groups
    }

    /// Whether a test may have several groups of a level.
    pub fn has_slots(&self, level: usize) -> bool {
        !self.slots[level].is_empty()
    }

    /// The slots of a level.
    pub fn slots_of(&self, level: usize) -> &[Arc<Selection>] {
        &self.slots[level]
    }

    /// The slots of all levels.
    pub fn all_slots(&self) -> impl Iterator<Item = &Selection> {
        self.slots.iter().flatten().map(Arc::as_ref)
    }

    /// How the effects of each level enter a test.
    pub fn slots(&self) -> LevelSlots {
        LevelSlots::new(self.slots.iter().cloned())
    }

    /// Number of names that a test gives of its groups at a level.
    fn width(&self, level: usize) -> usize {
        self.slots[level].len().max(1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_are_told_apart_by_those_they_stand_in() {
        let path = |names: [usize; 2]| names.map(Label::literal).to_vec();
        let tests = [("a", [0, 1]), ("b", [2, 1]), ("c", [0, 3]), ("d", [0, 1])];
        let grouping = Grouping::from_paths(2, tests.map(|(id, names)| (id, path(names))));
        assert_eq!((grouping.groups(0).len(), grouping.groups(1).len(), grouping.tests()), (3, 2, 4));
        let inner: Vec<usize> = (0..4).map(|test| grouping.group_of(test, 0)).collect();
        let outer: Vec<usize> = (0..4).map(|test| grouping.group_of(test, 1)).collect();
        assert_eq!((inner, outer), (vec![0, 1, 2, 0], vec![0, 1, 0, 0]));
        assert_eq!(grouping.groups(0)[2], Group { path: path([0, 3]), parent: Some(0), tests: 1 });
        assert_eq!(grouping.groups(1)[1], Group { path: vec![Label::literal(2)], parent: None, tests: 1 });
        assert_eq!((grouping.number("c"), grouping.number("e")), (Some(2), None));
        assert_eq!((grouping.nested(), grouping.is_crossed()), (2, false));
    }

    #[test]
    fn factors_follow_the_nested_levels() {
        // (station, unit)
        let path = |names: [usize; 2]| names.map(Label::literal).to_vec();
        let tests = [("a", [7, 0]), ("b", [6, 0]), ("c", [8, 2]), ("d", [7, 1])];
        let grouping = Grouping::crossed((1, 1), tests.map(|(id, names)| (id, path(names))));
        assert_eq!((grouping.depth(), grouping.nested(), grouping.is_crossed()), (2, 1, true));
        assert_eq!((grouping.groups(0).len(), grouping.groups(1).len()), (3, 3));
        let stations: Vec<usize> = (0..4).map(|test| grouping.group_of(test, 1)).collect();
        assert_eq!(stations, [0, 1, 2, 0]);
        assert_eq!(grouping.groups(1)[0], Group { path: vec![Label::literal(7)], parent: None, tests: 2 });
    }

    #[test]
    fn tests_have_a_group_in_each_slot_that_is_not_empty() {
        let slots = vec![vec![Arc::new(Selection::new(vec![(0, 0)])), Arc::new(Selection::new(vec![(1, 0)]))]];
        let (x, y) = (Label::literal(0), Label::literal(1));
        let tests = [("a", vec![x, y]), ("b", vec![y, Label::MISSING]), ("c", vec![y, y])];
        let grouping = Grouping::with_slots(slots, 0, tests);
        let of = |test: usize| -> Vec<(usize, usize)> {
            let pair = |member: Member<'_>| (member.group, member.selection.expect("a slot").pairs()[0].0);
            grouping.members(test, 0).map(pair).collect()
        };
        assert_eq!([of(0), of(1), of(2)], [vec![(0, 0), (1, 1)], vec![(1, 0)], vec![(1, 0), (1, 1)]]);
        assert_eq!([grouping.groups_of(0, 0), grouping.groups_of(2, 0)], [vec![0, 1], vec![1]]);
        assert_eq!(grouping.groups(0).iter().map(|group| group.tests).collect::<Vec<_>>(), [1, 3]);
        assert_eq!((grouping.is_crossed(), grouping.has_slots(0)), (true, true));
    }
}
