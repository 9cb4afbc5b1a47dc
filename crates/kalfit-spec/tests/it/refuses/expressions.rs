use super::refusal;

#[test]
fn a_product_of_states() {
    let text = r#"[measurements.y]
equation = "a + 2 * (a - 1) * (b + 3)"
column = "y"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    state `a` times state `b` is not linear in the states
    at   "2 * (a - 1) * (b + 3)"
    "#);
}

#[test]
fn a_quotient_of_states() {
    let text = r#"[measurements.y]
equation = "a / (1 + b)"
column = "y"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    state `a` divided by state `b` is not linear in the states
    at   "a / (1 + b)"
    "#);
}

#[test]
fn a_division_by_a_state() {
    let text = r#"[measurements.y]
equation = "1 / b"
column = "y"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    a division by state `b` is not linear in the states
    at   "1 / b"
    "#);
}

#[test]
fn a_power_of_a_state() {
    let text = r#"[measurements.y]
equation = "a^2 + b"
column = "y"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    a power of state `a` is not linear in the states
    at   "a^2"
    "#);
}

#[test]
fn a_state_in_an_exponent() {
    let text = r#"[measurements.y]
equation = "2^a"
column = "y"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    state `a` in an exponent is not linear in the states
    at   "2^a"
    "#);
}

#[test]
fn a_function_of_a_state() {
    let text = r#"[measurements.y]
equation = "b + sqrt(2 * a)"
column = "y"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `sqrt` of state `a` is not linear in the states
    at   "sqrt(2 * a)"
    "#);
}

#[test]
fn a_condition_on_a_state() {
    let text = r#"[measurements.y]
equation = "if(a > 0, a, b)"
column = "y"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    a condition on state `a` is not linear in the states
    at   "a > 0"
    "#);
}

#[test]
fn a_comparison_that_stands_for_a_number() {
    let text = r#"[measurements.y]
equation = "a + (u > 2) * b"
column = "y"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    found a condition, expected a number
    at   "(u > 2)"
    hint `if(condition, 1, 0)` makes a number of a condition
    "#);
}

#[test]
fn a_number_that_stands_for_a_condition() {
    let text = r#"[measurements.y]
equation = "if(u, a, b)"
column = "y"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    found a number, expected a condition
    at   "u"
    hint write `u != 0`
    "#);
}

#[test]
fn a_text_that_stands_for_a_number() {
    let text = r#"[measurements.y]
equation = "a + 'b'"
column = "y"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    found a text, expected a number or a condition
    at   "'b'"
    hint texts are compared with columns, as in `sensor == 'A'`
    "#);
}

#[test]
fn texts_in_order() {
    let text = r#"[measurements.y]
equation = "if(s < 'A', a, b)"
column = "y"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    texts can only be compared by `==` or `!=`, found `<`
    at   "s < 'A'"
    "#);
}

#[test]
fn a_text_compared_with_a_state() {
    let text = r#"[measurements.y]
equation = "if('A' == a, a, b)"
column = "y"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    a text can only be compared with a column of the data, found the state `a`
    at   "a"
    hint the column is written `` `a` ``
    "#);
}

#[test]
fn a_text_compared_with_a_number() {
    let text = r#"[measurements.y]
equation = "if(2 * s == 'A', a, b)"
column = "y"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    a text can only be compared with a column of the data, found `2 * s`
    at   "2 * s"
    "#);
}

#[test]
fn a_chain_of_comparisons() {
    let text = r#"[measurements.y]
equation = "if(0 < u < 1, a, b)"
column = "y"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    comparisons cannot be chained
    at   "<"
    hint write `a < b and b < c`
    "#);
}

#[test]
fn a_single_equals_sign() {
    let text = r#"[measurements.y]
equation = "if(u = 1, a, b)"
column = "y"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    found `=`, which means nothing in an expression
    at   "="
    hint `==` compares
    "#);
}

#[test]
fn a_product_without_its_sign() {
    let text = r#"[measurements.y]
equation = "2a"
column = "y"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    found `a`, expected an operator or the end
    at   "a"
    hint write `2 * a`
    "#);
}

#[test]
fn a_power_of_another_language() {
    let text = r#"[measurements.y]
equation = "u**2 * a"
column = "y"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    found `*`, expected a number, a name or `(`
    at   "*"
    hint `^` raises to a power
    "#);
}

#[test]
fn an_open_parenthesis() {
    let text = r#"[measurements.y]
equation = "a + (b * 2"
column = "y"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    the parenthesis is not closed, expected `)`
    at   "("
    "#);
}

#[test]
fn an_open_text() {
    let text = r#"[measurements.y]
equation = "if(s == 'A, a, b)"
column = "y"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    the text is not closed, expected `'`
    at   "'A, a, b)"
    "#);
}

#[test]
fn a_column_without_a_name() {
    let text = r#"[measurements.y]
equation = "a * ``"
column = "y"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    found nothing between backticks, expected the name of a column between backticks
    at   "``"
    "#);
}

