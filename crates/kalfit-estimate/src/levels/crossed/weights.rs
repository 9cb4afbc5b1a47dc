//! Posterior covariance of the mean of each group and test given all measurements, and N = Z'PZ of each. Both depend on
//! designs and Σ alone.
#![expect(non_snake_case, reason = "W, V, P, N, E are the letters of the theory")]

use crate::levels::crossed::dense::{Dense, gathered};
use crate::levels::crossed::eliminated::EliminatedUnit;
use crate::levels::crossed::layout::{CrossedTest, Unit};
use kalfit_algebra::rows::Rows;

/// Matrices of one unit.
pub(super) struct UnitWeights {
    pub(super) groups: Vec<GroupWeights>,
    /// V of the mean of each test, p × p.
    pub(super) tests: Vec<Rows>,
    /// C over the levels that the unit meets.
    pub(super) C: Rows,
}

/// Matrices of one group; A is the sum of the effects of the group and of the groups around it.
pub(super) struct GroupWeights {
    /// Γ, with E[A | b, z] = α - Γb: p × states of the levels.
    pub(super) gamma: Rows,
    /// Var[A | b, z], p × p.
    pub(super) P: Rows,
    /// CΓ', states of the levels × p.
    pub(super) y: Rows,
    /// Var[A | z] = P + ΓCΓ'.
    pub(super) V: Rows,
    /// N of the effect of the group, p × p.
    pub(super) N: Rows,
}

impl UnitWeights {
    /// The matrices of a unit, given those of all levels of the part.
    pub(super) fn new(unit: &Unit, own: &EliminatedUnit, dense: &Dense) -> UnitWeights {
        let p = own.groups[0].J.nrows();
        let C = gathered(&dense.C, unit, p);
        let last = unit.groups.len() - 1;
        let mut groups: Vec<GroupWeights> = Vec::with_capacity(unit.groups.len());
        for (number, group) in unit.groups.iter().enumerate().rev() {
            let above = (group.parent != number).then(|| &groups[last - group.parent]);
            let eliminated = &own.groups[number];
            let (mut gamma, mut P) = (eliminated.HD.clone(), eliminated.H.clone());
            if let Some(above) = above {
                gamma = gamma.plus(&eliminated.T.times(&above.gamma));
                P = P.plus(&eliminated.T.times(&above.P).times_transpose(&eliminated.T));
            }
            let y = C.times_transpose(&gamma);
            let V = P.clone().plus(&gamma.times(&y));
            let known = eliminated.up.times(&C).times_transpose(&eliminated.up);
            let mut N = eliminated.W.clone().less(&known);
            if let Some(above) = above {
                let both = eliminated.up.times(&above.y).times(&eliminated.W);
                N = N.less(&eliminated.W.times(&above.V).times(&eliminated.W)).plus(&with_transpose(&both));
            }
            groups.push(GroupWeights { gamma, P, y, V, N });
        }
        groups.reverse();
        let rest = Rest { unit, dense, p, of_groups: groups.iter().map(|group| group.rest(unit, dense)).collect() };
        let of_test = |test: &CrossedTest| rest.covariance(test, &groups[test.group].P);
        let tests = unit.tests.iter().map(of_test).collect();
        UnitWeights { groups, tests, C }
    }
}

impl GroupWeights {
    /// A root of ΓCΓ': Γ times the root of C, p × columns of the root.
    fn rest(&self, unit: &Unit, dense: &Dense) -> Rows {
        let p = self.gamma.nrows();
        let mut rest = Rows::zeros(p, dense.half.nrows());
        for (level, &place) in unit.met.iter().enumerate() {
            for k in 0..p {
                let column = dense.half.column(place * p + k);
                for i in 0..p {
                    let x = self.gamma[(i, level * p + k)];
                    if x != 0.0 {
                        rest.row_mut(i).iter_mut().zip(column.iter()).for_each(|(sum, half)| *sum += x * half);
                    }
                }
            }
        }
        rest
    }
}

/// What the levels leave unknown of the mean of a test: (E-Γ)C(E-Γ)' as the square of a root, for where measurements are
/// precise it is a small difference of E and Γ.
struct Rest<'a> {
    unit: &'a Unit,
    dense: &'a Dense,
    p: usize,
    /// Γ times the root of C, of each group.
    of_groups: Vec<Rows>,
}

impl Rest<'_> {
    /// V = P + (E-Γ)C(E-Γ)' of a test.
    fn covariance(&self, test: &CrossedTest, of_group: &Rows) -> Rows {
        let mut root = self.of_groups[test.group].clone();
        for member in &test.members {
            for &(state, effect) in member.selection.pairs() {
                let column = self.dense.half.column(self.unit.met[member.level] * self.p + effect);
                root.row_mut(state).iter_mut().zip(column.iter()).for_each(|(rest, half)| *rest -= half);
            }
        }
        of_group.clone().plus(&root.times_transpose(&root))
    }
}

/// W - WVW.
pub(super) fn weight(W: &Rows, V: &Rows) -> Rows {
    W.clone().less(&W.times(V).times(W))
}

/// A + A'.
pub(super) fn with_transpose(a: &Rows) -> Rows {
    a.transposed().plus(a)
}
