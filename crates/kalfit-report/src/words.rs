//! Sentences: counting, listing, wrapping.

/// Characters of a text from outside that are shown.
const MOST_SHOWN: usize = 4000;

/// Text from outside as it may be shown: one line that ends, no control characters (a test's id could hold an escape sequence), none that directs text.
pub(crate) fn clean(text: &str) -> String {
    let more = text.chars().nth(MOST_SHOWN).map(|_| '…');
    let shown: String = text.chars().take(MOST_SHOWN).chain(more).collect();
    kalfit::record::plain_text(&shown)
}

/// With a capital letter and a full stop.
pub(crate) fn sentence(text: &str) -> String {
    let stop = if text.trim().is_empty() || text.trim().ends_with(['.', '!', '?']) { "" } else { "." };
    capital(text.trim()) + stop
}

/// With a capital letter.
pub(crate) fn capital(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or(String::new(), |first| format!("{}{}", first.to_uppercase(), letters.as_str()))
}

/// `1 test`, `18 tests`.
pub(crate) fn count(n: usize, singular: &str) -> String {
    match n {
        1 => format!("1 {singular}"),
        n if ["ss", "sh", "ch", "x"].iter().any(|end| singular.ends_with(end)) => format!("{n} {singular}es"),
        n => format!("{n} {singular}s"),
    }
}

/// `a`, `a and b`, `a, b and c`; beyond `most`, `a, b and 7 more`.
pub(crate) fn list(items: &[String], most: usize) -> String {
    let shown = if items.len() > most { most.max(1) } else { items.len() };
    let rest = items.len() - shown.min(items.len());
    match (&items[..shown.min(items.len())], rest) {
        ([], _) => String::new(),
        ([only], 0) => only.clone(),
        ([firsts @ .., last], 0) => format!("{} and {last}", firsts.join(", ")),
        (firsts, rest) => format!("{} and {rest} more", firsts.join(", ")),
    }
}

/// Breaks a paragraph at spaces into lines of at most `width` characters; every line but the first starts with `hang`
/// spaces. A word longer than a line is cut.
pub(crate) fn wrap(paragraph: &str, width: usize, hang: usize) -> String {
    let width = width.max(hang + 8);
    let mut lines = vec![String::new()];
    let mut used = 0;
    for word in paragraph.split_whitespace() {
        let letters: Vec<char> = word.chars().collect();
        for piece in letters.chunks(width - hang) {
            let empty = used == 0 || (lines.len() > 1 && used == hang);
            if !empty && used + 1 + piece.len() > width {
                lines.push(" ".repeat(hang));
                used = hang;
            } else if !empty {
                lines.last_mut().expect("there is a line").push(' ');
                used += 1;
            }
            lines.last_mut().expect("there is a line").extend(piece);
            used += piece.len();
        }
    }
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_read_as_english() {
        let items: Vec<String> = ["a", "b", "c", "d"].map(str::to_owned).to_vec();
        assert_eq!(list(&items[..0], 3), "");
        assert_eq!(list(&items[..1], 3), "a");
        assert_eq!(list(&items[..2], 3), "a and b");
        assert_eq!(list(&items[..3], 3), "a, b and c");
        assert_eq!(list(&items, 2), "a, b and 2 more");
        assert_eq!(list(&items, 0), "a and 3 more");
    }

    #[test]
    fn sentences_begin_large_and_end() {
        assert_eq!(sentence("the end"), "The end.");
        assert_eq!(sentence(" Done. "), "Done.");
        assert_eq!(sentence(""), "");
    }

    #[test]
    fn wrapped_lines_never_exceed_the_width() {
        let text = format!("a sentence with {} inside, and some more words", "x".repeat(70));
        for width in 20..60 {
            let wrapped = wrap(&text, width, 2);
            for line in wrapped.lines() {
                assert!(line.chars().count() <= width, "{} > {width}: {line}", line.chars().count());
            }
            assert_eq!(wrapped.replace(['\n', ' '], ""), text.replace(' ', ""), "no letter is lost");
        }
    }

    #[test]
    fn escape_sequences_do_not_reach_the_terminal() {
        assert_eq!(clean("a\u{1b}[31mb\nc"), "a [31mb c");
    }
}
