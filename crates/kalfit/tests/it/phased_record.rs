//! The record of a fit to tests in several phases: what is found of all phases together, cut into phases.

#![expect(clippy::unwrap_used, reason = "a test that cannot be set up must fail")]

use kalfit::estimate::{self, Estimate, Settings, Silent, Structure};
use kalfit::infer::{self, Choices, DeletionChoice, Inference};
use kalfit::model::{
    Carry, Clock, Column, CovarianceKind, CovarianceStructure, FixedElement, Initial, Linear, MeanElement,
    MeanStructure, Measurement, Motion, Phase, Regression, State,
};
use kalfit::record::RecordError;
use kalfit::reduce::PhasedReducer;
use kalfit::{Alpha, Expression, FitRecord, Label, Labels, Model, PhasedModel, PhasedTest, Provenance, Reductions};
use kalfit::{Source, Test};

/// Columns: what is measured, the slope's factor, and what means move with.
const COLUMNS: [&str; 3] = ["y", "x", "heat"];
/// Tests; every third of them ends after the first phase.
const TESTS: usize = 24;

fn number(x: f64) -> Expression {
    Expression::Number(x)
}

fn linear(terms: &[(usize, Expression)]) -> Linear {
    Linear { terms: terms.to_vec(), constant: number(0.0) }
}

fn phase(name: &str, label: usize, states: &[&str], equation: Linear, carry: Vec<Carry>) -> Phase {
    let state = |name: &&str| State {
        name: (*name).into(),
        unit: (*name == "bias").then(|| "deg/h".to_owned()),
        motion: Motion::Constant,
        initial: Initial::Estimated,
        offset: None,
        random: true,
    };
    let column = |name: &&str| Column { name: (*name).into(), used_in: "measurement `m`".into() };
    let measurement = Measurement { name: "m".into(), column: 0, filter: None, equation, noise_variance: number(0.01) };
    let model = Model {
        title: "two phases".into(),
        columns: COLUMNS.iter().map(column).collect(),
        text_columns: vec![column(&"phase")],
        literals: vec!["bench".into(), "flight".into()],
        parameters: vec![],
        states: states.iter().map(state).collect(),
        process_noise_covariance: vec![],
        measurements: vec![measurement],
        noise_covariance: vec![],
        clock: Clock::default(),
        group: None,
        estimated: (0..states.len()).collect(),
        mean: MeanStructure::free(states.len()),
        covariance: CovarianceStructure::full(),
    };
    Phase { name: name.into(), label: Some(label), model, carry, filter: None }
}

/// bench: bias + slope × x is measured; flight: its own bias, added to that of the bench, and its trend.
fn model() -> PhasedModel {
    let terms = || linear(&[(0, number(1.0)), (1, Expression::Column(1))]);
    let carry = vec![Carry { state: 0, from: linear(&[(0, number(1.0))]) }];
    let bench = phase("bench", 0, &["bias", "slope"], terms(), vec![]);
    let flight = phase("flight", 1, &["bias", "trend"], terms(), carry);
    PhasedModel { phases: vec![bench, flight], column: Some(0), levels: Vec::new() }
}

fn test(j: usize) -> Test {
    let random = |k: usize| ((7919 * (j + 1) * (k + 3)) % 1009) as f64 / 504.5 - 1.0;
    let mut test = Test::new(format!("t{j:02}"), 3, 1);
    let heat = random(0);
    let (bias, slope) = (2.0 + 0.5 * heat + random(1), 0.3 + random(2));
    let (more, trend) = (0.5 - 0.7 * heat + random(3), -0.2 + 0.5 * random(4));
    for row in 0..4 {
        let x = row as f64 - 1.0;
        let y = bias + slope * x + 0.1 * random(10 + row);
        test.push(&[y, x, heat], &[Label::literal(0)], Source::default());
    }
    for row in (0..4).filter(|_| j % 3 != 2) {
        let x = row as f64 - 1.0;
        let y = bias + more + trend * x + 0.1 * random(20 + row);
        test.push(&[y, x, heat], &[Label::literal(1)], Source::default());
    }
    test
}

fn reduced(model: &PhasedModel) -> Reductions {
    let labels = Labels::new(&model.shared().literals);
    let tests: Vec<PhasedTest> = (0..TESTS).map(|j| model.split(test(j), &labels).unwrap()).collect();
    PhasedReducer::new(model, &Alpha::default()).unwrap().reduce(&tests).unwrap()
}

fn fitted(model: &PhasedModel) -> (FitRecord, Estimate, Inference) {
    let (alpha, reductions) = (Alpha::default(), reduced(model));
    let estimate =
        estimate::fit(&reductions, &Structure::of(model, &alpha, None), &Settings::default(), &mut Silent).unwrap();
    let choices = Choices { deletion: DeletionChoice::All, ..Choices::default() };
    let inference = infer::infer(&estimate, &reductions, choices);
    let record = FitRecord::new(model, &alpha, &reductions, &estimate, &inference, Provenance::default());
    (record, estimate, inference)
}

