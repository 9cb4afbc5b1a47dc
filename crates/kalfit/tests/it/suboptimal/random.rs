//! Random filters against the dense construction, and the laws of theory §8.

use kalfit::reduce::{EstimateReducer, Estimates, FilterRunner, Reducer, Reduction, Terminal, lost};
use nalgebra::{DMatrix, DVector};
use proptest::prelude::*;

use super::drawn::{Drawn, Kind, draw, generator, uniform};

fn run(drawn: &Drawn) -> Estimates {
    FilterRunner::new(&drawn.phase, &drawn.alpha).expect("sound").run(&drawn.test).expect("sound")
}

fn reduce(drawn: &Drawn, estimates: &Estimates) -> (Reduction, Terminal) {
    EstimateReducer::new(&drawn.phase, &drawn.alpha).expect("sound").reduce("t", estimates).expect("sound")
}

fn raw(drawn: &Drawn) -> Reduction {
    let tests = std::slice::from_ref(&drawn.test);
    Reducer::new(&drawn.phase.model, &drawn.alpha).expect("sound").reduce(tests).expect("sound").remove(0)
}

/// (y, J).
fn information(reduction: &Reduction) -> (DVector<f64>, DMatrix<f64>) {
    let q = reduction.data.len();
    let r = DMatrix::from_fn(q, q, |i, k| if i <= k { reduction.factor[i + k * (k + 1) / 2] } else { 0.0 });
    (r.transpose() * DVector::from_column_slice(&reduction.data), r.transpose() * r)
}

fn log_likelihood(reduction: &Reduction, sigma: &DVector<f64>) -> f64 {
    let (y, j) = information(reduction);
    let square: f64 = reduction.data.iter().map(|x| x * x).sum();
    reduction.constant - 0.5 * square + y.dot(sigma) - 0.5 * sigma.dot(&(j * sigma))
}

fn off(a: &DMatrix<f64>, b: &DMatrix<f64>) -> f64 {
    (a - b).amax() / (1.0 + b.amax())
}

/// (pseudo-inverse, log pseudo-determinant, rank) by eigenvalues of Γ scaled to unit diagonal; the determinant over an
/// orthonormal basis of its range as it is.
pub(crate) fn pseudo(gamma: &DMatrix<f64>) -> (DMatrix<f64>, f64, usize) {
    let eigen = gamma.clone().symmetric_eigen();
    let floor = 1e-11 * eigen.eigenvalues.amax();
    let kept: Vec<usize> = (0..gamma.nrows()).filter(|&i| eigen.eigenvalues[i] > floor).collect();
    let basis = eigen.eigenvectors.select_columns(&kept);
    let values = DVector::from_fn(kept.len(), |k, _| eigen.eigenvalues[kept[k]]);
    let inverse = &basis * DMatrix::from_diagonal(&values.map(f64::recip)) * basis.transpose();
    (inverse, values.iter().map(|x| x.ln()).sum(), kept.len())
}

/// The law of ŝ and of x_K given σ, with ζ among the noises: (mean, covariance), [x_K; ŝ].
fn law(drawn: &Drawn, dense: &Estimates, sigma: &DVector<f64>) -> (DVector<f64>, DMatrix<f64>) {
    let (n, m) = (dense.transition.nrows(), dense.estimates.len());
    let mut map = DMatrix::zeros(n + m, n);
    map.rows_mut(0, n).copy_from(&dense.transition);
    map.rows_mut(n, m).copy_from(&dense.sensitivities);
    let mut start = drawn.start.0.clone();
    drawn.phase.entering().iter().zip(sigma).for_each(|(&state, sigma)| start[state] += sigma);
    let mut mean = &map * start;
    (0..n).for_each(|i| mean[i] += dense.drift[i]);
    (0..m).for_each(|i| mean[n + i] += dense.offsets[i]);
    (mean, &dense.root * dense.root.transpose() + &map * &drawn.start.1 * map.transpose())
}

/// Certain directions of wrong filters are known to dense eigenvalues only when others are not nearly so.
fn clear_cut(gamma: &DMatrix<f64>) -> bool {
    let eigen = gamma.clone().symmetric_eigen();
    let most = eigen.eigenvalues.amax();
    eigen.eigenvalues.iter().all(|value| *value > 1e-6 * most || value.abs() < 1e-13 * most)
}

