//! The restricted likelihood against plain matrices, a crude optimiser, EM, and units.

use crate::simulated;

use kalfit::estimate::{Criterion, Estimate, Solver, Stop};
use kalfit::infer;
use kalfit::model::{CovarianceKind, CovarianceStructure, MeanElement, MeanStructure, Regression};
use kalfit::reduce::Reductions;
use kalfit_fixtures::near;
use nalgebra::{DMatrix, DVector};
use simulated::{Assumed, Recipe, beta, changed, dense, ensemble, fit, fixed, simplex};

/// Standard errors of generalised least squares: those of few tests are compared elsewhere.
fn at_known_covariance() -> infer::Choices {
    infer::Choices { df: infer::DfChoice::None, ..infer::Choices::default() }
}

fn base() -> Recipe {
    Recipe { p: 3, tests: 12, rank: 3, observed: 5, strength: 1.5, designs: 12, regressors: 0, mild: false }
}

fn means() -> Vec<MeanStructure> {
    let of = |elements: Vec<MeanElement>| MeanStructure { elements, ..MeanStructure::free(3) };
    let (free, fixed) = (MeanElement::Free, MeanElement::Fixed(0.5));
    let tied = MeanElement::Tied { constant: 0.3, terms: vec![(0, 0.5), (2, -1.0)] };
    let proportional = |w: f64| MeanElement::Proportional(w);
    vec![
        MeanStructure::free(3),
        of(vec![free.clone(), fixed.clone(), free.clone()]),
        of(vec![free.clone(), tied, free.clone()]),
        of(vec![proportional(1.0), proportional(200.0), free]),
        of(vec![fixed.clone(), fixed.clone(), fixed]),
    ]
}

fn covariances() -> Vec<CovarianceStructure> {
    let diagonal = CovarianceStructure { kind: CovarianceKind::Diagonal, ..CovarianceStructure::full() };
    let equal = CovarianceStructure { equal: vec![vec![(0, 0), (1, 1), (2, 2)]], ..CovarianceStructure::full() };
    vec![CovarianceStructure::full(), diagonal, equal, fixed(&[(1, 0, 0.2)]), fixed(&[(2, 2, 0.0)])]
}

fn certified(estimate: &Estimate, what: &str) {
    assert_eq!(estimate.stop, Stop::Certified, "{what}: {:?} {:?}", estimate.certificate, estimate.trace);
    assert_eq!(estimate.criterion, Criterion::Reml);
}

/// ℓ_R, the mean and its standard errors are those of generalised least squares by plain matrices at the estimated Σ.
#[test]
fn the_restricted_likelihood_is_the_dense_one() {
    for seed in 0..6 {
        let data = ensemble(base(), seed);
        for (m, mean) in means().iter().enumerate() {
            for (c, covariance) in covariances().iter().enumerate() {
                let what = format!("seed {seed}, mean {m}, covariance {c}");
                let assumed = Assumed::reml(mean.clone(), covariance.clone());
                let found = fit(&data, &assumed, Solver::Newton);
                certified(&found, &what);
                let plain = dense(&data, mean, &beta(&found, mean), &found.covariance);
                near::mixed(format_args!("ℓ_R, {what}"), found.log_likelihood, plain.restricted, 1e-10);
                near::mixed(
                    format_args!("ℓ at μ̂, {what}"),
                    plain.log_likelihood,
                    at(&data, mean, &plain.beta, &found),
                    1e-12,
                );
                let errors = infer::infer(&found, &data, at_known_covariance()).uncertainty.errors.mean;
                let (_, b) = mean.basis();
                let law = &b * &plain.covariance * b.transpose();
                for i in 0..3 {
                    let expected = Some(law[(i, i)].sqrt()).filter(|e| *e > 0.0);
                    match (errors[i], expected) {
                        (Some(found), Some(expected)) => {
                            near::mixed(format_args!("error of mean {i}, {what}"), found, expected, 1e-8)
                        }
                        (found, expected) => assert_eq!(found, expected, "error of mean {i}, {what}"),
                    }
                }
            }
        }
    }
}

