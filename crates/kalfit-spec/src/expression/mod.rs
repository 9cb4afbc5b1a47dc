//! The expression language of model files; its grammar stands in the documentation of the crate.

mod fold;
mod form;
mod lower;
mod syntax;
mod token;

use std::ops::Range;

use kalfit::model::{Expression, Linear};

use crate::error::{Result, Span, SpecError};
use crate::names::Context;
use crate::table::Field;
use lower::Lowering;
use syntax::Node;

pub(crate) use fold::{ONE, ZERO, binary, is_zero, negate, size, square};
pub(crate) use lower::symbol;
pub(crate) use token::is_name;

/// What may stand in an expression, and where the expression stands, in words.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Scope<'p> {
    pub(crate) states: bool,
    pub(crate) columns: bool,
    pub(crate) parameters: bool,
    /// `dt`.
    pub(crate) step: bool,
    pub(crate) place: &'p str,
}

impl<'p> Scope<'p> {
    /// Equations of motion and measurement.
    pub(crate) fn equation(place: &'p str) -> Scope<'p> {
        Scope { states: true, columns: true, parameters: true, step: true, place }
    }

    /// Noise.
    pub(crate) fn row(place: &'p str) -> Scope<'p> {
        Scope { states: false, ..Scope::equation(place) }
    }

    /// What a phase inherits.
    pub(crate) fn carry(place: &'p str) -> Scope<'p> {
        Scope { step: false, ..Scope::equation(place) }
    }

    /// The start of a test.
    pub(crate) fn start(place: &'p str) -> Scope<'p> {
        Scope { step: false, ..Scope::row(place) }
    }

    /// Selection of rows.
    pub(crate) fn rows(place: &'p str) -> Scope<'p> {
        Scope { parameters: false, ..Scope::row(place) }
    }

    /// What is common to all tests.
    pub(crate) fn common(place: &'p str) -> Scope<'p> {
        Scope { columns: false, ..Scope::start(place) }
    }

    /// Ties between means.
    pub(crate) fn means(place: &'p str) -> Scope<'p> {
        Scope { states: true, columns: false, parameters: false, step: false, place }
    }
}

/// The text of an expression and where it stands in the file.
#[derive(Debug)]
pub(crate) struct Snippet {
    text: String,
    span: Span,
    /// Start of the text in the file, when it stands there as it is, without escapes.
    start: Option<usize>,
}

impl Snippet {
    fn new(source: &str, text: &str, span: Span) -> Snippet {
        // One quote, three, or three and a line break before the text.
        let start = [1, 3, 4, 5]
            .into_iter()
            .map(|skip| span.start + skip)
            .find(|&start| start + text.len() < span.end && source.get(start..start + text.len()) == Some(text));
        Snippet { text: text.to_owned(), span, start }
    }

    /// Bytes of the file for bytes of the text.
    fn locate(&self, within: &Range<usize>) -> Span {
        match self.start {
            Some(start) => start + within.start..start + within.end,
            None => self.span.clone(),
        }
    }

    fn text_at(&self, within: &Range<usize>) -> &str {
        &self.text[within.clone()]
    }
}

fn read(context: &Context<'_>, field: &Field<'_>) -> Result<(Snippet, Node)> {
    let text = field.as_text().ok_or_else(|| field.wrong_type("a number or an expression"))?;
    let snippet = Snippet::new(context.source, text, field.span.clone());
    match syntax::parse(text) {
        Ok(node) => Ok((snippet, node)),
        Err(fault) => {
            let span = if fault.span.is_empty() { snippet.end() } else { snippet.locate(&fault.span) };
            Err(SpecError::new(fault.problem).at(span).maybe_hint(fault.hint))
        }
    }
}

impl Snippet {
    /// Where the text ends: the closing quote, which is something to point at.
    fn end(&self) -> Span {
        self.span.end - 1..self.span.end
    }
}

/// A linear form in the states: a number or an expression.
pub(crate) fn linear(context: &mut Context<'_>, field: &Field<'_>, scope: Scope<'_>) -> Result<Linear> {
    if field.is_number() {
        return Ok(lower::constant(field.number()?));
    }
    let (snippet, node) = read(context, field)?;
    Ok(Lowering { context, scope, snippet: &snippet }.form(&node)?.into_linear())
}

/// A number without states: a number or an expression.
pub(crate) fn scalar(context: &mut Context<'_>, field: &Field<'_>, scope: Scope<'_>) -> Result<Expression> {
    if field.is_number() {
        return Ok(lower::constant(field.number()?).constant);
    }
    let (snippet, node) = read(context, field)?;
    Lowering { context, scope, snippet: &snippet }.scalar(&node)
}

/// A condition.
pub(crate) fn condition(context: &mut Context<'_>, field: &Field<'_>, scope: Scope<'_>) -> Result<Expression> {
    field.text()?;
    let (snippet, node) = read(context, field)?;
    Lowering { context, scope, snippet: &snippet }.truth(&node)
}
