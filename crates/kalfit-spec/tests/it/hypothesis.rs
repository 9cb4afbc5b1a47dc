//! A model under a hypothesis: what replaces what, what stays, and what is refused with its place in the right file.

use crate::Only as _;
use kalfit::model::{CovarianceKind, MeanElement, Value};
use kalfit_spec::{BesideError, Hypothesis, Spec, SpecProblem};
use proptest::prelude::*;

const MODEL: &str = r#"
title = "bench"
[data]
test = "id"
time = "t"
[states]
bias = {}
scale = {}
drift = { process = "gauss-markov", time_constant = "tau", sigma = "s", initial = "estimated" }
[measurements.y]
column = "y"
where = "kind == 'slow'"
equation = "bias + scale * u + drift"
noise = "noise"
[parameters]
tau = { value = 30, lower = 1 }
s = 0.2
noise = { per = "lot", fixed = { A = 0.7, B = 0.9 } }
[mean]
start = { bias = 3 }
regression = { bias = ["warm", "age"] }
[covariance]
order = ["scale", "bias", "drift"]
fixed = { "scale, drift" = 0 }
start = [[4, 0, 0], [0, 1, 0], [0, 0, 1]]
"#;

fn model() -> Spec {
    Spec::parse("model.toml", MODEL).expect("the model is whole")
}

fn under(hypothesis: &str) -> Hypothesis {
    model().under(hypothesis).unwrap_or_else(|error| panic!("{hypothesis}\n{error:?}"))
}

/// Message, file, text at the span, and hint.
fn refusal_by(spec: &Spec, hypothesis: &str) -> String {
    let (file, text, error) = match spec.under(hypothesis) {
        Ok(_) => return "accepted".to_owned(),
        Err(BesideError::File(error)) => ("hypothesis", hypothesis, error),
        Err(BesideError::Model(error)) => ("model", spec.text.as_str(), error),
    };
    let mut lines = vec![error.message];
    lines.extend(error.span.map(|span| format!("in the {file} at {:?}", &text[span])));
    lines.extend(error.hint.map(|hint| format!("hint {hint}")));
    lines.join("\n")
}

fn refusal(hypothesis: &str) -> String {
    refusal_by(&model(), hypothesis)
}

#[test]
fn what_a_hypothesis_does_not_speak_of_stays() {
    let found = under("title = 'no bias'\n[mean]\nfixed = { scale = 0 }\n");
    let base = model().only();
    assert_eq!(found.title.as_deref(), Some("no bias"));
    assert_eq!(found.only().title, "bench", "the title of the model is its own");
    assert_eq!(found.only().covariance, base.covariance, "[covariance], start values included");
    assert_eq!(found.only().parameters, base.parameters);
    assert_eq!(found.only().literals, base.literals);
    assert_eq!((found.only().columns, found.only().text_columns), (base.columns, base.text_columns));
    assert_eq!(found.only().mean.regression, base.mean.regression, "a key of [mean] that is not replaced");
    assert_eq!(found.digest.len(), "sha256:".len() + 64);
    assert_ne!(found.digest, model().digest);
}

#[test]
fn keys_of_the_mean_replace_keys_and_drop_the_start_values() {
    let found = under("[mean]\nfixed = { scale = 0 }\n").only().mean;
    assert_eq!(found.elements, [MeanElement::Fixed(0.0), MeanElement::Free, MeanElement::Free]);
    assert_eq!(found.start, [None; 3], "the model starts the mean of bias at 3");
    let found = under("[mean]\nfixed = { scale = 0 }\nstart = { drift = 7 }\n").only().mean;
    assert_eq!(found.start, [None, None, Some(7.0)], "start values of its own");
    let found = under("[mean]\nfixed = { bias = 3 }\n").only().mean;
    assert_eq!(found.elements[1], MeanElement::Fixed(3.0), "fixed where the model has a start value");
}

#[test]
fn keys_of_the_covariance_replace_keys_whole() {
    let found = under("[covariance]\nfixed = { 'bias, bias' = 0 }\n").only().covariance;
    let mut alone = MODEL.replace("fixed = { \"scale, drift\" = 0 }", "fixed = { 'bias, bias' = 0 }");
    alone.truncate(alone.find("start = [[4").expect("the start values are last"));
    let expected = Spec::parse("model.toml", &alone).expect("the model is whole").only().covariance;
    assert_eq!(found, expected, "as a model with that key instead of its own, without start values");
    assert_ne!(found, model().only().covariance);
}

