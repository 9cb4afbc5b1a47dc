//! Each phase by itself: the paper's quick analysis is the fit of the phases' least-squares differences.

use kalfit::estimate::{Combination, Criterion, FitError, Settings, Silent, Stop};
use kalfit::infer::{NotNested, StdErrors, likelihood_ratio, uncertainty};
use kalfit::model::{Alpha, CovarianceStructure, MeanStructure};
use kalfit::reduce::{ChainPhase, Path, Reduction, ReductionRef, Reductions};
use kalfit_fixtures::dense::{log_density, unpacked};
use nalgebra::{DMatrix, DVector};

use super::fits::{Phases, by, fit, structure};
use super::{Joint, Recipe, ensemble};

/// Two phases, both observable in every test, all states inherited.
fn data() -> (Recipe, Reductions) {
    let recipe = Recipe {
        tests: 40,
        designs: 40,
        own: vec![2, 2],
        heirs: vec![0, 0],
        observed: 9,
        strength: 1.5,
        missing: true,
        root: DMatrix::identity(4, 4),
        ..Recipe::two()
    };
    // a phase with fewer rows than states has no least-squares estimate
    let observable = |r: &ReductionRef<'_>| {
        let regular = |phase: &ChainPhase| unpacked(&phase.factor, 2).diagonal().iter().all(|x| x.abs() > 0.3);
        r.chain.expect("made so").phases.iter().all(regular)
    };
    let data = ensemble(&recipe, 2).iter().filter(observable).collect();
    (recipe, data)
}

/// (x_LS,i - what the phase before makes of its own, covariance of its error).
fn differences(reduction: ReductionRef<'_>) -> Vec<(DVector<f64>, DMatrix<f64>)> {
    let chain = reduction.chain.expect("made so");
    let solved = |phase: &ChainPhase| {
        let r = unpacked(&phase.factor, 2);
        let inverse = r.try_inverse().expect("observable");
        (&inverse * DVector::from_column_slice(&phase.data), &inverse * inverse.transpose())
    };
    let mut found: Vec<(DVector<f64>, DMatrix<f64>)> = Vec::new();
    let mut before: Option<(DVector<f64>, DMatrix<f64>)> = None;
    for phase in &chain.phases {
        let (x, p) = solved(phase);
        found.push(match (&phase.link, &before) {
            (Some(link), Some((x_before, p_before))) => (
                &x - &link.mean - &link.sensitivity * x_before,
                &p + &link.sensitivity * p_before * link.sensitivity.transpose() + &link.root * link.root.transpose(),
            ),
            _ => (x.clone(), p.clone()),
        });
        before = Some((x, p));
    }
    found
}

