//! Newton and EM end at the same point, for every structure and both criteria.

use crate::simulated;

use kalfit::estimate::{Solver, Stop};
use kalfit::infer;
use simulated::structures::structures;
use simulated::{Recipe, ensemble, fit};

/// EM is stopped 1e-4 standard errors away by its own account, which is of the quadratic model there.
const FAR: f64 = 1e-3;

#[test]
fn em_and_newton_end_at_the_same_point_under_every_structure() {
    let recipe =
        Recipe { p: 3, tests: 60, rank: 3, observed: 6, strength: 5.0, designs: 60, regressors: 1, mild: false };
    for (name, assumed) in structures(3) {
        let mut arrived = 0;
        for seed in 0..6 {
            let data = ensemble(recipe, seed);
            let newton = fit(&data, &assumed, Solver::Newton);
            let em = fit(&data, &assumed, Solver::Em);
            let what = format!("{name}, seed {seed}");
            assert_eq!(newton.stop, Stop::Certified, "{what}: {:?}", newton.certificate);
            let fall = em.trace.windows(2).map(|w| w[0] - w[1]).fold(0.0, f64::max);
            assert!(fall < 1e-9, "{what}: EM fell by {fall}");
            let gap = newton.log_likelihood - em.log_likelihood;
            assert!(gap > -1e-8, "{what}: newton {} em {}", newton.log_likelihood, em.log_likelihood);
            if em.stop != Stop::Certified {
                continue; // towards a boundary EM creeps
            }
            arrived += 1;
            assert!(gap < 1e-6, "{what}: newton {} em {}", newton.log_likelihood, em.log_likelihood);
            let errors = infer::infer(&newton, &data, infer::Choices::default()).uncertainty.errors;
            for i in 0..3 {
                let unit = errors.mean[i].unwrap_or(1.0);
                let far = (newton.mean[i] - em.mean[i]).abs() / unit;
                assert!(far < FAR, "{what}: mean {i} {} and {}", newton.mean[i], em.mean[i]);
                for j in 0..=i {
                    let unit = errors.covariance[i][j].unwrap_or(1.0);
                    let (a, b) = (newton.covariance[(i, j)], em.covariance[(i, j)]);
                    assert!((a - b).abs() / unit < FAR, "{what}: covariance {i} {j} {a} and {b}");
                }
            }
            let pairs = newton.coefficients.iter().zip(&em.coefficients).zip(&errors.coefficients);
            for ((a, b), error) in pairs {
                let unit = error.expect("the data inform it");
                assert!((a - b).abs() / unit < FAR, "{what}: coefficient {a} and {b}");
            }
        }
        assert!(arrived >= 4, "{name}: EM arrived in {arrived} of 6 fits only");
    }
}
