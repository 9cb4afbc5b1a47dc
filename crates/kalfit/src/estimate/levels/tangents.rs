//! How what is said moves with an element of a Σ: derivatives of r and W̄ of every test and group (theory §11).
//!
//! With E the derivative of Σ of a level, W and s of that level's members move by -WEW and -WEs, and of the groups above them by
//!
//! ```text
//! dW = G dJ G'      ds = G(dy - dJ Σ s)      G = (I+JΣ)⁻¹ = I - WΣ
//! ```
//!
//! On the way down, with (dm̂, dV) of the mean of a group, its members have
//!
//! ```text
//! dr = ds - dW m̂ - W dm̂      dW̄ = dW - dW V W - W V dW - W dV W
//! ```
#![expect(non_snake_case, reason = "W, V, E, G are the letters of the theory")]

use crate::estimate::levels::units::Design;
use crate::estimate::levels::walk::{At, Down, Mean, Walked};
use crate::linalg::rows::Rows;

/// An element of the Σ of a level, in both of its places.
#[derive(Debug, Clone, Copy)]
pub(super) struct Along {
    pub(super) level: usize,
    pub(super) row: usize,
    pub(super) column: usize,
}

/// What moves of a test or a group.
pub(super) struct Moved<'a> {
    pub(super) level: usize,
    /// Its number among the tests of the design; `None` for a group.
    pub(super) test: Option<usize>,
    pub(super) of: &'a Down,
    /// dr.
    pub(super) r: Rows,
    /// dW̄.
    pub(super) weight: Rows,
}

/// (dW, ds), where they are not zero.
type Change = Option<(Rows, Rows)>;

impl Along {
    /// E.
    fn matrix(self, p: usize) -> Rows {
        let mut matrix = Rows::zeros(p, p);
        matrix[(self.row, self.column)] = 1.0;
        matrix[(self.column, self.row)] = 1.0;
        matrix
    }

    /// Ex.
    fn times(self, x: &Rows) -> Rows {
        let mut moved = Rows::zeros(x.nrows(), x.ncols());
        moved.row_mut(self.row).copy_from_slice(x.row(self.column));
        moved.row_mut(self.column).copy_from_slice(x.row(self.row));
        moved
    }

    /// Tells what moves, groups first.
    pub(super) fn through(self, at: &At<'_>, (design, walked): (&Design, &Walked), tell: &mut dyn FnMut(Moved<'_>)) {
        let changes = self.up(at, design, walked);
        let mut means: Vec<Option<Mean>> = vec![None; design.groups.len()];
        for (own, node) in design.groups.iter().enumerate().rev() {
            let above = (node.parent != own).then(|| (&walked.means[node.parent], means[node.parent].as_ref()));
            let above = above.map(|(mean, moved)| (mean, moved.expect("it was visited")));
            let (up, down) = (&walked.up[own], &walked.down[own]);
            let change = changes[own].as_ref();
            let moved = moved((&up.W, down), change, above);
            let here = (node.level == self.level).then_some(self);
            means[own] = Some(inherited((&up.W, down, &at.sigmas[node.level]), (change, &moved), here, above));
            tell(Moved { level: node.level, test: None, of: down, r: moved.0, weight: moved.1 });
        }
        for (number, (member, down)) in design.tests.iter().zip(&walked.tests).enumerate() {
            let W = &at.leaves[member.leaf].W;
            let change = (self.level == 0).then(|| self.own(W, &walked.said[number]));
            let moving = means[member.group].as_ref().expect("it was visited");
            let (r, weight) = moved((W, down), change.as_ref(), Some((&walked.means[member.group], moving)));
            tell(Moved { level: 0, test: Some(number), of: down, r, weight });
        }
    }

    /// (dW, ds) of members of its own level.
    fn own(self, W: &Rows, s: &Rows) -> (Rows, Rows) {
        let known = W.times(&self.matrix(W.nrows()));
        (negative(known.times(W)), negative(known.times(s)))
    }

    /// (dW, ds) of the groups.
    fn up(self, at: &At<'_>, design: &Design, walked: &Walked) -> Vec<Change> {
        let mut gathered: Vec<Change> = vec![None; design.groups.len()];
        if self.level == 0 {
            for (member, s) in design.tests.iter().zip(&walked.said) {
                add(&mut gathered[member.group], self.own(&at.leaves[member.leaf].W, s));
            }
        }
        for (own, node) in design.groups.iter().enumerate() {
            let up = &walked.up[own];
            let change = match gathered[own].take() {
                _ if node.level == self.level => Some(self.own(&up.W, &up.s)),
                Some((J, y)) => {
                    let sigma = &at.sigmas[node.level];
                    let G = Rows::identity(sigma.nrows()).less(&up.W.times(sigma));
                    let left = y.less(&J.times(&sigma.times(&up.s)));
                    Some((G.times(&J).times_transpose(&G), G.times(&left)))
                }
                None => None,
            };
            if let (Some((W, s)), true) = (&change, node.parent != own) {
                add(&mut gathered[node.parent], (W.clone(), s.clone()));
            }
            gathered[own] = change;
        }
        gathered
    }
}

