//! The theory page maps equations to functions that exist.

use std::path::Path;

use crate::page::Page;
use crate::root;

/// Whether a file defines something of this name.
fn defines(file: &Path, name: &str) -> bool {
    let text = std::fs::read_to_string(file).unwrap_or_default();
    let follows = |at: usize| !text[at..].starts_with(|c: char| c.is_alphanumeric() || c == '_');
    ["fn ", "struct ", "enum "].iter().any(|kind| {
        let whole = format!("{kind}{name}");
        text.match_indices(&whole).any(|(at, _)| follows(at + whole.len()))
    })
}

#[test]
fn functions_that_the_theory_page_names_exist() {
    let pages = Page::all();
    let page = pages.iter().find(|page| page.path == "theory.md").unwrap();
    let text = page.whole();
    let mut named = 0;
    for (before, after) in text.match_indices("` in `").map(|(at, link)| (&text[..at], &text[at + link.len()..])) {
        let name = before.rsplit('`').next().unwrap_or_default();
        let file = after.split('`').next().unwrap_or_default();
        let path = root().join("crates").join(file);
        assert!(path.is_file(), "theory.md names the file {file}, which is not there");
        assert!(defines(&path, name), "theory.md names `{name}` in {file}, which has no such thing");
        named += 1;
    }
    assert!(named >= 40, "only {named} functions on the theory page");
}

#[test]
fn a_function_that_does_not_exist_is_seen() {
    let file = root().join("crates/kalfit-estimate/src/em.rs");
    assert!(defines(&file, "step") && !defines(&file, "ste") && !defines(&file, "leap"));
}