proptest! {
    // one seed: about one drawn filter in some thousands has estimates whose relation is told from rounding error
    #![proptest_config(ProptestConfig { rng_seed: proptest::test_runner::RngSeed::Fixed(7), ..ProptestConfig::with_cases(300) })]

    #[test]
    fn the_filter_and_what_its_estimates_depend_on_are_those_of_the_stacked_noises(seed: u64) {
        let drawn = draw(seed, Kind::Wrong);
        let (found, dense) = (run(&drawn), drawn.dense());
        prop_assert_eq!((found.steps, found.observations), (dense.steps, dense.observations));
        let column = |x: &DVector<f64>| DMatrix::from_column_slice(x.len(), 1, x.as_slice());
        let gamma = |e: &Estimates| &e.root * e.root.transpose();
        for (what, a, b) in [
            ("ŝ", column(&found.estimates), column(&dense.estimates)),
            ("s̄", column(&found.offsets), column(&dense.offsets)),
            ("S", found.sensitivities.clone(), dense.sensitivities.clone()),
            ("φ_K", found.transition.clone(), dense.transition.clone()),
            ("s̄_1", column(&found.drift), column(&dense.drift)),
            ("Γ", gamma(&found), gamma(&dense)),
        ] {
            prop_assert!(off(&a, &b) < 1e-9, "{}: {} against {}", what, a, b);
        }
    }

    #[test]
    fn reductions_of_estimates_are_their_density_and_the_law_of_the_last_state(seed: u64) {
        let drawn = draw(seed, Kind::Wrong);
        let dense = drawn.dense();
        let (reduction, terminal) = reduce(&drawn, &run(&drawn));
        let (n, m, q) = (dense.transition.nrows(), dense.estimates.len(), reduction.data.len());
        let random = &mut generator(seed ^ 1);
        for _ in 0..3 {
            let sigma = DVector::from_fn(q, |_, _| 2.0 * uniform(random));
            let (mean, covariance) = law(&drawn, &dense, &sigma);
            let gamma = covariance.view((n, n), (m, m)).into_owned();
            prop_assume!(clear_cut(&gamma));
            let (inverse, log_determinant, rank) = pseudo(&gamma);
            let left = &dense.estimates - mean.rows(n, m);
            let square = left.dot(&(&inverse * &left));
            let expected = -0.5 * (rank as f64 * std::f64::consts::TAU.ln() + log_determinant + square);
            let found = log_likelihood(&reduction, &sigma);
            prop_assert!((found - expected).abs() < 1e-7 * (1.0 + expected.abs()), "ℓ {} against {}", found, expected);
            let cross = covariance.view((0, n), (n, m)).into_owned();
            let last = mean.rows(0, n) + &cross * &inverse * left;
            let own = &terminal.mean + &terminal.sensitivity * &sigma;
            prop_assert!((&own - &last).amax() < 1e-7 * (1.0 + last.amax()), "x_K {} against {}", own, last);
            let spread = covariance.view((0, 0), (n, n)) - &cross * &inverse * cross.transpose();
            let own = terminal.covariance();
            prop_assert!(off(&own, &spread) < 1e-7, "P_K {} {}", own, spread);
        }
    }

    #[test]
    fn estimates_of_an_optimal_filter_are_sufficient(seed: u64) {
        let drawn = draw(seed, Kind::Optimal);
        let ((own, _), raw) = (reduce(&drawn, &run(&drawn)), raw(&drawn));
        let ((y, j), (raw_y, raw_j)) = (information(&own), information(&raw));
        prop_assert!((&j - &raw_j).amax() <= 1e-9 * (1.0 + raw_j.amax()), "J {} against {}", j, raw_j);
        prop_assert!((&y - &raw_y).amax() <= 1e-9 * (1.0 + raw_y.amax()), "y {} against {}", y, raw_y);
    }

    #[test]
    fn no_filter_knows_more_than_the_measurements(seed: u64) {
        let drawn = draw(seed, Kind::Wrong);
        let lost = lost(&raw(&drawn), &reduce(&drawn, &run(&drawn)).0);
        let lost = lost.expect("not less than nothing");
        let least = lost.information.clone().symmetric_eigen().eigenvalues.min();
        prop_assert!(least > -1e-9 * (1.0 + lost.information.amax()), "{} of {}", least, lost.information);
        prop_assert!(0.0 <= lost.range.0 && lost.range.0 <= lost.range.1 && lost.range.1 <= 1.0, "{:?}", lost.range);
    }

    #[test]
    fn estimates_and_noise_at_the_end_apart_say_the_same(seed: u64) {
        // (53)-(56): ŝ = S x_0 + s̄ + D_2 w_T + v with w_T ~ N(0, Q_T) one more unknown
        let drawn = draw(seed, Kind::Wrong);
        let dense = drawn.dense();
        let (n, m) = (dense.transition.nrows(), dense.estimates.len());
        let gamma = &dense.root * dense.root.transpose();
        let (q_t, own) = (gamma.view((0, 0), (n, n)).into_owned(), gamma.view((n, n), (m, m)).into_owned());
        let cross = gamma.view((n, 0), (m, n)).into_owned();
        prop_assume!(clear_cut(&q_t) && clear_cut(&own));
        let (inverse, ..) = pseudo(&q_t);
        let d_2 = &cross * &inverse;
        let v = &own - &d_2 * &q_t * d_2.transpose();
        let together = &d_2 * &q_t * d_2.transpose() + &v;
        prop_assume!(clear_cut(&v));
        // Bayesian least squares for (x_0, w_T), x_0 without prior, w_T with variance Q_T
        let (whole, ..) = pseudo(&together);
        let information = dense.sensitivities.transpose() * &whole * &dense.sensitivities;
        let residual = &dense.estimates - &dense.offsets;
        let y = dense.sensitivities.transpose() * &whole * &residual;
        let start = DVector::from_fn(n, |i, _| drawn.start.0[i] + 0.3 * (i as f64 + 1.0));
        let w = &q_t * d_2.transpose() * &whole * (&residual - &dense.sensitivities * &start);
        let free = drawn.clone().free();
        let (reduction, terminal) = reduce(&free, &run(&free));
        let (own_y, own_j) = self::information(&reduction);
        prop_assert!(off(&own_j, &information) < 1e-7, "J {} against {}", own_j, information);
        prop_assert!((&own_y - &y).amax() < 1e-7 * (1.0 + y.amax()), "y {} against {}", own_y, y);
        let last = &dense.transition * &start + &dense.drift + w;
        let own_last = &terminal.mean + &terminal.sensitivity * &start;
        prop_assert!((&own_last - &last).amax() < 1e-7 * (1.0 + last.amax()), "x_K {} against {}", own_last, last);
    }
}