#[test]
fn a_structure_drops_the_other_keys_but_the_order() {
    let found = under("[covariance]\nstructure = 'full'\n").only();
    let names = found.estimated_names();
    assert_eq!(names, ["scale", "bias", "drift"], "the order of the model");
    let expected = MODEL.replace("fixed = { \"scale, drift\" = 0 }", "");
    let expected = expected.replace("start = [[4, 0, 0], [0, 1, 0], [0, 0, 1]]", "");
    let expected = Spec::parse("model.toml", &expected).expect("the model is whole").only().covariance;
    assert_eq!(found.covariance, expected, "`fixed` of the model is gone");
    let diagonal = under("[covariance]\nstructure = 'diagonal'\n").only().covariance;
    assert_ne!(diagonal, expected);
}

#[test]
fn a_structure_keeps_the_known_part() {
    let known = MODEL.replace("[covariance]\n", "[covariance]\nknown = [[1, 0, 0], [0, 2, 0], [0, 0, 3]]\n");
    let spec = Spec::parse("model.toml", &known.replace("start = [[4, 0, 0], [0, 1, 0], [0, 0, 1]]", "")).unwrap();
    let found = spec.under("[covariance]\nstructure = 'diagonal'\n").unwrap().only().covariance;
    assert_eq!(found.kind, CovarianceKind::Diagonal);
    assert_eq!(found.known, spec.model.shared().covariance.known);
    assert!(found.known.is_some());
}

#[test]
fn tables_that_the_model_has_not_are_added() {
    let bare = "[states]\na = {}\nb = {}\n[measurements.y]\ncolumn = 'y'\nequation = 'a + b * u'\nnoise = 1\n";
    let spec = Spec::parse("model.toml", bare).unwrap();
    let found = spec.under("[mean]\nfixed = { b = 0 }\n[covariance]\nstructure = 'diagonal'\n").unwrap().only();
    let whole = format!("{bare}[mean]\nfixed = {{ b = 0 }}\n[covariance]\nstructure = 'diagonal'\n");
    let expected = Spec::parse("model.toml", &whole).unwrap().only();
    assert_eq!(found, expected);
}

#[test]
fn regressions_keep_the_columns_of_the_model() {
    let columns: Vec<String> = model().only().columns.iter().map(|c| c.name.clone()).collect();
    for (own, expected) in [("['age']", vec!["age"]), ("['age', 'warm']", vec!["age", "warm"])] {
        let found = under(&format!("[mean]\nregression = {{ bias = {own} }}\n")).only();
        let names: Vec<&str> = found.mean.regression.iter().map(|r| columns[r.column].as_str()).collect();
        assert_eq!(names, expected, "{own}");
        assert_eq!(found.columns, model().only().columns);
    }
    assert!(under("[mean]\nregression = {}\n").only().mean.regression.is_empty());
}

#[test]
fn parameters_are_replaced_one_by_one_in_the_order_of_the_model() {
    let found = under("[parameters]\ns = 0.5\ntau = { start = 9 }\n").only().parameters;
    let names: Vec<&str> = found.iter().map(|p| p.name.as_str()).collect();
    assert_eq!(names, ["tau", "s", "noise"]);
    assert_eq!(found[0].value, Value::Free { start: Some(9.0) });
    assert_eq!(found[0].lower, None, "a parameter is replaced whole, its bounds with it");
    assert_eq!(found[1].value, Value::Fixed(0.5));
    assert_eq!(found[2], model().only().parameters[2]);
}

#[test]
fn what_was_set_stays_set_unless_the_hypothesis_speaks_of_it() {
    let mut spec = model();
    for assignment in ["tau=90", "s=0.3", "noise[C]=2"] {
        spec.set(assignment).unwrap();
    }
    let found = spec.under("[parameters]\ns = 0.5\n").unwrap().only();
    assert_eq!(found.parameters[0].value, Value::Fixed(90.0), "set");
    assert_eq!(found.parameters[1].value, Value::Fixed(0.5), "said by the hypothesis");
    assert_eq!(found.parameters[2], spec.model.shared().parameters[2], "a level that was set");
    assert_eq!(found.literals, spec.model.shared().literals);
}

