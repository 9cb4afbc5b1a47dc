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
    /// Information of the unit on the effects of the levels that it meets, Σ E'WE - Σ D'HD, by the levels' states.
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
    /// D.
    D: Rows,
    /// U, upper triangular, with U'U = I + F'JF.
    upper: Rows,
    /// U⁻ᵀF'.
    half: Rows,
}

impl EliminatedUnit {
    /// Integrates out the tests, whose designs are `leaves`, and the groups of a unit. What a test says of the levels, E,
    /// goes through the same rotations as its R; the rows that remain give K without a difference of large numbers.
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
            let mut of_levels = Rows::zeros(p, width);
            test.members.iter().for_each(|member| member.add_columns(&mut of_levels, &leaf.half));
            gathered[test.group].take(&leaf.half, &of_levels, &mut K);
        }
        let none = Rows::zeros(p, p);
        let mut groups = Vec::with_capacity(unit.groups.len());
        for (number, group) in unit.groups.iter().enumerate() {
            let own = std::mem::replace(&mut gathered[number], Members::none(0, 0));
            let root = crossing.block_of(group).map_or(&none, |block| &at.roots[block]);
            let integrated = Integrated::of(&own.factor(p), root);
            log_det += integrated.log_det;
            let of_levels = Rows::solved_transposed(&integrated.upper, own.upper.last_columns(width));
            if group.parent == number {
                add_squares(&mut K, &of_levels);
            } else {
                gathered[group.parent].take(&integrated.half, &of_levels, &mut K);
            }
            groups.push(own.eliminated(root, (&integrated, &of_levels)));
        }
        EliminatedUnit { groups, K, log_det }
    }

    /// Adds K to that of the whole part.
    pub(super) fn add_to(&self, unit: &Unit, p: usize, all: &mut DMatrix<f64>) {
        scatter(&self.K, unit, p, all);
    }
}

/// Root of the information of the members of a group on the group's mean and on the effects of the levels: [R | X], R
/// upper triangular.
struct Members {
    upper: Rows,
}

impl Members {
    fn none(p: usize, width: usize) -> Members {
        Members { upper: Rows::zeros(p, p + width) }
    }

    /// R.
    fn factor(&self, p: usize) -> Rows {
        self.upper.first_columns(p)
    }

    /// Folds in the rows [B | X] of a member; what they say of the levels alone is added to K.
    fn take(&mut self, half: &Rows, of_levels: &Rows, K: &mut Rows) {
        let p = self.upper.nrows();
        let rest = Rotations::absorb(&mut self.upper, half.joined_columns(of_levels), p);
        if of_levels.ncols() > 0 {
            add_squares(K, &rest.last_columns(of_levels.ncols()));
        }
    }

    /// The matrices of the group with Σ = FF', given F', and R and X with the effect of the group integrated out.
    fn eliminated(&self, root: &Rows, (integrated, of_levels): (&Integrated<f64>, &Rows)) -> EliminatedGroup {
        let (p, width) = (self.upper.nrows(), of_levels.ncols());
        let factor = self.factor(p);
        let upper = Rotations::identity_plus(&factor.times_transpose(root));
        let half = Rows::solved_transposed(&upper, root.clone());
        let H = half.transpose_times(&half);
        let J = factor.transpose_times(&factor);
        let T = Rows::identity(p).less(&H.times(&J));
        // HR'X as F(I+F'R'RF)⁻¹F'R'X
        let D = factor.transpose_times(&self.upper.last_columns(width));
        let HD = half.transpose_times(&half.times(&D));
        let up = integrated.half.transpose_times(of_levels);
        EliminatedGroup { J, H, T, W: integrated.W.clone(), HD, up, D, upper, half }
    }
}

impl EliminatedGroup {
    /// The root û of the posterior mean Fû of the group's effect, given y, the mean of the group around it if there is
    /// one, and the effects of the levels.
    pub(super) fn root(&self, y: &Rows, above: Option<&Rows>, effects: &Rows) -> Rows {
        let mut left = y.clone().less(&self.D.times(effects));
        if let Some(above) = above {
            left = left.less(&self.J.times(above));
        }
        let mut root = self.half.times(&left);
        for c in 0..root.ncols() {
            for i in (0..root.nrows()).rev() {
                let dot: f64 = (i + 1..root.nrows()).map(|k| self.upper[(i, k)] * root[(k, c)]).sum();
                root[(i, c)] = (root[(i, c)] - dot) / self.upper[(i, i)];
            }
        }
        root
    }
}

/// K ← K + X'X.
fn add_squares(K: &mut Rows, x: &Rows) {
    for i in 0..x.nrows() {
        let row = x.row(i);
        for (a, &left) in row.iter().enumerate().filter(|(_, x)| **x != 0.0) {
            K.row_mut(a).iter_mut().zip(row).for_each(|(sum, right)| *sum += left * right);
        }
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
