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
    pub(super) r: &'a Rows,
    /// dW̄.
    pub(super) weight: &'a Rows,
}

/// Where what moves of one test after the other is worked out.
pub(super) struct Scratch {
    r: Rows,
    weight: Rows,
    /// Er + dm̂, and E - EWV - VWE + dV.
    shift: Rows,
    inner: Rows,
    half: Rows,
}

impl Scratch {
    /// For p states and so many columns.
    pub(super) fn new(p: usize, columns: usize) -> Scratch {
        let square = || Rows::zeros(p, p);
        let wide = || Rows::zeros(p, columns);
        Scratch { r: wide(), weight: square(), shift: wide(), inner: square(), half: square() }
    }
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
    pub(super) fn through(
        self,
        at: &At<'_>,
        (design, walked): (&Design, &Walked),
        scratch: &mut Scratch,
        tell: &mut dyn FnMut(Moved<'_>),
    ) {
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
            tell(Moved { level: node.level, test: None, of: down, r: &moved.0, weight: &moved.1 });
        }
        for (number, (member, down)) in design.tests.iter().zip(&walked.tests).enumerate() {
            let moving = means[member.group].as_ref().expect("it was visited");
            self.test((&at.leaves[member.leaf].W, &walked.known[number]), down, moving, scratch);
            tell(Moved { level: 0, test: Some(number), of: down, r: &scratch.r, weight: &scratch.weight });
        }
    }

    /// dr = -W(Er + dm̂) and dW̄ = -W(E - EWV - VWE + dV)W of a test, E where it is of the tests' own level.
    fn test(self, (W, known): (&Rows, &Rows), down: &Down, moving: &Mean, scratch: &mut Scratch) {
        let p = W.nrows();
        let Scratch { r, weight, shift, inner, half } = scratch;
        for i in 0..p {
            shift.row_mut(i).copy_from_slice(moving.mean.row(i));
            inner.row_mut(i).copy_from_slice(moving.covariance.row(i));
        }
        if self.level == 0 {
            let places = [(self.row, self.column), (self.column, self.row)];
            for (i, k) in places.into_iter().take(if self.row == self.column { 1 } else { 2 }) {
                shift.row_mut(i).iter_mut().zip(down.r.row(k)).for_each(|(to, x)| *to += x);
                inner[(i, k)] += 1.0;
                for c in 0..p {
                    let both = known[(k, c)];
                    inner[(i, c)] -= both;
                    inner[(c, i)] -= both;
                }
            }
        }
        product(-1.0, W, shift, r);
        product(-1.0, W, inner, half);
        product(1.0, half, W, weight);
    }

    /// (dW, ds) of a group of its own level.
    fn own(self, W: &Rows, s: &Rows) -> (Rows, Rows) {
        let mut change = (Rows::zeros(W.nrows(), W.nrows()), Rows::zeros(s.nrows(), s.ncols()));
        self.add_own(&mut change, (W, s));
        change
    }

    /// Adds (dW, ds) of a member of its own level: -WEW and -WEs.
    fn add_own(self, (sum_W, sum_s): &mut (Rows, Rows), (W, s): (&Rows, &Rows)) {
        let places = [(self.row, self.column), (self.column, self.row)];
        for (i, k) in places.into_iter().take(if self.row == self.column { 1 } else { 2 }) {
            for row in 0..W.nrows() {
                let x = W[(row, i)];
                sum_W.row_mut(row).iter_mut().zip(W.row(k)).for_each(|(sum, w)| *sum -= x * w);
                sum_s.row_mut(row).iter_mut().zip(s.row(k)).for_each(|(sum, s)| *sum -= x * s);
            }
        }
    }

    /// (dW, ds) of the groups.
    fn up(self, at: &At<'_>, design: &Design, walked: &Walked) -> Vec<Change> {
        let mut gathered: Vec<Change> = vec![None; design.groups.len()];
        if self.level == 0 {
            for (member, s) in design.tests.iter().zip(&walked.said) {
                let W = &at.leaves[member.leaf].W;
                let none = || (Rows::zeros(W.nrows(), W.nrows()), Rows::zeros(s.nrows(), s.ncols()));
                self.add_own(gathered[member.group].get_or_insert_with(none), (W, s));
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

/// AB, so many times, into a matrix of its shape.
fn product(scale: f64, a: &Rows, b: &Rows, into: &mut Rows) {
    for i in 0..a.nrows() {
        into.row_mut(i).fill(0.0);
        for k in 0..a.ncols() {
            let x = scale * a[(i, k)];
            into.row_mut(i).iter_mut().zip(b.row(k)).for_each(|(sum, b)| *sum += x * b);
        }
    }
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
