//! What the likelihood that is maximised is of.

use std::borrow::Cow;

use rayon::prelude::*;

use crate::estimate::error::FitError;
use crate::estimate::marginal;
use crate::estimate::settings::{Combination, Criterion, Settings};
use crate::reduce::{Reduction, ReductionRef, Reductions};

/// The reductions whose likelihood is maximised: those given, or, phase by phase, what is left of each phase without the one before.
pub(super) fn evidence<'a>(
    reductions: &'a Reductions,
    (phases, states): (usize, usize),
    settings: &Settings,
) -> Result<Cow<'a, Reductions>, FitError> {
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
