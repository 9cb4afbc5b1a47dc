//! Tests gathered by groups of the outermost level.

use std::collections::HashMap;
use std::sync::Arc;

use rayon::prelude::*;

use crate::classes::Classes;
use crate::frame::Frame;
use crate::levels::batches::{UnitBatch, batches};
use crate::levels::crossed::Crossing;
use crate::levels::design::{Leaf, UnitDesign, UnitMembers, UnitTest};
use crate::levels::trees::{FlatUnit, GroupTree, trees};
use kalfit_algebra::rows::Rows;
use kalfit_algebra::symmetric::pair;
use kalfit_filter::reduce::{ReductionRef, Reductions};
use kalfit_model::Grouping;
use kalfit_model::Reduction;

/// All tests of an ensemble, by groups of the outermost level ("units"), which are sorted by design.
#[derive(Debug, Clone)]
pub struct Units {
    /// p, number of states of a test.
    pub states: usize,
    /// The groups that each test belongs to, level by level.
    pub grouping: Arc<Grouping>,
    /// Index in the grouping of each reduction's test.
    pub(super) numbers: Arc<Vec<usize>>,
    /// Sum of the constants of the tests.
    pub(super) constant: f64,
    /// Factor on d of the designs.
    pub(super) unit: f64,
    /// Designs of tests, one for each class.
    pub(super) leaves: Arc<Vec<Leaf>>,
    /// Designs of units.
    pub(super) designs: Arc<Vec<UnitDesign>>,
    /// Units that are evaluated in lanes.
    pub(super) batches: Arc<Vec<UnitBatch>>,
    /// The tests where groups cross, in place of `designs` and `batches`.
    pub(super) crossing: Option<Arc<Crossing>>,
}

impl Units {
    /// Gathers `reductions`, which form `classes`; `Err` with the id of a test that is in no group.
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
            let ungrouped = reductions.iter().find(|reduction| grouping.number(reduction.test).is_none());
            return Err(ungrouped.map_or(String::new(), |reduction| reduction.test.to_owned()));
        };
        let crossing = grouping
            .is_crossed()
            .then(|| Crossing::new(reductions, &leaf_of, (grouping, &numbers), (frame, states)))
            .map(Arc::new);
        let mut index_of_kind: HashMap<usize, usize> = HashMap::new();
        let mut trees_by_design: Vec<Vec<GroupTree>> = Vec::new();
        let trees = match crossing {
            Some(_) => Vec::new(),
            None => trees(reductions, &leaf_of, (grouping, &numbers)),
        };
        for tree in trees {
            let at = *index_of_kind.entry(tree.kind).or_insert(trees_by_design.len());
            if at == trees_by_design.len() {
                trees_by_design.push(Vec::new());
            }
            trees_by_design[at].push(tree);
        }
        let design = |trees: &Vec<GroupTree>| UnitDesign::of(trees, reductions, frame, states);
        let designs: Vec<UnitDesign> = trees_by_design.par_iter().map(design).collect();
        Ok(Units {
            states,
            grouping: grouping.clone(),
            numbers: Arc::new(numbers),
            constant: (0..classes.len()).map(|number| classes.listed.get(number).constant).sum(),
            unit: 1.0,
            leaves: Arc::new((0..classes.len()).into_par_iter().map(leaf).collect()),
            batches: Arc::new(batches(&designs)),
            designs: Arc::new(designs),
            crossing,
        })
    }

    /// The units at another noise level: d is multiplied by `unit`, and `change` is added to the constant.
    pub(crate) fn with_noise(&self, unit: f64, change: f64) -> Units {
        Units { unit: self.unit * unit, constant: self.constant + change, ..self.clone() }
    }

    /// Every `every`-th unit; the constant is reduced in proportion to the number of units.
    pub(crate) fn thinned(&self, every: usize) -> Units {
        let mut first = 0;
        let mut designs = Vec::new();
        for design in self.designs.iter() {
            let selected: Vec<usize> =
                (0..design.units.len()).filter(|unit| (first + unit) % every == every / 2).collect();
            first += design.units.len();
            if !selected.is_empty() {
                designs.push(design.some(&selected));
            }
        }
        let selected: usize = designs.iter().map(|design| design.units.len()).sum();
        let constant = self.constant * selected as f64 / first.max(1) as f64;
        Units { batches: Arc::new(batches(&designs)), designs: Arc::new(designs), constant, ..self.clone() }
    }

    /// Whether groups cross, so that units are not independent.
    pub(crate) fn is_crossed(&self) -> bool {
        self.crossing.is_some()
    }

    /// Levels of crossed factors times states of the largest dense system; zero where no groups cross.
    pub(crate) fn largest_system(&self) -> usize {
        self.crossing.as_ref().map_or(0, |crossing| crossing.largest() * self.states)
    }

    /// Number of units.
    pub(crate) fn len(&self) -> usize {
        self.designs.iter().map(|design| design.units.len()).sum()
    }

    /// Number of levels, including the level of the tests.
    pub(crate) fn levels(&self) -> usize {
        self.grouping.depth() + 1
    }

    /// Number of tests, then number of groups of each level.
    pub(crate) fn counts(&self) -> Vec<f64> {
        if let Some(crossing) = &self.crossing {
            return crossing.counts();
        }
        let mut counts = vec![0.0; self.levels()];
        for design in self.designs.iter() {
            let units = design.units.len() as f64;
            counts[0] += units * design.tests.len() as f64;
            design.groups.iter().for_each(|group| counts[group.level] += units);
        }
        counts
    }
}

impl UnitDesign {
    /// The design of units whose trees have equal kinds.
    fn of(trees: &[GroupTree], reductions: &Reductions, frame: &Frame, p: usize) -> UnitDesign {
        let flat: Vec<FlatUnit> = trees.iter().map(FlatUnit::of).collect();
        let tests: Vec<UnitTest> = flat[0].tests.iter().map(|(member, _)| *member).collect();
        let of_test = |t: usize| {
            let mut data = Rows::zeros(p, flat.len());
            for (unit, one) in flat.iter().enumerate() {
                let reduction = reductions.get(one.tests[t].1);
                for i in 0..p {
                    data[(i, unit)] = from_centre(reduction, frame, i);
                }
            }
            data
        };
        UnitDesign {
            data: (0..tests.len()).map(of_test).collect(),
            tests,
            groups: flat[0].groups.iter().map(|(node, _)| *node).collect(),
            units: flat
                .iter()
                .map(|one| UnitMembers {
                    tests: one.tests.iter().map(|(_, j)| *j).collect(),
                    groups: one.groups.iter().map(|(_, group)| *group).collect(),
                })
                .collect(),
        }
    }
}

/// Entry i of d - R × centre of the frame, for a test whose reduction is [`stacked`].
pub(super) fn from_centre(reduction: ReductionRef<'_>, frame: &Frame, i: usize) -> f64 {
    let moved = (i..reduction.data.len()).map(|k| reduction.factor[pair(k, 0) + i] * frame.centre[k]);
    reduction.data[i] - moved.sum::<f64>()
}

/// The reduction of a test in the stacked per-test effect and effects of its groups: d - R(γ + β_1 + …).
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