fn at(data: &Reductions, mean: &MeanStructure, beta: &DVector<f64>, found: &Estimate) -> f64 {
    dense(data, mean, beta, &found.covariance).log_likelihood
}

/// Regression coefficients count in q, in the units of their columns.
#[test]
fn regression_coefficients_are_part_of_the_mean() {
    for seed in 0..8 {
        let data = ensemble(Recipe { tests: 20, designs: 20, regressors: 2, ..base() }, seed);
        let data = changed(&data, |_, test| test.covariates[1] *= 1e4);
        let regression = vec![Regression { element: 0, column: 0 }, Regression { element: 2, column: 1 }];
        let mean = MeanStructure { regression, ..MeanStructure::free(3) };
        let found = fit(&data, &Assumed::reml(mean.clone(), CovarianceStructure::full()), Solver::Newton);
        certified(&found, &format!("seed {seed}"));
        let plain = dense(&data, &mean, &beta(&found, &mean), &found.covariance);
        near::mixed("ℓ_R", found.log_likelihood, plain.restricted, 1e-10);
        let inference = infer::infer(&found, &data, at_known_covariance());
        for c in 0..2 {
            near::mixed("coefficient", found.coefficients[c], plain.beta[3 + c], 1e-7);
            let error = inference.uncertainty.errors.coefficients[c].expect("the data inform it");
            let expected = plain.covariance[(3 + c, 3 + c)].sqrt();
            assert!((error / expected - 1.0).abs() < 1e-8, "error {error}, expected {expected}");
        }
    }
}

/// The maximum is one: no crude search from the optimum or from elsewhere finds more, and it ends at the same Σ.
#[test]
fn newton_ends_where_a_crude_search_ends() {
    for seed in 0..6 {
        let recipe = Recipe { p: 2, tests: 7, rank: 2, observed: 4, designs: 7, ..base() };
        let data = ensemble(recipe, seed);
        let mean = MeanStructure::free(2);
        let found = fit(&data, &Assumed::reml(mean.clone(), CovarianceStructure::full()), Solver::Newton);
        certified(&found, &format!("seed {seed}"));
        let sigma = |x: &[f64]| {
            let root = DMatrix::from_row_slice(2, 2, &[x[0], 0.0, x[1], x[2]]);
            &root * root.transpose()
        };
        let zero = DVector::zeros(2);
        let value = |x: &[f64]| dense(&data, &mean, &zero, &sigma(x)).restricted;
        let (end, best) = simplex(&[0.8, 0.0, 0.8], &value);
        near::mixed(format_args!("ℓ_R, seed {seed}"), found.log_likelihood, best, 1e-9);
        let gap = (sigma(&end) - &found.covariance).amax() / found.covariance.amax();
        assert!(gap < 1e-3, "seed {seed}: {} {} {gap:.1e}", sigma(&end), found.covariance);
    }
}

/// The information on Σ is minus the second derivative of the dense ℓ_R: its standard errors are those of differences.
#[test]
fn standard_errors_of_the_covariance_are_those_of_difference_quotients() {
    let elements = [(0, 0), (1, 0), (1, 1)];
    for seed in 0..5 {
        let recipe = Recipe { p: 2, tests: 16, rank: 2, observed: 4, strength: 6.0, designs: 16, ..base() };
        let data = ensemble(recipe, seed);
        let mean = MeanStructure::free(2);
        let found = fit(&data, &Assumed::reml(mean.clone(), CovarianceStructure::full()), Solver::Newton);
        let zero = DVector::zeros(2);
        let value = |steps: [f64; 3]| {
            let mut sigma = found.covariance.clone();
            for (k, (i, j)) in elements.into_iter().enumerate() {
                sigma[(i, j)] += steps[k];
                sigma[(j, i)] = sigma[(i, j)];
            }
            dense(&data, &mean, &zero, &sigma).restricted
        };
        // small beside the smallest variance too, so that the differences stay inside the cone
        let h = 3e-4 * found.covariance.symmetric_eigenvalues().min();
        let unit = |k: usize, s: f64| std::array::from_fn(|i| if i == k { s * h } else { 0.0 });
        let plus = |a: [f64; 3], b: [f64; 3]| std::array::from_fn(|i| a[i] + b[i]);
        let second = DMatrix::from_fn(3, 3, |a, b| {
            let at = |s: f64, t: f64| value(plus(unit(a, s), unit(b, t)));
            -(at(1.0, 1.0) - at(1.0, -1.0) - at(-1.0, 1.0) + at(-1.0, -1.0)) / (4.0 * h * h)
        });
        let law = second.try_inverse().expect("a maximum");
        let errors = infer::infer(&found, &data, infer::Choices::default()).uncertainty.errors.covariance;
        for (k, (i, j)) in elements.into_iter().enumerate() {
            let (found, expected) = (errors[i][j].expect("inside"), law[(k, k)].sqrt());
            assert!(
                (found / expected - 1.0).abs() < 1e-3,
                "seed {seed}: error of {i}{j} {found}, by differences {expected}"
            );
        }
    }
}

