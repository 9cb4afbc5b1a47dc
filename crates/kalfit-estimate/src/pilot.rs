//! A start from a subset of the tests.
//!
//! Where classes are very many, every k-th class in canonical order represents all classes. The maximum over this
//! subset costs little and differs from the maximum over all tests by about the sampling error of the subset; from
//! there, Newton's method needs only a few passes.

use crate::problem::Problem;
use crate::{Criterion, FitError, Structure};

/// Smallest number of classes in a pilot.
const MIN_CLASSES: usize = 512;
/// Smallest number of classes in a pilot for each free coordinate of (μ, Σ).
const CLASSES_PER_COORDINATE: usize = 6;
/// A pilot holds at most one in this many of all classes.
const MIN_THINNING: usize = 8;

/// The problem of a subset of the classes, in the coordinates of `whole`; `None` where the classes are too few to make
/// a pilot worthwhile.
pub(crate) fn problem(whole: &Problem, structure: &Structure<'_>) -> Result<Option<Problem>, FitError> {
    let coordinates = whole.mean.basis.ncols() + whole.mean.regressors.len() + whole.covariance.elements.count();
    let min_count = MIN_CLASSES.max(CLASSES_PER_COORDINATE * coordinates);
    // tests in groups are selected by whole units, which must be independent; their restricted likelihood would need all
    // designs
    let all = match &whole.classes.units {
        Some(units) if whole.criterion() == Criterion::Reml || units.is_crossed() => return Ok(None),
        Some(units) => units.len(),
        None => whole.classes.len(),
    };
    let every = all / min_count;
    if every < MIN_THINNING {
        return Ok(None);
    }
    Ok(Some(Problem::of(whole.classes.thinned(every), structure, whole.criterion())?))
}
