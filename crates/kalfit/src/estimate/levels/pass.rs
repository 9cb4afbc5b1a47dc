//! One pass over the units: ℓ and its derivatives, as sums over tests in one block for each level.

use std::ops::Range;

use nalgebra::DMatrix;
use rayon::prelude::*;

use crate::estimate::levels::totals::{Totals, Wish};
use crate::estimate::levels::units::Units;
use crate::estimate::levels::walk::At;
use crate::estimate::order::{FlatMean, Order, Wanted};
use crate::estimate::point::Point;
use crate::estimate::sums::{OfLevels, Sums};

/// Most units that are walked through at once.
const TOGETHER: usize = 64;
/// Tasks there are at most; fixed, so that sums have the same bits for any number of threads.
const TASKS: usize = 64;

/// ℓ and its derivatives at a point. The mean is the sum of those of all levels, so what is said of one is said of each.
pub(crate) fn pass(units: &Units, point: &Point, wanted: Wanted<'_>) -> Sums {
    let at = At::new(units, point, wanted.regressors);
    let (p, levels) = (units.states, units.levels());
    let flat = wanted.flat.map(|flat| (folded(flat, p, levels), flat.covariance));
    let wish = Wish { order: wanted.order, flat: flat.as_ref().map(|(jacobian, covariance)| (jacobian, *covariance)) };
    let coordinates = p + wanted.regressors.len();
    let pieces = pieces(units);
    let of_part = |pieces: &[(usize, Range<usize>)]| {
        let mut totals = Totals::zero(units, coordinates, wish);
        for (design, some) in pieces {
            totals.take(&at, (&units.designs[*design], some.clone()), wish);
        }
        totals
    };
    let parts: Vec<Totals> = pieces.par_chunks(pieces.len().div_ceil(TASKS).max(1)).map(of_part).collect();
    let totals = parts.iter().fold(Totals::zero(units, coordinates, wish), Totals::and);
    sums((units, units.constant), totals, wanted)
}

/// Calls `of` with the numbers of the reductions of each unit and its sums of first order, the constants of its tests apart.
pub(crate) fn each_unit(units: &Units, point: &Point, wanted: Wanted<'_>, of: &mut dyn FnMut(&[usize], &Sums)) {
    let at = At::new(units, point, wanted.regressors);
    let wish = Wish { order: Order::First, flat: None };
    for design in units.designs.iter() {
        for (number, unit) in design.units.iter().enumerate() {
            let mut totals = Totals::zero(units, units.states + wanted.regressors.len(), wish);
            totals.take(&at, (design, number..number + 1), wish);
            of(&unit.tests, &sums((units, 0.0), totals, wanted));
        }
    }
}

/// Some units of a design each.
fn pieces(units: &Units) -> Vec<(usize, Range<usize>)> {
    let of = |(number, count): (usize, usize)| {
        (0..count).step_by(TOGETHER).map(move |from| (number, from..(from + TOGETHER).min(count)))
    };
    units.designs.iter().map(|design| design.units.len()).enumerate().flat_map(of).collect()
}

/// d(μ, coefficients) / d(free mean coordinates): the mean is the sum over the levels.
fn folded(flat: &FlatMean<'_>, p: usize, levels: usize) -> DMatrix<f64> {
    let all = flat.jacobian;
    DMatrix::from_fn(all.nrows() - p * (levels - 1), all.ncols(), |row, c| match row.checked_sub(p) {
        None => (0..levels).map(|l| all[(l * p + row, c)]).sum(),
        Some(regressor) => all[(p * levels + regressor, c)],
    })
}

fn sums((units, constant): (&Units, f64), totals: Totals, wanted: Wanted<'_>) -> Sums {
    let (p, levels) = (units.states, units.levels());
    let mut sums = Wanted { order: wanted.order.min(Order::Mean), ..wanted }.zero();
    let all = sums.mean_score.len();
    // of each mean coordinate of all levels the one that it is
    let own = |m: usize| if m < p * levels { m % p } else { m - p * (levels - 1) };
    sums.value = constant + totals.value;
    sums.quadratic = totals.quadratic;
    sums.mean_score.iter_mut().enumerate().for_each(|(m, to)| *to = totals.score[own(m)]);
    sums.mean_information = DMatrix::from_fn(all, all, |m, n| totals.information[(own(m), own(n))]);
    for (level, (outer, weight)) in totals.outer.iter().zip(&totals.weight).enumerate() {
        let at = (level * p, level * p);
        sums.outer.view_mut(at, (p, p)).copy_from(outer);
        sums.weight.view_mut(at, (p, p)).copy_from(weight);
    }
    sums.spread = totals.spread;
    let cross = DMatrix::from_fn(if totals.cross.ncols() > 0 { all } else { 0 }, totals.cross.ncols(), |m, e| {
        totals.cross[(own(m), e)]
    });
    let symmetric = |a: DMatrix<f64>| (&a + a.transpose()) * 0.5;
    sums.of_levels =
        Some(OfLevels { observed: symmetric(totals.observed), cross, expected: symmetric(totals.expected) });
    sums
}
