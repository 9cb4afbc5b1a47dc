//! Directions of α and (μ, Σ) together that the data do not determine, before any fit: the null space of the expected
//! information at the start values (theory §13).

use nalgebra::{DMatrix, DVector};

use crate::SharedProgress;
use crate::direction::Direction;
use crate::dynamic::expected::{EvaluationPair, is_possible, units};
use crate::dynamic::mixed::{ElementLaws, of_elements};
use crate::dynamic::stepwise::EvaluationPoint;
use crate::identifiability::{null_space, parts_with_parameters};
use crate::reason::Explanation;
use kalfit_algebra::sparse::Sparse;
use kalfit_estimate::{Objective, Problem, Progress, Structure, Sums, law_at};
use kalfit_filter::reduce::Reductions;
use kalfit_model::{PhasedModel, PhasedTest, Slots};
use kalfit_search::{DynamicError, ProfileLikelihood, Settings};

/// Step of a coordinate of α, for differences of coefficients.
const STEP: f64 = 1e-4;
/// Component of a unit vector, in coordinates of unit information, above which the coordinate takes part.
const MIN_COMPONENT: f64 = 1e-3;
/// Multiplications of a first look, a fraction of a second: where evenly chosen units of tests determine everything, all
/// tests do.
const FEW_MULTIPLICATIONS: f64 = 5e7;
/// Largest number of free values of α for which the information is computed.
const MAX_VALUES: usize = 24;

/// Directions of (μ, Σ) along which other values of α fit as well, at the free values `starts` of α, in the order of
/// `slots`. `reductions`: those at these values. Empty where tests are not given by rows, where no value or more than 24
/// values are free, and where the information does not exist at the start.
///
/// # Errors
/// A test cannot be evaluated at the start.
pub fn examine_with_parameters(
    (model, tests): (&PhasedModel, &[PhasedTest]),
    (slots, starts): (&Slots, &[f64]),
    (reductions, structure): (&Reductions, &Structure<'_>),
    progress: &mut dyn Progress,
) -> Result<Vec<(Direction, Explanation)>, DynamicError> {
    let settings = Settings::default();
    let objective = &ProfileLikelihood::new(model, tests, slots, &settings);
    let progress = &SharedProgress::new(progress, None);
    let k = starts.len();
    if k == 0 || k > MAX_VALUES || reductions.remote().is_some() || !is_possible(objective) {
        return Ok(Vec::new());
    }
    let (problem, point, sums) = kalfit_estimate::at_start(reductions, structure).map_err(DynamicError::Fit)?;
    let (law, sought) = (law_at(&problem, &point), objective.sought(starts));
    let along = |s: usize| -> Result<EvaluationPair, DynamicError> {
        let coordinate = &objective.coordinates[s];
        let step = coordinate.step(sought[s], STEP);
        let values = [1.0, -1.0].map(|sign| coordinate.moved(sought[s], sign * step));
        let at = |value: f64| {
            let mut moved = sought.clone();
            moved[s] = value;
            EvaluationPoint::new(objective, &objective.alpha(&moved), law.clone())
        };
        let width = coordinate.of_value(values[0]) - coordinate.of_value(values[1]);
        Ok(([at(values[0])?, at(values[1])?], width))
    };
    let free = problem.covariance.free_directions(&problem.covariance.chart(&point.root));
    let means = problem.mean_jacobian();
    let m = means.nrows();
    // elements that are held have no part
    let is_free = |row: f64| row > 0.0;
    let of_means = (0..m).filter(|&i| is_free(means.row(i).norm()));
    let of_sigma = free.row_sizes().into_iter().enumerate().filter(|(_, size)| is_free(*size)).map(|(e, _)| m + e);
    let moving: Vec<usize> = of_means.chain(of_sigma).collect();
    let laws = ElementLaws::of(&problem, &law).only(&moving);
    let alpha = objective.alpha(&sought);
    let place = |law| EvaluationPoint::new(objective, &alpha, law);
    let values = || (0..k).map(along).collect::<Result<Vec<_>, _>>().map(Some);
    let units = units(objective);
    let within = |most: f64| -> Result<Vec<(Direction, Explanation)>, DynamicError> {
        let found = of_elements(objective, (&units, (k, most)), &values, (&laws, &place, &law), progress)?;
        let Some([of_values, with_moving]) = found else { return Ok(Vec::new()) };
        let mut with_elements = DMatrix::zeros(k, m + problem.covariance.elements.count());
        moving.iter().enumerate().for_each(|(c, &e)| with_elements.set_column(e, &with_moving.column(c)));
        Ok(directions((&problem, objective.slots), (&sums, &free), (&of_values, &with_elements)))
    };
    // what some units do not determine, all of them together may
    if within(FEW_MULTIPLICATIONS)?.is_empty() { Ok(Vec::new()) } else { within(f64::INFINITY) }
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
        let least = MIN_COMPONENT * shares.norm();
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
