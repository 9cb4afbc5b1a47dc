//! Tests and units by their designs: equal designs are evaluated once. The order does not depend on the order or on the
//! names of the tests.

use std::cmp::Ordering;
use std::collections::BTreeMap;

use nalgebra::DMatrix;

use kalfit_model::Grouping;

/// A test, bordered by the mean: K = T'JT with T = [I X], and a last row and column of the data where these are needed.
#[derive(Debug, Clone)]
pub(super) struct Leaf {
    /// K.
    pub(super) k: DMatrix<f64>,
    /// ∂K/∂v of each variance of noise.
    pub(super) slopes: Vec<DMatrix<f64>>,
    /// ∂²K/∂v∂u of each pair of variances, packed.
    pub(super) curvatures: Vec<DMatrix<f64>>,
    /// ∂²λ/∂v∂u of each pair, packed.
    pub(super) log_curvatures: Vec<f64>,
}

impl Leaf {
    fn numbers(&self) -> impl Iterator<Item = &f64> {
        let matrices = self.slopes.iter().chain(&self.curvatures).flat_map(|one| one.iter());
        self.k.iter().chain(matrices).chain(&self.log_curvatures)
    }

    fn compare(&self, other: &Leaf) -> Ordering {
        let different = self.numbers().zip(other.numbers()).map(|(a, b)| a.total_cmp(b)).find(|order| order.is_ne());
        different.unwrap_or(Ordering::Equal)
    }
}

/// Members of a group: (class of the level below, number of members of that class), by ascending class.
pub(super) type Members = Vec<(usize, usize)>;

/// All tests as classes of units.
#[derive(Debug, Clone)]
pub(super) struct Forest {
    /// One test of each class.
    pub(super) leaves: Vec<Leaf>,
    /// Classes of the groups of each level, the innermost first.
    pub(super) levels: Vec<Vec<Members>>,
    /// The units: (class of the outermost level, or of tests where there are no groups; number of units).
    pub(super) units: Members,
    /// Number of effects of crossed factors, whose columns follow those of the states.
    pub(super) crossed: usize,
}

impl Forest {
    /// The classes of tests, given in any order with the number of each in `grouping`, by its nested levels.
    pub(super) fn of(tests: Vec<Leaf>, grouping: Option<(&Grouping, &[usize])>) -> Forest {
        let mut order: Vec<usize> = (0..tests.len()).collect();
        order.sort_by(|&a, &b| tests[a].compare(&tests[b]));
        let (mut class_of, mut classes) = (vec![0; tests.len()], Vec::<usize>::new());
        for j in order {
            if classes.last().is_none_or(|&last| tests[last].compare(&tests[j]).is_ne()) {
                classes.push(j);
            }
            class_of[j] = classes.len() - 1;
        }
        let mut tests: Vec<Option<Leaf>> = tests.into_iter().map(Some).collect();
        let leaves = classes.into_iter().filter_map(|j| tests[j].take()).collect();
        let mut levels = Vec::new();
        let Some((grouping, numbers)) = grouping.filter(|(grouping, _)| grouping.nested() > 0) else {
            return Forest { leaves, levels, units: counted(class_of), crossed: 0 };
        };
        // (index of the group, class of the member) at the level in work
        let mut below: Vec<(usize, usize)> =
            class_of.iter().zip(numbers).map(|(&class, &number)| (grouping.group_of(number, 0), class)).collect();
        for level in 0..grouping.nested() {
            let mut members: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
            below.iter().for_each(|&(group, class)| members.entry(group).or_default().push(class));
            let groups: Vec<(usize, Members)> =
                members.into_iter().map(|(group, classes)| (group, counted(classes))).collect();
            let mut kinds: Vec<Members> = groups.iter().map(|(_, members)| members.clone()).collect();
            kinds.sort_unstable();
            kinds.dedup();
            let class = |members: &Members| kinds.binary_search(members).unwrap_or_default();
            let parent = |group: usize| grouping.groups(level)[group].parent.unwrap_or_default();
            below = groups.iter().map(|(group, members)| (parent(*group), class(members))).collect();
            levels.push(kinds);
        }
        let units = counted(below.into_iter().map(|(_, class)| class).collect());
        Forest { leaves, levels, units, crossed: 0 }
    }

    /// Width of the bordered matrices.
    pub(super) fn width(&self) -> usize {
        self.leaves.first().map_or(0, |leaf| leaf.k.nrows())
    }

    /// Number of classes that are evaluated at each level, tests first: a class once in each class that it is part of.
    pub(super) fn evaluations(&self) -> Vec<usize> {
        let mut times = vec![self.units.len()];
        for groups in self.levels.iter().rev() {
            let members: usize = groups.iter().map(Vec::len).sum();
            let mean = members as f64 / groups.len().max(1) as f64;
            let last = times.last().copied().unwrap_or_default();
            times.push((last as f64 * mean).ceil() as usize);
        }
        times.reverse();
        times
    }
}

/// Distinct numbers in ascending order, with the count of each.
fn counted(mut numbers: Vec<usize>) -> Members {
    numbers.sort_unstable();
    let mut counts: Members = Vec::new();
    for number in numbers {
        match counts.last_mut() {
            Some((last, count)) if *last == number => *count += 1,
            _ => counts.push((number, 1)),
        }
    }
    counts
}
