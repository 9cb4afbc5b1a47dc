//! Sums of ℓ and its derivatives over the parts.
#![expect(non_snake_case, reason = "K, E are the letters of the theory")]

use nalgebra::DMatrix;
use rayon::prelude::*;

use crate::levels::crossed::dense::Dense;
use crate::levels::crossed::eliminated::EliminatedUnit;
use crate::levels::crossed::layout::{CrossedTest, Crossing, Part, Unit};
use crate::levels::crossed::respond::{PartAt, Response, UnitResponse};
use crate::levels::crossed::weights::{UnitWeights, weight};
use crate::levels::pass::{summed_levels, sums};
use crate::levels::tangents::SigmaElement;
use crate::levels::totals::{SumSelection, UnitSums, add, add_products, each_coordinate, free_columns, numbers};
use crate::levels::units::Units;
use crate::levels::walk::{Integrated, LevelLaws};
use crate::order::{Order, SumsWanted};
use crate::point::Point;
use crate::sums::Sums;
use kalfit_algebra::rows::Rows;
use kalfit_algebra::symmetric::{pair, pairs};

/// Columns of working vectors that are passed through the tests at once.
const MAX_COLUMNS: usize = 16;

/// ℓ and its derivatives at a point.
pub(in crate::levels) fn pass(units: &Units, crossing: &Crossing, point: &Point, wanted: SumsWanted<'_>) -> Sums {
    let flat = wanted.flat.map(|flat| (summed_levels(flat, units.states, units.levels()), flat.covariance));
    let selection = SumSelection {
        flat: flat.as_ref().map(|(jacobian, covariance)| (jacobian, *covariance)),
        ..SumSelection::of(units, wanted, wanted.order)
    };
    let at = LevelLaws::<f64>::new(units, point, wanted.regressors);
    let leaves = leaves(units, &at);
    let of = |part: &Part| Totals { units, crossing, at: &at, leaves: &leaves, selection }.of_part(part);
    let parts: Vec<UnitSums> = crossing.parts.par_iter().map(of).collect();
    sums((units, units.constant), parts.into_iter().fold(UnitSums::zero(selection), UnitSums::and), wanted)
}

/// Calls `of` for each part with the indices of the tests' reductions and the sums of first order over the part,
/// without the constants of the tests.
pub(in crate::levels) fn each_part(
    (units, crossing): (&Units, &Crossing),
    point: &Point,
    wanted: SumsWanted<'_>,
    of: &mut dyn FnMut(&[usize], &Sums),
) {
    let selection = SumSelection::of(units, wanted, Order::First);
    let at = LevelLaws::<f64>::new(units, point, wanted.regressors);
    let leaves = leaves(units, &at);
    let totals = Totals { units, crossing, at: &at, leaves: &leaves, selection };
    for part in &crossing.parts {
        let tests: Vec<usize> =
            part.units.iter().flat_map(|unit| unit.tests.iter().map(|test| test.reduction)).collect();
        of(&tests, &sums((units, 0.0), totals.of_part(part), wanted));
    }
}

/// The designs of all tests with the effect of the test integrated out.
pub(super) fn leaves(units: &Units, at: &LevelLaws<'_>) -> Vec<Integrated<f64>> {
    units.leaves.par_iter().map(|leaf| Integrated::of(&leaf.factor, &at.roots[0])).collect()
}

impl<'a> PartAt<'a> {
    /// A part at Σ.
    pub(super) fn new(part: &'a Part, crossing: &Crossing, at: &LevelLaws<'_>, leaves: &'a [Integrated<f64>]) -> Self {
        let p = at.mean.len();
        let eliminated = |unit: &Unit| EliminatedUnit::new(unit, crossing, (at, leaves));
        let units: Vec<EliminatedUnit> = part.units.par_iter().map(eliminated).collect();
        let size = part.levels.len() * p;
        let mut K = DMatrix::zeros(size, size);
        part.units.iter().zip(&units).for_each(|(unit, own)| own.add_to(unit, p, &mut K));
        let dense = Dense::new(K, part, crossing, at);
        let each = part.units.par_iter().zip(&units);
        let weights = each.map(|(unit, own)| UnitWeights::new(unit, own, &dense)).collect();
        PartAt { part, leaves, units, dense, weights, p }
    }

