//! The record of a fit with free dynamic parameters: entries in their order, counts, and what is said in words.

#![expect(clippy::unwrap_used, reason = "a test that cannot be set up must fail")]

use std::collections::BTreeMap;

use kalfit::dynamic::{self, DynamicFit, OtherEnd, ParameterInference, Settings, Standing};
use kalfit::estimate::{Silent, Stop};
use kalfit::infer::{Choices, Inference, restricted};
use kalfit::model::PhasedModel;
use kalfit::model::{
    Clock, Column, CovarianceStructure, Initial, Linear, MeanStructure, Measurement, Motion, Operator, Parameter,
    Slots, State, Value,
};
use kalfit::record::{DynamicParts, LevelCounts, MethodRecord, level_notes};
use kalfit::reduce::PhasedTest;
use kalfit::{Alpha, Expression, FitRecord, Label, Labels, Model, Provenance, Source, Test};

/// A level for each unit, measured with a variance for each lot; the variance of lot `B` is known.
fn model() -> Model {
    let column = |name: &str| Column { name: name.into(), used_in: "measurement `y`".into() };
    let level = State {
        name: "level".into(),
        unit: None,
        motion: Motion::Constant,
        initial: Initial::Estimated,
        offset: None,
        random: true,
    };
    let product = |a, b| Expression::Binary(Operator::Multiply, Box::new(a), Box::new(b));
    let measurement = Measurement {
        name: "y".into(),
        column: 0,
        filter: None,
        equation: Linear { terms: vec![(0, Expression::Number(1.0))], constant: Expression::Number(0.0) },
        noise_variance: product(Expression::Parameter(0), Expression::Parameter(1)),
    };
    let parameter = |name: &str, value| Parameter {
        name: name.into(),
        unit: None,
        value,
        per: None,
        fixed_levels: BTreeMap::new(),
        lower: None,
        upper: None,
        positive: true,
    };
    let r = Parameter {
        per: Some(0),
        fixed_levels: BTreeMap::from([(0, 0.25)]),
        unit: Some("V^2".into()),
        ..parameter("r", Value::Free { start: Some(0.5) })
    };
    Model {
        title: "units".into(),
        columns: vec![column("y")],
        text_columns: vec![column("lot")],
        literals: vec!["B".into()],
        parameters: vec![r, parameter("one", Value::Fixed(1.0))],
        states: vec![level],
        process_noise_covariance: vec![],
        measurements: vec![measurement],
        noise_covariance: vec![],
        clock: Clock::default(),
        group: None,
        estimated: vec![0],
        mean: MeanStructure::free(1),
        covariance: CovarianceStructure::full(),
    }
}

/// Lots come in the data as C, B, A: labels are not in the order of their texts.
fn ensemble() -> (Labels, Vec<Test>) {
    let mut labels = Labels::new(&model().literals);
    let lots: Vec<Label> = ["C", "B", "A"].iter().map(|text| labels.intern(text)).collect();
    let unit = |j: usize| {
        let mut test = Test::new(format!("u{j:02}"), 1, 1);
        for row in 0..6 {
            let noise = f64::from(u8::try_from((7 * j + 5 * row) % 11).unwrap()) / 5.0 - 1.0;
            let level = f64::from(u8::try_from((3 * j) % 5).unwrap());
            test.push(&[level + noise * (1.0 + 0.5 * (j % 3) as f64)], &[lots[j % 3]], Source::default());
        }
        test
    };
    (labels, (0..9).map(unit).collect())
}

fn fitted(model: &Model) -> (Labels, Vec<Test>, DynamicFit, Inference, Vec<ParameterInference>) {
    let (labels, tests) = ensemble();
    let (model, phased) =
        (PhasedModel::from(model.clone()), tests.iter().cloned().map(PhasedTest::from).collect::<Vec<_>>());
    let fit = dynamic::fit(&model, &labels, &phased, &Settings::default(), &mut Silent).unwrap();
    let (inference, parameters) =
        dynamic::infer(&model, (&labels, &phased), &fit, Choices::default(), &mut Silent).unwrap();
    (labels, tests, fit, inference, parameters)
}

/// The record after the fit and what is known of its parameters were changed.
fn record(change: impl FnOnce(&mut DynamicFit, &mut Vec<ParameterInference>)) -> FitRecord {
    let model = model();
    let (labels, _, mut fit, inference, mut parameters) = fitted(&model);
    change(&mut fit, &mut parameters);
    let model = PhasedModel::from(model);
    let parts =
        DynamicParts { model: &model, labels: &labels, fit: &fit, inference: &inference, parameters: &parameters };
    FitRecord::dynamic(&parts, Provenance::default())
}

