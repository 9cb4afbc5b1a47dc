use super::{refusal, refusal_in_one_line};

#[test]
fn each_line_of_covariance_is_refused_with_its_message() {
    let rows = [
        (
            "an unknown structure",
            r#"structure = "diagnoal""#,
            r#"`structure` of `[covariance]` is `diagnoal`, expected `full`, `diagonal`, `blocks`, `proportional`, `correlation` or `fixed` | at "\"diagnoal\"" | hint did you mean `diagonal`?"#,
        ),
        (
            "blocks without their structure",
            r#"blocks = [["a"], ["b"]]"#,
            r#"`blocks` has no effect with structure `full` | at "blocks" | hint `blocks` goes with structure `blocks`"#,
        ),
        (
            "a matrix of a full structure",
            "matrix = [[1, 0], [0, 1]]",
            r#"`matrix` has no effect with structure `full` | at "matrix" | hint `matrix` goes with structure `proportional`, `correlation` or `fixed`"#,
        ),
        (
            "a proportional structure without its matrix",
            r#"structure = "proportional""#,
            r#"`[covariance]` has no `matrix` | at "[covariance]" | hint structure `proportional` needs `matrix`, with a row for every estimated state"#,
        ),
        (
            "an order that leaves a state out",
            r#"order = ["a"]"#,
            r#"`b` is missing in `order` of `[covariance]` | at "[\"a\"]" | hint the order names every estimated state once"#,
        ),
        (
            "an order that names a state twice",
            r#"order = ["a", "b", "a"]"#,
            r#"`a` stands twice in `order` of `[covariance]` | at "\"a\"""#,
        ),
        (
            "an order with an unknown state",
            r#"order = ["a", "c"]"#,
            r#"unknown state `c` in `order` of `[covariance]` | at "\"c\"""#,
        ),
        (
            "an element of one name",
            "fixed = { a = 1 }",
            r#"`a` in `fixed` of `[covariance]` is not an element, expected two names as in `a, b` | at "a" | hint the variance of `a` is the element `a, a`"#,
        ),
        (
            "an element given twice",
            r#"fixed = { "a, b" = 1, "b,a" = 2 }"#,
            r#"element `a, b` is given twice in `fixed` of `[covariance]`: 1 and 2 | at "\"b,a\"""#,
        ),
        (
            "a covariance beside a zero variance",
            r#"fixed = { "a, a" = 0, "a, b" = 1 }"#,
            r#"the covariance of `a` and `b` in `fixed` of `[covariance]` is not 0, but the variance of `a` is | at "\"a, b\"""#,
        ),
        (
            "a negative variance",
            r#"fixed = { "a, a" = -1 }"#,
            r#"the variance of `a` in `fixed` of `[covariance]` is -1, expected 0 or more | at "\"a, a\"""#,
        ),
        (
            "a correlation beyond one",
            r#"fixed = { "a, a" = 1, "b, b" = 4, "a, b" = 3 }"#,
            r#"the correlation of `a` and `b` in `fixed` of `[covariance]` is 1.5000, expected -1 to 1 | at "\"a, b\"""#,
        ),
        (
            "a matrix that is not symmetric",
            "known = [[1, 0.5], [0.25, 1]]",
            r#"`known` of `[covariance]` is not symmetric: the entries of `a, b` differ | at "0.25""#,
        ),
        (
            "a matrix with too few rows",
            "known = [[1, 0]]",
            r#"`known` of `[covariance]` has 1 row, expected 2 | at "[[1, 0]]" | hint a row and a column for every estimated state, in the order of Σ"#,
        ),
        (
            "a matrix with a short row",
            "known = [[1, 0], [0]]",
            r#"`known` of `[covariance]` has 1 entry in row 2, expected 2 | at "[0]" | hint a row and a column for every estimated state, in the order of Σ"#,
        ),
        (
            "an equal group of one",
            r#"equal = [["a, a"]]"#,
            r#"`equal` of `[covariance]` has a group of fewer than two, expected at least two elements | at "[\"a, a\"]""#,
        ),
        (
            "an element twice in equal",
            r#"equal = [["a, b", "b, a"]]"#,
            r#"`a, b` stands twice in `equal` of `[covariance]` | at "\"b, a\"""#,
        ),
        (
            "a start that is no covariance",
            "start = [[1, 2], [2, 1]]",
            r#"the correlation of `a` and `b` in `start` of `[covariance]` is 2.0000, expected -1 to 1 | at "2""#,
        ),
        (
            "a start with a parameter",
            r#"start = [[1, "s"], ["s", 1]]"#,
            r#"`start` of `[covariance]` is a string, expected a number | at "\"s\"""#,
        ),
        (
            "an unknown key",
            r#"struture = "full""#,
            r#"unknown key `struture` in `[covariance]` | at "struture" | hint did you mean `structure`?"#,
        ),
    ];
    for (what, line, message) in rows {
        assert_eq!(refusal_in_one_line(&format!("[covariance]\n{line}\n")), message, "{what}");
    }
}

#[test]
fn fixed_elements_of_a_proportional_structure() {
    let text = r#"[covariance]
structure = "proportional"
matrix = [[1, 0], [0, 1]]
fixed = { "a, a" = 1 }
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `fixed` has no effect with structure `proportional`
    at   "fixed"
    hint `fixed` goes with structure `full`, `diagonal` or `blocks`
    "#);
}

#[test]
fn a_start_of_a_fixed_structure() {
    let text = r#"[covariance]
structure = "fixed"
matrix = [[1, 0], [0, 1]]
start = [[1, 0], [0, 1]]
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `start` has no effect with structure `fixed`
    at   "start"
    hint `start` goes with structure `full`, `diagonal` or `blocks`
    "#);
}