    /// Sum of log|I + F'JF| over tests, groups and levels.
    pub(super) fn log_det(&self) -> f64 {
        let tests = self.units.iter().map(|unit| unit.log_det).sum::<f64>();
        tests + self.dense.log_det
    }
}

/// Data columns of all tests of a part: first the effects of the mean coordinates if requested, then d - Rμ.
pub(super) struct DataColumns {
    /// The columns with the effect of the test integrated out, by unit, p × columns.
    pub(super) left: Vec<Vec<Rows>>,
    /// s of each test by unit, p × columns.
    pub(super) said: Vec<Vec<Rows>>,
}

impl DataColumns {
    pub(super) fn of(
        part: &Part,
        units: &Units,
        (at, leaves): (&LevelLaws<'_>, &[Integrated<f64>]),
        before: usize,
    ) -> Self {
        let one = |test: &CrossedTest| {
            let data = Rows::from_fn(test.data.len(), 1, |i, _| test.data[i]);
            let leaf = &leaves[test.leaf];
            let left = Rows::solved_transposed(&leaf.upper, at.data((&units.leaves[test.leaf], &data), before));
            let said = leaf.half.transpose_times(&left);
            (left, said)
        };
        let of_unit = |unit: &Unit| unit.tests.iter().map(one).unzip::<Rows, Rows, Vec<Rows>, Vec<Rows>>();
        let (left, said) = part.units.par_iter().map(of_unit).unzip();
        DataColumns { left, said }
    }
}

/// Inputs of the sums over a part.
struct Totals<'a> {
    units: &'a Units,
    crossing: &'a Crossing,
    at: &'a LevelLaws<'a>,
    leaves: &'a [Integrated<f64>],
    selection: SumSelection<'a>,
}

