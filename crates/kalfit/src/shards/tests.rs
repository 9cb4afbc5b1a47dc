//! Fits by sums, compared with fits of all tests in one place.

use nalgebra::{DMatrix, DVector};

use crate::face::{Ensemble, Options};
use crate::shards::Audit;
use crate::shards::{Asks, Next, Shard, ShardError, go_on};
use kalfit_estimate as estimate;
use kalfit_estimate::{Criterion, Silent};
use kalfit_infer::{Choices, DeletionChoice, DfChoice, IntervalKind, StdErrors, TestsChoice};
use kalfit_model::build::{Columns, ModelBuilder, constant, fixed, free, gauss_markov, measurement, name, phase};
use kalfit_model::remote::{Answer, Asked, sum};
use kalfit_model::{Alpha, Column, CovarianceStructure, GroupLevel, PhasedModel, Population};
use kalfit_record::{FitRecord, Provenance};

/// The fit of tests that are divided among `places` places, and the number of rounds of questions.
fn by_sums(ensemble: &Ensemble, places: usize, asks: &Asks) -> (FitRecord, usize) {
    let tests = ensemble.tests();
    // groups of the outermost level are not split
    let grouping = kalfit_filter::reduce::grouping(ensemble.model(), tests).unwrap();
    let unit = |j: usize| grouping.as_ref().map_or(j, |grouping| grouping.group_of(j, grouping.depth() - 1));
    let part = |k: usize| -> Vec<_> {
        (0..tests.len()).filter(|&j| unit(j) % places == k).map(|j| tests[j].clone()).collect()
    };
    let settings = kalfit_search::Settings { inner: asks.settings.clone(), ..Default::default() };
    let shard = |k| Shard::new(ensemble.model().clone(), ensemble.labels(), part(k), settings.clone()).unwrap();
    let shards: Vec<Shard> = (0..places).map(shard).collect();
    let mut known: Vec<(Asked, Answer)> = Vec::new();
    let model = ensemble.model();
    let slots = kalfit_model::Slots::in_phases(model, &kalfit_model::Labels::new(&model.shared().literals), &[]);
    let audit = Audit::new(model, &slots).unwrap();
    for round in 0..200 {
        match go_on(ensemble.model(), asks, known.clone(), Provenance::default(), &mut Silent).unwrap() {
            Next::Ends(record) => {
                assert_cache_has_no_effect(&shards, (0..places).map(shard).collect(), &known);
                return (*record, round);
            }
            Next::Asks(all) => {
                for asked in all {
                    assert!(known.iter().all(|(other, _)| *other != asked), "asked twice: {asked:?}");
                    let answers: Vec<Answer> = shards.iter().map(|shard| shard.answer(&asked).unwrap()).collect();
                    for (shard, numbers) in shards.iter().zip(&answers).filter_map(|(s, a)| Some((s, a.as_ref()?))) {
                        assert_eq!(audit.fault(&asked.question, numbers, shard.tests()), None, "{asked:?}");
                    }
                    known.push((asked, sum(&answers).expect("of one length")));
                }
            }
        }
    }
    panic!("no end after 200 rounds");
}

/// Places that have answered many questions give the same answers as fresh ones, to the bit.
fn assert_cache_has_no_effect(old: &[Shard], fresh: Vec<Shard>, known: &[(Asked, Answer)]) {
    for (asked, _) in known.iter().rev().step_by(3) {
        for (old, fresh) in old.iter().zip(&fresh) {
            assert_eq!(old.answer(asked), fresh.answer(asked), "{asked:?}");
        }
    }
}

fn in_one_place(ensemble: &Ensemble, asks: &Asks) -> FitRecord {
    let choices = Choices {
        std_errors: asks.std_errors,
        intervals: IntervalKind::Wald,
        df: DfChoice::None,
        deletion: DeletionChoice::None,
        tests: TestsChoice::None,
    };
    let options = Options { settings: asks.settings.clone(), choices, innovations: false, ..Options::default() };
    ensemble.fit_with(&options, &mut Silent).unwrap().record
}

/// Every figure of a record with its standard error.
fn figures(record: &FitRecord) -> Vec<(String, f64, Option<f64>)> {
    let mut all = Vec::new();
    for level in &record.levels {
        for (i, state) in level.states.iter().enumerate() {
            let what = format!("{} deviation {state}", level.name);
            all.push((what, level.std_dev.estimate[i], level.std_dev.std_error[i]));
        }
    }
    for phase in &record.phases {
        for (i, state) in phase.states.iter().enumerate() {
            all.push((format!("mean {state}"), phase.mean.estimate[i], phase.mean.std_error[i]));
            all.push((format!("deviation {state}"), phase.std_dev.estimate[i], phase.std_dev.std_error[i]));
            for k in 0..i {
                let (value, error) = (phase.covariance.estimate[i][k], phase.covariance.std_error[i][k]);
                all.push((format!("covariance {state} {k}"), value, error));
            }
        }
        for r in &phase.mean.regression {
            all.push((format!("regression {}", r.column), r.estimate, r.std_error));
        }
    }
    let parameters = record.parameters.iter().map(|p| (p.name.clone(), p.estimate, p.std_error));
    all.extend(parameters);
    all
}

