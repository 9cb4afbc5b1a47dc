//! Models in phases: what each phase has, takes from the top level and inherits.

use kalfit::model::{Carry, CovarianceKind, Expression, FixedElement, Initial, Linear, MeanElement, Phase, Value};
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

/// Two phases whose tables stand at the top level but for what differs.
const SHARED: &str = r#"
[data]
test = "id"
time = "t"
phase = "leg"
[states]
tilt = { derivative = "bias", noise_density = "arw" }
bias = {}
[measurements.level]
column = "level"
equation = "tilt"
noise = "noise"
[measurements.turn]
column = "turn"
equation = "bias"
noise = 2
[process_noise_covariance]
[noise_covariance]
"level, turn" = 0.1
[mean]
fixed = { bias = 0 }
[covariance]
structure = "diagonal"
[phases.align]
initial_time = "start"
[phases.coast]
[phases.coast.carry]
tilt = "tilt + 0.1 * bias"
[phases."re-entry".mean]
[phases.re-entry.measurements.y]
column = "y"
equation = "bias"
noise = "noise"
[phases.re-entry.noise_covariance]
[parameters]
arw = { start = 0.1 }
noise = { per = "lot", fixed = { A = 0.7 } }
"#;

#[test]
fn a_phase_takes_from_the_top_level_what_it_leaves_out() {
    let spec = read(SHARED);
    let [align, coast, entry] = spec.model.phases.as_slice() else { panic!("{:?}", spec.describe()) };
    assert_eq!([&align.name, &coast.name, &entry.name], ["align", "coast", "re-entry"]);
    assert_eq!((&align.model.states, &align.model.measurements), (&coast.model.states, &coast.model.measurements));
    assert_eq!(align.model.noise_covariance, coast.model.noise_covariance);
    assert_eq!((entry.model.measurements.len(), entry.model.noise_covariance.len()), (1, 0), "both are its own");
    assert_eq!(align.model.mean.elements, [MeanElement::Free, MeanElement::Fixed(0.0)]);
    assert_eq!(entry.model.mean.elements, [MeanElement::Free, MeanElement::Free], "its own table is empty");
    assert!(spec.model.phases.iter().all(|phase| phase.model.covariance.kind == CovarianceKind::Diagonal));
    assert!(align.model.clock.initial_time.is_some() && coast.model.clock.initial_time.is_none());
    assert_eq!(coast.carry, [takes(0, &[(0, 1.0), (1, 0.1)])]);
    assert!(entry.carry.is_empty(), "without `carry` all states start afresh");
    assert_eq!(spec.model.estimated_names().len(), 6);
}

#[test]
fn places_are_found_phase_by_phase() {
    let spec = read(SHARED);
    let at = |span: Option<std::ops::Range<usize>>| span.map(|span| SHARED[span.start..].lines().next().unwrap_or(""));
    assert_eq!(at(spec.phase_span("coast")), Some("coast]"));
    assert_eq!(at(spec.state_span_in("re-entry", "bias")), Some("bias = {}"));
    assert_eq!(at(spec.state_span("bias")), Some("bias = {}"));
    assert_eq!(at(spec.measurement_span_in("re-entry", "y")), Some("y]"));
    assert_eq!(at(spec.measurement_span_in("coast", "y")), None);
    assert_eq!(at(spec.measurement_span("y")), Some("y]"));
    assert_eq!(at(spec.carry_span("coast", "tilt")), Some("tilt = \"tilt + 0.1 * bias\""));
    assert_eq!(at(spec.filter_span("coast")), None);
    assert_eq!(at(spec.column_span("leg")), Some("\"leg\""));
    let (plain, filtered) = (read(SCHMIDT), SCHMIDT.find("filter]"));
    assert_eq!((plain.phase_span("main"), plain.filter_span("main").map(|span| span.start)), (None, filtered));
}

