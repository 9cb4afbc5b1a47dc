//! Plans against textbook designs, an exhaustive search, and the cases of theory §15.

use std::sync::Arc;

use kalfit_fixtures::near;
use nalgebra::{DMatrix, DVector};

use super::{Criterion, Kinds, PlanProblem, Relaxed, Scenario, in_whole_numbers, relax};

fn problem(base: DMatrix<f64>, kinds: Vec<DMatrix<f64>>, criterion: Criterion, limits: Kinds) -> PlanProblem {
    PlanProblem { kinds: limits, scenarios: vec![Scenario { base, kinds: Arc::new(kinds), criterion }] }
}

/// Unlimited numbers of tests that cost one each.
fn unlimited(count: usize, budget: f64) -> Kinds {
    Kinds { costs: vec![1.0; count], most: vec![f64::INFINITY; count], budget }
}

/// Information of one measurement at x about the coefficients of a polynomial.
fn polynomial(x: f64, coefficients: usize) -> DMatrix<f64> {
    let row = DVector::from_fn(coefficients, |i, _| x.powi(i32::try_from(i).expect("few")));
    &row * row.transpose()
}

/// The certificate (15.4), written out again from M and its inverse for the determinant.
fn gap_again(problem: &PlanProblem, plan: &Relaxed) -> f64 {
    let own = &problem.scenarios[0];
    let inverse = own.information(&plan.numbers).try_inverse().expect("regular");
    let d = inverse.nrows() as f64;
    let mut per_cost: Vec<(f64, usize)> =
        (0..own.kinds.len()).map(|k| ((&inverse * &own.kinds[k]).trace() / d / problem.kinds.costs[k], k)).collect();
    per_cost.sort_by(|a, b| b.0.total_cmp(&a.0));
    let (mut left, mut sum) = (problem.kinds.budget, (&inverse * &own.base).trace() / d - 1.0);
    for (gain, k) in per_cost {
        let spent = left.min(problem.kinds.most[k] * problem.kinds.costs[k]);
        (left, sum) = (left - spent, sum + spent * gain);
    }
    sum
}

#[test]
fn polynomials_have_the_designs_of_the_textbooks() {
    let grid: Vec<f64> = (0..=400).map(|k| -1.0 + f64::from(k) / 200.0).collect();
    for (coefficients, expected) in
        [(3, vec![(-1.0, 1.0 / 3.0), (0.0, 1.0 / 3.0), (1.0, 1.0 / 3.0)]), (4, vec![(-1.0, 0.25), (1.0, 0.25)])]
    {
        let kinds = grid.iter().map(|&x| polynomial(x, coefficients)).collect();
        let zero = DMatrix::zeros(coefficients, coefficients);
        let problem = problem(zero, kinds, Criterion::Determinant, unlimited(grid.len(), 1.0));
        let found = relax(&problem).expect("regular");
        assert!(found.gap.abs() < 1e-9, "gap {}", found.gap);
        near::absolute("the certificate", gap_again(&problem, &found), found.gap, 1e-11);
        for (x, share) in expected {
            let at = grid.iter().position(|own| (own - x).abs() < 1e-12).expect("on the grid");
            near::absolute("share", found.numbers[at], share, 1e-5);
        }
        if coefficients == 4 {
            // ±1/√5 lies between two points of the grid, which share it
            let inner: f64 =
                grid.iter().zip(&found.numbers).filter(|(x, _)| (**x - 0.4475).abs() < 0.01).map(|(_, n)| n).sum();
            near::absolute("share at 1/√5", inner, 0.25, 1e-4);
        }
    }
}

/// A random slope over rows at 0 and 1: the D-optimal share of rows at 1 is 1/(1 + √(1 + κ)), κ = m s/v.
#[test]
fn rows_of_a_random_slope_have_the_shares_of_theory() {
    for (kappa, rows, expected) in [(15.0, 10, 2), (8.0, 12, 3), (3.0, 12, 4)] {
        let slope_variance = kappa / f64::from(rows);
        let of = |ones: i32| {
            let j =
                DMatrix::from_row_slice(2, 2, &[f64::from(rows), f64::from(ones), f64::from(ones), f64::from(ones)]);
            let sigma = DMatrix::from_row_slice(2, 2, &[0.0, 0.0, 0.0, slope_variance]);
            (DMatrix::identity(2, 2) + &j * sigma).try_inverse().expect("regular") * j
        };
        let kinds: Vec<DMatrix<f64>> = (1..rows).map(of).collect();
        let found =
            relax(&problem(DMatrix::zeros(2, 2), kinds, Criterion::Determinant, unlimited(rows as usize - 1, 1.0)));
        let found = found.expect("regular");
        near::absolute("all tests are of one kind", found.numbers[expected - 1], 1.0, 1e-6);
        assert!(found.gap.abs() < 1e-9);
    }
}

