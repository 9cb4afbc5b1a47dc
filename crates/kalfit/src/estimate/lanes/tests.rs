//! Blocks against the formulas for any class, one test at a time.

use kalfit_lanes::Isa;
use nalgebra::DMatrix;

use super::*;
use crate::estimate::order::FlatMean;
use crate::estimate::pass::one_by_one;
use crate::estimate::terms::Terms;
use crate::linalg::elements::Elements;

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

/// All sums in one row: of the blocks, and test by test.
fn both(p: usize, isa: Isa, tests: usize) -> (Vec<f64>, Vec<f64>) {
    let point = point(p);
    let classes: Vec<Class> = (0..tests).map(|j| class(p, j)).collect();
    let blocks = Blocks::filled((p, 0, false), isa, tests, &|j, place| place.set(classes[j].view()));
    let mut found: Vec<f64> = Vec::new();
    for totals in blocks.totals(&point, Order::Expected) {
        let parts = [&totals.r, &totals.W, &totals.outer, &totals.curvature, &totals.cross, &totals.expected];
        let row = [totals.log_det, totals.quadratic].into_iter().chain(parts.into_iter().flatten().copied());
        let row: Vec<f64> = row.collect();
        found.resize(row.len(), 0.0);
        found.iter_mut().zip(&row).for_each(|(sum, x)| *sum += x);
    }
    let mut expected = vec![0.0; found.len()];
    let mut terms = Terms::new(p);
    for class in classes.iter().map(Class::view) {
        terms.factorise(class, &point.root);
        terms.finish(class, &[], &point);
        let log_det = -2.0 * (terms.value(class) - class.constant) - terms.quadratic;
        let places: Vec<usize> = (0..p).flat_map(|i| (0..=i).map(move |k| i * p + k)).collect();
        let inner = |at: usize| terms.outer[at] - 0.5 * terms.W[at];
        let mut row = vec![log_det, terms.quadratic];
        row.extend(&terms.r);
        row.extend(places.iter().map(|&at| terms.W[at]));
        row.extend(places.iter().map(|&at| terms.outer[at]));
        row.extend(
            places.iter().flat_map(|&a| places.iter().map(move |&b| (a, b))).map(|(a, b)| terms.W[a] * inner(b)),
        );
        row.extend(places.iter().flat_map(|&a| (0..p).map(move |l| (a, l))).map(|(a, l)| terms.W[a] * terms.r[l]));
        row.extend(
            places.iter().flat_map(|&a| places.iter().map(move |&b| (a, b))).map(|(a, b)| terms.W[a] * terms.W[b]),
        );
        expected.iter_mut().zip(&row).for_each(|(sum, x)| *sum += x);
    }
    (found, expected)
}

#[test]
fn blocks_say_what_their_tests_say_one_by_one() {
    for isa in Isa::all() {
        for p in (1..=10).chain([13, 20]) {
            // also blocks that are not full, and more than one task
            for tests in [1, isa.lanes(), 3 * isa.lanes() + 1, fewest(p) * isa.lanes() + 3] {
                let (found, expected) = both(p, *isa, tests);
                let largest = expected.iter().fold(0.0_f64, |most, x| most.max(x.abs()));
                for (at, (found, expected)) in found.iter().zip(&expected).enumerate() {
                    let allowed = 1e-12 * (1.0 + largest) + 1e-11 * expected.abs();
                    assert!(
                        (found - expected).abs() < allowed,
                        "{isa:?}, p = {p}, {tests} tests, {at}: {found} {expected}"
                    );
                }
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
fn several_tests_regressions_and_the_restricted_likelihood_are_summed_as_one_by_one() {
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
                let wanted = Wanted { elements: &elements, regressors: &regressors, order: Order::Expected, flat };
                for tests in [1, 2 * isa.lanes() + 1, fewest(p) * isa.lanes() + 3] {
                    let classes: Vec<Class> =
                        (0..tests).map(|j| any_class(p, j, (regressors.len(), several))).collect();
                    let fill = |j: usize, place: &mut Class| place.set(classes[j].view());
                    let blocks = Blocks::filled((p, regressors.len(), several), *isa, tests, &fill);
                    let mut found = wanted.zero();
                    found.value += blocks.constant();
                    blocks.whole(&point, wanted).into_iter().for_each(|totals| found.take_whole(totals));
                    let expected =
                        one_by_one(&classes.iter().map(Class::view).collect::<Vec<_>>(), &point, wanted).numbers();
                    let largest = expected.iter().fold(0.0_f64, |most, x| most.max(x.abs()));
                    for (at, (found, expected)) in found.numbers().iter().zip(&expected).enumerate() {
                        let allowed = 1e-12 * (1.0 + largest) + 1e-11 * expected.abs();
                        assert!(
                            (found - expected).abs() < allowed,
                            "{isa:?}, p = {p}, several {several}, {tests} tests, {at}: {found} {expected}"
                        );
                    }
                }
            }
        }
    }
}

/// What is put into blocks comes out again.
#[test]
fn classes_are_read_as_they_were_put() {
    for (p, covariates, several) in [(1, 0, false), (3, 2, false), (2, 1, true), (4, 0, true)] {
        let classes: Vec<Class> = (0..19).map(|j| any_class(p, j, (covariates, several))).collect();
        let fill = |j: usize, place: &mut Class| place.set(classes[j].view());
        let blocks = Blocks::filled((p, covariates, several), Isa::best(), classes.len(), &fill);
        let mut found = Class::default();
        for (j, class) in classes.iter().enumerate() {
            blocks.read(j, &mut found);
            assert_eq!((found.count, found.constant), (class.count, class.constant), "p = {p}, {j}");
            let numbers = |class: &Class| [&class.factor[..], &class.mean, &class.scatter, &class.covariates].concat();
            assert_eq!(numbers(&found), numbers(class), "p = {p}, {j}");
        }
    }
}
