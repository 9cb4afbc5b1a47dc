use super::refusal;

#[test]
fn a_measurement_without_a_column() {
    let text = r#"[measurements.y]
equation = "a"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    measurement `y` has no `column`
    at   "[measurements.y]"
    "#);
}

#[test]
fn a_noise_and_a_variance() {
    let text = r#"[measurements.y]
column = "y"
equation = "a"
noise = 1
variance = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    measurement `y` has both `noise` and `variance`, expected one of them
    at   "variance"
    "#);
}

#[test]
fn a_measurement_without_noise() {
    let text = r#"[measurements.y]
column = "y"
equation = "a"
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    measurement `y` has neither `noise` nor `variance`, expected one of them
    at   "[measurements.y]"
    hint `noise` is a standard deviation, `variance` its square; 0 is legal
    "#);
}

#[test]
fn a_negative_noise() {
    let text = r#"[measurements.y]
column = "y"
equation = "a"
noise = "-0.1"
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `noise` of measurement `y` is -0.1, expected 0 or more
    at   "\"-0.1\""
    "#);
}

#[test]
fn a_negative_variance() {
    let text = r#"[measurements.y]
column = "y"
equation = "a"
variance = -2
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `variance` of measurement `y` is -2, expected 0 or more
    at   "-2"
    "#);
}

#[test]
fn a_cell_that_is_measured_twice() {
    let text = r#"[measurements.y1]
column = "y"
equation = "a"
noise = 1
[measurements.y2]
column = "y"
equation = "b"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    measurements `y1` and `y2` both read every row of column `y`
    at   "\"y\""
    hint `where` says which rows a measurement is read from
    "#);
}

#[test]
fn a_row_selection_that_selects_all() {
    let text = r#"[measurements.y]
column = "y"
where = "1 < 2"
equation = "a"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `where` has no effect because it is always true
    at   "where"
    "#);
}

#[test]
fn a_comma_in_a_measurement_name() {
    let text = r#"[measurements."y,z"]
column = "y"
equation = "a"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `y,z` cannot be the name of a measurement: commas, quotes and control characters are not allowed
    at   "\"y,z\""
    "#);
}

#[test]
fn a_covariance_with_an_unknown_measurement() {
    let text = r#"[measurements]
y1 = { column = "y1", equation = "a", noise = 1 }
y2 = { column = "y2", equation = "b", noise = 2 }
y3 = { column = "y3", equation = "b", noise = 0 }
[noise_covariance]
"y1, y4" = 0.1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    unknown measurement `y4` in `[noise_covariance]`
    at   "\"y1, y4\""
    hint did you mean `y1`?
    "#);
}

#[test]
fn a_covariance_of_a_noise_with_itself() {
    let text = r#"[measurements]
y1 = { column = "y1", equation = "a", noise = 1 }
y2 = { column = "y2", equation = "b", noise = 2 }
y3 = { column = "y3", equation = "b", noise = 0 }
[noise_covariance]
"y1, y1" = 0.1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `y1, y1` in `[noise_covariance]` is a variance, expected two different names
    at   "\"y1, y1\""
    hint the noise of a measurement by itself is given in its own table
    "#);
}

#[test]
fn a_covariance_given_twice() {
    let text = r#"[measurements]
y1 = { column = "y1", equation = "a", noise = 1 }
y2 = { column = "y2", equation = "b", noise = 2 }
y3 = { column = "y3", equation = "b", noise = 0 }
[noise_covariance]
"y1, y2" = 0.1
"y2,y1" = 0.2
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    element `y2, y1` is given twice in `[noise_covariance]`: 0.1 and 0.2
    at   "\"y2,y1\""
    "#);
}

#[test]
fn a_covariance_beyond_the_variances() {
    let text = r#"[measurements]
y1 = { column = "y1", equation = "a", noise = 1 }
y2 = { column = "y2", equation = "b", noise = 2 }
y3 = { column = "y3", equation = "b", noise = 0 }
[noise_covariance]
"y1, y2" = 3
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    the correlation of `y1` and `y2` in `[noise_covariance]` is 1.5000, expected -1 to 1
    at   "\"y1, y2\""
    "#);
}

#[test]
fn a_covariance_of_a_noise_of_zero() {
    let text = r#"[measurements]
y1 = { column = "y1", equation = "a", noise = 1 }
y2 = { column = "y2", equation = "b", noise = 2 }
y3 = { column = "y3", equation = "b", noise = 0 }
[noise_covariance]
"y1, y3" = 0.1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    the covariance of `y3` and `y1` in `[noise_covariance]` is not 0, but the variance of `y3` is
    at   "\"y1, y3\""
    "#);
}

#[test]
fn a_covariance_of_three() {
    let text = r#"[measurements]
y1 = { column = "y1", equation = "a", noise = 1 }
y2 = { column = "y2", equation = "b", noise = 2 }
y3 = { column = "y3", equation = "b", noise = 0 }
[noise_covariance]
"y1, y2, y3" = 0.1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `y1, y2, y3` in `[noise_covariance]` is not an element, expected two names as in `a, b`
    at   "\"y1, y2, y3\""
    "#);
}

#[test]
fn process_noises_that_cannot_be_together() {
    let text = r#"[states]
a = { next = "a", step_noise = 1 }
b = { next = "b", step_noise = 1 }
c = { next = "c", step_noise = 1 }
d = {}
[process_noise_covariance]
"a, b" = 0.9
"b, c" = 0.9
"a, c" = -0.9
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `[process_noise_covariance]` is not positive semidefinite: scaled to unit diagonal, its smallest eigenvalue is -8.000e-1, its largest 1.900e0
    at   "process_noise_covariance"
    hint every pair is possible by itself, but not all together
    "#);
}

#[test]
fn a_covariance_of_a_state_without_noise() {
    let text = r#"[states]
a = { next = "a", step_noise = 1 }
b = { next = "b", step_noise = 1 }
c = { next = "c", step_noise = 1 }
d = {}
[process_noise_covariance]
"a, d" = 0.1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    the covariance of `d` and `a` in `[process_noise_covariance]` is not 0, but the variance of `d` is
    at   "\"a, d\""
    hint state `d` has no noise
    "#);
}

#[test]
fn a_covariance_with_an_unknown_state() {
    let text = r#"[states]
a = { next = "a", step_noise = 1 }
b = { next = "b", step_noise = 1 }
c = { next = "c", step_noise = 1 }
d = {}
[process_noise_covariance]
"a, cc" = 0.1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    unknown state `cc` in `[process_noise_covariance]`
    at   "\"a, cc\""
    hint did you mean `c`?
    "#);
}

#[test]
fn a_covariance_between_a_step_and_a_rate() {
    let text = r#"[data]
time = "t"
[states]
a = { next = "a", step_noise = 1 }
b = { derivative = "-b", noise_density = 1 }
[process_noise_covariance]
"a, b" = 0.1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    the noise of `b` is per unit of time and that of `a` per step, so they have no covariance
    at   "\"a, b\""
    "#);
}

#[test]
fn a_covariance_of_a_noise_that_drives_the_hidden_rate() {
    let text = r#"[data]
time = "t"
[states]
a = { process = "gauss-markov-2", time_constant = 3, sigma = 1 }
b = { derivative = "-b", noise_density = 1 }
[process_noise_covariance]
"a, b" = 0.1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    the covariance of `a` and `b` in `[process_noise_covariance]` is not 0, but the variance of `a` is
    at   "\"a, b\""
    hint the noise of this process drives its hidden state `a (rate)`
    "#);
}
