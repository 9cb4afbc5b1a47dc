//! Instruments side by side: what one says does not depend on the other, although rounding error ties all that is certain
//! together.

use kalfit::model::{CovarianceStructure, MeanStructure, Motion, Phase};
use kalfit::reduce::{EstimateReducer, Estimates, Reduction, Terminal};
use nalgebra::{DMatrix, DVector};

use super::drawn::{Drawn, Kind, draw, generator, matrix};

fn diagonal(a: &DMatrix<f64>, b: &DMatrix<f64>) -> DMatrix<f64> {
    let mut both = DMatrix::zeros(a.nrows() + b.nrows(), a.ncols() + b.ncols());
    both.view_mut((0, 0), a.shape()).copy_from(a);
    both.view_mut(a.shape(), b.shape()).copy_from(b);
    both
}

fn stacked(a: &DVector<f64>, b: &DVector<f64>) -> DVector<f64> {
    DVector::from_iterator(a.len() + b.len(), a.iter().chain(b).copied())
}

/// The states of both.
fn phase(a: &Drawn, b: &Drawn) -> Phase {
    let mut phase = a.phase.clone();
    let (n, others) = (phase.model.states.len(), &b.phase.model);
    phase.model.states.extend(others.states.iter().cloned().map(|mut state| {
        let Motion::Discrete { next, .. } = &mut state.motion else { panic!("drawn in steps") };
        next.terms.iter_mut().for_each(|(other, _)| *other += n);
        state
    }));
    phase.model.estimated.extend(others.estimated.iter().map(|i| n + i));
    (phase.model.mean, phase.model.covariance) =
        (MeanStructure::free(phase.model.estimated.len()), CovarianceStructure::full());
    phase
}

/// The estimates of both, one after the other, by any of the roots that Γ has.
fn estimates(a: &Estimates, b: &Estimates, seed: u64) -> Estimates {
    let (n, l) = (a.transition.nrows(), b.transition.nrows());
    let part = |e: &Estimates, first: usize, count: usize| e.root.rows(first, count).into_owned();
    let last = diagonal(&part(a, 0, n), &part(b, 0, l));
    let own = diagonal(&part(a, n, 2 * n), &part(b, l, 2 * l));
    let mut root = DMatrix::zeros(3 * (n + l), last.ncols());
    root.rows_mut(0, n + l).copy_from(&last);
    root.rows_mut(n + l, 2 * (n + l)).copy_from(&own);
    let turn = matrix(root.ncols(), root.ncols(), &mut generator(seed)).qr().q();
    Estimates {
        estimates: stacked(&a.estimates, &b.estimates),
        offsets: stacked(&a.offsets, &b.offsets),
        sensitivities: diagonal(&a.sensitivities, &b.sensitivities),
        transition: diagonal(&a.transition, &b.transition),
        drift: stacked(&a.drift, &b.drift),
        root: root * turn,
        ..a.clone()
    }
}

fn reduce(phase: &Phase, drawn: &Drawn, estimates: &Estimates) -> (Reduction, Terminal) {
    EstimateReducer::new(phase, &drawn.alpha).expect("sound").reduce("t", estimates).expect("sound")
}

/// (y, J).
fn information(reduction: &Reduction) -> (DVector<f64>, DMatrix<f64>) {
    let q = reduction.data.len();
    let r = DMatrix::from_fn(q, q, |i, k| if i <= k { reduction.factor[i + k * (k + 1) / 2] } else { 0.0 });
    (r.transpose() * DVector::from_column_slice(&reduction.data), r.transpose() * r)
}

/// log p at σ = 0.
fn density(reduction: &Reduction) -> f64 {
    reduction.constant - 0.5 * reduction.data.iter().map(|x| x * x).sum::<f64>()
}

#[test]
fn two_instruments_side_by_side_say_what_each_says() {
    let mut known_starts = 0;
    for seed in 0..1000 {
        let (a, b) = (draw(2 * seed, Kind::Wrong), draw(2 * seed + 1, Kind::Wrong));
        known_starts += usize::from(a.start.1.amax() > 0.0 || b.start.1.amax() > 0.0);
        let (of_a, of_b) = (a.dense(), b.dense());
        let ((one, last), (two, other)) = (reduce(&a.phase, &a, &of_a), reduce(&b.phase, &b, &of_b));
        let (both, end) = reduce(&phase(&a, &b), &a, &estimates(&of_a, &of_b, seed));
        let ((y_1, j_1), (y_2, j_2), (y, j)) = (information(&one), information(&two), information(&both));
        let column = |x: &DVector<f64>| DMatrix::from_column_slice(x.len(), 1, x.as_slice());
        let density = |found: f64| DMatrix::from_element(1, 1, found);
        for (what, found, expected) in [
            ("J", j, diagonal(&j_1, &j_2)),
            ("y", column(&y), column(&stacked(&y_1, &y_2))),
            ("ℓ", density(self::density(&both)), density(self::density(&one) + self::density(&two))),
            ("x̂_K", column(&end.mean), column(&stacked(&last.mean, &other.mean))),
            ("Ψ_K", end.sensitivity.clone(), diagonal(&last.sensitivity, &other.sensitivity)),
            ("P_K", end.covariance(), diagonal(&last.covariance(), &other.covariance())),
        ] {
            // the least of singular values is 1e-6 or so of the largest
            let off = (&found - &expected).amax() / (1.0 + expected.amax());
            assert!(off < 1e-7, "{what}, seed {seed}: off by {off:e}, {found} against {expected}");
        }
    }
    assert!(known_starts > 300, "{known_starts} have a known start with a variance");
}
