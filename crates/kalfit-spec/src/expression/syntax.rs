//! From words to a tree, with the bytes of every part.

use std::ops::Range;

use kalfit::model::Operator;

use crate::error::ExpressionProblem;
use crate::token::{ExpressionToken, SpannedToken, tokenize};
use crate::vocabulary::operator_written;

/// Longest expression that is read, in bytes.
const MAX_LENGTH: usize = 16_384;
/// Parts of one expression.
const MAX_PARTS: usize = 1_000;
/// Levels of nesting: it bounds the recursion of all that walks the tree.
const MAX_DEPTH: usize = 64;

/// A part of an expression and its bytes in the text.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct SyntaxNode {
    pub(crate) kind: SyntaxKind,
    pub(crate) span: Range<usize>,
}

/// The kinds of part.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum SyntaxKind {
    Number(f64),
    Name(String),
    Column(String),
    Text(String),
    Negate(Box<SyntaxNode>),
    Not(Box<SyntaxNode>),
    Binary(Operator, Box<SyntaxNode>, Box<SyntaxNode>),
    Call(String, Vec<SyntaxNode>),
}

/// A fault of syntax: what, where, and what may help.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct SyntaxFault {
    pub(crate) problem: ExpressionProblem,
    pub(crate) span: Range<usize>,
    pub(crate) hint: Option<String>,
}

type ParseResult<T> = Result<T, Box<SyntaxFault>>;

/// Reads a whole text as one expression.
pub(crate) fn parse(text: &str) -> ParseResult<SyntaxNode> {
    if text.len() > MAX_LENGTH {
        return fault(ExpressionProblem::TooLong { found: text.len(), limit: MAX_LENGTH }, 0..text.len(), None);
    }
    let words = tokenize(text).map_err(|(problem, span)| {
        let hint = character_hint(&problem);
        Box::new(SyntaxFault { problem, span, hint })
    })?;
    let mut parser = ExpressionParser { words: &words, next: 0, end: text.len(), parts: 0 };
    let node = parser.expression(0, 0)?;
    match parser.peek() {
        None => Ok(node),
        Some(_) => parser.unexpected("an operator or the end"),
    }
}

struct ExpressionParser<'w, 's> {
    words: &'w [SpannedToken<'s>],
    next: usize,
    end: usize,
    parts: usize,
}

/// How tightly operators bind, loosest first: left and right power of each.
fn power(token: &ExpressionToken<'_>) -> Option<(u8, u8, Operator)> {
    let (ExpressionToken::Name(word) | ExpressionToken::Symbol(word)) = token else { return None };
    let operator = operator_written(word)?;
    let (left, right) = match operator {
        Operator::Or => (1, 2),
        Operator::And => (3, 4),
        Operator::Add | Operator::Subtract => (9, 10),
        Operator::Multiply | Operator::Divide => (11, 12),
        Operator::Power => (16, 15), // groups from the right
        _ => (COMPARISON, COMPARISON + 1),
    };
    Some((left, right, operator))
}

const NOT: u8 = 6;
const COMPARISON: u8 = 7;
const MINUS: u8 = 13;
const OPERAND: &str = "a number, a name or `(`";

