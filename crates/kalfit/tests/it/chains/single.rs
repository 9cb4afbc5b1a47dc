//! One test in three phases, the second of which does not see all of its own states: Σ fixed at zero, at something, at 1e6; and free.

use kalfit::estimate::{Combination, Estimate, Stop};
use kalfit::infer::{self, Choices};
use kalfit::model::{CovarianceKind, CovarianceStructure, MeanElement, MeanStructure};
use kalfit::reduce::{Chain, ChainPhase, Link, Path, Reduction, Reductions};
use kalfit_fixtures::dense::unpacked;
use nalgebra::{DMatrix, DVector};

use super::fits::{Phases, by, fit, kind, matrix};
use super::{Joint, stacked};

const OWN: [usize; 3] = [2, 2, 1];

/// A bias that a rate moves: calibrated, checked once, then used, where only the bias starts with an error of its own.
fn test() -> Reduction {
    let moved = DMatrix::from_row_slice(2, 2, &[1.0, 10.0, 0.0, 1.0]);
    let root = DMatrix::from_row_slice(2, 1, &[0.05, 0.0]);
    let link = |mean: [f64; 2], sensitivity: DMatrix<f64>| {
        Some(Link { mean: DVector::from_column_slice(&mean), sensitivity, root: root.clone() })
    };
    let phase = |own: usize, data: [f64; 2], factor: [f64; 3], link: Option<Link>| ChainPhase {
        own,
        constant: 1.5,
        data: data.to_vec(),
        factor: factor.to_vec(),
        path: Path::Information,
        link,
    };
    let used = DMatrix::from_row_slice(2, 2, &[0.9, 0.0, 0.0, 1.0]) * &moved;
    let chain = Chain {
        phases: vec![
            phase(2, [40.0, 15.0], [40.0, 80.0, 100.0], None),
            phase(2, [50.0, 0.0], [20.0, 0.0, 0.0], link([0.1, 0.0], moved)),
            phase(1, [60.0, 3.0], [25.0, 50.0, 30.0], link([0.0, 0.0], used)),
        ],
    };
    let reduction = stacked(&chain, &OWN);
    Reduction { test: "S1".to_owned(), chain: Some(Box::new(chain)), ..reduction }
}

fn blocks(of: impl Fn(usize) -> CovarianceStructure) -> Phases {
    OWN.iter().map(|&p| (MeanStructure::free(p), of(p))).collect()
}

fn fixed(variance: f64) -> Phases {
    blocks(|p| kind(CovarianceKind::Fixed(matrix(&(DMatrix::identity(p, p) * variance)))))
}

fn dense(estimate: &Estimate, reduction: &Reduction) -> f64 {
    let mu = DVector::from_column_slice(&estimate.mean);
    Joint::of(reduction.chain.as_ref().expect("made so"), &OWN).log_density(&mu, &estimate.covariance)
}

#[test]
fn the_means_of_one_test_do_not_depend_on_the_covariance() {
    let reduction = test();
    let data = &Reductions::from(vec![reduction.clone()]);
    // with as many means as rows of information all of them are met: the estimate solves Rξ = d
    let r = unpacked(&reduction.factor, 5);
    let expected = r.lu().solve(&DVector::from_column_slice(&reduction.data)).expect("observable over all phases");
    for variance in [0.0, 1e-4, 1.0, 1e6] {
        for way in [Combination::Chain, Combination::Stacked] {
            let found = fit(data, &fixed(variance), &by(way));
            assert_eq!(found.stop, Stop::Certified, "Σ {variance}: {:?}", found.certificate);
            for (a, b) in found.mean.iter().zip(expected.iter()) {
                assert!((a - b).abs() < 1e-6 * (1.0 + b.abs()), "Σ {variance} {way:?}: {a} {b}");
            }
            let at = dense(&found, &reduction);
            assert!((found.log_likelihood - at).abs() < 1e-6, "Σ {variance}: {} {at}", found.log_likelihood);
        }
    }
}

