//! Groups of tests: levels of groups within groups (theory §11), and factors whose groups cross these (theory §16).

use std::collections::HashMap;

use crate::ensemble::Label;

/// The groups that each test belongs to, level by level: the nested levels, the innermost first, then the crossed
/// factors, each as a level whose groups stand in no other group.
#[derive(Debug, Clone, PartialEq)]
pub struct Grouping {
    /// Index of each test, by the id of the test.
    numbers: HashMap<String, usize>,
    /// For each level the index in `groups` of the group of each test.
    of_test: Vec<Vec<usize>>,
    /// The groups of each level; the groups of a level are in the order of first mention by tests.
    groups: Vec<Vec<Group>>,
    /// Number of nested levels.
    nested: usize,
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
        let depth = factors + nested;
        let (of_test, groups) = (vec![Vec::new(); depth], vec![Vec::new(); depth]);
        let mut grouping = Grouping { numbers: HashMap::new(), of_test, groups, nested };
        let mut known: HashMap<(usize, Vec<Label>), usize> = HashMap::new();
        for (number, (id, path)) in tests.into_iter().enumerate() {
            grouping.numbers.insert(id.to_owned(), number);
            for (factor, name) in path[..factors].iter().enumerate() {
                grouping.join(&mut known, depth - 1 - factor, (vec![*name], None));
            }
            let mut parent = None;
            for names in 1..=nested {
                let own = path[factors..factors + names].to_vec();
                parent = Some(grouping.join(&mut known, nested - names, (own, parent)));
            }
        }
        grouping
    }

    /// Adds the next test to the group of a level that has this path; returns the index of the group.
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
        self.of_test[level].push(at);
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

    /// Index of the group of a test at a level, the innermost being level 0.
    pub fn group_of(&self, test: usize, level: usize) -> usize {
        self.of_test[level][test]
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
}
