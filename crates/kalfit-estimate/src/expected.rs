//! The state of the estimator at a given population, with the information that is expected before anything is measured
//! (theory §3).

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use crate::covariance::CovarianceMap;
use crate::curvature::Curvature;
use crate::local::{Local, Tangent};
use crate::order::Order;
use crate::point::Point;
use crate::sums::Sums;
use crate::{FinalState, FitError, NewtonIterate, Problem, Settings, Structure};
use kalfit_algebra::elements::Element;
use kalfit_filter::reduce::Reductions;
use kalfit_model::Chain;
use kalfit_model::Population;

/// Largest deviation of a population from the structure, in standard deviations, that counts as rounding: the
/// population was read from a file.
const STRUCTURE_TOLERANCE: f64 = 1e-6;

/// The reason why there is no state at a population.
#[derive(Debug, Clone, PartialEq)]
pub enum ExpectedError {
    /// The problem cannot be set up, or its information is not finite.
    Fit(FitError),
    /// An element of the population does not agree with the structure.
    Off {
        /// The element.
        element: Element,
        /// Value of the element in the population, in the user's units.
        found: f64,
        /// Value of the element by the structure, in the user's units.
        expected: f64,
    },
}

impl From<FitError> for ExpectedError {
    fn from(error: FitError) -> ExpectedError {
        ExpectedError::Fit(error)
    }
}

/// The state at a population, which must agree with the structure. Measured values in the reductions are ignored.
pub fn at_population(
    reductions: &Reductions,
    structure: &Structure<'_>,
    population: &Population,
) -> Result<FinalState, ExpectedError> {
    let settings = Settings::default();
    let problem = without_data(reductions, structure, &settings)?;
    let mut point = point(&problem, population)?;
    let sums = problem.likelihood(&point, Order::Expected);
    let local = local(&sums);
    let tangent = Tangent::new(&local, &problem.mean.jacobian(), &problem.covariance, &point.root);
    if tangent.information.iter().any(|x| !x.is_finite()) {
        return Err(FitError::NotFinite.into());
    }
    point.root = tangent.chart.root.clone();
    let place = NewtonIterate { curvature: Curvature::new(&tangent), point, local, tangent };
    Ok(FinalState {
        problem: Arc::new(problem),
        newton_iterate: place,
        sums,
        assumed: structure.into(),
        settings,
        joint: None,
    })
}

/// The problem of the same tests before anything is measured.
fn without_data(
    reductions: &Reductions,
    structure: &Structure<'_>,
    settings: &Settings,
) -> Result<Problem, ExpectedError> {
    let mut without_data = reductions.clone();
    for number in 0..without_data.len() {
        let test = without_data.get_mut(number);
        (*test.constant, *test.residual) = (0.0, None);
        test.data.fill(0.0);
        test.chain.into_iter().for_each(Chain::blank);
    }
    Ok(super::problem(&without_data, structure, settings)?)
}

/// Expected information on (μ, coefficients; elements of Σ) at a population, which must agree with the structure, in the
/// user's units: block diagonal. An element of Σ moves both triangles.
///
/// # Errors
/// A structure that is not possible, or a population that does not agree with it.
pub fn information_at_population(
    reductions: &Reductions,
    structure: &Structure<'_>,
    population: &Population,
) -> Result<DMatrix<f64>, ExpectedError> {
    let problem = without_data(reductions, structure, &Settings::default())?;
    let point = point(&problem, population)?;
    let information = problem.likelihood(&point, Order::Expected).all_expected_information();
    let to_eta = to_eta(&problem);
    Ok(to_eta.tr_mul(&information) * to_eta)
}

/// d(η)/d(μ, coefficients; elements of Σ in the user's units).
fn to_eta(problem: &Problem) -> DMatrix<f64> {
    let (units, m) = (user_units(problem), problem.mean_units().len());
    let mut to_eta =
        DMatrix::from_diagonal(&DVector::from_iterator(units.len(), units.iter().map(|unit| unit.recip())));
    let means = problem.mean.centring.centred(&to_eta.view((0, 0), (m, m)).into_owned());
    to_eta.view_mut((0, 0), (m, m)).copy_from(&means);
    to_eta
}

/// For each mean coordinate and each element of Σ, the size of one unit of η in the user's units.
fn user_units(problem: &Problem) -> Vec<f64> {
    let scale = &problem.classes.frame.scale;
    let elements = problem.covariance.elements.all().map(|(i, j)| scale[i] * scale[j]);
    problem.mean_units().into_iter().chain(elements).collect()
}

