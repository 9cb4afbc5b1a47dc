//! The expected information that free values of α share with every element of (μ, Σ), which the score test of a
//! constraint needs where α is free.
//!
//! A mean enters the filter linearly, and so does Σ: a root F of Σ with one more column v gives Σ + vv', and the
//! difference of v = ae_i + be_j and v = ae_i - be_j is 2ab in σ_ij. So slopes along elements of (μ, Σ) are exact.

use nalgebra::DMatrix;

use crate::SharedProgress;
use crate::dynamic::expected::{Directions, EvaluationPair, along_value, is_possible, units};
use crate::dynamic::stepwise::{EvaluationPoint, GroupedTest};
use crate::holds_any;
use crate::law::AsymptoticLaw;
use kalfit_estimate::{Criterion, Mixed, Problem};
use kalfit_filter::score::InitialLaw;
use kalfit_model::{Evidence, PhasedTest};
use kalfit_search::{DynamicError, DynamicFit, ProfileLikelihood};

/// Largest number of values that adapt; with more values, score tests treat α as known.
pub(super) const MAX_VALUES: usize = 24;
/// Largest number of elements of (μ, Σ) in one pass of the filters. A pass with k values of α costs the square or the cube
/// of k and the elements together, so that as many elements as values cost least.
const MOST_ELEMENTS_PER_PASS: usize = 8;
/// Largest number of multiplications for this information: with more, it comes from evenly chosen tests.
const MOST_MULTIPLICATIONS: f64 = 5e8;

/// Covariance of all that is free, and expected information of the values of α that move with the elements of (μ, Σ).
/// `None` where no value moves or no element is held, where more than [`MAX_VALUES`] values or values of single tests
/// move, where tests are not given by rows, and once `progress` stops.
pub(super) fn mixed(
    objective: &ProfileLikelihood<'_>,
    fit: &DynamicFit,
    progress: &SharedProgress<'_>,
) -> Result<Option<Mixed>, DynamicError> {
    let (state, shared) = (&fit.estimate.state, fit.joint.shared());
    let needed = !shared.is_empty()
        && shared.len() <= MAX_VALUES
        && fit.joint.is_of_shared_values()
        && holds_any(state)
        && fit.estimate.criterion == Criterion::Ml;
    if !needed || fit.reductions.remote().is_some() || !is_possible(objective) {
        return Ok(None);
    }
    let Some([of_values, information]) = information(objective, fit, progress)? else { return Ok(None) };
    let law = AsymptoticLaw::new(state);
    let (k, n) = (shared.len(), law.jacobian().ncols());
    let mut all = DMatrix::zeros(k + n, k + n);
    all.view_mut((0, 0), (k, k)).copy_from(&of_values);
    for a in 0..k {
        let cross = law.jacobian().transposed_times(&information.row(a).transpose());
        all.view_mut((k, a), (n, 1)).copy_from(&cross);
        all.view_mut((a, k), (1, n)).copy_from(&cross.transpose());
    }
    all.view_mut((k, k), (n, n)).copy_from(&law.jacobian().congruence(&state.sums.all_expected_information()));
    let Some(covariances) = fit.joint.covariances_of(&all) else { return Ok(None) };
    let tangent_first: Vec<usize> = (k..k + n).chain(0..k).collect();
    let covariance = DMatrix::from_fn(k + n, k + n, |i, j| covariances.whole[(tangent_first[i], tangent_first[j])]);
    Ok(Some(Mixed { covariance, information }))
}

/// Expected information of α, values × values, and of α with (mean coordinates, elements of Σ) in η, values × elements.
fn information(
    objective: &ProfileLikelihood<'_>,
    fit: &DynamicFit,
    progress: &SharedProgress<'_>,
) -> Result<Option<[DMatrix<f64>; 2]>, DynamicError> {
    let (shared, law) = (fit.joint.shared(), fit.estimate.state.law());
    let laws = ElementLaws::of(&fit.estimate.state.problem, &law);
    let place = |law| EvaluationPoint::new(objective, &fit.alpha, law);
    let values = || shared.iter().map(|&s| along_value(objective, fit, s)).collect();
    let units = units(objective);
    let every = stride(objective, units.len(), (shared.len(), laws.0.len()), MOST_MULTIPLICATIONS);
    of_elements((&units, every), shared.len(), &values, (&laws, &place, &law), progress)
}

