//! Texts in the data, each stored once.

use std::collections::HashMap;

/// A text of the data, given by its number in [`Labels`]. Different texts have different labels; their order means
/// nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Label(u32);

impl Label {
    /// The label of an empty cell.
    pub const MISSING: Label = Label(u32::MAX);

    /// The label of the literal with this index in the model that the [`Labels`] were made for.
    pub fn literal(index: usize) -> Label {
        Label(u32::try_from(index).expect("a model names fewer than 2^32 texts"))
    }

    /// True for an empty cell.
    pub fn is_missing(self) -> bool {
        self == Label::MISSING
    }

    /// Number of the text.
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

/// The texts of a data set. The model's literals come first, so that a literal's index is its label.
#[derive(Debug, Clone, Default)]
pub struct Labels {
    texts: Vec<String>,
    by_text: HashMap<String, Label>,
}

impl Labels {
    /// Starts with a model's literals, which must differ from each other.
    pub fn new(literals: &[String]) -> Labels {
        let mut labels = Labels::default();
        for text in literals {
            labels.intern(text);
        }
        labels
    }

    /// The label of a text, which is added if it is new.
    pub fn intern(&mut self, text: &str) -> Label {
        if let Some(&label) = self.by_text.get(text) {
            return label;
        }
        let label = Label::literal(self.texts.len());
        self.texts.push(text.to_owned());
        self.by_text.insert(text.to_owned(), label);
        label
    }

    /// All texts, in the order of their labels.
    pub fn texts(&self) -> &[String] {
        &self.texts
    }

    /// The text of a label; empty for [`Label::MISSING`].
    pub fn text(&self, label: Label) -> &str {
        self.texts.get(label.index()).map_or("", String::as_str)
    }
}
