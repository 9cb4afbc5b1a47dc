//! L⁻¹ times residuals, states, regressors and terms: differences of innovations.

use std::ops::Range;

use kalfit_algebra::symmetric::square_root;
use kalfit_filter::innovations::{Change, Innovation, InnovationFilter};
use kalfit_filter::reduce::ReduceError;
use kalfit_model::{Evidence, LevelSlots, PhasedModel, PhasedTest, Population, TestId};
use nalgebra::DMatrix;

use crate::misfit::FittedEnsemble;
use crate::misfit::levels::Unit;
use crate::misfit::terms::Term;

/// Computes, for each unit, the columns [residual, p states, regressors, terms], each multiplied by L⁻¹ of the law within
/// tests.
pub(super) struct Columns<'a> {
    terms: &'a [Term],
    base: &'a InnovationFilter,
    /// Filters with one element of the mean or one coefficient moved, and by how much.
    moved: Vec<(InnovationFilter, f64)>,
    states: usize,
    /// Roots of the covariances of the levels, the innermost first.
    roots: Vec<DMatrix<f64>>,
    /// Basis of the free means, p × q.
    basis: DMatrix<f64>,
}

/// Columns of the tests of a unit.
pub(super) struct UnitColumns {
    /// Id and rows of each test.
    pub(super) tests: Vec<(TestId, Range<usize>)>,
    /// Where each row stands; empty where it was not asked for.
    pub(super) places: Vec<Innovation>,
    /// One row for each innovation.
    pub(super) values: DMatrix<f64>,
}

