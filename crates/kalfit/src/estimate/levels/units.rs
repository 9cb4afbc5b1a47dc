//! Tests gathered as what stands in one group of the outermost level.

use std::cmp::Ordering;
use std::collections::HashMap;
use std::sync::Arc;

use nalgebra::DVector;
use rayon::prelude::*;

use crate::ensemble::Grouping;
use crate::estimate::classes::Classes;
use crate::estimate::frame::Frame;
use crate::linalg::rows::Rows;
use crate::linalg::symmetric::pair;
use crate::reduce::{Reduction, ReductionRef, Reductions};

/// All tests of an ensemble, by the groups of the outermost level ("units") and these by their design.
#[derive(Debug, Clone)]
pub(crate) struct Units {
    /// p, the states of a test.
    pub(crate) states: usize,
    pub(crate) grouping: Arc<Grouping>,
    /// The number of each reduction's test in the grouping.
    pub(super) numbers: Arc<Vec<usize>>,
    /// Σ constant over the tests.
    pub(super) constant: f64,
    /// What d of the designs is multiplied by.
    pub(super) unit: f64,
    /// Designs of tests.
    pub(super) leaves: Arc<Vec<Leaf>>,
    /// Designs of units.
    pub(super) designs: Arc<Vec<Design>>,
}

/// What tests of one class share.
#[derive(Debug, Clone)]
pub(super) struct Leaf {
    /// R, p × p.
    pub(super) factor: Rows,
    /// Scaled covariates of the regressions.
    pub(super) covariates: Vec<f64>,
}

/// Units whose tests have the same designs in the same groups.
#[derive(Debug, Clone)]
pub(super) struct Design {
    /// Of each test the number of its leaf and its group.
    pub(super) tests: Vec<Member>,
    /// The groups, those of inner levels before those that they stand in; the last one is the unit.
    pub(super) groups: Vec<Node>,
    /// The units, each by the numbers of its reductions and of its groups in their levels.
    pub(super) units: Vec<Unit>,
    /// d of the tests from the centre on: of each test p rows of as many numbers as there are units.
    pub(super) data: Vec<Rows>,
}

/// A test of a unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct Member {
    pub(super) leaf: usize,
    pub(super) group: usize,
}

/// A group of a unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct Node {
    /// Its level, the innermost being 1: that of its Σ among the blocks.
    pub(super) level: usize,
    /// The group that it stands in; itself for the unit.
    pub(super) parent: usize,
}

/// One group of the outermost level.
#[derive(Debug, Clone)]
pub(super) struct Unit {
    /// Numbers of its reductions, in the order of the tests of the design.
    pub(super) tests: Vec<usize>,
    /// Numbers of its groups in their levels, in the order of the groups of the design.
    pub(super) groups: Vec<usize>,
}

/// A group with all that stands in it, its members in an order that does not depend on the order of the tests.
struct Tree {
    /// Which group of its level it is.
    group: usize,
    level: usize,
    /// Equal for groups of equal design.
    kind: usize,
    /// The place of its first test in the order of the ids.
    first: usize,
    inner: Vec<Tree>,
    /// (leaf, place in the order of the ids, number of the reduction).
    tests: Vec<(usize, usize, usize)>,
}