#[test]
fn entries_are_in_the_order_of_the_model_and_of_the_texts_of_their_levels() {
    let record = record(|_, _| {});
    let of = |p: &kalfit::record::ParameterRecord| (p.name.clone(), p.level.clone().unwrap_or_default(), p.fixed);
    let found: Vec<(String, String, bool)> = record.parameters.iter().map(of).collect();
    let entry = |name: &str, level: &str, fixed| (name.to_owned(), level.to_owned(), fixed);
    let expected = [("r", "A", false), ("r", "B", true), ("r", "C", false), ("one", "", true)];
    assert_eq!(found, expected.map(|(name, level, fixed)| entry(name, level, fixed)));
    assert_eq!(record.parameters[1].estimate, 0.25);
    for free in [&record.parameters[0], &record.parameters[2]] {
        assert!(free.std_error.is_some_and(|e| e > 0.0) && free.interval95.is_some(), "{free:?}");
        assert_eq!((free.unit.as_deref(), free.per.as_deref()), (Some("V^2"), Some("lot")));
    }
    assert!(record.parameters[1].std_error.is_none() && record.parameters[1].standing.is_none());
}

#[test]
fn every_free_level_counts() {
    let record = record(|_, _| {});
    assert_eq!(record.free_parameters, 1 + 1 + 2);
    let expected = 2.0 * 4.0 - 2.0 * record.log_likelihood;
    assert!((record.aic.unwrap() - expected).abs() < 1e-12, "{:?} {expected}", record.aic);
    let expected = 4.0 * 54f64.ln() - 2.0 * record.log_likelihood;
    assert!((record.bic.unwrap() - expected).abs() < 1e-12, "{:?} {expected}", record.bic);
}

#[test]
fn the_fit_is_that_of_the_same_values_held() {
    let record = record(|_, _| {});
    let (_, tests) = ensemble();
    let mut model = model();
    let labels = ensemble().0;
    // the levels in the order of their labels
    let value = |level: &str| record.parameters.iter().find(|p| p.level.as_deref() == Some(level)).unwrap().estimate;
    model.parameters[0].value = Value::Fixed(value("C"));
    model.literals.push("C".into());
    model.literals.push("A".into());
    assert_eq!((labels.text(Label::literal(1)), labels.text(Label::literal(2))), ("C", "A"));
    model.parameters[0].fixed_levels = BTreeMap::from([(0, 0.25), (1, value("C")), (2, value("A"))]);
    let alpha = Alpha::fixed(&model.parameters).unwrap();
    let reductions = kalfit::reduce::Reducer::new(&model, &alpha).unwrap().reduce(&tests).unwrap();
    let structure = kalfit::estimate::Structure::single(&model.mean, &model.covariance, &alpha);
    let estimate = kalfit::estimate::fit(&reductions, &structure, &Default::default(), &mut Silent).unwrap();
    let (found, expected) = (record.log_likelihood, estimate.log_likelihood);
    assert!((found - expected).abs() < 1e-9, "{found} {expected}");
}

#[test]
fn convergence_takes_both_certificates() {
    assert!(record(|_, _| {}).converged);
    let stalled = record(|fit, _| fit.stop = Stop::Stalled);
    assert!(!stalled.converged);
    assert!(stalled.reason.contains("the dynamic parameters"), "{}", stalled.reason);
    let inner = record(|fit, _| fit.estimate.stop = Stop::PassLimit);
    assert!(!inner.converged);
    assert!(inner.reason.contains("reached its limit of iterations"), "{}", inner.reason);
    assert!(inner.parameters.iter().all(|p| p.standing.is_none()), "short of a maximum nothing is said of standings");
    let unknown = record(|fit, _| fit.certificate = f64::NAN);
    assert!(unknown.certificate.parameters.is_finite(), "{}", unknown.certificate.parameters);
}

#[test]
fn values_at_a_limit_are_said_in_words() {
    let at = |standing: Standing, value: f64| {
        record(|fit, parameters| {
            fit.values[0] = value;
            parameters[0] = ParameterInference { std_error: None, interval: None, standing };
        })
    };
    for (standing, value, words, at_bound) in [
        (Standing::Lower, 0.0, "`r` for lot `A` is estimated as zero", true),
        (Standing::Lower, 0.1, "`r` for lot `A` is at its lower bound", true),
        (Standing::Upper, 2.0, "`r` for lot `A` is at its upper bound", true),
        (Standing::Unbounded, 1e9, "`r` for lot `A` is too large to be determined", false),
        (Standing::Unidentified, 0.5, "`r` for lot `A` is not identified", false),
    ] {
        let record = at(standing, value);
        assert!(record.notes[0].starts_with(words), "{standing:?}: {:?}", record.notes);
        assert_eq!(record.parameters[0].at_bound, at_bound, "{standing:?}");
        assert!(record.parameters[0].note.is_some(), "{standing:?}");
    }
    let both = record(|fit, parameters| {
        fit.values = vec![0.0, 0.0];
        for found in parameters {
            *found = ParameterInference { std_error: None, interval: None, standing: Standing::Lower };
        }
    });
    assert!(both.notes[0].starts_with("`r` for lot `A` and `C` is estimated as zero"), "{:?}", both.notes);
}

