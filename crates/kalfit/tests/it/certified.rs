//! What is called certified is a maximum, to no better than rounding lets it be; and what is symmetric is so to the last bit.

use kalfit::build::{Columns, constant, measurement, name};
use kalfit::estimate::{Estimate, Solver, Stop};
use kalfit::infer::{self, Choices, DeletionChoice};
use kalfit::model::{CovarianceStructure, MeanStructure, Regression};
use kalfit::{Fit, Model};
use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::simulated::structures::structures;
use crate::simulated::{Assumed, Recipe, changed, dense, ensemble, fit, normal};

/// Six levels about `offset`, ten measurements of noise one each: the same to the last bit, but for the offset.
fn levels(offset: f64) -> Fit {
    let model = Model::builder("Levels")
        .state(constant("level"))
        .measurement(measurement("y", name("level"), 1.0))
        .build()
        .expect("a model");
    let mut random = ChaCha8Rng::seed_from_u64(1);
    // numbers of eight bits behind the point, which beside the offset are exact
    let exact = |x: f64| (x * 256.0).round() / 256.0;
    let tests: Vec<Columns> = (0..6)
        .map(|j| {
            let level = 2.0 * normal(&mut random);
            let y: Vec<f64> = (0..10).map(|_| offset + exact(level + normal(&mut random))).collect();
            Columns::new(format!("t{j}")).numbers("y", y)
        })
        .collect();
    kalfit::fit(&model, &tests).expect("a fit")
}

#[test]
fn the_certificate_knows_what_rounding_leaves_open() {
    let plain = levels(0.0);
    let error = plain.inference.uncertainty.errors.mean[0].expect("the mean is free");
    assert!(plain.converged() && plain.record.certificate.rounding < 1e-15, "{:?}", plain.record.certificate);
    for (offset, told, certified) in [
        (1e3, false, true),
        (1e6, false, true),
        (1e8, false, true),
        (1e10, true, true),
        (5e11, true, true),
        (2e12, true, false),
        (1e13, true, false),
    ] {
        let found = levels(offset);
        let (certificate, limit) = (&found.record.certificate, found.record.certificate.rounding);
        let off = (found.estimate.mean[0] - offset - plain.estimate.mean[0]).abs() / error;
        let variance_off = (found.estimate.covariance[(0, 0)] - plain.estimate.covariance[(0, 0)]).abs()
            / plain.inference.uncertainty.errors.covariance[0][0].expect("it is free");
        let what =
            format!("offset {offset:e}: off by {off:.1e} and {variance_off:.1e} standard errors, bound {limit:.1e}");
        println!("{what}");
        assert!(off <= limit && variance_off <= limit, "{what}");
        let expected = offset * f64::EPSILON / error;
        assert!(
            limit < 4.0 * expected && limit > expected,
            "{what}: {expected:.1e} is ε times the mean, in standard errors"
        );
        assert!(certificate.mean >= limit && certificate.covariance >= limit, "{what}: {certificate:?}");
        assert_eq!(found.converged(), certified, "{what}: {}", found.record.reason);
        let notes = found.record.notes.iter().filter(|note| note.contains("rounding")).count();
        assert_eq!(notes, usize::from(told), "{what}: {:?}", found.record.notes);
        assert_eq!(found.record.reason.contains("rounding"), !certified, "{what}: {}", found.record.reason);
        assert!(!told || found.record.notes[0].contains("`level`"), "{what}: {:?}", found.record.notes);
    }
}

/// Wherever a column counts from, and however large the coefficient, what is centred costs no rounding.
#[test]
fn a_regression_far_from_zero_costs_no_rounding() {
    let recipe =
        Recipe { p: 1, tests: 40, rank: 1, observed: 1, strength: 3.0, designs: 40, regressors: 1, mild: true };
    let regression = vec![Regression { element: 0, column: 0 }];
    let assumed = Assumed::ml(MeanStructure { regression, ..MeanStructure::free(1) }, CovarianceStructure::full());
    let slope = 1e8;
    let at = |offset: f64| {
        let data = changed(&ensemble(recipe, 5), |_, test| {
            test.data[0] += test.factor[0] * slope * test.covariates[0];
            test.covariates[0] += offset;
        });
        fit(&data, &assumed, Solver::Newton)
    };
    let (near, far) = (at(0.0), at(1e4));
    for found in [&near, &far] {
        let off = (found.coefficients[0] / slope - 1.0).abs();
        assert!(off < 1e-6, "the coefficient is {}, drawn with {slope}", found.coefficients[0]);
        let limit = found.certificate.rounding.max(1e-6);
        assert!(found.certificate.mean < limit, "the score is no more than rounding: {:?}", found.certificate);
    }
    assert!(near.certificate.rounding < 1e-6, "{:?}", near.certificate);
    assert!(far.certificate.rounding < 1e-6, "{:?}", far.certificate);
}

/// Moves of mean and Σ that stay feasible, in the sizes of the estimates, and ℓ there by dense algebra.
fn best_neighbour(data: &kalfit::Reductions, found: &Estimate, seed: u64) -> f64 {
    let p = found.mean.len();
    let free = MeanStructure::free(p);
    let at = |mean: &DVector<f64>, sigma: &DMatrix<f64>| dense(data, &free, mean, sigma).log_likelihood;
    let mean = DVector::from_column_slice(&found.mean);
    let here = at(&mean, &found.covariance);
    let eigen = found.covariance.clone().symmetric_eigen();
    let root = DMatrix::from_fn(p, p, |i, k| eigen.eigenvectors[(i, k)] * eigen.eigenvalues[k].max(0.0).sqrt());
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut best = f64::NEG_INFINITY;
    for _ in 0..60 {
        let mean_move = DVector::from_fn(p, |_, _| normal(&mut random));
        let root_move = DMatrix::from_fn(p, p, |_, _| normal(&mut random));
        let outward = DVector::from_fn(p, |_, _| normal(&mut random));
        for t in [1e-4, 1e-3, 1e-2, 0.1] {
            let turned = &root + &root_move * t;
            let moves = [
                (&mean + &mean_move * t, found.covariance.clone()),
                (mean.clone(), &turned * turned.transpose()),
                (mean.clone(), &found.covariance + &outward * outward.transpose() * t),
                (&mean - &mean_move * t, &turned * turned.transpose() + &outward * outward.transpose() * (t * t)),
            ];
            best = moves.iter().map(|(mean, sigma)| at(mean, sigma) - here).fold(best, f64::max);
        }
    }
    best
}