#[track_caller]
fn agree(ensemble: &Ensemble, asks: &Asks) -> usize {
    let (found, rounds) = by_sums(ensemble, 3, asks);
    eprintln!("{}: {rounds} rounds", ensemble.model().shared().title);
    let expected = in_one_place(ensemble, asks);
    assert!(found.converged && expected.converged, "{} {}", found.reason, expected.reason);
    let (a, b) = (found.log_likelihood, expected.log_likelihood);
    assert!((a - b).abs() <= 1e-10 * b.abs(), "log-likelihood: {a} {b}");
    for ((what, value, error), (_, known, known_error)) in figures(&found).into_iter().zip(figures(&expected)) {
        let unit = known_error.unwrap_or(known.abs()).max(1e-12);
        assert!((value - known).abs() <= 1e-5 * unit, "{what}: {value} {known}, standard error {unit}");
        match (error, known_error) {
            (Some(error), Some(known)) => assert!((error / known - 1.0).abs() < 1e-5, "of {what}: {error} {known}"),
            _ => assert_eq!(error.is_some(), known_error.is_some(), "of {what}"),
        }
    }
    assert!(found.certificate.mean.max(found.certificate.covariance) < 1e-6, "{:?}", found.certificate);
    assert!(found.certificate.parameters < 1e-4, "{:?}", found.certificate);
    let counts = |record: &FitRecord| (record.data.tests, record.data.steps, record.data.observations);
    assert_eq!(counts(&found), counts(&expected));
    let seen = |record: &FitRecord| -> Vec<(usize, usize)> {
        record.phases.iter().flat_map(|p| &p.observability).map(|o| (o.informed_by, o.observed_by)).collect()
    };
    assert_eq!(seen(&found), seen(&expected));
    assert_eq!(found.free_parameters, expected.free_parameters);
    let groups = |record: &FitRecord| record.levels.iter().map(|level| level.groups).collect::<Vec<_>>();
    assert_eq!(groups(&found), groups(&expected));
    let tests = |record: &FitRecord| record.phases.iter().map(|phase| phase.tests).collect::<Vec<_>>();
    assert_eq!(tests(&found), tests(&expected));
    assert!(found.tests.is_empty());
    rounds
}

fn population(mean: &[f64], variances: &[f64]) -> Population {
    let covariance = DMatrix::from_diagonal(&DVector::from_row_slice(variances));
    Population { mean: mean.to_vec(), coefficients: Vec::new(), covariance }
}

fn lines(sigma: kalfit_model::build::ParameterBuilder) -> ModelBuilder {
    kalfit_model::Model::builder("lines")
        .state(constant("level"))
        .state(constant("slope"))
        .measurement(measurement("y", name("level") + name("slope") * name("x"), "sigma"))
        .parameter(sigma)
}

/// Tests of several lengths and designs, one in seven without a slope.
fn ensemble_of_lines(model: &PhasedModel, tests: usize) -> Ensemble {
    let design = |j: usize| {
        let rows = 4 + j % 3;
        let x = |k: usize| if j % 7 == 3 { 0.0 } else { k as f64 - 1.0 + 0.1 * (j % 5) as f64 };
        let dose = 0.5 + 0.25 * (j % 4) as f64;
        Columns::new(format!("t{j:03}"))
            .numbers("x", (0..rows).map(x))
            .every_number("dose", dose)
            .every_number("y", 0.0)
    };
    let designs: Vec<Columns> = (0..tests).map(design).collect();
    let mut truth = population(&[1.0, -0.5], &[0.5, 0.2]);
    truth.coefficients = vec![0.0; model.phases[0].model.mean.regression.len()];
    Ensemble::new(model, &designs).unwrap().draw(&Alpha::common([0.4]), truth, tests as u64, 3).unwrap()
}

#[test]
fn known_parameters() {
    let model = lines(fixed("sigma", 0.4)).build().unwrap();
    let rounds = agree(&ensemble_of_lines(&model, 60), &Asks::default());
    assert!(rounds <= 9, "{rounds} rounds");
    let expected = Asks { std_errors: StdErrors::Expected, ..Asks::default() };
    agree(&ensemble_of_lines(&model, 60), &expected);
}