fn add(sum: &mut Change, more: (Rows, Rows)) {
    *sum = Some(match sum.take() {
        None => more,
        Some((W, s)) => (W.plus(&more.0), s.plus(&more.1)),
    });
}

fn negative(a: Rows) -> Rows {
    Rows::zeros(a.nrows(), a.ncols()).less(&a)
}

/// A + A'.
fn twice(a: &Rows) -> Rows {
    a.transposed().plus(a)
}

/// (dr, dW̄).
fn moved((W, down): (&Rows, &Down), change: Option<&(Rows, Rows)>, above: Option<(&Mean, &Mean)>) -> (Rows, Rows) {
    let p = W.nrows();
    let (mut r, mut weight) = match change {
        Some((dW, ds)) => (ds.clone(), dW.clone()),
        None => (Rows::zeros(p, down.r.ncols()), Rows::zeros(p, p)),
    };
    if let Some((mean, moving)) = above {
        r = r.less(&W.times(&moving.mean));
        weight = weight.less(&W.times(&moving.covariance).times(W));
        if let Some((dW, _)) = change {
            r = r.less(&dW.times(&mean.mean));
            weight = weight.less(&twice(&dW.times(&mean.covariance).times(W)));
        }
    }
    (r, weight)
}

/// (dm̂, dV) of the mean of the members of a group: of m̂ + Σr and TVT' + Σ - ΣWΣ with T = I - ΣW.
fn inherited(
    (W, down, sigma): (&Rows, &Down, &Rows),
    (change, moved): (Option<&(Rows, Rows)>, &(Rows, Rows)),
    here: Option<Along>,
    above: Option<(&Mean, &Mean)>,
) -> Mean {
    let p = W.nrows();
    let mut mean = sigma.times(&moved.0);
    let mut covariance = Rows::zeros(p, p);
    let mut turned = Rows::zeros(p, p); // dT
    if let Some((dW, _)) = change {
        let known = sigma.times(dW);
        covariance = covariance.less(&known.times(sigma));
        turned = turned.less(&known);
    }
    if let Some(along) = here {
        mean = mean.plus(&along.times(&down.r));
        let known = along.times(W);
        covariance = covariance.plus(&along.matrix(p)).less(&twice(&known.times(sigma)));
        turned = turned.less(&known);
    }
    if let Some((law, moving)) = above {
        let T = Rows::identity(p).less(&sigma.times(W));
        mean = mean.plus(&moving.mean);
        covariance = covariance
            .plus(&T.times(&moving.covariance).times_transpose(&T))
            .plus(&twice(&turned.times(&law.covariance).times_transpose(&T)));
    }
    Mean { mean, covariance }
}