#[test]
fn other_starts_that_ended_elsewhere_are_said_in_words() {
    let ended = |gap: f64, shift: f64, (stop, given_up): (Stop, bool)| {
        record(|fit, _| {
            let end = OtherEnd {
                log_likelihood: fit.estimate.log_likelihood - gap,
                values: fit.values.iter().map(|value| value * (1.0 + shift)).collect(),
                stop,
                given_up,
            };
            fit.others = vec![end];
        })
    };
    let with = |gap: f64, shift: f64, stop: Stop| ended(gap, shift, (stop, false));
    let plain = record(|fit, _| fit.others.clear()).notes;
    let said = |record: FitRecord| {
        let new: Vec<String> = record.notes.into_iter().filter(|note| !plain.contains(note)).collect();
        (new, record.starts)
    };
    let (notes, starts) = said(with(0.0, 0.0, Stop::Certified));
    assert_eq!((notes.as_slice(), starts.len()), (&[][..], 1), "the same place is nothing to speak of");
    assert!(starts[0].converged);
    let (notes, _) = said(with(2.5, 0.3, Stop::Certified));
    assert!(notes.len() == 1 && notes[0].contains("lower by 2.5000"), "{notes:?}");
    let (notes, _) = said(with(0.0, 1.0, Stop::Certified));
    assert!(notes.len() == 1 && notes[0].contains("not unique"), "{notes:?}");
    let (notes, starts) = said(with(9.0, 0.3, Stop::Stalled));
    assert!(notes.len() == 1 && notes[0].contains("did not end at a certified optimum"), "{notes:?}");
    assert!(!starts[0].converged);
    let (notes, _) = said(ended(9.0, 0.3, (Stop::PassLimit, true)));
    assert!(notes.len() == 1 && notes[0].contains("1 of 1 other starts were stopped early"), "{notes:?}");
    let (notes, _) = said(with(-9.0, 0.3, Stop::Stalled));
    assert!(notes[0].contains("higher by 9.0000, at a point that is not a certified maximum"), "{notes:?}");
}

#[test]
fn methods_that_end_at_different_maxima_are_said_in_words() {
    let model = model();
    let (_, _, fit, ..) = fitted(&model);
    let own = MethodRecord::new(&fit, 0.0);
    let mut together = record(|_, _| {});
    let before = together.notes.len();
    together.add_methods(vec![own.clone(), MethodRecord { method: "em".into(), ..own.clone() }]);
    assert_eq!(together.notes.len(), before);
    let lower = MethodRecord { method: "em".into(), log_likelihood: own.log_likelihood - 1.0, ..own.clone() };
    together.add_methods(vec![own, lower]);
    assert!(together.notes[0].starts_with("the methods ended at different maxima: `em`"), "{:?}", together.notes);
    assert_eq!(together.methods.len(), 2);
}

#[test]
fn fixed_levels_that_the_data_do_not_have_are_named() {
    let (labels, tests) = ensemble();
    let mut model = model();
    let tests: Vec<PhasedTest> = tests.into_iter().map(PhasedTest::from).collect();
    let counts = LevelCounts::all(&model, &labels, &tests);
    let three = ["A", "B", "C"].map(|level| (level.to_owned(), 3));
    assert_eq!(counts, [LevelCounts { parameter: 0, tests: three.to_vec() }]);
    assert_eq!(level_notes(&model, &counts), Vec::<String>::new());
    model.literals[0] = "b".into();
    let notes = level_notes(&model, &counts);
    assert_eq!(notes, ["`r` is fixed for lot `b`, which the data do not have: they have `A`, `B` and `C`"]);
}

#[test]
fn what_a_hypothesis_takes_away_is_counted_in_the_values_that_the_data_have() {
    let (labels, tests) = ensemble();
    let wide = model();
    let tests: Vec<PhasedTest> = tests.into_iter().map(PhasedTest::from).collect();
    let slots = |model: &PhasedModel| Slots::in_phases(model, &labels, &tests);
    let whole = PhasedModel::from(wide.clone());
    let taken = |null: &PhasedModel| restricted((null, &slots(null)), (&whole, &slots(&whole)), &tests);
    let counts = |null: &Model| taken(&null.clone().into()).map(|t| (t.count, t.at_bound));
    assert_eq!(counts(&wide), Ok((0, 0)));
    let held = |levels: &[(usize, f64)]| {
        let mut null = wide.clone();
        null.literals = ["B", "C", "A"].map(str::to_owned).to_vec();
        null.parameters[0].fixed_levels.extend(levels.iter().copied());
        null
    };
    assert_eq!(counts(&held(&[(2, 0.4)])), Ok((1, 0)));
    assert_eq!(counts(&held(&[(2, 0.0)])), Ok((1, 1)));
    assert_eq!(counts(&held(&[(1, 0.4), (2, 0.0)])), Ok((2, 1)));
    assert!(counts(&held(&[(0, 0.3)])).is_err(), "the model has another value for lot B");
    let mut free = wide.clone();
    free.parameters[1].value = Value::Free { start: None };
    assert!(counts(&free).is_err(), "the model has it fixed");
}
