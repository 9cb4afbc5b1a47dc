//! Predictive densities of folds against refits without each fold.

use crate::face::{Ensemble, Options};
use crate::validate::{Folds, Validation, validate};
use kalfit_apply::apply::Applied;
use kalfit_estimate::Silent;
use kalfit_model::build::{Columns, constant, free, measurement, name};
use kalfit_model::{Model, PhasedModel};

fn model(noise_is_free: bool) -> PhasedModel {
    let builder = Model::builder("lines").state(constant("level")).state(constant("slope"));
    let equation = name("level") + name("x") * name("slope");
    match noise_is_free {
        true => builder.parameter(free("sigma")).measurement(measurement("y", equation, name("sigma"))),
        false => builder.measurement(measurement("y", equation, 0.5)),
    }
    .build()
    .expect("a model")
}

fn lines() -> Vec<Columns> {
    let one = |j: usize| {
        let x: Vec<f64> = (0..5 + j % 3).map(|k| k as f64).collect();
        let [level, slope] = [((j * 7) % 11) as f64 / 3.0, ((j * 5) % 9) as f64 / 8.0];
        let y = x
            .iter()
            .map(|x| level + slope * x + ((3 * j + 5 * *x as usize) % 7) as f64 / 7.0 - 0.4)
            .collect::<Vec<_>>();
        Columns::new(format!("t{j:02}")).numbers("x", x).numbers("y", y)
    };
    (0..12).map(one).collect()
}

/// Log densities of the tests of each fold at a fit to the others.
fn refitted(ensemble: &Ensemble, folds: &Folds) -> Vec<(String, f64)> {
    let options = Options { innovations: false, ..Options::default() };
    let mut found = Vec::new();
    for fold in 0..folds.count() {
        let (inside, others) = folds.split(fold);
        let pick = |of: &[usize]| of.iter().map(|&test| ensemble.tests()[test].clone()).collect::<Vec<_>>();
        let rest = Ensemble::of_tests(ensemble.model(), ensemble.labels().clone(), pick(&others));
        let fit = rest.fit_with(&options, &mut Silent).expect("a fit");
        assert!(fit.converged(), "{}", fit.record.reason);
        for test in pick(&inside) {
            let tests = [test];
            let applied = Applied::new(ensemble.model(), &fit.alpha, &fit.population(), &tests)
                .map(|own| own.said().expect("it says").posteriors.get(0).log_likelihood);
            let own = applied.expect("it applies");
            found.push((tests[0].id.to_string(), own));
        }
    }
    found.sort_by(|a, b| a.0.cmp(&b.0));
    found
}

fn compare(found: &Validation, expected: &[(String, f64)], tolerance: f64) {
    assert!(found.converged && found.folds.iter().all(|fold| *fold), "{:?}", found.folds);
    assert_eq!(found.pieces.len(), expected.len());
    for (piece, (name, density)) in found.pieces.iter().zip(expected) {
        assert_eq!(&piece.name, name);
        let difference = (piece.log_density - density).abs();
        assert!(difference < tolerance, "{name}: {} against {density}", piece.log_density);
    }
}

#[test]
fn without_each_test_it_is_a_refit_without_it() {
    let model = model(false);
    let ensemble = Ensemble::new(&model, &lines()).expect("tests");
    let folds = Folds::drawn(&model, ensemble.labels(), ensemble.tests(), (12, 1)).expect("folds");
    let found = validate(&ensemble, &folds, &Options::default(), &mut Silent).expect("it validates");
    compare(&found, &refitted(&ensemble, &folds), 1e-7);
}

#[test]
fn folds_are_refits_with_free_parameters_too() {
    let model = model(true);
    let ensemble = Ensemble::new(&model, &lines()).expect("tests");
    let folds = Folds::drawn(&model, ensemble.labels(), ensemble.tests(), (4, 7)).expect("folds");
    assert_eq!(folds.count(), 4);
    assert!((0..4).all(|fold| folds.split(fold).0.len() == 3), "{folds:?}");
    let found = validate(&ensemble, &folds, &Options::default(), &mut Silent).expect("it validates");
    compare(&found, &refitted(&ensemble, &folds), 1e-5);
    let observations: usize = found.pieces.iter().map(|piece| piece.observations).sum();
    assert_eq!(observations, found.tests.iter().map(|test| test.innovations).sum::<usize>());
    assert!(found.pieces.iter().map(|piece| piece.log_density).sum::<f64>() < found.fitted, "{}", found.fitted);
}

#[test]
fn folds_do_not_depend_on_the_order_of_tests() {
    let model = model(false);
    let mut all = lines();
    let first = Ensemble::new(&model, &all).expect("tests");
    all.reverse();
    let second = Ensemble::new(&model, &all).expect("tests");
    let of = |ensemble: &Ensemble| {
        let folds = Folds::drawn(&model, ensemble.labels(), ensemble.tests(), (5, 3)).expect("folds");
        let mut named: Vec<(String, usize)> =
            ensemble.tests().iter().map(|test| test.id.to_string()).zip(folds.of).collect();
        named.sort();
        named
    };
    assert_eq!(of(&first), of(&second));
}
