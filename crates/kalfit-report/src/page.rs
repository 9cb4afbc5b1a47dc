//! Headings, paragraphs, lists, tables: as text, or as parts of an HTML page. What is said is written once.

use maud::{Markup, PreEscaped, html};

use crate::TextStyle;
use crate::table::{self, TextColumn};
use crate::words::wrap;

/// Rows of a table in a page, where a text has room for few.
const MOST_ROWS: usize = 200;

/// What all sections of a text or a page are laid out with.
pub(crate) struct PageLayout<'a> {
    pub(crate) style: &'a TextStyle,
    medium: PageMedium,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum PageMedium {
    Text,
    Html,
}

impl<'a> PageLayout<'a> {
    pub(crate) fn new(style: &'a TextStyle) -> PageLayout<'a> {
        PageLayout { style, medium: PageMedium::Text }
    }

    /// Sections are HTML, escaped.
    pub(crate) fn html() -> PageLayout<'static> {
        const STYLE: &TextStyle = &TextStyle { width: 80, color: false };
        PageLayout { style: STYLE, medium: PageMedium::Html }
    }

    pub(crate) fn width(&self) -> usize {
        self.style.columns()
    }

    /// Rows that a long table may have, given how many a text has room for.
    pub(crate) fn rows(&self, in_text: usize) -> usize {
        if self.medium == PageMedium::Html { in_text.max(MOST_ROWS) } else { in_text }
    }

    /// A heading over a body; nothing when the body is empty.
    pub(crate) fn section(&self, heading: &str, body: &str) -> String {
        if body.is_empty() {
            return String::new();
        }
        match self.medium {
            PageMedium::Text => format!("{}\n{body}", self.heading(heading)),
            PageMedium::Html => html! { h3 { (heading) } (PreEscaped(body)) }.into_string(),
        }
    }

    pub(crate) fn heading(&self, heading: &str) -> String {
        if self.medium == PageMedium::Html {
            return html! { h3 { (heading) } }.into_string();
        }
        let wrapped = wrap(heading, self.width(), 0);
        wrapped.lines().map(|line| self.style.bold(line)).collect::<Vec<_>>().join("\n")
    }

    pub(crate) fn paragraph(&self, text: &str) -> String {
        match self.medium {
            PageMedium::Text => wrap(text, self.width(), 0) + "\n",
            PageMedium::Html => html! { p { (coded(text)) } }.into_string(),
        }
    }

    /// A list of sentences, indented as tables are.
    pub(crate) fn items(&self, sentences: &[String]) -> String {
        match (self.medium, sentences) {
            (PageMedium::Text, _) => sentences.iter().map(|s| indent(&wrap(s, self.width() - 2, 2))).collect(),
            (PageMedium::Html, []) => String::new(),
            (PageMedium::Html, [only]) => html! { p { (coded(only)) } }.into_string(),
            (PageMedium::Html, several) => html! { ul { @for one in several { li { (coded(one)) } } } }.into_string(),
        }
    }

    /// Columns side by side.
    pub(crate) fn table(&self, columns: &[TextColumn]) -> String {
        match self.medium {
            PageMedium::Text => table::table(columns, self.width()),
            PageMedium::Html => table::html(columns, true),
        }
    }

    /// Columns that need not all fit side by side; `first` leads.
    pub(crate) fn wide_table(&self, first: &TextColumn, others: &[TextColumn]) -> String {
        match self.medium {
            PageMedium::Text => table::wide_table(first, others, self.width()),
            PageMedium::Html => {
                let all: Vec<TextColumn> = std::iter::once(first).chain(others).cloned().collect();
                table::html(&all, false) // a triangle
            }
        }
    }
}

/// Text as HTML, with what stands between backticks as code; a backtick without a second one stays.
pub(crate) fn coded(text: &str) -> Markup {
    let parts: Vec<&str> = text.split('`').collect();
    let is_code = |k: usize| k % 2 == 1 && k + 1 < parts.len();
    html! {
        @for (k, part) in parts.iter().enumerate() {
            @if is_code(k) { code { (part) } } @else if k % 2 == 1 { "`" (part) } @else { (part) }
        }
    }
}

fn indent(text: &str) -> String {
    text.lines().map(|line| format!("  {line}\n")).collect()
}
