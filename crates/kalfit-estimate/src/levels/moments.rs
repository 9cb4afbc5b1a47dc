//! Start values for the variances of each level, by moments.

use nalgebra::DVector;

use crate::levels::design::{Leaf, UnitDesign};
use crate::levels::units::Units;

impl Units {
    /// Sums of (y - Jμ)_i² - J_ii and of J_ii² over the groups of each level, tests first, with J and y - Jμ summed
    /// over all tests in a group.
    pub(crate) fn excess(&self, mean: &DVector<f64>) -> (DVector<f64>, DVector<f64>) {
        let (levels, p) = (self.levels(), self.states);
        let centre: Vec<f64> = (0..p).map(|i| (0..levels).map(|l| mean[l * p + i]).sum()).collect();
        let (mut excess, mut squares) = (DVector::zeros(levels * p), DVector::zeros(levels * p));
        if let Some(crossing) = &self.crossing {
            crossing.moments(&self.leaves, (&centre, self.unit), &mut |level, i, y, information| {
                excess[level * p + i] += y * y - information;
                squares[level * p + i] += information * information;
            });
            return (excess, squares);
        }
        for design in self.designs.iter() {
            design.moments(&self.leaves, (&centre, self.unit), &mut |level, i, y, information| {
                excess[level * p + i] += y * y - information;
                squares[level * p + i] += information * information;
            });
        }
        (excess, squares)
    }

    /// A variance for each state at each level by moments, as if the states were uncorrelated: the
    /// [excess](Units::excess) of level k has the mean Σ_l v_l N_min(k,l), N_l = Σ J_ii² over the groups of level l. By
    /// levels, tests first; `None` where the groups have no information. The groups of a crossed factor are compared
    /// with the tests alone, as if no other groups were there.
    pub(crate) fn variances(&self, (excess, squares): (&DVector<f64>, &DVector<f64>)) -> Vec<Vec<Option<f64>>> {
        let (levels, p, nested) = (self.levels(), self.states, self.grouping.nested() + 1);
        let of_levels = |which: &[usize], i: usize| -> Vec<Option<f64>> {
            let of = |sums: &DVector<f64>| which.iter().map(|l| sums[l * p + i]).collect::<Vec<f64>>();
            variances_of_state(&of(excess), &of(squares))
        };
        let of_state = |i: usize| {
            let mut found = of_levels(&(0..nested).collect::<Vec<usize>>(), i);
            found.extend((nested..levels).map(|level| of_levels(&[0, level], i)[1]));
            found
        };
        let by_state: Vec<Vec<Option<f64>>> = (0..p).map(of_state).collect();
        (0..levels).map(|level| by_state.iter().map(|found| found[level]).collect()).collect()
    }
}

/// Variances of one state at all levels, from the outermost on, by differences of the equations of neighbouring levels.
fn variances_of_state(excess: &[f64], squares: &[f64]) -> Vec<Option<f64>> {
    // e_k = Σ_l v_l N_min(k,l), so e_k - e_(k-1) = (N_k - N_(k-1)) Σ_(l≥k) v_l
    let mut outer_variance = 0.0;
    let mut found: Vec<Option<f64>> = (0..excess.len())
        .rev()
        .map(|k| {
            let (e, n) = match k {
                0 => (excess[0], squares[0]),
                _ => (excess[k] - excess[k - 1], squares[k] - squares[k - 1]),
            };
            let total = (n > 0.0).then(|| (e / n).max(outer_variance))?;
            let own = total - outer_variance;
            outer_variance = total;
            Some(own)
        })
        .collect();
    found.reverse();
    found
}

impl UnitDesign {
    /// Calls `on_moments` with the level, the state i, (y - Jμ)_i and J_ii of each test, and of the sum over each group.
    fn moments(
        &self,
        leaves: &[Leaf],
        (mean, scale): (&[f64], f64),
        on_moments: &mut dyn FnMut(usize, usize, f64, f64),
    ) {
        let p = mean.len();
        for unit in 0..self.units.len() {
            let mut sums = vec![(vec![0.0; p], vec![0.0; p]); self.groups.len()];
            for (member, data) in self.tests.iter().zip(&self.data) {
                let own = leaves[member.leaf].moments(&|row| scale * data[(row, unit)], mean);
                let (y, information) = &mut sums[member.group];
                for (i, (own, square)) in own.into_iter().enumerate() {
                    on_moments(0, i, own, square);
                    y[i] += own;
                    information[i] += square;
                }
            }
            for (at, node) in self.groups.iter().enumerate() {
                let (y, information) = std::mem::take(&mut sums[at]);
                for i in 0..p {
                    on_moments(node.level, i, y[i], information[i]);
                    if node.parent != at {
                        sums[node.parent].0[i] += y[i];
                        sums[node.parent].1[i] += information[i];
                    }
                }
            }
        }
    }
}

impl Leaf {
    /// (y - Jμ)_i and J_ii of a test with this design, given d.
    pub(super) fn moments(&self, data: &dyn Fn(usize) -> f64, mean: &[f64]) -> Vec<(f64, f64)> {
        let (factor, p) = (&self.factor, mean.len());
        let residual = |row: usize| data(row) - (row..p).map(|k| factor[(row, k)] * mean[k]).sum::<f64>();
        let residual: Vec<f64> = (0..p).map(residual).collect();
        let one = |i: usize| {
            let own = (0..=i).map(|row| factor[(row, i)] * residual[row]).sum();
            (own, (0..=i).map(|row| factor[(row, i)].powi(2)).sum())
        };
        (0..p).map(one).collect()
    }
}