#[test]
fn each_phase_has_its_part_of_the_estimate() {
    let model = model();
    let (record, estimate, inference) = fitted(&model);
    assert!(record.converged, "{}", record.reason);
    assert_eq!((record.solver.phases.as_str(), record.log_likelihood_kind.as_str()), ("chain", "measurements"));
    for (k, (phase, range)) in record.phases.iter().zip(model.ranges()).enumerate() {
        assert_eq!((&phase.name, &phase.states), (&model.phases[k].name, &model.phases[k].model.estimated_names()));
        assert_eq!(phase.units, [Some("deg/h".to_owned()), None]);
        assert_eq!(phase.mean.estimate, estimate.mean[range.clone()]);
        assert_eq!(phase.mean.std_error, inference.uncertainty.errors.mean[range.clone()]);
        for (i, whole) in range.clone().enumerate() {
            assert_eq!(phase.std_dev.estimate[i], estimate.covariance[(whole, whole)].sqrt());
            for (j, other) in range.clone().enumerate() {
                assert_eq!(phase.covariance.estimate[i][j], estimate.covariance[(whole, other)]);
                assert_eq!(phase.covariance.std_error[i][j], inference.uncertainty.errors.covariance[whole][other]);
                assert!(!phase.covariance.fixed[i][j]);
            }
        }
        assert_eq!(phase.observability.len(), 2);
        assert_eq!(phase.observability[0].state, "bias");
        assert!(phase.mean.std_error.iter().all(Option::is_some) && phase.unidentified.is_empty(), "{phase:?}");
    }
    assert_eq!(record.constraints, [], "between phases there is nothing to be held");
    assert_eq!(record.free_parameters, 2 * (2 + 3));
    assert!(record.aic.is_some() && record.composite_log_likelihood.is_none());
}

#[test]
fn tests_list_the_phases_that_they_have() {
    let (record, ..) = fitted(&model());
    assert_eq!(record.phases.iter().map(|phase| phase.tests).collect::<Vec<_>>(), [Some(TESTS), Some(TESTS / 3 * 2)]);
    for (j, test) in record.tests.iter().enumerate() {
        let expected: &[&str] = if j % 3 == 2 { &["bench"] } else { &["bench", "flight"] };
        let found: Vec<&str> = test.phases.iter().map(|phase| phase.name).collect();
        assert_eq!(found, expected, "{}", test.id);
        assert!(test.phases.iter().all(|phase| phase.mean.len() == 2 && phase.covariance.size() == 2));
        let deletion = test.deletion.as_ref().unwrap();
        let phases: Vec<&str> = deletion.phases.iter().map(|phase| phase.name.as_str()).collect();
        assert_eq!(phases, ["bench", "flight"], "the answer without a test is of all phases");
    }
    let sum: f64 = record.tests.iter().map(|test| test.log_likelihood).sum();
    assert!((sum - record.log_likelihood).abs() < 1e-9 * sum.abs(), "{sum} {}", record.log_likelihood);
}

#[test]
fn constraints_regressions_and_scales_are_of_their_phase() {
    let mut model = model();
    let [bench, flight] = &mut model.phases[..] else { unreachable!() };
    bench.model.mean.regression = vec![Regression { element: 0, column: 2 }];
    bench.model.covariance.fixed = vec![FixedElement { i: 1, j: 0, value: 0.0 }];
    flight.model.mean.regression = vec![Regression { element: 0, column: 2 }];
    flight.model.mean.elements[1] = MeanElement::Fixed(-0.25);
    let star = vec![vec![number(1.0), number(0.0)], vec![number(0.0), number(0.25)]];
    flight.model.covariance.kind = CovarianceKind::Proportional(star);
    let (record, estimate, _) = fitted(&model);
    let found: Vec<(&str, &str)> = record.constraints.iter().map(|c| (c.phase.as_str(), c.element.as_str())).collect();
    assert!(found.contains(&("bench", "covariance[bias, slope]")), "{found:?}");
    assert!(found.contains(&("flight", "mean[trend]")), "{found:?}");
    assert!(found.iter().all(|(phase, element)| *phase == "bench" || !element.contains("slope")), "{found:?}");
    assert_eq!(record.phases[0].covariance.fixed, [[false, true], [true, false]]);
    assert_eq!(record.phases[1].mean.fixed, [false, true]);
    for (phase, expected) in record.phases.iter().zip([0.5, -0.7]) {
        let [regression] = &phase.mean.regression[..] else { panic!("{:?}", phase.mean.regression) };
        assert_eq!((regression.state.as_str(), regression.column.as_str()), ("bias", "heat"));
        let error = regression.std_error.unwrap();
        assert!((regression.estimate - expected).abs() < 5.0 * error, "{} ± {error}", regression.estimate);
    }
    let beta = estimate.covariance[(2, 2)];
    let scale = record.phases[1].covariance.scale.as_ref().unwrap();
    assert!((scale.estimate - beta).abs() < 1e-12 * beta, "{} {beta}", scale.estimate);
    assert!(record.phases[0].covariance.scale.is_none() && scale.std_error.is_some_and(|e| e > 0.0));
    let coefficients = |d: &kalfit::record::DeletionRecord| d.phases.iter().map(|p| p.regression.len()).collect();
    let lengths: Vec<usize> = coefficients(record.tests.get(0).deletion.as_ref().unwrap());
    assert_eq!(lengths, [1, 1]);
}

