//! Through the groups of units that are alike, from the tests up and down again.
#![expect(non_snake_case, reason = "R, U, W, V are the letters of the theory")]

use std::ops::Range;

use rayon::prelude::*;

use crate::estimate::levels::units::{Design, Leaf, Member, Units};
use crate::estimate::point::{Point, Regressors};
use crate::linalg::factors::{Factors, Rotations};
use crate::linalg::rows::Rows;

/// The Σ of each level and the mean, at a point.
pub(super) struct At<'a> {
    pub(super) units: &'a Units,
    pub(super) point: &'a Point,
    pub(super) regressors: &'a Regressors,
    /// F' of each level, Σ = FF', tests first.
    roots: Vec<Rows>,
    pub(super) sigmas: Vec<Rows>,
    /// What tests of each design say of the mean of their group.
    pub(super) leaves: Vec<Solved>,
}

/// What the matrices of a reduction say once what is its own is integrated out.
#[derive(Debug, Clone)]
pub(super) struct Solved {
    /// U with U'U = I + RΣR'.
    upper: Rows,
    /// B = U⁻ᵀR.
    half: Rows,
    /// W = B'B.
    pub(super) W: Rows,
    /// log|I + RΣR'|.
    log_det: f64,
}

/// A node on the way up: what it says of the mean of its group.
#[derive(Debug, Clone)]
pub(super) struct Up {
    pub(super) W: Rows,
    /// s, one column for each unit after those of the mean coordinates.
    pub(super) s: Rows,
    /// [R | d] of all that its members say of their mean, by columns as s.
    said: Rows,
    /// Squares of each column that are left of its members, its tests apart from that in inner groups.
    left: Vec<f64>,
    /// log|…| of its members.
    log_det: f64,
}

/// A node on the way down.
#[derive(Debug, Clone)]
pub(super) struct Down {
    /// r, one column for each unit after those of the mean coordinates.
    pub(super) r: Rows,
    /// W̄.
    pub(super) weight: Rows,
}

/// The posterior of the mean of the members of a group.
#[derive(Debug, Clone)]
pub(super) struct Mean {
    /// Less its own mean, by columns as [`Down::r`].
    pub(super) mean: Rows,
    /// V.
    pub(super) covariance: Rows,
}

/// What units that are alike say at a point.
pub(super) struct Walked {
    /// Columns before those of the units: what the mean coordinates do.
    pub(super) before: usize,
    pub(super) units: usize,
    /// log|…| of one of them.
    pub(super) log_det: f64,
    /// Squares that are left, of all.
    pub(super) quadratic: f64,
    /// Of the groups.
    pub(super) up: Vec<Up>,
    pub(super) down: Vec<Down>,
    pub(super) means: Vec<Mean>,
    /// s of the tests, what else is known of them, and WV with V of the mean of their group.
    pub(super) said: Vec<Rows>,
    pub(super) tests: Vec<Down>,
    pub(super) known: Vec<Rows>,
}

