//! Hypotheses about models in phases.

use kalfit::model::{CovarianceKind, MeanElement, PhasedModel, Value};
use kalfit_spec::{BesideError, Spec};
use proptest::prelude::*;

/// Phases `one` and `two` take both tables from the top level, `three` has its own.
const MODEL: &str = r#"
[data]
test = "id"
phase = "leg"
[states]
a = {}
b = {}
[measurements.y]
column = "y"
equation = "a + b * u"
noise = "noise"
[mean]
fixed = { a = 1 }
start = { b = 5 }
regression = { b = ["warm"] }
[covariance]
order = ["b", "a"]
fixed = { "a, b" = 0 }
start = [[4, 0], [0, 1]]
[phases.one]
[phases.two.carry]
a = "a"
[phases.three.mean]
start = { a = 3 }
[phases.three.covariance]
structure = "diagonal"
known = [[1, 0], [0, 0]]
[parameters]
noise = { per = "lot", fixed = { A = 0.7 } }
"#;

fn model() -> Spec {
    Spec::parse("model.toml", MODEL).expect("the model is whole")
}

fn under(hypothesis: &str) -> PhasedModel {
    model().under(hypothesis).unwrap_or_else(|error| panic!("{hypothesis}\n{error:?}")).model
}

/// Message, file, text at the span, and hint.
fn refusal(hypothesis: &str) -> String {
    refusal_by(&model(), hypothesis)
}

fn refusal_by(spec: &Spec, hypothesis: &str) -> String {
    let (file, text, error) = match spec.under(hypothesis) {
        Ok(_) => return "accepted".to_owned(),
        Err(BesideError::File(error)) => ("hypothesis", hypothesis, error),
        Err(BesideError::Model(error)) => ("model", spec.text.as_str(), error),
    };
    let mut lines = vec![error.message];
    lines.extend(error.span.map(|span| format!("in the {file} at {:?}", &text[span])));
    lines.extend(error.label.map(|label| format!("label {label}")));
    lines.extend(error.hint.map(|hint| format!("hint {hint}")));
    lines.join("\n")
}

#[test]
fn a_phase_that_takes_the_top_level_gets_its_keys_and_the_others_keep_theirs() {
    let (found, base) = (under("[phases.two.mean]\nfixed = { b = 0 }\n"), model().model);
    assert_eq!(found.phases[0], base.phases[0]);
    assert_eq!(found.phases[2], base.phases[2]);
    let two = &found.phases[1].model;
    assert_eq!(
        two.mean.elements,
        [MeanElement::Fixed(0.0), MeanElement::Free],
        "`fixed` is replaced whole; b stands first"
    );
    assert_eq!(two.mean.start, [None, None], "start values are dropped");
    assert_eq!(two.mean.regression, base.phases[1].model.mean.regression, "a key that is not replaced");
    assert_eq!(two.covariance, base.phases[1].model.covariance);
    assert_eq!(found.phases[1].carry, base.phases[1].carry);
}

#[test]
fn a_phase_with_its_own_table_gets_keys_of_its_own_table() {
    let found = under("[phases.three.covariance]\nstructure = 'full'\n");
    let three = &found.phases[2].model.covariance;
    assert_eq!(three.kind, CovarianceKind::Full);
    assert!(three.known.is_some(), "what is no constraint stays");
    assert_eq!(found.phases[0], model().model.phases[0]);
}

#[test]
fn the_top_level_acts_on_the_phases_that_take_it() {
    let found = under("[mean]\nfixed = { b = 0 }\n[covariance]\nstructure = 'diagonal'\n");
    for phase in &found.phases[..2] {
        assert_eq!(phase.model.mean.elements, [MeanElement::Fixed(0.0), MeanElement::Free], "{}", phase.name);
        assert_eq!((&phase.model.covariance.kind, phase.model.covariance.fixed.len()), (&CovarianceKind::Diagonal, 0));
        assert_eq!(phase.model.estimated, [1, 0], "the order of the model stays");
    }
    assert_eq!(found.phases[2], model().model.phases[2]);
}

#[test]
fn the_top_level_and_a_phase_may_both_be_spoken_of() {
    let found = under("[mean]\nfixed = { b = 0 }\n[phases.two.mean]\nstart = { a = 2 }\n");
    let [one, two] = [0, 1].map(|i| &found.phases[i].model.mean);
    assert_eq!((&one.elements, &two.elements), (&vec![MeanElement::Fixed(0.0), MeanElement::Free], &one.elements));
    assert_eq!((&one.start, &two.start), (&vec![None, None], &vec![None, Some(2.0)]));
}

