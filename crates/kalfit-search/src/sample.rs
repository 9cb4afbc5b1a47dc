//! A part of the data, on which searches are cheap, and where the best of them end.

use crate::Settings;
use crate::coordinates::alike;
use crate::profile_likelihood::ProfileLikelihood;
use crate::quadratic::ProfileInformation;
use crate::search::search;
use crate::search_state::SearchStart;
use crate::twins::ordered;
use kalfit_estimate::{Progress, Stage, Step};
use kalfit_model::{Evidence, PhasedTest};

/// Ends on a part of the data whose ℓ is this close to the best one's are followed on all of it.
pub(super) const CLOSE: f64 = 5.0;
/// … so many of them, none but those that differ by more than this part.
pub(super) const FOLLOWED: usize = 3;
pub(super) const ALIKE: f64 = 2e-2;
/// A place leads to the same maximum on a part as on all data where it is no further below than this.
const SAME: f64 = 10.0;
/// Larger parts are so many times as long each, and no longer than this part of all.
const GROWS: usize = 8;
const SHORTER: usize = 4;
/// … and a search on them ends this near to where it leads, in standard errors.
const ROUGH: f64 = 1e-3;
/// Rows of the part, and rows of one test in it.
const ROWS: usize = 100_000;
const ROWS_OF_A_TEST: usize = 20_000;
/// Where values are common to all tests, these rows are enough if they are of so many tests.
const ROWS_OF_MANY: usize = 20_000;
const MANY: usize = 256;

/// The first rows of every phase of every test, as many tests as fit; `common`: values are common to all tests.
pub(super) fn sample(tests: &[PhasedTest], common: bool) -> Vec<PhasedTest> {
    sample_of(tests, common, 1)
}

/// Parts of the data between the sample and all of it, each larger than the one before, where the sample breaks records off: what is
/// slow shows in whole ones. Of short tests it holds enough.
pub(super) fn larger(tests: &[PhasedTest], common: bool) -> impl Iterator<Item = Vec<PhasedTest>> {
    let all = if tests.iter().any(|test| test.row_count() > ROWS_OF_A_TEST) { total(tests) } else { 0 };
    let least = SHORTER * ROWS.min(tests.len().max(1) * ROWS_OF_A_TEST);
    let sizes = std::iter::successors(Some(GROWS), |size| Some(GROWS * size));
    let sizes = sizes.take_while(move |size| least * size <= all); // before anything is copied
    sizes.map(move |size| sample_of(tests, common, size)).take_while(move |part| SHORTER * total(part) <= all)
}

/// Settings of a search on such a part: where it ends exactly does not matter.
pub(super) fn roughly(settings: &Settings) -> Settings {
    let mut rough = settings.clone();
    rough.inner.tolerance = rough.inner.tolerance.max(ROUGH);
    rough
}

/// So many times as many rows.
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
        if many > ROWS * size || (common && many > ROWS_OF_MANY * size && sample.len() >= MANY * size) {
            break;
        }
    }
    sample
}

/// Starts on all of the data: the values that were given, or where they lead on a part of it if ℓ is higher there, and where the best
/// of many others end on that part. Each with how ℓ curves about it, as far as the part tells. The others as they are when they all
/// fail there.
pub(super) fn promising(
    (objective, small): (&ProfileLikelihood<'_>, &ProfileLikelihood<'_>),
    given: Option<Vec<f64>>,
    others: Vec<Vec<f64>>,
    progress: &mut dyn Progress,
) -> Vec<SearchStart> {
    let mut part = Subsample { small, more: objective.rows() as f64 / small.rows() as f64, floor: None, progress };
    let (mut kept, mut seen) = (Vec::new(), Vec::new());
    if let Some(given) = given {
        let (start, _, places) = part.nearer(objective, given.into());
        kept.push(start);
        seen.extend(places);
    }
    let mut ends: Vec<(f64, SearchStart)> = others.iter().filter_map(|start| part.end(start.clone().into())).collect();
    ends.sort_by(|a, b| b.0.total_cmp(&a.0));
    let Some(&(best, _)) = ends.first() else {
        kept.extend(others.into_iter().map(SearchStart::from));
        return kept;
    };
    let most = kept.len() + FOLLOWED;
    for (_, start) in ends.into_iter().filter(|(value, _)| best - value <= CLOSE) {
        let place = ordered(&small.twins, &start.values);
        if kept.len() < most && !seen.iter().any(|other| alike(other, &place, ALIKE)) {
            kept.push(start);
            seen.push(place);
        }
    }
    kept
}

