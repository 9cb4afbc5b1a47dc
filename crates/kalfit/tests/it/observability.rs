//! What the data identify, why not, and which tests say what, on ensembles made by hand.

use kalfit::estimate::{self, Settings, Silent, Solver, Structure};
use kalfit::infer::{self, Examination, Quantity, Reason};
use kalfit::model::{Alpha, CovarianceKind, CovarianceStructure, MeanElement, MeanStructure, Regression};
use kalfit::reduce::{Plain, Reduction, Reductions, StepMatrices};
use nalgebra::{DMatrix, DVector};

/// A test of p constants that measures each combination in `rows` with unit noise, some value each.
fn test(id: &str, rows: &[&[f64]]) -> Reduction {
    let p = rows[0].len();
    let seed: f64 = id.bytes().map(f64::from).sum();
    let mut plain = Plain::new(id, DVector::zeros(p), DMatrix::identity(p, p), DMatrix::zeros(p, p));
    for (k, row) in rows.iter().enumerate() {
        let value = (seed * 1.7 + k as f64 * 2.3).sin() * 3.0;
        plain.steps.push(StepMatrices::new(
            DMatrix::from_row_slice(1, p, row),
            DMatrix::identity(1, 1),
            DVector::from_element(1, value),
        ));
    }
    plain.reduce().expect("sound")
}

fn examine_under(data: &Reductions, mean: &MeanStructure, covariance: &CovarianceStructure) -> Examination {
    let alpha = Alpha::default();
    infer::examine_at_start(data, &Structure::single(mean, covariance, &alpha)).expect("a legal problem")
}

fn examine(data: &Reductions) -> Examination {
    let p = (0..).find(|p| p * (p + 1) / 2 == data.get(0).factor.len()).expect("packed");
    examine_under(data, &MeanStructure::free(p), &CovarianceStructure::full())
}

/// (quantity, direction, reason) of each direction.
fn found(examination: &Examination) -> Vec<(Quantity, Vec<f64>, Reason)> {
    let both = examination.unidentified.iter().zip(&examination.explanations);
    both.map(|(d, e)| (d.quantity, d.direction.clone(), e.reason.clone())).collect()
}

#[track_caller]
fn assert_direction(found: &[f64], expected: &[f64]) {
    let norm = expected.iter().map(|x| x * x).sum::<f64>().sqrt();
    let apart = found.iter().zip(expected).map(|(a, b)| (a - b / norm).abs()).fold(0.0, f64::max);
    let turned = found.iter().zip(expected).map(|(a, b)| (a + b / norm).abs()).fold(0.0, f64::max);
    assert!(apart.min(turned) < 1e-9 && found.len() == expected.len(), "{found:?} against {expected:?}");
}

fn counts(examination: &Examination) -> Vec<(usize, usize)> {
    examination.observability.states.iter().map(|s| (s.informed_by, s.observed_by)).collect()
}

#[test]
fn a_state_no_test_sees_is_named_with_its_mean_and_covariances() {
    let data: Reductions = (0..4).map(|j| test(&format!("t{j}"), &[&[1.0, 0.0], &[1.0, 0.0]])).collect();
    let examination = examine(&data);
    assert_eq!(counts(&examination), [(4, 4), (0, 0)]);
    let found = found(&examination);
    assert_eq!(found.len(), 3, "{found:?}");
    assert_direction(&found[0].1, &[0.0, 1.0]);
    assert_eq!(found[0].0, Quantity::Mean);
    for (_, direction, reason) in &found {
        assert_eq!(reason, &Reason::Unseen { states: vec![1] }, "{direction:?}");
        assert_eq!(direction.iter().filter(|w| **w != 0.0).count(), 1, "one element each: {direction:?}");
    }
}

#[test]
fn a_sum_of_two_states_never_tells_them_apart() {
    let data: Reductions = (0..5).map(|j| test(&format!("t{j}"), &[&[1.0, 1.0, 0.0], &[0.0, 0.0, 1.0]])).collect();
    let examination = examine(&data);
    assert_eq!(counts(&examination), [(5, 0), (5, 0), (5, 5)]);
    let found = found(&examination);
    let mean: Vec<_> = found.iter().filter(|(q, ..)| *q == Quantity::Mean).collect();
    assert_eq!(mean.len(), 1, "{found:?}");
    assert_direction(&mean[0].1, &[1.0, -1.0, 0.0]);
    assert_eq!(mean[0].2, Reason::NeverApart { states: vec![0, 1] });
    // of Σ: var a, cov ab, var b only as their sum var a + 2 cov + var b, and cov ac + cov bc: three directions are dark
    assert_eq!(found.len(), 4, "{found:?}");
    assert!(
        found.iter().any(|(q, _, r)| *q == Quantity::Covariance && *r == Reason::NeverApart { states: vec![0, 1] })
    );
    assert_eq!(examination.explanations[0].tests, ["t0", "t1", "t2", "t3", "t4"]);
}