impl Totals<'_> {
    fn of_part(&self, part: &Part) -> UnitSums {
        let before = self.selection.coordinates;
        let here = PartAt::new(part, self.crossing, self.at, self.leaves);
        let data = DataColumns::of(part, self.units, (self.at, self.leaves), before);
        let response = here.respond(&data.said, before + 1);
        let mut totals = UnitSums::zero(self.selection);
        let left = here.products(&response, &data.left);
        totals.quadratic = left[(before, before)];
        totals.value = -0.5 * (here.log_det() + totals.quadratic);
        totals.score = Rows::from_fn(before, 1, |c, _| left[(c, before)]);
        totals.information = Rows::from_fn(before, before, |i, k| left[(i, k)]);
        self.first(&here, &response, before, &mut totals);
        if self.selection.order >= Order::Average {
            self.products_of_all(&here, &response, before, &mut totals);
        }
        if self.selection.order >= Order::Second {
            self.weights_of_all(&here, &mut totals);
        } else {
            // twice the average is the sum of observed and expected
            totals.observed = half(&totals.observed);
        }
        totals
    }

    /// Adds rr' and N of all tests, groups and levels.
    fn first(&self, here: &PartAt<'_>, response: &Response, before: usize, totals: &mut UnitSums) {
        let mut node = |block: usize, r: &Rows, N: &Rows| {
            add(&mut totals.weight[block], 1.0, N);
            add_products(&mut totals.outer[block], (r, r), before);
            if let Some((jacobian, _)) = self.selection.flat {
                totals.spread(block, &free_columns(r, jacobian), 1.0);
            }
        };
        for ((unit, weights), own) in here.part.units.iter().zip(&here.weights).zip(&response.units) {
            for ((test, V), r) in unit.tests.iter().zip(&weights.tests).zip(&own.tests) {
                node(0, r, &weight(&here.leaves[test.leaf].W, V));
            }
            for ((group, weights), r) in unit.groups.iter().zip(&weights.groups).zip(&own.groups) {
                self.crossing.block_of(group).iter().for_each(|block| node(*block, r, &weights.N));
            }
        }
        for (level, (factor, _)) in here.part.levels.iter().enumerate() {
            let r = level_rows(&response.levels, level, here.p);
            node(self.crossing.factors[*factor], &r, &here.dense.weight(level));
        }
    }

    /// The elements of the Σ, in their order.
    fn elements(&self) -> Vec<SigmaElement> {
        let (p, levels) = (self.selection.states, self.selection.levels);
        let element = |level: usize| {
            let pairs = (0..p).flat_map(|row| (0..=row).map(move |column| (row, column)));
            pairs.map(move |(row, column)| SigmaElement { level, row, column })
        };
        (0..levels).flat_map(element).collect()
    }

    /// Adds twice the average information: the responses to the working vectors of each element of the Σ.
    fn products_of_all(&self, here: &PartAt<'_>, response: &Response, before: usize, totals: &mut UnitSums) {
        let elements = self.elements();
        let first = if self.selection.flat.is_some_and(|(_, covariance)| covariance.is_some()) { 0 } else { before };
        let width = before + 1 - first;
        for (batch, some) in elements.chunks((MAX_COLUMNS / width).max(1)).enumerate() {
            let batch = batch * (MAX_COLUMNS / width).max(1);
            let working = WorkingVectors { here, crossing: self.crossing, response, first };
            let said: Vec<Vec<Rows>> =
                (0..here.part.units.len()).into_par_iter().map(|unit| working.of_unit(unit, some)).collect();
            let moved = here.respond(&said, some.len() * width);
            for at in 0..some.len() {
                self.products(here, (response, &moved), (at, first, before), (batch + at, totals));
            }
        }
    }

    /// Adds the expected information, and takes it from the observed one: the derivatives of N along each element.
    fn weights_of_all(&self, here: &PartAt<'_>, totals: &mut UnitSums) {
        let (p, elements) = (self.selection.states, self.elements());
        let along: Vec<Vec<Rows>> =
            elements.iter().map(|element| here.weights_along(self.crossing, *element)).collect();
        let order = self.crossing.order();
        for (e, (element, sums)) in elements.iter().zip(&along).enumerate() {
            let from = order.iter().position(|block| *block == element.level).unwrap_or(0);
            for &block in &order[from..] {
                for i in 0..p {
                    for k in 0..=i {
                        let row = block * pairs(p) + pair(i, k);
                        let part = if i == k { -0.5 } else { -1.0 } * 0.5 * (sums[block][(i, k)] + sums[block][(k, i)]);
                        let places = [(row, e), (e, row)];
                        for place in places.into_iter().take(if block == element.level { 1 } else { 2 }) {
                            totals.expected[place] += part;
                            totals.observed[place] -= part;
                        }
                    }
                }
            }
        }
    }

    /// Adds the derivatives of rr' by element e, whose responses are in the columns of place `at`.
    fn products(
        &self,
        here: &PartAt<'_>,
        (response, moved): (&Response, &Response),
        (at, first, before): (usize, usize, usize),
        (e, totals): (usize, &mut UnitSums),
    ) {
        let p = here.p;
        let width = before + 1 - first;
        let mut sum = vec![Rows::zeros(p, p); self.selection.levels];
        let mut node = |block: usize, r: &Rows, moved: &Rows| {
            // dr is minus the response; the other half of dr r' + r dr' follows by symmetry
            let own = &mut sum[block];
            for i in 0..p {
                let change = -2.0 * moved.row(i)[at * width + before - first];
                own.row_mut(i).iter_mut().enumerate().for_each(|(k, sum)| *sum += change * r.row(k)[before]);
            }
            if let (Some((jacobian, Some(covariance))), 0) = (self.selection.flat, first) {
                let own = Rows::from_fn(p, before, |i, c| -moved[(i, at * width + c)]);
                let own = own.times(&numbers(jacobian)).times(&numbers(covariance));
                let both = own.times_transpose(&free_columns(r, jacobian));
                sum[block] = sum[block].clone().plus(&both).plus(&both.transposed());
            }
        };
        let units = here.part.units.iter().zip(response.units.iter().zip(&moved.units));
        for (unit, (own, moved)) in units {
            let UnitResponse { tests, groups, .. } = own;
            for ((test, r), moved) in unit.tests.iter().zip(tests).zip(&moved.tests) {
                node(0, r, moved);
                let covariates = &self.units.leaves[test.leaf].covariates;
                for (c, (state, x)) in each_coordinate(self.at, covariates).enumerate() {
                    totals.cross[(c, e)] += x * moved[(state, at * width + before - first)];
                }
            }
            for ((group, r), moved) in unit.groups.iter().zip(groups).zip(&moved.groups) {
                self.crossing.block_of(group).iter().for_each(|block| node(*block, r, moved));
            }
        }
        for (level, (factor, _)) in here.part.levels.iter().enumerate() {
            let of = |all: &DMatrix<f64>| level_rows(all, level, p);
            node(self.crossing.factors[*factor], &of(&response.levels), &of(&moved.levels));
        }
        for (block, along) in sum.iter().enumerate() {
            for i in 0..p {
                for k in 0..=i {
                    let row = block * pairs(p) + pair(i, k);
                    let both = 0.5 * (along[(i, k)] + along[(k, i)]);
                    totals.observed[(row, e)] += if i == k { -0.5 } else { -1.0 } * both;
                }
            }
        }
    }
}

