//! Levels: what a file may say of groups that tests stand in, and what the model is then.

use kalfit::TestKey;
use kalfit::model::{CovarianceKind, CovarianceStructure, Expression, FixedElement, Role, roles};
use kalfit_spec::{BesideError, Spec};
use nalgebra::DMatrix;

const PASTES: &str = r#"
title = "Strength of paste: two assays of each of three casks from ten batches"

[data]
test = "cask"
levels = ["batch"]

[states]
strength_of_cask = {}

[measurements.strength]
column = "strength"
equation = "strength_of_cask"
noise = "sigma"

[parameters]
sigma = {}

[levels.batch.covariance]
structure = "full"
"#;

const UNITS: &str = r#"
[data]
test = "run"
levels = ["lot", "serial"]
group = "lot"
[states]
bias = {}
scale = {}
slope = { random = false }
drift = {}
[measurements.y]
column = "y"
equation = "bias + scale * u + slope * z + drift * w"
variance = "v"
[covariance]
order = ["drift", "scale", "bias", "slope"]
states = ["bias"]
[levels.lot.covariance]
structure = "fixed"
states = ["bias", "scale"]
matrix = [[0, 0, 0, 0], [0, "v", 0.5, 0], [0, 0.5, "2 * v", 0], [0, 0, 0, 0]]
[levels.serial.covariance]
structure = "blocks"
blocks = [["drift", "bias"]]
fixed = { "bias, bias" = 4 }
equal = [["drift, drift", "scale, scale"]]
start = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 4, 0], [0, 0, 0, 0]]
[parameters]
v = {}
"#;

fn read(text: &str) -> Spec {
    Spec::parse("model.toml", text).unwrap_or_else(|error| panic!("{text}\n{error:?}"))
}

/// Variances fixed at zero.
fn still(elements: &[usize]) -> Vec<FixedElement> {
    elements.iter().map(|&i| FixedElement { i, j: i, value: 0.0 }).collect()
}

#[test]
fn casks_of_batches_are_told_apart_by_both() {
    let spec = read(PASTES);
    assert_eq!(spec.layout.test, TestKey::Column("cask".to_owned()));
    assert_eq!(spec.layout.levels, ["batch"]);
    let [batch] = spec.model.levels.as_slice() else { panic!("{:?}", spec.model.levels) };
    assert_eq!((batch.name.as_str(), &batch.covariance), ("batch", &CovarianceStructure::full()));
    let column = &spec.model.shared().text_columns[batch.column];
    assert_eq!((column.name.as_str(), column.used_in.as_str()), ("batch", "`levels` of `[data]`"));
    assert_eq!(spec.level_span("batch").map(|span| &spec.text[span]), Some("\"batch\""));
    assert_eq!(spec.level_span("cask"), None);
}

#[test]
fn a_level_without_a_table_is_full() {
    let expected = read(PASTES).model;
    for without in ["", "[levels]\n", "[levels.batch]\n", "[levels.batch.covariance]\n"] {
        let text = PASTES.replace("[levels.batch.covariance]\nstructure = \"full\"\n", without);
        assert_eq!(read(&text).model, expected, "{without}");
    }
    assert_eq!(read(&PASTES.replace("\"cask\"", "\"@file\"")).model, expected);
}

#[test]
fn states_that_are_not_listed_vary_no_more_than_those_that_never_do() {
    let model = read(UNITS).model;
    let names: Vec<&str> = model.levels.iter().map(|level| level.name.as_str()).collect();
    assert_eq!(names, ["lot", "serial"], "the outermost first");
    assert_eq!(model.shared().estimated_names(), ["drift", "scale", "bias", "slope"]);
    assert_eq!(model.shared().covariance.fixed, still(&[0, 1, 3]), "only `bias` varies from run to run");
    let [lot, serial] = model.levels.as_slice() else { panic!("{names:?}") };
    assert_eq!(lot.covariance.fixed, still(&[0, 3]));
    let CovarianceKind::Fixed(matrix) = &lot.covariance.kind else { panic!("{:?}", lot.covariance.kind) };
    assert_eq!(matrix[1][1], Expression::Parameter(0));
    let expected = CovarianceStructure {
        kind: CovarianceKind::Blocks(vec![vec![0, 2], vec![1], vec![3]]),
        fixed: [FixedElement { i: 2, j: 2, value: 4.0 }, still(&[3]).remove(0)].into(),
        equal: vec![vec![(0, 0), (1, 1)]],
        known: None,
        start: Some(DMatrix::from_diagonal(&[1.0, 1.0, 4.0, 0.0].to_vec().into())),
    };
    assert_eq!(serial.covariance, expected, "by default all that are random vary");
}

