//! Distance of each test from the other tests of its groups.
//!
//! With A = H'V_w⁻¹H the information of a test and g = H'V_w⁻¹r its score, V_w the law within tests, a group passes on
//! what its tests say of the group's own mean (its effect u ~ N(0, Σ) eliminated), and the posterior of the sum t of all
//! effects comes down again:
//!
//! ```text
//! K = F(I + F'AF)⁻¹F',  Σ = FF'        up:   A ← A - AKA,  g ← g - AKg
//!                                      down: t = (I - KA) t_above + Kg,  P = K + (I - KA) P_above (I - KA)'
//! s = g - At,  I = A - APA             the score of a shift of one test, and its variance
//! ```
//!
//! Each state i is tested by itself, z² = s_i²/I_ii with the other states taken out. An outlying test widens the Σ that it
//! is judged by: with ν degrees of freedom between tests of one group, z² cannot exceed ν however far the test lies. So z²
//! is compared as an externally studentised residual: z²(ν - 1)/(ν - z²) ~ F(1, ν - 1).

use std::ops::Range;

use kalfit_algebra::symmetric::{range, scaled_inverse, sizes};
use kalfit_model::{Grouping, TestId};
use nalgebra::{DMatrix, DVector};
use statrs::distribution::{ChiSquared, ContinuousCDF};
use statrs::function::beta::beta_reg;

use crate::misfit::columns::UnitColumns;
use crate::misfit::levels::spans;

/// A direction in which a test is informative counts when this part of its information is left beside the other tests.
const INFORMATIVE: f64 = 1e-9;

/// Distance of a test from the other tests of its groups.
#[derive(Debug, Clone, PartialEq)]
pub struct UnlikeTest {
    /// Id of the test.
    pub test: TestId,
    /// Index of the state that deviates most.
    pub state: usize,
    /// z of this state.
    pub deviation: f64,
    /// Probability of a deviation as large as this in any of the states, at most 1.
    pub p_value: f64,
}

/// Information and score of some tests about their mean.
#[derive(Debug, Clone)]
struct Message {
    information: DMatrix<f64>,
    score: DVector<f64>,
}

/// Distances of the tests of a unit; none for a unit of one test. The columns of the unit are those within tests.
pub(super) fn distances(
    unit: &UnitColumns,
    grouping: &Grouping,
    roots: &[DMatrix<f64>],
    states: Range<usize>,
) -> Vec<UnlikeTest> {
    let free = grouping.tests().saturating_sub(grouping.groups(0).len());
    if unit.tests.len() < 2 {
        return Vec::new();
    }
    let tests: Vec<Message> = unit.tests.iter().map(|(_, rows)| Message::of(unit, rows.clone(), &states)).collect();
    let p = states.len();
    let mut above = vec![(DVector::zeros(p), DMatrix::zeros(p, p))];
    for level in (0..roots.len()).rev() {
        above = down(unit, grouping, (level, roots), &tests, &above);
    }
    let each = unit.tests.iter().zip(&tests).zip(expanded(unit, grouping, &above));
    each.filter_map(|(((id, _), test), (mean, variance))| test.deviation(id, mean, variance, free)).collect()
}

/// Posteriors of the sums of effects down to each group of a level, from those of the groups of the level above.
fn down(
    unit: &UnitColumns,
    grouping: &Grouping,
    (level, roots): (usize, &[DMatrix<f64>]),
    tests: &[Message],
    above: &[(DVector<f64>, DMatrix<f64>)],
) -> Vec<(DVector<f64>, DMatrix<f64>)> {
    let outer: Vec<Range<usize>> = if level + 1 < roots.len() {
        spans(unit, grouping, level + 1)
    } else {
        std::iter::once(0..unit.tests.len()).collect()
    };
    let of = |tests_of_group: &Range<usize>| {
        let parent = outer.iter().position(|group| group.contains(&tests_of_group.start)).unwrap_or(0);
        let message = upward(unit, grouping, (level, roots), tests, tests_of_group);
        message.posterior(&roots[level], &above[parent])
    };
    spans(unit, grouping, level).iter().map(of).collect()
}

