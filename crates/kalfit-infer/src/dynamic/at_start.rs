//! Directions of α and (μ, Σ) together that the data do not determine, before any fit: the null space of the expected
//! information at the start values (theory §13).

use nalgebra::{DMatrix, DVector};

use crate::SharedProgress;
use crate::direction::Direction;
use crate::dynamic::expected::{EvaluationPair, is_possible, sides, units};
use crate::dynamic::mixed::{ElementLaws, MAX_VALUES, of_elements, stride};
use crate::dynamic::stepwise::EvaluationPoint;
use crate::identifiability::{Examination, MIN_DIFFERENCED_WEIGHT, examine_at, null_space, parts_with_parameters};
use crate::reason::Explanation;
use kalfit_algebra::sparse::Sparse;
use kalfit_estimate::{Objective, Point, Problem, Progress, Structure, Sums, law_at};
use kalfit_filter::reduce::Reductions;
use kalfit_filter::score::InitialLaw;
use kalfit_model::{Alpha, PhasedModel, PhasedTest, Slots};
use kalfit_search::{DynamicError, ProfileLikelihood, Settings};

/// Multiplications of a first look, a fraction of a second: where evenly chosen units of tests determine everything, all
/// tests do.
const FEW_MULTIPLICATIONS: f64 = 5e7;

