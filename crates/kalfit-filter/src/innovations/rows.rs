//! Innovations of the rows of a phase, from a data pass over the rows.

use crate::innovations::innovation::Innovation;
use crate::reduce::{CACHED_ROWS, Gains, Instance, Workspace, single_test_innovations};
use kalfit_model::Test;

/// e, S and e/√S of one measurement.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Figures {
    pub(crate) value: f64,
    pub(crate) variance: f64,
    pub(crate) standardised: f64,
}

/// The form in which the innovations of a test are listed: all of each, or e/√S alone.
pub(crate) trait ListedInnovation: Sized + Send {
    /// Appends innovations in the order of `measured`, which gives (step, measurement); measurements without figures
    /// are omitted. The first argument after the list is (phase, rows, column of times).
    fn append(
        series: &mut Vec<Self>,
        place: (usize, &Test, Option<usize>),
        measured: impl Iterator<Item = (usize, Instance)>,
        row_figures: impl Iterator<Item = Option<Figures>>,
    );

    /// True if S and e/√S are finite.
    fn is_finite(&self) -> bool;
}

impl ListedInnovation for Innovation {
    fn append(
        series: &mut Vec<Innovation>,
        (phase, rows, time): (usize, &Test, Option<usize>),
        measured: impl Iterator<Item = (usize, Instance)>,
        row_figures: impl Iterator<Item = Option<Figures>>,
    ) {
        let all = measured.zip(row_figures).filter_map(|(place, figures)| Some((place, figures?)));
        series.extend(all.map(|((step, instance), Figures { value, variance, standardised })| {
            let time = time.map(|column| rows.numbers(instance.row)[column]);
            Innovation { phase, step, time, measurement: instance.meter, value, variance, standardised }
        }));
    }

    fn is_finite(&self) -> bool {
        self.standardised.is_finite() && self.variance.is_finite()
    }
}

/// e/√S, or NaN where S is not finite.
impl ListedInnovation for f64 {
    fn append(
        series: &mut Vec<f64>,
        _: (usize, &Test, Option<usize>),
        _: impl Iterator<Item = (usize, Instance)>,
        row_figures: impl Iterator<Item = Option<Figures>>,
    ) {
        let standardised =
            |figures: Figures| if figures.variance.is_finite() { figures.standardised } else { f64::NAN };
        series.extend(row_figures.flatten().map(standardised));
    }

    fn is_finite(&self) -> bool {
        f64::is_finite(*self)
    }
}

/// Runs the data pass over the rows of a phase in the work space. `figures` maps e, 1/S and T of the filter to the
/// figures of the innovation. A measurement that can only have one value is omitted; the reduction checks that
/// value.
pub(crate) fn series<T: ListedInnovation>(
    place: (usize, &Test, Option<usize>),
    gains: &Gains,
    work: &mut Workspace,
    mut figures: impl FnMut(f64, f64, &[f64]) -> Figures,
) -> Vec<T> {
    single_test_innovations(gains, work);
    let row_figures = work.pass.e.iter().enumerate().map(|(row, &e)| {
        let (weight, _, sensitivity) = gains.row(row);
        (weight > 0.0).then(|| figures(e, weight, sensitivity))
    });
    let mut series = Vec::with_capacity(work.pass.e.len());
    T::append(&mut series, place, measured(work), row_figures);
    series
}

/// The innovations of tests of one design, whose data pass has run in the first lanes of the block of the work space.
/// `figures` maps e and 1/S to the figures of an innovation. The first argument is (phase, tests, column of times).
pub(crate) fn series_in_lanes<T: ListedInnovation>(
    (phase, tests, time): (usize, &[&Test], Option<usize>),
    gains: &Gains,
    work: &Workspace,
    figures: impl Fn(f64, f64) -> Figures,
) -> Vec<Vec<T>> {
    let (lanes, e) = (work.block.lanes(), &work.scratch.e);
    let mut series: Vec<Vec<T>> = tests.iter().map(|_| Vec::with_capacity(e.len() / lanes)).collect();
    let (mut measured, mut row) = (measured(work), 0);
    let mut rows = Vec::with_capacity(CACHED_ROWS);
    for e in e.chunks(CACHED_ROWS * lanes) {
        rows.clear();
        for place in measured.by_ref().take(e.len() / lanes) {
            rows.push((place, gains.row(row).0));
            row += 1;
        }
        for (lane, (test, series)) in tests.iter().zip(&mut series).enumerate() {
            let row_figures = rows
                .iter()
                .zip(e.chunks_exact(lanes))
                .map(|((_, weight), e)| (*weight > 0.0).then(|| figures(e[lane], *weight)));
            T::append(series, (phase, test, time), rows.iter().map(|(place, _)| *place), row_figures);
        }
    }
    series
}

/// (step, measurement) of each scalar measurement of the test in the work space.
fn measured(work: &Workspace) -> impl Iterator<Item = (usize, Instance)> {
    let steps = work.design.each_step().enumerate().flat_map(|(step, rows)| rows.rows.map(move |_| step));
    steps.zip(work.instances.iter())
}

/// True if S and e/√S of all innovations are finite.
pub(crate) fn are_finite<T: ListedInnovation>(series: &[T]) -> bool {
    series.iter().all(T::is_finite)
}
