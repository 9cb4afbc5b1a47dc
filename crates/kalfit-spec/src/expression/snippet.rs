//! The text of an expression, and its bytes in the file.

use std::ops::Range;

use crate::error::Span;

/// The text of an expression and where it stands in the file.
#[derive(Debug)]
pub(crate) struct ExpressionSnippet {
    text: String,
    span: Span,
    /// Start of the text in the file, when it stands there as it is, without escapes.
    start: Option<usize>,
}

impl ExpressionSnippet {
    pub(super) fn new(source: &str, text: &str, span: Span) -> ExpressionSnippet {
        // One quote, three, or three and a line break before the text.
        let start = [1, 3, 4, 5]
            .into_iter()
            .map(|skip| span.start + skip)
            .find(|&start| start + text.len() < span.end && source.get(start..start + text.len()) == Some(text));
        ExpressionSnippet { text: text.to_owned(), span, start }
    }

    /// Bytes of the file for bytes of the text.
    pub(super) fn locate(&self, within: &Range<usize>) -> Span {
        match self.start {
            Some(start) => start + within.start..start + within.end,
            None => self.span.clone(),
        }
    }

    pub(super) fn text_at(&self, within: &Range<usize>) -> &str {
        &self.text[within.clone()]
    }

    /// Where the text ends: the closing quote, which is something to point at.
    pub(super) fn end(&self) -> Span {
        self.span.end - 1..self.span.end
    }
}
