//! The paper's §2.3: what happens to the part of the state that no test observes.

use crate::simulated;

use kalfit::estimate::{self, Estimate, Settings, Silent, Solver, Stop, Structure};
use kalfit::infer::{self, Quantity};
use kalfit::model::{Alpha, CovarianceStructure, MeanStructure};
use kalfit::reduce::{Reduction, ReductionRef, Reductions};
use kalfit_fixtures::dense::unpacked;
use nalgebra::{DMatrix, DVector};
use simulated::{Recipe, ensemble};

const P: usize = 4;
/// Observed directions.
const O: usize = 2;

/// Tests that all see `seen` ξ (O × P) and nothing else.
fn tests(seen: &DMatrix<f64>, seed: u64) -> Reductions {
    let recipe =
        Recipe { p: O, tests: 25, rank: O, observed: 4, strength: 1.5, designs: 25, regressors: 0, mild: false };
    let wide = |reduction: ReductionRef<'_>| {
        let r = unpacked(reduction.factor, O) * seen;
        let mut stacked = DMatrix::zeros(P + 1, P + 1);
        stacked.view_mut((0, 0), (O, P)).copy_from(&r);
        (0..O).for_each(|i| stacked[(i, P)] = reduction.data[i]);
        let upper = stacked.qr().r();
        let mut found = Reduction::from(reduction);
        // what is zero is so exactly, as it is after a filter
        let clean = |x: f64| if x.abs() < 1e-13 * upper.amax() { 0.0 } else { x };
        found.factor = (0..P).flat_map(|k| (0..=k).map(move |i| (i, k))).map(|(i, k)| clean(upper[(i, k)])).collect();
        found.data = (0..P).map(|i| clean(upper[(i, P)])).collect();
        found.constant = -0.5 * upper[(P, P)].powi(2);
        found
    };
    ensemble(recipe, seed).iter().map(wide).collect()
}

/// The first O states.
fn straight() -> DMatrix<f64> {
    DMatrix::identity(O, P)
}

/// A subspace along no state.
fn oblique() -> DMatrix<f64> {
    DMatrix::from_row_slice(O, P, &[1.0, 0.5, -0.7, 0.3, 0.2, -1.0, 0.4, 0.8])
}

struct Start {
    mean: Vec<f64>,
    covariance: DMatrix<f64>,
}

fn search(data: &Reductions, start: &Start, solver: Solver, passes: usize) -> Estimate {
    let mean = MeanStructure { start: start.mean.iter().copied().map(Some).collect(), ..MeanStructure::free(P) };
    let covariance = CovarianceStructure { start: Some(start.covariance.clone()), ..CovarianceStructure::full() };
    let alpha = Alpha::default();
    let structure = Structure::single(&mean, &covariance, &alpha);
    let settings = Settings { max_passes: passes, ..Settings::of(solver) };
    estimate::fit(data, &structure, &settings, &mut Silent).expect("a legal problem")
}

fn same(what: &str, a: &DMatrix<f64>, b: &DMatrix<f64>, tolerance: f64) {
    let error = (a - b).amax() / b.amax().max(1.0);
    assert!(error <= tolerance, "{what}: {a} and {b}: {error:.1e}, tolerance {tolerance:.0e}");
}

fn column(mean: &[f64]) -> DMatrix<f64> {
    DMatrix::from_column_slice(mean.len(), 1, mean)
}

fn part(a: &DMatrix<f64>, rows: std::ops::Range<usize>, columns: std::ops::Range<usize>) -> DMatrix<f64> {
    a.view((rows.start, columns.start), (rows.len(), columns.len())).clone_owned()
}

/// Σ_uo Σ_oo⁻¹ and Σ_uu - Σ_uo Σ_oo⁻¹ Σ_ou.
fn regression(sigma: &DMatrix<f64>) -> (DMatrix<f64>, DMatrix<f64>) {
    let (oo, uo) = (part(sigma, 0..O, 0..O), part(sigma, O..P, 0..O));
    let slope = &uo * oo.try_inverse().expect("positive definite");
    let rest = part(sigma, O..P, O..P) - &slope * uo.transpose();
    (slope, rest)
}

fn correlated() -> Start {
    let root = DMatrix::from_row_slice(
        4,
        4,
        &[1.0, 0.0, 0.0, 0.0, 0.3, 0.9, 0.0, 0.0, 0.8, -0.4, 0.7, 0.0, -0.5, 0.6, 0.2, 1.1],
    );
    Start { mean: vec![0.5, -1.0, 3.0, -2.0], covariance: &root * root.transpose() }
}

fn uncorrelated() -> Start {
    let mut covariance = correlated().covariance;
    for i in 0..O {
        for k in O..P {
            covariance[(i, k)] = 0.0;
            covariance[(k, i)] = 0.0;
        }
    }
    Start { covariance, ..correlated() }
}