#[test]
fn levels_of_a_parameter_are_those_of_the_model_by_name() {
    let levels = |hypothesis: &str| {
        let found = under(hypothesis).only();
        let level = |(level, value): (&usize, &f64)| (found.literals[*level].clone(), *value);
        let column = found.parameters[2].per.map(|c| found.text_columns[c].name.clone());
        (column.unwrap(), found.parameters[2].fixed_levels.iter().map(level).collect::<Vec<_>>())
    };
    let of = |pairs: &[(&str, f64)]| pairs.iter().map(|(l, v)| ((*l).to_owned(), *v)).collect::<Vec<_>>();
    let (column, found) = levels("[parameters]\nnoise = { per = 'lot', fixed = { B = 1 } }\n");
    assert_eq!((column.as_str(), found), ("lot", of(&[("B", 1.0)])));
    let (_, found) = levels("[parameters]\nnoise = { per = 'lot', fixed = { new = 2, A = 1 } }\n");
    assert_eq!(found, of(&[("A", 1.0), ("new", 2.0)]));
    let (column, _) = levels("[parameters]\nnoise = { per = 'other', fixed = { A = 1 } }\n");
    assert_eq!(column, "other");
}

#[test]
fn a_hypothesis_that_says_nothing_is_refused() {
    insta::assert_snapshot!(refusal(""), @r#"
    the hypothesis has no `mean`
    in the hypothesis at ""
    hint say what to test, in `[mean]` or `[covariance]`
    "#);
    insta::assert_snapshot!(refusal("title = 'nothing'"), @r#"
    the hypothesis has no `mean`
    in the hypothesis at "title = 'nothing'"
    hint say what to test, in `[mean]` or `[covariance]`
    "#);
}

#[test]
fn keys_and_words_that_are_unknown_are_refused_where_they_stand() {
    insta::assert_snapshot!(refusal("[states]\na = {}\n"), @r#"
    unknown key `states` in the hypothesis
    in the hypothesis at "states"
    hint its keys are `title`, `mean`, `covariance`, `levels`, `crossed`, `parameters` or `phases`
    "#);
    insta::assert_snapshot!(refusal("# é\n[covarance]\nfixed = {}\n"), @r#"
    unknown key `covarance` in the hypothesis
    in the hypothesis at "covarance"
    hint did you mean `covariance`?
    "#);
    insta::assert_snapshot!(refusal("# é\n[covariance]\nstructur = 'diagonal'\n"), @r#"
    unknown key `structur` in `[covariance]`
    in the hypothesis at "structur"
    hint did you mean `structure`?
    "#);
    insta::assert_snapshot!(refusal("# é\n[covariance]\nstructure = 'diag'\n"), @r#"
    `structure` of `[covariance]` is `diag`, expected `full`, `diagonal`, `blocks`, `proportional`, `correlation` or `fixed`
    in the hypothesis at "'diag'"
    "#);
    insta::assert_snapshot!(refusal("# é\n[mean]\nfixed = { scal = 0 }\n"), @r#"
    unknown state `scal` in `fixed` of `[mean]`
    in the hypothesis at "scal"
    hint did you mean `scale`?
    "#);
    insta::assert_snapshot!(refusal("# é\n[mean]\nfixed = { scale = 'no' }\n"), @r#"
    `scale` of `fixed` of `[mean]` is a string, expected a number
    in the hypothesis at "'no'"
    "#);
    insta::assert_snapshot!(refusal("title = 3\n[mean]\nfixed = { scale = 0 }\n"), @r#"
    `title` of the hypothesis is a number, expected a string
    in the hypothesis at "3"
    "#);
    insta::assert_snapshot!(refusal("# é\n[covariance]\nfixed = { 'scale, bas' = 0 }\n"), @r#"
    unknown state `bas` in `fixed` of `[covariance]`
    in the hypothesis at "'scale, bas'"
    hint did you mean `bias`?
    "#);
    insta::assert_snapshot!(refusal("# é\n[parameters]\ntua = 3\n"), @r#"
    unknown parameter `tua` in the hypothesis
    in the hypothesis at "tua"
    hint did you mean `tau`?
    "#);
    insta::assert_snapshot!(refusal("# é\n[parameters]\ntau = 0.5\n\n[mean]\nfixed = {}"), @"accepted");
    insta::assert_snapshot!(refusal("# é\n[parameters]\ntau = { start = 50, upper = 40, lower = 1 }\n"), @r#"
    time constant `tau` is 50, expected at most 40, its `upper` bound
    in the hypothesis at "50"
    "#);
    insta::assert_snapshot!(refusal("# é\n[mean]\nregression = { bias = ['warm', 'cold'] }\n"), @r#"
    unknown regression column `cold` in the hypothesis: the model has no regression on it
    in the hypothesis at "'cold'"
    "#);
}

#[test]
fn matrices_of_a_hypothesis_may_have_an_order_of_their_own() {
    let under = |text: &str| model().under(text).map(|found| found.model);
    let own = "[covariance]\norder = ['bias', 'drift', 'scale']\nstructure = 'fixed'\nmatrix = [[1, 2, 3], [2, 50, 6], [3, 6, 900]]\n";
    let same = "[covariance]\nstructure = 'fixed'\nmatrix = [[900, 3, 6], [3, 1, 2], [6, 2, 50]]\n";
    assert_eq!(under(own).unwrap(), under(same).unwrap());
    assert_eq!(under(own).unwrap().estimated_names(), ["scale", "bias", "drift"], "the order of the model");
    insta::assert_snapshot!(refusal("[covariance]\norder = ['bias', 'scale']\nstructure = 'diagonal'\n"), @r#"
    `drift` is missing in `order` of `[covariance]`
    in the hypothesis at "['bias', 'scale']"
    hint the order names every estimated state once
    "#);
    insta::assert_snapshot!(refusal("[covariance]\norder = ['bias', 'scale', 'bias']\nstructure = 'diagonal'\n"), @r#"
    `bias` stands twice in `order` of `[covariance]`
    in the hypothesis at "'bias'"
    "#);
}

#[test]
fn what_is_no_constraint_is_refused() {
    insta::assert_snapshot!(refusal("[covariance]\nknown = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\n"), @r#"
    `known` has no effect in a hypothesis: it is no constraint, and the model's stays
    in the hypothesis at "known"
    "#);
}

#[test]
fn values_that_are_no_tables_are_refused_where_they_stand() {
    insta::assert_snapshot!(refusal("mean = 3"), @r#"
    `mean` of the hypothesis is a number, expected a table
    in the hypothesis at "3"
    "#);
    insta::assert_snapshot!(refusal("covariance = 'diagonal'"), @r#"
    `covariance` of the hypothesis is a string, expected a table
    in the hypothesis at "'diagonal'"
    "#);
    insta::assert_snapshot!(refusal("parameters = []"), @r#"
    `parameters` of the hypothesis is an array, expected a table
    in the hypothesis at "[]"
    "#);
}

#[test]
fn text_that_is_no_toml_is_refused_at_its_place() {
    insta::assert_snapshot!(refusal("# é\n[mean]\nfixed = { scale = 0"), @r#"
    not valid TOML: unclosed inline table, expected `}`
    in the hypothesis at ""
    "#);
    insta::assert_snapshot!(refusal("# é\n[mean]\nfixed = { scale = 0 }\nfixed = { bias = 0 }\n"), @r#"
    not valid TOML: duplicate key
    in the hypothesis at "fixed"
    "#);
    insta::assert_snapshot!(refusal("scale = 0\n= 3"), @r#"
    not valid TOML: unquoted keys cannot be empty, expected letters, numbers, `-`, `_`
    in the hypothesis at ""
    "#);
}

#[test]
fn a_key_of_the_model_that_does_not_go_with_the_hypothesis_is_shown_in_the_model() {
    insta::assert_snapshot!(refusal("[covariance]\nfixed = { 'scale, scale' = -1 }\n"), @r#"
    the variance of `scale` in `fixed` of `[covariance]` is -1, expected 0 or more
    in the hypothesis at "'scale, scale'"
    "#);
    insta::assert_snapshot!(refusal("[mean]\nproportional_to = { bias = 1, scale = 2 }\nfixed = { scale = 1 }\n"), @r#"
    the mean of `scale` is fixed and proportional
    in the hypothesis at "scale"
    "#);
    let tied = MODEL.replace("start = { bias = 3 }", "tied = { bias = \"2 * scale\" }");
    let spec = Spec::parse("model.toml", &tied).unwrap();
    insta::assert_snapshot!(refusal_by(&spec, "[mean]\nfixed = { bias = 1 }\n"), @r#"
    the mean of `bias` is fixed and tied
    in the model at "bias"
    "#);
    let blocks =
        MODEL.replace("fixed = { \"scale, drift\" = 0 }", "structure = \"diagonal\"\nfixed = { \"bias, bias\" = 2 }");
    let spec = Spec::parse("model.toml", &blocks.replace("start = [[4, 0, 0], [0, 1, 0], [0, 0, 1]]", "")).unwrap();
    insta::assert_snapshot!(refusal_by(&spec, "[covariance]\nequal = [['bias, bias', 'scale, scale']]\n"), @r#"
    element `bias, bias` in `equal` is fixed at 2, so it has no value to share
    in the hypothesis at "'bias, bias'"
    "#);
}

#[test]
fn a_hypothesis_that_is_too_large_is_refused() {
    let error = model().under(&format!("# {}", "x".repeat(4 * 1024 * 1024))).unwrap_err();
    let BesideError::File(error) = error else { panic!("{error:?}") };
    assert!(matches!(*error.problem, SpecProblem::TooLarge { .. }), "{error:?}");
    assert_eq!(error.message, "the file has 4194306 bytes, expected at most 4194304");
    let largest = format!("[mean]\nfixed = {{ scale = 0 }}\n#{}", "x".repeat(4 * 1024 * 1024 - 30));
    assert_eq!(largest.len(), 4 * 1024 * 1024);
    assert_eq!(under(&largest).only().mean.elements[0], MeanElement::Fixed(0.0), "the limit is for each file");
}

/// Whatever the two files hold, the place of an error is in the file it names.
fn survives(spec: &Spec, hypothesis: &str) {
    let (text, error) = match spec.under(hypothesis) {
        Ok(found) => {
            let (model, base) = (&found.only(), spec.model.shared());
            assert_eq!(model.estimated, base.estimated, "{hypothesis}");
            assert_eq!(model.columns, base.columns, "{hypothesis}");
            let known = |c: &usize| *c < base.columns.len();
            assert!(model.mean.regression.iter().all(|r| known(&r.column)), "{hypothesis}");
            let levels = model.parameters.iter().flat_map(|p| p.fixed_levels.keys());
            assert!(levels.clone().all(|level| *level < model.literals.len()), "{hypothesis}");
            return;
        }
        Err(BesideError::File(error)) => (hypothesis, error),
        Err(BesideError::Model(error)) => (spec.text.as_str(), error),
    };
    assert!(!error.message.is_empty() && !error.message.ends_with('.'), "{error:?}");
    if let Some(span) = &error.span {
        assert!(text.get(span.clone()).is_some(), "{span:?} is no part of the file: {error}\n{hypothesis}");
    }
}

/// Lines that hypotheses are made of, some of them wrong.
const LINES: [&str; 30] = [
    "title = 'é'",
    "[mean]",
    "[mean.fixed]",
    "fixed = { scale = 0 }",
    "fixed = { bias = 1, drift = 0 }",
    "scale = 0",
    "tied = { bias = 'scale + 1' }",
    "tied = { bias = 'é +' }",
    "proportional_to = { bias = 1, drift = 2 }",
    "start = { bias = 2 }",
    "regression = { bias = ['age'] }",
    "regression = { bias = ['é'] }",
    "[mean.regression]",
    "bias = ['warm']",
    "[covariance]",
    "structure = 'diagonal'",
    "structure = 'proportional'",
    "structure = 'blocks'",
    "blocks = [['scale', 'bias'], ['drift']]",
    "matrix = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]",
    "fixed = { 'scale, scale' = 0 }",
    "equal = [['scale, scale', 'bias, bias']]",
    "order = ['bias', 'scale', 'drift']",
    "[parameters]",
    "tau = { start = 3, lower = 1 }",
    "noise = { per = 'kind', fixed = { A = 1, slow = 2 } }",
    "s = 'é'",
    "[states]",
    "# é",
    "é = 3",
];

proptest! {
    #![proptest_config(ProptestConfig { cases: 1_000, ..ProptestConfig::default() })]

    #[test]
    fn any_text_is_a_hypothesis_or_refused(text in any::<String>()) {
        survives(&model(), &text);
    }

    #[test]
    fn any_lines_are_a_hypothesis_or_refused(lines in prop::collection::vec(prop::sample::select(&LINES[..]), 0..12)) {
        let mut spec = model();
        spec.set("noise[é]=3").expect("a level can be set");
        survives(&spec, &lines.join("\n"));
    }

    #[test]
    fn a_hypothesis_with_a_piece_cut_out_is_read_or_refused(from in 0_usize..200, length in 0_usize..40) {
        let whole = "# é\n[mean]\nfixed = { scale = 0 }\nregression = { bias = ['age'] }\n[covariance]\nstructure = 'diagonal'\n\
                     [parameters]\nnoise = { per = 'lot', fixed = { é = 1, A = 2 } }\n";
        let letters: Vec<char> = whole.chars().collect();
        let (from, to) = (from.min(letters.len()), (from + length).min(letters.len()));
        let rest: String = letters[..from].iter().chain(&letters[to..]).collect();
        survives(&model(), &rest);
    }
}