impl Units {
    /// Of reductions with the classes they are of; `Err` with the id of a test that is in no group.
    pub(crate) fn new(reductions: &Reductions, classes: &Classes, grouping: &Arc<Grouping>) -> Result<Units, String> {
        let frame = &classes.frame;
        let states = frame.scale.len() / (grouping.depth() + 1);
        let mut leaf_of = vec![0; reductions.len()];
        for leaf in 0..classes.len() {
            classes.tests_of(leaf).iter().for_each(|&j| leaf_of[j] = leaf);
        }
        let leaf = |number: usize| {
            let (class, p) = (classes.listed.get(number), frame.scale.len());
            let factor = Rows::from_fn(states, states, |i, k| class.factor[i * p + k]);
            Leaf { factor, covariates: class.covariates.to_vec() }
        };
        let numbers: Option<Vec<usize>> = (0..reductions.len()).map(|j| grouping.number(reductions.id(j))).collect();
        let Some(numbers) = numbers else {
            let apart = reductions.iter().find(|reduction| grouping.number(reduction.test).is_none());
            return Err(apart.map_or(String::new(), |reduction| reduction.test.to_owned()));
        };
        let mut of_design: HashMap<usize, usize> = HashMap::new();
        let mut found: Vec<Vec<Tree>> = Vec::new();
        for tree in trees(reductions, &leaf_of, (grouping, &numbers)) {
            let at = *of_design.entry(tree.kind).or_insert(found.len());
            if at == found.len() {
                found.push(Vec::new());
            }
            found[at].push(tree);
        }
        let design = |trees: &Vec<Tree>| Design::of(trees, reductions, frame, states);
        Ok(Units {
            states,
            grouping: grouping.clone(),
            numbers: Arc::new(numbers),
            constant: (0..classes.len()).map(|number| classes.listed.get(number).constant).sum(),
            unit: 1.0,
            leaves: Arc::new((0..classes.len()).into_par_iter().map(leaf).collect()),
            designs: Arc::new(found.par_iter().map(design).collect()),
        })
    }

    /// The same with other noise: d so many times as large, and this much more of Σ constant.
    pub(crate) fn with_noise(&self, unit: f64, change: f64) -> Units {
        Units { unit: self.unit * unit, constant: self.constant + change, ..self.clone() }
    }

    /// Every so-many-th unit.
    pub(crate) fn thinned(&self, every: usize) -> Units {
        let mut first = 0;
        let mut designs = Vec::new();
        for design in self.designs.iter() {
            let kept: Vec<usize> = (0..design.units.len()).filter(|unit| (first + unit) % every == every / 2).collect();
            first += design.units.len();
            if !kept.is_empty() {
                designs.push(design.some(&kept));
            }
        }
        let kept: usize = designs.iter().map(|design| design.units.len()).sum();
        let constant = self.constant * kept as f64 / first.max(1) as f64;
        Units { designs: Arc::new(designs), constant, ..self.clone() }
    }

    /// How many units there are.
    pub(crate) fn len(&self) -> usize {
        self.designs.iter().map(|design| design.units.len()).sum()
    }

    /// Number of levels, that of the tests among them.
    pub(crate) fn levels(&self) -> usize {
        self.grouping.depth() + 1
    }

    /// How many there are of each level, tests first.
    pub(crate) fn counts(&self) -> Vec<f64> {
        let mut counts = vec![0.0; self.levels()];
        for design in self.designs.iter() {
            let units = design.units.len() as f64;
            counts[0] += units * design.tests.len() as f64;
            design.groups.iter().for_each(|group| counts[group.level] += units);
        }
        counts
    }

    /// A variance for each state at each level by moments, as if the states were uncorrelated: with J and y - Jμ of all that stands in a
    /// group, Σ (y - Jμ)_i² - J_ii over the groups of level k has the mean Σ_l v_l N_min(k,l), N_l = Σ J_ii² over those of level l. By
    /// levels, tests first; none where the groups say nothing.
    pub(crate) fn variances(&self, mean: &DVector<f64>) -> Vec<Vec<Option<f64>>> {
        let (levels, p) = (self.levels(), self.states);
        let centre: Vec<f64> = (0..p).map(|i| (0..levels).map(|l| mean[l * p + i]).sum()).collect();
        let (mut excess, mut squares) = (vec![vec![0.0; p]; levels], vec![vec![0.0; p]; levels]);
        for design in self.designs.iter() {
            design.moments(&self.leaves, (&centre, self.unit), &mut |level, i, y, information| {
                excess[level][i] += y * y - information;
                squares[level][i] += information * information;
            });
        }
        let of_state = |i: usize| solved(&excess, &squares, i);
        let by_state: Vec<Vec<Option<f64>>> = (0..p).map(of_state).collect();
        (0..levels).map(|level| by_state.iter().map(|found| found[level]).collect()).collect()
    }
}

