//! Linear covariance structures against dense algebra and against the same models said otherwise.

use crate::simulated;

use kalfit::estimate::{Estimate, FitError, Solver, Stop};
use kalfit::infer;
use kalfit::model::{CovarianceKind, CovarianceStructure, MeanStructure, StructureError};
use kalfit::reduce::Reductions;
use nalgebra::{DMatrix, DVector};
use simulated::{Assumed, Recipe, beta, dense, ensemble, fit, fixed, simplex, try_fit};

fn base() -> Recipe {
    Recipe { p: 3, tests: 40, rank: 3, observed: 5, strength: 2.0, designs: 40, regressors: 0, mild: false }
}

fn linear(constant: DMatrix<f64>, generators: Vec<DMatrix<f64>>) -> CovarianceStructure {
    CovarianceStructure { kind: CovarianceKind::Linear { constant, generators }, ..CovarianceStructure::full() }
}

fn assumed(covariance: CovarianceStructure) -> Assumed {
    Assumed::ml(MeanStructure::free(3), covariance)
}

/// Ones where |i - j| = k.
fn band(p: usize, k: usize) -> DMatrix<f64> {
    DMatrix::from_fn(p, p, |i, j| if i.abs_diff(j) == k { 1.0 } else { 0.0 })
}

fn unit(p: usize, i: usize, j: usize) -> DMatrix<f64> {
    DMatrix::from_fn(p, p, |a, b| if (a, b) == (i, j) || (a, b) == (j, i) { 1.0 } else { 0.0 })
}

fn toeplitz(p: usize) -> CovarianceStructure {
    linear(DMatrix::zeros(p, p), (0..p).map(|k| band(p, k)).collect())
}

fn certified(estimate: &Estimate, what: &str) {
    assert_eq!(estimate.stop, Stop::Certified, "{what}: {:?} {:?}", estimate.certificate, estimate.trace);
    assert!(estimate.passes <= 15, "{what}: {} passes: {:?}", estimate.passes, estimate.trace);
}

fn close(what: &str, a: &Estimate, b: &Estimate) {
    let gap = (a.log_likelihood - b.log_likelihood).abs();
    assert!(gap < 1e-8, "{what}: ℓ {} and {}", a.log_likelihood, b.log_likelihood);
    let gap = (&a.covariance - &b.covariance).amax() / a.covariance.amax().max(1.0);
    assert!(gap < 1e-6, "{what}: Σ {} and {}", a.covariance, b.covariance);
    assert_eq!(a.declared_covariance(), b.declared_covariance(), "{what}: declared");
}

/// Full, diagonal, fixed and equal elements are linear structures too: the same optimum and the same standard errors.
#[test]
fn structures_said_otherwise_are_the_same() {
    let zero = DMatrix::zeros(3, 3);
    let pairs: Vec<(usize, usize)> = (0..3).flat_map(|i| (0..=i).map(move |j| (i, j))).collect();
    let all = |but: &[(usize, usize)]| {
        pairs.iter().filter(|p| !but.contains(p)).map(|&(i, j)| unit(3, i, j)).collect::<Vec<_>>()
    };
    let diagonal = CovarianceStructure { kind: CovarianceKind::Diagonal, ..CovarianceStructure::full() };
    let equal = CovarianceStructure { equal: vec![vec![(0, 0), (1, 1)]], ..CovarianceStructure::full() };
    let mut shared = all(&[(0, 0), (1, 1)]);
    shared.push(unit(3, 0, 0) + unit(3, 1, 1));
    let cases = [
        ("full", CovarianceStructure::full(), linear(zero.clone(), all(&[]))),
        ("diagonal", diagonal, linear(zero.clone(), all(&[(1, 0), (2, 0), (2, 1)]))),
        ("equal", equal, linear(zero.clone(), shared)),
        ("fixed covariance", fixed(&[(1, 0, 0.3)]), linear(unit(3, 1, 0) * 0.3, all(&[(1, 0)]))),
        ("fixed variance", fixed(&[(1, 1, 0.8)]), linear(unit(3, 1, 1) * 0.8, all(&[(1, 1)]))),
        ("no variance", fixed(&[(2, 2, 0.0)]), linear(zero.clone(), all(&[(2, 0), (2, 1), (2, 2)]))),
        (
            "known",
            fixed(&[(0, 0, 1.0), (1, 1, 2.0), (2, 2, 0.5), (1, 0, 0.0), (2, 0, 0.0), (2, 1, 0.0)]),
            linear(DMatrix::from_diagonal(&DVector::from_vec(vec![1.0, 2.0, 0.5])), Vec::new()),
        ),
    ];
    for seed in 0..8 {
        let data = ensemble(base(), seed);
        for (what, one, other) in &cases {
            let what = format!("{what}, seed {seed}");
            let (a, b) = (
                fit(&data, &assumed(one.clone()), Solver::Newton),
                fit(&data, &assumed(other.clone()), Solver::Newton),
            );
            certified(&b, &what);
            close(&what, &a, &b);
            let (a, b) = {
                let of = |e| infer::infer(e, &data, infer::Choices::default());
                (of(&a), of(&b))
            };
            for (x, y) in
                a.uncertainty.errors.covariance.iter().flatten().zip(b.uncertainty.errors.covariance.iter().flatten())
            {
                match (x, y) {
                    (Some(x), Some(y)) => assert!((x / y - 1.0).abs() < 1e-5, "{what}: errors {x} and {y}"),
                    (x, y) => assert_eq!(x, y, "{what}"),
                }
            }
            let of =
                |i: &infer::Inference| i.sensitivities.iter().map(|s| (s.element, s.sensitivity)).collect::<Vec<_>>();
            for ((e, x), (f, y)) in of(&a).into_iter().zip(of(&b)) {
                assert_eq!(e, f, "{what}");
                assert!((x - y).abs() < 1e-5 * (1.0 + x.abs()), "{what}: sensitivities of {e:?} {x} and {y}");
            }
        }
    }
}