impl<'a> Columns<'a> {
    /// Residuals alone, without states, regressors and terms. `base`: the filter under the law within tests.
    pub(super) fn residuals_alone(base: &'a InnovationFilter) -> Columns<'a> {
        let basis = DMatrix::zeros(0, 0);
        Columns { terms: &[], base, moved: Vec::new(), states: 0, roots: Vec::new(), basis }
    }

    /// All columns. `base`: the filter under the law within tests.
    pub(super) fn new(
        (model, base): (&PhasedModel, &'a InnovationFilter),
        of: &FittedEnsemble<'_>,
        terms: &'a [Term],
    ) -> Result<Columns<'a>, ReduceError> {
        let p = model.dimension();
        let within = within_tests(of.population, p);
        let deviations = of.population.together(p, &model.slots()).covariance.diagonal().map(f64::sqrt);
        let filter = |population: &Population| base.at(model, population);
        let mut moved = Vec::new();
        for i in 0..p {
            let step = [deviations[i], within.mean[i].abs(), 1.0].into_iter().find(|x| *x > 0.0).unwrap_or(1.0);
            let mut mean = within.clone();
            mean.mean[i] += step;
            moved.push((filter(&mean)?, step));
        }
        for (k, coefficient) in within.coefficients.iter().enumerate() {
            let step = if *coefficient == 0.0 { 1.0 } else { coefficient.abs() };
            let mut other = within.clone();
            other.coefficients[k] += step;
            moved.push((filter(&other)?, step));
        }
        let levels = of.population.mean.len().checked_div(p).unwrap_or(1);
        let root = |level: usize| square_root(&of.population.covariance.view((level * p, level * p), (p, p)).into());
        Ok(Columns { terms, base, moved, states: p, roots: (1..levels).map(root).collect(), basis: basis(model) })
    }

    /// Number of passes of the filter over a test.
    pub(super) fn passes(&self) -> usize {
        1 + self.moved.len() + self.terms.iter().map(Term::width).sum::<usize>()
    }

    /// Columns of the states, p.
    pub(super) fn states(&self) -> Range<usize> {
        1..1 + self.states
    }

    /// Columns of the regressors.
    pub(super) fn regressors(&self) -> Range<usize> {
        1 + self.states..1 + self.moved.len()
    }

    /// Roots of the covariances of the levels, the innermost first.
    pub(super) fn roots(&self) -> &[DMatrix<f64>] {
        &self.roots
    }

    /// Basis of the free means, p × q.
    pub(super) fn basis(&self) -> &DMatrix<f64> {
        &self.basis
    }

    /// The columns of some units, with the places of rows; a test whose innovations cannot all be had is left out.
    pub(super) fn of_units(&self, units: &[Unit], tests: &[PhasedTest]) -> Vec<UnitColumns> {
        let chosen = chosen(units, tests);
        let base = existing(self.base.series(&chosen));
        let standardised = |series: &Vec<Innovation>| series.iter().map(|one| one.standardised).collect();
        let mut columns = self.of_means(base.iter().map(|one| one.as_ref().map(standardised)).collect(), &chosen);
        let sizes: Vec<f64> = self.terms.iter().map(|term| self.size_of(term, &base)).collect();
        let terms = self.terms.iter().zip(sizes);
        let of_terms: Vec<(&'a Term, usize, f64)> =
            terms.flat_map(|(term, size)| (0..term.width()).map(move |column| (term, column, size))).collect();
        if let [only] = &chosen[..] {
            let change = |&(term, column, size): &(&'a Term, usize, f64)| self.change(term, column, size, only);
            let changes: Vec<Change<'_>> = of_terms.iter().map(change).collect();
            for (other, (.., size)) in self.base.changed(only, &changes).into_iter().zip(&of_terms) {
                columns.push(differences(&columns[0], vec![other], *size));
            }
        } else {
            for (term, column, size) in of_terms {
                let copy = |test: &PhasedTest| self.base.copy(test, &self.change(term, column, size, test));
                let copies: Vec<PhasedTest> = chosen.iter().map(copy).collect();
                columns.push(differences(&columns[0], existing(self.base.standardised(&copies)), size));
            }
        }
        unit_columns((units, tests), columns, base)
    }

    /// The columns of some units but those of terms, without the places of rows.
    pub(super) fn without_terms(&self, units: &[Unit], tests: &[PhasedTest]) -> Vec<UnitColumns> {
        let chosen = chosen(units, tests);
        let columns = self.of_means(existing(self.base.standardised(&chosen)), &chosen);
        unit_columns((units, tests), columns, chosen.iter().map(|_| None).collect())
    }

    /// The columns of residuals, states and regressors of some tests.
    fn of_means(&self, residuals: Column, tests: &[PhasedTest]) -> Vec<Column> {
        let mut columns = Vec::with_capacity(self.passes());
        columns.push(residuals);
        for (filter, step) in &self.moved {
            columns.push(differences(&columns[0], existing(filter.standardised(tests)), -*step));
        }
        columns
    }

    /// A change of the measurement that the innovations show: their size.
    fn size_of(&self, term: &Term, base: &[Option<Vec<Innovation>>]) -> f64 {
        let own = |one: &&Innovation| (one.phase, one.measurement) == (term.phase, term.measurement);
        let all = base.iter().flatten().flat_map(|series| series.iter().filter(own));
        let (count, sum) = all.fold((0.0, 0.0), |(count, sum), one| (count + 1.0, sum + one.variance));
        if count > 0.0 { (sum / count).sqrt() } else { 1.0 }
    }

    /// The change of a test by `size` times a column of a term, added to the measurement of the term.
    fn change<'t>(&self, term: &'t Term, column: usize, size: f64, test: &'t PhasedTest) -> Change<'t> {
        let rows = test.phases.get(term.phase).and_then(Evidence::cells);
        let value = move |row: usize, value: f64| {
            let change = rows.map_or(0.0, |rows| term.value(column, row, rows));
            if change == 0.0 { value } else { value + size * change }
        };
        Change { phase: term.phase, measurement: term.measurement, value: Box::new(value) }
    }
}

impl UnitColumns {
    /// r of the unit's tests, multiplied by L⁻¹.
    pub(super) fn residuals(&self) -> impl Iterator<Item = f64> {
        self.values.column(0).into_iter().copied()
    }

    /// Number of innovations of each test, and the sum of their squares.
    pub(super) fn squares(&self) -> impl Iterator<Item = (TestId, usize, f64)> {
        let of = |(id, rows): &(TestId, Range<usize>)| {
            (id.clone(), rows.len(), self.values.view_range(rows.clone(), 0..1).norm_squared())
        };
        self.tests.iter().map(of)
    }
}

/// The law of a test given the effects of its groups, at the mean over all groups.
pub(super) fn within_tests(population: &Population, p: usize) -> Population {
    let covariance = population.covariance.view((0, 0), (p, p)).into();
    Population { covariance, ..population.together(p, &LevelSlots::default()) }
}

/// Basis of the free means of all phases.
fn basis(model: &PhasedModel) -> DMatrix<f64> {
    let parts: Vec<DMatrix<f64>> = model.phases.iter().map(|phase| phase.model.mean.basis().1).collect();
    let (rows, columns) = parts.iter().fold((0, 0), |(r, c), part| (r + part.nrows(), c + part.ncols()));
    let mut all = DMatrix::zeros(rows, columns);
    let mut at = (0, 0);
    for part in parts {
        all.view_mut(at, part.shape()).copy_from(&part);
        at = (at.0 + part.nrows(), at.1 + part.ncols());
    }
    all
}

/// The values of a column in each test; `None` where the test has no innovations.
type Column = Vec<Option<Vec<f64>>>;

/// The tests of some units.
fn chosen(units: &[Unit], tests: &[PhasedTest]) -> Vec<PhasedTest> {
    units.iter().flat_map(|unit| unit.tests.iter().map(|&test| tests[test].clone())).collect()
}

/// Innovations of tests, as far as they can be had.
fn existing<T>(found: Vec<Result<Option<T>, ReduceError>>) -> Vec<Option<T>> {
    found.into_iter().map(|found| found.ok().flatten()).collect()
}

/// (other - base) / step for each test; `None` where they are not alike.
fn differences(base: &Column, other: Column, step: f64) -> Column {
    let each = base.iter().zip(other).map(|(base, other)| {
        let (base, mut other) = (base.as_ref()?, other?);
        other.iter_mut().zip(base).for_each(|(other, base)| *other = (*other - base) / step);
        (base.len() == other.len()).then_some(other)
    });
    each.collect()
}

/// The columns of units, whose tests stand one after the other in `columns` and `places`.
fn unit_columns(
    (units, tests): (&[Unit], &[PhasedTest]),
    mut columns: Vec<Column>,
    mut places: Vec<Option<Vec<Innovation>>>,
) -> Vec<UnitColumns> {
    let mut at = 0..0;
    let units = units.iter().map(|unit| {
        at = at.end..at.end + unit.tests.len();
        of_unit((unit, tests), at.clone(), &mut columns, &mut places)
    });
    units.collect()
}

/// The columns of a unit, which are taken out of those of all.
fn of_unit(
    (unit, all): (&Unit, &[PhasedTest]),
    at: Range<usize>,
    columns: &mut [Column],
    places: &mut [Option<Vec<Innovation>>],
) -> UnitColumns {
    let (mut tests, mut numbers, mut rows, mut own_places) = (Vec::new(), Vec::new(), 0, Vec::new());
    for (&test, number) in unit.tests.iter().zip(at) {
        let is_whole =
            |column: &Column| column[number].as_ref().is_some_and(|values| values.iter().all(|x| x.is_finite()));
        let Some(own) = columns[0][number].as_ref().filter(|_| columns.iter().all(is_whole)) else { continue };
        tests.push((all[test].id.clone(), rows..rows + own.len()));
        rows += own.len();
        numbers.push(number);
        match places[number].take() {
            Some(places) if own_places.is_empty() => own_places = places,
            places => own_places.extend(places.into_iter().flatten()),
        }
    }
    let mut values = Vec::with_capacity(rows * columns.len());
    for column in columns.iter_mut() {
        numbers.iter().for_each(|&number| values.extend(column[number].take().into_iter().flatten()));
    }
    UnitColumns { tests, values: DMatrix::from_vec(rows, columns.len(), values), places: own_places }
}
