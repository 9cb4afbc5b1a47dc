//! One part of the page.

use maud::Markup;

/// One part of the page.
pub(super) struct Section {
    /// Its anchor.
    pub(super) id: &'static str,
    pub(super) title: &'static str,
    pub(super) body: Markup,
}

impl Section {
    pub(super) fn new(id: &'static str, title: &'static str, body: Markup) -> Option<Section> {
        (!body.0.is_empty()).then_some(Section { id, title, body })
    }
}
