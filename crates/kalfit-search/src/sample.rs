//! A part of the data, on which searches are cheap, and the best ends of searches on that part.

use crate::Settings;
use crate::coordinates::alike;
use crate::exchangeable::ordered;
use crate::profile_likelihood::ProfileLikelihood;
use crate::quadratic::ProfileInformation;
use crate::record::Candidate;
use crate::search::search;
use crate::search_state::SearchStart;
use kalfit_estimate::{Progress, Stage, Step};
use kalfit_model::{Evidence, PhasedTest};

/// Loss of ℓ from the best end on a part of the data up to which an end is followed on all of the data.
pub(super) const CLOSE_LOSS: f64 = 5.0;
/// Maximal number of such ends that are followed.
pub(super) const MAX_FOLLOWED: usize = 3;
/// Relative difference of values up to which two ends are the same.
pub(super) const SAME_END_DIFFERENCE: f64 = 2e-2;
/// Largest loss of ℓ, on a part of the data, from a maximum to a start that counts as one of the same maximum.
const SAME_MAXIMUM: f64 = 10.0;
/// Ratio of the sizes of successive larger parts.
const GROWTH: usize = 8;
/// Least ratio of the size of all data to that of a part.
const MIN_RATIO: usize = 4;
/// Tolerance of a search on a larger part, in standard errors.
const ROUGH_TOLERANCE: f64 = 1e-3;
/// Number of rows beyond which the sample takes no more tests.
const ROWS: usize = 100_000;
/// Maximal number of rows of one test in the sample.
const ROWS_OF_A_TEST: usize = 20_000;
/// Number of rows that is enough where values are common to all tests and the rows are of many tests.
const ROWS_OF_MANY: usize = 20_000;
/// Number of tests from which on [`ROWS_OF_MANY`] rows are enough.
const MANY_TESTS: usize = 256;

/// The first rows of every phase of every test, as many tests as fit; `common`: values are common to all tests.
pub(super) fn sample(tests: &[PhasedTest], common: bool) -> Vec<PhasedTest> {
    sample_of(tests, common, 1)
}

/// Parts of the data between the sample and all of it, each larger than the one before, where the sample cuts records
/// short: slow processes show in whole ones. Short tests need no larger part, because the sample has enough of them.
pub(super) fn larger(tests: &[PhasedTest], common: bool) -> impl Iterator<Item = Vec<PhasedTest>> {
    let all = if tests.iter().any(|test| test.row_count() > ROWS_OF_A_TEST) { total_rows(tests) } else { 0 };
    let least = MIN_RATIO * ROWS.min(tests.len().max(1) * ROWS_OF_A_TEST);
    let sizes = std::iter::successors(Some(GROWTH), |size| Some(GROWTH * size));
    let sizes = sizes.take_while(move |size| least * size <= all); // before anything is copied
    sizes.map(move |size| sample_of(tests, common, size)).take_while(move |part| MIN_RATIO * total_rows(part) <= all)
}

/// Settings of a search on a part of the data, with a tolerance of [`ROUGH_TOLERANCE`] or more: the exact end does not
/// matter.
pub(super) fn rough_settings(settings: &Settings) -> Settings {
    let mut rough = settings.clone();
    rough.inner.tolerance = rough.inner.tolerance.max(ROUGH_TOLERANCE);
    rough
}

/// The sample with `size` times as many rows.
fn sample_of(tests: &[PhasedTest], common: bool, size: usize) -> Vec<PhasedTest> {
    let mut order: Vec<&PhasedTest> = tests.iter().collect();
    order.sort_by(|a, b| a.id.cmp(&b.id));
    let first = |evidence: &Evidence| match evidence {
        Evidence::Rows(test) => Evidence::Rows(test.first(ROWS_OF_A_TEST * size)),
        other => other.clone(),
    };
    let mut many = 0;
    let mut sample = Vec::new();
    for test in order {
        let kept = PhasedTest { id: test.id.clone(), phases: test.phases.iter().map(first).collect() };
        many += kept.row_count();
        sample.push(kept);
        if many > ROWS * size || (common && many > ROWS_OF_MANY * size && sample.len() >= MANY_TESTS * size) {
            break;
        }
    }
    sample
}

/// Starts on all of the data: the given values, or the end of a search from the given values on a part of the data if ℓ
/// is no lower at that end; and the best ends of searches from `others` on that part, each with the curvature of ℓ on
/// the part. Where all searches from `others` fail, `others` are returned unchanged.
pub(super) fn promising(
    (objective, small): (&ProfileLikelihood<'_>, &ProfileLikelihood<'_>),
    given: Option<Candidate>,
    others: Vec<Candidate>,
    progress: &mut dyn Progress,
) -> Vec<SearchStart> {
    let mut part = Subsample { small, more: objective.rows() as f64 / small.rows() as f64, best_known: None, progress };
    let (mut kept, mut seen) = (Vec::new(), Vec::new());
    if let Some(given) = given {
        let (start, _, places) = part.refined(objective, given.into());
        kept.push(start);
        seen.extend(places);
    }
    let mut ends: Vec<(f64, SearchStart)> = others.iter().filter_map(|start| part.end(start.clone().into())).collect();
    ends.sort_by(|a, b| b.0.total_cmp(&a.0));
    let Some(&(best, _)) = ends.first() else {
        kept.extend(others.into_iter().map(SearchStart::from));
        return kept;
    };
    let most = kept.len() + MAX_FOLLOWED;
    for (_, start) in ends.into_iter().filter(|(value, _)| best - value <= CLOSE_LOSS) {
        let place = ordered(&small.twins, &start.values);
        if kept.len() < most && !seen.iter().any(|other| alike(other, &place, SAME_END_DIFFERENCE)) {
            kept.push(start);
            seen.push(place);
        }
    }
    kept
}

