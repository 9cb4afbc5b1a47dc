//! Misfit that tests have in common.
//!
//! Each test may look well by itself while all tests deviate from the model in the same way: a sensor that saturates, a
//! response that bends, a drift of the bench. Under the model the measurements of all tests are y ~ N(Xβ, V), with V
//! from processes, noises, Σ and the levels of groups. A mean term Dγ that the model lacks is tested by its score at
//! γ = 0, with the mean coordinates β eliminated:
//!
//! ```text
//! s = D'V⁻¹r,   I = D'V⁻¹D - D'V⁻¹X (X'V⁻¹X)⁻ X'V⁻¹D,   T = s'I⁻s ~ χ²_k,   k = rank of I
//! F = (T/k) / ((r'V⁻¹r - T)/(n - q - k)) ~ F(k, n - q - k),   q = rank of X
//! ```
//!
//! F allows for noise levels that were estimated from the same data: a common misfit makes them large. Columns of L⁻¹,
//! V = LL', come from the filter itself: its standardised innovations are linear in the measurements, so that the
//! innovations of y + D less those of y are L⁻¹D.

mod columns;
mod levels;
mod normality;
mod probe;
mod score;
mod shared;
mod steps;
mod terms;
mod unlike;
mod wrong_rows;

pub use normality::Normality;
pub use terms::TermKind;
pub use unlike::UnlikeTest;
pub use wrong_rows::WrongRow;

use kalfit_filter::innovations::InnovationFilter;
use kalfit_filter::reduce::ReduceError;
use kalfit_model::{Alpha, Grouping, PhasedModel, PhasedTest, Population, TestId};

use columns::{Columns, within_tests};
use levels::Unit;
use score::Score;
use shared::SharedSteps;
use steps::StepMeans;
use terms::{Term, candidates};
use wrong_rows::LargeInnovations;

/// Most rows that the filter passes, over all terms: enough to find a tenth of a standard deviation in every term, and a
/// few tenths of a second. Of larger ensembles units are taken at equal distances in the order of the data.
const MAX_ROW_PASSES: usize = 4_000_000;
/// Number of states above which a row counts as several, as the work on it grows with the cube of this number: with 500
/// states, nine passes over three tests of twenty rows took 140 s.
const FEW_STATES: usize = 10;
/// Rows that the filter takes together.
const ROWS_OF_A_BATCH: usize = 1 << 14;

/// Why no misfit was looked for.
#[derive(Debug, thiserror::Error)]
pub enum NoMisfit {
    /// The model has no innovations at this estimate, for the reasons of [`InnovationFilter::new`].
    #[error(transparent)]
    Filter(#[from] ReduceError),
    /// Groups of tests cross.
    #[error("with crossed factors no test is independent of the others")]
    Crossed,
    /// With so many states, even the unit with fewest rows takes more work than all units may.
    #[error("its terms take {passes} passes of a filter with {states} states over the data, which is too much work")]
    Work {
        /// Number of states of the phase with most.
        states: usize,
        /// Number of passes.
        passes: usize,
    },
}

/// Where a check of an ensemble is made.
#[derive(Debug, Clone, Copy)]
pub struct FittedEnsemble<'a> {
    /// The model.
    pub model: &'a PhasedModel,
    /// α of the fit.
    pub alpha: &'a Alpha,
    /// μ and Σ of the tests and of the levels of groups.
    pub population: &'a Population,
    /// All tests.
    pub tests: &'a [PhasedTest],
    /// The groups of the tests; `None` without levels.
    pub grouping: Option<&'a Grouping>,
}

/// What the tests have in common that the model does not describe.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Misfit {
    /// Number of tests that were looked at.
    pub tests: usize,
    /// Number n of standardised innovations of these tests under the law of the whole model, levels included.
    pub count: usize,
    /// r'V⁻¹r; χ²_n when the model is right.
    pub nis: f64,
    /// Score tests of mean terms.
    pub terms: Vec<TermTest>,
    /// Whether the innovations are normal; `None` for fewer than 20.
    pub normality: Option<Normality>,
    /// Distance of each test from the other tests of its groups; empty without levels.
    pub unlike: Vec<UnlikeTest>,
    /// Number of different comparisons in `unlike`: two tests of a unit differ from each other by one and the same amount.
    pub comparisons: usize,
    /// Measurements that contradict the others of their test: at most one of each test that has a large innovation.
    pub wrong_rows: Vec<WrongRow>,
    /// Number of innovations of each test and their square sum under the law of the whole model; empty without levels.
    pub by_test: Vec<(TestId, usize, f64)>,
}

