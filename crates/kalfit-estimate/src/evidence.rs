//! The reductions that the maximised likelihood is computed from.

use std::borrow::Cow;

use rayon::prelude::*;

use crate::error::FitError;
use crate::settings::{Combination, Criterion, Settings};
use crate::structure::Structure;
use crate::{levels, marginal};
use kalfit_filter::reduce::{ReductionRef, Reductions};
use kalfit_model::Reduction;

/// The reductions whose likelihood is maximised: the given reductions; under `Marginal`, the difference between each
/// phase and the prediction from the phase before; for tests in groups, reductions in the states of the test and of
/// each group of the test.
pub fn evidence<'a>(
    reductions: &'a Reductions,
    structure: &Structure<'_>,
    settings: &Settings,
) -> Result<Cow<'a, Reductions>, FitError> {
    let (phases, states) = (structure.phases.len(), structure.dimension());
    if structure.grouping.is_some() {
        let is_stacked = |r: ReductionRef<'_>| r.data.len() == states;
        return Ok(match reductions.iter().all(is_stacked) {
            true => Cow::Borrowed(reductions),
            false => Cow::Owned(reductions.iter().map(|r| levels::stacked(r, phases)).collect()),
        });
    }
    if settings.phases != Combination::Marginal || phases < 2 {
        return Ok(Cow::Borrowed(reductions));
    }
    if settings.criterion == Criterion::Reml {
        return Err(FitError::RestrictedMarginal);
    }
    let one = |r: ReductionRef<'_>| {
        marginal::marginal(r, states).ok_or_else(|| FitError::NoPhases { test: r.test.to_owned() })
    };
    let all: Vec<Result<Reduction, FitError>> = reductions.par_iter().map(one).collect();
    Ok(Cow::Owned(all.into_iter().collect::<Result<_, _>>()?))
}