/// Each start, replaced by the end of a search on a larger part of the data if ℓ of all data is no lower at that end. A
/// start other than the first is dropped if the search ends near an earlier end, or far below in ℓ.
pub(super) fn refined(
    (objective, larger): (&ProfileLikelihood<'_>, &ProfileLikelihood<'_>),
    starts: Vec<SearchStart>,
    progress: &mut dyn Progress,
) -> Vec<SearchStart> {
    let mut part =
        Subsample { small: larger, more: objective.rows() as f64 / larger.rows() as f64, best_known: None, progress };
    let mut kept: Vec<SearchStart> = Vec::new();
    let mut seen: Vec<Vec<f64>> = Vec::new();
    for start in starts {
        if part.progress.stops() {
            kept.push(start);
            break;
        }
        let (start, value, places) = part.refined(objective, start);
        let is_far = value.zip(part.best_known).is_some_and(|(value, best_known)| value < best_known);
        if kept.is_empty() || !(is_far || seen.iter().any(|other| alike(other, &places[0], SAME_END_DIFFERENCE))) {
            kept.push(start);
            seen.extend(places);
        }
        let within = value.map(|value| value - CLOSE_LOSS);
        part.best_known = part.best_known.into_iter().chain(within).reduce(f64::max);
    }
    kept
}

/// A part of the data; all of the data have `more` times as many rows.
struct Subsample<'a, 'b> {
    small: &'a ProfileLikelihood<'b>,
    more: f64,
    /// Best known ℓ on the part; a search that cannot reach this ℓ gives up.
    best_known: Option<f64>,
    progress: &'a mut dyn Progress,
}

impl Subsample<'_, '_> {
    /// ℓ at the end of a search on the part, and that end as a start.
    fn end(&mut self, start: SearchStart) -> Option<(f64, SearchStart)> {
        let mut subsample_progress = SubsampleProgress { small: self.small, progress: &mut *self.progress };
        let start = SearchStart { curvature: start.curvature.map(|all| all.times(self.more.recip())), ..start };
        let end = search(self.small, start, self.best_known, &mut subsample_progress).ok()?;
        let curvature = ProfileInformation::of(&self.small.coordinates, end.level_scale, (&end.joint, &end.iterate))
            .map(|curvature| curvature.times(self.more));
        Some((end.iterate.value(), SearchStart { values: end.restart(), origin: end.origin, curvature }))
    }

    /// The start, or the end of a search from the start if ℓ of all data is no lower at that end; ℓ of the part at that
    /// end; and the points that count as one maximum: the returned start, and the end unless that is another maximum.
    fn refined(
        &mut self,
        objective: &ProfileLikelihood<'_>,
        start: SearchStart,
    ) -> (SearchStart, Option<f64>, Vec<Vec<f64>>) {
        let here = objective.value(&start.values);
        let place = |start: &SearchStart| ordered(&self.small.twins, &start.values);
        let own = place(&start);
        let Some((value, end)) = self.end(start.clone()) else { return (start, None, vec![own]) };
        let led = place(&end);
        if here.is_none_or(|here| objective.value(&end.values).is_some_and(|there| there >= here)) {
            return (end, Some(value), vec![led]);
        }
        let is_close = self.small.value(&start.values).is_some_and(|own| value - own <= SAME_MAXIMUM);
        (start, Some(value), if is_close { vec![led, own] } else { vec![own] })
    }
}

/// Progress of a search on a part of the data, reported as work on start values.
pub(super) struct SubsampleProgress<'a, 'b> {
    pub(super) small: &'a ProfileLikelihood<'b>,
    pub(super) progress: &'a mut dyn Progress,
}

impl Progress for SubsampleProgress<'_, '_> {
    fn stage(&mut self, _: Stage<'_>) {
        self.progress.stage(Stage::StartValues { filter_runs: self.small.filter_passes() });
    }

    fn step(&mut self, _: Step) {
        self.progress.stage(Stage::StartValues { filter_runs: self.small.filter_passes() });
    }

    fn stops(&self) -> bool {
        self.progress.stops()
    }
}

pub(super) fn total_rows(tests: &[PhasedTest]) -> usize {
    tests.iter().map(PhasedTest::row_count).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use kalfit_model::{Source, Test};

    fn record(id: usize, rows: usize) -> PhasedTest {
        let mut test = Test::new(format!("{id:02}"), 1, 0);
        (0..rows).for_each(|row| test.push(&[row as f64], &[], Source::default()));
        PhasedTest { id: test.id.clone(), phases: vec![Evidence::Rows(test)].into() }
    }

    #[test]
    fn larger_parts_grow_and_are_much_shorter_than_all() {
        let long: Vec<PhasedTest> = (0..24).map(|id| record(id, 160_000)).collect();
        let sizes = |tests: &[PhasedTest]| larger(tests, true).map(|part| total_rows(&part)).collect::<Vec<_>>();
        assert_eq!(sizes(&long), [6 * 160_000], "800 000 rows are enough: a quarter of all");
        assert!(sizes(&long[..23]).is_empty(), "no part of a fifth");
        let short: Vec<PhasedTest> = (0..256).map(|id| record(id, 15_000)).collect();
        assert!(sizes(&short).is_empty(), "whole tests are in the sample");
        assert_eq!(total_rows(&sample(&long, true)), 6 * 20_000);
    }
}