/// The test of one mean term.
#[derive(Debug, Clone, PartialEq)]
pub struct TermTest {
    /// Index of the phase.
    pub phase: usize,
    /// Index of the measurement in the model of the phase.
    pub measurement: usize,
    /// Which term.
    pub kind: TermKind,
    /// F; for [`TermKind::Shared`] the mean of n c² over pairs of tests, 1 for independent tests.
    pub statistic: f64,
    /// k, and n - q - k; for [`TermKind::Shared`] the number of pairs and their largest n.
    pub degrees_of_freedom: [usize; 2],
    /// Probability of a statistic as large as this.
    pub p_value: f64,
    /// The part of the term that deviates most.
    pub largest: Option<Deviation>,
}

/// The deviation of one part of a term.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Deviation {
    /// Where: least and largest value of the input, step or time; equal for a single value.
    pub at: [f64; 2],
    /// The deviation, in the unit of the measurement, for a term of kind [`TermKind::Steps`] in standard deviations.
    pub value: f64,
    /// Its standard deviation if the model is right.
    pub std_dev: f64,
}

/// Looks for misfit that tests have in common. Tests whose innovations do not exist, such as tests given by estimates or
/// reductions, are left out.
///
/// # Errors
/// Why it was not looked for.
pub fn misfit(of: &FittedEnsemble<'_>, go_on: &mut dyn FnMut(f64) -> bool) -> Result<Misfit, NoMisfit> {
    if of.grouping.is_some_and(Grouping::is_crossed) {
        return Err(NoMisfit::Crossed);
    }
    let (model, tests) = probe::probed(of.model, of.tests);
    let units = levels::units(&tests, of.grouping);
    let terms = candidates(&model, of.model, &tests);
    // the law of tests moves no covariance: all filters share the gains of designs
    let base = InnovationFilter::new(&model, of.alpha, &within_tests(of.population, model.dimension()))?;
    let columns = Columns::new((&model, &base), of, &terms)?;
    let (states, passes) = (most_states(&model), columns.passes());
    let least = units.iter().map(|unit| unit.rows(&tests)).min().unwrap_or(0);
    if has_too_many_states(states, least * passes) {
        return Err(NoMisfit::Work { states, passes });
    }
    let mut found = Misfit::default();
    let Some(large) = whole(of, (&model, &base), (&tests, &units), &mut found, &mut |share| go_on(0.5 * share))? else {
        return Ok(Misfit::default());
    };
    let units = chosen(units, &tests, (passes, row_passes(states)));
    let (mut score, mut steps) = (Score::new(&columns, &terms), StepMeans::new(&columns));
    let mut shared = SharedSteps::default();
    let all = units.len().max(1) as f64;
    for (done, batch) in batches(&units, &tests) {
        if !go_on(0.5 + 0.5 * done as f64 / all) {
            return Ok(Misfit::default());
        }
        for mut unit in columns.of_units(batch, &tests) {
            found.tests += unit.tests.len();
            levels::whiten(&mut unit, of.grouping, columns.roots(), columns.states());
            let whitened = score.of_means(&unit);
            score.add(&unit, &whitened);
            steps.add(&unit, &whitened);
            shared.add(&unit, &whitened);
        }
    }
    found.terms = score.tests(&terms);
    found.terms.extend(steps.tests(&score));
    found.terms.extend(shared.tests());
    let together = of.population.together(model.dimension(), &model.slots());
    let filter = base.at(&model, &together)?;
    let left = found.count.saturating_sub(columns.basis().ncols() + columns.regressors().len());
    found.wrong_rows = large.wrong(&filter, (&model, &tests), (found.nis, left));
    Ok(found)
}