#[test]
fn states_of_disjoint_groups_of_tests_have_no_covariance() {
    let mut data: Reductions = (0..4).map(|j| test(&format!("a{j}"), &[&[1.0, 0.0], &[2.0, 0.0]])).collect();
    data.extend((0..3).map(|j| test(&format!("b{j}"), &[&[0.0, 1.0]])));
    let examination = examine(&data);
    assert_eq!(counts(&examination), [(4, 4), (3, 3)]);
    let found = found(&examination);
    assert_eq!(found.len(), 1, "{found:?}");
    assert_direction(&found[0].1, &[0.0, 1.0, 0.0]);
    assert_eq!(found[0].2, Reason::NeverTogether { states: [0, 1] });
    assert_eq!(examination.observability.states[1].tests, ["b0", "b1", "b2"]);
    assert_eq!(examination.observability.together, [[4, 0], [0, 3]]);
}

#[test]
fn a_state_that_one_test_tells_rests_on_that_test() {
    // all see a + b, one also a alone: the mean of b rests on it
    let mut data: Reductions = (0..20).map(|j| test(&format!("t{j:02}"), &[&[1.0, 1.0]])).collect();
    data.push(test("z", &[&[1.0, 1.0], &[1.0, 0.0]]));
    data.push(test("y", &[&[0.0, 0.0]]));
    let fixed = CovarianceStructure { kind: CovarianceKind::Fixed(zeros(2)), ..CovarianceStructure::full() };
    let examination = examine_under(&data, &MeanStructure::free(2), &fixed);
    assert_eq!(counts(&examination), [(21, 1), (21, 1)]);
    let states = &examination.observability.states;
    assert!(states[0].tests.is_empty(), "more than are listed");
    // by hand, I = Σ J = [[22, 21], [21, 21]]: u for a is (1, -1), for b (-1, 22/21)
    let leading: Vec<_> = states.iter().map(|s| s.leading.clone().expect("known")).collect();
    assert_eq!((leading[0].test.as_str(), leading[1].test.as_str()), ("z", "z"));
    assert!((leading[0].share - 1.0).abs() < 1e-12, "{}", leading[0].share);
    let square = (1.0f64 / 21.0).powi(2);
    let expected = (1.0 + square) / (1.0 + 21.0 * square);
    assert!((leading[1].share - expected).abs() < 1e-12, "{} {expected}", leading[1].share);
}

fn zeros(p: usize) -> Vec<Vec<kalfit::Expression>> {
    vec![vec![kalfit::Expression::Number(0.0); p]; p]
}

#[test]
fn a_nearly_dark_direction_of_the_mean_is_weakly_determined() {
    let tilt = 1e-3;
    let rows: [&[f64]; 2] = [&[1.0, 1.0 + tilt], &[1.0, 1.0 - tilt]];
    let fixed = CovarianceStructure { kind: CovarianceKind::Fixed(zeros(2)), ..CovarianceStructure::full() };
    let examination = examine_under(&vec![test("a", &rows), test("b", &rows)].into(), &MeanStructure::free(2), &fixed);
    assert!(examination.unidentified.is_empty(), "{:?}", examination.unidentified);
    let weak = &examination.observability.weak;
    assert_eq!(weak.len(), 1, "{weak:?}");
    // correlation of the two columns is 1/√(1 + tilt²)
    let rho = 1.0 / (1.0 + tilt * tilt).sqrt();
    let expected = ((1.0 + rho) / (1.0 - rho)).sqrt();
    assert!((weak[0].condition / expected - 1.0).abs() < 1e-6, "{} {expected}", weak[0].condition);
    assert!((weak[0].direction[0] + weak[0].direction[1]).abs() < 1e-5, "{:?}", weak[0].direction);
    let well: [&[f64]; 2] = [&[1.0, 0.2], &[1.0, -0.1]];
    assert!(examine(&vec![test("a", &well), test("b", &well)].into()).observability.weak.is_empty());
}

#[test]
fn too_few_tests_for_a_covariance_are_counted() {
    let whole: [&[f64]; 3] = [&[1.0, 0.0, 0.0], &[0.0, 1.0, 0.0], &[0.0, 0.0, 1.0]];
    let data: Reductions = (0..3).map(|j| test(&format!("t{j}"), &whole)).collect();
    let shortages = examine(&data).observability.shortages;
    assert_eq!(shortages.len(), 1);
    assert_eq!((shortages[0].states.clone(), shortages[0].tests, shortages[0].rank), (vec![0, 1, 2], 3, 2));
    // and the fit is as singular as that
    let alpha = Alpha::default();
    let (mean, covariance) = (MeanStructure::free(3), CovarianceStructure::full());
    let structure = Structure::single(&mean, &covariance, &alpha);
    let fit = estimate::fit(&data, &structure, &Settings::of(Solver::Newton), &mut Silent).expect("a fit");
    let rank = infer::infer(&fit, &data, infer::Choices::default()).uncertainty.boundary[0].rank;
    assert!(rank <= 2, "{rank}");
    let known = MeanStructure { elements: vec![MeanElement::Fixed(0.0); 3], ..MeanStructure::free(3) };
    assert!(examine_under(&data, &known, &covariance).observability.shortages.is_empty());
    let diagonal = CovarianceStructure { kind: CovarianceKind::Diagonal, ..CovarianceStructure::full() };
    assert!(examine_under(&data, &mean, &diagonal).observability.shortages.is_empty());
}

