use super::{refusal, refusal_in_one_line};

#[test]
fn a_mean_of_an_unknown_state() {
    let text = r#"[states]
bias = {}
b = {}
[measurements.y]
column = "y"
equation = "b"
noise = 1
[mean]
fixed = { bais = 0 }
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    unknown state `bais` in `fixed` of `[mean]`
    at   "bais"
    hint did you mean `bias`?
    "#);
}

#[test]
fn a_mean_of_a_state_with_known_start() {
    let text = r#"[states]
a = {}
b = {}
c = { initial = { mean = 0, sigma = 1 } }
[mean]
fixed = { c = 0 }
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    state `c` in `fixed` of `[mean]` is not estimated: its start is known
    at   "c"
    "#);
}

#[test]
fn a_mean_fixed_and_tied() {
    let text = r#"[mean]
fixed = { a = 0 }
tied = { a = "b" }
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    the mean of `a` is fixed and tied
    at   "a"
    "#);
}

#[test]
fn a_mean_fixed_and_proportional() {
    let text = r#"[mean]
fixed = { a = 0 }
proportional_to = { a = 1, b = 2 }
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    the mean of `a` is fixed and proportional
    at   "a"
    "#);
}

#[test]
fn each_line_of_mean_is_refused_with_its_message() {
    let rows = [
        ("a mean tied to itself", r#"tied = { a = "a + b" }"#, r#"the mean of `a` is tied to itself | at "\"a + b\"""#),
        (
            "a mean tied to nothing",
            r#"tied = { a = "2" }"#,
            r#"the mean of `a` is tied to no other mean | at "\"2\"" | hint a mean that is known stands under `fixed`"#,
        ),
        (
            "a mean tied to a column",
            r#"tied = { a = "2 * c" }"#,
            r#"column `c` cannot stand in `a` of `tied` of `[mean]` | at "c""#,
        ),
        (
            "a tie that is not linear",
            r#"tied = { a = "b * b" }"#,
            r#"state `b` times state `b` is not linear in the states | at "b * b""#,
        ),
        (
            "a proportional mean of zeros",
            "proportional_to = { a = 0, b = 0 }",
            r#"`proportional_to` of `[mean]` is zero throughout, so its scale has nothing to act on | at "{ a = 0, b = 0 }""#,
        ),
    ];
    for (what, line, message) in rows {
        assert_eq!(refusal_in_one_line(&format!("[mean]\n{line}\n")), message, "{what}");
    }
}

#[test]
fn a_mean_tied_to_a_tied_one() {
    let text = r#"[states]
a = {}
b = {}
c = {}
[mean]
tied = { a = "b", b = "c" }
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    the mean of `a` is tied to `b`, which is tied itself
    at   "\"b\""
    hint write the expression of the other mean instead of its name
    "#);
}

#[test]
fn a_mean_tied_to_a_known_start() {
    let text = r#"[states]
a = {}
b = {}
c = { initial = { mean = 0, sigma = 1 } }
[mean]
tied = { a = "b + c" }
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    state `c` in `a` of `tied` of `[mean]` is not estimated: its start is known
    at   "\"b + c\""
    "#);
}

#[test]
fn a_start_of_a_fixed_mean() {
    let text = r#"[mean]
fixed = { a = 0 }
start = { a = 1 }
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `a` has no effect as a start value: its mean is fixed
    at   "a"
    "#);
}

#[test]
fn a_column_twice_in_a_regression() {
    let text = r#"[mean.regression]
a = ["T", "T"]
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `T` stands twice in regression of the mean of `a`
    at   "\"T\""
    "#);
}

#[test]
fn a_regression_on_nothing() {
    let text = r#"[mean.regression]
a = []
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `a` of `regression` of `[mean]` has no column, expected names of columns
    at   "[]"
    "#);
}

#[test]
fn a_regression_on_a_number() {
    let text = r#"[mean.regression]
a = [3]
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `a` of `regression` of `[mean]` is a number, expected an array of strings
    at   "3"
    "#);
}