#[test]
fn known_parameters_constraints_and_a_regression() {
    let model = lines(fixed("sigma", 0.4)).regress_mean("slope", "dose").fix_mean("level", 1.0).build().unwrap();
    agree(&ensemble_of_lines(&model, 60), &Asks::default());
    let reml =
        Asks { settings: estimate::Settings { criterion: Criterion::Reml, ..Default::default() }, ..Asks::default() };
    agree(&ensemble_of_lines(&model, 60), &reml);
}

#[test]
fn a_noise_level() {
    let rounds = agree(&ensemble_of_lines(&lines(free("sigma")).build().unwrap(), 80), &Asks::default());
    assert!(rounds <= 13, "{rounds} rounds");
}

#[test]
fn a_time_constant_and_two_noise_levels() {
    let model = kalfit_model::Model::builder("drifts")
        .time("t")
        .state(constant("bias"))
        .state(gauss_markov("drift", "tau", "walk"))
        .measurement(measurement("y", name("bias") + name("drift"), "sigma"))
        .parameter(free("tau").start(2.0))
        .parameter(free("walk"))
        .parameter(free("sigma"))
        .fix_mean("bias", 0.0)
        .build()
        .unwrap();
    let design = |j: usize| {
        let rows = 40 + j % 5;
        Columns::new(format!("t{j}")).numbers("t", (0..rows).map(|k| 0.5 * k as f64)).every_number("y", 0.0)
    };
    let designs: Vec<Columns> = (0..45).map(design).collect();
    let alpha = Alpha::common([3.0, 0.5, 0.2]);
    let drawn = Ensemble::new(&model, &designs).unwrap().draw(&alpha, population(&[0.0], &[1.0]), 45, 2).unwrap();
    let rounds = agree(&drawn, &Asks::default());
    assert!(rounds <= 13, "{rounds} rounds");
}

/// Two phases; the second one inherits the level, and some tests lack it. The noise level is known or free.
fn phases(sigma: kalfit_model::build::ParameterBuilder) -> Ensemble {
    let rest = kalfit_model::Model::builder("phases")
        .state(constant("level"))
        .measurement(measurement("y", name("level"), "sigma"))
        .parameter(sigma.clone());
    let moved = kalfit_model::Model::builder("phases")
        .state(constant("level"))
        .state(constant("rate"))
        .measurement(measurement("y", name("level") + name("rate") * name("x"), 0.2))
        .parameter(sigma);
    let model = PhasedModel::builder("part")
        .phase(phase("rest", &rest))
        .phase(phase("move", &moved).carry("level", name("level")))
        .build()
        .unwrap();
    let design = |j: usize| {
        let rows = if j % 6 == 5 { 4 } else { 9 + j % 3 };
        Columns::new(format!("t{j:02}"))
            .numbers("x", (0..rows).map(|k| 0.3 * k as f64 - 1.0))
            .texts("part", (0..rows).map(|k| if k < 4 { "rest" } else { "move" }))
            .every_number("y", 0.0)
    };
    let designs: Vec<Columns> = (0..48).map(design).collect();
    let truth = population(&[1.0, 0.2, -0.5], &[0.5, 0.1, 0.3]);
    Ensemble::new(&model, &designs).unwrap().draw(&Alpha::common([0.1]), truth, 48, 5).unwrap()
}

#[test]
fn tests_in_phases() {
    agree(&phases(fixed("sigma", 0.1)), &Asks::default());
    agree(&phases(free("sigma").start(0.2)), &Asks::default());
}

/// Lines of tests in groups of these levels, the outermost first, with a regression of the mean on a dose.
fn in_groups(sigma: kalfit_model::build::ParameterBuilder, levels: &[&str], tests: usize) -> Ensemble {
    let mut model = lines(sigma).regress_mean("slope", "dose").build().unwrap();
    let column = |name: &&str| Column { name: (*name).to_owned(), used_in: "levels".to_owned() };
    model.phases[0].model.text_columns = levels.iter().map(column).collect();
    let level = |(column, name): (usize, &&str)| GroupLevel {
        name: (*name).to_owned(),
        column,
        crossed: false,
        covariance: CovarianceStructure::full(),
        members: Vec::new(),
    };
    model.levels = levels.iter().enumerate().map(level).collect();
    let design = |j: usize| {
        let rows = 4 + j % 3;
        let x = |k: usize| if j % 7 == 3 { 0.0 } else { k as f64 - 1.0 + 0.1 * (j % 5) as f64 };
        let own = Columns::new(format!("t{j:03}"))
            .numbers("x", (0..rows).map(x))
            .every_number("dose", 0.5 + 0.25 * (j % 4) as f64)
            .every_number("y", 0.0);
        // groups of several sizes, which the order of the tests does not follow
        let names = [format!("lot {}", j % 11), format!("unit {}", j / 11 % (2 + j % 3))];
        levels.iter().zip(names).fold(own, |own, (level, name)| own.texts(*level, vec![name; rows]))
    };
    let designs: Vec<Columns> = (0..tests).map(design).collect();
    let variances = [[0.05, 0.02], [0.5, 0.2], [0.3, 0.1]];
    let blocks = [&variances[..1], &variances[3 - levels.len()..]].concat();
    let mean: Vec<f64> = [1.0, -0.5].into_iter().chain(vec![0.0; 2 * levels.len()]).collect();
    let truth = Population { coefficients: vec![0.4], ..population(&mean, &blocks.concat()) };
    Ensemble::new(&model, &designs).unwrap().draw(&Alpha::common([0.4]), truth, tests as u64, 11).unwrap()
}