/// (2) The iterates on the observable subspace do not depend on the start outside it.
#[test]
fn observable_iterates_do_not_see_the_rest() {
    for seen in [straight(), oblique()] {
        // starts that agree in seen μ and seen Σ seen', and in nothing else
        let start = correlated();
        let (_, _, v) = {
            let svd = seen.clone().svd(true, true);
            (svd.u, svd.singular_values, svd.v_t.expect("asked for"))
        };
        let onto = v.transpose() * &v; // projection on the rows of seen
        let off = DMatrix::identity(P, P) - onto;
        let moved = DVector::from_column_slice(&start.mean) + &off * DVector::from_vec(vec![4.0, 1.0, -2.0, 5.0]);
        // x ↦ x + off M x leaves seen x alone
        let turn = DMatrix::identity(P, P) + &off * DMatrix::from_fn(P, P, |i, k| 0.3 * (i as f64) - 0.2 * (k as f64));
        let other = Start {
            mean: moved.as_slice().to_vec(),
            covariance: &turn * &start.covariance * turn.transpose() + &off * off.transpose() * 2.0,
        };
        for seed in 0..4 {
            let data = tests(&seen, seed);
            for passes in [3, 5, 9, 30] {
                let a = search(&data, &start, Solver::Em, passes);
                let b = search(&data, &other, Solver::Em, passes);
                let what = format!("seed {seed}, {passes} passes");
                same(&format!("mean, {what}"), &(&seen * column(&a.mean)), &(&seen * column(&b.mean)), 1e-10);
                let (sa, sb) = (&seen * &a.covariance * seen.transpose(), &seen * &b.covariance * seen.transpose());
                same(&format!("covariance, {what}"), &sa, &sb, 1e-10);
                assert!((column(&a.mean) - column(&b.mean)).amax() > 0.1, "the starts should differ elsewhere");
            }
        }
    }
}

/// (3) With initial correlation the unobservable part moves, but its regression on the observable part stays.
#[test]
fn the_regression_on_the_observable_part_stays_as_it_was() {
    let start = correlated();
    let (slope, rest) = regression(&start.covariance);
    for seed in 0..4 {
        let data = tests(&straight(), seed);
        for passes in [3, 9, 40] {
            let found = search(&data, &start, Solver::Em, passes);
            let what = format!("seed {seed}, {passes} passes");
            let (own, left) = regression(&found.covariance);
            same(&format!("Σ_uo Σ_oo⁻¹, {what}"), &own, &slope, 1e-9);
            same(&format!("Σ_uu given o, {what}"), &left, &rest, 1e-9);
            let moved = DMatrix::from_fn(P - O, 1, |i, _| found.mean[O + i] - start.mean[O + i]);
            assert!(moved.amax() > 1e-3, "{what}: the unobservable mean should move, by regression");
            let expected = &slope * DMatrix::from_fn(O, 1, |i, _| found.mean[i] - start.mean[i]);
            same(&format!("unobservable mean, {what}"), &moved, &expected, 1e-9);
        }
    }
}

/// (4) With zero initial correlation the unobservable mean and covariance and the zero correlation never change.
#[test]
fn without_correlation_the_unobservable_part_never_changes() {
    let start = uncorrelated();
    for seed in 0..4 {
        let data = tests(&straight(), seed);
        for (solver, passes) in [(Solver::Em, 3), (Solver::Em, 9), (Solver::Em, 40), (Solver::Newton, 200)] {
            let found = search(&data, &start, solver, passes);
            let what = format!("{solver:?}, seed {seed}, {passes} passes");
            let mean = |m: &[f64]| column(&m[O..]);
            same(&format!("mean, {what}"), &mean(&found.mean), &mean(&start.mean), 1e-12);
            let unobserved = |s: &DMatrix<f64>| part(s, O..P, O..P);
            same(&format!("covariance, {what}"), &unobserved(&found.covariance), &unobserved(&start.covariance), 1e-11);
            assert!(part(&found.covariance, O..P, 0..O).amax() < 1e-11, "{what}: {}", found.covariance);
        }
    }
}

/// After Newton's method what is not identified stands where it started: the unobservable mean, the regression of the
/// unobservable part on the observable one, and its covariance given that.
#[test]
fn newton_leaves_what_is_not_identified_at_its_start() {
    let start = correlated();
    let (slope, rest) = regression(&start.covariance);
    for seed in 0..8 {
        let data = tests(&straight(), seed);
        let found = search(&data, &start, Solver::Newton, 200);
        assert_eq!(found.stop, Stop::Certified, "seed {seed}: {:?}", found.certificate);
        same(&format!("mean, seed {seed}"), &column(&found.mean[O..]), &column(&start.mean[O..]), 1e-12);
        let singular = found.covariance.view((0, 0), (O, O)).symmetric_eigenvalues().min() < 1e-6;
        if !singular {
            let (own, left) = regression(&found.covariance);
            same(&format!("Σ_uo Σ_oo⁻¹, seed {seed}"), &own, &slope, 1e-6);
            same(&format!("Σ_uu given o, seed {seed}"), &left, &rest, 1e-6);
        }
        let directions = infer::identifiability(&found);
        let of = |q: Quantity| directions.iter().filter(|d| d.quantity == q).count();
        assert_eq!((of(Quantity::Mean), of(Quantity::Covariance)), (2, 7), "seed {seed}: unidentified directions");
    }
}
