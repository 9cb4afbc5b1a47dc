//! The tests and groups of a unit integrated out at Σ, from the tests to the unit: what depends on designs alone.
#![expect(non_snake_case, reason = "W, J, D, H, T, K are the letters of the theory")]

use crate::levels::crossed::layout::{Crossing, Unit};
use crate::levels::walk::{Integrated, LevelLaws};
use kalfit_algebra::factors::{Factors, Rotations};
use kalfit_algebra::rows::Rows;
use nalgebra::DMatrix;

/// Matrices of the groups of a unit, with the levels that the unit meets as columns.
pub(super) struct EliminatedUnit {
    pub(super) groups: Vec<EliminatedGroup>,
    /// What the unit says of the levels that it meets: Σ E'WE - Σ D'HD, by the levels' states.
    pub(super) K: Rows,
    /// Sum of log|I + F'JF| over tests and groups.
    pub(super) log_det: f64,
}

/// Matrices of a group.
pub(super) struct EliminatedGroup {
    /// J = ΣW of the members.
    pub(super) J: Rows,
    /// H = F(I+F'JF)⁻¹F'.
    pub(super) H: Rows,
    /// T = I - HJ.
    pub(super) T: Rows,
    /// W = (I+JΣ)⁻¹J, the information on the mean of the enclosing group.
    pub(super) W: Rows,
    /// HD, with D = ΣWE of the members: p × states of the levels.
    pub(super) HD: Rows,
    /// T'D.
    pub(super) up: Rows,
}

impl EliminatedUnit {
    /// Integrates out the tests, whose designs are `leaves`, and the groups of a unit.
    pub(super) fn new(
        unit: &Unit,
        crossing: &Crossing,
        (at, leaves): (&LevelLaws<'_>, &[Integrated<f64>]),
    ) -> EliminatedUnit {
        let p = at.mean.len();
        let width = p * unit.met.len();
        let mut K = Rows::zeros(width, width);
        let mut log_det = 0.0;
        let mut gathered: Vec<Members> = unit.groups.iter().map(|_| Members::none(p, width)).collect();
        for test in &unit.tests {
            let leaf = &leaves[test.leaf];
            log_det += leaf.log_det;
            let members = &mut gathered[test.group];
            members.take(&leaf.half);
            for &member in &test.members {
                add_columns(&mut members.D, &leaf.W, member);
                for &other in &test.members {
                    add_block(&mut K, &leaf.W, (member, other));
                }
            }
        }
        let mut groups = Vec::with_capacity(unit.groups.len());
        for (number, group) in unit.groups.iter().enumerate() {
            let own = std::mem::replace(&mut gathered[number], Members::none(0, 0));
            let root = &at.roots[crossing.tree[group.kind]];
            let (eliminated, half, own_log_det) = own.eliminated(root);
            log_det += own_log_det;
            if width > 0 {
                K = K.less(&own.D.transpose_times(&eliminated.HD));
            }
            if group.parent != number {
                let above = &mut gathered[group.parent];
                above.take(&half);
                above.D = std::mem::replace(&mut above.D, Rows::zeros(0, 0)).plus(&eliminated.up);
            }
            groups.push(eliminated);
        }
        EliminatedUnit { groups, K, log_det }
    }

    /// Adds K to that of the whole part.
    pub(super) fn add_to(&self, unit: &Unit, p: usize, all: &mut DMatrix<f64>) {
        scatter(&self.K, unit, p, all);
    }
}

/// What the members of a group say of the group's mean and of the levels.
struct Members {
    /// R, upper triangular, R'R = J.
    root: Rows,
    D: Rows,
}

impl Members {
    fn none(p: usize, width: usize) -> Members {
        Members { root: Rows::zeros(p, p), D: Rows::zeros(p, width) }
    }

    /// Folds in the information B'B of a member.
    fn take(&mut self, half: &Rows) {
        let p = self.root.nrows();
        Rotations::absorb(&mut self.root, half.clone(), p);
    }

    /// The matrices of the group with Σ = FF', given F'; a root B of W = B'B; log|I + F'JF|.
    fn eliminated(&self, root: &Rows) -> (EliminatedGroup, Rows, f64) {
        let p = self.root.nrows();
        let integrated = Integrated::of(&self.root, root);
        let upper = Rotations::identity_plus(&self.root.times_transpose(root));
        let half = Rows::solved_transposed(&upper, root.clone());
        let H = half.transpose_times(&half);
        let J = self.root.transpose_times(&self.root);
        let T = Rows::identity(p).less(&H.times(&J));
        let up = T.transpose_times(&self.D);
        let HD = H.times(&self.D);
        (EliminatedGroup { J, H, T, W: integrated.W, HD, up }, integrated.half, integrated.log_det)
    }
}

/// Adds a p × p matrix to the columns of one level.
pub(super) fn add_columns(to: &mut Rows, of: &Rows, level: usize) {
    let p = of.ncols();
    for i in 0..of.nrows() {
        let row = &mut to.row_mut(i)[level * p..(level + 1) * p];
        row.iter_mut().zip(of.row(i)).for_each(|(sum, x)| *sum += x);
    }
}

/// Adds a p × p matrix to the rows of one level and the columns of another.
pub(super) fn add_block(to: &mut Rows, of: &Rows, (level, other): (usize, usize)) {
    let p = of.ncols();
    for i in 0..p {
        let row = &mut to.row_mut(level * p + i)[other * p..(other + 1) * p];
        row.iter_mut().zip(of.row(i)).for_each(|(sum, x)| *sum += x);
    }
}

/// Adds a matrix over the levels of a unit to one over the levels of its part.
pub(super) fn scatter(own: &Rows, unit: &Unit, p: usize, all: &mut DMatrix<f64>) {
    for (b, &column) in unit.met.iter().enumerate() {
        for (a, &row) in unit.met.iter().enumerate() {
            for k in 0..p {
                for i in 0..p {
                    all[(row * p + i, column * p + k)] += own[(a * p + i, b * p + k)];
                }
            }
        }
    }
}
