//! The numbers that a pass over tests in lanes reads from the designs and the data of the tests.
#![expect(non_snake_case, reason = "the letters of the theory: R")]

use kalfit_lanes::Lanes;

use crate::reduce::data::Data;
use crate::reduce::design::{Design, Stretch, TransitionView};
use crate::reduce::entries::Entries;
use crate::reduce::segments::SegmentedStretch;

/// The numbers that a pass reads from the designs of tests: shared by all lanes, or one per lane.
pub(crate) trait Numbers<T> {
    /// Type of a list of numbers: shared by all lanes, or one per lane.
    type List<'a>: Entries<T>
    where
        Self: 'a;
    /// The transition of a run.
    fn transition<'a>(&'a self, design: &'a Design, run: usize) -> Option<TransitionView<'a, Self::List<'a>>>;
    /// Coefficients h of the terms of all lines.
    fn h(&self) -> Self::List<'_>;
    /// 1/S and K of a row.
    fn gains(&self, row: usize) -> (T, Self::List<'_>);
    /// T of a row.
    fn sensitivities(&self, row: usize) -> Self::List<'_>;
    /// R, upper triangle, packed by columns.
    fn R(&self) -> Self::List<'_>;
    /// Rows from `row` to at most `end`, and the row from which on 1/S and T repeat.
    #[inline(always)]
    fn repeats(&self, _row: usize, end: usize) -> Repeats {
        Repeats { steady: end, end, width: 1 }
    }
    /// The stretches that are cut into segments.
    #[inline(always)]
    fn segments(&self) -> &[SegmentedStretch] {
        &[]
    }
    /// True if long stretches can be scanned.
    const CAN_SCAN: bool = false;
    /// Scans a stretch of equal steps: updates x̂ and replaces values by innovations. False if the stretch cannot be
    /// scanned.
    #[inline(always)]
    fn scan(&self, _: &Stretch<'_>, _: &mut [T], _: &mut [f64]) -> bool {
        false
    }
}

/// Rows up to `end`; from row `steady` on, 1/S and T repeat every `width` rows.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Repeats {
    pub(super) steady: usize,
    pub(super) end: usize,
    pub(super) width: usize,
}

/// The data of tests, in lanes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct DataView<'a> {
    pub(crate) start: &'a [f64],
    pub(crate) inputs: &'a [f64],
    pub(crate) values: &'a [f64],
}

impl<'a> DataView<'a> {
    /// View of the data of a single test.
    pub(super) fn of(data: &'a Data) -> DataView<'a> {
        DataView { start: &data.start, inputs: &data.inputs, values: &data.values }
    }
}

/// Number `k` of each test, in lanes.
#[inline(always)]
pub(crate) fn at<T: Lanes>(numbers: &[f64], k: usize) -> T {
    T::load(&numbers[k * T::COUNT..][..T::COUNT])
}

#[inline(always)]
pub(super) fn put<T: Lanes>(numbers: &mut [f64], k: usize, x: T) {
    x.store(&mut numbers[k * T::COUNT..][..T::COUNT]);
}
