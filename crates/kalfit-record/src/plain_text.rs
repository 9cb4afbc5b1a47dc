//! Text from outside, as it may be shown.

/// Whether a character changes the direction of the text around it, so that a reader sees other words than a program.
pub fn directs_text(c: char) -> bool {
    matches!(c, '\u{61c}' | '\u{200e}'..='\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

/// The text with a space for every control character, and with every character that directs text written out, as in
/// `\u202e`.
pub fn plain_text(text: &str) -> String {
    let mut plain = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            c if c.is_control() => plain.push(' '),
            c => push_undirected(&mut plain, c),
        }
    }
    plain
}

/// The text with every character that directs text written out; the escape is also that of JSON and JavaScript.
pub fn undirected(text: String) -> String {
    if !text.contains(directs_text) {
        return text;
    }
    let mut plain = String::with_capacity(text.len() + 16);
    text.chars().for_each(|c| push_undirected(&mut plain, c));
    plain
}

fn push_undirected(text: &mut String, c: char) {
    match directs_text(c) {
        true => text.push_str(&format!("\\u{:04x}", u32::from(c))),
        false => text.push(c),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_directs_text_is_written_out() {
        assert_eq!(plain_text("a\u{202e}b\tc\u{2067}µ"), "a\\u202eb c\\u2067µ");
        assert_eq!(undirected("a\u{200f}\nb".to_owned()), "a\\u200f\nb");
    }
}