impl<'a> At<'a> {
    pub(super) fn new(units: &'a Units, point: &'a Point, regressors: &'a Regressors) -> At<'a> {
        let p = units.states;
        let block = |l: usize| point.root.view((l * p, l * p), (p, p)).transpose();
        let roots: Vec<Rows> = (0..units.levels()).map(|l| Rows::from(&block(l))).collect();
        let sigmas = roots.iter().map(|root| root.transpose_times(root)).collect();
        let leaves = units.leaves.par_iter().map(|leaf| Solved::of(&leaf.factor, &roots[0])).collect();
        At { units, point, regressors, roots, sigmas, leaves }
    }

    /// μ of the tests of a leaf.
    pub(super) fn mean_of(&self, leaf: &Leaf) -> Vec<f64> {
        let (p, levels) = (self.units.states, self.units.levels());
        let mut mean: Vec<f64> = (0..p).map(|i| (0..levels).map(|l| self.point.mean[l * p + i]).sum()).collect();
        for (c, &element) in self.regressors.iter().enumerate() {
            mean[element] += leaf.covariates[c] * self.point.coefficients[c];
        }
        mean
    }

    /// W of the tests of a design.
    pub(super) fn weight_of(&self, member: Member) -> &Rows {
        &self.leaves[member.leaf].W
    }

    /// F' of a level.
    pub(super) fn root(&self, level: usize) -> &Rows {
        &self.roots[level]
    }

    /// What a mean coordinate does to a state of the tests of a leaf.
    pub(super) fn effect(&self, leaf: &Leaf, state: usize, coordinate: usize) -> f64 {
        match coordinate.checked_sub(self.units.states) {
            None => f64::from(u8::from(coordinate == state)),
            Some(c) if self.regressors[c] == state => leaf.covariates[c],
            Some(_) => 0.0,
        }
    }

    /// d - Rμ of some units, after R times what each mean coordinate does to ξ, if that is wanted.
    fn data(&self, (leaf, data): (&Leaf, &Rows), units: &Range<usize>, before: usize) -> Rows {
        let (p, mean) = (self.units.states, self.mean_of(leaf));
        let mut all = Rows::zeros(p, before + units.len());
        for i in 0..p {
            let factor = leaf.factor.row(i);
            let moved: f64 = (i..p).map(|k| factor[k] * mean[k]).sum();
            let row = all.row_mut(i);
            let (first, rest) = row.split_at_mut(before);
            for (c, x) in first.iter_mut().enumerate() {
                *x = match c.checked_sub(p) {
                    None => factor[c],
                    Some(c) => leaf.covariates[c] * factor[self.regressors[c]],
                };
            }
            rest.iter_mut().zip(&data.row(i)[units.clone()]).for_each(|(to, d)| *to = self.units.unit * d - moved);
        }
        all
    }

    /// Up and down through some units of a design; with what the mean coordinates do, if that is wanted.
    pub(super) fn walked(&self, design: &Design, units: Range<usize>, coordinates: bool) -> Walked {
        let before = if coordinates { self.units.states + self.regressors.len() } else { 0 };
        let mut walked = Walked {
            before,
            units: units.len(),
            log_det: 0.0,
            quadratic: 0.0,
            up: Vec::with_capacity(design.groups.len()),
            down: Vec::new(),
            means: Vec::new(),
            said: Vec::with_capacity(design.tests.len()),
            tests: Vec::with_capacity(design.tests.len()),
            known: Vec::with_capacity(design.tests.len()),
        };
        self.up(design, &units, &mut walked);
        self.down(design, &mut walked);
        walked
    }

    /// From the tests to the units.
    fn up(&self, design: &Design, units: &Range<usize>, walked: &mut Walked) {
        let p = self.units.states;
        let width = p + walked.before + units.len();
        let mut gathered = vec![Gathered::none(p, width); design.groups.len()];
        for (member, data) in design.tests.iter().zip(&design.data) {
            let (leaf, solved) = (&self.units.leaves[member.leaf], &self.leaves[member.leaf]);
            let left = Rows::solved_below(&solved.upper, self.data((leaf, data), units, walked.before));
            walked.said.push(solved.half.transpose_times(&left));
            gathered[member.group].take(solved, &left);
        }
        for (at, node) in design.groups.iter().enumerate() {
            let own = std::mem::replace(&mut gathered[at], Gathered::none(0, 0));
            let solved = Solved::of(&own.upper.first_columns(p), &self.roots[node.level]);
            let left = Rows::solved_below(&solved.upper, own.upper.last_columns(width - p));
            let s = solved.half.transpose_times(&left);
            walked.log_det += own.log_det;
            walked.quadratic += own.left[walked.before..].iter().sum::<f64>();
            if node.parent == at {
                walked.log_det += solved.log_det;
                walked.quadratic += squares(&left)[walked.before..].iter().sum::<f64>();
            } else {
                gathered[node.parent].take(&solved, &left);
            }
            walked.up.push(Up { W: solved.W, s, said: own.upper, left: own.left, log_det: own.log_det });
        }
    }

    /// From the units to the tests.
    fn down(&self, design: &Design, walked: &mut Walked) {
        let count = design.groups.len();
        let (mut down, mut means) = (vec![None; count], vec![None; count]);
        for at in (0..count).rev() {
            let (node, up) = (design.groups[at], &walked.up[at]);
            let sigma = &self.sigmas[node.level];
            let above = if node.parent == at { None } else { means[node.parent].as_ref() };
            let own = Down::of((&up.W, up.s.clone()), above);
            means[at] = Some(Mean::of((&up.W, &own.r), sigma, above));
            down[at] = Some(own);
        }
        walked.down = down.into_iter().map(|one| one.expect("it was visited")).collect();
        walked.means = means.into_iter().map(|one| one.expect("it was visited")).collect();
        for (member, s) in design.tests.iter().zip(&walked.said) {
            let (W, mean) = (&self.leaves[member.leaf].W, &walked.means[member.group]);
            let known = W.times(&mean.covariance);
            let r = s.clone().less(&W.times(&mean.mean));
            walked.tests.push(Down { r, weight: W.clone().less(&known.times(W)) });
            walked.known.push(known);
        }
    }
}

impl Walked {
    /// log|…| of all that stands in a group, but of the group itself, and the squares of each column that are left of it.
    pub(super) fn within(&self, design: &Design, group: usize) -> (f64, Vec<f64>) {
        let inner = (0..design.groups.len()).filter(|&own| design.stands_in(own, group));
        let mut sum = (0.0, vec![0.0; self.before + self.units]);
        for up in inner.map(|own| &self.up[own]) {
            sum.0 += up.log_det;
            sum.1.iter_mut().zip(&up.left).for_each(|(sum, x)| *sum += x);
        }
        sum
    }
}

impl Up {
    /// The squares of each column and log|I + RΣR'| where the group is by itself; `root`: F' of the Σ that it has then.
    pub(super) fn apart(&self, root: &Rows) -> (Vec<f64>, f64) {
        let p = self.said.nrows();
        let solved = Solved::of(&self.said.first_columns(p), root);
        let left = Rows::solved_below(&solved.upper, self.said.last_columns(self.said.ncols() - p));
        (squares(&left), solved.log_det)
    }

