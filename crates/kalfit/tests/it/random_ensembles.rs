//! The estimator on thousands of random ensembles of reductions: weak and strong information, singular J and Σ, unequal
//! and shared designs, constraints. Everything is compared with naive dense algebra or with the other solver.

use crate::simulated;

use kalfit::estimate::{
    self, Derivatives, Estimate, Likelihood, Settings, Silent, Solver, Stop, Structure, pass_flops,
};
use kalfit::model::{Alpha, CovarianceKind, CovarianceStructure, FixedElement, MeanElement, MeanStructure, Regression};
use kalfit::reduce::Reductions;
use kalfit_fixtures::dense::marginal;
use kalfit_fixtures::near;
use nalgebra::{DMatrix, DVector};
use simulated::{Recipe, changed, ensemble};

/// The density of the reductions, each at its own mean, naively.
fn dense(data: &Reductions, estimate: &Estimate, elements: &[usize]) -> f64 {
    data.iter()
        .map(|reduction| {
            let mut mu = DVector::from_column_slice(&estimate.mean);
            for (c, &i) in elements.iter().enumerate() {
                mu[i] += estimate.coefficients[c] * reduction.covariates[c];
            }
            marginal(reduction, &mu, &estimate.covariance)
        })
        .sum()
}

fn fit(data: &Reductions, mean: &MeanStructure, covariance: &CovarianceStructure, solver: Solver) -> Estimate {
    let alpha = Alpha::default();
    let structure = Structure::single(mean, covariance, &alpha);
    let tolerance = if solver == Solver::Em { 1e-4 } else { 1e-8 };
    let settings = Settings { tolerance, ..Settings::of(solver) };
    estimate::fit(data, &structure, &settings, &mut Silent).expect("a legal problem")
}

fn recipes() -> Vec<Recipe> {
    let base = Recipe { p: 3, tests: 40, rank: 3, observed: 6, strength: 1.0, designs: 40, regressors: 0, mild: false };
    vec![
        Recipe { p: 1, rank: 1, ..base },
        Recipe { p: 2, rank: 1, ..base },
        base,
        Recipe { rank: 1, ..base },
        Recipe { strength: 0.2, ..base },
        Recipe { strength: 30.0, ..base },
        Recipe { strength: 1e4, ..base },
        Recipe { observed: 2, ..base },
        Recipe { designs: 1, tests: 60, ..base },
        Recipe { designs: 5, tests: 100, rank: 2, ..base },
        Recipe { p: 6, rank: 6, tests: 100, designs: 100, observed: 9, ..base },
        Recipe { p: 6, rank: 3, tests: 100, designs: 100, observed: 9, ..base },
        Recipe { p: 10, rank: 10, tests: 200, designs: 200, observed: 14, ..base },
        Recipe { p: 10, rank: 7, tests: 200, designs: 20, observed: 14, ..base },
    ]
}

/// Newton ends certified within 15 passes, and its ℓ is that of the dense density.
#[test]
fn newton_is_certified_in_few_passes_and_its_likelihood_is_the_dense_one() {
    let mut worst = Vec::new();
    for recipe in recipes() {
        let seeds = if recipe.p > 3 { 12 } else { 60 };
        let mut most = 0;
        for seed in 0..seeds {
            let data = ensemble(recipe, seed);
            let mean = MeanStructure::free(recipe.p);
            let found = fit(&data, &mean, &CovarianceStructure::full(), Solver::Newton);
            let what = format!("{recipe:?} seed {seed}: {:?} {:?}", found.certificate, found.trace);
            assert_eq!(found.stop, Stop::Certified, "{what}");
            let expected = dense(&data, &found, &[]);
            let error = (found.log_likelihood - expected).abs() / (1.0 + expected.abs());
            assert!(error < 1e-9, "ℓ {} but dense {expected}; {what}", found.log_likelihood);
            most = most.max(found.passes);
        }
        worst.push((recipe, most));
    }
    for (recipe, most) in &worst {
        println!("{most} passes at most: {recipe:?}");
    }
    assert!(worst.iter().all(|(_, most)| *most <= 15), "{worst:#?}");
}

/// EM and Newton end at the same point; EM is slow, so it is held to its own, looser decrement.
#[test]
fn em_and_newton_end_at_the_same_point() {
    let base = Recipe { p: 2, tests: 30, rank: 2, observed: 4, strength: 2.0, designs: 30, regressors: 0, mild: false };
    let structures = [
        (MeanStructure::free(2), CovarianceStructure::full()),
        (MeanStructure::free(2), CovarianceStructure { kind: CovarianceKind::Diagonal, ..CovarianceStructure::full() }),
        (MeanStructure::free(2), fixed(&[(0, 0, 1.0)])),
        (MeanStructure::free(2), fixed(&[(1, 0, 0.3)])),
        (MeanStructure::free(2), fixed(&[(0, 0, 0.0)])),
        (
            MeanStructure::free(2),
            CovarianceStructure { equal: vec![vec![(0, 0), (1, 1)]], ..CovarianceStructure::full() },
        ),
        (
            MeanStructure { elements: vec![MeanElement::Fixed(1.0), MeanElement::Free], ..MeanStructure::free(2) },
            CovarianceStructure::full(),
        ),
    ];
    for (k, (mean, covariance)) in structures.iter().enumerate() {
        for seed in 0..20 {
            let data = ensemble(base, seed);
            let newton = fit(&data, mean, covariance, Solver::Newton);
            assert_eq!(newton.stop, Stop::Certified, "{k} {seed} {:?} {:?}", newton.certificate, newton.trace);
            let em = fit(&data, mean, covariance, Solver::Em);
            assert!(em.trace.windows(2).all(|w| w[1] >= w[0] - 1e-9), "EM fell: {:?}", em.trace);
            let gap = newton.log_likelihood - em.log_likelihood;
            let slow = if em.stop == Stop::Certified { 1e-7 } else { 1e-2 };
            assert!(
                gap.abs() < slow,
                "{k} {seed}: newton {} em {} ({:?})",
                newton.log_likelihood,
                em.log_likelihood,
                em.stop
            );
        }
    }
}

