//! Headings, paragraphs, lists.

use crate::Style;
use crate::words::wrap;

/// What all sections of a text are laid out with.
pub(crate) struct Page<'a> {
    pub(crate) style: &'a Style,
}

impl<'a> Page<'a> {
    pub(crate) fn new(style: &'a Style) -> Page<'a> {
        Page { style }
    }

    pub(crate) fn width(&self) -> usize {
        self.style.columns()
    }

    /// A heading over a body; nothing when the body is empty.
    pub(crate) fn section(&self, heading: &str, body: &str) -> String {
        if body.is_empty() {
            return String::new();
        }
        format!("{}\n{body}", self.heading(heading))
    }

    pub(crate) fn heading(&self, heading: &str) -> String {
        let wrapped = wrap(heading, self.width(), 0);
        wrapped.lines().map(|line| self.style.bold(line)).collect::<Vec<_>>().join("\n")
    }

    pub(crate) fn paragraph(&self, text: &str) -> String {
        wrap(text, self.width(), 0) + "\n"
    }

    /// A list of sentences, indented as tables are.
    pub(crate) fn items(&self, sentences: &[String]) -> String {
        sentences.iter().map(|s| indent(&wrap(s, self.width() - 2, 2))).collect()
    }
}

fn indent(text: &str) -> String {
    text.lines().map(|line| format!("  {line}\n")).collect()
}