#[test]
fn an_unknown_function() {
    let text = r#"[measurements.y]
equation = "a * ln(u)"
column = "y"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    unknown function `ln`
    at   "ln"
    hint the natural logarithm is `log`
    "#);
}

#[test]
fn a_misspelt_function() {
    let text = r#"[measurements.y]
equation = "a * sqr(u)"
column = "y"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    unknown function `sqr`
    at   "sqr"
    hint did you mean `sqrt`?
    "#);
}

#[test]
fn a_name_used_as_a_function() {
    let text = r#"[measurements.y]
equation = "a (u + 1)"
column = "y"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    unknown function `a`
    at   "a"
    hint write `a * (`
    "#);
}

#[test]
fn a_function_without_arguments() {
    let text = r#"[measurements.y]
equation = "a * exp"
column = "y"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `exp` is a function, expected its arguments in parentheses
    at   "exp"
    hint a column of this name is written `` `exp` ``
    "#);
}

#[test]
fn too_many_arguments() {
    let text = r#"[measurements.y]
equation = "a * exp(1, 2)"
column = "y"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `exp` has 2 arguments, expected 1
    at   "exp(1, 2)"
    "#);
}

#[test]
fn an_if_without_an_else() {
    let text = r#"[measurements.y]
equation = "if(u > 1, a)"
column = "y"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `if` has 2 arguments, expected 3
    at   "if(u > 1, a)"
    hint write `if(condition, value, other_value)`
    "#);
}

#[test]
fn a_division_by_zero() {
    let text = r#"[measurements.y]
equation = "a * (1 / (2 - 2))"
column = "y"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    division by zero
    at   "(1 / (2 - 2))"
    "#);
}

#[test]
fn a_root_of_a_negative_number() {
    let text = r#"[measurements.y]
equation = "a * sqrt(-1)"
column = "y"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    the value is not a finite number
    at   "sqrt(-1)"
    "#);
}

#[test]
fn a_number_too_large() {
    let text = r#"[measurements.y]
equation = "1e999 * a"
column = "y"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    the value is not a finite number
    at   "1e999"
    "#);
}

#[test]
fn an_empty_expression() {
    let text = r#"[measurements.y]
equation = ""
column = "y"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    found the end, expected a number, a name or `(`
    at   "\""
    "#);
}

#[test]
fn an_expression_that_stops() {
    let text = r#"[measurements.y]
equation = "a +"
column = "y"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    found the end, expected a number, a name or `(`
    at   "\""
    "#);
}

#[test]
fn a_doubled_sign() {
    let text = r#"[measurements.y]
equation = "a + + b"
column = "y"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    found `+`, expected a number, a name or `(`
    at   "+"
    hint a sign `+` is left out
    "#);
}

#[test]
fn a_column_name_with_a_point() {
    let text = r#"[measurements.y]
equation = "a * Sepal.Length"
column = "y"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    found `.`, which means nothing in an expression
    at   "."
    hint a column whose name has other characters than letters, digits and `_` stands in backticks
    "#);
}

#[test]
fn an_expression_in_three_quotes() {
    let text = r#"[measurements.y]
equation = """
  a
  + b * b"""
column = "y"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    state `b` times state `b` is not linear in the states
    at   "b * b"
    "#);
}

#[test]
fn an_expression_with_escapes() {
    let text = r#"[measurements.y]
equation = "a * \u0062"
column = "y"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    state `a` times state `b` is not linear in the states
    at   "\"a * \\u0062\""
    "#);
}

#[test]
fn dt_without_time() {
    let text = r#"[measurements.y]
equation = "a * dt"
column = "y"
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `dt` needs `time` in `[data]`
    at   "dt"
    "#);
}

#[test]
fn a_state_in_a_noise() {
    let text = r#"[measurements.y]
column = "y"
equation = "a"
noise = "0.1 * a"
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    state `a` cannot stand in `noise` of measurement `y`
    at   "a"
    "#);
}

#[test]
fn a_parameter_in_a_row_selection() {
    let text = r#"[measurements.y]
column = "y"
where = "u > limit"
equation = "a"
noise = 1
[parameters]
limit = 3
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    parameter `limit` cannot stand in `where` of measurement `y`
    at   "limit"
    "#);
}

#[test]
fn dt_in_an_initial_value() {
    let text = r#"[data]
time = "t"
[states.a]
initial = { mean = "dt", sigma = 0 }
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `dt` cannot stand in `mean` of `initial` of state `a`
    at   "dt"
    "#);
}

#[test]
fn an_expression_that_is_true() {
    let text = r#"[measurements.y]
column = "y"
equation = true
noise = 1
"#;
    insta::assert_snapshot!(refusal(text), @r#"
    `equation` of measurement `y` is a truth value, expected a number or an expression
    at   "true"
    "#);
}
