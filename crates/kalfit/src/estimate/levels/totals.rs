//! What units say, added up.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

use crate::estimate::levels::tangents::{Along, Moved, Scratch};
use crate::estimate::levels::units::{Design, Units};
use crate::estimate::levels::walk::{At, Walked};
use crate::estimate::order::Order;
use crate::linalg::rows::Rows;
use crate::linalg::symmetric::{pair, pairs};

/// Sums over units. Mean coordinates are the p elements of μ, then the regression coefficients.
#[derive(Debug, Clone)]
pub(super) struct Totals {
    /// ℓ, constants apart.
    pub(super) value: f64,
    pub(super) quadratic: f64,
    /// Of the mean coordinates.
    pub(super) score: DVector<f64>,
    pub(super) information: DMatrix<f64>,
    /// Σ rr' and Σ W̄, by levels.
    pub(super) outer: Vec<DMatrix<f64>>,
    pub(super) weight: Vec<DMatrix<f64>>,
    /// Of the restricted likelihood: Σ ½(X'r X'r' + …) by pairs of free mean coordinates, elements.
    pub(super) spread: DMatrix<f64>,
    /// -∂²ℓ by two elements, and by a mean coordinate and an element.
    pub(super) observed: DMatrix<f64>,
    pub(super) cross: DMatrix<f64>,
    pub(super) expected: DMatrix<f64>,
}

/// What is to be added up.
#[derive(Clone, Copy)]
pub(super) struct Wish<'a> {
    pub(super) order: Order,
    /// Free mean coordinates of the restricted likelihood: the jacobian on (μ, coefficients), and their covariance where it is known.
    pub(super) flat: Option<(&'a DMatrix<f64>, Option<&'a DMatrix<f64>>)>,
}

impl Totals {
    pub(super) fn zero(units: &Units, coordinates: usize, wish: Wish<'_>) -> Totals {
        let (p, levels) = (units.states, units.levels());
        let s = levels * pairs(p);
        let second = if wish.order >= Order::Second { s } else { 0 };
        let q = wish.flat.map_or(0, |(jacobian, _)| pairs(jacobian.ncols()));
        Totals {
            value: 0.0,
            quadratic: 0.0,
            score: DVector::zeros(coordinates),
            information: DMatrix::zeros(coordinates, coordinates),
            outer: vec![DMatrix::zeros(p, p); levels],
            weight: vec![DMatrix::zeros(p, p); levels],
            spread: DMatrix::zeros(q, if q > 0 { s } else { 0 }),
            observed: DMatrix::zeros(second, second),
            cross: DMatrix::zeros(if second > 0 { coordinates } else { 0 }, second),
            expected: DMatrix::zeros(second, second),
        }
    }

    pub(super) fn and(mut self, other: &Totals) -> Totals {
        self.value += other.value;
        self.quadratic += other.quadratic;
        self.score += &other.score;
        self.information += &other.information;
        self.outer.iter_mut().zip(&other.outer).for_each(|(sum, more)| *sum += more);
        self.weight.iter_mut().zip(&other.weight).for_each(|(sum, more)| *sum += more);
        self.spread += &other.spread;
        self.observed += &other.observed;
        self.cross += &other.cross;
        self.expected += &other.expected;
        self
    }

    /// Adds what some units of a design say.
    pub(super) fn take(&mut self, at: &At<'_>, (design, units): (&Design, Range<usize>), wish: Wish<'_>) {
        let coordinates = !at.regressors.is_empty() || wish.flat.is_some();
        let walked = at.walked(design, units, coordinates);
        let count = walked.units as f64;
        self.value -= 0.5 * (count * walked.log_det + walked.quadratic);
        self.quadratic += walked.quadratic;
        let groups = design.groups.iter().map(|node| node.level).zip(&walked.down);
        let all = groups.chain(walked.tests.iter().map(|test| (0, test)));
        for (level, down) in all {
            add(&mut self.weight[level], count, &down.weight);
            add_products(&mut self.outer[level], (&down.r, &down.r), walked.before);
            if let Some((jacobian, _)) = wish.flat {
                self.spread(level, &of_free(&down.r, jacobian), count);
            }
        }
        self.mean(at, design, &walked);
        if wish.order >= Order::Second {
            self.second(at, (design, &walked), wish);
        }
    }

