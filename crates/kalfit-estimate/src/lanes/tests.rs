//! Sums over classes, in lanes and one by one, against the formulas of the theory.
#![expect(non_snake_case, reason = "R, S, W, E, X are the letters of the theory")]

use kalfit_lanes::Isa;
use nalgebra::{DMatrix, DVector};

use super::*;
use crate::class::ClassRef;
use crate::order::FlatMean;
use crate::order::Order;
use crate::pass::one_by_one;
use kalfit_algebra::elements::Elements;

fn class(p: usize, j: usize) -> Class {
    let wave = |seed: usize| ((7 * j + 3 * seed) as f64).sin();
    let factor = |at: usize| match (at / p, at % p) {
        (i, k) if i < k => wave(at),
        (i, k) if i == k => 1.5 + wave(at),
        _ => 0.0,
    };
    Class {
        count: 1.0,
        constant: wave(99),
        factor: (0..p * p).map(factor).collect(),
        mean: (0..p).map(|i| wave(1000 + i)).collect(),
        scatter: Vec::new(),
        covariates: Vec::new(),
        square_root: false,
        chain: None,
    }
}

fn point(p: usize) -> Point {
    Point {
        mean: (0..p).map(|i| 0.1 * i as f64 - 0.2).collect(),
        coefficients: Vec::new(),
        root: DMatrix::from_fn(p, p, |i, k| ((i * 5 + k * 3) as f64).cos()),
    }
}

/// All sums over classes in one phase, as one vector in the order of [`crate::estimate::sums::Sums::numbers`].
fn by_hand(classes: &[Class], point: &Point, SumsWanted { regressors, flat, .. }: SumsWanted<'_>) -> Vec<f64> {
    let (p, m) = (point.mean.len(), point.mean.len() + regressors.len());
    let mean = DVector::from_iterator(m, point.mean.iter().chain(&point.coefficients).copied());
    let places: Vec<(usize, usize)> = (0..p).flat_map(|i| (0..=i).map(move |k| (i, k))).collect();
    let mut sums = Vec::new();
    for class in classes {
        let (n, R) = (class.count, DMatrix::from_row_slice(p, p, &class.factor));
        let E = DMatrix::from_fn(p, m, |i, c| match c.checked_sub(p) {
            None => f64::from(i == c),
            Some(c) => {
                if regressors[c] == i {
                    class.covariates[c]
                } else {
                    0.0
                }
            }
        });
        let S = DMatrix::identity(p, p) + &R * &point.root * (&R * &point.root).transpose();
        let inverse = S.clone().try_inverse().expect("S is at least one");
        let of = |u: &DVector<f64>| (R.transpose() * &inverse * u, (u.transpose() * &inverse * u)[0]);
        let (r, square) = of(&(DVector::from_column_slice(&class.mean) - &R * &E * &mean));
        let (mut outer, mut quadratic) = (&r * r.transpose() * n, n * square);
        for away in class.scatter.chunks_exact(p) {
            let (r, square) = of(&DVector::from_column_slice(away));
            (outer, quadratic) = (outer + &r * r.transpose(), quadratic + square);
        }
        let W = R.transpose() * &inverse * &R;
        let (WE, mut inner) = (&W * &E, &outer - &W * (0.5 * n));
        let WX = flat.map_or_else(|| DMatrix::zeros(p, 0), |flat| &WE * flat.jacobian);
        if let Some(covariance) = flat.and_then(|flat| flat.covariance) {
            inner += &WX * covariance * WX.transpose() * n;
        }
        let mut row = vec![class.constant - 0.5 * (n * S.determinant().ln() + quadratic), quadratic];
        row.extend((E.transpose() * &r * n).iter());
        for matrix in [E.transpose() * &WE * n, outer, &W * n] {
            row.extend(matrix.iter());
        }
        for &(k, l) in &places {
            let both = |c: usize, d: usize| WX[(k, c)] * WX[(l, d)] + WX[(l, c)] * WX[(k, d)];
            row.extend((0..WX.ncols()).flat_map(|c| (0..=c).map(move |d| (c, d))).map(|(c, d)| 0.5 * n * both(c, d)));
        }
        row.extend(places.iter().flat_map(|&b| places.iter().map(move |&a| (a, b))).map(|(a, b)| W[a] * inner[b]));
        let crosses = (0..p).flat_map(|l| (0..p * m).map(move |at| (at / m, at % m, l)));
        row.extend(crosses.map(|(k, c, l)| n * WE[(k, c)] * r[l]));
        row.extend(places.iter().flat_map(|&b| places.iter().map(move |&a| (a, b))).map(|(a, b)| n * W[a] * W[b]));
        sums.resize(row.len(), 0.0);
        sums.iter_mut().zip(&row).for_each(|(sum, x)| *sum += x);
    }
    sums
}

