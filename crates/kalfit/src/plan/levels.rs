//! Expected standard errors of tests in groups: more units, or more runs of each?

use std::sync::Arc;

use crate::ensemble::{Grouping, Label};
use crate::estimate::Structure;
use crate::model::Population;
use crate::plan::{Expected, Plan, PlanError, Planned, Quantity, Reason, quantities};
use crate::reduce::{Reduction, Reductions};

/// More tests than this are not arranged.
const MOST_TESTS: usize = 200_000;

/// So many groups in each group, and so many tests in each of the innermost ones.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Arrangement {
    /// By level, the outermost first: groups of the level in each group of the one above.
    pub groups: Vec<usize>,
    /// Tests in each group of the innermost level.
    pub tests: usize,
}

impl Arrangement {
    /// All tests.
    pub fn total(&self) -> usize {
        self.groups.iter().fold(self.tests, |product, groups| product.saturating_mul(*groups))
    }

    /// The names of the groups of each test.
    fn paths(&self) -> Vec<Vec<Label>> {
        let start = vec![Vec::new()];
        let level = |paths: Vec<Vec<Label>>, &count: &usize| -> Vec<Vec<Label>> {
            let more = |path: &Vec<Label>, k: usize| path.iter().copied().chain([Label::literal(k)]).collect();
            paths.iter().flat_map(|path| (0..count).map(move |k| more(path, k))).collect()
        };
        let groups = self.groups.iter().fold(start, level);
        groups.into_iter().flat_map(|path| std::iter::repeat_n(path, self.tests)).collect()
    }
}

/// Expected standard errors for each arrangement of tests like those that the reductions were made of, one after the other and again from
/// the first. The structure is of a model with levels, its population in what is a test's own and what each level adds; which groups the
/// design's own tests stand in does not count.
///
/// # Errors
/// As [`plan`](crate::plan::plan); arrangements of too many tests.
pub fn plan_groups(
    reductions: &Reductions,
    structure: &Structure<'_>,
    population: &Population,
    arrangements: &[Arrangement],
) -> Result<Plan, PlanError> {
    let regressions = structure.regressions().len();
    population.check_named(structure.dimension(), regressions, &|i| (i + 1).to_string())?;
    let all: Vec<Expected> = arrangements
        .iter()
        .map(|one| {
            let (tests, grouping) = arranged(reductions, one)?;
            Expected::of(&tests, &Structure { grouping: Some(grouping), ..structure.clone() }, population)
        })
        .collect::<Result<_, _>>()?;
    let own = structure.phases[0].mean.elements.len();
    let has_mean = |quantity: &Quantity| !matches!(quantity, Quantity::Mean(i) if *i >= own);
    let planned = |quantity: Quantity| {
        let errors: Vec<Result<f64, Reason>> = all
            .iter()
            .map(|found| {
                let found = found.at(population);
                found.error(quantity).ok_or_else(|| found.reason(quantity))
            })
            .collect();
        let known = errors.iter().any(Result::is_ok);
        let std_errors = match errors.iter().find_map(|error| error.err()) {
            Some(reason) if !known => Err(reason),
            _ => Ok(errors.into_iter().map(|error| error.unwrap_or(f64::INFINITY)).collect()),
        };
        Planned { quantity, value: all.first().and_then(|found| found.at(population).value(quantity)), std_errors }
    };
    let Some(first) = all.first() else { return Err(PlanError::ZeroTests) };
    let elements = &first.state.problem.covariance.elements;
    Ok(Plan {
        design_tests: reductions.len(),
        tests: arrangements.iter().map(Arrangement::total).collect(),
        arrangements: arrangements.to_vec(),
        quantities: quantities(elements, regressions).into_iter().filter(has_mean).map(planned).collect(),
    })
}

/// Tests like those of the design, in groups.
fn arranged(design: &Reductions, arrangement: &Arrangement) -> Result<(Reductions, Arc<Grouping>), PlanError> {
    let total = arrangement.total();
    if total == 0 || design.is_empty() {
        return Err(PlanError::ZeroTests);
    }
    if total > MOST_TESTS {
        return Err(PlanError::TooManyTests { found: total, most: MOST_TESTS });
    }
    let ids: Vec<String> = (0..total).map(|test| test.to_string()).collect();
    let like = |(test, id): (usize, &String)| Reduction { test: id.clone(), ..design.get(test % design.len()).into() };
    let tests = ids.iter().enumerate().map(like).collect();
    let paths = ids.iter().map(String::as_str).zip(arrangement.paths());
    Ok((tests, Arc::new(Grouping::from_paths(arrangement.groups.len(), paths))))
}