    /// Rank of R.
    pub(super) fn rank(&self) -> usize {
        let p = self.said.nrows();
        (0..p).filter(|&i| self.said.row(i)[i..p].iter().any(|x| *x != 0.0)).count()
    }
}

/// What the members of a group say together.
#[derive(Clone)]
struct Gathered {
    /// [R | d].
    upper: Rows,
    /// Squares of each column that are left.
    left: Vec<f64>,
    log_det: f64,
}

impl Gathered {
    fn none(p: usize, width: usize) -> Gathered {
        Gathered { upper: Rows::zeros(p, width), left: vec![0.0; width - p], log_det: 0.0 }
    }

    /// Folds in what a member says.
    fn take(&mut self, solved: &Solved, data: &Rows) {
        let p = self.upper.nrows();
        let rest = Rotations::absorb(&mut self.upper, solved.half.beside(data), p);
        for i in 0..p {
            self.left.iter_mut().zip(&rest.row(i)[p..]).for_each(|(sum, x)| *sum += x * x);
        }
        self.log_det += solved.log_det;
    }
}

/// Sum of squares of each column.
fn squares(left: &Rows) -> Vec<f64> {
    let mut sums = vec![0.0; left.ncols()];
    for i in 0..left.nrows() {
        sums.iter_mut().zip(left.row(i)).for_each(|(sum, x)| *sum += x * x);
    }
    sums
}

impl Solved {
    /// From R and F'.
    fn of(factor: &Rows, root: &Rows) -> Solved {
        let upper = Rotations::identity_plus(&root.times_transpose(factor));
        let log_det = 2.0 * (0..upper.nrows()).map(|i| upper[(i, i)].ln()).sum::<f64>();
        let half = Rows::solved_below(&upper, factor.clone());
        Solved { W: half.transpose_times(&half), half, upper, log_det }
    }
}

impl Down {
    fn of((W, s): (&Rows, Rows), above: Option<&Mean>) -> Down {
        match above {
            None => Down { r: s, weight: W.clone() },
            Some(above) => {
                Down { r: s.less(&W.times(&above.mean)), weight: W.clone().less(&W.times(&above.covariance).times(W)) }
            }
        }
    }
}

impl Mean {
    pub(super) fn of((W, r): (&Rows, &Rows), sigma: &Rows, above: Option<&Mean>) -> Mean {
        let (own, known) = (sigma.times(r), sigma.times(W));
        let left = sigma.clone().less(&known.times(sigma));
        match above {
            None => Mean { mean: own, covariance: left },
            Some(above) => {
                let rest = Rows::identity(known.nrows()).less(&known);
                let inherited = rest.times(&above.covariance).times_transpose(&rest);
                Mean { mean: own.plus(&above.mean), covariance: left.plus(&inherited) }
            }
        }
    }
}
