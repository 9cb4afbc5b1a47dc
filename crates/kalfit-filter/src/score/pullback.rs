//! From the adjoints of a test's coefficients to dℓ/dα.
//!
//! ```text
//! φ̄, Q̄, b̄ of steps ── groups ──> F̄, Q̄_c, ū ─┐
//! R̄, z̄, h̄ of measurements ── unwhitened ──────┼── taps ──> dℓ/dα
//! ā, P̄0 ── Lyapunov ──────────────────────────┘
//! ```
//!
//! A *tap* is a coefficient that depends on a free value. The adjoints of a tap are summed over each run of equal
//! cells, and each sum goes through the expression of the tap once. The cost of the pullback does not depend on the
//! number of free values.

mod adjoints;
mod columns;
mod groups;
mod measured;
mod moved;
mod response;
mod taps;
#[cfg(test)]
mod tests;
mod whitened;

use std::collections::BTreeSet;

use crate::reduce::{Coefficient, Fault, ModelAt, Preparer, ReduceErrorKind, Subject};
use kalfit_model::Slots;

pub(crate) use adjoints::Adjoints;
pub(crate) use response::{PullbackFactors, ResponseEntry};
pub use taps::Gradient;
pub use taps::add;
use taps::{CellRead, Context, FreeCoefficients};

/// The chain rule from the coefficients of a model at α to the free values of α, shared by threads.
#[derive(Debug)]
pub(crate) struct Pullback<'a> {
    preparer: &'a Preparer,
    slots: &'a Slots,
    taps: FreeCoefficients,
    /// Index of the tap of each coefficient of the dynamics, by slot; `None` for coefficients without a tap.
    values: Vec<Option<usize>>,
    /// Index of the tap of each known input of the dynamics, by slot; `None` for inputs without a tap.
    inputs: Vec<Option<usize>>,
    /// Whether each coefficient of the dynamics has a tap, by slot.
    free: Vec<bool>,
    /// Cells that taps of the dynamics' coefficients read.
    reads: Vec<CellRead>,
    /// Cells that the taps read; `None` where no tap reads a cell.
    cells: Option<Vec<CellRead>>,
    meters: Vec<MeterTaps>,
    pairs: Vec<Option<usize>>,
    /// Index of the tap of each coefficient of the start; `None` for coefficients without a tap.
    start: Vec<Option<usize>>,
    needs: NeededAdjoints,
}

/// Indices of the taps of the coefficients of a measurement.
#[derive(Debug, Clone)]
struct MeterTaps {
    noise: Option<usize>,
    constant: Option<usize>,
    /// (kernel state, tap) of each coefficient of h that has a tap.
    terms: Vec<(usize, usize)>,
}

impl MeterTaps {
    fn taps(&self) -> impl Iterator<Item = usize> {
        self.noise.into_iter().chain(self.constant).chain(self.terms.iter().map(|&(_, tap)| tap))
    }
}

#[derive(Debug, Clone, Copy, Default)]
struct NeededAdjoints {
    /// Whether φ depends on free values, and with φ also Γ in b = Γu.
    rates: bool,
    inputs: bool,
    noise: bool,
    equation: bool,
    measurements: bool,
    start: bool,
}

