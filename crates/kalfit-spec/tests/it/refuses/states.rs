use super::{refusal, refusal_in_one_line};

#[test]
fn an_unknown_process() {
    let text = r#"[states.a]
process = "gaus-markov"
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `process` of state `a` is `gaus-markov`, expected `constant`, `random-walk`, `gauss-markov`, `gauss-markov-2` or `integral`
    at   "\"gaus-markov\""
    hint did you mean `gauss-markov`?
    "#);
}

#[test]
fn a_steady_state_of_a_random_walk() {
    let text = r#"[states.a]
process = "random-walk"
step_noise = 1
sigma = 2
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `sigma` has no effect on a random walk
    at   "sigma"
    hint it takes `noise_density` or `step_noise`
    "#);
}

#[test]
fn a_sigma_without_a_process() {
    let text = r#"[states.a]
sigma = 2
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `sigma` has no effect on a constant
    at   "sigma"
    hint write `process = "gauss-markov"`
    "#);
}

#[test]
fn a_noise_density_without_a_process() {
    let text = r#"[data]
time = "t"
[states.a]
noise_density = 2
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `noise_density` has no effect on a constant
    at   "noise_density"
    hint write `process = "random-walk"`
    "#);
}

#[test]
fn a_derivative_and_a_next_value() {
    let text = r#"[states.a]
derivative = "0"
next = "a"
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    state `a` has both `derivative` and `next`, expected one of them
    at   "next"
    "#);
}

#[test]
fn a_process_and_an_equation() {
    let text = r#"[states.a]
process = "constant"
next = "a"
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    state `a` has both `process` and `next`, expected one of them
    at   "next"
    "#);
}

#[test]
fn a_noise_density_of_a_step() {
    let text = r#"[states.a]
next = "a"
noise_density = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `noise_density` has no effect beside `next`
    at   "noise_density"
    hint the noise of a step is `step_noise`
    "#);
}

#[test]
fn a_step_noise_of_a_derivative() {
    let text = r#"[data]
time = "t"
[states.a]
derivative = "-a"
step_noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `step_noise` has no effect beside `derivative`
    at   "step_noise"
    hint white noise that drives a derivative is `noise_density`
    "#);
}

#[test]
fn a_noise_of_an_integral() {
    let text = r#"[data]
time = "t"
[states]
b = {}
[states.a]
process = "integral"
of = "b"
noise_density = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `noise_density` has no effect on an integral
    at   "noise_density"
    hint it takes `of`; an integral with noise is written `derivative = …` with `noise_density`
    "#);
}

#[test]
fn continuous_time_without_time() {
    let text = r#"[states.a]
process = "gauss-markov"
time_constant = 3
sigma = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    state `a` moves in continuous time, which needs `time` in `[data]`
    at   "\"gauss-markov\""
    hint `time` names the column with the time of each row; `next` and `step_noise` need no time
    "#);
}

#[test]
fn a_derivative_without_time() {
    let text = r#"[states.a]
derivative = "-a"
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    state `a` moves in continuous time, which needs `time` in `[data]`
    at   "derivative"
    hint `time` names the column with the time of each row; `next` and `step_noise` need no time
    "#);
}

#[test]
fn a_random_walk_that_does_not_walk() {
    let text = r#"[states.a]
process = "random-walk"
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    state `a` has neither `noise_density` nor `step_noise`, expected one of them
    at   "[states.a]"
    hint `noise_density` is per square root of the time unit, `step_noise` per step
    "#);
}

#[test]
fn a_random_walk_with_two_noises() {
    let text = r#"[states.a]
process = "random-walk"
noise_density = 1
step_noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    state `a` has both `noise_density` and `step_noise`, expected one of them
    at   "step_noise"
    "#);
}

#[test]
fn a_gauss_markov_process_without_sigma() {
    let text = r#"[data]
time = "t"
[states.a]
process = "gauss-markov"
time_constant = 3
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    state `a` has no `sigma`
    at   "[states.a]"
    "#);
}

#[test]
fn a_time_constant_of_zero() {
    let text = r#"[data]
time = "t"
[states.a]
process = "gauss-markov"
time_constant = "2 - 2"
sigma = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `time_constant` of state `a` is 0, expected more than 0
    at   "\"2 - 2\""
    "#);
}

