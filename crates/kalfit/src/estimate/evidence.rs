//! What the likelihood that is maximised is of.

use std::borrow::Cow;

use rayon::prelude::*;

use crate::estimate::error::FitError;
use crate::estimate::settings::{Combination, Criterion, Settings};
use crate::estimate::structure::Structure;
use crate::estimate::{levels, marginal};
use crate::reduce::Reduction;

/// The reductions whose likelihood is maximised: those given, or, phase by phase, what is left of each phase without the one before, or,
/// where tests stand in groups, in what is a test's own and what each of its groups adds.
pub(super) fn evidence<'a>(
    reductions: &'a [Reduction],
    structure: &Structure<'_>,
    settings: &Settings,
) -> Result<Cow<'a, [Reduction]>, FitError> {
    let (phases, states) = (structure.phases.len(), structure.dimension());
    if structure.grouping.is_some() {
        let own = |r: &Reduction| if r.data.len() < states { levels::stacked(r, phases) } else { r.clone() };
        return Ok(Cow::Owned(reductions.par_iter().map(own).collect()));
    }
    if settings.phases != Combination::Marginal || phases < 2 {
        return Ok(Cow::Borrowed(reductions));
    }
    if settings.criterion == Criterion::Reml {
        return Err(FitError::RestrictedMarginal);
    }
    let one = |r: &Reduction| marginal::marginal(r, states).ok_or_else(|| FitError::NoPhases { test: r.test.clone() });
    Ok(Cow::Owned(reductions.par_iter().map(one).collect::<Result<_, _>>()?))
}