/// The same starts where they lead on a larger part of the data, if ℓ of all data is no lower there. The first one stays; of the
/// others those that end near another do not, nor those that end far below.
pub(super) fn nearer(
    (objective, larger): (&ProfileLikelihood<'_>, &ProfileLikelihood<'_>),
    starts: Vec<SearchStart>,
    progress: &mut dyn Progress,
) -> Vec<SearchStart> {
    let mut part =
        Subsample { small: larger, more: objective.rows() as f64 / larger.rows() as f64, floor: None, progress };
    let mut kept: Vec<SearchStart> = Vec::new();
    let mut seen: Vec<Vec<f64>> = Vec::new();
    for start in starts {
        if part.progress.stops() {
            kept.push(start);
            break;
        }
        let (start, value, places) = part.nearer(objective, start);
        let is_far = value.zip(part.floor).is_some_and(|(value, floor)| value < floor);
        if kept.is_empty() || !(is_far || seen.iter().any(|other| alike(other, &places[0], ALIKE))) {
            kept.push(start);
            seen.extend(places);
        }
        let within = value.map(|value| value - CLOSE);
        part.floor = part.floor.into_iter().chain(within).reduce(f64::max);
    }
    kept
}

/// A part of the data, of which all are `more` times as many.
struct Subsample<'a, 'b> {
    small: &'a ProfileLikelihood<'b>,
    more: f64,
    /// Searches that cannot come so high give up.
    floor: Option<f64>,
    progress: &'a mut dyn Progress,
}

impl Subsample<'_, '_> {
    /// Where a search ends, and ℓ there.
    fn end(&mut self, start: SearchStart) -> Option<(f64, SearchStart)> {
        let mut beside = SubsampleProgress { small: self.small, progress: &mut *self.progress };
        let start = SearchStart { curvature: start.curvature.map(|all| all.times(self.more.recip())), ..start };
        let end = search(self.small, start, self.floor, &mut beside).ok()?;
        let curvature = ProfileInformation::of(&self.small.coordinates, end.level_scale, (&end.joint, &end.home))
            .map(|curvature| curvature.times(self.more));
        Some((end.home.value(), SearchStart { values: end.restart(), curvature }))
    }

    /// A start, or where it leads if ℓ of all data is no lower there; ℓ of the part where it leads. The last are places that are the
    /// same: the start, and where it leads if that is no other maximum.
    fn nearer(
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
        let is_close = self.small.value(&start.values).is_some_and(|own| value - own <= SAME);
        (start, Some(value), if is_close { vec![led, own] } else { vec![own] })
    }
}

/// Listens to a search on a part of the data: it is about start values still.
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

pub(super) fn total(tests: &[PhasedTest]) -> usize {
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
        let sizes = |tests: &[PhasedTest]| larger(tests, true).map(|part| total(&part)).collect::<Vec<_>>();
        assert_eq!(sizes(&long), [6 * 160_000], "800 000 rows are enough: a quarter of all");
        assert!(sizes(&long[..23]).is_empty(), "no part of a fifth");
        let short: Vec<PhasedTest> = (0..256).map(|id| record(id, 15_000)).collect();
        assert!(sizes(&short).is_empty(), "whole tests are in the sample");
        assert_eq!(total(&sample(&long, true)), 6 * 20_000);
    }
}