impl<'w> ExpressionParser<'w, '_> {
    /// Precedence climbing: all operators that bind at least as tightly as `least`.
    fn expression(&mut self, least: u8, depth: usize) -> ParseResult<SyntaxNode> {
        if depth >= MAX_DEPTH {
            return fault(ExpressionProblem::TooDeep { limit: MAX_DEPTH }, self.here(), None);
        }
        let mut left = self.operand(depth)?;
        let mut compared = false;
        while let Some((left_power, right_power, operator)) = self.peek().and_then(power) {
            if left_power < least {
                break;
            }
            let comparison = left_power == COMPARISON;
            if comparison && compared {
                let hint = "write `a < b and b < c`";
                return fault(ExpressionProblem::ChainedComparison, self.here(), Some(hint.to_owned()));
            }
            compared = comparison;
            self.next += 1;
            let right = self.expression(right_power, depth + 1)?;
            let span = left.span.start..right.span.end;
            left = self.node(SyntaxKind::Binary(operator, Box::new(left), Box::new(right)), span)?;
        }
        Ok(left)
    }

    fn operand(&mut self, depth: usize) -> ParseResult<SyntaxNode> {
        let Some((token, span)) = self.words.get(self.next) else { return self.unexpected(OPERAND) };
        let span = span.clone();
        self.next += 1;
        match token {
            ExpressionToken::Number(x) => self.node(SyntaxKind::Number(*x), span),
            ExpressionToken::Column(name) => self.node(SyntaxKind::Column((*name).to_owned()), span),
            ExpressionToken::Text(text) => self.node(SyntaxKind::Text(text.clone()), span),
            ExpressionToken::Name("not") => self.prefix(NOT, SyntaxKind::Not, span, depth),
            ExpressionToken::Symbol("-") => self.prefix(MINUS, SyntaxKind::Negate, span, depth),
            ExpressionToken::Name(name) if !matches!(*name, "and" | "or") => match self.peek() {
                Some(ExpressionToken::Symbol("(")) => self.call(name, span, depth),
                _ => self.node(SyntaxKind::Name((*name).to_owned()), span),
            },
            ExpressionToken::Symbol("(") => {
                let mut inside = self.expression(0, depth + 1)?;
                let close = self.close(&span)?;
                inside.span = span.start..close;
                Ok(inside)
            }
            _ => {
                self.next -= 1;
                self.unexpected(OPERAND)
            }
        }
    }

    fn prefix(
        &mut self,
        least: u8,
        kind: fn(Box<SyntaxNode>) -> SyntaxKind,
        span: Range<usize>,
        depth: usize,
    ) -> ParseResult<SyntaxNode> {
        let operand = self.expression(least, depth + 1)?;
        let span = span.start..operand.span.end;
        self.node(kind(Box::new(operand)), span)
    }

    fn call(&mut self, name: &str, span: Range<usize>, depth: usize) -> ParseResult<SyntaxNode> {
        let open = self.here();
        self.next += 1;
        let mut arguments = Vec::new();
        if self.peek() != Some(&ExpressionToken::Symbol(")")) {
            loop {
                arguments.push(self.expression(0, depth + 1)?);
                if self.peek() != Some(&ExpressionToken::Symbol(",")) {
                    break;
                }
                self.next += 1;
            }
        }
        let close = self.close(&open)?;
        self.node(SyntaxKind::Call(name.to_owned(), arguments), span.start..close)
    }

    /// The end of the parenthesis that was opened at `open`.
    fn close(&mut self, open: &Range<usize>) -> ParseResult<usize> {
        match self.words.get(self.next) {
            Some((ExpressionToken::Symbol(")"), span)) => {
                self.next += 1;
                Ok(span.end)
            }
            Some(_) => self.unexpected("an operator or `)`"),
            None => fault(ExpressionProblem::Unclosed { what: "the parenthesis", expected: "`)`" }, open.clone(), None),
        }
    }

    fn node(&mut self, kind: SyntaxKind, span: Range<usize>) -> ParseResult<SyntaxNode> {
        self.parts += 1;
        if self.parts > MAX_PARTS {
            return fault(ExpressionProblem::TooManyParts { limit: MAX_PARTS }, 0..self.end, None);
        }
        Ok(SyntaxNode { kind, span })
    }

    fn peek(&self) -> Option<&'w ExpressionToken<'_>> {
        self.words.get(self.next).map(|(token, _)| token)
    }

    fn here(&self) -> Range<usize> {
        self.words.get(self.next).map_or(self.end..self.end, |(_, span)| span.clone())
    }

    fn unexpected<T>(&self, expected: &'static str) -> ParseResult<T> {
        let found = self.peek().map_or("the end".to_owned(), ExpressionToken::shown);
        let before = self.next.checked_sub(1).map(|i| &self.words[i].0);
        let hint = match (before, self.peek()) {
            (Some(ExpressionToken::Symbol("*")), Some(ExpressionToken::Symbol("*"))) => {
                Some("`^` raises to a power".to_owned())
            }
            (Some(ExpressionToken::Number(x)), Some(ExpressionToken::Name(name))) => {
                Some(format!("write `{x} * {name}`"))
            }
            (Some(ExpressionToken::Number(x)), Some(ExpressionToken::Symbol("("))) => Some(format!("write `{x} * (`")),
            (_, Some(ExpressionToken::Symbol("+"))) => Some("a sign `+` is left out".to_owned()),
            _ => None,
        };
        fault(ExpressionProblem::Unexpected { found, expected }, self.here(), hint)
    }
}

