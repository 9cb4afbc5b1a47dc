//! Derivatives of N of all tests, groups and levels along an element of a Σ, summed by block (theory §16, (A9)).
//!
//! With E the derivative of Σ of one kind of node, upwards and then, with dC from dK, downwards:
//!
//! ```text
//! tests:   dW = -WEW
//! groups:  dH = -H dJ H + TET'      dT = -H dJ T - TEW      dW = T'dJ T - WEW
//!          d(HD) = H(dD - dJ HD) + TE T'D      d(T'D) = T'(dD - dJ HD) - WE T'D
//!          dK = -dD'HD - (HD)'dD + (HD)'dJ HD - (T'D)'E T'D
//! levels:  dC = -C dK C + (I-CK)E(I-KC)      dN = (I-KC)dK(I-CK) - NEN
//! ```
//!
//! where the terms with E are those of the nodes at the level of E alone. The second derivatives are symmetric, so that N
//! is followed only at the level of E and at those above it: tests, then groups from the innermost on, then factors.
#![expect(non_snake_case, reason = "W, J, D, H, T, K, C, N, E are the letters of the theory")]

use nalgebra::DMatrix;
use rayon::prelude::*;

use crate::levels::crossed::dense::gathered;
use crate::levels::crossed::eliminated::{EliminatedGroup, EliminatedUnit, scatter};
use crate::levels::crossed::layout::{Crossing, Unit};
use crate::levels::crossed::member::add_members;
use crate::levels::crossed::respond::PartAt;
use crate::levels::crossed::weights::{GroupWeights, UnitWeights, with_transpose};
use crate::levels::tangents::SigmaElement;
use crate::levels::totals::add;
use crate::levels::walk::Integrated;
use kalfit_algebra::rows::Rows;

/// Derivatives of the matrices of one group; those that vanish are absent.
struct GroupTangent {
    H: Rows,
    T: Rows,
    W: Rows,
    HD: Rows,
    up: Rows,
}

/// Derivatives of the matrices of one unit, from its tests up.
struct UnitTangent {
    groups: Vec<Option<GroupTangent>>,
    K: Rows,
}

/// Derivatives of J and D of a group.
struct MembersTangent {
    J: Rows,
    D: Rows,
}

