use super::{refusal, refusal_in_one_line};

#[test]
fn each_equation_is_refused_with_its_message() {
    let rows = [
        (
            "a product of states",
            "a + 2 * (a - 1) * (b + 3)",
            r#"state `a` times state `b` is not linear in the states | at "2 * (a - 1) * (b + 3)""#,
        ),
        (
            "a quotient of states",
            "a / (1 + b)",
            r#"state `a` divided by state `b` is not linear in the states | at "a / (1 + b)""#,
        ),
        ("a division by a state", "1 / b", r#"a division by state `b` is not linear in the states | at "1 / b""#),
        ("a power of a state", "a^2 + b", r#"a power of state `a` is not linear in the states | at "a^2""#),
        ("a state in an exponent", "2^a", r#"state `a` in an exponent is not linear in the states | at "2^a""#),
        (
            "a function of a state",
            "b + sqrt(2 * a)",
            r#"`sqrt` of state `a` is not linear in the states | at "sqrt(2 * a)""#,
        ),
        (
            "a condition on a state",
            "if(a > 0, a, b)",
            r#"a condition on state `a` is not linear in the states | at "a > 0""#,
        ),
        (
            "a comparison that stands for a number",
            "a + (u > 2) * b",
            r#"found a condition, expected a number | at "(u > 2)" | hint `if(condition, 1, 0)` makes a number of a condition"#,
        ),
        (
            "a number that stands for a condition",
            "if(u, a, b)",
            r#"found a number, expected a condition | at "u" | hint write `u != 0`"#,
        ),
        (
            "a text that stands for a number",
            "a + 'b'",
            r#"found a text, expected a number or a condition | at "'b'" | hint texts are compared with columns, as in `sensor == 'A'`"#,
        ),
        (
            "texts in order",
            "if(s < 'A', a, b)",
            r#"texts can only be compared by `==` or `!=`, found `<` | at "s < 'A'""#,
        ),
        (
            "a text compared with a state",
            "if('A' == a, a, b)",
            r#"a text can only be compared with a column of the data, found the state `a` | at "a" | hint the column is written `` `a` ``"#,
        ),
        (
            "a text compared with a number",
            "if(2 * s == 'A', a, b)",
            r#"a text can only be compared with a column of the data, found `2 * s` | at "2 * s""#,
        ),
        (
            "a chain of comparisons",
            "if(0 < u < 1, a, b)",
            r#"comparisons cannot be chained | at "<" | hint write `a < b and b < c`"#,
        ),
        (
            "a single equals sign",
            "if(u = 1, a, b)",
            r#"found `=`, which means nothing in an expression | at "=" | hint `==` compares"#,
        ),
        (
            "a product without its sign",
            "2a",
            r#"found `a`, expected an operator or the end | at "a" | hint write `2 * a`"#,
        ),
        (
            "a power of another language",
            "u**2 * a",
            r#"found `*`, expected a number, a name or `(` | at "*" | hint `^` raises to a power"#,
        ),
        ("an open parenthesis", "a + (b * 2", r#"the parenthesis is not closed, expected `)` | at "(""#),
        ("an open text", "if(s == 'A, a, b)", r#"the text is not closed, expected `'` | at "'A, a, b)""#),
        (
            "a column without a name",
            "a * ``",
            r#"found nothing between backticks, expected the name of a column between backticks | at "``""#,
        ),
        (
            "an unknown function",
            "a * ln(u)",
            r#"unknown function `ln` | at "ln" | hint the natural logarithm is `log`"#,
        ),
        ("a misspelt function", "a * sqr(u)", r#"unknown function `sqr` | at "sqr" | hint did you mean `sqrt`?"#),
        ("a name used as a function", "a (u + 1)", r#"unknown function `a` | at "a" | hint write `a * (`"#),
        (
            "a function without arguments",
            "a * exp",
            r#"`exp` is a function, expected its arguments in parentheses | at "exp" | hint a column of this name is written `` `exp` ``"#,
        ),
        ("too many arguments", "a * exp(1, 2)", r#"`exp` has 2 arguments, expected 1 | at "exp(1, 2)""#),
        (
            "an if without an else",
            "if(u > 1, a)",
            r#"`if` has 2 arguments, expected 3 | at "if(u > 1, a)" | hint write `if(condition, value, other_value)`"#,
        ),
        ("a division by zero", "a * (1 / (2 - 2))", r#"division by zero | at "(1 / (2 - 2))""#),
        ("a root of a negative number", "a * sqrt(-1)", r#"the value is not a finite number | at "sqrt(-1)""#),
        ("a number too large", "1e999 * a", r#"the value is not a finite number | at "1e999""#),
        ("an empty expression", "", r#"found the end, expected a number, a name or `(` | at "\"""#),
        ("an expression that stops", "a +", r#"found the end, expected a number, a name or `(` | at "\"""#),
        (
            "a doubled sign",
            "a + + b",
            r#"found `+`, expected a number, a name or `(` | at "+" | hint a sign `+` is left out"#,
        ),
        (
            "a column name with a point",
            "a * Sepal.Length",
            r#"found `.`, which means nothing in an expression | at "." | hint a column whose name has other characters than letters, digits and `_` stands in backticks"#,
        ),
        (
            "an expression with escapes",
            r#"a * \u0062"#,
            r#"state `a` times state `b` is not linear in the states | at "\"a * \\u0062\"""#,
        ),
        ("dt without time", "a * dt", r#"`dt` needs `time` in `[data]` | at "dt""#),
    ];
    for (what, equation, message) in rows {
        assert_eq!(
            refusal_in_one_line(&format!("[measurements.y]\nequation = \"{equation}\"\ncolumn = \"y\"\nnoise = 1\n")),
            message,
            "{what}"
        );
    }
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