fn fixed(elements: &[(usize, usize, f64)]) -> CovarianceStructure {
    let fixed = elements.iter().map(|&(i, j, value)| FixedElement { i, j, value }).collect();
    CovarianceStructure { fixed, ..CovarianceStructure::full() }
}

/// Regression coefficients: certified, likelihood dense, and EM (ECM) agrees.
#[test]
fn regressions_are_estimated() {
    for seed in 0..20 {
        let recipe =
            Recipe { p: 3, tests: 60, rank: 3, observed: 5, strength: 1.5, designs: 60, regressors: 2, mild: false };
        let data = ensemble(recipe, seed);
        let regression = vec![Regression { element: 0, column: 0 }, Regression { element: 1, column: 1 }];
        let mean = MeanStructure { regression, ..MeanStructure::free(3) };
        let found = fit(&data, &mean, &CovarianceStructure::full(), Solver::Newton);
        assert_eq!(found.stop, Stop::Certified, "{:?} {:?}", found.certificate, found.trace);
        let expected = dense(&data, &found, &[0, 1]);
        assert!((found.log_likelihood - expected).abs() < 1e-8, "{} dense {expected}", found.log_likelihood);
        let em = fit(&data, &mean, &CovarianceStructure::full(), Solver::Em);
        let gap = found.log_likelihood - em.log_likelihood;
        let slow = if em.stop == Stop::Certified { 1e-7 } else { 2e-2 };
        assert!(gap > -1e-7 && gap < slow, "newton {} em {}", found.log_likelihood, em.log_likelihood);
    }
}

/// Units: rescaling a state rescales the answer and shifts ℓ not at all.
#[test]
fn units_do_not_matter() {
    let recipe =
        Recipe { p: 3, tests: 40, rank: 2, observed: 5, strength: 1.0, designs: 40, regressors: 0, mild: false };
    for seed in 0..20 {
        let data = ensemble(recipe, seed);
        let unit = [1e-6, 1.0, 3e5];
        let rescaled = changed(&data, |_, test| {
            for k in 0..3 {
                (0..=k).for_each(|i| test.factor[i + k * (k + 1) / 2] /= unit[k]);
            }
        });
        let mean = MeanStructure::free(3);
        let one = fit(&data, &mean, &CovarianceStructure::full(), Solver::Newton);
        let other = fit(&rescaled, &mean, &CovarianceStructure::full(), Solver::Newton);
        assert!((one.log_likelihood - other.log_likelihood).abs() < 1e-9);
        for i in 0..3 {
            let (a, b) = (one.mean[i] * unit[i], other.mean[i]);
            assert!((a - b).abs() <= 1e-6 * b.abs(), "mean {a} and {b}");
            let (a, b) = (one.covariance[(i, i)] * unit[i] * unit[i], other.covariance[(i, i)]);
            assert!((a - b).abs() <= 1e-6 * b.abs().max(1e-9 * unit[i] * unit[i]), "variance {a} and {b}");
        }
    }
}

/// A class of tests fitted as one equals the tests fitted apart (here kept apart by a constant covariate nobody uses).
#[test]
fn a_design_class_equals_its_tests_apart() {
    let recipe =
        Recipe { p: 3, tests: 60, rank: 3, observed: 6, strength: 1.0, designs: 4, regressors: 0, mild: false };
    for seed in 0..20 {
        let data = ensemble(recipe, seed);
        let apart = changed(&data, |j, test| test.covariates = vec![j as f64]);
        let mean = MeanStructure::free(3);
        let together = fit(&data, &mean, &CovarianceStructure::full(), Solver::Newton);
        let single = fit(&apart, &mean, &CovarianceStructure::full(), Solver::Newton);
        assert_eq!((together.classes, single.classes), (4, 60));
        assert!((together.log_likelihood - single.log_likelihood).abs() < 1e-9);
        assert!(
            (&together.covariance - &single.covariance).amax() < 1e-6,
            "{} {}",
            together.covariance,
            single.covariance
        );
    }
}