#[test]
fn every_phase_may_be_spoken_of() {
    let text: String =
        ["one", "two", "three"].map(|name| format!("[phases.{name}.mean]\nfixed = {{ b = 0 }}\n")).concat();
    let found = under(&text);
    assert!(found.phases.iter().all(|phase| phase.model.mean.elements.contains(&MeanElement::Fixed(0.0))));
    let text = "[phases]\none.covariance.structure = 'diagonal'\ntwo.covariance.structure = 'diagonal'\n";
    let found = under(text);
    assert!(found.phases.iter().all(|phase| phase.model.covariance.kind == CovarianceKind::Diagonal));
}

#[test]
fn parameters_change_in_every_phase() {
    let mut spec = model();
    spec.set("noise[C]=3").expect("a level can be set");
    let found =
        spec.under("[parameters]\nnoise = { per = 'batch', fixed = { 'é' = 2 } }\n").expect("it is whole").model;
    for phase in &found.phases {
        let model = &phase.model;
        let noise = &model.parameters[0];
        assert_eq!(noise.value, Value::Free { start: None });
        assert_eq!(noise.per.map(|column| model.text_columns[column].name.as_str()), Some("batch"));
        let levels: Vec<&str> = noise.fixed_levels.keys().map(|level| model.literals[*level].as_str()).collect();
        assert_eq!(levels, ["é"]);
        assert_eq!((&model.literals, &model.text_columns), (&found.shared().literals, &found.shared().text_columns));
        assert_eq!(phase.label.map(|label| &model.literals[label]), Some(&phase.name));
    }
    let kept = spec.under("[mean]\nfixed = { a = 0 }\n").expect("it is whole").model;
    assert!(
        kept.phases.iter().all(|phase| phase.model.parameters == spec.model.shared().parameters),
        "what was set stays"
    );
}

