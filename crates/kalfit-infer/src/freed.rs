//! The structure with one constraint freed, and the likelihood ratio of the constraint by a fit to that structure.
//!
//! A score test looks at the slope of ℓ at the constraint. The data are said to contradict a constraint only where the
//! likelihood ratio says so too.

use crate::constraint::Sensitivity;
use crate::score_test::p_value;
use crate::small_sample::{DfChoice, JointTest, SmallSample};
use kalfit_algebra::elements::Element;
use kalfit_estimate::{Criterion, Estimate, PhaseStructure, Silent, Stop, Structure, fit, fit_from};
use kalfit_filter::reduce::Reductions;
use kalfit_model::{CovarianceKind, CovarianceStructure, FixedElement, MeanElement, MeanStructure, Population};
use std::borrow::Cow;

/// Level, over all tested constraints together, at which a score test calls for the likelihood ratio.
pub(crate) const LEVEL: f64 = 0.05;
/// Largest number of constraints with a likelihood ratio, those with the smallest p-values.
const MOST_RATIOS: usize = 20;

/// A phase or level with one of its constraints freed.
pub(crate) struct Freed {
    /// Index among the phases and levels of the structure.
    pub(crate) part: usize,
    pub(crate) mean: MeanStructure,
    pub(crate) covariance: CovarianceStructure,
}

impl Freed {
    /// The part of a structure that holds an element, with the element free; `None` where the form of Σ has no single
    /// elements.
    pub(crate) fn of(structure: &Structure<'_>, element: Element) -> Option<Freed> {
        let (Element::Mean(first) | Element::Covariance(first, _)) = element;
        let ranges = structure.ranges();
        let part = ranges.iter().position(|range| range.contains(&first))?;
        let (start, own) = (ranges[part].start, &structure.phases[part]);
        let (mut mean, covariance) = (own.mean.clone().into_owned(), own.covariance.clone());
        match element {
            Element::Mean(i) => {
                mean.elements[i - start] = MeanElement::Free;
                Some(Freed { part, mean, covariance })
            }
            Element::Covariance(i, j) => {
                let freed = without_constraint(covariance, (i.max(j) - start, i.min(j) - start), mean.elements.len())?;
                Some(Freed { part, mean, covariance: freed })
            }
        }
    }

    /// The structure with this part in place.
    pub(crate) fn within<'a>(&'a self, structure: &Structure<'a>) -> Structure<'a> {
        let mut freed = structure.clone();
        freed.phases[self.part] = PhaseStructure { mean: Cow::Borrowed(&self.mean), covariance: &self.covariance };
        freed
    }
}

/// The structure without its constraint on element (i, j), i ≥ j, of p × p.
fn without_constraint(
    mut structure: CovarianceStructure,
    (i, j): (usize, usize),
    p: usize,
) -> Option<CovarianceStructure> {
    let blocks = match &structure.kind {
        CovarianceKind::Full => vec![(0..p).collect()],
        CovarianceKind::Diagonal => (0..p).map(|k| vec![k]).collect(),
        CovarianceKind::Blocks(blocks) => blocks.clone(),
        _ => return None,
    };
    let place = |k: usize| blocks.iter().position(|block: &Vec<usize>| block.contains(&k));
    let (a, b) = (place(i)?, place(j)?);
    let without_variance = |k: usize| structure.fixed.iter().any(|f| (f.i, f.j, f.value) == (k, k, 0.0));
    let mut zeros: Vec<(usize, usize)> = Vec::new();
    if a != b {
        // the two blocks become one, in which all covariances between them but this one stay zero
        let pairs = blocks[a].iter().flat_map(|&k| blocks[b].iter().map(move |&l| (k.max(l), k.min(l))));
        zeros.extend(pairs.filter(|&(k, l)| (k, l) != (i, j) && !without_variance(k) && !without_variance(l)));
        let mut joined: Vec<Vec<usize>> =
            blocks.iter().enumerate().filter(|(at, _)| *at != a && *at != b).map(|(_, block)| block.clone()).collect();
        let mut both: Vec<usize> = blocks[a].iter().chain(&blocks[b]).copied().collect();
        both.sort_unstable();
        joined.push(both);
        structure.kind = CovarianceKind::Blocks(joined);
    } else if i == j && without_variance(i) {
        // covariances with the state were zero with its variance
        let others = blocks[a].iter().filter(|&&k| k != i && !without_variance(k));
        zeros.extend(others.map(|&k| (i.max(k), i.min(k))));
    }
    structure.fixed.retain(|f| (f.i, f.j) != (i, j));
    zeros.retain(|&(k, l)| !structure.fixed.iter().any(|f| (f.i, f.j) == (k, l)));
    structure.fixed.extend(zeros.into_iter().map(|(i, j)| FixedElement { i, j, value: 0.0 }));
    structure.start = None;
    Some(structure)
}

