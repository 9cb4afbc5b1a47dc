//! Derivatives of r and W̄ of every test and group by an element of a Σ (theory §11).
//!
//! With E the derivative of Σ of a level, W and s of the members at that level change by -WEW and -WEs, and W and s of
//! the groups above these members by
//!
//! ```text
//! dW = G dJ G'      ds = G(dy - dJ Σ s)      G = (I+JΣ)⁻¹ = I - WΣ
//! ```
//!
//! In the downward pass, with (dm̂, dV) of the mean of a group, its members have
//!
//! ```text
//! dr = ds - dW m̂ - W dm̂      dW̄ = dW - dW V W - W V dW - W dV W
//! ```
#![expect(non_snake_case, reason = "W, V, E, G are the letters of the theory")]

use kalfit_lanes::Lanes;

use crate::levels::batch_data::BatchData;
use crate::levels::walk::{Down, GroupMean, LevelLaws, PassResults};
use kalfit_algebra::rows::Rows;

/// An element of the Σ of a level, in both triangles.
#[derive(Debug, Clone, Copy)]
pub(super) struct SigmaElement {
    pub(super) level: usize,
    pub(super) row: usize,
    pub(super) column: usize,
}

/// Derivatives of r and W̄ of a test or a group by an element of a Σ.
pub(super) struct NodeTangent<'a, T> {
    pub(super) level: usize,
    /// Index of the test in the batch data; `None` for a group.
    pub(super) test: Option<usize>,
    pub(super) of: &'a Down<T>,
    /// dr, with the columns of r.
    pub(super) r: &'a Rows<T>,
    /// dW̄, p × p.
    pub(super) weight: &'a Rows<T>,
}

/// Buffers for the derivatives of one test after the other.
pub(super) struct Scratch<T> {
    r: Rows<T>,
    weight: Rows<T>,
    /// Er + dm̂.
    shift: Rows<T>,
    /// E - EWV - VWE + dV.
    inner: Rows<T>,
    half: Rows<T>,
}

impl<T: Lanes> Scratch<T> {
    /// Buffers for p states and `columns` columns.
    #[inline(always)]
    pub(super) fn new(p: usize, columns: usize) -> Scratch<T> {
        Scratch {
            r: Rows::zeros(p, columns),
            weight: Rows::zeros(p, p),
            shift: Rows::zeros(p, columns),
            inner: Rows::zeros(p, p),
            half: Rows::zeros(p, p),
        }
    }
}

/// Derivatives (dW, ds) or (dr, dW̄).
type TangentPair<T> = (Rows<T>, Rows<T>);
/// Derivatives (dW, ds); `None` where both are zero.
type WeightTangent<T> = Option<TangentPair<T>>;

impl SigmaElement {
    /// Positions of the element in the matrix: two, or one on the diagonal.
    #[inline(always)]
    pub(super) fn places(self) -> impl Iterator<Item = (usize, usize)> {
        let places = [(self.row, self.column), (self.column, self.row)];
        places.into_iter().take(if self.row == self.column { 1 } else { 2 })
    }

    /// The matrix E.
    #[inline(always)]
    pub(super) fn matrix<T: Lanes>(self, p: usize) -> Rows<T> {
        let mut matrix = Rows::zeros(p, p);
        for place in self.places() {
            matrix[place] = T::splat(1.0);
        }
        matrix
    }

    /// The product Ex.
    #[inline(always)]
    fn times<T: Lanes>(self, x: &Rows<T>) -> Rows<T> {
        let mut moved = Rows::zeros(x.nrows(), x.ncols());
        for (i, k) in self.places() {
            moved.row_mut(i).copy_from_slice(x.row(k));
        }
        moved
    }

