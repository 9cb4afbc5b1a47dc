//! Pz for data columns z: the responses of all tests, groups and levels.

use nalgebra::DMatrix;
use rayon::prelude::*;

use crate::levels::crossed::dense::{Dense, rows_of};
use crate::levels::crossed::eliminated::EliminatedUnit;
use crate::levels::crossed::layout::{Part, Unit};
use crate::levels::crossed::weights::UnitWeights;
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
    /// What is subtracted from the products of the columns: Σ y'Hy + y'Cy, columns × columns.
    pub(super) explained: DMatrix<f64>,
}

/// Responses of one unit, each p × columns.
pub(super) struct UnitResponse {
    /// r = s - Wm̂ of each test.
    pub(super) tests: Vec<Rows>,
    /// r of each group.
    pub(super) groups: Vec<Rows>,
    /// α - Γb̂ of each group: the posterior mean of the sum of the effects of the group and of the groups around it.
    pub(super) means: Vec<Rows>,
}

/// Upward data of one unit.
struct UnitData {
    /// y = Σs of each group.
    y: Vec<Rows>,
    /// s = T'y of each group.
    s: Vec<Rows>,
    /// E's - ΣD'Hy over the levels that the unit meets.
    of_levels: Rows,
    /// Σ y'Hy.
    explained: Rows,
}

impl PartAt<'_> {
    /// The responses to data columns, given s of each test by unit.
    pub(super) fn respond(&self, said: &[Vec<Rows>], columns: usize) -> Response {
        let p = self.p;
        let units = || self.part.units.par_iter().zip(&self.units).zip(said);
        let up: Vec<UnitData> = units().map(|((unit, own), s)| self.up(unit, own, s, columns)).collect();
        let mut y = DMatrix::zeros(self.dense.K.nrows(), columns);
        let mut explained = DMatrix::zeros(columns, columns);
        for (unit, data) in self.part.units.iter().zip(&up) {
            for (level, &place) in unit.met.iter().enumerate() {
                for i in 0..p {
                    let row = data.of_levels.row(level * p + i);
                    row.iter().enumerate().for_each(|(c, x)| y[(place * p + i, c)] += x);
                }
            }
            for a in 0..columns {
                (0..columns).for_each(|b| explained[(a, b)] += data.explained[(a, b)]);
            }
        }
        let effects = &self.dense.C * &y;
        explained += y.transpose() * &effects;
        let levels = &y - &self.dense.K * &effects;
        let down = |(((unit, own), weights), (s, data)): (_, (&Vec<Rows>, &UnitData))| {
            self.down((unit, own, weights), (s, data), &effects)
        };
        let all = self.part.units.par_iter().zip(&self.units).zip(&self.weights).zip(said.par_iter().zip(&up));
        Response { units: all.map(down).collect(), levels, effects, explained }
    }

    fn up(&self, unit: &Unit, own: &EliminatedUnit, said: &[Rows], columns: usize) -> UnitData {
        let p = self.p;
        let mut y: Vec<Rows> = unit.groups.iter().map(|_| Rows::zeros(p, columns)).collect();
        let mut of_levels = Rows::zeros(unit.met.len() * p, columns);
        for (test, s) in unit.tests.iter().zip(said) {
            add(&mut y[test.group], s);
            for &member in &test.members {
                for i in 0..p {
                    let row = of_levels.row_mut(member * p + i);
                    row.iter_mut().zip(s.row(i)).for_each(|(sum, x)| *sum += x);
                }
            }
        }
        let mut s = Vec::with_capacity(unit.groups.len());
        let mut explained = Rows::zeros(columns, columns);
        for (number, (group, own)) in unit.groups.iter().zip(&own.groups).enumerate() {
            let up = own.T.transpose_times(&y[number]);
            of_levels = of_levels.less(&own.HD.transpose_times(&y[number]));
            explained = explained.plus(&y[number].transpose_times(&own.H.times(&y[number])));
            if group.parent != number {
                add(&mut y[group.parent], &up);
            }
            s.push(up);
        }
        UnitData { y, s, of_levels, explained }
    }

    fn down(
        &self,
        (unit, own, weights): (&Unit, &EliminatedUnit, &UnitWeights),
        (said, data): (&[Rows], &UnitData),
        effects: &DMatrix<f64>,
    ) -> UnitResponse {
        let p = self.p;
        let effects = rows_of(effects, unit, p);
        let last = unit.groups.len() - 1;
        // from the unit on, so that each group follows the group around it
        let (mut alphas, mut groups): (Vec<Rows>, Vec<Rows>) = (Vec::new(), Vec::new());
        let mut means: Vec<Rows> = Vec::new();
        for (number, group) in unit.groups.iter().enumerate().rev() {
            let eliminated = &own.groups[number];
            let mut alpha = eliminated.H.times(&data.y[number]);
            let mut r = data.s[number].clone().less(&eliminated.up.times(&effects));
            if group.parent != number {
                alpha = alpha.plus(&eliminated.T.times(&alphas[last - group.parent]));
                r = r.less(&eliminated.W.times(&means[last - group.parent]));
            }
            means.push(alpha.clone().less(&weights.groups[number].gamma.times(&effects)));
            alphas.push(alpha);
            groups.push(r);
        }
        means.reverse();
        groups.reverse();
        let one = |(test, s): (&crate::levels::crossed::layout::CrossedTest, &Rows)| {
            let mut mean = means[test.group].clone();
            for &member in &test.members {
                for i in 0..p {
                    let row = mean.row_mut(i);
                    row.iter_mut().zip(effects.row(member * p + i)).for_each(|(sum, x)| *sum += x);
                }
            }
            s.clone().less(&self.leaves[test.leaf].W.times(&mean))
        };
        let tests = unit.tests.iter().zip(said).map(one).collect();
        UnitResponse { tests, groups, means }
    }
}

fn add(sum: &mut Rows, more: &Rows) {
    for i in 0..more.nrows() {
        sum.row_mut(i).iter_mut().zip(more.row(i)).for_each(|(sum, x)| *sum += x);
    }
}
