//! The outcome of a single test: the data pass under the gains of the test's design.

use crate::reduce::data::{Data, EXACT_TOLERANCE, Miss, Outcome};
use crate::reduce::design::Design;
use crate::reduce::exact_design::ExactDesign;
use crate::reduce::gains::{FactorRotations, Gains};
use crate::reduce::lanes::{DataWorkspace, InnovationObserver, innovations, pass_alone};
use kalfit_lanes::Lanes;

/// The outcome of a test; an error where a noise-free measurement has a value other than the only possible one.
pub(crate) fn outcome(
    design: &Design,
    gains: &Gains,
    data: &Data,
    scratch: &mut DataWorkspace,
) -> Result<Outcome, Miss> {
    let design_and_gains = (design, gains);
    let Some(rotations) = &gains.rotations else {
        pass_alone(design_and_gains, data, scratch);
        return Ok(scratch.outcome((0, 1), gains.active, gains.log_determinant));
    };
    let mut exact = None;
    if gains.active < design.rows() || !rotations.exact.is_empty() {
        let mut check = ConsistencyCheck {
            design,
            gains,
            exact: &rotations.exact,
            sizes: &data.sizes,
            exact_sizes: Vec::new(),
            miss: None,
        };
        innovations(design_and_gains, data, scratch, &mut check);
        check.miss.map_or(Ok(()), Err)?;
        exact = (!rotations.exact.is_empty())
            .then(|| rotations.exact.rows_from_innovations(&scratch.e, &check.exact_sizes))
            .transpose()?;
    } else {
        innovations(design_and_gains, data, scratch, &mut ());
    }
    let (d, residual) = folded((design.frame.p, gains), rotations, &scratch.e);
    Ok(Outcome { exact: exact.map(Box::new), ..Outcome::new(d, residual, gains.active, gains.log_determinant) })
}

/// Observer that checks measurements with 1/S = 0: the value of such a measurement is determined by other measurements.
struct ConsistencyCheck<'a> {
    design: &'a Design,
    gains: &'a Gains,
    exact: &'a ExactDesign,
    sizes: &'a [f64],
    /// Size of the terms of each exact measurement.
    exact_sizes: Vec<f64>,
    /// The first measurement with an impossible value.
    miss: Option<Miss>,
}

impl InnovationObserver for ConsistencyCheck<'_> {
    const OBSERVES_EVERY_ROW: bool = true;

    fn observe<T: Lanes>(&mut self, (row, line): (usize, usize), e: T, x: &[T]) {
        let (e, (states, h)) = (e.lane(0), self.design.terms(line));
        let terms: f64 = states.iter().zip(h).map(|(&state, h)| (h * x[state as usize].lane(0)).abs()).sum();
        let (has_no_weight, size) = (self.gains.row(row).0 == 0.0, self.sizes[row] + terms);
        if has_no_weight && self.exact.has(row) {
            self.exact_sizes.push(size);
        } else if has_no_weight && e.abs() > EXACT_TOLERANCE * size && self.miss.is_none() {
            self.miss = Some(Miss { row, residual: e });
        }
    }
}

/// (d, residual sum of squares): the rotations that made R, applied to the innovations `e`.
fn folded((p, gains): (usize, &Gains), rotations: &FactorRotations, e: &[f64]) -> (Vec<f64>, f64) {
    let (mut d, mut residual) = (vec![0.0; p], 0.0);
    for (row, &e) in e.iter().enumerate() {
        let mut left = e * gains.row(row).0.sqrt();
        for (d, &(c, s)) in d.iter_mut().zip(&rotations.row_rotations[row * p..]) {
            (*d, left) = (c * *d + s * left, c * left - s * *d);
        }
        residual += left * left;
    }
    for &settle in &rotations.settle {
        settle.apply(&mut d, &mut residual);
    }
    (d, residual)
}
