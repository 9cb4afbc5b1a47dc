//! Pz for data columns z: the responses of all tests, groups and levels.

use nalgebra::DMatrix;
use rayon::prelude::*;

use crate::levels::crossed::dense::{Dense, rows_of};
use crate::levels::crossed::eliminated::EliminatedUnit;
use crate::levels::crossed::layout::{CrossedTest, Part, TreeGroup, Unit};
use crate::levels::crossed::weights::{GroupWeights, UnitWeights};
use crate::levels::totals::add;
use crate::levels::walk::Integrated;
use kalfit_algebra::rows::Rows;

/// A part at Σ.
pub(super) struct PartAt<'a> {
    pub(super) part: &'a Part,
    pub(super) leaves: &'a [Integrated<f64>],
    pub(super) units: Vec<EliminatedUnit>,
    pub(super) dense: Dense,
    pub(super) weights: Vec<UnitWeights>,
    pub(super) p: usize,
}

/// Responses to some data columns.
pub(super) struct Response {
    pub(super) units: Vec<UnitResponse>,
    /// r of each level, M × columns.
    pub(super) levels: DMatrix<f64>,
    /// b̂, M × columns.
    pub(super) effects: DMatrix<f64>,
    /// v̂ with b̂ = Lv̂.
    roots: DMatrix<f64>,
}

/// Responses of one unit, each p × columns.
pub(super) struct UnitResponse {
    /// r = s - Wm̂ of each test.
    pub(super) tests: Vec<Rows>,
    /// r of each group: the sum over its tests.
    pub(super) groups: Vec<Rows>,
    /// m̂ of each test.
    pub(super) expected: Vec<Rows>,
    /// û of each group, whose effect is Fû.
    roots: Vec<Rows>,
    /// α - Γb̂ of each group: the posterior mean of the sum of the effects of the group and of the groups around it.
    pub(super) means: Vec<Rows>,
}

/// Moments of the groups of a unit if all levels had no effect, each p × columns.
struct UnitData {
    /// y of each group.
    y: Vec<Rows>,
    /// α of each group: the posterior mean of the sum of the effects of the group and of the groups around it.
    alphas: Vec<Rows>,
}

