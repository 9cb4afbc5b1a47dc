//! Innovations of the rows of a phase, from a data pass over the rows.

use crate::innovations::innovation::Innovation;
use crate::reduce::{Gains, Instance, Workspace, single_test_innovations};
use kalfit_model::Test;

/// e, S and e/√S of one measurement.
pub(crate) struct Figures {
    pub(crate) value: f64,
    pub(crate) variance: f64,
    pub(crate) standardised: f64,
}

/// Runs the data pass over the rows of a phase in the work space. `figures` maps e, 1/S and T of the filter to the
/// figures of the innovation. A measurement that can only have one value is omitted; the reduction checks that
/// value.
pub(crate) fn series(
    place: (usize, &Test, Option<usize>),
    gains: &Gains,
    work: &mut Workspace,
    mut figures: impl FnMut(f64, f64, &[f64]) -> Figures,
) -> Vec<Innovation> {
    single_test_innovations(gains, work);
    let Workspace { design, instances, pass, .. } = work;
    let steps = design.each_step().enumerate().flat_map(|(step, rows)| rows.rows.map(move |_| step));
    let row_figures = pass.e.iter().enumerate().map(|(row, &e)| {
        let (weight, _, sensitivity) = gains.row(row);
        (weight > 0.0).then(|| figures(e, weight, sensitivity))
    });
    list_innovations(place, steps.zip(instances.iter()), row_figures)
}

/// Innovations in the order of `measured`, which gives (step, measurement); measurements without figures are omitted.
/// The first argument is (phase, rows, column of times).
pub(crate) fn list_innovations(
    (phase, rows, time): (usize, &Test, Option<usize>),
    measured: impl Iterator<Item = (usize, Instance)>,
    row_figures: impl Iterator<Item = Option<Figures>>,
) -> Vec<Innovation> {
    let mut series = Vec::with_capacity(row_figures.size_hint().1.unwrap_or(0));
    for ((step, instance), figures) in measured.zip(row_figures) {
        if let Some(Figures { value, variance, standardised }) = figures {
            let time = time.map(|column| rows.numbers(instance.row)[column]);
            series.push(Innovation { phase, step, time, measurement: instance.meter, value, variance, standardised });
        }
    }
    series
}

/// True if S and e/√S of all innovations are finite.
pub(crate) fn are_finite(series: &[Innovation]) -> bool {
    series.iter().all(|one| one.standardised.is_finite() && one.variance.is_finite())
}