/// Toeplitz, compound symmetry and a factor pattern: a maximum of the dense likelihood over θ, found without derivatives.
#[test]
fn the_optimum_is_that_of_a_crude_search_over_theta() {
    let ones = DMatrix::from_element(3, 3, 1.0);
    let loadings = DVector::from_vec(vec![1.0, 0.5, -0.8]);
    let factor = &loadings * loadings.transpose();
    let uniqueness = DMatrix::from_diagonal(&DVector::from_vec(vec![0.3, 0.2, 0.1]));
    let cases = [
        ("toeplitz", DMatrix::zeros(3, 3), (0..3).map(|k| band(3, k)).collect::<Vec<_>>()),
        ("compound symmetry", DMatrix::zeros(3, 3), vec![DMatrix::identity(3, 3), ones]),
        ("one factor", uniqueness, vec![factor, DMatrix::identity(3, 3)]),
    ];
    for seed in 0..4 {
        let data = ensemble(Recipe { tests: 15, designs: 15, ..base() }, seed);
        let mean = MeanStructure::free(3);
        for (what, constant, generators) in &cases {
            let what = format!("{what}, seed {seed}");
            let found = fit(&data, &assumed(linear(constant.clone(), generators.clone())), Solver::Newton);
            certified(&found, &what);
            assert_eq!(found.declared_covariance(), generators.len(), "{what}");
            let own = dense(&data, &mean, &beta(&found, &mean), &found.covariance).log_likelihood;
            assert!((own - found.log_likelihood).abs() < 1e-9, "{what}: ℓ {} dense {own}", found.log_likelihood);
            let sigma = |theta: &[f64]| generators.iter().zip(theta).fold(constant.clone(), |s, (g, t)| s + g * *t);
            let value = |theta: &[f64]| {
                let sigma = sigma(theta);
                if sigma.clone().symmetric_eigen().eigenvalues.min() < 0.0 {
                    return f64::NEG_INFINITY;
                }
                let best = dense(&data, &mean, &DVector::zeros(3), &sigma).beta;
                dense(&data, &mean, &best, &sigma).log_likelihood
            };
            let mut start = vec![0.0; generators.len()];
            start[if what.starts_with("one") { 1 } else { 0 }] = 1.0;
            let (_, best) = simplex(&start, &value);
            // near a boundary the crude search, which cannot step over it, may stop early
            assert!(found.log_likelihood > best - 1e-7, "{what}: ℓ {} crude {best}", found.log_likelihood);
            assert!(found.log_likelihood < best + 1e-3, "{what}: ℓ {} crude {best}", found.log_likelihood);
        }
    }
}

