//! Innovations of tests in phases against the joint Gaussian of the measurements and the likelihood of the fit.

use kalfit::estimate::{Derivatives, Likelihood};
use kalfit::innovations::{Innovations, innovations};
use kalfit::reduce::{Evidence, PhasedReducer, PhasedTest};
use kalfit::simulate::{Designs, Simulator};
use kalfit::{Alpha, Population, Source, Test};
use kalfit_fixtures::near;
use nalgebra::DMatrix;

use crate::three_phases::{law_root, model, population, roots, rows, test, values};

fn drawn(seed: usize, count: u64) -> Vec<PhasedTest> {
    let simulator = Simulator::new(&model(), &Alpha::default(), population(roots(seed)), 3).expect("sound");
    let designs = Designs::new(vec![test("a", &rows())]).expect("a test");
    simulator.draw(&designs, 0..count).expect("sound").into_iter().map(|drawn| drawn.test).collect()
}

fn run(initial: &Population, tests: &[PhasedTest]) -> Vec<Innovations> {
    let found = innovations(&model(), &Alpha::default(), initial, tests).expect("sound");
    found.into_iter().map(|one| one.expect("rows")).collect()
}

#[test]
fn innovations_are_what_earlier_phases_and_rows_did_not_say() {
    for seed in 0..8 {
        let initial = population(roots(seed));
        let (mean, root) = law_root(&rows(), &initial);
        // the triangular root of the covariance, without forming that
        let upper = root.transpose().qr().r();
        let root = DMatrix::from_fn(mean.len(), mean.len(), |i, k| upper[(k, i)] * upper[(k, k)].signum());
        for test in drawn(seed, 3) {
            let z = values(&test);
            let white = root.solve_lower_triangular(&(&z - &mean)).expect("positive");
            let found = run(&initial, std::slice::from_ref(&test)).remove(0);
            assert_eq!(found.summary.count, z.len());
            for (k, one) in found.series.iter().enumerate() {
                let what = format!("seed {seed}, innovation {k}");
                near::mixed(&what, one.standardised, white[k], 1e-9);
                near::mixed(format_args!("{what}, variance"), one.variance / root[(k, k)].powi(2), 1.0, 1e-9);
            }
            let phases: Vec<(usize, usize)> = found.series.iter().map(|one| (one.phase, one.step)).collect();
            assert_eq!(phases[..4], [(0, 0), (0, 0), (0, 1), (0, 2)]);
            assert_eq!(phases[4..], [(1, 0), (1, 0), (1, 2), (1, 2), (1, 3), (2, 0), (2, 1)]);
        }
    }
}

#[test]
fn their_densities_add_up_to_the_likelihood_of_the_test() {
    let mut model = model();
    model.phases[0].model.mean.regression.clear();
    for seed in 0..8 {
        let initial = Population { coefficients: Vec::new(), ..population(roots(seed)) };
        let tests = drawn(seed, 4);
        let reducer = PhasedReducer::new(&model, &Alpha::default()).expect("sound");
        let reductions = reducer.reduce(&tests).expect("sound");
        let found = innovations(&model, &Alpha::default(), &initial, &tests).expect("sound");
        for (reduction, one) in reductions.iter().zip(found) {
            let likelihood = Likelihood::new(&std::iter::once(reduction).collect(), 5);
            let l = likelihood.at(&initial.mean, &initial.covariance, Derivatives::First).log_likelihood;
            let one = one.expect("rows");
            near::mixed(format_args!("seed {seed}"), one.log_likelihood, l, 1e-9);
        }
    }
}

/// Tests of seven designs, which differ in the inputs of all phases; every fifth lacks the last phase.
fn of_several_designs(count: u64) -> Vec<PhasedTest> {
    let mut tests = drawn(0, count);
    for (j, test) in tests.iter_mut().enumerate() {
        let stretched = |rows: &Test| {
            let mut own = Test::new(format!("t{j}"), 5, 1);
            for row in 0..rows.rows() {
                let mut cells = rows.numbers(row).to_vec();
                cells[2] *= 1.0 + 0.1 * (j % 7) as f64;
                own.push(&cells, rows.texts(row), Source::default());
            }
            own
        };
        let phases = test.phases.iter().take(if j % 5 == 4 { 2 } else { 3 }).map(|phase| match phase {
            Evidence::Rows(rows) => Evidence::Rows(stretched(rows)),
            other => other.clone(),
        });
        *test = PhasedTest { id: format!("t{j}").into(), phases: phases.collect() };
    }
    tests
}