/// What the tests of a group say of the mean of the group: effects of inner groups are eliminated.
fn upward(
    unit: &UnitColumns,
    grouping: &Grouping,
    (level, roots): (usize, &[DMatrix<f64>]),
    tests: &[Message],
    group: &Range<usize>,
) -> Message {
    let parts: Vec<Message> = match level {
        0 => tests[group.clone()].to_vec(),
        _ => {
            let inner = spans(unit, grouping, level - 1).into_iter().filter(|inner| group.contains(&inner.start));
            let of = |inner: Range<usize>| upward(unit, grouping, (level - 1, roots), tests, &inner);
            inner.map(|inner| of(inner).without(&roots[level - 1])).collect()
        }
    };
    let p = roots[level].nrows();
    let none = Message { information: DMatrix::zeros(p, p), score: DVector::zeros(p) };
    parts.into_iter().fold(none, |all, part| Message {
        information: all.information + part.information,
        score: all.score + part.score,
    })
}

/// The posterior for each test, from those of the innermost groups.
fn expanded<'a>(
    unit: &UnitColumns,
    grouping: &Grouping,
    groups: &'a [(DVector<f64>, DMatrix<f64>)],
) -> Vec<(&'a DVector<f64>, &'a DMatrix<f64>)> {
    let spans = spans(unit, grouping, 0);
    let each = spans.iter().zip(groups);
    each.flat_map(|(tests, (mean, variance))| tests.clone().map(move |_| (mean, variance))).collect()
}

impl Message {
    fn of(unit: &UnitColumns, rows: Range<usize>, states: &Range<usize>) -> Message {
        let block = unit.values.rows_range(rows);
        let of_states = block.columns_range(states.clone());
        Message { information: of_states.transpose() * of_states, score: of_states.transpose() * block.column(0) }
    }

    /// K of the effect with this root.
    fn gain(&self, root: &DMatrix<f64>) -> DMatrix<f64> {
        let p = root.ncols();
        let inner = DMatrix::identity(p, p) + root.transpose() * &self.information * root;
        match inner.cholesky() {
            Some(cholesky) => root * cholesky.solve(&root.transpose()),
            None => DMatrix::zeros(root.nrows(), root.nrows()),
        }
    }

    /// Without the effect of the group with this root.
    fn without(self, root: &DMatrix<f64>) -> Message {
        let change = &self.information * self.gain(root);
        Message {
            information: &self.information - &change * &self.information,
            score: &self.score - change * &self.score,
        }
    }

    fn posterior(
        &self,
        root: &DMatrix<f64>,
        (mean, variance): &(DVector<f64>, DMatrix<f64>),
    ) -> (DVector<f64>, DMatrix<f64>) {
        let gain = self.gain(root);
        let kept = DMatrix::identity(gain.nrows(), gain.nrows()) - &gain * &self.information;
        (&kept * mean + &gain * &self.score, &gain + &kept * variance * kept.transpose())
    }

    fn deviation(&self, id: &TestId, mean: &DVector<f64>, variance: &DMatrix<f64>, free: usize) -> Option<UnlikeTest> {
        let score = &self.score - &self.information * mean;
        let information = &self.information - &self.information * variance * &self.information;
        let size = sizes(&self.information);
        let shares = DMatrix::from_fn(size.len(), size.len(), |i, k| information[(i, k)] / size[i] / size[k]);
        let score = DVector::from_fn(size.len(), |i, _| score[i] / size[i]);
        let seen = range(&shares, |share| share > INFORMATIVE);
        let inverse = &seen * scaled_inverse(&(seen.transpose() * &shares * &seen)) * seen.transpose();
        let estimate = &inverse * score;
        let z = |i: usize| estimate[i] / inverse[(i, i)].sqrt();
        let states = (0..size.len()).filter(|&i| inverse[(i, i)] > 0.0 && z(i).is_finite());
        let (mut looked, mut largest) = (0_u32, None::<(usize, f64)>);
        for i in states {
            looked += 1;
            largest =
                Some((i, z(i))).filter(|(_, z)| largest.is_none_or(|(_, other)| z.abs() > other.abs())).or(largest);
        }
        let (state, deviation) = largest?;
        let p_value = (tail(deviation * deviation, free) * f64::from(looked)).min(1.0);
        Some(UnlikeTest { test: id.clone(), state, deviation, p_value })
    }
}

/// Probability of a square as large as z², with ν degrees of freedom of the variance that z is divided by.
fn tail(square: f64, free: usize) -> f64 {
    let free = free as f64;
    if square < free && free > 1.0 {
        let (f, rest) = (square * (free - 1.0) / (free - square), free - 1.0);
        return beta_reg(0.5 * rest, 0.5, rest / (rest + f));
    }
    // a variance that was not estimated from these tests
    ChiSquared::new(1.0).map_or(1.0, |law| law.sf(square))
}