impl PartAt<'_> {
    /// Σ dN along an element over the nodes of each block of Σ from that of the element on, in the order of tests, groups
    /// and factors; zero for blocks before.
    pub(super) fn weights_along(&self, crossing: &Crossing, element: SigmaElement) -> Vec<Rows> {
        let p = self.p;
        let E = element.matrix(p);
        if let Some(factor) = crossing.factors.iter().position(|&own| own == element.level) {
            return self.along_factor(crossing, factor, &E);
        }
        let of_tests: Option<Vec<Rows>> = (element.level == 0).then(|| {
            let of = |leaf: &Integrated<f64>| minus(&leaf.W.times(&E).times(&leaf.W));
            self.leaves.iter().map(of).collect()
        });
        let units = || self.part.units.par_iter().zip(&self.units);
        let up =
            |(unit, own): (&Unit, &EliminatedUnit)| upward(unit, own, crossing, (element, &E), of_tests.as_deref());
        let tangents: Vec<UnitTangent> = units().map(up).collect();
        let (dC, mut sums) = self.of_levels(crossing, &tangents);
        let lowest = crossing.tree.iter().position(|&block| block == element.level);
        let down = |((unit, own), (weights, tangent)): ((&Unit, &EliminatedUnit), (&UnitWeights, &UnitTangent))| {
            self.downward((unit, own), (weights, tangent), (lowest, of_tests.as_deref()), (crossing, &dC))
        };
        let by_unit: Vec<Vec<Rows>> = units().zip(self.weights.par_iter().zip(&tangents)).map(down).collect();
        for unit in by_unit {
            sums = sums.into_iter().zip(&unit).map(|(sum, own)| sum.plus(own)).collect();
        }
        sums
    }

    /// Σ dN = -Σ NEN over the levels of each factor, by block of Σ, along an element of the Σ of one factor.
    fn along_factor(&self, crossing: &Crossing, factor: usize, E: &Rows) -> Vec<Rows> {
        let p = self.p;
        let weights = self.dense.weights();
        let mut sums = self.no_sums(crossing);
        let levels = || self.part.levels.iter().enumerate();
        let own: Vec<usize> = levels().filter(|(_, level)| level.0 == factor).map(|(number, _)| number).collect();
        for (number, (factor, _)) in levels() {
            let sum = &mut sums[crossing.factors[*factor]];
            for &level in &own {
                let N = Rows::from_fn(p, p, |i, k| weights[(number * p + i, level * p + k)]);
                *sum = sum.clone().less(&N.times(E).times_transpose(&N));
            }
        }
        sums
    }

    /// A zero for each block of Σ.
    fn no_sums(&self, crossing: &Crossing) -> Vec<Rows> {
        vec![Rows::zeros(self.p, self.p); 1 + crossing.tree.len() + crossing.factors.len()]
    }

    /// dC and Σ dN over the levels of each factor, by block of Σ, from the derivatives of all units.
    fn of_levels(&self, crossing: &Crossing, tangents: &[UnitTangent]) -> (DMatrix<f64>, Vec<Rows>) {
        let (p, size) = (self.p, self.dense.K.nrows());
        let mut sums = self.no_sums(crossing);
        if size == 0 {
            return (DMatrix::zeros(0, 0), sums);
        }
        let mut dK = DMatrix::zeros(size, size);
        self.part.units.iter().zip(tangents).for_each(|(unit, tangent)| scatter(&tangent.K, unit, p, &mut dK));
        let rest = self.dense.rest();
        let left = rest * &dK;
        for (number, (factor, _)) in self.part.levels.iter().enumerate() {
            let rows = left.rows(number * p, p) * rest.rows(number * p, p).transpose();
            let sum = &mut sums[crossing.factors[*factor]];
            *sum = sum.clone().plus(&Rows::from_fn(p, p, |i, k| rows[(i, k)]));
        }
        (-(&self.dense.C * dK * &self.dense.C), sums)
    }

    /// Σ dN over the tests of a unit, where dW of each design is given, and over its groups of the kind `lowest` and those
    /// around them, by block of Σ.
    fn downward(
        &self,
        (unit, own): (&Unit, &EliminatedUnit),
        (weights, tangent): (&UnitWeights, &UnitTangent),
        (lowest, of_tests): (Option<usize>, Option<&[Rows]>),
        (crossing, dC): (&Crossing, &DMatrix<f64>),
    ) -> Vec<Rows> {
        let p = self.p;
        let dC = gathered(dC, unit, p);
        let mut sums = self.no_sums(crossing);
        let last = unit.groups.len() - 1;
        let mut means: Vec<MeanTangent> = Vec::with_capacity(unit.groups.len());
        let followed = unit.groups.iter().enumerate().filter(|(_, group)| lowest.is_none_or(|kind| group.kind >= kind));
        for (number, group) in followed.rev() {
            let eliminated = &own.groups[number];
            let change = tangent.groups[number].as_ref();
            let above = (group.parent != number).then(|| (&weights.groups[group.parent], &means[last - group.parent]));
            let mean = MeanTangent::of((eliminated, change), &weights.groups[number], above, (&weights.C, &dC));
            // N = W - WV̄W - up C up' + up Ȳ W + (up Ȳ W)', with V̄ and Ȳ of the group around
            let mut dN = change.map_or_else(|| Rows::zeros(p, p), |change| change.W.clone());
            let known = eliminated.up.times(&dC).times_transpose(&eliminated.up);
            dN = dN.less(&known);
            if let Some(change) = change {
                dN = dN.less(&with_transpose(&change.up.times(&weights.C).times_transpose(&eliminated.up)));
            }
            if let Some((above, above_tangent)) = above {
                let W = &eliminated.W;
                let mut both = eliminated.up.times(&above_tangent.y).times(W);
                dN = dN.less(&W.times(&above_tangent.V).times(W));
                if let Some(change) = change {
                    dN = dN.less(&with_transpose(&change.W.times(&above.V).times(W)));
                    both = both
                        .plus(&change.up.times(&above.y).times(W))
                        .plus(&eliminated.up.times(&above.y).times(&change.W));
                }
                dN = dN.plus(&with_transpose(&both));
            }
            if let Some(block) = crossing.block_of(group) {
                sums[block] = sums[block].clone().plus(&dN);
            }
            means.push(mean);
        }
        if let Some(of_tests) = of_tests {
            for (test, V) in unit.tests.iter().zip(&weights.tests) {
                let mean = &means[last - test.group];
                let (W, dW) = (&self.leaves[test.leaf].W, &of_tests[test.leaf]);
                let mut dV = mean.V.clone();
                add_members(&mut dV, &test.members, &dC, &mean.y);
                let both = with_transpose(&dW.times(V).times(W));
                let sum = &mut sums[0];
                *sum = std::mem::replace(sum, Rows::zeros(0, 0)).plus(dW).less(&both).less(&W.times(&dV).times(W));
            }
        }
        sums
    }
}

/// Derivatives of what is known of the mean of a group: of Γ, P, CΓ' and V.
struct MeanTangent {
    gamma: Rows,
    P: Rows,
    y: Rows,
    V: Rows,
}

