//! From a data pass over rows to their innovations.

use crate::ensemble::Test;
use crate::innovations::series::Innovation;
use crate::reduce::{Gains, Workspace, innovate};

/// e, S and e/√S of one measurement.
pub(crate) struct Figures {
    pub(crate) value: f64,
    pub(crate) variance: f64,
    pub(crate) standardised: f64,
}

/// Runs the data pass over the rows of a phase in the work space. `figures`: from e, 1/S and T of the filter to those of the
/// innovation. A measurement that can only be one value says nothing and is left out; whether it was that value is the
/// reduction's business.
pub(crate) fn series(
    (phase, rows, time): (usize, &Test, Option<usize>),
    gains: &Gains,
    work: &mut Workspace,
    mut figures: impl FnMut(f64, f64, &[f64]) -> Figures,
) -> Vec<Innovation> {
    let Workspace { design, data, instances, pass, .. } = work;
    innovate(design, gains, data, pass);
    let mut series = Vec::with_capacity(instances.len());
    let steps = design.each_step().enumerate().flat_map(|(step, rows)| rows.rows.map(move |row| (step, row)));
    for ((step, row), instance) in steps.zip(instances.iter()) {
        let (weight, _, sensitivity) = gains.row(row);
        if weight > 0.0 {
            let time = time.map(|column| rows.numbers(instance.row)[column]);
            let Figures { value, variance, standardised } = figures(pass.e[row], weight, sensitivity);
            series.push(Innovation { phase, step, time, measurement: instance.meter, value, variance, standardised });
        }
    }
    series
}

/// All figures are numbers.
pub(crate) fn are_finite(series: &[Innovation]) -> bool {
    series.iter().all(|one| one.standardised.is_finite() && one.variance.is_finite())
}