/// Asserts that the sums over blocks of classes, and over the classes one by one, equal those by hand.
fn assert_sums(classes: &[Class], (isa, several): (Isa, bool), point: &Point, wanted: SumsWanted<'_>) {
    let p = point.mean.len();
    let fill = |j: usize, place: &mut Class| place.set(classes[j].view());
    let blocks = ClassBatches::filled((p, wanted.regressors.len(), several), isa, classes.len(), &fill);
    let mut together = wanted.zero();
    together.value += blocks.constant();
    blocks.totals(point, wanted).into_iter().for_each(|totals| together.take(totals));
    // every second class by square roots
    let view = |j: usize| ClassRef { square_root: j % 2 == 1, ..classes[j].view() };
    let alone = one_by_one(&(0..classes.len()).map(view).collect::<Vec<_>>(), point, wanted);
    let expected = by_hand(classes, point, wanted);
    let largest = expected.iter().fold(0.0_f64, |most, x| most.max(x.abs()));
    for (way, found) in [("side by side", together), ("one by one", alone)] {
        let found = found.numbers();
        assert_eq!(found.len(), expected.len());
        for (at, (found, expected)) in found.iter().zip(&expected).enumerate() {
            let allowed = 1e-12 * (1.0 + largest) + 1e-11 * expected.abs();
            let about = format!("{way}, {isa:?}, p = {p}, several {several}, {} classes", classes.len());
            assert!((found - expected).abs() < allowed, "{about}, {at}: {found} {expected}");
        }
    }
}

#[test]
fn sums_over_single_tests_are_those_by_hand() {
    for isa in Isa::all() {
        for p in (1..=10).chain([13, 20]) {
            let elements = Elements::single(p);
            let wanted = SumsWanted { elements: &elements, regressors: &[], order: Order::Expected, flat: None };
            // also blocks that are not full, and more than one task
            for tests in [1, isa.lanes(), 3 * isa.lanes() + 1, min_blocks(p) * isa.lanes() + 3] {
                let classes: Vec<Class> = (0..tests).map(|j| class(p, j)).collect();
                assert_sums(&classes, (*isa, false), &point(p), wanted);
            }
        }
    }
}

/// A class of one test, or of several, with covariates.
fn any_class(p: usize, j: usize, (covariates, several): (usize, bool)) -> Class {
    let wave = |seed: usize| ((5 * j + 2 * seed) as f64).cos();
    let count = if several { 2 + j % 4 } else { 1 };
    Class {
        count: count as f64,
        scatter: (0..p * (if several { p.min(count) } else { 0 })).map(|i| wave(300 + i)).collect(),
        covariates: (0..covariates).map(|c| wave(600 + c)).collect(),
        ..class(p, j)
    }
}

#[test]
fn sums_over_several_tests_with_regressions_and_the_restricted_likelihood_are_those_by_hand() {
    for isa in Isa::all() {
        for (p, regressors, q, several) in [
            (1, vec![], 1, true),
            (2, vec![], 0, true),
            (2, vec![1, 0, 1], 0, false),
            (3, vec![2, 0], 4, true),
            (5, vec![1, 4, 4], 6, false),
            (12, vec![3], 13, true),
        ] {
            let m = p + regressors.len();
            let jacobian = DMatrix::from_fn(m, q, |i, c| if i == c { 1.0 } else { 0.3 * ((i + 2 * c) as f64).sin() });
            let half = DMatrix::from_fn(q, q, |i, c| ((3 * i + c) as f64).cos());
            let covariance = &half * half.transpose() * 0.1;
            let point = Point { coefficients: (0..m - p).map(|c| 0.4 - 0.3 * c as f64).collect(), ..point(p) };
            let elements = Elements::single(p);
            for known in [None, Some(&covariance)] {
                let flat = FlatMean { jacobian: &jacobian, covariance: known };
                let flat = (q > 0).then_some(&flat);
                let wanted = SumsWanted { elements: &elements, regressors: &regressors, order: Order::Expected, flat };
                for tests in [1, 2 * isa.lanes() + 1, min_blocks(p) * isa.lanes() + 3] {
                    let classes: Vec<Class> =
                        (0..tests).map(|j| any_class(p, j, (regressors.len(), several))).collect();
                    assert_sums(&classes, (*isa, several), &point, wanted);
                }
            }
        }
    }
}

/// Classes that are written into blocks are read back unchanged.
#[test]
fn classes_are_read_as_they_were_put() {
    for (p, covariates, several) in [(1, 0, false), (3, 2, false), (2, 1, true), (4, 0, true)] {
        let classes: Vec<Class> = (0..19).map(|j| any_class(p, j, (covariates, several))).collect();
        let fill = |j: usize, place: &mut Class| place.set(classes[j].view());
        let blocks = ClassBatches::filled((p, covariates, several), Isa::best(), classes.len(), &fill);
        let mut found = Class::default();
        for (j, class) in classes.iter().enumerate() {
            blocks.read(j, &mut found);
            assert_eq!((found.count, found.constant), (class.count, class.constant), "p = {p}, {j}");
            let numbers = |class: &Class| [&class.factor[..], &class.mean, &class.scatter, &class.covariates].concat();
            assert_eq!(numbers(&found), numbers(class), "p = {p}, {j}");
        }
    }
}