impl PartAt<'_> {
    /// The responses to data columns, given s of each test by unit.
    pub(super) fn respond(&self, said: &[Vec<Rows>], columns: usize) -> Response {
        let units = || self.part.units.par_iter().zip(&self.units).zip(said);
        let data: Vec<UnitData> = units().map(|((unit, own), s)| self.without_levels(unit, own, s, columns)).collect();
        let mut y = DMatrix::zeros(self.dense.K.nrows(), columns);
        for ((unit, said), UnitData { alphas, .. }) in self.part.units.iter().zip(said).zip(&data) {
            for (test, s) in unit.tests.iter().zip(said).filter(|(test, _)| !test.members.is_empty()) {
                let left = s.clone().less(&self.leaves[test.leaf].W.times(&alphas[test.group]));
                test.members.iter().for_each(|member| member.add_rows(&mut y, unit.met[member.level], &left));
            }
        }
        let (roots, effects) = self.dense.effects(&y);
        let down = |(((unit, own), weights), (s, data)): (_, (&Vec<Rows>, &UnitData))| {
            self.down((unit, own, weights), (s, data), &effects)
        };
        let all = self.part.units.par_iter().zip(&self.units).zip(&self.weights).zip(said.par_iter().zip(&data));
        let units: Vec<UnitResponse> = all.map(down).collect();
        let mut levels = DMatrix::zeros(effects.nrows(), columns);
        for (unit, own) in self.part.units.iter().zip(&units) {
            for (test, r) in unit.tests.iter().zip(&own.tests) {
                test.members.iter().for_each(|member| member.add_rows(&mut levels, unit.met[member.level], r));
            }
        }
        Response { units, levels, effects, roots }
    }

    /// y and α of each group of a unit.
    fn without_levels(&self, unit: &Unit, own: &EliminatedUnit, said: &[Rows], columns: usize) -> UnitData {
        let p = self.p;
        let mut y: Vec<Rows> = unit.groups.iter().map(|_| Rows::zeros(p, columns)).collect();
        unit.tests.iter().zip(said).for_each(|(test, s)| add(&mut y[test.group], 1.0, s));
        for (number, (group, own)) in unit.groups.iter().zip(&own.groups).enumerate() {
            if group.parent != number {
                let up = own.T.transpose_times(&y[number]);
                add(&mut y[group.parent], 1.0, &up);
            }
        }
        let last = unit.groups.len() - 1;
        let mut alphas: Vec<Rows> = Vec::with_capacity(unit.groups.len());
        // from the unit on, so that each group follows the group around it
        for (number, group) in unit.groups.iter().enumerate().rev() {
            let eliminated = &own.groups[number];
            let alpha = eliminated.H.times(&y[number]);
            alphas.push(match group.parent == number {
                true => alpha,
                false => alpha.plus(&eliminated.T.times(&alphas[last - group.parent])),
            });
        }
        alphas.reverse();
        UnitData { y, alphas }
    }

    fn down(
        &self,
        (unit, own, weights): (&Unit, &EliminatedUnit, &UnitWeights),
        (said, UnitData { y, alphas }): (&[Rows], &UnitData),
        effects: &DMatrix<f64>,
    ) -> UnitResponse {
        let p = self.p;
        let effects = rows_of(effects, unit, p);
        let mean = |(alpha, weights): (&Rows, &GroupWeights)| alpha.clone().less(&weights.gamma.times(&effects));
        let means: Vec<Rows> = alphas.iter().zip(&weights.groups).map(mean).collect();
        let expected = |test: &CrossedTest| {
            let mut mean = means[test.group].clone();
            test.members.iter().for_each(|member| member.add_effects(&mut mean, &effects));
            mean
        };
        let expected: Vec<Rows> = unit.tests.iter().map(expected).collect();
        let r =
            |((test, s), mean): ((&CrossedTest, &Rows), &Rows)| s.clone().less(&self.leaves[test.leaf].W.times(mean));
        let tests: Vec<Rows> = unit.tests.iter().zip(said).zip(&expected).map(r).collect();
        let mut groups: Vec<Rows> = means.iter().map(|mean| Rows::zeros(p, mean.ncols())).collect();
        unit.tests.iter().zip(&tests).for_each(|(test, r)| add(&mut groups[test.group], 1.0, r));
        for (number, group) in unit.groups.iter().enumerate().filter(|(number, group)| group.parent != *number) {
            let own = groups[number].clone();
            add(&mut groups[group.parent], 1.0, &own);
        }
        let root = |(number, group): (usize, &TreeGroup)| {
            let above = (group.parent != number).then(|| &means[group.parent]);
            own.groups[number].root(&y[number], above, &effects)
        };
        let roots = unit.groups.iter().enumerate().map(root).collect();
        UnitResponse { tests, groups, expected, means, roots }
    }

    /// The products x'Pz of data columns: (left - Bm̂)'(left - Bm̂) of all tests, and û'û of all effects. Where measurements
    /// are precise, these are small differences of the columns, not differences of large products.
    pub(super) fn products(&self, response: &Response, left: &[Vec<Rows>]) -> Rows {
        let columns = response.effects.ncols();
        let of_unit = |((unit, own), left): ((&Unit, &UnitResponse), &Vec<Rows>)| {
            let mut sum = Rows::zeros(columns, columns);
            for ((test, mean), left) in unit.tests.iter().zip(&own.expected).zip(left) {
                let rest = left.clone().less(&self.leaves[test.leaf].half.times(mean));
                add(&mut sum, 1.0, &rest.transpose_times(&rest));
            }
            own.roots.iter().for_each(|root| add(&mut sum, 1.0, &root.transpose_times(root)));
            sum
        };
        let units = self.part.units.par_iter().zip(&response.units).zip(left);
        let parts: Vec<Rows> = units.map(of_unit).collect();
        let mut sum = Rows::zeros(columns, columns);
        parts.iter().for_each(|part| add(&mut sum, 1.0, part));
        let roots = response.roots.transpose() * &response.roots;
        Rows::from_fn(columns, columns, |i, k| sum[(i, k)] + roots[(i, k)])
    }
}