/// Looks at every test without terms: the size and the law of innovations, tests unlike those of their groups, and large
/// innovations; `None` when the check is not to go on.
fn whole(
    of: &FittedEnsemble<'_>,
    (model, base): (&PhasedModel, &InnovationFilter),
    (tests, units): (&[PhasedTest], &[Unit]),
    found: &mut Misfit,
    go_on: &mut dyn FnMut(f64) -> bool,
) -> Result<Option<LargeInnovations>, ReduceError> {
    let columns = match of.grouping {
        Some(_) => Columns::new((model, base), of, &[])?,
        None => Columns::residuals_alone(base),
    };
    let rows = tests.iter().map(PhasedTest::row_count).sum();
    let (mut large, mut values) = (LargeInnovations::default(), Vec::with_capacity(rows));
    let all = units.len().max(1) as f64;
    for (done, batch) in batches(units, tests) {
        if !go_on(done as f64 / all) {
            return Ok(None);
        }
        for mut unit in columns.without_terms(batch, tests) {
            if let Some(grouping) = of.grouping {
                let distances = unlike::distances(&unit, grouping, columns.roots(), columns.states());
                found.comparisons += if unit.tests.len() == 2 { distances.len().min(1) } else { distances.len() };
                found.unlike.extend(distances);
                levels::whiten(&mut unit, of.grouping, columns.roots(), columns.states());
                found.by_test.extend(unit.squares());
            }
            large.add(&unit);
            values.extend(unit.residuals());
        }
    }
    (found.count, found.nis) = (values.len(), values.iter().map(|value| value * value).sum());
    found.normality = Normality::of(&values);
    Ok(Some(large))
}

/// Whether so many rows are too many for a filter of so many states. With few states a long record is looked at however
/// long it is: that takes some ten passes, and the search takes hundreds.
fn has_too_many_states(states: usize, rows: usize) -> bool {
    states > FEW_STATES && rows > row_passes(states)
}

/// Most rows that a filter of so many states passes, at least 1.
fn row_passes(states: usize) -> usize {
    let cube = |n: usize| n.saturating_pow(3);
    (MAX_ROW_PASSES.saturating_mul(cube(FEW_STATES)) / cube(states.max(FEW_STATES))).max(1)
}

/// Number of states of the phase with most.
fn most_states(model: &PhasedModel) -> usize {
    model.phases.iter().map(|phase| phase.model.states.len()).max().unwrap_or(0)
}

/// The units to look at.
fn chosen(units: Vec<Unit>, tests: &[PhasedTest], (passes, most): (usize, usize)) -> Vec<Unit> {
    let rows: usize = units.iter().map(|unit| unit.rows(tests)).sum();
    let every = (rows * passes).div_ceil(most).max(1);
    units.into_iter().step_by(every).collect()
}

/// (number of units before, units) of each batch.
fn batches<'u>(units: &'u [Unit], tests: &[PhasedTest]) -> Vec<(usize, &'u [Unit])> {
    let (mut all, mut from, mut rows) = (Vec::new(), 0, 0);
    for (k, unit) in units.iter().enumerate() {
        rows += unit.rows(tests);
        if rows >= ROWS_OF_A_BATCH || k + 1 == units.len() {
            all.push((from, &units[from..=k]));
            (from, rows) = (k + 1, 0);
        }
    }
    all
}

/// Terms by measurement, without the borrowed parts.
impl Term {
    fn tested(&self, statistic: score::FTest, largest: Option<Deviation>) -> TermTest {
        TermTest {
            phase: self.phase,
            measurement: self.measurement,
            kind: self.kind,
            statistic: statistic.value,
            degrees_of_freedom: statistic.degrees_of_freedom,
            p_value: statistic.p_value(),
            largest,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_records_of_few_states_are_looked_at_and_hundreds_of_states_are_not() {
        assert!(!has_too_many_states(1, 100_000_000), "a record of 10^7 rows, ten passes");
        assert!(!has_too_many_states(18, 40_000), "1 000 rows, forty passes");
        assert!(has_too_many_states(500, 180), "20 rows, nine passes");
        assert_eq!((row_passes(3), row_passes(20), row_passes(10_000)), (MAX_ROW_PASSES, MAX_ROW_PASSES / 8, 1));
    }
}
