//! Models in phases: what each phase has, takes from the top level and inherits.

use kalfit::model::{Carry, CovarianceKind, Expression, FixedElement, Linear, MeanElement, Phase, Value};
use kalfit_spec::Spec;
use nalgebra::{DMatrix, DVector};

fn read(text: &str) -> Spec {
    match Spec::parse("model.toml", text) {
        Ok(spec) => spec,
        Err(error) => panic!("{error} at {:?}, {:?}", error.span.clone().map(|span| &text[span]), error.hint),
    }
}

fn number(x: f64) -> Expression {
    Expression::Number(x)
}

/// x_0 of `state` takes `terms` and nothing known.
fn takes(state: usize, terms: &[(usize, f64)]) -> Carry {
    let terms = terms.iter().map(|(from, weight)| (*from, number(*weight))).collect();
    Carry { state, from: Linear { terms, constant: number(0.0) } }
}

/// Ground alignment of a platform, then flight.
const PLATFORM: &str = r#"
title = "Inertial platform"

[data]
test = "test"
time = "t"                                   # s
phase = "phase"

[phases.align.states]
velocity_error = { derivative = "0.00980665 * tilt", noise_density = "vrw", unit = "m/s" }
tilt = { derivative = "bias / 60", noise_density = "arw", unit = "mrad" }
bias = { unit = "mrad/min" }

[phases.align.measurements.stationary]
column = "vel"
equation = "velocity_error"
noise = "sigma_vel"

[phases.flight.states]
velocity_error = { derivative = "0.00980665 * tilt", noise_density = "vrw", unit = "m/s" }
tilt = { derivative = "bias / 60", noise_density = "arw", unit = "mrad" }
bias = { unit = "mrad/min" }

[phases.flight.carry]
velocity_error = "velocity_error"
tilt = "tilt"
bias = "bias"

[phases.flight.measurements.doppler]
column = "doppler"
equation = "velocity_error"
noise = "sigma_doppler"

[phases.flight.measurements.star]
column = "star"
equation = "tilt"
noise = "sigma_star"

[phases.flight.covariance]
structure = "diagonal"

[parameters]
vrw = 0.01
arw = 0.02
sigma_vel = 0.05
sigma_doppler = 0.2
sigma_star = 0.3
"#;

#[test]
fn two_phases_have_their_own_measurements_and_share_the_rest() {
    let spec = read(PLATFORM);
    let model = &spec.model;
    let [align, flight] = model.phases.as_slice() else { panic!("{} phases", model.phases.len()) };
    assert_eq!((align.name.as_str(), flight.name.as_str()), ("align", "flight"));
    let labels = [align, flight].map(|phase| phase.label.map(|label| phase.model.literals[label].as_str()));
    assert_eq!(labels, [Some("align"), Some("flight")]);
    let column = model.column.map(|column| model.shared().text_columns[column].name.as_str());
    assert_eq!(column, Some("phase"));
    let names = |phase: &Phase| phase.model.measurements.iter().map(|one| one.name.clone()).collect::<Vec<_>>();
    assert_eq!((names(align), names(flight)), (vec!["stationary".to_owned()], vec!["doppler".into(), "star".into()]));
    assert_eq!((align.carry.len(), align.filter.is_none(), flight.filter.is_none()), (0, true, true));
    assert_eq!(flight.carry, [takes(0, &[(0, 1.0)]), takes(1, &[(1, 1.0)]), takes(2, &[(2, 1.0)])]);
    assert_eq!(align.model.covariance.kind, CovarianceKind::Full);
    assert_eq!(flight.model.covariance.kind, CovarianceKind::Diagonal);
    assert_eq!(model.dimension(), 6);
    for (a, b) in model.phases.iter().zip(&model.phases[1..]) {
        let (a, b) = (&a.model, &b.model);
        assert_eq!((&a.title, &a.columns, &a.text_columns), (&b.title, &b.columns, &b.text_columns));
        assert_eq!((&a.literals, &a.parameters, a.group), (&b.literals, &b.parameters, b.group));
    }
    let columns: Vec<&str> = model.shared().columns.iter().map(|column| column.name.as_str()).collect();
    assert_eq!(columns, ["t", "vel", "doppler", "star"]);
    assert_eq!(model.shared().columns[3].used_in, "`column` of measurement `star` of phase `flight`");
}

