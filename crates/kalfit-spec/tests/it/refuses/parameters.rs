use super::refusal;

#[test]
fn a_parameter_that_nothing_uses() {
    let text = r#"[parameters]
s = 3
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    parameter `s` is not used
    at   "s"
    "#);
}

#[test]
fn a_parameter_that_a_typo_made_unused() {
    let text = r#"[measurements.y]
column = "y"
equation = "a"
noise = "sgima"
[parameters]
sigma = {}
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    parameter `sigma` is not used
    at   "sigma"
    hint `noise` of measurement `y` names `sgima`, which is then a column of the data
    "#);
}

#[test]
fn a_value_and_a_start() {
    let text = r#"[measurements.y]
column = "y"
equation = "a"
noise = "s"
[parameters]
s = { value = 1, start = 2 }
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    parameter `s` has both `value` and `start`, expected one of them
    at   "2"
    hint `value` fixes a parameter, `start` leaves it free
    "#);
}

#[test]
fn fixed_levels_without_per() {
    let text = r#"[measurements.y]
column = "y"
equation = "a"
noise = "s"
[parameters]
s = { fixed = { A = 1 } }
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `fixed` has no effect without `per`
    at   "fixed"
    hint `per` names the column whose levels have a value each; `value` fixes a parameter as a whole
    "#);
}

#[test]
fn levels_of_one_value() {
    let text = r#"[measurements.y]
column = "y"
equation = "a"
noise = "s"
[parameters]
s = { value = 1, per = "lot" }
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `per` has no effect on a parameter whose levels all have the same `value`
    at   "per"
    "#);
}

#[test]
fn a_start_beyond_a_bound() {
    let text = r#"[measurements.y]
column = "y"
equation = "a"
noise = "s"
[parameters]
s = { start = 3, upper = 2 }
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    standard deviation `s` is 3, expected at most 2, its `upper` bound
    at   "3"
    "#);
}

#[test]
fn bounds_in_the_wrong_order() {
    let text = r#"[measurements.y]
column = "y"
equation = "a"
noise = "s"
[parameters]
s = { lower = 3, upper = 2 }
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `upper` of standard deviation `s` is 2, expected more than `lower`, which is 3
    at   "2"
    "#);
}

#[test]
fn a_negative_bound_of_a_standard_deviation() {
    let text = r#"[measurements.y]
column = "y"
equation = "a"
noise = "s"
[parameters]
s = { lower = -1 }
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `lower` of standard deviation `s` is -1, expected 0 or more
    at   "-1"
    "#);
}

#[test]
fn a_start_of_zero_for_a_standard_deviation() {
    let text = r#"[measurements.y]
column = "y"
equation = "a"
noise = "s"
[parameters]
s = { start = 0 }
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    start of standard deviation `s` is 0, expected more than 0
    at   "0"
    hint to fix it at 0, write `value = 0`
    "#);
}

#[test]
fn a_negative_standard_deviation() {
    let text = r#"[measurements.y]
column = "y"
equation = "a"
noise = "s"
[parameters]
s = -0.5
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    standard deviation `s` is -0.5, expected 0 or more
    at   "-0.5"
    "#);
}

#[test]
fn a_negative_level() {
    let text = r#"[measurements.y]
column = "y"
equation = "a"
noise = "s"
[parameters]
s = { per = "lot", fixed = { A = 1, B = -1 } }
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    standard deviation `s` is -1, expected 0 or more
    at   "-1"
    "#);
}

#[test]
fn a_time_constant_of_zero() {
    let text = r#"[data]
time = "t"
[states.a]
process = "gauss-markov"
time_constant = "tau"
sigma = 1
[parameters]
tau = 0
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    time constant `tau` is 0, expected more than 0
    at   "0"
    "#);
}

#[test]
fn a_parameter_that_is_a_text() {
    let text = r#"[measurements.y]
column = "y"
equation = "a"
noise = "s"
[parameters]
s = "3"
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `s` of `[parameters]` is a string, expected a number or a table such as `{ start = 1 }`
    at   "\"3\""
    "#);
}

#[test]
fn a_parameter_that_is_infinite() {
    let text = r#"[measurements.y]
column = "y"
equation = "a"
noise = "s"
[parameters]
s = inf
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `s` of `[parameters]` is inf, expected a finite number
    at   "inf"
    "#);
}

#[test]
fn a_parameter_that_is_not_a_number() {
    let text = r#"[measurements.y]
column = "y"
equation = "a"
noise = "s"
[parameters]
s = { start = nan }
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `start` of parameter `s` is nan, expected a finite number
    at   "nan"
    "#);
}

#[test]
fn a_parameter_with_the_name_of_a_function() {
    let text = r#"[parameters]
max = 3
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `max` cannot be the name of a parameter: it is a word of the expression language
    at   "max"
    "#);
}

#[test]
fn a_misspelt_key_of_a_parameter() {
    let text = r#"[measurements.y]
column = "y"
equation = "a"
noise = "s"
[parameters]
s = { strat = 3 }
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    unknown key `strat` in parameter `s`
    at   "strat"
    hint did you mean `start`?
    "#);
}

#[test]
fn a_level_parameter_in_the_population() {
    let text = r#"[covariance]
structure = "correlation"
matrix = [[1, "r"], ["r", 1]]
[parameters]
r = { per = "lot" }
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    parameter `r` has a value per `lot`, but `matrix` of `[covariance]` is common to all tests
    at   "r"
    "#);
}
