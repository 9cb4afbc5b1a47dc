//! Groups of tests, level by level (theory §11).

use std::collections::HashMap;

use crate::ensemble::Label;

/// The groups that each test belongs to, level by level.
#[derive(Debug, Clone, PartialEq)]
pub struct Grouping {
    /// Index of each test, by the id of the test.
    numbers: HashMap<String, usize>,
    /// For each level, the innermost first, the index in `groups` of the group of each test.
    of_test: Vec<Vec<usize>>,
    /// The groups of each level, the innermost level first; the groups of a level are in the order of first mention by
    /// tests.
    groups: Vec<Vec<Group>>,
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
        let mut grouping =
            Grouping { numbers: HashMap::new(), of_test: vec![Vec::new(); depth], groups: vec![Vec::new(); depth] };
        let mut known: HashMap<Vec<Label>, usize> = HashMap::new();
        for (number, (id, path)) in tests.into_iter().enumerate() {
            grouping.numbers.insert(id.to_owned(), number);
            let mut parent = None;
            for names in 1..=depth {
                let level = depth - names;
                let own = path[..names].to_vec();
                let groups = &mut grouping.groups[level];
                let at = *known.entry(own).or_insert_with_key(|path| {
                    groups.push(Group { path: path.clone(), parent, tests: 0 });
                    groups.len() - 1
                });
                groups[at].tests += 1;
                grouping.of_test[level].push(at);
                parent = Some(at);
            }
        }
        grouping
    }

    /// Number of levels of groups.
    pub fn depth(&self) -> usize {
        self.groups.len()
    }

    /// Number of tests.
    pub fn tests(&self) -> usize {
        self.numbers.len()
    }

    /// The groups of a level, the innermost being level 0.
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
    }
}