/// The fit without each test is that of the others by themselves; also where a test alone says what a coefficient is.
#[test]
fn deletion_equals_refitting_the_others() {
    let regression = MeanStructure { regression: vec![Regression { element: 1, column: 0 }], ..MeanStructure::free(3) };
    for (seed, mean) in [(0, MeanStructure::free(3)), (1, means().remove(2)), (2, regression.clone()), (3, regression)]
    {
        let regressors = mean.regression.len();
        let mut data = ensemble(Recipe { regressors, designs: 8, ..base() }, seed);
        if seed == 3 {
            data = changed(&data, |j, test| test.covariates = vec![if j == 5 { 2.0 } else { 0.0 }]);
        }
        let assumed = Assumed::reml(mean, CovarianceStructure::full());
        let all = fit(&data, &assumed, Solver::Newton);
        certified(&all, "all");
        let deletions = infer::deletions(&all, &data);
        for (j, deletion) in deletions.iter().enumerate() {
            let others: Vec<usize> = (0..data.len()).filter(|other| *other != j).collect();
            let again = fit(&data.select(&others), &assumed, Solver::Newton);
            let what = format!("seed {seed}, without test {j}");
            certified(&again, &what);
            let found = deletion.as_ref().expect("the others have an optimum");
            let of = |mean: &[f64], covariance: &DMatrix<f64>| [mean, covariance.as_slice()].concat();
            let (own, other) =
                (of(&found.estimate.mean, &found.estimate.covariance), of(&again.mean, &again.covariance));
            own.iter().zip(&other).for_each(|(x, y)| near::mixed(&what, *x, *y, 1e-5));
            if seed != 3 {
                found
                    .estimate
                    .coefficients
                    .iter()
                    .zip(&again.coefficients)
                    .for_each(|(x, y)| near::mixed(&what, *x, *y, 1e-5));
            }
            assert!(found.displacement >= 0.0 && found.displacement.is_finite(), "{what}: {}", found.displacement);
        }
    }
}

/// EM never falls and ends where Newton's method ends.
#[test]
fn em_and_newton_end_at_the_same_point() {
    let mut arrived = 0;
    for seed in 0..6 {
        let data = ensemble(Recipe { strength: 4.0, ..base() }, seed);
        for (m, mean) in means().iter().enumerate() {
            for (c, covariance) in covariances().iter().enumerate() {
                let assumed = Assumed::reml(mean.clone(), covariance.clone());
                let newton = fit(&data, &assumed, Solver::Newton);
                let em = fit(&data, &assumed, Solver::Em);
                let what = format!("seed {seed}, mean {m}, covariance {c}: {:?}", em.stop);
                certified(&newton, &what);
                assert!(em.trace.windows(2).all(|w| w[1] >= w[0] - 1e-9), "EM fell, {what}: {:?}", em.trace);
                let gap = newton.log_likelihood - em.log_likelihood;
                // towards a nearly singular optimum EM creeps, and has not arrived when the passes run out
                // equal variances where the true ones are not: EM may end at another, lower maximum
                let elsewhere = !covariance.equal.is_empty();
                let slow = if em.stop == Stop::Certified && !elsewhere { 1e-7 } else { f64::INFINITY };
                arrived += usize::from(em.stop == Stop::Certified);
                assert!(gap > -1e-8 && gap < slow, "{what}: newton {} em {}", newton.log_likelihood, em.log_likelihood);
            }
        }
    }
    assert!(arrived > 100, "EM arrived in {arrived} of 150 fits only");
}

