//! A start from a part of the tests.
//!
//! Of very many designs every so-many-th, in an order that goes by what they tell, stand for all. The best (μ, Σ) of those few
//! costs little to find and lies within their sampling error of that of all, where Newton's method needs but a few passes.

use crate::problem::Problem;
use crate::{Criterion, FitError, Structure};

/// Fewest classes of a pilot, and fewest for each free coordinate of (μ, Σ).
const CLASSES: usize = 512;
const EACH: usize = 6;
/// A pilot is of no more than this part of all classes.
const PART: usize = 8;

/// The problem of a part of the classes, in the same coordinates; `None` where there are too few to be worth it.
pub(crate) fn problem(whole: &Problem, structure: &Structure<'_>) -> Result<Option<Problem>, FitError> {
    let coordinates = whole.mean.basis.ncols() + whole.mean.regressors.len() + whole.covariance.elements.count();
    let wanted = CLASSES.max(EACH * coordinates);
    // of tests in groups whole units, whose restricted likelihood would want all designs
    let all = match &whole.classes.units {
        Some(_) if whole.criterion() == Criterion::Reml => return Ok(None),
        Some(units) => units.len(),
        None => whole.classes.len(),
    };
    let every = all / wanted;
    if every < PART {
        return Ok(None);
    }
    Ok(Some(Problem::of(whole.classes.thinned(every), structure, whole.criterion())?))
}
