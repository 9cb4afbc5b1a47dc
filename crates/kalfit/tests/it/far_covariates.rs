//! Covariates far from zero and in any unit: estimates, standard errors and intervals are those of the covariate about
//! zero, transformed.

use kalfit::estimate::{Criterion, Solver, Stop};
use kalfit::infer::{self, Choices, DeletionChoice, Estimated, Inference, IntervalKind};
use kalfit::model::{CovarianceStructure, MeanElement, MeanStructure, Regression};
use kalfit::reduce::Reductions;
use kalfit_fixtures::near;

use crate::simulated::{Assumed, Recipe, changed, ensemble, fit, fixed};

/// Twenty tests of three states with so many covariates.
fn tests(regressors: usize, seed: u64) -> Reductions {
    ensemble(
        Recipe { p: 3, tests: 20, rank: 3, observed: 5, strength: 1.5, designs: 20, regressors, mild: false },
        seed,
    )
}

/// The first covariate x becomes unit (x + offset).
fn moved(data: &Reductions, offset: f64, unit: f64) -> Reductions {
    changed(data, |_, test| test.covariates[0] = unit * (test.covariates[0] + offset))
}

/// Two covariates act on the first state, a third on the last.
fn regression() -> MeanStructure {
    let regression = [(0, 0), (0, 1), (2, 2)].map(|(element, column)| Regression { element, column });
    MeanStructure { regression: regression.to_vec(), ..MeanStructure::free(3) }
}

fn of(inference: &Inference, a: Estimated, b: Estimated) -> f64 {
    let estimates = inference.estimates.as_ref().expect("the covariance of the estimates");
    let at = |what| estimates.quantities.iter().position(|own| *own == what).expect("an estimate");
    estimates.covariance[(at(a), at(b))]
}

#[test]
fn estimates_follow_the_zero_and_the_unit_of_a_covariate() {
    let choices = Choices { deletion: DeletionChoice::None, intervals: IntervalKind::Profile, ..Choices::default() };
    for (seed, criterion, covariance) in [
        (1, Criterion::Ml, CovarianceStructure::full()),
        (2, Criterion::Ml, fixed(&[(1, 1, 0.0)])),
        (3, Criterion::Reml, CovarianceStructure::full()),
        (4, Criterion::Reml, fixed(&[(0, 2, 0.0), (1, 1, 0.0)])),
    ] {
        let (data, assumed) = (tests(3, seed), Assumed { mean: regression(), covariance, criterion });
        let choices = match criterion {
            Criterion::Ml => choices,
            Criterion::Reml => Choices { intervals: IntervalKind::Wald, ..choices },
        };
        let known = fit(&data, &assumed, Solver::Newton);
        let expected = infer::infer(&known, &data, choices);
        for (offset, unit) in [(300.0, 1.0), (-1e5, 1e-6), (1e7, 1.0), (2e7, 1e6)] {
            let what = format!("seed {seed}, (x + {offset}) * {unit}");
            let data = moved(&data, offset, unit);
            let found = fit(&data, &assumed, Solver::Newton);
            assert_eq!(found.stop, Stop::Certified, "{what}");
            let jacobian = if criterion == Criterion::Reml { f64::ln(unit) } else { 0.0 };
            // the column itself is rounded to 16 digits
            let rounding = 1e-8 + 2e-15 * offset.abs();
            near::mixed(&what, found.log_likelihood - known.log_likelihood, -jacobian, rounding);
            near::mixed(&what, (&found.covariance - &known.covariance).amax(), 0.0, 1e-5);
            near::mixed(&what, found.coefficients[0] * unit, known.coefficients[0], 1e-6);
            near::mixed(&what, found.coefficients[1], known.coefficients[1], 1e-6);
            near::mixed(&what, found.mean[1], known.mean[1], 1e-6);
            // the mean at the covariate that was zero
            let at_zero = found.mean[0] + found.coefficients[0] * unit * offset;
            near::mixed(&what, at_zero, known.mean[0], 1e-16 * offset.abs() * found.mean[0].abs().max(1e8));
            let inference = infer::infer(&found, &data, choices);
            let (own, other) = (&inference.uncertainty.errors, &expected.uncertainty.errors);
            let pairs = [
                (own.mean[1], other.mean[1]),
                (own.std_dev[0], other.std_dev[0]),
                (own.coefficients[0].map(|error| error * unit), other.coefficients[0]),
                (own.coefficients[2], other.coefficients[2]),
            ];
            for (own, other) in pairs {
                assert_eq!(own.is_some(), other.is_some(), "{what}");
                near::mixed(&what, own.unwrap_or(0.0), other.unwrap_or(0.0), 1e-5);
            }
            if criterion == Criterion::Ml {
                // Var(μ - γ offset); with few tests REML's errors have a law of their own
                let (mean, slope) = (Estimated::Mean(0), Estimated::Coefficient(0));
                let variance = of(&expected, mean, mean) - 2.0 * offset * of(&expected, mean, slope)
                    + offset * offset * of(&expected, slope, slope);
                let error = own.mean[0].expect("the data inform it");
                assert!((error / variance.sqrt() - 1.0).abs() < 1e-5, "{what}: {error}, expected {}", variance.sqrt());
            }
            let ends = |all: &Inference, unit: f64| {
                all.intervals.ends.coefficients[0].expect("an interval").map(|end| end.expect("an end") * unit)
            };
            let (own, other) = (ends(&inference, unit), ends(&expected, 1.0));
            (0..2).for_each(|k| near::mixed(&what, own[k], other[k], 1e-5));
        }
    }
}

/// Elements that are fixed, or that others are tied to, keep the covariate as it is: the model says that the mean at
/// covariate zero is known.
#[test]
fn a_fixed_mean_is_that_at_covariate_zero() {
    let data = tests(2, 5);
    let mean = |first: MeanElement| {
        let tied = MeanElement::Tied { constant: 0.25, terms: vec![(1, 2.0)] };
        let regression = [(0, 0), (1, 1)].map(|(element, column)| Regression { element, column }).to_vec();
        MeanStructure { elements: vec![first, MeanElement::Free, tied], regression, ..MeanStructure::free(3) }
    };
    let fit = |data: &Reductions, first: MeanElement| {
        fit(data, &Assumed::ml(mean(first), CovarianceStructure::full()), Solver::Newton)
    };
    let free = fit(&data, MeanElement::Free);
    let held = fit(&data, MeanElement::Fixed(free.mean[0]));
    near::mixed("ℓ", held.log_likelihood, free.log_likelihood, 1e-9);
    near::mixed("coefficient", held.coefficients[0], free.coefficients[0], 1e-5);
    let offset = 3.0;
    let moved = moved(&data, offset, 1.0);
    let (other, there) = (fit(&moved, MeanElement::Fixed(free.mean[0])), fit(&moved, MeanElement::Free));
    near::mixed("ℓ", there.log_likelihood, free.log_likelihood, 1e-9);
    near::mixed("mean", there.mean[0], free.mean[0] - offset * free.coefficients[0], 1e-5);
    assert!(other.log_likelihood < free.log_likelihood - 1e-3, "another model: {}", other.log_likelihood);
    near::mixed("tie", there.mean[2], 0.25 + 2.0 * there.mean[1], 1e-12);
}