fn fault<T>(problem: ExpressionProblem, span: Range<usize>, hint: Option<String>) -> ParseResult<T> {
    Err(Box::new(SyntaxFault { problem, span, hint }))
}

fn character_hint(problem: &ExpressionProblem) -> Option<String> {
    let ExpressionProblem::UnknownCharacter { found } = problem else { return None };
    Some(match found {
        '=' => "`==` compares".to_owned(),
        '&' => "write `and`".to_owned(),
        '|' => "write `or`".to_owned(),
        '!' => "write `not`".to_owned(),
        '"' => "texts stand in single quotes".to_owned(),
        '.' | '@' | '#' | '$' | '%' | ':' | '[' | ']' | '{' | '}' => {
            "a column whose name has other characters than letters, digits and `_` stands in backticks".to_owned()
        }
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The tree with every parenthesis written.
    fn grouped(text: &str) -> String {
        fn show(node: &SyntaxNode) -> String {
            match &node.kind {
                SyntaxKind::Number(x) => format!("{x}"),
                SyntaxKind::Name(name) => name.clone(),
                SyntaxKind::Column(name) => format!("`{name}`"),
                SyntaxKind::Text(text) => format!("'{text}'"),
                SyntaxKind::Negate(a) => format!("(-{})", show(a)),
                SyntaxKind::Not(a) => format!("(not {})", show(a)),
                SyntaxKind::Binary(operator, a, b) => format!("({} {operator:?} {})", show(a), show(b)),
                SyntaxKind::Call(name, arguments) => {
                    format!("{name}({})", arguments.iter().map(show).collect::<Vec<_>>().join(", "))
                }
            }
        }
        show(&parse(text).unwrap())
    }

    #[test]
    fn operators_bind_in_the_documented_order() {
        for (text, expected) in [
            ("a + b * c", "(a Add (b Multiply c))"),
            ("a - b - c", "((a Subtract b) Subtract c)"),
            ("a / b * c", "((a Divide b) Multiply c)"),
            ("a ^ b ^ c", "(a Power (b Power c))"),
            ("-a ^ b", "(-(a Power b))"),
            ("2^-1", "(2 Power (-1))"),
            ("2^-a*b", "((2 Power (-a)) Multiply b)"),
            ("-a * b", "((-a) Multiply b)"),
            ("a or b and not c < d + 1", "(a Or (b And (not (c Less (d Add 1)))))"),
            ("not a == b or c", "((not (a Equal b)) Or c)"),
            ("if(a < b, max(a, b, 1), (c))", "if((a Less b), max(a, b, 1), c)"),
        ] {
            assert_eq!(grouped(text), expected, "{text}");
        }
    }

    #[test]
    fn deep_nesting_is_refused_and_not_followed() {
        for text in
            ["(".repeat(5_000), "-".repeat(5_000), "2^".repeat(5_000), "not ".repeat(3_000), "sin(".repeat(3_000)]
        {
            let problem = parse(&text).unwrap_err().problem;
            assert_eq!(problem, ExpressionProblem::TooDeep { limit: MAX_DEPTH });
        }
    }

    #[test]
    fn an_endless_sum_is_refused() {
        let problem = parse(&vec!["a"; 2_000].join("+")).unwrap_err().problem;
        assert_eq!(problem, ExpressionProblem::TooManyParts { limit: MAX_PARTS });
        assert!(parse(&vec!["a"; 500].join("+")).is_ok());
    }
}