#[test]
fn with_a_free_covariance_one_test_puts_it_at_zero_and_says_so() {
    let reduction = test();
    let data = &Reductions::from(vec![reduction.clone()]);
    let zero = fit(data, &fixed(0.0), &by(Combination::Chain));
    let found = fit(data, &blocks(|_| CovarianceStructure::full()), &by(Combination::Chain));
    assert_eq!(found.stop, Stop::Certified, "{:?}", found.certificate);
    assert_eq!(found.covariance, DMatrix::zeros(5, 5));
    for (a, b) in found.mean.iter().zip(&zero.mean) {
        assert!((a - b).abs() < 1e-6 * (1.0 + b.abs()), "{a} {b}");
    }
    let inference = infer::infer(&found, data, Choices::default());
    let ranks: Vec<(usize, usize)> = inference.uncertainty.boundary.iter().map(|b| (b.rank, b.states.len())).collect();
    assert_eq!(ranks, [(0, 2), (0, 2), (0, 1)]);
}

/// With the mean known the posterior is that of the joint law of all phases, for a huge prior least squares.
#[test]
fn the_posterior_of_each_phase_is_that_given_all_phases() {
    let reduction = test();
    let data = &Reductions::from(vec![reduction.clone()]);
    let joint = Joint::of(reduction.chain.as_ref().expect("made so"), &OWN);
    for variance in [0.0, 0.3, 1e6] {
        let known = |(_, covariance): &(MeanStructure, CovarianceStructure)| {
            let p = match &covariance.kind {
                CovarianceKind::Fixed(rows) => rows.len(),
                _ => 0,
            };
            let elements = vec![MeanElement::Fixed(0.25); p];
            (MeanStructure { elements, ..MeanStructure::free(p) }, covariance.clone())
        };
        let phases: Phases = fixed(variance).iter().map(known).collect();
        let found = fit(data, &phases, &by(Combination::Chain));
        let inference = infer::infer(&found, data, Choices::default());
        let posterior = inference.posteriors.get(0);
        let mu = DVector::from_element(5, 0.25);
        let sigma = DMatrix::identity(5, 5) * variance;
        let (mean, covariance) = joint.law.given(&mu, &sigma);
        let variances: Vec<f64> = posterior.covariances().flat_map(|own| own.diagonal().as_slice().to_vec()).collect();
        for i in 0..5 {
            let (a, b) = (posterior.mean[i], mean[i]);
            assert!((a - b).abs() < 1e-6 * (1.0 + b.abs()), "Σ {variance}, {i}: {a} {b}");
            let b = covariance[(i, i)];
            let a = variances[i];
            assert!((a - b).abs() < 1e-8 * (1.0 + variance), "Σ {variance}, variance {i}: {a} {b}");
        }
    }
}

/// Two, one and two directions are seen in the phases by themselves; two, three and all five once they are taken together.
#[test]
fn it_is_said_which_directions_enter_at_which_phase() {
    let reduction = test();
    let data = &Reductions::from(vec![reduction.clone()]);
    for way in [Combination::Chain, Combination::Stacked] {
        let found = fit(data, &fixed(1.0), &by(way));
        let phases = infer::infer(&found, data, Choices::default()).phases;
        let ranks: Vec<(usize, usize)> = phases.iter().map(|p| (p.own_rank, p.rank_so_far)).collect();
        assert_eq!(ranks, [(2, 2), (1, 3), (2, 5)], "{way:?}");
        let entered: Vec<usize> = phases.iter().map(|p| p.entered.len()).collect();
        assert_eq!(entered, [2, 1, 2], "{way:?}");
        // the check sees the bias of its own phase and no rate
        let check = &phases[1].entered[0];
        assert!((check[2] - 1.0).abs() < 1e-9 && check[3] == 0.0, "{check:?}");
    }
}