    fn mean(&mut self, at: &At<'_>, design: &Design, walked: &Walked) {
        let count = walked.units as f64;
        for (member, down) in design.tests.iter().zip(&walked.tests) {
            let covariates = &at.units.leaves[member.leaf].covariates;
            each_coordinate(at, covariates, |c, state, x| {
                let row = down.r.row(state);
                self.score[c] += x * row[walked.before..].iter().sum::<f64>();
                for (d, r) in row[..walked.before].iter().enumerate() {
                    self.information[(c, d)] += count * x * r;
                }
            });
        }
        if walked.before == 0 {
            let unit = walked.up.last().expect("a unit is a group");
            add(&mut self.information, count, &unit.W);
        }
    }

    /// Adds ½ (r_c r_d' + r_d r_c') for each pair of free mean coordinates.
    fn spread(&mut self, level: usize, free: &Rows, count: f64) {
        let (p, q) = (free.nrows(), free.ncols());
        let first = level * pairs(p);
        for c in 0..q {
            for d in 0..=c {
                for k in 0..p {
                    for l in 0..=k {
                        let both = free[(k, c)] * free[(l, d)] + free[(l, c)] * free[(k, d)];
                        self.spread[(pair(c, d), first + pair(k, l))] += 0.5 * count * both;
                    }
                }
            }
        }
    }

    fn second(&mut self, at: &At<'_>, (design, walked): (&Design, &Walked), wish: Wish<'_>) {
        let (p, levels) = (at.units.states, at.units.levels());
        let elements = (0..levels).flat_map(|level| (0..p).flat_map(move |i| (0..=i).map(move |j| (level, i, j))));
        let mut scratch = Scratch::new(p, walked.before + walked.units);
        let mut sum = DMatrix::zeros(p, p);
        for (e, (level, row, column)) in elements.enumerate() {
            let along = Along { level, row, column };
            along.through(at, (design, walked), &mut scratch, &mut |moved| {
                self.moved(at, (design, walked), (e, &mut sum), &moved, wish);
            });
        }
    }

    /// Adds how the scores of a test or group move along element e.
    fn moved(
        &mut self,
        at: &At<'_>,
        (design, walked): (&Design, &Walked),
        (e, along): (usize, &mut DMatrix<f64>),
        moved: &Moved<'_>,
        wish: Wish<'_>,
    ) {
        let (p, count) = (moved.r.nrows(), walked.units as f64);
        along.fill(0.0);
        add_products(along, (moved.r, &moved.of.r), walked.before);
        add_products(along, (&moved.of.r, moved.r), walked.before);
        if let Some((jacobian, Some(covariance))) = wish.flat {
            let [own, free] = [moved.r, &moved.of.r].map(|r| of_free(r, jacobian));
            let both = own.times(&Rows::from(covariance)).times_transpose(&free);
            *along += DMatrix::from_fn(p, p, |i, k| count * (both[(i, k)] + both[(k, i)]));
        }
        for i in 0..p {
            for k in 0..=i {
                let row = moved.level * pairs(p) + pair(i, k);
                let places = if i == k { -0.5 } else { -1.0 };
                let weight = count * moved.weight[(i, k)];
                self.observed[(row, e)] += places * (along[(i, k)] - weight);
                self.expected[(row, e)] += places * weight;
            }
        }
        if let Some(test) = moved.test {
            let covariates = &at.units.leaves[design.tests[test].leaf].covariates;
            each_coordinate(at, covariates, |c, state, x| {
                self.cross[(c, e)] -= x * moved.r.row(state)[walked.before..].iter().sum::<f64>();
            });
        }
    }
}

/// Calls `of` with each mean coordinate of a test, the state that it moves, and how much.
fn each_coordinate(at: &At<'_>, covariates: &[f64], mut of: impl FnMut(usize, usize, f64)) {
    let p = at.units.states;
    (0..p).for_each(|i| of(i, i, 1.0));
    at.regressors.iter().zip(covariates).enumerate().for_each(|(c, (&state, &x))| of(p + c, state, x));
}

/// What free mean coordinates do, from what the mean coordinates do, which stand first.
fn of_free(r: &Rows, jacobian: &DMatrix<f64>) -> Rows {
    r.first_columns(jacobian.nrows()).times(&Rows::from(jacobian))
}

/// Adds AB' of the columns after the first ones.
fn add_products(sum: &mut DMatrix<f64>, (a, b): (&Rows, &Rows), before: usize) {
    for i in 0..a.nrows() {
        for k in 0..b.nrows() {
            sum[(i, k)] += a.row(i)[before..].iter().zip(&b.row(k)[before..]).map(|(x, y)| x * y).sum::<f64>();
        }
    }
}

fn add(sum: &mut DMatrix<f64>, scale: f64, more: &Rows) {
    for i in 0..more.nrows() {
        more.row(i).iter().enumerate().for_each(|(k, x)| sum[(i, k)] += scale * x);
    }
}
