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

    /// What differs from one test, or group of a level, to the next is told from what differs between those that they stand in only
    /// where there are several in each. For each block of Σ, the tests' own first and then the innermost level: the first block that it
    /// is not told from; and last the same for the mean.
    fn together(&self) -> Vec<usize> {
        let members = std::iter::once(self.tests).chain(self.groups.iter().rev().copied());
        let mut first = vec![0];
        first.extend(members.enumerate().scan(0, |least, (block, members)| {
            *least = if members == 1 { *least } else { block + 1 };
            Some(*least)
        }));
        first
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
            .zip(arrangements)
            .map(|(found, one)| {
                let found = found.at(population);
                let error = found.error(quantity).ok_or_else(|| found.reason(quantity))?;
                if is_told(quantity, own, population, &one.together()) { Ok(error) } else { Err(Reason::Unidentified) }
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

/// True where no other block has a share of the quantity that these groups do not tell from its own. `own` states are in each block.
fn is_told(quantity: Quantity, own: usize, population: &Population, together: &[usize]) -> bool {
    let (Quantity::StdDev(i) | Quantity::Correlation(i, _) | Quantity::Covariance(i, _)) = quantity else {
        return true;
    };
    let (block, mean) = (i / own, together.len() - 1);
    let varies =
        |other: usize| other == mean || population.covariance[(other * own + i % own, other * own + i % own)] > 0.0;
    (0..together.len()).all(|other| other == block || together[other] != together[block] || !varies(other))
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

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector};

    use super::{Arrangement, is_told};
    use crate::model::Population;
    use crate::plan::Quantity;

    #[test]
    fn what_has_one_member_is_not_told_from_what_it_stands_in() {
        let of = |groups: &[usize], tests| Arrangement { groups: groups.to_vec(), tests }.together();
        assert_eq!(of(&[8], 5), [0, 1, 2]);
        assert_eq!(of(&[8], 1), [0, 0, 2], "one test of each unit");
        assert_eq!(of(&[1], 5), [0, 1, 1], "one unit: its own part is not told from the mean");
        assert_eq!(of(&[4, 1], 3), [0, 1, 1, 3], "one unit of each lot");
    }

    #[test]
    fn only_what_varies_in_both_is_untold() {
        // two states, one level; the second state varies from test to test only
        let variances = DVector::from_vec(vec![1.0, 2.0, 3.0, 0.0]);
        let covariance = DMatrix::from_diagonal(&variances);
        let population = Population { mean: vec![0.0; 4], coefficients: vec![], covariance };
        let told = |i: usize, tests: usize| {
            is_told(Quantity::StdDev(i), 2, &population, &Arrangement { groups: vec![8], tests }.together())
        };
        assert_eq!([0, 1, 2].map(|i| told(i, 1)), [false, true, false]);
        assert_eq!([0, 1, 2].map(|i| told(i, 2)), [true; 3]);
    }
}
