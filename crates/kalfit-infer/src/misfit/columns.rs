//! L⁻¹ times residuals, states, regressors and terms: differences of innovations.

use std::ops::Range;

use kalfit_algebra::symmetric::square_root;
use kalfit_filter::innovations::{Innovation, InnovationFilter, Innovations};
use kalfit_filter::reduce::ReduceError;
use kalfit_model::{Evidence, LevelSlots, PhasedModel, PhasedTest, Population, TestId};
use nalgebra::DMatrix;

use crate::misfit::FittedEnsemble;
use crate::misfit::levels::Unit;
use crate::misfit::terms::Term;

/// Computes, for each unit, the columns [residual, p states, regressors, terms], each multiplied by L⁻¹ of the law within
/// tests.
pub(super) struct Columns<'a> {
    model: &'a PhasedModel,
    terms: &'a [Term],
    base: InnovationFilter,
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
    /// Where each row stands.
    pub(super) places: Vec<Innovation>,
    /// One row for each innovation.
    pub(super) values: DMatrix<f64>,
}

impl<'a> Columns<'a> {
    /// Residuals alone, without states, regressors and terms.
    pub(super) fn residuals_alone(model: &'a PhasedModel, of: &FittedEnsemble<'_>) -> Result<Columns<'a>, ReduceError> {
        let within = within_tests(of.population, model.dimension());
        let base = InnovationFilter::new(model, of.alpha, &within)?;
        let basis = DMatrix::zeros(0, 0);
        Ok(Columns { model, terms: &[], base, moved: Vec::new(), states: 0, roots: Vec::new(), basis })
    }

    /// All columns.
    pub(super) fn new(
        model: &'a PhasedModel,
        of: &FittedEnsemble<'_>,
        terms: &'a [Term],
    ) -> Result<Columns<'a>, ReduceError> {
        let p = model.dimension();
        let within = within_tests(of.population, p);
        let deviations = of.population.together(p, &model.slots()).covariance.diagonal().map(f64::sqrt);
        let filter = |population: &Population| InnovationFilter::new(model, of.alpha, population);
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
        Ok(Columns {
            model,
            terms,
            base: filter(&within)?,
            moved,
            states: p,
            roots: (1..levels).map(root).collect(),
            basis: basis(model),
        })
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

    /// The columns of some units; a test whose innovations cannot all be had is left out.
    pub(super) fn of_units(&self, units: &[Unit], tests: &[PhasedTest]) -> Vec<UnitColumns> {
        let chosen: Vec<PhasedTest> =
            units.iter().flat_map(|unit| unit.tests.iter().map(|&test| tests[test].clone())).collect();
        let base = series(&self.base, &chosen);
        let mut columns: Vec<Vec<Option<Vec<f64>>>> = Vec::with_capacity(self.passes());
        columns.push(base.iter().map(|one| one.as_ref().map(standardised)).collect());
        for (filter, step) in &self.moved {
            columns.push(differences(&base, &series(filter, &chosen), -*step));
        }
        for term in self.terms {
            for column in 0..term.width() {
                let size = self.size_of(term, &base);
                let other: Vec<PhasedTest> = chosen.iter().map(|test| self.with(term, column, size, test)).collect();
                columns.push(differences(&base, &series(&self.base, &other), size));
            }
        }
        let mut at = 0..0;
        let units = units.iter().map(|unit| {
            at = at.end..at.end + unit.tests.len();
            unit_columns((unit, tests), at.clone(), &base, &columns)
        });
        units.collect()
    }

    /// A change of the measurement that the innovations show: their size.
    fn size_of(&self, term: &Term, base: &[Option<Innovations>]) -> f64 {
        let own = |one: &&Innovation| (one.phase, one.measurement) == (term.phase, term.measurement);
        let all = base.iter().flatten().flat_map(|test| test.series.iter().filter(own));
        let (count, sum) = all.fold((0.0, 0.0), |(count, sum), one| (count + 1.0, sum + one.variance));
        if count > 0.0 { (sum / count).sqrt() } else { 1.0 }
    }

    /// A test with `size` times a column of a term added to the measurement of the term.
    fn with(&self, term: &Term, column: usize, size: f64, test: &PhasedTest) -> PhasedTest {
        let mut test = test.clone();
        let measured = self.model.phases[term.phase].model.measurements[term.measurement].column;
        let Some(Evidence::Rows(rows)) = test.phases.get_mut(term.phase) else { return test };
        for row in 0..rows.rows() {
            let change = term.value(column, row, rows);
            if change != 0.0 {
                let value = rows.numbers(row)[measured] + size * change;
                rows.set_number(row, measured, value);
            }
        }
        test
    }
}

impl UnitColumns {
    /// r of the unit's tests, multiplied by L⁻¹.
    pub(super) fn residuals(&self) -> Vec<f64> {
        self.values.column(0).iter().copied().collect()
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
fn within_tests(population: &Population, p: usize) -> Population {
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

fn series(filter: &InnovationFilter, tests: &[PhasedTest]) -> Vec<Option<Innovations>> {
    filter.run(tests).into_iter().map(|found| found.ok().flatten()).collect()
}

fn standardised(one: &Innovations) -> Vec<f64> {
    one.series.iter().map(|one| one.standardised).collect()
}

/// (other - base) / step for each test; `None` where they are not alike.
fn differences(base: &[Option<Innovations>], other: &[Option<Innovations>], step: f64) -> Vec<Option<Vec<f64>>> {
    let each = base.iter().zip(other).map(|(base, other)| {
        let (base, other) = (base.as_ref()?, other.as_ref()?);
        let pairs = other.series.iter().zip(&base.series);
        (base.series.len() == other.series.len())
            .then(|| pairs.map(|(other, base)| (other.standardised - base.standardised) / step).collect())
    });
    each.collect()
}

fn unit_columns(
    (unit, all): (&Unit, &[PhasedTest]),
    at: Range<usize>,
    base: &[Option<Innovations>],
    columns: &[Vec<Option<Vec<f64>>>],
) -> UnitColumns {
    let (mut tests, mut places) = (Vec::new(), Vec::new());
    let mut rows: Vec<(usize, usize)> = Vec::new();
    for (&test, number) in unit.tests.iter().zip(at) {
        let is_whole = |column: &Vec<Option<Vec<f64>>>| {
            column[number].as_ref().is_some_and(|values| values.iter().all(|x| x.is_finite()))
        };
        let Some(own) = base[number].as_ref().filter(|_| columns.iter().all(is_whole)) else { continue };
        tests.push((all[test].id.clone(), places.len()..places.len() + own.series.len()));
        rows.extend((0..own.series.len()).map(|row| (number, row)));
        places.extend_from_slice(&own.series);
    }
    let value = |row: usize, column: usize| {
        let (number, row) = rows[row];
        columns[column][number].as_ref().map_or(0.0, |values| values[row])
    };
    UnitColumns { tests, values: DMatrix::from_fn(rows.len(), columns.len(), value), places }
}