/// Variances of one state at all levels, the outermost first found: differences of the equations of neighbouring levels.
fn solved(excess: &[Vec<f64>], squares: &[Vec<f64>], i: usize) -> Vec<Option<f64>> {
    // e_k = Σ_l v_l N_min(k,l), so e_k - e_(k-1) = (N_k - N_(k-1)) Σ_(l≥k) v_l
    let mut above = 0.0;
    let mut found: Vec<Option<f64>> = (0..excess.len())
        .rev()
        .map(|k| {
            let (e, n) = match k {
                0 => (excess[0][i], squares[0][i]),
                _ => (excess[k][i] - excess[k - 1][i], squares[k][i] - squares[k - 1][i]),
            };
            let together = (n > 0.0).then(|| (e / n).max(above))?;
            let own = together - above;
            above = together;
            Some(own)
        })
        .collect();
    found.reverse();
    found
}

/// The trees of all units, in the order of their first tests.
fn trees(reductions: &Reductions, leaf_of: &[usize], (grouping, numbers): (&Grouping, &[usize])) -> Vec<Tree> {
    let mut by_id: Vec<usize> = (0..reductions.len()).collect();
    by_id.par_sort_unstable_by(|&a, &b| reductions.id(a).cmp(reductions.id(b)));
    let mut groups: Vec<HashMap<usize, Tree>> = (0..grouping.depth()).map(|_| HashMap::new()).collect();
    for (place, &j) in by_id.iter().enumerate() {
        let group = grouping.group_of(numbers[j], 0);
        let tree = groups[0].entry(group).or_insert_with(|| Tree::empty(group, 1, place));
        tree.tests.push((leaf_of[j], place, j));
    }
    let mut kinds: HashMap<Vec<usize>, usize> = HashMap::new();
    for level in 0..grouping.depth() {
        let mut trees: Vec<Tree> = std::mem::take(&mut groups[level]).into_values().collect();
        trees.sort_unstable_by_key(|tree| tree.first);
        trees.iter_mut().for_each(|tree| tree.settle(&mut kinds));
        if level + 1 == grouping.depth() {
            return trees;
        }
        for tree in trees {
            let parent = grouping.groups(level)[tree.group].parent.expect("an inner level");
            let above = groups[level + 1].entry(parent);
            let above = above.or_insert_with(|| Tree::empty(parent, level + 2, tree.first));
            above.first = above.first.min(tree.first);
            above.inner.push(tree);
        }
    }
    Vec::new()
}

impl Tree {
    fn empty(group: usize, level: usize, first: usize) -> Tree {
        Tree { group, level, kind: 0, first, inner: Vec::new(), tests: Vec::new() }
    }

    /// Orders what stands in it, and finds its kind.
    fn settle(&mut self, kinds: &mut HashMap<Vec<usize>, usize>) {
        self.tests.sort_unstable();
        let by_kind = |a: &Tree, b: &Tree| -> Ordering { a.kind.cmp(&b.kind).then(a.first.cmp(&b.first)) };
        self.inner.sort_unstable_by(by_kind);
        let members = self.tests.iter().map(|test| test.0).chain(self.inner.iter().map(|tree| tree.kind));
        let signature: Vec<usize> = std::iter::once(self.level).chain(members).collect();
        let next = kinds.len();
        self.kind = *kinds.entry(signature).or_insert(next);
    }

    /// The groups, inner ones first, each with the numbers of what stands in it: `of` is told of each test and of each group.
    fn visit(&self, unit: &mut Laid) -> usize {
        let inner: Vec<usize> = self.inner.iter().map(|tree| tree.visit(unit)).collect();
        let own = unit.groups.len();
        unit.groups.push((Node { level: self.level, parent: own }, self.group));
        inner.iter().for_each(|&child| unit.groups[child].0.parent = own);
        unit.tests.extend(self.tests.iter().map(|&(leaf, _, j)| (Member { leaf, group: own }, j)));
        own
    }
}

/// A unit laid out in rows.
#[derive(Default)]
struct Laid {
    groups: Vec<(Node, usize)>,
    tests: Vec<(Member, usize)>,
}

impl Laid {
    fn of(tree: &Tree) -> Laid {
        let mut laid = Laid::default();
        tree.visit(&mut laid);
        laid
    }
}

