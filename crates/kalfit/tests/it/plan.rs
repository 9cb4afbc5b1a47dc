//! Expected standard errors against dense formulas and against the spread of fits to simulated ensembles.

use kalfit::estimate::{self, Settings, Silent, Structure};
use kalfit::infer::Element;
use kalfit::model::{Alpha, CovarianceKind, CovarianceStructure, FixedElement, MeanElement, MeanStructure, Regression};
use kalfit::plan::{Plan, PlanError, Quantity, Reason, plan};
use kalfit::reduce::{Path, Reduction, Reductions};
use kalfit::{Expression, Population};
use kalfit_fixtures::near;
use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

/// log p(z | ξ) = -½ ‖d - Rξ‖².
fn reduction(id: usize, r: &DMatrix<f64>, d: &DVector<f64>, covariates: &[f64]) -> Reduction {
    let p = r.ncols();
    Reduction {
        test: format!("t{id:04}"),
        constant: 0.0,
        residual: None,
        data: d.as_slice().to_vec(),
        factor: (0..p).flat_map(|k| (0..=k).map(move |i| (i, k))).map(|(i, k)| r[(i, k)]).collect(),
        covariates: covariates.to_vec(),
        steps: 1,
        observations: 1,
        path: Path::Information,
        design: 0,
        chain: None,
        exact: None,
    }
}

fn m(rows: usize, columns: usize, entries: &[f64]) -> DMatrix<f64> {
    DMatrix::from_row_slice(rows, columns, entries)
}

/// Three unequal designs: the last observes one combination only.
fn roots() -> Vec<DMatrix<f64>> {
    vec![m(2, 2, &[2.0, 0.5, 0.0, 1.0]), m(2, 2, &[0.8, -1.0, 0.0, 3.0]), m(2, 2, &[1.5, 1.5, 0.0, 0.0])]
}

fn designs(roots: &[DMatrix<f64>]) -> Reductions {
    roots.iter().enumerate().map(|(j, r)| reduction(j, r, &DVector::zeros(r.ncols()), &[])).collect()
}

fn population(mean: &[f64], covariance: DMatrix<f64>) -> Population {
    Population { mean: mean.to_vec(), coefficients: vec![], covariance }
}

fn planned(
    designs: &Reductions,
    mean: &MeanStructure,
    covariance: &CovarianceStructure,
    truth: &Population,
    tests: &[usize],
) -> Result<Plan, PlanError> {
    plan(designs, &Structure::single(mean, covariance, &Alpha::default()), truth, tests)
}

fn of(plan: &Plan, quantity: Quantity) -> Result<Vec<f64>, Reason> {
    plan.quantities.iter().find(|q| q.quantity == quantity).expect("every quantity is planned").std_errors.clone()
}

/// (I + JΣ)⁻¹J of each design.
fn weights(roots: &[DMatrix<f64>], sigma: &DMatrix<f64>) -> Vec<DMatrix<f64>> {
    let one = |r: &DMatrix<f64>| {
        let j = r.transpose() * r;
        (DMatrix::identity(j.nrows(), j.nrows()) + &j * sigma).lu().solve(&j).expect("regular")
    };
    roots.iter().map(one).collect()
}