impl MeanTangent {
    fn of(
        (own, change): (&EliminatedGroup, Option<&GroupTangent>),
        weights: &GroupWeights,
        above: Option<(&GroupWeights, &MeanTangent)>,
        (C, dC): (&Rows, &Rows),
    ) -> MeanTangent {
        let p = own.J.nrows();
        let (mut gamma, mut P) = match change {
            Some(change) => (change.HD.clone(), change.H.clone()),
            None => (Rows::zeros(p, weights.gamma.ncols()), Rows::zeros(p, p)),
        };
        if let Some((above, tangent)) = above {
            gamma = gamma.plus(&own.T.times(&tangent.gamma));
            P = P.plus(&own.T.times(&tangent.P).times_transpose(&own.T));
            if let Some(change) = change {
                gamma = gamma.plus(&change.T.times(&above.gamma));
                P = P.plus(&with_transpose(&change.T.times(&above.P).times_transpose(&own.T)));
            }
        }
        let y = dC.times_transpose(&weights.gamma).plus(&C.times_transpose(&gamma));
        let V = P.clone().plus(&gamma.times(&weights.y)).plus(&weights.gamma.times(&y));
        MeanTangent { gamma, P, y, V }
    }
}

/// The derivatives of a unit's matrices, from the tests to the unit; `of_tests`: dW of each design.
fn upward(
    unit: &Unit,
    own: &EliminatedUnit,
    crossing: &Crossing,
    (element, E): (SigmaElement, &Rows),
    of_tests: Option<&[Rows]>,
) -> UnitTangent {
    let p = E.nrows();
    let width = p * unit.met.len();
    let none = || MembersTangent { J: Rows::zeros(p, p), D: Rows::zeros(p, width) };
    let mut K = Rows::zeros(width, width);
    let mut gathered: Vec<Option<MembersTangent>> = unit.groups.iter().map(|_| None).collect();
    if let Some(of_tests) = of_tests {
        for test in &unit.tests {
            let dW = &of_tests[test.leaf];
            let members = gathered[test.group].get_or_insert_with(none);
            add(&mut members.J, 1.0, dW);
            for member in &test.members {
                member.add_columns(&mut members.D, dW);
                test.members.iter().for_each(|other| member.add_block(&mut K, dW, other));
            }
        }
    }
    let mut groups = Vec::with_capacity(unit.groups.len());
    for (number, group) in unit.groups.iter().enumerate() {
        let is_own = crossing.block_of(group) == Some(element.level);
        let members = gathered[number].take();
        if members.is_none() && !is_own {
            groups.push(None);
            continue;
        }
        let eliminated = &own.groups[number];
        let tangent = GroupTangent::of(eliminated, members.as_ref(), is_own.then_some(E), &mut K);
        if group.parent != number {
            let above = gathered[group.parent].get_or_insert_with(none);
            add(&mut above.J, 1.0, &tangent.W);
            above.D = std::mem::replace(&mut above.D, Rows::zeros(0, 0)).plus(&tangent.up);
        }
        groups.push(Some(tangent));
    }
    UnitTangent { groups, K }
}

impl GroupTangent {
    fn of(own: &EliminatedGroup, members: Option<&MembersTangent>, E: Option<&Rows>, K: &mut Rows) -> GroupTangent {
        let (p, width) = (own.J.nrows(), own.HD.ncols());
        let zero = || Rows::zeros(p, p);
        let mut tangent =
            GroupTangent { H: zero(), T: zero(), W: zero(), HD: Rows::zeros(p, width), up: Rows::zeros(p, width) };
        let mut dK = Rows::zeros(width, width);
        if let Some(MembersTangent { J: dJ, D: dD }) = members {
            let HdJ = own.H.times(dJ);
            let left = dD.clone().less(&dJ.times(&own.HD));
            tangent.H = minus(&HdJ.times(&own.H));
            tangent.T = minus(&HdJ.times(&own.T));
            tangent.W = own.T.transpose_times(&dJ.times(&own.T));
            tangent.HD = own.H.times(&left);
            tangent.up = own.T.transpose_times(&left);
            if width > 0 {
                dK = dK
                    .less(&with_transpose(&dD.transpose_times(&own.HD)))
                    .plus(&own.HD.transpose_times(&dJ.times(&own.HD)));
            }
        }
        if let Some(E) = E {
            let TE = own.T.times(E);
            let WE = own.W.times(E);
            tangent.H = tangent.H.plus(&TE.times_transpose(&own.T));
            tangent.T = tangent.T.less(&TE.times(&own.W));
            tangent.W = tangent.W.less(&WE.times(&own.W));
            tangent.HD = tangent.HD.plus(&TE.times(&own.up));
            tangent.up = tangent.up.less(&WE.times(&own.up));
            if width > 0 {
                dK = dK.less(&own.up.transpose_times(&E.times(&own.up)));
            }
        }
        *K = std::mem::replace(K, Rows::zeros(0, 0)).plus(&dK);
        tangent
    }
}

fn minus(a: &Rows) -> Rows {
    Rows::from_fn(a.nrows(), a.ncols(), |i, k| -a[(i, k)])
}