#[test]
fn a_parameter_of_a_level_is_used_there() {
    let model = read(UNITS).model;
    assert_eq!(roles(&model), [Role::Scale { power: 1 }]);
    assert!(model.shared().parameters[0].positive);
}

#[test]
fn nothing_need_vary_at_a_level() {
    let spec = read(&PASTES.replace("structure = \"full\"", "states = []"));
    assert_eq!(
        spec.model.levels[0].covariance,
        CovarianceStructure { fixed: still(&[0]), ..CovarianceStructure::full() }
    );
    let spec = read(&format!("{PASTES}[covariance]\nstates = []\n"));
    assert_eq!(spec.model.shared().covariance.fixed, still(&[0]), "nor from test to test");
}

#[test]
fn levels_are_described() {
    insta::assert_snapshot!(read(PASTES).describe().join("\n"), @"
    tests: one for each value of columns `batch` and `cask` together
    steps: one for each row; x_0 is at the first row
    state `strength_of_cask`: constant; start estimated
    measurement `strength`: column `strength` reads strength_of_cask; noise of standard deviation sigma
    parameter `sigma`: free, not negative
    order of μ and Σ: strength_of_cask
    covariance Σ from test to test of one `batch`: full
    level `batch`: one group for each value of column `batch`
    level `batch`: covariance Σ from group to group: full
    ");
    let lines = read(UNITS).describe();
    let of = |start: &str| lines.iter().filter(|line| line.starts_with(start)).cloned().collect::<Vec<_>>().join("\n");
    insta::assert_snapshot!([of("tests"), of("level")].join("\n"), @"
    tests: one for each value of columns `lot`, `serial` and `run` together; reports are grouped by column `lot`
    level `lot`: one group for each value of column `lot`
    level `lot`: covariance Σ from group to group: known, [[0, 0, 0, 0], [0, v, 0.5, 0], [0, 0.5, 2 * v, 0], [0, 0, 0, 0]]
    level `lot`: variance of `drift`: fixed at 0
    level `lot`: variance of `slope`: fixed at 0
    level `serial`: one group for each value of columns `lot` and `serial` together
    level `serial`: covariance Σ from group to group: blocks (drift, bias; scale; slope)
    level `serial`: variance of `bias`: fixed at 4
    level `serial`: variance of `slope`: fixed at 0
    level `serial`: covariances of `drift, drift` and `scale, scale`: equal
    level `serial`: covariance Σ from group to group: starts at the given matrix
    ");
}

#[test]
fn reductions_are_the_same_in_groups() {
    let alone = PASTES.replace("levels = [\"batch\"]\n", "");
    let alone = alone.replace("[levels.batch.covariance]\nstructure = \"full\"\n", "");
    assert_eq!(read(PASTES).reduction_digest(), read(&alone).reduction_digest());
}

/// The covariances from lot to lot, from serial to serial and from run to run under a hypothesis.
fn under(hypothesis: &str) -> [CovarianceStructure; 3] {
    let model = read(UNITS).under(hypothesis).unwrap_or_else(|error| panic!("{hypothesis}\n{error:?}")).model;
    let [lot, serial] = model.levels.as_slice() else { panic!("{:?}", model.levels) };
    [&lot.covariance, &serial.covariance, &model.shared().covariance].map(Clone::clone)
}

#[test]
fn a_hypothesis_replaces_the_table_of_a_level() {
    let [lot, serial, run] = under("[mean]\nfixed = { bias = 1 }\n");
    let [_, found, same] = under("[levels.serial.covariance]\nstates = []\n");
    let nothing = CovarianceStructure { fixed: still(&[0, 1, 2, 3]), ..CovarianceStructure::full() };
    assert_eq!((&found, &same), (&nothing, &run), "nothing is left of the structure");
    let [found, same, _] = under("[levels.lot.covariance]\nstates = []\n");
    assert_eq!((&found, &same), (&nothing, &serial));
    let [same, _, found] = under("[covariance]\nstates = []\n");
    assert_eq!((&found, &same), (&nothing, &lot));
    let [found, ..] = under("[levels.lot.covariance]\nstructure = 'diagonal'\n");
    assert_eq!((found.kind, found.fixed), (CovarianceKind::Diagonal, still(&[0, 3])), "what varies stays");
    let [_, found, _] = under("[levels.serial.covariance]\nequal = []\n");
    assert_eq!(found, CovarianceStructure { equal: Vec::new(), start: None, ..serial }, "start values go");
    let named = read(UNITS).under("title = 'none'\n[levels.serial.covariance]\nstates = []\n").unwrap();
    assert_eq!((named.title.as_deref(), named.model.shared()), (Some("none"), read(UNITS).model.shared()));
}

#[test]
fn a_hypothesis_may_speak_of_a_level_that_the_model_does_not() {
    let alone = read(&PASTES.replace("[levels.batch.covariance]\nstructure = \"full\"\n", ""));
    let found = alone.under("[levels.batch.covariance]\nstates = []\n").unwrap().model.levels;
    assert_eq!(found[0].covariance.fixed, still(&[0]));
}

#[test]
fn matrices_of_a_hypothesis_have_its_order_at_every_level() {
    let order = "[covariance]\norder = ['bias', 'scale', 'drift', 'slope']\n";
    let matrix = "structure = 'fixed'\nmatrix = [[3, 1, 0, 0], [1, 2, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]]\n";
    let [found, ..] = under(&format!("{order}[levels.lot.covariance]\n{matrix}"));
    let CovarianceKind::Fixed(entries) = found.kind else { panic!("{:?}", found.kind) };
    let numbers: Vec<f64> = entries.iter().flatten().map(|entry| entry.as_number().expect("numbers")).collect();
    assert_eq!(numbers, [0., 0., 0., 0., 0., 2., 1., 0., 0., 1., 3., 0., 0., 0., 0., 0.]);
}

fn refusal(model: &str, hypothesis: &str) -> String {
    let (file, text, error) = match read(model).under(hypothesis) {
        Ok(_) => return "accepted".to_owned(),
        Err(BesideError::File(error)) => ("hypothesis", hypothesis, error),
        Err(BesideError::Model(error)) => ("model", model, error),
    };
    let mut lines = vec![error.message];
    lines.extend(error.span.map(|span| format!("in the {file} at {:?}", &text[span])));
    lines.extend(error.hint.map(|hint| format!("hint {hint}")));
    lines.join("\n")
}

#[test]
fn a_hypothesis_about_no_level_is_refused() {
    let alone = PASTES.replace("levels = [\"batch\"]\n", "");
    let alone = alone.replace("[levels.batch.covariance]\nstructure = \"full\"\n", "");
    insta::assert_snapshot!(refusal(&alone, "[levels.batch.covariance]\nstates = []\n"), @r#"
    `levels` has no effect in a hypothesis about a model without levels
    in the hypothesis at "levels"
    "#);
    insta::assert_snapshot!(refusal(UNITS, "[levels.lots.covariance]\nstates = []\n"), @r#"
    unknown level `lots` in `[levels]` of the hypothesis
    in the hypothesis at "lots"
    hint did you mean `lot`?
    "#);
    insta::assert_snapshot!(refusal(UNITS, "[levels.lot]\n"), @r#"
    `[levels.lot]` of the hypothesis has no `covariance`
    in the hypothesis at "[levels.lot]"
    "#);
    insta::assert_snapshot!(refusal(UNITS, "[levels.lot.mean]\n"), @r#"
    unknown key `mean` in `[levels.lot]` of the hypothesis
    in the hypothesis at "mean"
    hint its keys are `covariance`
    "#);
    insta::assert_snapshot!(refusal(UNITS, "[levels.lot]\ncovariance = 3\n"), @r#"
    `covariance` of `[levels.lot]` of the hypothesis is a number, expected a table
    in the hypothesis at "3"
    "#);
    insta::assert_snapshot!(refusal(UNITS, "levels = 3\n"), @r#"
    `levels` of the hypothesis is a number, expected a table
    in the hypothesis at "3"
    "#);
}

#[test]
fn a_hypothesis_about_a_level_that_cannot_be_is_refused() {
    insta::assert_snapshot!(refusal(UNITS, "[levels.lot.covariance]\nknown = [[1]]\n"), @r#"
    unknown key `known` in `[levels.lot.covariance]`
    in the hypothesis at "known"
    hint known covariance is that of tests: it stands in `[covariance]`
    "#);
    insta::assert_snapshot!(refusal(UNITS, "[levels.lot.covariance]\nstates = ['scale']\n"), @r#"
    state `bias` is not among `states` of `[levels.lot.covariance]`, but its covariance in `matrix` of `[levels.lot.covariance]` is not 0
    in the model at "0.5"
    "#);
    insta::assert_snapshot!(refusal(UNITS, "[levels.lot.covariance]\nstates = ['slope']\n"), @r#"
    state `slope` in `states` of `[levels.lot.covariance]` has `random = false`, so it does not vary
    in the hypothesis at "'slope'"
    "#);
}