#[test]
fn the_errors_of_a_full_covariance_are_those_of_the_dense_information() {
    let sigma = m(2, 2, &[1.0, 0.3, 0.3, 0.5]);
    let truth = population(&[5.0, -300.0], sigma.clone());
    let plan = planned(&designs(&roots()), &MeanStructure::free(2), &CovarianceStructure::full(), &truth, &[3, 300]);
    let plan = plan.expect("sound");
    let weights = weights(&roots(), &sigma);
    let mean = weights.iter().fold(DMatrix::zeros(2, 2), |sum, w| sum + w).try_inverse().expect("regular");
    let directions = [m(2, 2, &[1.0, 0.0, 0.0, 0.0]), m(2, 2, &[0.0, 1.0, 1.0, 0.0]), m(2, 2, &[0.0, 0.0, 0.0, 1.0])];
    let information = DMatrix::from_fn(3, 3, |k, l| {
        0.5 * weights.iter().map(|w| (w * &directions[k] * w * &directions[l]).trace()).sum::<f64>()
    });
    let covariance = information.try_inverse().expect("regular");
    let places = [(0, 0), (1, 0), (1, 1)];
    for i in 0..2 {
        let found = of(&plan, Quantity::Mean(i)).expect("identified");
        near::relative("mean", found[0], mean[(i, i)].sqrt(), 1e-10);
        near::relative("mean of 300", found[1], mean[(i, i)].sqrt() / 10.0, 1e-10);
        let k = 2 * i;
        let found = of(&plan, Quantity::StdDev(i)).expect("identified");
        near::relative("std dev", found[0], covariance[(k, k)].sqrt() / (2.0 * sigma[(i, i)].sqrt()), 1e-10);
    }
    for (k, &(i, j)) in places.iter().enumerate() {
        let found = of(&plan, Quantity::Covariance(i, j)).expect("identified");
        near::relative("covariance", found[0], covariance[(k, k)].sqrt(), 1e-10);
    }
    let unit = (sigma[(0, 0)] * sigma[(1, 1)]).sqrt();
    let rho = sigma[(0, 1)] / unit;
    let slope = DVector::from_vec(vec![-0.5 * rho / sigma[(0, 0)], 1.0 / unit, -0.5 * rho / sigma[(1, 1)]]);
    let found = of(&plan, Quantity::Correlation(1, 0)).expect("identified");
    near::relative("correlation", found[0], slope.dot(&(&covariance * &slope)).sqrt(), 1e-10);
}

#[test]
fn structures_are_planned_in_their_free_coordinates() {
    let sigma = m(2, 2, &[1.0, 0.0, 0.0, 0.5]);
    let weights = weights(&roots(), &sigma);
    let truth = population(&[5.0, -3.0], sigma.clone());
    // diagonal: two variances
    let diagonal = CovarianceStructure { kind: CovarianceKind::Diagonal, ..CovarianceStructure::full() };
    let plan = planned(&designs(&roots()), &MeanStructure::free(2), &diagonal, &truth, &[3]).expect("sound");
    let information = DMatrix::from_fn(2, 2, |i, j| 0.5 * weights.iter().map(|w| w[(i, j)] * w[(j, i)]).sum::<f64>());
    let covariance = information.try_inverse().expect("regular");
    for i in 0..2 {
        let found = of(&plan, Quantity::Covariance(i, i)).expect("identified");
        near::relative("diagonal", found[0], covariance[(i, i)].sqrt(), 1e-10);
    }
    assert_eq!(of(&plan, Quantity::Covariance(1, 0)), Err(Reason::Fixed));
    assert_eq!(of(&plan, Quantity::Correlation(1, 0)), Err(Reason::Fixed));
    // Σ = βΣ*: one number
    let entries = |x: &DMatrix<f64>| -> Vec<Vec<Expression>> {
        (0..2).map(|i| (0..2).map(|j| Expression::Number(x[(i, j)])).collect()).collect()
    };
    let scaled = CovarianceStructure {
        kind: CovarianceKind::Proportional(entries(&(&sigma * 4.0))),
        ..CovarianceStructure::full()
    };
    let plan = planned(&designs(&roots()), &MeanStructure::free(2), &scaled, &truth, &[3]).expect("sound");
    let information = 0.5 * weights.iter().map(|w| (w * &sigma * w * &sigma).trace()).sum::<f64>();
    let found = of(&plan, Quantity::Covariance(1, 1)).expect("identified");
    near::relative("proportional", found[0], 0.5 / information.sqrt(), 1e-10);
    // one mean fixed: the other is known better
    let mut fixed = MeanStructure::free(2);
    fixed.elements[1] = MeanElement::Fixed(-3.0);
    let plan = planned(&designs(&roots()), &fixed, &diagonal, &truth, &[3]).expect("sound");
    let information: f64 = weights.iter().map(|w| w[(0, 0)]).sum();
    near::relative("mean", of(&plan, Quantity::Mean(0)).expect("identified")[0], information.sqrt().recip(), 1e-10);
    assert_eq!(of(&plan, Quantity::Mean(1)), Err(Reason::Fixed));
}