#[test]
fn a_level_of_groups() {
    let rounds = agree(&in_groups(fixed("sigma", 0.4), &["lot"], 66), &Asks::default());
    assert!(rounds <= 12, "{rounds} rounds");
    let expected = Asks { std_errors: StdErrors::Expected, ..Asks::default() };
    agree(&in_groups(fixed("sigma", 0.4), &["lot"], 66), &expected);
    let rounds = agree(&in_groups(free("sigma"), &["lot"], 66), &Asks::default());
    assert!(rounds <= 16, "{rounds} rounds");
}

#[test]
fn units_in_lots() {
    agree(&in_groups(fixed("sigma", 0.4), &["lot", "unit"], 132), &Asks::default());
    agree(&in_groups(free("sigma"), &["lot", "unit"], 132), &Asks::default());
    let reml =
        Asks { settings: estimate::Settings { criterion: Criterion::Reml, ..Default::default() }, ..Asks::default() };
    agree(&in_groups(fixed("sigma", 0.4), &["lot", "unit"], 132), &reml);
}

#[test]
fn groups_of_tests_with_a_time_constant() {
    let mut model = kalfit_model::Model::builder("drifts of units")
        .time("t")
        .state(constant("bias"))
        .state(gauss_markov("drift", "tau", "walk"))
        .measurement(measurement("y", name("bias") + name("drift"), 0.2))
        .parameter(free("tau").start(2.0))
        .parameter(free("walk").start(0.4))
        .build()
        .unwrap();
    model.phases[0].model.text_columns = vec![Column { name: "unit".to_owned(), used_in: "levels".to_owned() }];
    let covariance = CovarianceStructure::full();
    model.levels =
        vec![GroupLevel { name: "unit".to_owned(), column: 0, crossed: false, covariance, members: Vec::new() }];
    let design = |j: usize| {
        let rows = 20 + j % 5;
        Columns::new(format!("t{j}"))
            .numbers("t", (0..rows).map(|k| 0.5 * k as f64))
            .every_number("y", 0.0)
            .texts("unit", vec![format!("{}", j % 12); rows])
    };
    let designs: Vec<Columns> = (0..48).map(design).collect();
    let truth = population(&[0.5, 0.0], &[0.3, 1.0]);
    let drawn = Ensemble::new(&model, &designs).unwrap().draw(&Alpha::common([3.0, 0.5]), truth, 48, 2).unwrap();
    agree(&drawn, &Asks::default());
}

#[test]
fn a_place_names_its_groups_of_the_outermost_level() {
    let ensemble = in_groups(free("sigma"), &["lot", "unit"], 30);
    let shard = Shard::new(ensemble.model().clone(), ensemble.labels(), ensemble.tests().to_vec(), Default::default());
    let expected: Vec<String> = (0..11).map(|lot| format!("lot {lot}")).collect();
    let mut found = shard.unwrap().groups().to_vec();
    found.sort_by_key(|name| name.len());
    assert_eq!(found, expected);
}

#[test]
fn models_that_no_sums_are_made_for_are_refused_in_words() {
    let model = lines(free("sigma").per("lot")).build().unwrap();
    let error = go_on(&model, &Asks::default(), Vec::new(), Provenance::default(), &mut Silent).unwrap_err();
    assert_eq!(error, ShardError::PerLevel { parameter: "sigma".to_owned() });
    let model = lines(free("sigma")).build().unwrap();
    let reml = estimate::Settings { criterion: Criterion::Reml, ..Default::default() };
    let asks = Asks { settings: reml, ..Asks::default() };
    let error = go_on(&model, &asks, Vec::new(), Provenance::default(), &mut Silent).unwrap_err();
    assert_eq!(error, ShardError::Restricted { parameter: "sigma".to_owned() });
}
