//! The levels that a test meets, and E of each: by which of its effects a level acts on which states of the test.

use std::sync::Arc;

use nalgebra::DMatrix;

use kalfit_algebra::rows::Rows;
use kalfit_model::Selection;

/// A level that a test meets.
#[derive(Debug, Clone)]
pub(super) struct Member {
    /// Index in [`Unit::met`](super::layout::Unit::met).
    pub(super) level: usize,
    /// The ones of E, p × p.
    pub(super) selection: Arc<Selection>,
}

impl Member {
    /// Pairs of a state and of the row of the effect on it, in a matrix with a row for each effect of each level that the
    /// unit meets; p effects a level.
    fn rows(&self, p: usize) -> impl Iterator<Item = (usize, usize)> + '_ {
        let first = self.level * p;
        self.selection.pairs().iter().map(move |&(state, effect)| (state, first + effect))
    }

    /// Adds AE to the columns of the effects of the levels, for an A with a column for each state.
    pub(super) fn add_columns(&self, to: &mut Rows, a: &Rows) {
        for i in 0..a.nrows() {
            self.rows(a.ncols()).for_each(|(state, effect)| to[(i, effect)] += a[(i, state)]);
        }
    }

    /// Adds E'AE of two members to the block of their levels, for an A of states × states.
    pub(super) fn add_block(&self, to: &mut Rows, a: &Rows, other: &Member) {
        let p = a.nrows();
        for (state, effect) in self.rows(p) {
            other.rows(p).for_each(|(column, beside)| to[(effect, beside)] += a[(state, column)]);
        }
    }

    /// Adds E'A to the rows of the effects of the level with this index among those of the part.
    pub(super) fn add_rows(&self, to: &mut DMatrix<f64>, level: usize, a: &Rows) {
        let first = level * a.nrows();
        for &(state, effect) in self.selection.pairs() {
            a.row(state).iter().enumerate().for_each(|(c, x)| to[(first + effect, c)] += x);
        }
    }

    /// Adds E times the effects of the levels, by states.
    pub(super) fn add_effects(&self, to: &mut Rows, effects: &Rows) {
        for (state, effect) in self.rows(to.nrows()) {
            to.row_mut(state).iter_mut().zip(effects.row(effect)).for_each(|(sum, x)| *sum += x);
        }
    }

    /// Adds the effects of one number for each, by states.
    pub(super) fn add_sums(&self, to: &mut [(f64, f64)], of_states: &[(f64, f64)]) {
        for &(state, effect) in self.selection.pairs() {
            to[effect] = (to[effect].0 + of_states[state].0, to[effect].1 + of_states[state].1);
        }
    }

    /// The states that an effect of the level acts on.
    pub(super) fn states_of(&self, effect: usize) -> impl Iterator<Item = usize> + '_ {
        self.selection.pairs().iter().filter(move |pair| pair.1 == effect).map(|pair| pair.0)
    }
}

/// Adds ECE' - Ey - (Ey)' to a p × p matrix, over all members of a test, with C and y by the effects of the levels that
/// the unit meets; y has a column for each state.
pub(super) fn add_members(sum: &mut Rows, members: &[Member], covariance: &Rows, y: &Rows) {
    let p = sum.nrows();
    for member in members {
        for (state, effect) in member.rows(p) {
            let (own, of_mean) = (covariance.row(effect), y.row(effect));
            for (column, beside) in members.iter().flat_map(|other| other.rows(p)) {
                sum[(state, column)] += own[beside];
            }
            for k in 0..p {
                sum[(state, k)] -= of_mean[k];
                sum[(k, state)] -= of_mean[k];
            }
        }
    }
}