#[test]
fn what_has_no_standard_error_says_why() {
    let full = CovarianceStructure::full();
    let one_sided = [m(2, 2, &[1.0, 0.0, 0.0, 0.0]), m(2, 2, &[2.0, 0.0, 0.0, 0.0])];
    let truth = population(&[1.0, 1.0], m(2, 2, &[1.0, 0.1, 0.1, 0.5]));
    let plan = planned(&designs(&one_sided), &MeanStructure::free(2), &full, &truth, &[10]).expect("sound");
    assert!(of(&plan, Quantity::Mean(0)).is_ok() && of(&plan, Quantity::StdDev(0)).is_ok());
    assert_eq!(of(&plan, Quantity::Mean(1)), Err(Reason::Unidentified));
    assert_eq!(of(&plan, Quantity::StdDev(1)), Err(Reason::Unidentified));
    assert_eq!(of(&plan, Quantity::Correlation(1, 0)), Err(Reason::Unidentified));
    // singular
    let truth = population(&[1.0, 1.0], m(2, 2, &[1.0, 0.5, 0.5, 0.25]));
    let plan = planned(&designs(&roots()), &MeanStructure::free(2), &full, &truth, &[10]).expect("sound");
    assert!(of(&plan, Quantity::Mean(1)).is_ok());
    assert_eq!(of(&plan, Quantity::StdDev(0)), Err(Reason::Boundary));
    let truth = population(&[1.0, 1.0], m(2, 2, &[1.0, 0.0, 0.0, 0.0]));
    let zero = CovarianceStructure { fixed: vec![FixedElement { i: 1, j: 1, value: 0.0 }], ..full.clone() };
    let plan = planned(&designs(&roots()), &MeanStructure::free(2), &zero, &truth, &[10]).expect("sound");
    assert!(of(&plan, Quantity::StdDev(0)).is_ok());
    assert_eq!(of(&plan, Quantity::StdDev(1)), Err(Reason::Fixed));
    let correlation = plan.quantities.iter().find(|q| q.quantity == Quantity::Correlation(1, 0)).expect("planned");
    assert_eq!((correlation.value, &correlation.std_errors), (None, &Err(Reason::Fixed)));
}

#[test]
fn a_population_off_the_structure_is_refused() {
    let diagonal = CovarianceStructure { kind: CovarianceKind::Diagonal, ..CovarianceStructure::full() };
    let mut fixed = MeanStructure::free(2);
    fixed.elements[0] = MeanElement::Fixed(0.0);
    let free = MeanStructure::free(2);
    let correlated = population(&[1.0, 1.0], m(2, 2, &[1.0, 0.1, 0.1, 0.5]));
    for (mean, element) in [(&free, Element::Covariance(1, 0)), (&fixed, Element::Mean(0))] {
        let refusal = planned(&designs(&roots()), mean, &diagonal, &correlated, &[10]).expect_err("off the structure");
        assert!(matches!(&refusal, PlanError::OffStructure { element: e, .. } if *e == element), "{refusal:?}");
    }
    let equal = CovarianceStructure { equal: vec![vec![(0, 0), (1, 1)]], ..CovarianceStructure::full() };
    let refusal = planned(&designs(&roots()), &free, &equal, &correlated, &[10]).expect_err("unequal");
    assert!(matches!(refusal, PlanError::OffStructure { .. }), "{refusal:?}");
    let short = population(&[1.0], m(1, 1, &[1.0]));
    assert!(matches!(planned(&designs(&roots()), &free, &equal, &short, &[1]), Err(PlanError::Population(_))));
    assert_eq!(planned(&designs(&roots()), &free, &diagonal, &correlated, &[0]).err(), Some(PlanError::ZeroTests));
    assert!(matches!(planned(&Reductions::new(), &free, &diagonal, &correlated, &[1]), Err(PlanError::Design(_))));
}

