//! Charts: what each shows, as JSON for the script of the page, and the figure around it.

use maud::{Markup, html};
use serde_json::{Value, json};

/// Letters of a text alternative; a screen reader has the tables too.
const MOST_LETTERS: usize = 600;

/// The charts of a page, in order.
#[derive(Default)]
pub(super) struct PageCharts {
    all: Vec<Value>,
}

/// One chart.
pub(super) struct PageChart<'a> {
    /// Which function of the script draws it.
    pub(super) kind: &'static str,
    /// What it shows.
    pub(super) title: &'a str,
    /// What to look for.
    pub(super) caption: &'a str,
    /// What it shows, for who cannot see it.
    pub(super) alternative: &'a str,
    /// What the function needs.
    pub(super) data: Value,
}

impl PageCharts {
    /// A figure; its chart is drawn when the page is opened.
    pub(super) fn figure(&mut self, chart: PageChart<'_>) -> Markup {
        let number = self.all.len();
        let PageChart { kind, title, caption, alternative, data } = chart;
        self.all.push(json!({ "kind": kind, "title": title, "data": data }));
        html! {
            figure data-chart=(number) {
                div.controls {}
                div.plot role="img" aria-label=(cut(&format!("{title}. {alternative}"), MOST_LETTERS)) {}
                figcaption { strong { (title) "." } " " (caption) }
            }
        }
    }

    /// All of them as JSON that cannot end the element it stands in.
    pub(super) fn json(&self) -> String {
        serde_json::to_string(&self.all)
            .expect("values are always written")
            .replace('<', "\\u003c")
            .replace('>', "\\u003e")
    }
}

/// The text up to so many letters.
pub(super) fn cut(text: &str, letters: usize) -> String {
    match text.char_indices().nth(letters) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text.to_owned(),
    }
}

/// A number that JSON has; null else.
pub(super) fn figure(x: f64) -> Value {
    if x.is_finite() { json!(x) } else { Value::Null }
}

/// Numbers that JSON has.
pub(super) fn figures(all: impl IntoIterator<Item = f64>) -> Vec<Value> {
    all.into_iter().map(figure).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn data_cannot_end_their_element_and_numbers_are_json() {
        let mut charts = PageCharts::default();
        let data = json!({ "name": "</script><script>alert(1)</script><!--", "x": figure(f64::NAN) });
        charts.figure(PageChart { kind: "k", title: "t", caption: "c", alternative: "a", data: data.clone() });
        let text = charts.json();
        assert!(!text.contains(['<', '>']), "{text}");
        let back: Value = serde_json::from_str(&text).unwrap();
        assert_eq!(back[0]["data"], data);
        assert!(back[0]["data"]["x"].is_null());
    }

    #[test]
    fn long_texts_are_cut_between_letters() {
        assert_eq!(cut("μμμμ", 2), "μμ…");
        assert_eq!(cut("μμ", 2), "μμ");
    }
}
