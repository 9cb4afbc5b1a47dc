//! Tests in several phases against the dense joint Gaussian of all their measurements.

use crate::{dense, journey};

use journey::{Journey, law, log_likelihood, marginal, normal};
use kalfit::Alpha;
use kalfit::reduce::{PhasedReducer, Reduction};
use nalgebra::DVector;
use proptest::prelude::{ProptestConfig, any, proptest};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

fn reduce(journey: &Journey) -> Reduction {
    let mut reducer = PhasedReducer::new(&journey.model, &Alpha::default()).expect("sound");
    reducer.reduce(std::slice::from_ref(&journey.test)).expect("sound").remove(0)
}

fn assert_near(found: f64, expected: f64, tolerance: f64, what: &str) {
    let error = (found - expected).abs() / (1.0 + expected.abs());
    assert!(error <= tolerance, "{what}: {found} against {expected}, off by {error:.1e}, allowed {tolerance:.0e}");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

    /// The stacked reduction is log p(all measurements | ξ_1, …, ξ_I) and, with Σ zero, singular or huge, log p(all measurements).
    #[test]
    fn the_stacked_reduction_is_the_dense_likelihood(seed in any::<u64>()) {
        let journey = Journey::random(seed);
        let reduction = reduce(&journey);
        let whole = dense::dense(&journey.whole());
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        if whole.values.is_empty() {
            assert_eq!((reduction.constant, reduction.observations), (0.0, 0));
            return Ok(());
        }
        let p = journey.dimension();
        for _ in 0..3 {
            let xi = DVector::from_fn(p, |_, _| normal(&mut rng));
            assert_near(log_likelihood(&reduction, &xi), whole.log_likelihood(&xi), 1e-8, "given ξ");
            let (mu, sigma) = law(&mut rng, p);
            assert_near(marginal(&reduction, &mu, &sigma), whole.marginal(&mu, &sigma), 1e-6, "marginal");
        }
    }
}