/// Information about (β, Σ 11, 12, 13, 22, 23, 33) of a test with J, with respect to elements of Σ.
fn information(j: &DMatrix<f64>, sigma: &DMatrix<f64>) -> DMatrix<f64> {
    let p = j.nrows();
    let w = (DMatrix::identity(p, p) + j * sigma).try_inverse().expect("regular") * j;
    let elements: Vec<DMatrix<f64>> = (0..p)
        .flat_map(|a| (a..p).map(move |b| (a, b)))
        .map(|(a, b)| {
            let mut s = DMatrix::zeros(p, p);
            (s[(a, b)], s[(b, a)]) = (1.0, 1.0);
            s
        })
        .collect();
    let mut all = DMatrix::zeros(p + elements.len(), p + elements.len());
    all.view_mut((0, 0), (p, p)).copy_from(&w);
    for (k, s) in elements.iter().enumerate() {
        for (l, t) in elements.iter().enumerate() {
            all[(p + k, p + l)] = 0.5 * (&w * s * &w * t).trace();
        }
    }
    all
}

/// The kinds of theory §15, case 1: static, rate, tumble and centrifuge, with the tests that were made already.
fn instruments() -> (DMatrix<f64>, Vec<DMatrix<f64>>, Kinds) {
    let sigma = DMatrix::from_row_slice(3, 3, &[0.6, 0.3, -0.05, 0.3, 1.0, -0.2, -0.05, -0.2, 0.1]);
    let rows: [&[[f64; 3]]; 4] = [
        &[[1.0, 0.0, 1.0], [1.0, 0.0, -1.0], [1.0, 0.0, 0.0]],
        &[[1.0, 1.0, 0.0], [1.0, -1.0, 0.0]],
        &[[1.0, 0.5, 1.0], [1.0, -0.5, -1.0], [1.0, 1.0, 0.0], [1.0, 0.0, 0.5]],
        &[[1.0, 0.0, 5.0], [1.0, 0.2, 10.0], [1.0, 0.0, 0.0]],
    ];
    let of = |rows: &&[[f64; 3]]| {
        let j = rows.iter().fold(DMatrix::zeros(3, 3), |sum, row| {
            let h = DVector::from_row_slice(row);
            sum + &h * h.transpose() / 0.25
        });
        information(&j, &sigma)
    };
    let kinds: Vec<DMatrix<f64>> = rows.iter().map(of).collect();
    let base = (&kinds[0] + &kinds[1]) * 3.0;
    (base, kinds, Kinds { costs: vec![1.0, 2.0, 3.0, 5.0], most: vec![12.0, 8.0, 5.0, 3.0], budget: 20.0 })
}

fn figure(entries: &[(usize, f64)]) -> DMatrix<f64> {
    let mut h = DMatrix::zeros(9, 1);
    entries.iter().for_each(|&(k, x)| h[(k, 0)] = x);
    h
}

/// A criterion with relaxed numbers, whole numbers, and log φ of both.
type Case = (Criterion, [f64; 4], [f64; 4], [f64; 2]);

/// The criteria of case 1.
fn expected() -> [Case; 4] {
    // corr(bias, scale) with variances 0.6 and 1, and covariance 0.3
    let (unit, rho) = (0.6f64.sqrt(), 0.3 / 0.6f64.sqrt());
    let mut means = DMatrix::zeros(9, 3);
    [0.6f64, 1.0, 0.1].iter().enumerate().for_each(|(i, variance)| means[(i, i)] = variance.sqrt().recip());
    [
        (
            Criterion::Determinant,
            [7.598_549_963, 0.0, 4.133_816_679, 0.0],
            [8.0, 0.0, 4.0, 0.0],
            [3.229_674_258_968, 3.229_460_251_723],
        ),
        (
            Criterion::Variances(figure(&[(6, 0.5)])),
            [0.0, 8.0, 4.0 / 3.0, 0.0],
            [1.0, 8.0, 1.0, 0.0],
            [2.958_580_446_425, 2.936_254_979_958],
        ),
        (
            Criterion::Variances(figure(&[(4, unit.recip()), (3, -0.5 * rho / 0.6), (6, -0.5 * rho)])),
            [0.0, 8.0, 4.0 / 3.0, 0.0],
            [1.0, 8.0, 1.0, 0.0],
            [2.494_641_981_894, 2.469_754_821_347],
        ),
        (
            Criterion::Variances(means),
            [11.159_849_038, 2.250_672_929, 1.446_268_369, 0.0],
            [11.0, 3.0, 1.0, 0.0],
            [1.056_446_593_123, 1.054_659_416_705],
        ),
    ]
}

