use super::refusal;

/// Message about `levels = …` beside what else `[data]` says.
fn data(rest: &str) -> String {
    refusal(&format!("[data]\n{rest}\n"))
}

/// Message about tables of a model whose tests stand in lots and serials.
fn in_groups(rest: &str) -> String {
    refusal(&format!("[data]\ntest = \"run\"\nlevels = [\"lot\", \"serial\"]\n{rest}\n"))
}

#[test]
fn levels_of_no_tests() {
    insta::assert_snapshot!(data("levels = [\"lot\"]"), @r#"
    `levels` has no effect without `test`
    at   "levels"
    hint all rows are one test then: `test` names the column that tells tests apart
    "#);
}

#[test]
fn no_levels_at_all() {
    insta::assert_snapshot!(data("test = \"run\"\nlevels = []"), @r#"
    the model has 0 levels of groups, expected 1 to 10
    at   "[]"
    hint without groups leave `levels` out; with them, as in `levels = ["unit"]`
    "#);
}

#[test]
fn one_name_that_is_no_array() {
    insta::assert_snapshot!(data("test = \"run\"\nlevels = \"lot\""), @r#"
    `levels` of `[data]` is a string, expected an array of strings
    at   "\"lot\""
    "#);
}

#[test]
fn more_levels_than_there_can_be() {
    let names: Vec<String> = (0..11).map(|k| format!("'c{k}'")).collect();
    let list = format!("[{}]", names.join(", "));
    let found = data(&format!("test = \"run\"\nlevels = {list}"));
    insta::assert_snapshot!(found, @r#"
    the model has 11 levels of groups, expected 1 to 10
    at   "['c0', 'c1', 'c2', 'c3', 'c4', 'c5', 'c6', 'c7', 'c8', 'c9', 'c10']"
    hint without groups leave `levels` out; with them, as in `levels = ["unit"]`
    "#);
}

#[test]
fn a_level_twice() {
    insta::assert_snapshot!(data("test = \"run\"\nlevels = [\"lot\", \"lot\"]"), @r#"
    `lot` stands twice in `levels` of `[data]`
    at   "\"lot\""
    "#);
}

#[test]
fn the_column_of_tests_as_a_level() {
    insta::assert_snapshot!(data("test = \"run\"\nlevels = [\"lot\", \"run\"]"), @r#"
    column `run` tells tests apart, so it cannot be a level of groups of them
    at   "\"run\""
    hint a level is a column of what has several tests, such as the unit that is tested
    "#);
}

#[test]
fn files_as_a_level() {
    insta::assert_snapshot!(data("test = \"run\"\nlevels = [\"@file\"]"), @r#"
    `levels` of `[data]` is `@file`, expected the names of columns
    at   "\"@file\""
    "#);
}

#[test]
fn levels_beside_phases() {
    let text = r#"[data]
test = "run"
levels = ["lot"]
phase = "leg"
[phases.a.states]
a = {}
[phases.a.measurements.y]
column = "y"
equation = "a"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `levels` of `[data]` does not go with `[phases]`
    at   "levels"
    hint take `levels` or `[phases]` out: tests in groups have one phase and the optimal filter
    "#);
}

#[test]
fn levels_beside_a_filter() {
    let text = r#"[filter]
kind = "kalman-schmidt"
covariance = [[1, 0], [0, 1]]
"#;
    insta::assert_snapshot!(in_groups(text), @r#"
    `levels` of `[data]` does not go with `[filter]`
    at   "levels"
    hint take `levels` or `[filter]` out: tests in groups have one phase and the optimal filter
    "#);
}

#[test]
fn a_table_of_levels_without_columns() {
    insta::assert_snapshot!(refusal("[levels.lot.covariance]\nstructure = \"diagonal\"\n"), @r#"
    `[levels]` has no effect without `levels` in `[data]`
    at   "levels"
    hint `levels` there names the columns of groups, as in `levels = ["unit"]`
    "#);
}

#[test]
fn a_table_of_no_level() {
    insta::assert_snapshot!(in_groups("[levels.serail.covariance]"), @r#"
    unknown level `serail` in `[levels]`
    at   "serail"
    hint did you mean `serial`?
    "#);
    insta::assert_snapshot!(in_groups("[levels.batch.covariance]"), @r#"
    unknown level `batch` in `[levels]`
    at   "batch"
    hint `levels` of `[data]` names `lot` or `serial`
    "#);
}

#[test]
fn levels_that_are_no_table() {
    insta::assert_snapshot!(in_groups("[levels]\nlot = 1"), @r#"
    `lot` of `[levels]` is a number, expected a table
    at   "1"
    "#);
}

#[test]
fn an_unknown_key_of_a_level() {
    insta::assert_snapshot!(in_groups("[levels.lot.mean]\nfixed = { a = 0 }"), @r#"
    unknown key `mean` in `[levels.lot]`
    at   "mean"
    hint its keys are `covariance`
    "#);
    insta::assert_snapshot!(in_groups("[levels.lot.covariance]\nstate = [\"a\"]"), @r#"
    unknown key `state` in `[levels.lot.covariance]`
    at   "state"
    hint did you mean `states`?
    "#);
}

#[test]
fn an_order_of_a_level() {
    insta::assert_snapshot!(in_groups("[levels.lot.covariance]\norder = [\"b\", \"a\"]"), @r#"
    unknown key `order` in `[levels.lot.covariance]`
    at   "order"
    hint at every level the states have the order of `[covariance]`
    "#);
}

#[test]
fn a_known_covariance_of_a_level() {
    insta::assert_snapshot!(in_groups("[levels.lot.covariance]\nknown = [[1, 0], [0, 1]]"), @r#"
    unknown key `known` in `[levels.lot.covariance]`
    at   "known"
    hint known covariance is that of tests: it stands in `[covariance]`
    "#);
}

#[test]
fn states_without_levels() {
    insta::assert_snapshot!(refusal("[covariance]\nstates = [\"a\"]\n"), @r#"
    `states` has no effect without `levels` in `[data]`
    at   "states"
    hint `random = false` of a state says that it has one value common to all tests
    "#);
}

#[test]
fn states_that_there_are_not() {
    insta::assert_snapshot!(in_groups("[levels.lot.covariance]\nstates = [\"a\", \"c\"]"), @r#"
    unknown state `c` in `states` of `[levels.lot.covariance]`
    at   "\"c\""
    "#);
}

#[test]
fn a_state_that_is_not_estimated() {
    let text = r#"[states]
a = {}
b = { initial = { mean = 0, sigma = 1 } }
[levels.lot.covariance]
states = ["b"]
"#;
    insta::assert_snapshot!(in_groups(text), @r#"
    state `b` in `states` of `[levels.lot.covariance]` is not estimated: its start is known
    at   "\"b\""
    "#);
}

#[test]
fn a_state_twice() {
    insta::assert_snapshot!(in_groups("[covariance]\nstates = [\"a\", \"a\"]"), @r#"
    `a` stands twice in `states` of `[covariance]`
    at   "\"a\""
    "#);
}

#[test]
fn a_state_with_one_value_for_all() {
    let text = r#"[states]
a = {}
b = { random = false }
[levels.lot.covariance]
states = ["a", "b"]
"#;
    insta::assert_snapshot!(in_groups(text), @r#"
    state `b` in `states` of `[levels.lot.covariance]` has `random = false`, so it does not vary
    at   "\"b\""
    "#);
}

#[test]
fn a_variance_of_what_does_not_vary() {
    insta::assert_snapshot!(in_groups("[levels.serial.covariance]\nstates = [\"a\"]\nfixed = { \"b, b\" = 2 }"), @r#"
    state `b` is not among `states` of `[levels.serial.covariance]`, but its variance in `fixed` of `[levels.serial.covariance]` is not 0
    at   "\"b, b\""
    "#);
    let matrix = "[levels.'no. 1'.covariance]\nstructure = \"fixed\"\nstates = [\"a\"]\nmatrix = [[1, 0], [0, 1]]";
    let text = format!("[data]\ntest = \"@file\"\nlevels = [\"no. 1\"]\n{matrix}\n");
    insta::assert_snapshot!(refusal(&text), @r#"
    state `b` is not among `states` of `[levels."no. 1".covariance]`, but its variance in `matrix` of `[levels."no. 1".covariance]` is not 0
    at   "1"
    "#);
    let start = "[levels.lot.covariance]\nstates = [\"a\"]\nstart = [[1, 0], [0, 1]]";
    insta::assert_snapshot!(in_groups(start), @r#"
    `start` has 1 for element `b, b`, but it is fixed at 0
    at   "1"
    "#);
}

#[test]
fn a_correlation_of_what_does_not_vary() {
    let text = "[covariance]\nstates = [\"b\"]\nstructure = \"correlation\"\nmatrix = [[1, 0.5], [0.5, 1]]";
    insta::assert_snapshot!(in_groups(text), @r#"
    state `a` is not among `states` of `[covariance]`, but its covariance in `matrix` of `[covariance]` is not 0
    at   "0.5"
    "#);
}

#[test]
fn a_variance_that_is_common_whatever_is_listed() {
    let text = r#"[states]
a = {}
b = { random = false }
[levels.lot.covariance]
states = ["a"]
fixed = { "b, b" = 1 }
"#;
    insta::assert_snapshot!(in_groups(text), @r#"
    state `b` has `random = false`, but its variance in `fixed` of `[levels.lot.covariance]` is not 0
    at   "\"b, b\""
    "#);
}

#[test]
fn a_value_per_column_in_a_level() {
    let text = r#"[parameters]
v = { per = "kind" }
[levels.lot.covariance]
structure = "fixed"
matrix = [["v", 0], [0, 1]]
"#;
    insta::assert_snapshot!(in_groups(text), @r#"
    parameter `v` has a value per `kind`, but `matrix` of `[levels.lot.covariance]` is common to all tests
    at   "v"
    "#);
}

#[test]
fn a_scale_that_is_negative() {
    let text = r#"[parameters]
v = -1
[levels.lot.covariance]
structure = "fixed"
matrix = [["v", 0], [0, 1]]
"#;
    insta::assert_snapshot!(in_groups(text), @r#"
    noise variance `v` is -1, expected 0 or more
    at   "-1"
    "#);
}

#[test]
fn groups_of_tests_whose_states_are_all_known() {
    for key in ["levels", "crossed"] {
        let found =
            data(&format!("test = \"run\"\n{key} = [\"lot\"]\n[states.a]\ninitial = {{ mean = 0, sigma = 1 }}"));
        let expected =
            format!("`{key}` has no effect where no initial state is estimated\nat   \"{key}\"\nhint groups differ");
        assert!(found.starts_with(&expected), "{found}");
    }
}