#[test]
fn company_order_and_threads_change_no_bit() {
    let (tests, initial, model) = (of_several_designs(60), population(roots(0)), model());
    let reduce = |tests: &[PhasedTest]| {
        PhasedReducer::new(&model, &Alpha::default()).expect("sound").reduce(tests).expect("sound")
    };
    let (reduced, found) = (reduce(&tests), run(&initial, &tests));
    let reversed: Vec<PhasedTest> = tests.iter().rev().cloned().collect();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool");
    let (back, mut found_back) = pool.install(|| (reduce(&reversed), run(&initial, &reversed)));
    found_back.reverse();
    assert!(back.iter().rev().eq(&reduced));
    assert_eq!(found, found_back);
    for (j, test) in tests.iter().enumerate() {
        let alone = std::slice::from_ref(test);
        assert_eq!(reduce(alone).get(0), reduced.get(j), "test {j} by itself");
        assert_eq!(run(&initial, alone)[0], found[j], "innovations of test {j} by itself");
    }
    let reducer = PhasedReducer::new(&model, &Alpha::default()).expect("sound");
    let pieces = reducer.pieces(&tests).expect("sound");
    let known = tests.iter().zip(pieces).map(|(test, pieces)| PhasedTest {
        id: test.id.clone(),
        phases: pieces.into_iter().map(|piece| Evidence::Reduced(Box::new(piece))).collect(),
    });
    for (from_pieces, reduced) in reduce(&known.collect::<Vec<_>>()).iter().zip(&reduced) {
        assert_eq!((from_pieces.factor, from_pieces.data), (reduced.factor, reduced.data), "{}", reduced.test);
    }
}

#[test]
fn a_phase_that_is_reduced_has_no_innovations_and_is_known_to_the_others() {
    let (tests, initial) = (drawn(0, 2), population(roots(0)));
    let whole = run(&initial, &tests);
    let reducer = PhasedReducer::new(&model(), &Alpha::default()).expect("sound");
    let pieces = reducer.pieces(&tests).expect("sound");
    for reduced in 0..3 {
        let mut mixed = tests.clone();
        for (test, pieces) in mixed.iter_mut().zip(&pieces) {
            test.phases[reduced] = Evidence::Reduced(Box::new(pieces[reduced].clone()));
        }
        for (found, whole) in run(&initial, &mixed).iter().zip(&whole) {
            let expected: Vec<_> = whole.series.iter().filter(|one| one.phase != reduced).collect();
            assert_eq!(found.series.len(), expected.len());
            for (a, b) in found.series.iter().zip(expected) {
                assert_eq!((a.phase, a.step, a.measurement), (b.phase, b.step, b.measurement));
                near::mixed("innovation", a.standardised, b.standardised, 1e-10);
            }
            near::mixed("log-likelihood", found.log_likelihood, whole.log_likelihood, 1e-10);
        }
    }
    let mut none = tests[0].clone();
    none.phases = pieces[0].iter().map(|piece| Evidence::Reduced(Box::new(piece.clone()))).collect();
    assert_eq!(innovations(&model(), &Alpha::default(), &initial, &[none]), Ok(vec![None]));
}

#[test]
fn a_phase_that_is_wrongly_modelled_shows_in_its_part() {
    let initial = population(roots(0));
    let mut wrong = model();
    wrong.phases[1].model.measurements[1].noise_variance = kalfit::Expression::Number(25.0);
    let design = test("a", &rows());
    let simulator = Simulator::new(&wrong, &Alpha::default(), initial.clone(), 5).expect("sound");
    let drawn = simulator.draw(&Designs::new(vec![design]).expect("a test"), 0..200).expect("sound");
    let tests: Vec<PhasedTest> = drawn.into_iter().map(|drawn| drawn.test).collect();
    let mut sizes = std::collections::BTreeMap::<(usize, usize), (f64, f64)>::new();
    for found in run(&initial, &tests) {
        let parts = found.parts();
        let count: usize = parts.iter().map(|part| part.summary.count).sum();
        assert_eq!(count, found.summary.count);
        for part in parts {
            let size = sizes.entry((part.phase, part.measurement)).or_default();
            *size = (size.0 + part.summary.nis, size.1 + part.summary.count as f64);
        }
    }
    for (&(phase, measurement), (nis, count)) in &sizes {
        let (mean, spread) = (nis / count, (2.0 / count).sqrt());
        // d is estimated from that measurement: phase three inherits what is wrong
        match (phase, measurement) {
            (1, 1) => assert!(mean > 10.0, "the wrong one: {mean}"),
            (0, _) => assert!((mean - 1.0).abs() < 4.0 * spread, "phase one, {measurement}: {mean} ± {spread}"),
            _ => {}
        }
    }
    assert_eq!(sizes.len(), 5);
}