impl<'a> Pullback<'a> {
    /// `preparer` must have been made with the free parameters of `slots` ([`Preparer::with_free`]). Returns an error
    /// where a free parameter decides which rows count, or decides the time of x_0: ℓ is not continuous in such a
    /// parameter.
    pub(crate) fn new(preparer: &'a Preparer, slots: &'a Slots) -> Result<Pullback<'a>, Box<Fault>> {
        let at = preparer.at();
        refuse_jumps(&at, preparer)?;
        let mut taps = FreeCoefficients::default();
        let dynamics = &preparer.dynamics;
        let values = table(&mut taps, &at, &dynamics.table);
        let inputs = table(&mut taps, &at, &dynamics.inputs);
        let mut meters = Vec::new();
        for (noise, constant, terms) in preparer.meters.parts() {
            let (noise, constant) = (taps.add(&at, noise), taps.add(&at, constant));
            let term = |(state, h): &(u32, Coefficient)| Some((*state as usize, taps.add(&at, h)?));
            meters.push(MeterTaps { noise, constant, terms: terms.iter().filter_map(term).collect() });
        }
        let pairs: Vec<Option<usize>> = preparer.meters.pairs().map(|pair| taps.add(&at, pair)).collect();
        let start: Vec<Option<usize>> = preparer.start.coefficients().map(|c| taps.add(&at, c)).collect();
        let reads: BTreeSet<CellRead> = values.iter().flatten().flat_map(|&tap| taps.reads(tap)).copied().collect();
        let free = values.iter().map(Option::is_some).collect();
        let cells = taps.all_reads();
        let mut pullback = Pullback {
            preparer,
            slots,
            taps,
            values,
            inputs,
            free,
            reads: reads.into_iter().collect(),
            cells: Some(cells).filter(|cells| !cells.is_empty()),
            meters,
            pairs,
            start,
            needs: NeededAdjoints::default(),
        };
        pullback.needs = pullback.needed_adjoints();
        Ok(pullback)
    }

    /// Finds the adjoints that the chain rule needs: the adjoints of coefficients that depend on free values.
    fn needed_adjoints(&self) -> NeededAdjoints {
        let dynamics = &self.preparer.dynamics;
        let (free, start) = (|slot: usize| self.free[slot], &self.preparer.start);
        let any = |terms: &[(usize, usize, usize)]| terms.iter().any(|&(.., slot)| free(slot));
        let rates = dynamics.components.iter().any(|c| any(&c.rates) || any(&c.held))
            || dynamics.recursions.iter().any(|recursion| recursion.terms.iter().any(|&(_, slot)| free(slot)));
        let noise = any(&dynamics.noise)
            || dynamics.components.iter().any(|c| any(&c.noise) || (any(&c.rates) && !c.noise.is_empty()));
        let noises = self.meters.iter().any(|meter| meter.noise.is_some());
        let covariances = self.pairs.iter().any(Option::is_some);
        let terms = self.meters.iter().any(|meter| !meter.terms.is_empty());
        let constants = self.meters.iter().any(|meter| meter.constant.is_some());
        let settled = (0..self.free.len()).any(|slot| free(slot) && start.needs(slot));
        let driven = (0..self.inputs.len()).any(|slot| self.inputs[slot].is_some() && start.needs_input(slot));
        NeededAdjoints {
            rates,
            inputs: self.inputs.iter().any(Option::is_some),
            noise,
            // Whitening combines the h of several measurements with weights that depend on the noise variances.
            equation: terms || covariances || (noises && !self.pairs.is_empty()),
            measurements: terms || covariances || noises || constants,
            start: self.start.iter().any(Option::is_some) || settled || driven,
        }
    }

    /// Whether φ depends on free values.
    pub(crate) fn needs_rates(&self) -> bool {
        self.needs.rates
    }

    /// Whether φ or b depends on free values.
    #[cfg(test)]
    pub(crate) fn needs_motion(&self) -> bool {
        self.needs.rates || self.needs.inputs
    }

    /// Whether Q depends on free values.
    #[cfg(test)]
    pub(crate) fn needs_noise(&self) -> bool {
        self.needs.noise
    }

    /// Whether adjoints of h are needed, because h or the whitening of measurements depends on free values.
    pub(crate) fn needs_equation(&self) -> bool {
        self.needs.equation
    }

    /// Whether a or P0 depends on free values.
    #[cfg(test)]
    pub(crate) fn needs_start(&self) -> bool {
        self.needs.start
    }

    fn context(&self) -> Context<'_> {
        Context { at: self.preparer.at(), slots: self.slots, taps: &self.taps }
    }
}

/// Index of the tap of each coefficient of a table, by slot; `None` for coefficients without a tap.
fn table(taps: &mut FreeCoefficients, at: &ModelAt<'_>, table: &crate::reduce::Table) -> Vec<Option<usize>> {
    let mut places = vec![None; table.fixed.len()];
    for (slot, coefficient) in table.free.iter().map(|(slot, c)| (*slot, c)) {
        places[slot] = taps.add(at, coefficient);
    }
    for (slot, coefficient, _) in &table.varying {
        places[*slot] = taps.add(at, coefficient);
    }
    places
}

fn refuse_jumps(at: &ModelAt<'_>, preparer: &Preparer) -> Result<(), Box<Fault>> {
    let refuse = |coefficient: &Coefficient, subject: Subject| {
        let Some(parameter) = coefficient.source().and_then(|(expression, _)| at.free_parameter(expression)) else {
            return Ok(());
        };
        let parameter = at.model.parameters[parameter].name.clone();
        Err(Fault::new(subject, ReduceErrorKind::FreeParameter { parameter }))
    };
    preparer.meters.filters().try_for_each(|(m, filter)| refuse(filter, Subject::Filter(m)))?;
    preparer.start.initial_time.iter().try_for_each(|time| refuse(time, Subject::InitialTime))
}
