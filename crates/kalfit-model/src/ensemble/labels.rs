//! Texts in the data, each stored once.

use std::collections::HashMap;

/// A text of the data, given by the index of the text in [`Labels`]. Different texts have different labels; the order
/// of labels has no meaning.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Label(u32);

impl Label {
    /// The label of an empty cell.
    pub const MISSING: Label = Label(u32::MAX);

    /// The label of literal `index` of the model whose literals [`Labels::new`] received.
    pub fn literal(index: usize) -> Label {
        Label(u32::try_from(index).expect("a model names fewer than 2^32 texts"))
    }

    /// Whether this is the label of an empty cell.
    pub fn is_missing(self) -> bool {
        self == Label::MISSING
    }

    /// Index of the text in [`Labels::texts`].
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

/// The texts of a data set. The literals of the model come first, so that literal k of the model is text k.
#[derive(Debug, Clone, Default)]
pub struct Labels {
    texts: Vec<String>,
    by_text: HashMap<String, Label>,
}

impl Labels {
    /// Texts that consist of the literals of a model, which must differ from each other.
    pub fn new(literals: &[String]) -> Labels {
        let mut labels = Labels::default();
        for text in literals {
            labels.intern(text);
        }
        labels
    }

    /// The label of a text; a new text is added.
    pub fn intern(&mut self, text: &str) -> Label {
        if let Some(&label) = self.by_text.get(text) {
            return label;
        }
        let label = Label::literal(self.texts.len());
        self.texts.push(text.to_owned());
        self.by_text.insert(text.to_owned(), label);
        label
    }

    /// All texts, by ascending label.
    pub fn texts(&self) -> &[String] {
        &self.texts
    }

    /// The text of a label; empty for [`Label::MISSING`].
    pub fn text(&self, label: Label) -> &str {
        self.texts.get(label.index()).map_or("", String::as_str)
    }
}
