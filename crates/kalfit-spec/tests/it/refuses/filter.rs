//! Filters that are not optimal.

use super::refusal as complete;

const KIND: &str = "kind = 'kalman-schmidt'\n";
const PRIOR: &str = "covariance = [[1, 0], [0, 2]]\n";

/// The message about a model of two constants and a filter.
fn refusal(filter: &str) -> String {
    complete(&format!("[filter]\n{filter}"))
}

#[test]
fn a_whole_filter_is_accepted() {
    insta::assert_snapshot!(refusal(&format!("{KIND}{PRIOR}")), @"accepted");
}

#[test]
fn a_filter_without_its_kind() {
    insta::assert_snapshot!(refusal(PRIOR), @r#"
    `[filter]` has no `kind`
    at   "[filter]"
    "#);
    insta::assert_snapshot!(refusal(&format!("kind = 'kalman-schmitt'\n{PRIOR}")), @r#"
    `kind` of `[filter]` is `kalman-schmitt`, expected `kalman-schmidt`
    at   "'kalman-schmitt'"
    hint did you mean `kalman-schmidt`?
    "#);
}

#[test]
fn an_unknown_key_of_a_filter() {
    insta::assert_snapshot!(refusal(&format!("{KIND}{PRIOR}consdier = ['a']\n")), @r#"
    unknown key `consdier` in `[filter]`
    at   "consdier"
    hint did you mean `consider`?
    "#);
}

#[test]
fn a_filter_without_a_prior() {
    insta::assert_snapshot!(refusal(KIND), @r#"
    `[filter]` has no `covariance`
    at   "[filter]"
    hint the filter's own prior: a row and a column for every state, in the order a, b
    "#);
}

#[test]
fn a_prior_of_the_wrong_size() {
    insta::assert_snapshot!(refusal(&format!("{KIND}covariance = [[1]]\n")), @r#"
    `covariance` of `[filter]` has 1 row, expected 2
    at   "[[1]]"
    hint a row and a column for every state, in the order a, b
    "#);
    insta::assert_snapshot!(refusal(&format!("{KIND}covariance = [[1, 0], [0]]\n")), @r#"
    `covariance` of `[filter]` has 1 entry in row 2, expected 2
    at   "[0]"
    hint a row and a column for every state, in the order a, b
    "#);
    let hidden =
        "[data]\ntime = 't'\n[states]\na = {}\nb = { process = 'gauss-markov-2', time_constant = 1, sigma = 1 }\n";
    insta::assert_snapshot!(complete(&format!("{hidden}[filter]\n{KIND}{PRIOR}")), @r#"
    `covariance` of `[filter]` has 2 rows, expected 3
    at   "[[1, 0], [0, 2]]"
    hint a row and a column for every state, in the order a, b, b (rate)
    "#);
    let states: String = (0..20).map(|i| format!("s{i} = {{}}\n")).collect();
    insta::assert_snapshot!(complete(&format!("[filter]\n{KIND}{PRIOR}[states]\na = {{}}\n{states}")), @r#"
    `covariance` of `[filter]` has 2 rows, expected 21
    at   "[[1, 0], [0, 2]]"
    hint a row and a column for each of all 21 states, in file order
    "#);
}

#[test]
fn a_prior_that_is_no_covariance() {
    insta::assert_snapshot!(refusal(&format!("{KIND}covariance = [[1, 0.5], [0, 2]]\n")), @r#"
    `covariance` of `[filter]` is not symmetric: the entries of `a, b` differ
    at   "0"
    "#);
    insta::assert_snapshot!(refusal(&format!("{KIND}covariance = [[1, 2], [2, 1]]\n")), @r#"
    the correlation of `a` and `b` in `covariance` of `[filter]` is 2.0000, expected -1 to 1
    at   "2"
    "#);
    insta::assert_snapshot!(refusal(&format!("{KIND}covariance = [[-1, 0], [0, 1]]\n")), @r#"
    the variance of `a` in `covariance` of `[filter]` is -1, expected 0 or more
    at   "-1"
    "#);
    insta::assert_snapshot!(refusal(&format!("{KIND}covariance = [['k', 0], [0, 1]]\n")), @r#"
    `covariance` of `[filter]` is a string, expected a number
    at   "'k'"
    "#);
}

#[test]
fn names_that_are_no_states() {
    insta::assert_snapshot!(refusal(&format!("{KIND}{PRIOR}consider = ['c']\n")), @r#"
    unknown state `c` in `consider` of `[filter]`
    at   "'c'"
    "#);
    insta::assert_snapshot!(refusal(&format!("{KIND}{PRIOR}consider = 'a'\n")), @r#"
    `consider` of `[filter]` is a string, expected an array of strings
    at   "'a'"
    "#);
    insta::assert_snapshot!(refusal(&format!("{KIND}{PRIOR}consider = ['a', 'a']\n")), @r#"
    `a` stands twice in `consider` of `[filter]`
    at   "'a'"
    "#);
    insta::assert_snapshot!(refusal(&format!("{KIND}{PRIOR}mean = {{ c = 1 }}\n")), @r#"
    unknown state `c` in `mean` of `[filter]`
    at   "c"
    "#);
    insta::assert_snapshot!(refusal(&format!("{KIND}{PRIOR}mean = {{ a = 'k' }}\n")), @r#"
    `a` of `mean` of `[filter]` is a string, expected a number
    at   "'k'"
    "#);
}

/// A filter whose noise is a parameter.
fn with_noise(parameter: &str, beliefs: &str) -> String {
    complete(&format!(
        "[states]\na = {{}}\n[measurements.y]\ncolumn = 'y'\nequation = 'a'\nnoise = 's'\n[parameters]\ns = {parameter}\n\
         [filter]\n{KIND}covariance = [[4]]\n{beliefs}"
    ))
}

#[test]
fn beliefs_about_what_is_no_parameter() {
    insta::assert_snapshot!(with_noise("2", "parameters = { t = 3 }\n"), @r#"
    unknown parameter `t` in `parameters` of `[filter]`
    at   "t"
    "#);
    insta::assert_snapshot!(with_noise("2", "parameters = { s = 's' }\n"), @r#"
    `s` of `parameters` of `[filter]` is a string, expected a number
    at   "'s'"
    "#);
}

#[test]
fn beliefs_out_of_range() {
    insta::assert_snapshot!(with_noise("2", "parameters = { s = -3 }\n"), @r#"
    standard deviation `s` in `[filter]` is -3, expected 0 or more
    at   "-3"
    "#);
    insta::assert_snapshot!(with_noise("{ value = 2, lower = 1 }", "parameters = { s = 0.1 }\n"), @"accepted");
}

#[test]
fn beliefs_about_what_the_filter_does_not_use() {
    let text = "[states]\na = { offset = 'k' }\n[measurements.y]\ncolumn = 'y'\nequation = 'a'\nnoise = 1\n\
                [parameters]\nk = {}\n[filter]\nkind = 'kalman-schmidt'\ncovariance = [[4]]\n";
    insta::assert_snapshot!(complete(text), @"accepted");
    insta::assert_snapshot!(complete(&format!("{text}parameters = {{ k = 1 }}\n")), @r#"
    `k` has no effect in `[filter]`: the filter does not use it
    at   "1"
    "#);
}

#[test]
fn a_free_parameter_that_the_filter_uses() {
    insta::assert_snapshot!(with_noise("{ start = 2 }", ""), @r#"
    parameter `s` is free, but `[filter]` uses it and does not say at which value
    at   "filter"
    hint the estimates are data, so what the filter believed is known: write `parameters = { s = … }` there, or fix the parameter
    "#);
    insta::assert_snapshot!(with_noise("{ start = 2 }", "parameters = { s = 3 }\n"), @"accepted");
    insta::assert_snapshot!(with_noise("{ value = 2, per = 'lot', fixed = { A = 1 } }", ""), @"accepted");
}

/// Two phases, of which the second has no use for parameter `q`.
const PHASES: &str = "[data]\nphase = 'leg'\n[parameters]\nq = {}\ns = {}\n[measurements.y]\ncolumn = 'y'\nequation = 'a'\n\
                      noise = 's'\n[phases.one.states]\na = { next = 'a', step_noise = 'q' }\n[phases.two.states]\na = {}\n";

#[test]
fn a_filter_of_the_top_level_is_checked_in_each_phase_that_it_serves() {
    let filter = format!("[filter]\n{KIND}covariance = [[1]]\n");
    insta::assert_snapshot!(complete(&format!("{PHASES}{filter}parameters = {{ q = 1, s = 2 }}\n")), @"accepted");
    insta::assert_snapshot!(complete(&format!("{PHASES}{filter}parameters = {{ q = 1 }}\n")), @r#"
    parameter `s` is free, but `[filter]` uses it and does not say at which value
    at   "filter"
    hint the estimates are data, so what the filter believed is known: write `parameters = { s = … }` there, or fix the parameter
    "#);
    let own = filter.replace("[filter]", "[phases.two.filter]");
    insta::assert_snapshot!(complete(&format!("{PHASES}{own}parameters = {{ q = 1, s = 2 }}\n")), @r#"
    `q` has no effect in `[phases.two.filter]`: the filter does not use it
    at   "1"
    "#);
    insta::assert_snapshot!(complete(&format!("{PHASES}{own}parameters = {{ s = 2 }}\n")), @"accepted");
    insta::assert_snapshot!(complete(&format!("{PHASES}{own}")), @r#"
    parameter `s` is free, but `[phases.two.filter]` uses it and does not say at which value
    at   "filter"
    hint the estimates are data, so what the filter believed is known: write `parameters = { s = … }` there, or fix the parameter
    "#);
}

#[test]
fn a_filter_of_the_top_level_that_one_phase_cannot_have() {
    let text = PHASES.replace("[phases.two.states]\n", "[phases.two.states]\nb = {}\n");
    insta::assert_snapshot!(complete(&format!("{text}[filter]\n{KIND}covariance = [[1]]\nparameters = {{ q = 1, s = 2 }}\n")), @r#"
    `covariance` of `[filter]` has 1 row, expected 2
    at   "[[1]]"
    hint a row and a column for every state, in the order b, a
    "#);
}

#[test]
fn a_filter_of_the_top_level_that_no_phase_takes() {
    let own = |name: &str| {
        format!("[{name}]\n{KIND}covariance = [[1]]\n{}", "parameters = { s = 2 }\n")
            .replace("s = 2", if name.contains("one") { "q = 1, s = 2" } else { "s = 2" })
    };
    let text = format!("{PHASES}{}{}{}", own("filter"), own("phases.one.filter"), own("phases.two.filter"));
    insta::assert_snapshot!(complete(&text), @r#"
    `filter` has no effect when every phase has its own
    at   "filter"
    "#);
}