/// All plans in whole numbers within the budget.
fn all_plans(kinds: &Kinds) -> Vec<Vec<f64>> {
    let mut plans = vec![Vec::new()];
    for k in 0..kinds.costs.len() {
        let longer = |plan: &Vec<f64>| {
            let plan = plan.clone();
            (0..=20).map(f64::from).take_while(move |n| *n <= kinds.most[k]).map(move |n| [&plan[..], &[n]].concat())
        };
        plans = plans.iter().flat_map(longer).collect();
    }
    plans.retain(|plan| plan.iter().zip(&kinds.costs).map(|(n, c)| n * c).sum::<f64>() <= kinds.budget);
    plans
}

#[test]
fn plans_of_instruments_are_those_of_the_exhaustive_search() {
    let (base, kinds, limits) = instruments();
    for (criterion, relaxed, whole, [log_phi, of_whole]) in expected() {
        let problem = problem(base.clone(), kinds.clone(), criterion, limits.clone()).regular();
        let found = relax(&problem).expect("regular");
        assert!(found.gap.abs() < 2e-9, "gap {}", found.gap);
        near::absolute("relaxed log φ", found.log_phi, log_phi, 1e-8);
        found.numbers.iter().zip(relaxed).for_each(|(n, expected)| near::absolute("relaxed", *n, expected, 2e-3));
        let plan = in_whole_numbers(&problem, &found).expect("regular");
        assert_eq!(plan.numbers, whole);
        assert!(plan.is_optimal() && plan.nodes < 50, "{plan:?}");
        near::absolute("log φ in whole numbers", plan.log_phi, of_whole, 1e-8);
        let best = all_plans(&limits).iter().filter_map(|plan| problem.log_phi(plan)).fold(f64::NEG_INFINITY, f64::max);
        near::absolute("the best of all", plan.log_phi, best, 1e-10);
    }
}

#[test]
fn slopes_are_those_of_differences() {
    let (base, kinds, limits) = instruments();
    for (criterion, ..) in expected().into_iter().chain([(
        Criterion::FigureDeterminant({
            let mut figures = DMatrix::zeros(9, 2);
            (figures[(6, 0)], figures[(0, 1)], figures[(4, 1)]) = (0.5, 1.0, 0.3);
            figures
        }),
        [0.0; 4],
        [0.0; 4],
        [0.0; 2],
    )]) {
        let problem = problem(base.clone(), kinds.clone(), criterion, limits.clone());
        let numbers = [2.0, 1.0, 1.5, 0.5];
        let at = problem.value(&numbers).expect("regular");
        let hessian = problem.hessian(&at, &[0, 1, 2, 3]);
        near::absolute(
            "⟨G, M⟩ = 1",
            at.of_base + at.gains.iter().zip(numbers).map(|(g, n)| g * n).sum::<f64>(),
            1.0,
            1e-12,
        );
        for k in 0..4 {
            let moved = |step: f64| {
                let mut numbers = numbers.to_vec();
                numbers[k] += step;
                problem.value(&numbers).expect("regular")
            };
            let (up, down) = (moved(1e-5), moved(-1e-5));
            near::absolute("slope", (up.log_phi - down.log_phi) / 2e-5, at.gains[k], 1e-8);
            (0..4)
                .for_each(|l| near::absolute("curvature", (up.gains[l] - down.gains[l]) / 2e-5, hessian[(k, l)], 1e-8));
        }
    }
}

