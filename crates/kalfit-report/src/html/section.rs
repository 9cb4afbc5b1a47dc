//! One part of the page.

use maud::Markup;

/// One part of the page.
pub(super) struct PageSection {
    /// Its anchor.
    pub(super) id: &'static str,
    pub(super) title: &'static str,
    pub(super) body: Markup,
}

impl PageSection {
    pub(super) fn new(id: &'static str, title: &'static str, body: Markup) -> Option<PageSection> {
        (!body.0.is_empty()).then_some(PageSection { id, title, body })
    }
}
