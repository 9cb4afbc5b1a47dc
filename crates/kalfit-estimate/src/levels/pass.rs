//! One pass over the units: ℓ and its derivatives, as sums over tests in one block for each level.

use std::ops::Range;

use kalfit_lanes::{Isa, Kernel, Lanes};
use nalgebra::DMatrix;
use rayon::prelude::*;

use crate::levels::batch_data::BatchData;
use crate::levels::batches::UnitBatch;
use crate::levels::crossed;
use crate::levels::design::UnitDesign;
use crate::levels::totals::{SumSelection, UnitSums};
use crate::levels::units::Units;
use crate::levels::walk::LevelLaws;
use crate::order::Order;
use crate::order::{FlatMean, SumsWanted};
use crate::point::Point;
use crate::sums::{GroupDerivatives, Sums};
use kalfit_algebra::rows::Rows;

/// Most units of one design that are evaluated at once.
const MAX_COLUMNS: usize = 64;
/// Most tasks of a pass; fixed, so that sums have the same bits for any number of threads.
const MAX_TASKS: usize = 64;

/// ℓ and its derivatives at a point. The mean is the sum of the means of all levels, so the derivatives by the mean of
/// each level are equal.
pub(crate) fn pass(units: &Units, point: &Point, wanted: SumsWanted<'_>) -> Sums {
    if let Some(crossing) = &units.crossing {
        return crossed::pass(units, crossing, point, wanted);
    }
    let flat = wanted.flat.map(|flat| (summed_levels(flat, units.states, units.levels()), flat.covariance));
    let selection = SumSelection {
        flat: flat.as_ref().map(|(jacobian, covariance)| (jacobian, *covariance)),
        ..SumSelection::of(units, wanted, wanted.order)
    };
    let work_items = work_items(units);
    let of_part = |work_items: &[UnitWork<'_>]| {
        let shared = work_items.iter().filter_map(UnitWork::columns);
        let columns = in_columns(units, (point, wanted), shared, selection);
        let batches = work_items.iter().filter_map(UnitWork::batch).collect();
        columns.and(Isa::best().run(UnitKernel { units, point, wanted, selection, batches }))
    };
    let parts: Vec<UnitSums> =
        work_items.par_chunks(work_items.len().div_ceil(MAX_TASKS).max(1)).map(of_part).collect();
    sums((units, units.constant), parts.into_iter().fold(UnitSums::zero(selection), UnitSums::and), wanted)
}

/// Calls `of` for each unit, or for each part where groups cross, with the indices of the tests' reductions and the sums
/// of first order over these tests, without the constants of the tests.
pub(crate) fn each_unit(units: &Units, point: &Point, wanted: SumsWanted<'_>, of: &mut dyn FnMut(&[usize], &Sums)) {
    if let Some(crossing) = &units.crossing {
        return crossed::each_part((units, crossing), point, wanted, of);
    }
    let selection = SumSelection::of(units, wanted, Order::First);
    for design in units.designs.iter() {
        for (number, unit) in design.units.iter().enumerate() {
            let single_unit = std::iter::once((design, number..number + 1));
            let totals = in_columns(units, (point, wanted), single_unit, selection);
            of(&unit.tests, &sums((units, 0.0), totals, wanted));
        }
    }
}

impl SumSelection<'_> {
    pub(super) fn of(units: &Units, wanted: SumsWanted<'_>, order: Order) -> Self {
        let (states, levels) = (units.states, units.levels());
        SumSelection { order, states, levels, coordinates: states + wanted.regressors.len(), flat: None }
    }
}

/// Units that are evaluated together.
enum UnitWork<'a> {
    /// Some units of one design.
    Columns(&'a UnitDesign, Range<usize>),
    Batch(&'a UnitBatch),
}

impl<'a> UnitWork<'a> {
    fn columns(&self) -> Option<(&'a UnitDesign, Range<usize>)> {
        match self {
            UnitWork::Columns(design, units) => Some((design, units.clone())),
            UnitWork::Batch(_) => None,
        }
    }

    fn batch(&self) -> Option<&'a UnitBatch> {
        match self {
            UnitWork::Columns(..) => None,
            UnitWork::Batch(batch) => Some(batch),
        }
    }
}