fn half(of: &Rows) -> Rows {
    Rows::from_fn(of.nrows(), of.ncols(), |i, k| 0.5 * of[(i, k)])
}

/// Rows of one level.
fn level_rows(all: &DMatrix<f64>, level: usize, p: usize) -> Rows {
    Rows::from_fn(p, all.ncols(), |i, c| all[(level * p + i, c)])
}

/// Working vectors of elements of the Σ: each node at the level of the element contributes E r to the tests inside.
struct WorkingVectors<'a> {
    here: &'a PartAt<'a>,
    crossing: &'a Crossing,
    response: &'a Response,
    /// First column of the responses that is used.
    first: usize,
}

impl WorkingVectors<'_> {
    /// W times the working vectors, for each test of a unit: the columns of one element after those of another.
    fn of_unit(&self, unit: usize, elements: &[SigmaElement]) -> Vec<Rows> {
        let (own, response) = (&self.here.part.units[unit], &self.response.units[unit]);
        let p = self.here.p;
        let one = |(number, test): (usize, &CrossedTest)| {
            let width = response.tests[number].ncols() - self.first;
            let mut all = Rows::zeros(p, width * elements.len());
            for (at, element) in elements.iter().enumerate() {
                for (i, k) in element.places() {
                    let mut add = |i: usize, from: &mut dyn Iterator<Item = f64>| {
                        let to = &mut all.row_mut(i)[at * width..(at + 1) * width];
                        to.iter_mut().zip(from).for_each(|(to, x)| *to += x);
                    };
                    if element.level == 0 {
                        add(i, &mut response.tests[number].row(k)[self.first..].iter().copied());
                    } else if let Some(kind) = self.crossing.tree.iter().position(|own| *own == element.level) {
                        let mut group = test.group;
                        while own.groups[group].kind != kind {
                            group = own.groups[group].parent;
                        }
                        add(i, &mut response.groups[group].row(k)[self.first..].iter().copied());
                    } else if let Some(factor) = self.crossing.factors.iter().position(|own| *own == element.level) {
                        let of_factor = |level: usize| self.here.part.levels[level].0 == factor;
                        for member in test.members.iter().filter(|member| of_factor(own.met[member.level])) {
                            let row = own.met[member.level] * p + k;
                            let levels = &self.response.levels;
                            let r = || (self.first..levels.ncols()).map(|c| levels[(row, c)]);
                            member.states_of(i).for_each(|state| add(state, &mut r()));
                        }
                    }
                }
            }
            self.here.leaves[test.leaf].W.times(&all)
        };
        own.tests.iter().enumerate().map(one).collect()
    }
}
