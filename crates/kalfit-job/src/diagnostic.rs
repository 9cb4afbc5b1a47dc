//! A failure as it is shown: what is wrong, where, and what to do about it. ASCII but for what the user wrote.

use crate::failure::{Failure, SourcePlace};

/// Characters of a source line that are shown, around the place.
const WIDEST: usize = 100;

/// A failure in words, with its line feeds: what is wrong, the line of the file, and a hint. Colours are ANSI escape sequences.
pub fn render(failure: &Failure, color: bool) -> String {
    let paint = |code: &str, text: &str| paint(color, code, text);
    let mut text = render_message(&failure.to_string(), color);
    if let Some(place) = failure.place() {
        let shown = excerpt(&place);
        text.push_str(&format!("  {} {} | {}\n", paint("34", "-->"), shown.at, shown.line));
        text.push_str(&format!("{}| {}\n", " ".repeat(shown.indent), paint("31", &shown.underline)));
    }
    if let Some(hint) = failure.hint() {
        text.push_str(&hinted(&hint, color));
    }
    text
}

/// As [`render`], for a message and a hint that stand alone.
pub fn render_hinted(message: &str, hint: Option<&str>, color: bool) -> String {
    render_message(message, color) + &hint.map_or(String::new(), |hint| hinted(hint, color))
}

fn hinted(hint: &str, color: bool) -> String {
    format!("\n{}: {}\n", paint(color, "36", "hint"), clean(hint))
}

/// As [`render`], for a message that stands alone.
pub fn render_message(message: &str, color: bool) -> String {
    format!("{}: {}\n", paint(color, "1;31", "error"), clean(message))
}

fn paint(color: bool, code: &str, text: &str) -> String {
    if color { format!("\u{1b}[{code}m{text}\u{1b}[0m") } else { text.to_owned() }
}

/// One line of a file with a part of it underlined.
struct SourceExcerpt {
    /// `file:line:column`
    at: String,
    line: String,
    /// Spaces before the bar that goes under the one in front of the line.
    indent: usize,
    underline: String,
}

fn excerpt(place: &SourcePlace) -> SourceExcerpt {
    let text = &place.source.text;
    let inside = |at: usize| (0..=at.min(text.len())).rev().find(|&i| text.is_char_boundary(i)).unwrap_or(0);
    let start = inside(place.span.start);
    let end = inside(place.span.end).max(start);
    let line_start = text[..start].rfind('\n').map_or(0, |i| i + 1);
    let line_end = text[start..].find('\n').map_or(text.len(), |i| start + i);
    let line = text[line_start..line_end].trim_end_matches('\r');
    let before = text[line_start..start].chars().count();
    let marked = text[start..end.min(line_end)].trim_end().chars().count().max(1);
    let at = format!("{}:{}:{}", clean(&place.source.name), 1 + text[..line_start].matches('\n').count(), before + 1);
    let (line, before, marked) = window(line, before, marked);
    let label = place.label.as_ref().map_or(String::new(), |label| format!(" {}", clean(label)));
    SourceExcerpt {
        indent: "  --> ".len() + at.chars().count() + 1,
        at,
        line,
        underline: format!("{}{}{label}", " ".repeat(before), "^".repeat(marked)),
    }
}

/// Cuts a long line to the part around `marked` characters after `before` others, and takes the indentation away.
fn window(line: &str, before: usize, marked: usize) -> (String, usize, usize) {
    let letters: Vec<char> = clean(line).chars().collect();
    let indentation = letters.iter().take(before).take_while(|c| c.is_whitespace()).count();
    let from = if before + marked - indentation <= WIDEST { indentation } else { before.saturating_sub(WIDEST / 2) };
    let to = letters.len().min(from + WIDEST);
    let (head, tail) = (if from > indentation { "..." } else { "" }, if to < letters.len() { "..." } else { "" });
    let shown: String = letters[from.min(to)..to].iter().collect();
    let shift = before - from + head.len();
    (format!("{head}{}{tail}", shown.trim_end()), shift, marked.min(WIDEST + head.len() - shift.min(WIDEST)))
}

/// One line without control characters: file names and cells may hold escape sequences.
fn clean(text: &str) -> String {
    kalfit::record::plain_text(text)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::failure::SourceText;

    fn shown(text: &str, span: std::ops::Range<usize>) -> String {
        let source = SourceText { name: "m.toml".into(), text: text.into() };
        let e = excerpt(&SourcePlace { source, span, label: Some("here".into()) });
        format!("{} | {}\n{}| {}", e.at, e.line, " ".repeat(e.indent - 6), e.underline)
    }

    #[test]
    fn the_span_is_underlined() {
        insta::assert_snapshot!(shown("title = 'a'\n\tnoise = 3\n", 13..18), @"
        m.toml:2:2 | noise = 3
                   | ^^^^^ here
        ");
    }

    #[test]
    fn spans_beyond_the_text_and_inside_characters_are_harmless() {
        for (start, end) in [(0, 0), (5, 2), (3, 400), (400, 500), (1, 2), (2, 7)] {
            let text = shown("é = 'ü'\nb = 2", start..end);
            assert!(text.contains('^'), "{start}..{end}: {text}");
        }
        assert!(shown("", 0..0).contains('^'));
    }

    #[test]
    fn long_lines_are_cut_around_the_span() {
        let line = format!("equation = \"{}BAD{}\"", "x + ".repeat(200), " + y".repeat(200));
        let at = line.find("BAD").unwrap();
        let text = shown(&line, at..at + 3);
        let lines: Vec<&str> = text.lines().collect();
        assert!(lines[0].chars().count() < 140, "{text}");
        let column = |line: &str, what: &str| line.find(what).unwrap();
        assert_eq!(column(lines[0], "BAD"), column(lines[1], "^^^"), "{text}");
    }
}