#[test]
fn a_state_in_two_blocks() {
    let text = r#"[covariance]
structure = "blocks"
blocks = [["a", "b"], ["a"]]
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `a` stands twice in `blocks` of `[covariance]`
    at   "\"a\""
    "#);
}

#[test]
fn an_empty_block() {
    let text = r#"[covariance]
structure = "blocks"
blocks = [["a", "b"], []]
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `blocks` of `[covariance]` has an empty block, expected names of states
    at   "[]"
    "#);
}

#[test]
fn a_fixed_element_outside_the_blocks() {
    let text = r#"[covariance]
structure = "blocks"
blocks = [["a"], ["b"]]
fixed = { "a, b" = 1 }
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    element `a, b` in `fixed` of `[covariance]` is 1, but structure `blocks` makes it 0
    at   "\"a, b\""
    "#);
}

#[test]
fn a_fixed_covariance_in_a_diagonal() {
    let text = r#"[covariance]
structure = "diagonal"
fixed = { "b, a" = 1 }
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    element `a, b` in `fixed` of `[covariance]` is 1, but structure `diagonal` makes it 0
    at   "\"b, a\""
    "#);
}

#[test]
fn a_matrix_that_is_not_semidefinite() {
    let text = r#"[covariance]
structure = "fixed"
matrix = [[1, 0.9, -0.9], [0.9, 1, 0.9], [-0.9, 0.9, 1]]
[states]
a = {}
b = {}
c = {}
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `matrix` of `[covariance]` is not positive semidefinite: scaled to unit diagonal, its smallest eigenvalue is -8.000e-1, its largest 1.900e0
    at   "[[1, 0.9, -0.9], [0.9, 1, 0.9], [-0.9, 0.9, 1]]"
    hint every pair is possible by itself, but not all together
    "#);
}

#[test]
fn a_matrix_with_a_column_of_the_data() {
    let text = r#"[covariance]
structure = "fixed"
matrix = [[1, "rho"], ["rho", 1]]
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    column `rho` cannot stand in `matrix` of `[covariance]`
    at   "rho"
    "#);
}

#[test]
fn a_correlation_matrix_with_a_variance() {
    let text = r#"[covariance]
structure = "correlation"
matrix = [[1, 0], [0, 2]]
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    the diagonal of a correlation matrix is 1, but the entry of `b` is not
    at   "2"
    "#);
}

#[test]
fn a_scaled_matrix_of_zeros() {
    let text = r#"[covariance]
structure = "proportional"
matrix = [[0, 0], [0, 0]]
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `matrix` of `[covariance]` is zero throughout, so its scale has nothing to act on
    at   "[[0, 0], [0, 0]]"
    "#);
}

#[test]
fn a_variance_of_a_common_value() {
    let text = r#"[covariance]
fixed = { "b, b" = 4 }
[states]
a = {}
b = { random = false }
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    state `b` has `random = false`, but its variance in `fixed` of `[covariance]` is not 0
    at   "\"b, b\""
    "#);
}

#[test]
fn a_covariance_of_a_common_value() {
    let text = r#"[covariance]
structure = "fixed"
matrix = [[1, 0.1], [0.1, 1]]
[states]
a = {}
b = { random = false }
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    state `b` has `random = false`, but its covariance in `matrix` of `[covariance]` is not 0
    at   "0.1"
    "#);
}

#[test]
fn a_correlation_of_a_common_value() {
    let text = r#"[covariance]
structure = "correlation"
matrix = [[1, 0.1], [0.1, 1]]
[states]
a = {}
b = { random = false }
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    state `b` has `random = false`, but its covariance in `matrix` of `[covariance]` is not 0
    at   "0.1"
    "#);
}

#[test]
fn an_equal_element_that_is_fixed() {
    let text = r#"[covariance]
fixed = { "a, a" = 1 }
equal = [["a, a", "b, b"]]
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    element `a, a` in `equal` is fixed at 1, so it has no value to share
    at   "\"a, a\""
    "#);
}

#[test]
fn an_equal_element_that_is_zero_by_structure() {
    let text = r#"[covariance]
structure = "diagonal"
equal = [["a, b", "b, b"]]
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    element `a, b` in `equal` is 0 by structure `diagonal`, so it has no value to share
    at   "\"a, b\""
    "#);
}

#[test]
fn an_equal_element_of_a_common_value() {
    let text = r#"[covariance]
equal = [["a, a", "b, b"]]
[states]
a = {}
b = { random = false }
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    element `b, b` in `equal` is fixed at 0, so it has no value to share
    at   "\"b, b\""
    "#);
}

#[test]
fn a_start_that_breaks_a_fixed_value() {
    let text = r#"[covariance]
fixed = { "a, a" = 1 }
start = [[2, 0], [0, 1]]
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `start` has 2 for element `a, a`, but it is fixed at 1
    at   "2"
    "#);
}

#[test]
fn a_start_that_breaks_the_structure() {
    let text = r#"[covariance]
structure = "diagonal"
start = [[2, 1], [1, 1]]
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `start` has 1 for element `a, b`, but structure `diagonal` makes it 0
    at   "1"
    "#);
}

#[test]
fn a_start_that_breaks_equality() {
    let text = r#"[covariance]
equal = [["a, a", "b, b"]]
start = [[2, 1], [1, 1]]
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `start` has 1 for element `b, b`, but it equals element `a, a`, which starts at 2
    at   "1"
    "#);
}