/// The information of [`information`] at any point. It comes from one of `every` units of tests; `values`: the pairs of
/// points along each of k values of α; `place`: the point with another law of ξ than `law`. `None` where a pair is not
/// defined, and once `progress` stops.
pub(super) fn of_elements(
    (units, every): (&[Vec<GroupedTest<'_>>], usize),
    k: usize,
    values: &dyn Fn() -> Result<Option<Vec<EvaluationPair>>, DynamicError>,
    (laws, place, law): (
        &ElementLaws,
        &(dyn Fn(InitialLaw) -> Result<EvaluationPoint, DynamicError> + Sync),
        &InitialLaw,
    ),
    progress: &SharedProgress<'_>,
) -> Result<Option<[DMatrix<f64>; 2]>, DynamicError> {
    let chosen: Vec<&[GroupedTest<'_>]> = units.iter().step_by(every).map(Vec::as_slice).collect();
    let rows = |unit: &[GroupedTest<'_>]| unit.iter().map(|member| rows_of(member.test)).sum::<usize>() as f64;
    let all_rows = units.iter().map(|unit| rows(unit)).sum::<f64>();
    let share = all_rows / chosen.iter().map(|unit| rows(unit)).sum::<f64>().max(1.0);
    let found = of_each_unit(&chosen, k, values, (laws, place, law), progress)?;
    let sum = |which: usize, shape: (usize, usize)| {
        let all = found.as_ref().into_iter().flatten();
        all.fold(DMatrix::zeros(shape.0, shape.1), |sum, unit| sum + &unit[which]) * share
    };
    let sums = [sum(0, (k, k)), sum(1, (k, laws.0.len()))];
    Ok(found.map(|_| sums))
}

/// The information of each of some units of tests: values × values, and values × elements. Arguments as of [`of_elements`].
pub(super) fn of_each_unit(
    units: &[&[GroupedTest<'_>]],
    k: usize,
    values: &dyn Fn() -> Result<Option<Vec<EvaluationPair>>, DynamicError>,
    (laws, place, law): (
        &ElementLaws,
        &(dyn Fn(InitialLaw) -> Result<EvaluationPoint, DynamicError> + Sync),
        &InitialLaw,
    ),
    progress: &SharedProgress<'_>,
) -> Result<Option<Vec<[DMatrix<f64>; 2]>>, DynamicError> {
    let count = laws.0.len();
    let mut found = vec![[DMatrix::zeros(k, k), DMatrix::zeros(k, count)]; units.len()];
    let of_a_pass = k.clamp(1, MOST_ELEMENTS_PER_PASS);
    for (number, chunk) in laws.0.chunks(of_a_pass).enumerate() {
        let Some(mut all) = values()? else { return Ok(None) };
        for (sides, width) in chunk {
            all.push(([place(sides[0].clone())?, place(sides[1].clone())?], *width));
        }
        let directions = Directions { centre: place(law.clone())?, all };
        let Some(parts) = progress.each(units.len(), |at| directions.information(units[at], progress)) else {
            return Ok(None);
        };
        let first = number * of_a_pass;
        for (own, part) in found.iter_mut().zip(parts) {
            let part = part.map_err(|error| DynamicError::Reduce(Box::new(error)))?;
            own[0].copy_from(&part.view((0, 0), (k, k)));
            own[1].columns_mut(first, chunk.len()).copy_from(&part.view((0, k), (k, chunk.len())));
        }
    }
    Ok((!progress.stops()).then_some(found))
}

/// One of so many units of tests is used, such that the work stays within `most` multiplications.
pub(super) fn stride(
    objective: &ProfileLikelihood<'_>,
    units: usize,
    (k, elements): (usize, usize),
    most: f64,
) -> usize {
    let states = objective.model.phases.iter().map(|phase| phase.model.states.len()).max().unwrap_or(0);
    let states = states + objective.model.levels.len() * objective.model.dimension();
    let of_a_pass = k.clamp(1, MOST_ELEMENTS_PER_PASS);
    let stacked = (states * (k + of_a_pass.min(elements) + 1)) as f64;
    let rows = objective.tests.iter().map(rows_of).sum::<usize>() as f64;
    let work = elements.div_ceil(of_a_pass) as f64 * rows * stacked * stacked;
    let wanted = (work / most).ceil().max(1.0) as usize;
    wanted.min(units.max(1))
}

fn rows_of(test: &PhasedTest) -> usize {
    let of = |evidence: &Evidence| if let Evidence::Rows(rows) = evidence { rows.rows() } else { 0 };
    test.phases.iter().map(of).sum()
}

/// Laws of ξ above and below a law along each element of (mean coordinates, Σ), and their distance in η.
pub(super) struct ElementLaws(Vec<([InitialLaw; 2], f64)>);

impl ElementLaws {
    pub(super) fn of(problem: &Problem, law: &InitialLaw) -> ElementLaws {
        ElementLaws(element_laws(problem, law))
    }

    /// Number of elements.
    pub(super) fn count(&self) -> usize {
        self.0.len()
    }

    /// The laws along some of the elements.
    pub(super) fn only(self, elements: &[usize]) -> ElementLaws {
        let mut all: Vec<_> = self.0.into_iter().map(Some).collect();
        ElementLaws(elements.iter().filter_map(|&e| all[e].take()).collect())
    }
}

fn element_laws(problem: &Problem, law: &InitialLaw) -> Vec<([InitialLaw; 2], f64)> {
    let (scale, p) = (&problem.classes.frame.scale, law.root.nrows());
    let moved = |change: &dyn Fn(&mut InitialLaw, f64)| {
        [1.0, -1.0].map(|sign| {
            let mut moved = law.clone();
            change(&mut moved, sign);
            moved
        })
    };
    // the effects of groups have no mean
    let means = (0..scale.len()).map(|i| {
        (
            moved(&|law, sign| {
                if i < p {
                    law.mean[i] += sign * scale[i]
                }
            }),
            2.0,
        )
    });
    let units = problem.mean.coefficient_scale.iter().enumerate();
    let coefficients = units.map(|(c, unit)| {
        let mut coordinates = vec![0.0; scale.len() + problem.mean.coefficient_scale.len()];
        coordinates[scale.len() + c] = 1.0;
        problem.mean.centring.uncentre(&mut coordinates);
        let change = |law: &mut InitialLaw, sign: f64| {
            law.regression[c].1 += sign / unit;
            (0..p).for_each(|i| law.mean[i] += sign * scale[i] * coordinates[i]);
        };
        (moved(&change), 2.0)
    });
    let blocks = scale.len() / p.max(1);
    let covariances = problem.covariance.elements.all().map(|(i, j)| {
        let with = |law: &mut InitialLaw, sign: f64| {
            let width = law.root.ncols() / blocks;
            let mut root = DMatrix::zeros(p, law.root.ncols() + blocks);
            for block in 0..blocks {
                let own = law.root.columns(block * width, width);
                root.view_mut((0, block * (width + 1)), (p, width)).copy_from(&own);
            }
            let column = (i / p) * (width + 1) + width;
            if i != j {
                root[(i % p, column)] = scale[i];
                root[(j % p, column)] = sign * scale[j];
            } else if sign > 0.0 {
                root[(i % p, column)] = scale[i];
            }
            law.root = root;
        };
        (moved(&with), if i == j { 1.0 } else { 2.0 })
    });
    means.chain(coefficients).chain(covariances).collect()
}