#[test]
fn a_negative_standard_deviation() {
    let text = r#"[states.a]
next = "a"
step_noise = -0.5
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `step_noise` of state `a` is -0.5, expected 0 or more
    at   "-0.5"
    "#);
}

#[test]
fn a_standard_deviation_whose_square_is_too_large() {
    let text = r#"[states.a]
next = "a"
step_noise = 1e200
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    the value is not a finite number
    at   "1e200"
    "#);
}

#[test]
fn an_unknown_start() {
    let text = r#"[states.a]
initial = "stationery"
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `initial` of state `a` is `stationery`, expected `estimated` or `stationary`
    at   "\"stationery\""
    hint did you mean `stationary`?
    "#);
}

#[test]
fn a_start_that_is_a_number() {
    let text = r#"[states.a]
initial = 0
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `initial` of state `a` is a number, expected `"estimated"`, `"stationary"` or `{ mean = …, sigma = … }`
    at   "0"
    "#);
}

#[test]
fn a_known_start_without_spread() {
    let text = r#"[states.a]
initial = { mean = 3 }
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `initial` of state `a` has no `sigma`
    at   "{ mean = 3 }"
    hint write `sigma = 0` when the start is known exactly, `initial = "estimated"` when its spread is to be found
    "#);
}

#[test]
fn a_known_start_without_mean() {
    let text = r#"[states.a]
initial = { sigma = 3 }
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `initial` of state `a` has no `mean`
    at   "{ sigma = 3 }"
    hint write `mean = 0` when the known mean is 0
    "#);
}

#[test]
fn a_stationary_constant() {
    let text = r#"[states.a]
initial = "stationary"
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    state `a` has no stationary distribution: a constant keeps the value it starts with
    at   "\"stationary\""
    "#);
}

#[test]
fn a_stationary_random_walk() {
    let text = r#"[states.a]
process = "random-walk"
step_noise = 1
initial = "stationary"
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    state `a` has no stationary distribution: the variance of a random walk grows without bound
    at   "\"stationary\""
    "#);
}

#[test]
fn a_stationary_state_driven_by_one_that_is_not() {
    let text = r#"[states]
b = {}
[states.a]
next = "0.5 * a + b"
initial = "stationary"
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    state `a` has no stationary distribution: it moves with state `b`, whose start is estimated
    at   "\"stationary\""
    "#);
}

#[test]
fn an_offset_of_a_known_start() {
    let text = r#"[states.a]
initial = { mean = 0, sigma = 1 }
offset = "c"
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `offset` has no effect on a state whose start is not estimated (known)
    at   "offset"
    "#);
}

#[test]
fn randomness_of_a_known_start() {
    let text = r#"[states.a]
initial = { mean = 0, sigma = 1 }
random = false
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `random` has no effect on a state whose start is not estimated (known)
    at   "random"
    "#);
}

#[test]
fn randomness_that_is_a_word() {
    let text = r#"[states.a]
random = "no"
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `random` of state `a` is a string, expected `true` or `false`
    at   "\"no\""
    "#);
}

#[test]
fn each_line_of_states_is_refused_with_its_message() {
    let rows = [
        (
            "a state with the name of a word",
            "dt = {}",
            r#"`dt` cannot be the name of a state: it is a word of the expression language | at "dt""#,
        ),
        (
            "a state with a space in its name",
            r#""scale x" = {}"#,
            r#"`scale x` cannot be the name of a state: only letters, digits and `_` can stand in expressions, and a digit cannot come first | at "\"scale x\"""#,
        ),
        (
            "a state that is no table",
            r#"a = "constant""#,
            r#"`a` of `[states]` is a string, expected a table | at "\"constant\"""#,
        ),
    ];
    for (what, line, message) in rows {
        assert_eq!(refusal_in_one_line(&format!("[states]\n{line}\n")), message, "{what}");
    }
}

#[test]
fn a_state_with_the_name_of_a_parameter() {
    let text = r#"[states]
a = {}
[parameters]
a = 3
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `a` is the name of a state and of a parameter
    at   "a"
    "#);
}

#[test]
fn an_unknown_key_of_a_state() {
    let text = r#"[states.a]
procces = "constant"
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    unknown key `procces` in state `a`
    at   "procces"
    hint did you mean `process`?
    "#);
}