/// Optima on the boundary are singular members, and certified, though the multipliers of the constraints are not unique there.
#[test]
fn boundary_optima_are_members_and_certified() {
    let mut singular = 0;
    for seed in 0..30 {
        let data = ensemble(Recipe { rank: 1, tests: 15, designs: 15, strength: 0.6, ..base() }, seed);
        let found = fit(&data, &assumed(toeplitz(3)), Solver::Newton);
        certified(&found, &format!("seed {seed}"));
        let values = found.covariance.clone().symmetric_eigen().eigenvalues;
        assert!(values.min() >= -1e-9 * values.max(), "{values}");
        singular += usize::from(values.min() < 1e-7 * values.max().max(1e-7));
        let s = &found.covariance;
        let spread = [s[(0, 0)] - s[(1, 1)], s[(1, 1)] - s[(2, 2)], s[(1, 0)] - s[(2, 1)]].map(f64::abs);
        assert!(spread.iter().all(|d| *d < 1e-9 * (1.0 + values.max())), "not Toeplitz: {s}");
    }
    assert!(singular >= 5, "only {singular} of 30 optima are singular: the test is not about the boundary");
}

/// EM takes its M-step by Newton's method and ends at the same point.
#[test]
fn em_ends_at_the_same_point() {
    for seed in 0..8 {
        let data = ensemble(Recipe { strength: 4.0, ..base() }, seed);
        let newton = fit(&data, &assumed(toeplitz(3)), Solver::Newton);
        let em = fit(&data, &assumed(toeplitz(3)), Solver::Em);
        assert!(em.trace.windows(2).all(|w| w[1] >= w[0] - 1e-9), "EM fell: {:?}", em.trace);
        let gap = newton.log_likelihood - em.log_likelihood;
        let slow = if em.stop == Stop::Certified { 1e-7 } else { 1e-2 };
        assert!(gap > -1e-8 && gap < slow, "seed {seed}: newton {} em {}", newton.log_likelihood, em.log_likelihood);
    }
}

/// What cannot be is refused, with what was found.
#[test]
fn structures_that_cannot_be_are_refused() {
    let data: Reductions = ensemble(base(), 1);
    let refusal = |covariance: CovarianceStructure| match try_fit(&data, &assumed(covariance), Solver::Newton) {
        Err(FitError::Structure(error)) => error,
        other => panic!("found {other:?}, expected a refusal"),
    };
    let zero = DMatrix::zeros(3, 3);
    let skew = DMatrix::from_fn(3, 3, |i, j| if i <= j { 1.0 } else { 0.5 });
    let nan = DMatrix::from_element(3, 3, f64::NAN);
    let identity = DMatrix::<f64>::identity(3, 3);
    assert!(matches!(refusal(linear(zero.clone(), vec![skew])), StructureError::Asymmetric { row: 0, column: 1, .. }));
    assert!(matches!(refusal(linear(nan, vec![identity.clone()])), StructureError::Asymmetric { .. }));
    assert!(matches!(
        refusal(linear(DMatrix::zeros(2, 3), vec![])),
        StructureError::Shape { rows: 2, columns: 3, states: 3, .. }
    ));
    let twice = vec![identity.clone(), &identity * 2.0];
    assert_eq!(refusal(linear(zero.clone(), twice)), StructureError::Dependent { generators: 2, rank: 1 });
    assert_eq!(refusal(linear(zero.clone(), vec![zero.clone()])), StructureError::Dependent { generators: 1, rank: 0 });
    // σ00 = -1 whatever θ
    assert_eq!(refusal(linear(-unit(3, 0, 0), vec![unit(3, 1, 1)])), StructureError::NoMember);
    // zero trace, but not zero
    let traceless = DMatrix::from_diagonal(&DVector::from_vec(vec![1.0, -1.0, 0.0]));
    assert_eq!(refusal(linear(unit(3, 2, 2) + unit(3, 1, 0), vec![traceless])), StructureError::NoMember);
    // a covariance with a state that has no variance
    assert_eq!(refusal(linear(zero, vec![unit(3, 1, 0), unit(3, 1, 1)])), StructureError::NoMember);
    let beside = CovarianceStructure { equal: vec![vec![(0, 0), (1, 1)]], ..toeplitz(3) };
    assert_eq!(refusal(beside), StructureError::NotAlone);
}