impl Design {
    /// Of units that are alike.
    fn of(trees: &[Tree], reductions: &Reductions, frame: &Frame, p: usize) -> Design {
        let laid: Vec<Laid> = trees.iter().map(Laid::of).collect();
        let tests: Vec<Member> = laid[0].tests.iter().map(|(member, _)| *member).collect();
        let of_test = |t: usize| {
            let mut data = Rows::zeros(p, laid.len());
            for (unit, one) in laid.iter().enumerate() {
                let reduction = reductions.get(one.tests[t].1);
                for i in 0..p {
                    data[(i, unit)] = from_centre(reduction, frame, i);
                }
            }
            data
        };
        Design {
            data: (0..tests.len()).map(of_test).collect(),
            tests,
            groups: laid[0].groups.iter().map(|(node, _)| *node).collect(),
            units: laid
                .iter()
                .map(|one| Unit {
                    tests: one.tests.iter().map(|(_, j)| *j).collect(),
                    groups: one.groups.iter().map(|(_, group)| *group).collect(),
                })
                .collect(),
        }
    }

    /// Some of the units.
    fn some(&self, units: &[usize]) -> Design {
        let of = |data: &Rows| Rows::from_fn(data.nrows(), units.len(), |i, at| data[(i, units[at])]);
        Design {
            tests: self.tests.clone(),
            groups: self.groups.clone(),
            units: units.iter().map(|&unit| self.units[unit].clone()).collect(),
            data: self.data.iter().map(of).collect(),
        }
    }

    /// Whether a group is another one, or stands in it.
    pub(super) fn stands_in(&self, mut group: usize, other: usize) -> bool {
        while group != other && self.groups[group].parent != group {
            group = self.groups[group].parent;
        }
        group == other
    }

    /// Calls `of` with the level, the state, (y - Jμ)_i and J_ii of each test and of all that stands in each group.
    fn moments(&self, leaves: &[Leaf], (mean, scale): (&[f64], f64), of: &mut dyn FnMut(usize, usize, f64, f64)) {
        let p = mean.len();
        for unit in 0..self.units.len() {
            let mut sums = vec![(vec![0.0; p], vec![0.0; p]); self.groups.len()];
            for (member, data) in self.tests.iter().zip(&self.data) {
                let factor = &leaves[member.leaf].factor;
                let dot = |row: usize, x: &dyn Fn(usize) -> f64| (row..p).map(|k| factor[(row, k)] * x(k)).sum::<f64>();
                let left: Vec<f64> = (0..p).map(|row| scale * data[(row, unit)] - dot(row, &|k| mean[k])).collect();
                let (y, information) = &mut sums[member.group];
                for i in 0..p {
                    let own: f64 = (0..=i).map(|row| factor[(row, i)] * left[row]).sum();
                    let square: f64 = (0..=i).map(|row| factor[(row, i)].powi(2)).sum();
                    of(0, i, own, square);
                    y[i] += own;
                    information[i] += square;
                }
            }
            for (at, node) in self.groups.iter().enumerate() {
                let (y, information) = std::mem::take(&mut sums[at]);
                for i in 0..p {
                    of(node.level, i, y[i], information[i]);
                    if node.parent != at {
                        sums[node.parent].0[i] += y[i];
                        sums[node.parent].1[i] += information[i];
                    }
                }
            }
        }
    }
}

/// (d - R × the centre)_i of a test whose reduction is [`stacked`].
fn from_centre(reduction: ReductionRef<'_>, frame: &Frame, i: usize) -> f64 {
    let moved = (i..reduction.data.len()).map(|k| reduction.factor[pair(k, 0) + i] * frame.centre[k]);
    reduction.data[i] - moved.sum::<f64>()
}

/// The reduction of a test in what is its own and what each of its groups adds: d - R(γ + β_1 + …).
pub(crate) fn stacked(reduction: ReductionRef<'_>, levels: usize) -> Reduction {
    let p = reduction.data.len();
    let mut data = reduction.data.to_vec();
    data.resize(p * levels, 0.0);
    let mut factor = Vec::with_capacity(pair(p * levels, 0));
    for column in 0..p * levels {
        let k = column % p;
        factor.extend_from_slice(&reduction.factor[pair(k, 0)..][..=k]);
        factor.resize(pair(column + 1, 0), 0.0);
    }
    Reduction { data, factor, ..reduction.into() }
}