#[test]
fn the_marginal_fit_is_that_of_the_differences_phase_by_phase() {
    let (recipe, data) = data();
    let phases: Phases = vec![
        (MeanStructure::free(2), CovarianceStructure::full()),
        (MeanStructure::free(2), CovarianceStructure::full()),
    ];
    let settings = by(Combination::Marginal);
    let found = fit(&data, &phases, &settings);
    assert_eq!(found.stop, Stop::Certified, "{:?}", found.certificate);
    let errors = uncertainty(&found, &data, &[], StdErrors::Observed).errors;
    let mut composite = 0.0;
    for (f, range) in recipe.ranges().into_iter().enumerate() {
        let own: Vec<(String, DVector<f64>, DMatrix<f64>)> = data
            .iter()
            .filter_map(|r| differences(r).into_iter().nth(f).map(|(x, p)| (r.test.to_owned(), x, p)))
            .collect();
        let reductions: Reductions = own.iter().map(|(test, x, p)| reduction(test, x, p)).collect();
        let one = vec![(MeanStructure::free(2), CovarianceStructure::full())];
        let apart = fit(&reductions, &one, &Settings::default());
        let apart_errors = uncertainty(&apart, &reductions, &[], StdErrors::Observed).errors;
        for (i, at) in range.clone().enumerate() {
            let (a, b) = (found.mean[at], apart.mean[i]);
            assert!((a - b).abs() < 1e-6, "phase {f} μ {i}: {a} {b}");
            let (a, b) = (errors.mean[at].expect("free"), apart_errors.mean[i].expect("free"));
            assert!((a - b).abs() < 1e-6, "phase {f} error of μ {i}: {a} {b}");
            for (k, other) in range.clone().enumerate() {
                let (a, b) = (found.covariance[(at, other)], apart.covariance[(i, k)]);
                assert!((a - b).abs() < 1e-6, "phase {f} Σ {i} {k}: {a} {b}");
                let (a, b) = (errors.covariance[at][other], apart_errors.covariance[i][k]);
                let (a, b) = (a.expect("free"), b.expect("free"));
                assert!((a - b).abs() < 1e-6, "phase {f} error of Σ {i} {k}: {a} {b}");
            }
        }
        let mu = DVector::from_column_slice(&found.mean[range.clone()]);
        let sigma = found.covariance.view((range.start, range.start), (2, 2)).clone_owned();
        composite += own.iter().map(|(_, x, p)| log_density(&(x - &mu), &(&sigma + p))).sum::<f64>();
    }
    let maximised = found.composite.expect("several phases");
    assert!((maximised - composite).abs() < 1e-8 * composite.abs(), "{maximised} {composite}");
    let mu = DVector::from_column_slice(&found.mean);
    let joint =
        |r: ReductionRef<'_>| Joint::of(r.chain.expect("made so"), &recipe.own).log_density(&mu, &found.covariance);
    let joint: f64 = data.iter().map(joint).sum();
    assert!((found.log_likelihood - joint).abs() < 1e-9 * joint.abs(), "{} {joint}", found.log_likelihood);
    let best = fit(&data, &phases, &Settings::default());
    assert!(best.log_likelihood > found.log_likelihood, "{} {}", best.log_likelihood, found.log_likelihood);
    assert_eq!(best.composite, None);
    assert_eq!(likelihood_ratio(&found, &best), Err(NotNested::Marginal));
}

fn reduction(test: &str, x: &DVector<f64>, p: &DMatrix<f64>) -> Reduction {
    let upper = p.clone().try_inverse().expect("regular").cholesky().expect("regular").l().transpose();
    let data = &upper * x;
    Reduction {
        test: test.to_owned(),
        constant: 0.0,
        residual: None,
        data: data.as_slice().to_vec(),
        factor: vec![upper[(0, 0)], upper[(0, 1)], upper[(1, 1)]],
        covariates: Vec::new(),
        steps: 1,
        observations: 1,
        path: Path::Information,
        design: 0,
        chain: None,
        exact: None,
    }
}

/// Phases that cannot be observed alone, states that only inherit: there is an answer, and it is certified.
#[test]
fn phases_without_a_least_squares_estimate_have_a_marginal_fit() {
    for seed in 0..4 {
        let recipe = Recipe { tests: 60, designs: 60, missing: true, ..Recipe::two() };
        let data = ensemble(&recipe, seed);
        let phases: Phases = vec![
            (MeanStructure::free(2), CovarianceStructure::full()),
            (MeanStructure::free(3), CovarianceStructure::full()),
        ];
        let found = fit(&data, &phases, &by(Combination::Marginal));
        assert_eq!(found.stop, Stop::Certified, "seed {seed}: {:?}", found.certificate);
        assert!(found.composite.is_some_and(f64::is_finite) && found.log_likelihood.is_finite());
        let exact = fit(&data, &phases, &Settings::default());
        assert!(exact.log_likelihood >= found.log_likelihood, "{} {}", exact.log_likelihood, found.log_likelihood);
    }
}

#[test]
fn what_has_no_marginal_meaning_is_refused() {
    let (_, data) = data();
    let phases: Phases = vec![
        (MeanStructure::free(2), CovarianceStructure::full()),
        (MeanStructure::free(2), CovarianceStructure::full()),
    ];
    let alpha = Alpha::default();
    let refused = |data: &Reductions, settings: &Settings| {
        kalfit::estimate::fit(data, &structure(&phases, &alpha), settings, &mut Silent).expect_err("refused")
    };
    let restricted = Settings { criterion: Criterion::Reml, ..by(Combination::Marginal) };
    assert_eq!(refused(&data, &restricted), FitError::RestrictedMarginal);
    let apart: Reductions = data.iter().map(|r| ReductionRef { chain: None, exact: None, ..r }).collect();
    let test = apart.get(0).test.to_owned();
    assert_eq!(refused(&apart, &by(Combination::Marginal)), FitError::NoPhases { test });
}
