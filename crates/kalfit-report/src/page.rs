//! Headings, paragraphs, lists, tables: as text, or as parts of an HTML page. What is said is written once.

use maud::{PreEscaped, html};

use crate::Style;
use crate::table::{self, Column};
use crate::words::wrap;

/// Rows of a table in a page, where a text has room for few.
const MOST_ROWS: usize = 200;

/// What all sections of a text or a page are laid out with.
pub(crate) struct Page<'a> {
    pub(crate) style: &'a Style,
    medium: Medium,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Medium {
    Text,
    Html,
}

impl<'a> Page<'a> {
    pub(crate) fn new(style: &'a Style) -> Page<'a> {
        Page { style, medium: Medium::Text }
    }

    /// Sections are HTML, escaped.
    pub(crate) fn html() -> Page<'static> {
        const STYLE: &Style = &Style { width: 80, color: false };
        Page { style: STYLE, medium: Medium::Html }
    }

    pub(crate) fn width(&self) -> usize {
        self.style.columns()
    }

    /// Rows that a long table may have, given how many a text has room for.
    pub(crate) fn rows(&self, in_text: usize) -> usize {
        if self.medium == Medium::Html { in_text.max(MOST_ROWS) } else { in_text }
    }

    /// A heading over a body; nothing when the body is empty.
    pub(crate) fn section(&self, heading: &str, body: &str) -> String {
        if body.is_empty() {
            return String::new();
        }
        match self.medium {
            Medium::Text => format!("{}\n{body}", self.heading(heading)),
            Medium::Html => html! { h3 { (heading) } (PreEscaped(body)) }.into_string(),
        }
    }

    pub(crate) fn heading(&self, heading: &str) -> String {
        if self.medium == Medium::Html {
            return html! { h3 { (heading) } }.into_string();
        }
        let wrapped = wrap(heading, self.width(), 0);
        wrapped.lines().map(|line| self.style.bold(line)).collect::<Vec<_>>().join("\n")
    }

    pub(crate) fn paragraph(&self, text: &str) -> String {
        match self.medium {
            Medium::Text => wrap(text, self.width(), 0) + "\n",
            Medium::Html => html! { p { (text) } }.into_string(),
        }
    }

    /// A list of sentences, indented as tables are.
    pub(crate) fn items(&self, sentences: &[String]) -> String {
        match (self.medium, sentences) {
            (Medium::Text, _) => sentences.iter().map(|s| indent(&wrap(s, self.width() - 2, 2))).collect(),
            (Medium::Html, []) => String::new(),
            (Medium::Html, [only]) => html! { p { (only) } }.into_string(),
            (Medium::Html, several) => html! { ul { @for one in several { li { (one) } } } }.into_string(),
        }
    }

    /// Columns side by side.
    pub(crate) fn table(&self, columns: &[Column]) -> String {
        match self.medium {
            Medium::Text => table::table(columns, self.width()),
            Medium::Html => table::html(columns, true),
        }
    }

    /// Columns that need not all fit side by side; `first` leads.
    pub(crate) fn wide_table(&self, first: &Column, others: &[Column]) -> String {
        match self.medium {
            Medium::Text => table::wide_table(first, others, self.width()),
            Medium::Html => {
                let all: Vec<Column> = std::iter::once(first).chain(others).cloned().collect();
                table::html(&all, false) // a triangle
            }
        }
    }
}

fn indent(text: &str) -> String {
    text.lines().map(|line| format!("  {line}\n")).collect()
}
