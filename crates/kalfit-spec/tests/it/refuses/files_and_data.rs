use super::refusal;

#[test]
fn text_that_is_not_toml() {
    let text = r#"[states
a = {}
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    not valid TOML: unclosed table, expected `]`
    at   ""
    "#);
}

#[test]
fn an_unknown_table() {
    let text = r#"[state]
a = {}
[states]
a = {}
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    unknown key `state` in the model file
    at   "state"
    hint did you mean `states`?
    "#);
}

#[test]
fn a_phase_column() {
    let text = r#"[data]
phase = "leg"
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `phase` has no effect without `[phases]`
    at   "phase"
    "#);
}

#[test]
fn a_title_that_is_no_text() {
    let text = r#"title = 3
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `title` of the model file is a number, expected a string
    at   "3"
    "#);
}

#[test]
fn a_model_without_states() {
    let text = r#"[states]
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    the model has 0 states, expected 1 to 500
    at   "states"
    hint a state is a table in `[states]`, as in `intercept = {}`
    "#);
}

#[test]
fn a_model_without_measurements() {
    let text = r#"[measurements]
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    the model has 0 measurements, expected 1 to 500
    at   "measurements"
    hint a measurement is a table, as in `[measurements.gyro]`
    "#);
}

#[test]
fn an_unknown_key_of_data() {
    let text = r#"[data]
tiem = "t"
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    unknown key `tiem` in `[data]`
    at   "tiem"
    hint did you mean `time`?
    "#);
}

#[test]
fn a_word_with_an_at_sign_that_is_not_file() {
    let text = r#"[data]
test = "@flie"
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `test` of `[data]` is `@flie`, expected `@file`, `@row` or the name of a column
    at   "\"@flie\""
    hint did you mean `@file`?
    "#);
}

#[test]
fn a_time_that_is_no_column() {
    let text = r#"[data]
time = 3
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `time` of `[data]` is a number, expected a string
    at   "3"
    "#);
}

#[test]
fn a_time_unit_without_time() {
    let text = r#"[data]
time_unit = "s"
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `time_unit` has no effect without `time`
    at   "time_unit"
    hint `time` names the column with the time of each row
    "#);
}

#[test]
fn a_number_in_quotes() {
    let text = r#"[data]
time = "t"
initial_time = "0.5"
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `initial_time` of `[data]` is a string, expected a number or the name of a column
    at   "\"0.5\""
    hint write the number without quotes: 0.5
    "#);
}

#[test]
fn an_initial_time_when_nothing_moves() {
    let text = r#"[data]
time = "t"
initial_time = 0
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `initial_time` has no effect when no state moves
    at   "initial_time"
    "#);
}

#[test]
fn a_first_step_when_nothing_moves() {
    let text = r#"[data]
step_first = true
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `step_first` has no effect when no state moves
    at   "step_first"
    "#);
}

#[test]
fn a_first_step_of_unknown_length() {
    let text = r#"[data]
time = "t"
step_first = true
[states.a]
process = "random-walk"
noise_density = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `step_first` gives the first step no length, which the motion of state `a` needs
    at   "step_first"
    hint `initial_time` says when the first step begins
    "#);
}

#[test]
fn a_first_step_whose_dt_is_unknown() {
    let text = r#"[data]
time = "t"
step_first = true
[states.a]
next = "a * exp(-dt)"
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `step_first` gives the first step no length, which the motion of state `a` needs
    at   "step_first"
    hint `initial_time` says when the first step begins
    "#);
}

#[test]
fn a_first_step_said_twice() {
    let text = r#"[data]
time = "t"
step_first = true
initial_time = 0
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `step_first` has no effect beside `initial_time`
    at   "step_first"
    hint with `initial_time` a step from x_0 precedes the first row anyway
    "#);
}

#[test]
fn an_unknown_word_for_inputs() {
    let text = r#"[data]
inputs = "previos"
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `inputs` of `[data]` is `previos`, expected `previous` or `current`
    at   "\"previos\""
    hint did you mean `previous`?
    "#);
}

#[test]
fn previous_inputs_without_inputs() {
    let text = r#"[data]
inputs = "previous"
[states.a]
next = "0.5 * a"
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `inputs` has no effect when no motion uses a column
    at   "inputs"
    "#);
}

#[test]
fn missing_values_that_are_no_texts() {
    let text = r#"[data]
missing = ["x", -99]
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `missing` of `[data]` is a number, expected an array of strings
    at   "-99"
    "#);
}

#[test]
fn a_date_where_a_column_stands() {
    let text = r#"[data]
group = 2024-01-01
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `group` of `[data]` is a date or time, expected a string
    at   "2024-01-01"
    "#);
}