#[test]
fn a_state_that_inherits_and_adds_nothing_enters_but_is_not_estimated() {
    let spec = read(
        r#"
[data]
test = "test"
time = "t"
phase = "phase"

[phases.calibrate.states]
bias = { derivative = "rate", noise_density = "rw" }
rate = {}

[phases.calibrate.measurements.bench]
column = "bench"
equation = "bias"
noise = 0.05

[phases.use.states]
bias = { derivative = "rate", noise_density = "rw" }
rate = { initial = { mean = 0, sigma = 0 } }

[phases.use.carry]
rate = "rate"
bias = "0.9 * bias + 2 * heat"

[phases.use.measurements.angle_rate]
column = "angle_rate"
equation = "bias"
noise = 0.08

[phases.use.mean]
fixed = { bias = 0 }

[phases.use.covariance]
structure = "fixed"
matrix = [[0.25]]

[parameters]
rw = 0.02
"#,
    );
    let last = &spec.model.phases[1];
    assert_eq!(last.entering(), [0, 1]);
    assert_eq!((last.model.estimated.as_slice(), last.carry.len()), (&[0][..], 2));
    assert_eq!(last.carry[0].from.terms, [(0, number(0.9))], "carry is in ascending order of state");
    assert_ne!(last.carry[0].from.constant, number(0.0), "a constant term is a known input");
    assert_eq!(last.carry[1], takes(1, &[(1, 1.0)]));
    assert_eq!(last.model.mean.elements, [MeanElement::Fixed(0.0)]);
    assert_eq!(last.model.covariance.kind, CovarianceKind::Fixed(vec![vec![number(0.25)]]));
}

/// An accelerometer whose scale factor a filter considers.
const SCHMIDT: &str = r#"
[data]
test = "unit"
time = "t"                                   # h

[states]
bias = { derivative = "trend", noise_density = "rw", unit = "ug" }
trend = { unit = "ug/h" }
scale = { unit = "ppm" }

[measurements.output]
column = "output"
equation = "bias + scale * g_in"
noise = "sigma_v"

[mean]
fixed = { scale = 0 }

[covariance]
fixed = { "scale, scale" = 4, "bias, scale" = 0, "trend, scale" = 0 }

[filter]
kind = "kalman-schmidt"
consider = ["scale"]
mean = { bias = 8, trend = 0 }
covariance = [[100, 0, 0], [0, 25, 0], [0, 0, 1]]
parameters = { sigma_v = 2, rw = 0.5 }

[parameters]
rw = 4
sigma_v = 6
"#;

#[test]
fn a_filter_has_its_own_prior_and_its_own_beliefs() {
    let spec = read(SCHMIDT);
    let [phase] = spec.model.phases.as_slice() else { panic!("{} phases", spec.model.phases.len()) };
    assert_eq!((phase.name.as_str(), phase.label, spec.model.column), ("main", None, None));
    let filter = phase.filter.as_ref().expect("there is a filter");
    assert_eq!((filter.consider.as_slice(), filter.mean.as_slice()), (&[2][..], &[8.0, 0.0, 0.0][..]));
    assert_eq!(filter.covariance, DMatrix::from_diagonal(&DVector::from_vec(vec![100.0, 25.0, 1.0])));
    assert_eq!(filter.parameters, [(0, 0.5), (1, 2.0)]);
    assert_eq!(phase.model.covariance.fixed[0], FixedElement { i: 2, j: 0, value: 0.0 });
    assert_eq!(spec.model.shared().parameters[0].value, Value::Fixed(4.0), "the model keeps its own belief");
}