/// Examines identifiability before any fit, at the free values `starts` of α, in the order of `slots`: as
/// [`examine_at_start`](crate::examine_at_start) does, and for directions of (μ, Σ) along which other values of α fit as
/// well.
/// `reductions`: those at the start. Directions with values of α are left out where tests are not given by rows, where more
/// than 24 values are free, and where the information does not exist at the start.
///
/// # Errors
/// As of [`examine_at_start`](crate::examine_at_start); a test cannot be evaluated at the start.
pub fn examine_with_parameters(
    (model, tests): (&PhasedModel, &[PhasedTest]),
    (slots, starts): (&Slots, &[f64]),
    (reductions, structure): (&Reductions, &Structure<'_>),
    progress: &mut dyn Progress,
) -> Result<Examination, DynamicError> {
    let at = kalfit_estimate::at_start(reductions, structure).map_err(DynamicError::Fit)?;
    let mut found = examine_at((&at.0, &at.1, &at.2), structure, reductions);
    let settings = Settings::default();
    let objective = ProfileLikelihood::new(model, tests, slots, &settings);
    let is_small = (1..=MAX_VALUES).contains(&starts.len());
    if is_small && reductions.remote().is_none() && is_possible(&objective) {
        let progress = &SharedProgress::new(progress, None);
        found.extend(with_parameters(&objective, starts, (&at.0, &at.1, &at.2), progress)?);
    }
    Ok(found)
}

/// Directions of (μ, Σ) along which other values of α fit as well.
fn with_parameters(
    objective: &ProfileLikelihood<'_>,
    starts: &[f64],
    (problem, point, sums): (&Problem, &Point, &Sums),
    progress: &SharedProgress<'_>,
) -> Result<Vec<(Direction, Explanation)>, DynamicError> {
    let (k, law, sought) = (starts.len(), law_at(problem, point), objective.sought(starts));
    let place = |alpha: &Alpha, law: InitialLaw| EvaluationPoint::new(objective, alpha, law);
    let along = |s: usize| -> Result<EvaluationPair, DynamicError> {
        let ([up, down], width) = sides(objective, &sought, s);
        let at = |sought: &[f64]| place(&objective.alpha(sought), law.clone());
        Ok(([at(&up)?, at(&down)?], width))
    };
    let values = || (0..k).map(along).collect::<Result<Vec<_>, _>>().map(Some);
    let free = problem.covariance.free_directions(&problem.covariance.chart(&point.root));
    let moving = moving((problem.mean_jacobian(), &free), sums);
    let laws = ElementLaws::of(problem, &law).only(&moving);
    let (alpha, units) = (objective.alpha(&sought), units(objective));
    let elsewhere = |law| place(&alpha, law);
    let rows = problem.mean_jacobian().nrows() + problem.covariance.elements.count();
    let of_every = |every: usize| -> Result<Vec<(Direction, Explanation)>, DynamicError> {
        let found = of_elements((&units, every), k, &values, (&laws, &elsewhere, &law), progress)?;
        let Some([of_values, with_moving]) = found else { return Ok(Vec::new()) };
        let mut with_elements = DMatrix::zeros(k, rows);
        moving.iter().enumerate().for_each(|(c, &e)| with_elements.set_column(e, &with_moving.column(c)));
        Ok(directions((problem, objective.slots), (sums, &free), (&of_values, &with_elements)))
    };
    // what some units do not determine, all of them together may
    let every = stride(objective, units.len(), (k, laws.count()), FEW_MULTIPLICATIONS);
    let found = of_every(every)?;
    if found.is_empty() || every == 1 { Ok(found) } else { of_every(1) }
}

/// Rows of (mean coordinates, elements of Σ) that are not held and that some test informs: what no test informs has no
/// information in common with a parameter either.
fn moving((means, free): (&DMatrix<f64>, &Sparse), sums: &Sums) -> Vec<usize> {
    let sizes = means.row_iter().map(|row| row.norm()).chain(free.row_sizes());
    let elements = sums.expected_information().diagonal();
    let informed = sums.mean_information.diagonal().iter().chain(elements.iter()).map(|x| *x > 0.0).collect::<Vec<_>>();
    sizes.enumerate().filter(|(row, size)| *size > 0.0 && informed[*row]).map(|(row, _)| row).collect()
}

/// The null space of the information, in directions that move values of α and (μ, Σ) both. `of_values`: information of α,
/// k × k; `with_elements`: of α with (mean coordinates, elements of Σ).
fn directions(
    (problem, slots): (&Problem, &Slots),
    (sums, free): (&Sums, &Sparse),
    (of_values, with_elements): (&DMatrix<f64>, &DMatrix<f64>),
) -> Vec<(Direction, Explanation)> {
    let (means, elements) = (problem.mean_jacobian(), sums.expected_information());
    let (k, m, q, f) = (of_values.nrows(), means.nrows(), means.ncols(), free.columns().count());
    let mut all = DMatrix::zeros(k + q + f, k + q + f);
    all.view_mut((0, 0), (k, k)).copy_from(of_values);
    for a in 0..k {
        let row = with_elements.row(a).transpose();
        let of_means = means.transpose() * row.rows(0, m);
        let of_free = free.transposed_times(&row.rows(m, row.len() - m).into_owned());
        let cross = DVector::from_iterator(q + f, of_means.iter().chain(of_free.iter()).copied());
        all.view_mut((k, a), (q + f, 1)).copy_from(&cross);
        all.view_mut((a, k), (1, q + f)).copy_from(&cross.transpose());
    }
    all.view_mut((k, k), (q, q)).copy_from(&(means.transpose() * &sums.mean_information * means));
    all.view_mut((k + q, k + q), (f, f)).copy_from(&free.congruence_of(elements));
    if all.iter().any(|x| !x.is_finite()) {
        return Vec::new();
    }
    let size: Vec<f64> = all.diagonal().iter().map(|x| x.max(0.0).sqrt()).collect();
    let mut found = Vec::new();
    for v in null_space(&|| all.clone(), &vec![1.0; k + q + f], 0.0) {
        let shares = DVector::from_fn(v.len(), |i, _| (v[i] * size[i]).abs());
        let least = MIN_DIFFERENCED_WEIGHT * shares.norm();
        let parameters: Vec<usize> =
            (0..k).filter(|&s| shares[s] > least).map(|s| slots.slots()[s].parameter).collect();
        if parameters.is_empty() || shares.rows(k, q + f).iter().all(|share| *share <= least) {
            continue; // of one of both alone
        }
        let mut moved = DVector::zeros(with_elements.ncols());
        moved.rows_mut(0, m).copy_from(&(means * v.rows(k, q)));
        let of_sigma = free.times(&v.rows(k + q, f).into_owned());
        moved.rows_mut(m, of_sigma.len()).copy_from(&of_sigma);
        found.extend(parts_with_parameters(problem, moved, &parameters));
    }
    found
}