#[test]
fn a_description_goes_phase_by_phase() {
    insta::assert_snapshot!(read(SHARED).describe().join("\n"), @"
    tests: one for each value of column `id`
    steps: rows of equal time, column `t`
    phases: `align`, then `coast`, then `re-entry`; column `leg` tells the phase of a row
    parameter `arw`: free, start 0.1, not negative
    parameter `noise`: free, not negative, one value for each value of column `lot`, fixed at 0.7 for 'A'
    phase `align`: x_0 is at time start
    state `tilt`: d/dt = bias + noise of standard deviation arw per square root of a unit of time; start estimated
    state `bias`: constant; start estimated
    measurement `level`: column `level` reads tilt; noise of standard deviation noise
    measurement `turn`: column `turn` reads bias; noise of variance 4
    measurement noise of `level` and `turn`: covariance 0.1
    order of μ and Σ: tilt, bias
    mean of `bias`: fixed at 0
    covariance Σ: diagonal
    phase `coast`: x_0 is at its first row
    state `tilt`: d/dt = bias + noise of standard deviation arw per square root of a unit of time; start estimated
    state `bias`: constant; start estimated
    state `tilt` inherits tilt + 0.1 * bias, as phase `align` ends
    measurement `level`: column `level` reads tilt; noise of standard deviation noise
    measurement `turn`: column `turn` reads bias; noise of variance 4
    measurement noise of `level` and `turn`: covariance 0.1
    order of μ and Σ: tilt, bias
    mean of `bias`: fixed at 0
    covariance Σ: diagonal
    phase `re-entry`: x_0 is at its first row
    state `tilt`: d/dt = bias + noise of standard deviation arw per square root of a unit of time; start estimated
    state `bias`: constant; start estimated
    nothing is inherited from phase `coast`
    measurement `y`: column `y` reads bias; noise of standard deviation noise
    order of μ and Σ: tilt, bias
    covariance Σ: diagonal
    ");
}

#[test]
fn a_description_has_the_filter_in_words() {
    insta::assert_snapshot!(read(SCHMIDT).describe().join("\n"), @"
    tests: one for each value of column `unit`
    steps: rows of equal time, column `t`; x_0 is at the first row
    state `bias` [ug]: d/dt = trend + noise of standard deviation rw per square root of a unit of time; start estimated
    state `trend` [ug/h]: constant; start estimated
    state `scale` [ppm]: constant; start estimated
    measurement `output`: column `output` reads bias + g_in * scale; noise of standard deviation sigma_v
    parameter `rw`: fixed at 4, not negative
    parameter `sigma_v`: fixed at 6, not negative
    order of μ and Σ: bias, trend, scale
    mean of `scale`: fixed at 0
    covariance Σ: full
    covariance of `bias, scale`: fixed at 0
    covariance of `trend, scale`: fixed at 0
    variance of `scale`: fixed at 4
    filter: Kalman-Schmidt; its estimates stand for the measurements
    filter: estimates `bias`, `trend`; considers `scale`
    filter: prior mean [8, 0, 0], prior covariance [[100, 0, 0], [0, 25, 0], [0, 0, 1]]
    filter: believes that `rw` is 0.5
    filter: believes that `sigma_v` is 2
    ");
}

#[test]
fn what_is_set_or_given_reaches_every_phase() {
    let mut spec = read(SHARED);
    spec.set("noise[B]=3").expect("a level can be set");
    spec.set("arw=0.2").expect("a parameter can be set");
    spec.give("noise", &[(Some("C"), 5.0)]).expect("a level can be given");
    let first = spec.model.shared().clone();
    assert_eq!(first.parameters[0].value, Value::Fixed(0.2));
    assert_eq!(first.parameters[1].fixed_levels.len(), 3);
    for phase in &spec.model.phases {
        assert_eq!((&phase.model.parameters, &phase.model.literals), (&first.parameters, &first.literals));
    }
}

#[test]
fn one_phase_may_be_declared_without_a_column() {
    let text =
        "[phases.bench.states]\na = {}\n[phases.bench.measurements.y]\ncolumn = 'y'\nequation = 'a'\nnoise = 1\n";
    let spec = read(text);
    assert_eq!((spec.model.phases[0].name.as_str(), spec.model.phases[0].label), ("bench", None));
    assert_eq!(spec.model.column, None);
    let spec = read(&format!("[data]\nphase = 'leg'\n{text}"));
    assert_eq!((spec.model.phases[0].label, spec.model.column), (Some(0), Some(0)));
}

/// A phase of two states, then one with `states`, `carry` and what else is given.
fn second(states: &str, carry: &str) -> String {
    format!(
        "[data]\ntime = 't'\nphase = 'leg'\n[phases.one.states]\ndrift = {{ process = 'gauss-markov-2', time_constant = 9, \
         sigma = 2 }}\nbias = {{}}\n[phases.one.measurements.y]\ncolumn = 'y'\nequation = 'bias + drift'\nnoise = 1\n\
         [phases.two.states]\n{states}\n[phases.two.carry]\n{carry}\n[phases.two.measurements.y]\ncolumn = 'y'\n\
         equation = 'bias'\nnoise = 1\n"
    )
}

#[test]
fn coefficients_of_carry_may_be_parameters_and_columns_and_states_of_the_phase_before_hide_columns() {
    let text =
        second("bias = {}\ndrift = {}", "bias = '(k + `drift`) * bias - drift / 2 + 3 * k'") + "[parameters]\nk = {}\n";
    let spec = read(&text);
    let [carry] = spec.model.phases[1].carry.as_slice() else { panic!("{:?}", spec.model.phases[1].carry) };
    assert_eq!(carry.state, 0, "`bias` is the first state of the second phase");
    let states: Vec<usize> = carry.from.terms.iter().map(|(state, _)| *state).collect();
    assert_eq!(states, [0, 2], "`drift` is state 0 of the phase before, then comes its hidden rate, then `bias`");
    insta::assert_snapshot!(spec.describe().iter().find(|line| line.contains("inherits")).expect("it is described"), @"state `bias` inherits -0.5 * drift + (k + `drift`) * bias + 3 * k, as phase `one` ends");
}

#[test]
fn a_second_order_process_goes_on_with_its_hidden_rate() {
    let states =
        "bias = {}\ndrift = { process = 'gauss-markov-2', time_constant = 9, sigma = 2, initial = 'estimated' }";
    let last = read(&second(states, "drift = '0.5 * drift'")).model.phases.remove(1);
    assert_eq!(last.carry, [takes(1, &[(0, 0.5)]), takes(2, &[(1, 0.5)])]);
    let none = Initial::Known { mean: number(0.0), variance: number(0.0) };
    assert_eq!(last.model.states[2].initial, none, "the rate goes on and adds nothing of its own");
    assert_eq!(last.model.estimated, [0, 1]);
}

#[test]
fn one_phase_may_have_a_filter_and_others_not() {
    let filter = "[phases.two.filter]\nkind = 'kalman-schmidt'\nmean = { bias = 1 }\ncovariance = [[4]]\n";
    let spec = read(&(second("bias = {}", "bias = 'bias'") + filter));
    let [one, two] = spec.model.phases.as_slice() else { panic!("{:?}", spec.describe()) };
    assert!(one.filter.is_none());
    let filter = two.filter.as_ref().expect("there is a filter");
    assert_eq!((filter.consider.len(), filter.mean.as_slice(), filter.parameters.len()), (0, &[1.0][..], 0));
}

#[test]
fn a_filter_of_the_top_level_serves_the_phases_that_have_none() {
    let filter = "[filter]\nkind = 'kalman-schmidt'\ncovariance = [[4, 0], [0, 9]]\nparameters = { arw = 3, noise = 1 }\n\
                  [phases.re-entry.filter]\nkind = 'kalman-schmidt'\nconsider = ['tilt']\nmean = { bias = 1 }\n\
                  covariance = [[1, 0], [0, 2]]\nparameters = { arw = 0.5, noise = 2 }\n";
    let spec = read(&SHARED.replace("[parameters]", &format!("{filter}[parameters]")));
    let filters: Vec<_> = spec.model.phases.iter().map(|phase| phase.filter.clone().expect("each has one")).collect();
    assert_eq!(filters[0], filters[1]);
    assert_eq!((&filters[0].mean, &filters[2].mean), (&vec![0.0, 0.0], &vec![0.0, 1.0]));
    assert_eq!((&filters[0].consider, &filters[2].consider), (&vec![], &vec![0]));
}

#[test]
fn a_considered_state_takes_its_hidden_rate_with_it() {
    let text = "[data]\ntime = 't'\n[states]\na = {}\nb = { process = 'gauss-markov-2', time_constant = 9, sigma = 2 }\n\
                [measurements.y]\ncolumn = 'y'\nequation = 'a + b'\nnoise = 1\n[filter]\nkind = 'kalman-schmidt'\n\
                consider = ['b']\nmean = { 'b (rate)' = 3 }\ncovariance = [[1, 0, 0], [0, 2, 0], [0, 0, 3]]\n";
    let filter = read(text).model.phases.remove(0).filter.expect("there is a filter");
    assert_eq!((filter.consider, filter.mean), (vec![1, 2], vec![0.0, 0.0, 3.0]));
}

#[test]
fn a_phase_may_be_of_any_name_that_a_cell_can_hold() {
    let text = SHARED.replace("phases.coast", "phases.\"ground test [2]\"");
    let spec = read(&text);
    assert_eq!(spec.model.phases[1].name, "ground test [2]");
    assert!(spec.model.shared().literals.contains(&"ground test [2]".to_owned()));
}

#[test]
fn an_error_in_a_table_of_the_top_level_says_which_phase_takes_it() {
    let labels = |text: &str| {
        let error = Spec::parse("model.toml", text).expect_err("it is wrong");
        format!("{error}\n{}", error.label.as_deref().unwrap_or_default())
    };
    insta::assert_snapshot!(labels(&SHARED.replace("[phases.coast]", "[phases.coast.states]\ntilt = {}\n[phases.coast]")), @"
    unknown state `bias` in `fixed` of `[mean]`
    for phase `coast`, which has no `mean` of its own
    ");
    insta::assert_snapshot!(labels(&SHARED.replace("\n[phases.re-entry.noise_covariance]", "")), @"
    unknown measurement `level` in `[noise_covariance]`
    for phase `re-entry`, which has no `noise_covariance` of its own
    ");
    insta::assert_snapshot!(labels(&SHARED.replace("[states]\n", "[phases.align.states]\n")), @"
    the model has 0 states, expected 1 to 500
    for phase `coast`, which has no `states` of its own
    ");
}

/// A phase of an own part, which follows the platform's alignment.
fn coast(own: &str) -> Spec {
    let (align, _) = PLATFORM.split_at(PLATFORM.find("[phases.flight.states]").expect("there is a flight"));
    let text = format!(
        "{align}{own}[phases.coast.measurements.star]\ncolumn = 'star'\nequation = 'tilt'\nnoise = 'sigma_vel'\n\
         [parameters]\nvrw = 0.01\narw = 0.02\nsigma_vel = 0.05\n"
    );
    read(&text)
}

#[test]
fn an_inheritance_is_linear_in_the_states_in_which_the_phase_before_ended() {
    let spec = coast(
        r#"
[phases.coast.states]
velocity_error = {}
tilt = {}
[phases.coast.carry]                 # x_0 of this phase = own uncertain part + these (linear in the previous phase's final states)
velocity_error = "velocity_error"
tilt = "tilt + 0.1 * bias"           # coefficients: numbers, parameters, columns constant within the test; a constant term is a known input
"#,
    );
    assert_eq!(spec.model.phases[1].carry, [takes(0, &[(0, 1.0)]), takes(1, &[(1, 1.0), (2, 0.1)])]);
}

#[test]
fn a_covariance_that_is_known_may_be_zero_or_huge_in_any_phase() {
    for value in ["0", "1e6", "0.25"] {
        let spec = coast(&format!(
            "[phases.coast.states]\ntilt = {{}}\nvelocity_error = {{ initial = {{ mean = 0, sigma = 0 }} }}\n\
             [phases.coast.carry]\ntilt = '0.9 * tilt'\nvelocity_error = 'velocity_error'\n\
             [phases.coast.covariance]\nstructure = 'fixed'\nmatrix = [[{value}]]\n"
        ));
        let known = number(value.parse().expect("it is a number"));
        assert_eq!(spec.model.phases[1].model.covariance.kind, CovarianceKind::Fixed(vec![vec![known]]), "{value}");
    }
}

#[test]
fn a_filter_as_the_contract_writes_it_is_read() {
    let spec = read(
        r#"
[states]
bias = {}
scale = {}
[measurements.output]
column = "output"
equation = "bias + scale * g_in"
noise = "sigma_v"
[parameters]
sigma_v = { start = 1, per = "lot" }
[filter]                             # or [phases.NAME.filter]
kind = "kalman-schmidt"
consider = ["scale"]                 # states whose uncertainty is accounted for but which are not estimated
mean = { bias = 0 }
covariance = [[4, 0], [0, 1e4]]      # the filter's own prior, required, in the order of all states; a state left out of `mean` is 0
parameters = { sigma_v = 0.2 }       # the filter's own belief, where it differs from the model (named parameters only)
"#,
    );
    let filter = spec.model.phases[0].filter.as_ref().expect("there is a filter");
    assert_eq!((filter.consider.as_slice(), filter.parameters.as_slice()), (&[1][..], &[(0, 0.2)][..]));
    assert_eq!(filter.covariance[(1, 1)], 1e4);
}
