//! The words of the expression language.

use std::ops::Range;

use winnow::Parser;
use winnow::Result as Lexed;
use winnow::ascii::{digit0, digit1};
use winnow::combinator::{alt, opt, repeat};
use winnow::stream::{LocatingSlice, Location};
use winnow::token::{none_of, one_of, take_while};

use crate::error::ExpressionProblem;

type TokenInput<'s> = LocatingSlice<&'s str>;

/// One word.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum ExpressionToken<'s> {
    Number(f64),
    Name(&'s str),
    /// A name in backticks: always a column.
    Column(&'s str),
    /// A text in single quotes, already without them.
    Text(String),
    Symbol(&'static str),
}

/// A word and its bytes in the text.
pub(crate) type SpannedToken<'s> = (ExpressionToken<'s>, Range<usize>);

/// Longest first, so that `<=` is not read as `<` and `=`.
const SYMBOLS: [&str; 14] = ["<=", ">=", "==", "!=", "<", ">", "+", "-", "*", "/", "^", "(", ")", ","];

/// Cuts a text into words.
pub(crate) fn tokenize(text: &str) -> Result<Vec<SpannedToken<'_>>, (ExpressionProblem, Range<usize>)> {
    let mut input = LocatingSlice::new(text);
    let mut words = Vec::new();
    loop {
        skip_space(&mut input);
        if input.is_empty() {
            return Ok(words);
        }
        let start = input.current_token_start();
        match alt((number, name, column, literal, symbol)).with_span().parse_next(&mut input) {
            Ok((ExpressionToken::Number(x), span)) if !x.is_finite() => {
                return Err((ExpressionProblem::NotFinite, span));
            }
            Ok(word) => words.push(word),
            Err(_) => return Err(unreadable(text, start)),
        }
    }
}

/// True when a text can be written in expressions as it is.
pub(crate) fn is_name(text: &str) -> bool {
    matches!(tokenize(text).as_deref(), Ok([(ExpressionToken::Name(name), _)]) if *name == text)
}

fn skip_space(input: &mut TokenInput<'_>) {
    let space: Lexed<&str> = take_while(0.., char::is_whitespace).parse_next(input);
    debug_assert!(space.is_ok(), "no space is space too");
}

fn number<'s>(input: &mut TokenInput<'s>) -> Lexed<ExpressionToken<'s>> {
    let exponent = (one_of(['e', 'E']), opt(one_of(['+', '-'])), digit1).void();
    let mantissa = alt(((digit1, opt(('.', digit0))).void(), ('.', digit1).void()));
    (mantissa, opt(exponent)).take().try_map(str::parse::<f64>).map(ExpressionToken::Number).parse_next(input)
}

fn name<'s>(input: &mut TokenInput<'s>) -> Lexed<ExpressionToken<'s>> {
    let first = one_of(|c: char| c.is_alphabetic() || c == '_');
    let rest = take_while(0.., |c: char| c.is_alphanumeric() || c == '_');
    (first, rest).take().map(ExpressionToken::Name).parse_next(input)
}

fn column<'s>(input: &mut TokenInput<'s>) -> Lexed<ExpressionToken<'s>> {
    ('`', take_while(1.., |c| c != '`'), '`').map(|(_, name, _)| ExpressionToken::Column(name)).parse_next(input)
}

/// A quote inside a text is written twice.
fn literal<'s>(input: &mut TokenInput<'s>) -> Lexed<ExpressionToken<'s>> {
    let inside = repeat::<_, _, (), _, _>(0.., alt(("''".void(), none_of('\'').void())));
    let quoted: &str = ('\'', inside, '\'').take().parse_next(input)?;
    Ok(ExpressionToken::Text(quoted[1..quoted.len() - 1].replace("''", "'")))
}

fn symbol<'s>(input: &mut TokenInput<'s>) -> Lexed<ExpressionToken<'s>> {
    for symbol in SYMBOLS {
        let found: Lexed<&str> = winnow::token::literal(symbol).parse_next(input);
        if found.is_ok() {
            return Ok(ExpressionToken::Symbol(symbol));
        }
    }
    Err(winnow::error::ContextError::new())
}

fn unreadable(text: &str, start: usize) -> (ExpressionProblem, Range<usize>) {
    let rest = &text[start..];
    let found = rest.chars().next().expect("the rest of the text is not empty");
    let whole = start..text.len();
    match found {
        '\'' => (ExpressionProblem::Unclosed { what: "the text", expected: "`'`" }, whole),
        '`' if rest.starts_with("``") => {
            let expected = "the name of a column between backticks";
            (
                ExpressionProblem::Unexpected { found: "nothing between backticks".to_owned(), expected },
                start..start + 2,
            )
        }
        '`' => (ExpressionProblem::Unclosed { what: "the column name", expected: "a backtick" }, whole),
        _ => (ExpressionProblem::UnknownCharacter { found }, start..start + found.len_utf8()),
    }
}

impl ExpressionToken<'_> {
    /// The word as messages show it.
    pub(crate) fn shown(&self) -> String {
        match self {
            ExpressionToken::Number(x) => format!("the number `{x}`"),
            ExpressionToken::Name(name) => format!("`{name}`"),
            ExpressionToken::Column(name) => format!("the column `{name}`"),
            ExpressionToken::Text(text) => format!("the text '{text}'"),
            ExpressionToken::Symbol(symbol) => format!("`{symbol}`"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tokens(text: &str) -> Vec<ExpressionToken<'_>> {
        tokenize(text).unwrap().into_iter().map(|(token, _)| token).collect()
    }

    #[test]
    fn numbers_names_columns_texts_and_symbols_are_told_apart() {
        let expected = [
            ExpressionToken::Number(1e-6),
            ExpressionToken::Symbol("*"),
            ExpressionToken::Name("tau_2"),
            ExpressionToken::Symbol("<="),
            ExpressionToken::Column("my column"),
            ExpressionToken::Symbol("=="),
            ExpressionToken::Text("it's".to_owned()),
        ];
        assert_eq!(tokens("1e-6*tau_2 <= `my column` == 'it''s'"), expected);
    }

    #[test]
    fn numbers_may_start_or_end_with_the_point() {
        assert_eq!(
            tokens(".5 5. 5.e1"),
            [ExpressionToken::Number(0.5), ExpressionToken::Number(5.0), ExpressionToken::Number(50.0)]
        );
    }

    #[test]
    fn a_number_followed_by_letters_is_a_number_and_a_name() {
        assert_eq!(tokens("2x"), [ExpressionToken::Number(2.0), ExpressionToken::Name("x")]);
        assert_eq!(tokens("2e"), [ExpressionToken::Number(2.0), ExpressionToken::Name("e")]);
    }

    #[test]
    fn only_letters_digits_and_underscores_make_names() {
        assert!(is_name("scale_x") && is_name("μ1"));
        assert!(!is_name("scale x") && !is_name("1x") && !is_name("") && !is_name(" x") && !is_name("a.b"));
    }
}