#[test]
fn what_is_wrong_with_a_phase_is_refused_where_it_stands() {
    insta::assert_snapshot!(refusal("[phases.for.mean]\nfixed = { a = 0 }\n"), @r#"
    unknown phase `for` in the hypothesis
    in the hypothesis at "for"
    "#);
    insta::assert_snapshot!(refusal("[phases.thre.mean]\nfixed = { a = 0 }\n"), @r#"
    unknown phase `thre` in the hypothesis
    in the hypothesis at "thre"
    hint did you mean `three`?
    "#);
    insta::assert_snapshot!(refusal("[phases.two]\n"), @r#"
    `[phases.two]` of the hypothesis has no `mean`
    in the hypothesis at "[phases.two]"
    "#);
    insta::assert_snapshot!(refusal("[phases.two.carry]\na = 'a'\n"), @r#"
    unknown key `carry` in `[phases.two]` of the hypothesis
    in the hypothesis at "carry"
    hint its keys are `mean` or `covariance`
    "#);
    insta::assert_snapshot!(refusal("[phases.two]\nmean = 3\n"), @r#"
    `mean` of `[phases.two]` of the hypothesis is a number, expected a table
    in the hypothesis at "3"
    label expected a table
    "#);
    insta::assert_snapshot!(refusal("[phases]\ntwo = 3\n"), @r#"
    `two` of `[phases]` of the hypothesis is a number, expected a table
    in the hypothesis at "3"
    label expected a table
    "#);
    insta::assert_snapshot!(refusal("phases = 3\n"), @r#"
    `phases` of the hypothesis is a number, expected a table
    in the hypothesis at "3"
    label expected a table
    "#);
    insta::assert_snapshot!(refusal("[phases.two.mean]\nfixed = { c = 0 }\n"), @r#"
    unknown state `c` in `fixed` of `[phases.two.mean]`
    in the hypothesis at "c"
    "#);
    insta::assert_snapshot!(refusal("[phases.three.covariance]\nknown = [[0, 0], [0, 0]]\n"), @r#"
    `known` has no effect in a hypothesis: it is no constraint, and the model's stays
    in the hypothesis at "known"
    "#);
    insta::assert_snapshot!(refusal("[phases.three.mean]\nregression = { a = ['cold'] }\n"), @r#"
    unknown regression column `cold` in the hypothesis: the model has no regression on it
    in the hypothesis at "'cold'"
    "#);
    insta::assert_snapshot!(refusal("[mean]\nfixed = { c = 0 }\n"), @r#"
    unknown state `c` in `fixed` of `[mean]`
    in the hypothesis at "c"
    label for phase `one`, which has no `mean` of its own
    "#);
    insta::assert_snapshot!(refusal("[filter]\nkind = 'kalman-schmidt'\n"), @r#"
    unknown key `filter` in the hypothesis
    in the hypothesis at "filter"
    hint its keys are `title`, `mean`, `covariance`, `levels`, `crossed`, `parameters` or `phases`
    "#);
}

#[test]
fn a_table_of_the_top_level_reaches_the_phases_that_take_it_even_when_all_are_spoken_of() {
    let all: String = ["one", "two"].map(|name| format!("[phases.{name}.mean]\nstart = {{ b = 7 }}\n")).concat();
    let found = under(&format!("[mean]\nfixed = {{ a = 0 }}\n{all}"));
    for phase in &found.phases[..2] {
        assert_eq!(phase.model.mean.elements, [MeanElement::Free, MeanElement::Fixed(0.0)], "{}", phase.name);
        assert_eq!(phase.model.mean.start, [Some(7.0), None], "{}", phase.name);
    }
}

#[test]
fn a_table_of_the_top_level_that_no_phase_takes_is_refused() {
    let own: String = ["one", "two", "three"].map(|name| format!("[phases.{name}.mean]\n")).concat();
    let text = MODEL
        .replace("[phases.three.mean]\nstart = { a = 3 }\n", "")
        .replace("[parameters]", &format!("{own}[parameters]"));
    let (from, to) = (text.find("[mean]").expect("it is there"), text.find("[covariance]").expect("it is there"));
    let spec = Spec::parse("model.toml", &(text[..from].to_owned() + &text[to..])).expect("the model is whole");
    insta::assert_snapshot!(refusal_by(&spec, "[mean]\nfixed = { a = 0 }\n"), @r#"
    `mean` has no effect when every phase of the model has its own
    in the hypothesis at "mean"
    hint write `[phases.NAME.mean]`
    "#);
}

#[test]
fn phases_of_a_model_without_phases_are_refused() {
    let text = "[states]\na = {}\n[measurements.y]\ncolumn = 'y'\nequation = 'a'\nnoise = 1\n";
    let spec = Spec::parse("model.toml", text).expect("the model is whole");
    let Err(BesideError::File(error)) = spec.under("[phases.main.mean]\nfixed = { a = 0 }\n") else {
        panic!("it is not refused");
    };
    assert_eq!(error.message, "`phases` has no effect in a hypothesis about a model without phases");
}

/// Lines that hypotheses are made of, some of them wrong.
const LINES: [&str; 22] = [
    "[mean]",
    "[covariance]",
    "[phases]",
    "[phases.one]",
    "[phases.two.mean]",
    "[phases.three.mean]",
    "[phases.three.covariance]",
    "[phases.one.covariance]",
    "[phases.'é'.mean]",
    "fixed = { a = 0 }",
    "fixed = { 'a, b' = 0 }",
    "fixed = { é = 0 }",
    "tied = { a = 'b + 1' }",
    "start = { b = 2 }",
    "structure = 'diagonal'",
    "structure = 'fixed'",
    "matrix = [[1, 0], [0, 1]]",
    "regression = { a = ['warm'] }",
    "[parameters]",
    "noise = { per = 'é', fixed = { B = 1 } }",
    "mean = { fixed = { b = 1 } }",
    "two.mean.fixed = { b = 1 }",
];

proptest! {
    #![proptest_config(ProptestConfig { cases: 1_000, ..ProptestConfig::default() })]

    #[test]
    fn any_lines_are_a_hypothesis_or_refused(lines in prop::collection::vec(prop::sample::select(&LINES[..]), 0..10)) {
        let (spec, hypothesis) = (model(), lines.join("\n"));
        let (text, error) = match spec.under(&hypothesis) {
            Ok(found) => {
                let shared = found.model.shared().clone();
                for (phase, base) in found.model.phases.iter().zip(&spec.model.phases) {
                    prop_assert_eq!((&phase.name, &phase.carry), (&base.name, &base.carry));
                    prop_assert_eq!(&phase.model.estimated, &base.model.estimated);
                    prop_assert_eq!((&phase.model.literals, &phase.model.parameters), (&shared.literals, &shared.parameters));
                }
                return Ok(());
            }
            Err(BesideError::File(error)) => (hypothesis.as_str(), error),
            Err(BesideError::Model(error)) => (spec.text.as_str(), error),
        };
        prop_assert!(!error.message.is_empty());
        prop_assert!(error.span.clone().is_none_or(|span| text.get(span).is_some()), "{:?}", error.span);
    }
}