/// Scores and information equal central differences of ℓ, at points far from the optimum and with a singular J.
#[test]
fn derivatives_equal_difference_quotients() {
    let pairs: Vec<(usize, usize)> = (0..3).flat_map(|i| (0..=i).map(move |j| (i, j))).collect();
    for (seed, observed) in [(1, 6), (2, 2), (3, 4)] {
        let recipe =
            Recipe { p: 3, tests: 12, rank: 3, observed, strength: 1.0, designs: 5, regressors: 0, mild: false };
        let likelihood = Likelihood::new(&ensemble(recipe, seed), 3);
        let mean = vec![0.3, -1.0, 2.0];
        let sigma = DMatrix::from_row_slice(3, 3, &[2.0, 0.3, -0.2, 0.3, 1.0, 0.4, -0.2, 0.4, 0.7]);
        let here = likelihood.at(&mean, &sigma, Derivatives::Second);
        let step = 1e-5;
        let moved_mean = |i: usize, h: f64| {
            let mut m = mean.clone();
            m[i] += h;
            likelihood.at(&m, &sigma, Derivatives::First)
        };
        let moved_sigma = |(i, j): (usize, usize), h: f64| {
            let mut s = sigma.clone();
            s[(i, j)] += h;
            s[(j, i)] = s[(i, j)];
            likelihood.at(&mean, &s, Derivatives::First)
        };
        for i in 0..3 {
            let (up, down) = (moved_mean(i, step), moved_mean(i, -step));
            near::mixed(
                "mean score",
                (up.log_likelihood - down.log_likelihood) / (2.0 * step),
                here.mean_score[i],
                1e-7,
            );
            for k in 0..3 {
                let slope = -(up.mean_score[k] - down.mean_score[k]) / (2.0 * step);
                near::mixed("mean information", slope, here.mean_information[(k, i)], 1e-7);
            }
        }
        for (a, &at) in pairs.iter().enumerate() {
            let (up, down) = (moved_sigma(at, step), moved_sigma(at, -step));
            let places = if at.0 == at.1 { 1.0 } else { 2.0 };
            let slope = (up.log_likelihood - down.log_likelihood) / (2.0 * step);
            near::mixed("covariance score", slope, places * here.covariance_score[at], 1e-7);
            for (b, &other) in pairs.iter().enumerate() {
                let places = if other.0 == other.1 { 1.0 } else { 2.0 };
                let slope = -places * (up.covariance_score[other] - down.covariance_score[other]) / (2.0 * step);
                near::mixed(
                    "covariance information",
                    slope,
                    here.covariance_information.as_ref().unwrap()[(a, b)],
                    1e-7,
                );
            }
            for i in 0..3 {
                let slope = -(up.mean_score[i] - down.mean_score[i]) / (2.0 * step);
                near::mixed("cross information", slope, here.cross_information.as_ref().unwrap()[(i, a)], 1e-7);
            }
        }
    }
}

/// Work of a pass, as counted flops a test: a regression gate that no noisy machine can upset.
#[test]
fn passes_cost_what_they_cost() {
    let cost = |p| (p, pass_flops(p, Derivatives::First), pass_flops(p, Derivatives::Second));
    insta::assert_snapshot!(format!("{:?}", [1, 3, 6, 10].map(cost)), @"[(1, 33, 41), (3, 252, 432), (6, 1353, 2991), (10, 5271, 14621)]");
}

/// Equal variances tie blocks together: at zero, what one gains may be what the other loses, and only their sum decides.
#[test]
fn equal_variances_leave_zero_when_their_sum_should() {
    let (mut zeros, mut positive) = (0, 0);
    for seed in 0..80 {
        let recipe =
            Recipe { p: 2, tests: 8, rank: 1, observed: 3, strength: 0.4, designs: 8, regressors: 0, mild: false };
        let data = ensemble(recipe, seed);
        let covariance = CovarianceStructure {
            kind: CovarianceKind::Diagonal,
            equal: vec![vec![(0, 0), (1, 1)]],
            ..CovarianceStructure::full()
        };
        let found = fit(&data, &MeanStructure::free(2), &covariance, Solver::Newton);
        assert_eq!(found.stop, Stop::Certified, "seed {seed}: {:?}", found.certificate);
        let likelihood = Likelihood::new(&data, 2);
        let at = |t: f64| {
            let sigma = DMatrix::identity(2, 2) * t;
            let at = likelihood.at(&[0.0, 0.0], &sigma, Derivatives::First);
            let Some(factor) = at.mean_information.clone().cholesky() else { return f64::NEG_INFINITY };
            let mean = factor.solve(&at.mean_score);
            likelihood.at(mean.as_slice(), &sigma, Derivatives::First).log_likelihood
        };
        let scanned = (0..400).map(|k| 1e-6 * 1.06_f64.powi(k)).chain([0.0]).map(at).fold(f64::NEG_INFINITY, f64::max);
        assert!(found.log_likelihood >= scanned - 1e-9, "seed {seed}: ℓ {} scanned {scanned}", found.log_likelihood);
        let counter = if found.covariance[(0, 0)] == 0.0 { &mut zeros } else { &mut positive };
        *counter += 1;
    }
    assert!(zeros > 5 && positive > 5, "{zeros} at zero, {positive} not");
}