    /// Calls `on_tangent` with the derivatives of every group, then of every test.
    #[inline(always)]
    pub(super) fn each_tangent<T: Lanes>(
        self,
        at: &LevelLaws<'_, T>,
        (batch, results): (&BatchData<'_, T>, &PassResults<T>),
        scratch: &mut Scratch<T>,
        mut on_tangent: impl FnMut(NodeTangent<'_, T>),
    ) {
        let changes = self.up(at, batch, results);
        let last = batch.groups.len() - 1;
        let mut means: Vec<GroupMean<T>> = Vec::with_capacity(batch.groups.len()); // in reverse order of the groups
        for (own, node) in batch.groups.iter().enumerate().rev() {
            let above = match node.parent == own {
                true => None,
                false => Some((&results.means[node.parent], &means[last - node.parent])),
            };
            let (up, down) = (&results.up[own], &results.down[own]);
            let change = changes[own].as_ref();
            let moved = moved((&up.W, down), change, above);
            let own_element = (node.level == self.level).then_some(self);
            let mean = inherited((&up.W, down, &at.sigmas[node.level]), (change, &moved), own_element, above);
            means.push(mean);
            on_tangent(NodeTangent { level: node.level, test: None, of: down, r: &moved.0, weight: &moved.1 });
        }
        for (number, (member, down)) in batch.tests.iter().zip(&results.tests).enumerate() {
            let mean_tangent = &means[last - member.group];
            self.test((&results.leaves[member.leaf].W, &results.known[number]), down, mean_tangent, scratch);
            on_tangent(NodeTangent { level: 0, test: Some(number), of: down, r: &scratch.r, weight: &scratch.weight });
        }
    }

    /// dr = -W(Er + dm̂) and dW̄ = -W(E - EWV - VWE + dV)W of a test; E is zero unless the element is of the tests'
    /// level.
    #[inline(always)]
    fn test<T: Lanes>(
        self,
        (W, known): (&Rows<T>, &Rows<T>),
        down: &Down<T>,
        mean_tangent: &GroupMean<T>,
        scratch: &mut Scratch<T>,
    ) {
        let p = W.nrows();
        let Scratch { r, weight, shift, inner, half } = scratch;
        for i in 0..p {
            shift.row_mut(i).copy_from_slice(mean_tangent.mean.row(i));
            inner.row_mut(i).copy_from_slice(mean_tangent.covariance.row(i));
        }
        if self.level == 0 {
            for (i, k) in self.places() {
                for (to, &x) in shift.row_mut(i).iter_mut().zip(down.r.row(k)) {
                    *to = *to + x;
                }
                inner[(i, k)] = inner[(i, k)] + T::splat(1.0);
                for c in 0..p {
                    let both = known[(k, c)];
                    inner[(i, c)] = inner[(i, c)] - both;
                    inner[(c, i)] = inner[(c, i)] - both;
                }
            }
        }
        product(-1.0, W, shift, r);
        product(-1.0, W, inner, half);
        product(1.0, half, W, weight);
    }

    /// Adds (dW, ds) of a member at the level of the element: -WEW and -WEs.
    #[inline(always)]
    fn add_own<T: Lanes>(self, (sum_W, sum_s): &mut TangentPair<T>, (W, s): (&Rows<T>, &Rows<T>)) {
        for (i, k) in self.places() {
            for row in 0..W.nrows() {
                let x = W[(row, i)];
                for (sum, &w) in sum_W.row_mut(row).iter_mut().zip(W.row(k)) {
                    *sum = x.fnma(w, *sum);
                }
                for (sum, &s) in sum_s.row_mut(row).iter_mut().zip(s.row(k)) {
                    *sum = x.fnma(s, *sum);
                }
            }
        }
    }

    /// Upward pass: (dW, ds) of the groups.
    #[inline(always)]
    fn up<T: Lanes>(
        self,
        at: &LevelLaws<'_, T>,
        batch: &BatchData<'_, T>,
        results: &PassResults<T>,
    ) -> Vec<WeightTangent<T>> {
        let mut gathered: Vec<WeightTangent<T>> = Vec::with_capacity(batch.groups.len());
        for _ in batch.groups {
            gathered.push(None);
        }
        let none = |W: &Rows<T>, s: &Rows<T>| (Rows::zeros(W.nrows(), W.nrows()), Rows::zeros(s.nrows(), s.ncols()));
        if self.level == 0 {
            for (member, s) in batch.tests.iter().zip(&results.said) {
                let W = &results.leaves[member.leaf].W;
                self.add_own(gathered[member.group].get_or_insert_with(|| none(W, s)), (W, s));
            }
        }
        for (own, node) in batch.groups.iter().enumerate() {
            let up = &results.up[own];
            let change = match gathered[own].take() {
                _ if node.level == self.level => {
                    let mut change = none(&up.W, &up.s);
                    self.add_own(&mut change, (&up.W, &up.s));
                    Some(change)
                }
                Some((J, y)) => {
                    let sigma = &at.sigmas[node.level];
                    let G = Rows::identity(sigma.nrows()).less(&up.W.times(sigma));
                    let left = y.less(&J.times(&sigma.times(&up.s)));
                    Some((G.times(&J).times_transpose(&G), G.times(&left)))
                }
                None => None,
            };
            if let (Some((W, s)), true) = (&change, node.parent != own) {
                add(&mut gathered[node.parent], (W, s));
            }
            gathered[own] = change;
        }
        gathered
    }
}

#[inline(always)]
fn add<T: Lanes>(sum: &mut WeightTangent<T>, (W, s): (&Rows<T>, &Rows<T>)) {
    *sum = Some(match sum.take() {
        None => (W.clone(), s.clone()),
        Some((sum_W, sum_s)) => (sum_W.plus(W), sum_s.plus(s)),
    });
}

/// Writes scale × AB into `into`.
#[inline(always)]
fn product<T: Lanes>(scale: f64, a: &Rows<T>, b: &Rows<T>, into: &mut Rows<T>) {
    for i in 0..a.nrows() {
        into.row_mut(i).fill(T::splat(0.0));
        for k in 0..a.ncols() {
            let x = T::splat(scale) * a[(i, k)];
            for (sum, &b) in into.row_mut(i).iter_mut().zip(b.row(k)) {
                *sum = x.fma(b, *sum);
            }
        }
    }
}

/// The sum A + A'.
#[inline(always)]
fn with_transpose<T: Lanes>(a: &Rows<T>) -> Rows<T> {
    a.transposed().plus(a)
}

/// (dr, dW̄) of a group; `above`: posterior of the mean of the enclosing group, and the derivative of this posterior.
#[inline(always)]
fn moved<T: Lanes>(
    (W, down): (&Rows<T>, &Down<T>),
    change: Option<&TangentPair<T>>,
    above: Option<(&GroupMean<T>, &GroupMean<T>)>,
) -> TangentPair<T> {
    let p = W.nrows();
    let (mut r, mut weight) = match change {
        Some((dW, ds)) => (ds.clone(), dW.clone()),
        None => (Rows::zeros(p, down.r.ncols()), Rows::zeros(p, p)),
    };
    if let Some((mean, mean_tangent)) = above {
        r = r.less(&W.times(&mean_tangent.mean));
        weight = weight.less(&W.times(&mean_tangent.covariance).times(W));
        if let Some((dW, _)) = change {
            r = r.less(&dW.times(&mean.mean));
            weight = weight.less(&with_transpose(&dW.times(&mean.covariance).times(W)));
        }
    }
    (r, weight)
}

/// (dm̂, dV) of the mean of the members of a group: derivatives of m̂ + Σr and TVT' + Σ - ΣWΣ with T = I - ΣW.
#[inline(always)]
fn inherited<T: Lanes>(
    (W, down, sigma): (&Rows<T>, &Down<T>, &Rows<T>),
    (change, moved): (Option<&TangentPair<T>>, &TangentPair<T>),
    own_element: Option<SigmaElement>,
    above: Option<(&GroupMean<T>, &GroupMean<T>)>,
) -> GroupMean<T> {
    let p = W.nrows();
    let mut mean = sigma.times(&moved.0);
    let mut covariance = Rows::zeros(p, p);
    let mut rest_tangent = Rows::zeros(p, p); // dT
    if let Some((dW, _)) = change {
        let known = sigma.times(dW);
        covariance = covariance.less(&known.times(sigma));
        rest_tangent = rest_tangent.less(&known);
    }
    if let Some(along) = own_element {
        mean = mean.plus(&along.times(&down.r));
        let known = along.times(W);
        covariance = covariance.plus(&along.matrix(p)).less(&with_transpose(&known.times(sigma)));
        rest_tangent = rest_tangent.less(&known);
    }
    if let Some((law, mean_tangent)) = above {
        let rest = Rows::identity(p).less(&sigma.times(W));
        mean = mean.plus(&mean_tangent.mean);
        covariance = covariance
            .plus(&rest.times(&mean_tangent.covariance).times_transpose(&rest))
            .plus(&with_transpose(&rest_tangent.times(&law.covariance).times_transpose(&rest)));
    }
    GroupMean { mean, covariance }
}