#[test]
fn a_covariate_that_does_not_vary_is_confounded_with_the_mean() {
    let with = |x: &dyn Fn(usize) -> f64| -> Reductions {
        let one =
            |j: usize| Reduction { covariates: vec![x(j)], ..test(&format!("t{j}"), &[&[1.0, 0.0], &[0.0, 1.0]]) };
        (0..8).map(one).collect()
    };
    let regression = vec![Regression { element: 1, column: 0 }];
    let mean = MeanStructure { regression, ..MeanStructure::free(2) };
    let covariance = CovarianceStructure::full();
    let alpha = Alpha::default();
    let structure = Structure::single(&mean, &covariance, &alpha);
    let fit = |data: &Reductions| {
        let fit = estimate::fit(data, &structure, &Settings::of(Solver::Newton), &mut Silent).expect("a fit");
        infer::infer(&fit, data, infer::Choices::default())
    };
    let data = with(&|_| 2.0);
    let inference = fit(&data);
    assert_eq!(inference.unidentified.len(), 1, "{:?}", inference.unidentified);
    assert_direction(&inference.unidentified[0].direction, &[0.0, 2.0, -1.0]);
    assert_eq!(inference.explanations[0].reason, Reason::Confounded { regressions: vec![0] });
    assert_eq!((inference.uncertainty.errors.mean[1], inference.uncertainty.errors.coefficients[0]), (None, None));
    assert!(inference.uncertainty.errors.mean[0].is_some());
    let inference = fit(&with(&|j| j as f64));
    assert!(inference.unidentified.is_empty(), "{:?}", inference.unidentified);
    assert!(inference.uncertainty.errors.coefficients[0].is_some());
}

#[test]
fn what_is_not_identified_has_no_standard_error_and_what_is_has_one() {
    let mut data: Reductions = (0..9).map(|j| test(&format!("a{j}"), &[&[1.0, 1.0, 0.0, 0.0][..]; 3])).collect();
    data.extend((0..9).map(|j| test(&format!("b{j}"), &[&[0.0, 0.0, 1.0, 0.0][..]; 3])));
    let (mean, covariance) = (MeanStructure::free(4), CovarianceStructure::full());
    let alpha = Alpha::default();
    let structure = Structure::single(&mean, &covariance, &alpha);
    let fit = estimate::fit(&data, &structure, &Settings::of(Solver::Newton), &mut Silent).expect("a fit");
    let inference = infer::infer(&fit, &data, infer::Choices::default());
    let errors = &inference.uncertainty.errors.mean;
    assert_eq!(errors.iter().map(Option::is_some).collect::<Vec<_>>(), [false, false, true, false], "{errors:?}");
    let leading: Vec<bool> = inference.observability.states.iter().map(|s| s.leading.is_some()).collect();
    assert_eq!(leading, [false, false, true, false], "shares of means that are not identified");
}

#[test]
fn units_and_the_order_of_tests_change_nothing_but_directions() {
    let ensemble = |scale: [f64; 3], reversed: bool| {
        let mut data = Reductions::new();
        for j in 0..12 {
            let row = |a: f64, b: f64, c: f64| [a * scale[0], b * scale[1], c * scale[2]];
            let x = 0.3 * f64::from(j);
            let rows = match j % 3 {
                0 => vec![row(1.0, 1.0, 0.0), row(1.0, 1.0 + x, 0.0)],
                1 => vec![row(0.0, 0.0, 1.0), row(0.0, 0.0, 2.0)],
                _ => vec![row(1.0, x, 0.0)],
            };
            let rows: Vec<&[f64]> = rows.iter().map(|row| row.as_slice()).collect();
            data.push(test(&format!("t{j:02}"), &rows));
        }
        if reversed {
            data = data.iter().rev().collect();
        }
        examine(&data)
    };
    let plain = ensemble([1.0; 3], false);
    assert_eq!(counts(&plain), [(8, 3), (8, 3), (4, 4)]);
    for (scale, reversed) in [([1.0; 3], true), ([1e-8, 3.0, 1e6], false), ([1e5, 1e5, 1e-7], true)] {
        let other = ensemble(scale, reversed);
        assert_eq!(counts(&other), counts(&plain), "{scale:?}");
        assert_eq!(other.explanations, plain.explanations, "{scale:?}");
        assert_eq!(other.observability.together, plain.observability.together, "{scale:?}");
        for (a, b) in other.observability.states.iter().zip(&plain.observability.states) {
            let (a, b) = (a.leading.as_ref().expect("known"), b.leading.as_ref().expect("known"));
            assert_eq!(a.test, b.test, "{scale:?}");
            assert!((a.share / b.share - 1.0).abs() < 1e-8, "{scale:?}: {} {}", a.share, b.share);
        }
    }
}