impl FinalState {
    /// d(μ in η, coefficients; elements of Σ in η)/d(μ, coefficients; elements of Σ in the user's units).
    pub fn user_to_eta(&self) -> DMatrix<f64> {
        to_eta(&self.problem)
    }

    /// d(μ, coefficients; elements of Σ)/d(coordinates along the tangent basis), in the user's units.
    pub fn user_jacobian(&self) -> DMatrix<f64> {
        let (problem, tangent) = (&self.problem, &self.newton_iterate.tangent);
        let mean = problem.mean.centring.uncentred(&problem.mean.jacobian());
        let (m, units) = (mean.nrows(), user_units(problem));
        let mut jacobian = DMatrix::zeros(units.len(), mean.ncols() + tangent.jacobian.ncols());
        jacobian.view_mut((0, 0), mean.shape()).copy_from(&mean);
        let of_sigma = tangent.jacobian.dense();
        jacobian.view_mut((m, mean.ncols()), of_sigma.shape()).copy_from(&of_sigma);
        jacobian.row_iter_mut().zip(&units).for_each(|(mut row, unit)| row *= *unit);
        jacobian * tangent.basis.dense()
    }
}

/// Expected derivatives of ℓ at the true (μ, Σ): score zero, information Σ E'WE on μ and ½ Σ tr(W D W E) on Σ, cross
/// information zero.
fn local(sums: &Sums) -> Local {
    let (m, p) = (sums.mean_score.len(), sums.weight.nrows());
    Local {
        value: 0.0,
        mean_score: DVector::zeros(m),
        mean_information: sums.mean_information.clone(),
        score: DMatrix::zeros(p, p),
        cross: DMatrix::zeros(m, sums.elements.count()),
        information: Arc::new(sums.expected_information()),
        weight: sums.weight.clone(),
        mean_covariance: None,
    }
}

/// The population as a point in η; an error where the population does not agree with the structure.
fn point(problem: &Problem, population: &Population) -> Result<Point, ExpectedError> {
    let (map, frame) = (&problem.mean, &problem.classes.frame);
    let (mean, coefficients) = map.in_eta(frame, &population.mean, &population.coefficients);
    let mean = DVector::from_vec(mean);
    let deviation = &mean - &map.offset;
    let by_structure = &map.offset + &map.basis * (map.basis.transpose() * &deviation);
    for i in 0..mean.len() {
        if (mean[i] - by_structure[i]).abs() > STRUCTURE_TOLERANCE * (1.0 + by_structure[i].abs()) {
            let (found, expected) = (population.mean[i], frame.centre[i] + frame.scale[i] * by_structure[i]);
            return Err(ExpectedError::Off { element: Element::Mean(i), found, expected });
        }
    }
    let root =
        root(&problem.covariance, &frame.covariance_in(&population.covariance)).map_err(|(i, j, by_structure)| {
            let expected = by_structure * frame.scale[i] * frame.scale[j];
            let element = Element::Covariance(i, j);
            ExpectedError::Off { element, found: population.covariance[(i, j)], expected }
        })?;
    Ok(Point { mean: by_structure.as_slice().to_vec(), coefficients, root })
}

/// Variances below this fraction of the largest count as zero.
const ZERO_VARIANCE: f64 = 1e-18;

/// A root of Σ in the form of the structure, or the element (i, j, value by the structure) that deviates most from the
/// structure.
fn root(map: &CovarianceMap, sigma: &DMatrix<f64>) -> Result<DMatrix<f64>, (usize, usize, f64)> {
    let root = map.root_of(&map.mask(sigma));
    let by_structure = &root * root.transpose();
    // in η all states are of about one size: a variance far smaller than the largest is zero with rounding errors
    let largest = (0..map.p).fold(0.0, |most: f64, i| most.max(sigma[(i, i)]));
    let size = |i: usize| sigma[(i, i)].max(by_structure[(i, i)]).max(ZERO_VARIANCE * largest).sqrt();
    let (mut worst, mut most) = (None, STRUCTURE_TOLERANCE);
    let mut note = |i: usize, j: usize, deviation: f64, value: f64| {
        let unit = (size(i) * size(j)).max(f64::MIN_POSITIVE);
        if deviation.abs() > most * unit {
            (worst, most) = (Some((i, j, value)), deviation.abs() / unit);
        }
    };
    for i in 0..map.p {
        for j in 0..=i {
            note(i, j, sigma[(i, j)] - by_structure[(i, j)], by_structure[(i, j)]);
        }
    }
    for (constraint, deviation) in map.constraints.iter().zip(map.residual(sigma).iter()) {
        let (i, j, x) = constraint.terms[0];
        note(i, j, deviation / x, sigma[(i, j)] - deviation / x);
    }
    worst.map_or(Ok(root), Err)
}