/// ℓ_max, at the α of an estimate, with a constraint freed; `None` without a certified maximum.
pub(crate) fn freed_maximum(estimate: &Estimate, reductions: &Reductions, freed: &Freed) -> Option<f64> {
    freed_fit(estimate, reductions, freed).map(|found| found.log_likelihood)
}

/// The fit, at the α of an estimate, with a constraint freed; `None` without a certified maximum.
fn freed_fit(estimate: &Estimate, reductions: &Reductions, freed: &Freed) -> Option<Estimate> {
    let state = &estimate.state;
    let assumed = state.structure();
    let structure = freed.within(&assumed);
    let near = fit_from(reductions, &structure, &Population::from(estimate), &state.settings, &mut Silent);
    let certified = |found: &Estimate| found.stop == Stop::Certified;
    let found = near.ok().filter(certified);
    found.or_else(|| fit(reductions, &structure, &state.settings, &mut Silent).ok().filter(certified))
}

/// Whether likelihood ratios of constraints can be formed: one likelihood was maximised, of tests that are here.
pub(crate) fn is_possible(estimate: &Estimate, reductions: &Reductions) -> bool {
    estimate.stop == Stop::Certified && !estimate.state.is_marginal() && reductions.remote().is_none()
}

/// Tests of a constraint by a fit without it.
pub(crate) struct Refits<'a> {
    /// ℓ_max with a constraint freed, given the level at which the statistic is to decide, and whether only one side of
    /// the held value is possible.
    pub(crate) maximum: &'a dyn Fn(&Freed, f64, bool) -> Option<f64>,
    /// The F test of a fixed mean, under the restricted likelihood.
    pub(crate) f_test: &'a dyn Fn(&Freed) -> Option<JointTest>,
}

/// The F test of a fixed mean by the laws of few tests (theory §14), at known α.
pub(crate) fn f_test(
    (estimate, reductions): (&Estimate, &Reductions),
    freed: &Freed,
    choice: DfChoice,
) -> Option<JointTest> {
    let wide = freed_fit(estimate, reductions, freed)?;
    SmallSample::of(&wide, reductions, choice)?.ok()?.f_test(&wide, estimate).ok()
}

/// Adds the test by a refit to each constraint that its score test rejects: F for means under the restricted likelihood,
/// whose maxima for different means cannot be compared, and the likelihood ratio for all others.
pub(crate) fn add_refits(estimate: &Estimate, sensitivities: &mut [Sensitivity], refits: &Refits<'_>) {
    let count = sensitivities.iter().filter(|own| own.p_value.is_some()).count();
    let level = LEVEL / count.max(1) as f64;
    let mut rejected: Vec<&mut Sensitivity> =
        sensitivities.iter_mut().filter(|own| own.p_value.is_some_and(|p| p < level)).collect();
    rejected.sort_by(|a, b| b.statistic.unwrap_or(0.0).total_cmp(&a.statistic.unwrap_or(0.0)));
    let structure = estimate.state.structure();
    for own in rejected.into_iter().take(MOST_RATIOS) {
        let Some(freed) = Freed::of(&structure, own.element) else { continue };
        if matches!(own.element, Element::Mean(_)) && estimate.criterion == Criterion::Reml {
            own.f = (refits.f_test)(&freed);
            continue;
        }
        let Some(maximum) = (refits.maximum)(&freed, level, own.is_one_sided()) else { continue };
        let ratio = (2.0 * (maximum - estimate.log_likelihood)).max(0.0);
        (own.ratio, own.ratio_p_value) = (Some(ratio), Some(p_value(ratio, own.is_one_sided())));
    }
}