/// In other units ℓ_R moves by the log of the units of the free means, and by nothing else.
#[test]
fn units_shift_the_restricted_likelihood_by_their_jacobian() {
    let unit = [1e-6, 1.0, 3e5];
    for seed in 0..10 {
        let data = ensemble(base(), seed);
        let rescaled = changed(&data, |_, test| {
            for k in 0..3 {
                (0..=k).for_each(|i| test.factor[i + k * (k + 1) / 2] /= unit[k]);
            }
        });
        let assumed = Assumed::reml(MeanStructure::free(3), CovarianceStructure::full());
        let (one, other) = (fit(&data, &assumed, Solver::Newton), fit(&rescaled, &assumed, Solver::Newton));
        let shift: f64 = unit.iter().map(|u| f64::ln(*u)).sum();
        near::mixed("ℓ_R", other.log_likelihood, one.log_likelihood + shift, 1e-9);
        for i in 0..3 {
            let scaled = one.covariance[(i, i)] * unit[i] * unit[i];
            let (found, expected) = (other.covariance[(i, i)] / scaled.max(1e-9 * unit[i] * unit[i]), 1.0);
            assert!(
                (found - expected).abs() < 1e-5 || scaled < 1e-9 * unit[i] * unit[i],
                "variance {i}: ratio {found}"
            );
        }
    }
}

/// A mean that no test informs has no place in the determinant: ℓ_R is that of the model without it.
#[test]
fn a_mean_that_no_test_informs_does_not_count() {
    for seed in 0..5 {
        let inner = ensemble(Recipe { p: 2, ..base() }, seed);
        let outer = changed(&inner, |_, test| {
            test.factor.extend([0.0, 0.0, 0.0]);
            test.data.push(0.0);
        });
        let diagonal = CovarianceStructure { kind: CovarianceKind::Diagonal, ..CovarianceStructure::full() };
        let small = fit(&inner, &Assumed::reml(MeanStructure::free(2), diagonal.clone()), Solver::Newton);
        let large = fit(&outer, &Assumed::reml(MeanStructure::free(3), diagonal), Solver::Newton);
        certified(&large, &format!("seed {seed}"));
        near::mixed("ℓ_R", large.log_likelihood, small.log_likelihood, 1e-11);
        let inference = infer::infer(&large, &outer, infer::Choices::default());
        assert_eq!(inference.uncertainty.errors.mean[2], None, "no error without information");
        assert!(inference.uncertainty.errors.mean[0].is_some());
    }
}

/// Two means of which only the sum is seen: the product of the non-zero eigenvalues of C, by hand.
#[test]
fn a_direction_that_no_test_informs_does_not_count() {
    let seen = ensemble(Recipe { p: 1, rank: 1, observed: 1, ..base() }, 3);
    let sums = changed(&seen, |_, test| {
        let r = test.factor[0];
        test.factor = vec![r, 3.0 * r, 0.0]; // R = [r 3r; 0 0]
        test.data.push(0.0);
    });
    let only_first = fixed(&[(1, 1, 0.0)]);
    let one = fit(&seen, &Assumed::reml(MeanStructure::free(1), CovarianceStructure::full()), Solver::Newton);
    let both = fit(&sums, &Assumed::reml(MeanStructure::free(2), only_first), Solver::Newton);
    // C = c [1 3; 3 9], whose non-zero eigenvalue is 10 c
    near::mixed("ℓ_R", both.log_likelihood, one.log_likelihood - 0.5 * 10.0_f64.ln(), 1e-11);
}