#[test]
fn measured_values_do_not_matter() {
    let sigma = m(2, 2, &[1.0, 0.3, 0.3, 0.5]);
    let truth = population(&[5.0, -3.0], sigma);
    let blank = designs(&roots());
    let measured: Reductions =
        blank.iter().map(|r| Reduction { constant: -1e5, data: vec![1e9, f64::NAN], ..r.into() }).collect();
    let run = |d: &Reductions| planned(d, &MeanStructure::free(2), &CovarianceStructure::full(), &truth, &[7]);
    assert_eq!(run(&blank), run(&measured));
}

/// 400 ensembles of 150 tests each: the spread of the estimates is that which the plan expects.
#[test]
fn fits_of_simulated_ensembles_spread_as_planned() {
    const ENSEMBLES: usize = 400;
    const TESTS: usize = 150;
    let sigma = m(2, 2, &[1.0, 0.3, 0.3, 0.5]);
    let slope = 0.4;
    let mut mean = MeanStructure::free(2);
    mean.regression.push(Regression { element: 0, column: 0 });
    let covariate = |j: usize| [-1.0, 0.2, 1.5, 0.9, -0.4][j % 5];
    let root = sigma.clone().cholesky().expect("positive definite").l();
    let (roots, full, alpha) = (roots(), CovarianceStructure::full(), Alpha::default());
    let structure = Structure::single(&mean, &full, &alpha);
    let mut random = ChaCha8Rng::seed_from_u64(2026);
    let mut found: Vec<DVector<f64>> = Vec::new();
    for _ in 0..ENSEMBLES {
        let mut normal = || random.sample::<f64, _>(StandardNormal);
        let tests: Reductions = (0..TESTS)
            .map(|j| {
                let r = &roots[j % 3];
                let mut xi = DVector::from_vec(vec![5.0, -3.0]) + &root * DVector::from_fn(2, |_, _| normal());
                xi[0] += slope * covariate(j);
                let noise = DVector::from_fn(2, |i, _| if r[(i, i)] > 0.0 { normal() } else { 0.0 });
                reduction(j, r, &(r * xi + noise), &[covariate(j)])
            })
            .collect();
        let fit = estimate::fit(&tests, &structure, &Settings::default(), &mut Silent).expect("a legal problem");
        let s = &fit.covariance;
        let (a, b) = (s[(0, 0)].sqrt(), s[(1, 1)].sqrt());
        found.push(DVector::from_vec(vec![fit.mean[0], fit.mean[1], fit.coefficients[0], a, b, s[(1, 0)] / (a * b)]));
    }
    // a design of 15 tests stands for the ensemble
    let design: Reductions =
        (0..15).map(|j| reduction(j, &roots[j % 3], &DVector::zeros(2), &[covariate(j)])).collect();
    let truth = Population { mean: vec![5.0, -3.0], coefficients: vec![slope], covariance: sigma };
    let plan = plan(&design, &structure, &truth, &[TESTS]).expect("sound");
    let quantities = [
        Quantity::Mean(0),
        Quantity::Mean(1),
        Quantity::Coefficient(0),
        Quantity::StdDev(0),
        Quantity::StdDev(1),
        Quantity::Correlation(1, 0),
    ];
    let count = ENSEMBLES as f64;
    let centre = found.iter().fold(DVector::zeros(6), |sum, x| sum + x) / count;
    for (k, quantity) in quantities.into_iter().enumerate() {
        let spread = (found.iter().map(|x| (x[k] - centre[k]).powi(2)).sum::<f64>() / (count - 1.0)).sqrt();
        let expected = of(&plan, quantity).expect("identified")[0];
        // a standard deviation from 400 draws has a relative standard error of 1/√800 = 3.5 %
        let away = (spread / expected - 1.0) * (2.0 * count).sqrt();
        assert!(away.abs() < 4.0, "{quantity:?}: spread {spread} against {expected}, {away:.1} standard errors");
    }
}