fn work_items<'a>(units: &'a Units) -> Vec<UnitWork<'a>> {
    let of = |design: &'a UnitDesign| {
        let count = design.units.len();
        (0..count)
            .step_by(MAX_COLUMNS)
            .map(move |from| UnitWork::Columns(design, from..(from + MAX_COLUMNS).min(count)))
    };
    let shared = units.designs.iter().filter(|design| design.is_shared()).flat_map(of);
    shared.chain(units.batches.iter().map(UnitWork::Batch)).collect()
}

/// Sums over units of equal designs, evaluated in columns.
fn in_columns<'a>(
    units: &Units,
    (point, wanted): (&Point, SumsWanted<'_>),
    work_items: impl Iterator<Item = (&'a UnitDesign, Range<usize>)>,
    selection: SumSelection<'_>,
) -> UnitSums {
    let at = LevelLaws::new(units, point, wanted.regressors);
    let mut totals = UnitSums::zero(selection);
    work_items.for_each(|(design, some)| totals.take(&at, &BatchData::equal_designs(units, design, some), selection));
    totals
}

/// Kernel that sums over the units of some batches, in lanes.
struct UnitKernel<'a> {
    units: &'a Units,
    point: &'a Point,
    wanted: SumsWanted<'a>,
    selection: SumSelection<'a>,
    batches: Vec<&'a UnitBatch>,
}

impl Kernel for UnitKernel<'_> {
    type Output = UnitSums;

    #[inline(always)]
    fn run<T: Lanes>(self) -> UnitSums {
        let at = LevelLaws::<T>::new(self.units, self.point, self.wanted.regressors);
        let mut totals = UnitSums::<T>::zero(self.selection);
        for batch in self.batches {
            totals.take(&at, &BatchData::of(self.units, batch), self.selection);
        }
        totals.of_all_lanes()
    }
}

/// d(μ, coefficients) / d(free mean coordinates), with μ the sum of the means of all levels.
pub(super) fn summed_levels(flat: &FlatMean<'_>, p: usize, levels: usize) -> DMatrix<f64> {
    let all = flat.jacobian;
    DMatrix::from_fn(all.nrows() - p * (levels - 1), all.ncols(), |row, c| match row.checked_sub(p) {
        None => (0..levels).map(|l| all[(l * p + row, c)]).sum(),
        Some(regressor) => all[(p * levels + regressor, c)],
    })
}

/// The sums of a pass from the totals over units; `constant`: the constants of the tests.
pub(super) fn sums((units, constant): (&Units, f64), totals: UnitSums, wanted: SumsWanted<'_>) -> Sums {
    let (p, levels) = (units.states, units.levels());
    let mut sums = wanted.zero_in_groups();
    let all = sums.mean_score.len();
    // index among (μ, coefficients) of coordinate m of (means of all levels, coefficients)
    let summed_index = |m: usize| if m < p * levels { m % p } else { m - p * (levels - 1) };
    sums.value = constant + totals.value;
    sums.quadratic = totals.quadratic;
    sums.mean_score.iter_mut().enumerate().for_each(|(m, to)| *to = totals.score[(summed_index(m), 0)]);
    sums.mean_information = DMatrix::from_fn(all, all, |m, n| totals.information[(summed_index(m), summed_index(n))]);
    for (level, (outer, weight)) in totals.outer.iter().zip(&totals.weight).enumerate() {
        let at = (level * p, level * p);
        sums.outer.view_mut(at, (p, p)).copy_from(&matrix(outer));
        sums.weight.view_mut(at, (p, p)).copy_from(&matrix(weight));
    }
    sums.spread = matrix(&totals.spread);
    let cross = DMatrix::from_fn(if totals.cross.ncols() > 0 { all } else { 0 }, totals.cross.ncols(), |m, e| {
        totals.cross[(summed_index(m), e)]
    });
    let symmetric = |a: &Rows| {
        let a = matrix(a);
        (&a + a.transpose()) * 0.5
    };
    sums.group_derivatives =
        Some(GroupDerivatives { observed: symmetric(&totals.observed), cross, expected: symmetric(&totals.expected) });
    sums
}

fn matrix(rows: &Rows) -> DMatrix<f64> {
    DMatrix::from_fn(rows.nrows(), rows.ncols(), |i, k| rows[(i, k)])
}