#[test]
fn no_feasible_direction_leads_up_from_a_certified_point() {
    let base = Recipe { p: 2, tests: 30, rank: 2, observed: 4, strength: 2.0, designs: 30, regressors: 0, mild: false };
    let recipes = [
        base,
        Recipe { rank: 1, ..base },
        Recipe { p: 3, rank: 1, observed: 5, ..base },
        Recipe { p: 3, rank: 2, observed: 5, strength: 0.5, ..base },
        Recipe { p: 4, rank: 2, observed: 6, designs: 3, ..base },
    ];
    let mut singular = 0;
    for recipe in recipes {
        for seed in 0..8 {
            let data = ensemble(recipe, seed);
            let assumed = Assumed::ml(MeanStructure::free(recipe.p), CovarianceStructure::full());
            let found = fit(&data, &assumed, Solver::Newton);
            assert_eq!(found.stop, Stop::Certified, "{recipe:?} seed {seed}: {:?}", found.certificate);
            singular += usize::from(found.covariance.clone().symmetric_eigenvalues().min() < 1e-9);
            let best = best_neighbour(&data, &found, seed);
            assert!(best < 1e-9 * (1.0 + found.log_likelihood.abs()), "{recipe:?} seed {seed}: ℓ rises by {best:e}");
        }
    }
    assert!(singular >= 10, "of 40 optima only {singular} are on the boundary");
}

fn is_symmetric(what: &str, matrix: &DMatrix<f64>) {
    for i in 0..matrix.nrows() {
        for j in 0..i {
            let (a, b) = (matrix[(i, j)], matrix[(j, i)]);
            assert_eq!(a.to_bits(), b.to_bits(), "{what}: ({i}, {j}) {a:e} and {b:e}");
        }
    }
}

#[test]
fn covariances_are_symmetric_to_the_last_bit() {
    let recipe =
        Recipe { p: 3, tests: 30, rank: 3, observed: 5, strength: 0.7, designs: 20, regressors: 1, mild: true };
    for (structure, assumed) in structures(3) {
        for seed in 0..6 {
            let data = ensemble(recipe, seed);
            let found = fit(&data, &assumed, Solver::Newton);
            let what = format!("{structure}, seed {seed}");
            is_symmetric(&format!("{what}: Σ"), &found.covariance);
            let choices = Choices { deletion: DeletionChoice::All, ..Choices::default() };
            let inferred = infer::infer(&found, &data, choices);
            for (posterior, test) in inferred.posteriors.iter().zip(&data) {
                is_symmetric(&format!("{what}: posterior of {}", test.test), &posterior.covariance(0).into_owned());
            }
            for deletion in inferred.deletions.iter().flatten().flatten() {
                is_symmetric(&format!("{what}: Σ without a test"), &deletion.estimate.covariance);
            }
            let errors = &inferred.uncertainty.errors;
            for (i, j) in [(1, 0), (2, 0), (2, 1)] {
                assert_eq!(errors.covariance[i][j], errors.covariance[j][i], "{what}: standard errors");
                assert_eq!(errors.correlation[i][j], errors.correlation[j][i], "{what}: of correlations");
            }
        }
    }
}

#[test]
fn every_matrix_of_a_record_is_symmetric_to_the_last_bit() {
    let model = Model::builder("Lines")
        .state(constant("start"))
        .state(constant("slope"))
        .state(constant("bend"))
        .measurement(measurement(
            "y",
            name("start") + name("slope") * name("t") + name("bend") * name("t") * name("t"),
            0.1,
        ))
        .build()
        .expect("a model");
    let mut random = ChaCha8Rng::seed_from_u64(8);
    let tests: Vec<Columns> = (0..12)
        .map(|j| {
            let b = [normal(&mut random), 0.3 * normal(&mut random), 0.01 * normal(&mut random)];
            let t: Vec<f64> = (0..6 + j).map(|k| 0.7 * k as f64).collect();
            let y: Vec<f64> = t.iter().map(|t| b[0] + b[1] * t + b[2] * t * t + 0.1 * normal(&mut random)).collect();
            Columns::new(format!("t{j}")).numbers("t", t).numbers("y", y)
        })
        .collect();
    let found = kalfit::fit(&model, &tests).expect("a fit");
    let rows = |of: &[Vec<f64>]| DMatrix::from_fn(3, 3, |i, j| of[i][j]);
    is_symmetric("Σ", &rows(&found.record.phases[0].covariance.estimate));
    let known = |of: &[Vec<Option<f64>>]| DMatrix::from_fn(3, 3, |i, j| of[i][j].expect("it is known"));
    for test in found.record.tests.iter() {
        let part = test.phases.get(0);
        let (posterior, own) = (part.covariance, part.own.expect("enough rows"));
        is_symmetric(&format!("posterior of {}", test.id), &DMatrix::from_fn(3, 3, |i, j| posterior[i][j]));
        is_symmetric(&format!("{} by itself", test.id), &known(&own.covariance));
    }
}
