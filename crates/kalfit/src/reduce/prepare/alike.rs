//! What tests that look alike are recognised by.

use crate::reduce::dynamics::Dynamics;
use crate::reduce::observe::Meters;
use crate::reduce::recognise::Looks;
use crate::reduce::start::Start;
use crate::reduce::subject::{At, Uses};

/// All that is read of a test but measured values and covariates; `None` where values are mixed. `shape` and `drive`: columns of
/// the measurements and of the dynamics.
pub(super) fn looks(
    at: &At<'_>,
    (shape, drive): (&Uses, &Uses),
    (dynamics, start, meters): (&Dynamics, &Start, &Meters),
) -> Option<Looks> {
    let mut read = Uses::default();
    for uses in [shape, drive, &dynamics.uses] {
        read.numbers.extend(&uses.numbers);
        read.texts.extend(&uses.texts);
    }
    start.coefficients().chain(&start.initial_time).for_each(|coefficient| read.add(coefficient, at.alpha));
    read.numbers.extend(at.model.clock.time);
    meters.can_repeat().then(|| Looks::new(at.model.columns.len(), &read, meters.columns()))
}