/// Random kinds with random costs, caps and criteria.
#[test]
fn random_plans_are_those_of_the_exhaustive_search() {
    let mut state = 1980u64;
    let mut random = move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as f64 / f64::from(1u32 << 31)
    };
    for case in 0..40 {
        let (d, count) = (2 + case % 3, 3 + case % 3);
        let kinds: Vec<DMatrix<f64>> = (0..count)
            .map(|_| {
                let rows = DMatrix::from_fn(1 + case % 2, d, |_, _| 2.0 * random() - 1.0);
                rows.transpose() * rows
            })
            .collect();
        let base = if case % 4 == 0 { DMatrix::zeros(d, d) } else { DMatrix::identity(d, d) * 0.3 };
        let column = DMatrix::from_fn(d, 1, |_, _| random() - 0.5);
        let criterion = match case % 3 {
            0 => Criterion::Determinant,
            1 => Criterion::Variances(column),
            _ => Criterion::FigureDeterminant(DMatrix::from_fn(d, 2, |_, _| random() - 0.5)),
        };
        let limits = Kinds {
            costs: (0..count).map(|_| 1.0 + (3.0 * random()).floor()).collect(),
            most: (0..count).map(|_| 1.0 + (6.0 * random()).floor()).collect(),
            budget: 8.0 + (case % 7) as f64,
        };
        let problem = problem(base, kinds, criterion, limits.clone()).regular();
        let best = all_plans(&limits).iter().filter_map(|plan| problem.log_phi(plan)).fold(f64::NEG_INFINITY, f64::max);
        let Some(found) = relax(&problem) else {
            assert!(!best.is_finite(), "case {case}: {best}");
            continue;
        };
        assert!(found.log_phi + found.gap.max(0.0) >= best - 1e-9, "case {case}: bound {} of {best}", found.log_phi);
        assert!(found.gap < 1e-6, "case {case}: gap {}", found.gap);
        match in_whole_numbers(&problem, &found) {
            Some(plan) => {
                assert!(plan.is_optimal(), "case {case}: {plan:?}");
                near::absolute("the best of all", plan.log_phi, best, 1e-9);
            }
            None => assert!(!best.is_finite(), "case {case}: {best}"),
        }
    }
}

/// Plans whose first rounding is singular, or has a kind that is in no better plan, are found all the same; and none costs
/// more than the budget, however near to it.
#[test]
fn plans_are_found_where_rounding_is_far_from_them() {
    let one = |x: f64| DMatrix::from_element(1, 1, x);
    // one test of the second kind fits and is best, though the relaxed plan has the first alone
    let limits = Kinds { costs: vec![0.7, 1.0], most: vec![f64::INFINITY; 2], budget: 1.0 };
    let first = problem(DMatrix::zeros(1, 1), vec![one(0.5), one(2.0 / 3.0)], Criterion::Determinant, limits);
    let plan = in_whole_numbers(&first, &relax(&first).expect("regular")).expect("there is one");
    assert_eq!(plan.numbers, [0.0, 1.0]);
    // only the dear kind informs both
    let dear = DMatrix::from_row_slice(2, 2, &[1.0, 0.5, 0.5, 1.0]);
    let cheap = DMatrix::from_row_slice(2, 2, &[5.0, 0.0, 0.0, 0.0]);
    for budget in [3.0, 3.2, 4.0, 4.2, 4.5, 5.0] {
        let limits = Kinds { costs: vec![0.7, 3.0], most: vec![f64::INFINITY; 2], budget };
        let problem = problem(DMatrix::zeros(2, 2), vec![cheap.clone(), dear.clone()], Criterion::Determinant, limits);
        let plan = in_whole_numbers(&problem, &relax(&problem).expect("regular")).expect("there is one");
        assert_eq!(plan.numbers[1], 1.0, "budget {budget}: {plan:?}");
        assert!(plan.is_optimal(), "budget {budget}: {plan:?}");
    }
    let limits = Kinds { costs: vec![1e6; 3], most: vec![1.0; 3], budget: 2_999_999.9 };
    let kinds = vec![one(1.0), one(1.1), one(1.2)];
    let three = problem(DMatrix::zeros(1, 1), kinds, Criterion::Determinant, limits);
    let plan = in_whole_numbers(&three, &relax(&three).expect("regular")).expect("there is one");
    assert_eq!(plan.numbers, [0.0, 1.0, 1.0]);
    // many tests of a kind are filled in few steps
    let limits = Kinds { costs: vec![1e-6, 1.0], most: vec![1e9; 2], budget: 20.7 };
    let many = problem(one(1.0), vec![one(1e-7), one(1.0)], Criterion::Determinant, limits);
    let plan = in_whole_numbers(&many, &relax(&many).expect("regular")).expect("there is one");
    assert!(plan.log_phi > 3.0 && plan.numbers.iter().all(|n| n.fract() == 0.0), "{plan:?}");
}