#[test]
fn the_population_comes_back_whatever_the_order_of_the_phases() {
    let mut model = model();
    model.phases[1].model.mean.regression = vec![Regression { element: 0, column: 2 }];
    let (mut record, estimate, _) = fitted(&model);
    let check = |record: &FitRecord| {
        let found = record.population(&model).unwrap();
        assert_eq!(found.mean, estimate.mean);
        assert_eq!(found.coefficients, estimate.coefficients);
        assert_eq!(found.covariance, estimate.covariance);
    };
    check(&record);
    record.phases.swap(0, 1);
    check(&record);
    record.phases[0].states.swap(0, 1);
    let error = |record: &FitRecord, model: &PhasedModel| record.population(model).unwrap_err().to_string();
    assert!(record.population(&model).is_ok(), "states may stand in another order");
    record.phases[0].states[0] = "drift".into();
    assert_eq!(
        error(&record, &model),
        "the estimated states of phase `flight` are `drift`, `bias`, expected `bias`, `trend` as in the model"
    );
    record.phases.truncate(1);
    assert_eq!(error(&record, &model), "the phases are `flight`, expected `bench`, `flight` as in the model");
    record.phases.clear();
    assert!(matches!(record.population(&model), Err(RecordError::Names { .. })));
}

/// A second phase that measures only its own bias added to one that the first phase does not measure either.
#[test]
fn a_direction_that_mixes_phases_stands_in_each_with_its_part_and_whole_in_a_note() {
    let mut model = model();
    model.phases[0].model.measurements[0].equation = linear(&[(1, Expression::Column(1))]);
    let (record, ..) = fitted(&model);
    let names: Vec<String> = ["bench", "flight"].map(String::from).to_vec();
    for (phase, other) in record.phases.iter().zip(["slope", "trend"]) {
        let mixed: Vec<_> = phase.unidentified.iter().filter(|u| u.what == "mean" && u.phases == names).collect();
        let [direction] = &mixed[..] else { panic!("{:?}", phase.unidentified) };
        assert_eq!(direction.elements, ["bias", other]);
        assert!((direction.direction[0].abs() - 0.5f64.sqrt()).abs() < 1e-6, "{:?}", direction.direction);
        assert!(phase.mean.std_error[0].is_none() && phase.mean.std_error[1].is_some(), "{:?}", phase.mean);
    }
    let note = record.notes.iter().find(|note| note.contains("of the means")).unwrap();
    assert_eq!(
        note,
        "the phases together do not determine the combination 0.71 flight.bias - 0.71 bench.bias of the means: no test separates `bench.bias` and `flight.bias`: only combinations of them are measured"
    );
    assert!(record.notes.iter().all(|note| !note.contains("NaN")), "{:?}", record.notes);
}

#[test]
fn a_likelihood_of_what_filters_made_of_the_data_has_no_aic() {
    let model = model();
    let (alpha, reductions) = (Alpha::default(), reduced(&model));
    let structure = Structure::of(&model, &alpha, None);
    let estimate = estimate::fit(&reductions, &structure, &Settings::default(), &mut Silent).unwrap();
    let inference = infer::infer(&estimate, &reductions, Choices::default());
    let provenance = Provenance { of_estimates: true, ..Provenance::default() };
    let record = FitRecord::new(&model, &alpha, &reductions, &estimate, &inference, provenance);
    assert_eq!(record.log_likelihood_kind, "estimates");
    assert!(record.aic.is_none() && record.bic.is_none());
    let mut filtered = model.clone();
    let covariance = nalgebra::DMatrix::identity(2, 2);
    let filter = kalfit::model::Filter { consider: vec![1], mean: vec![0.0; 2], covariance, parameters: vec![] };
    filtered.phases[1].filter = Some(filter);
    let record = FitRecord::new(&filtered, &alpha, &reductions, &estimate, &inference, Provenance::default());
    assert_eq!(record.log_likelihood_kind, "estimates");
    assert!(record.phases[0].filter.is_none());
    assert_eq!(record.phases[1].filter.as_ref().unwrap().consider, ["trend"]);
}
