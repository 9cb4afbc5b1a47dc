//! Links of the book lead to pages of the book, and every page is in its table of contents.

use std::collections::BTreeSet;
use std::path::{Component, Path, PathBuf};

use crate::page::Page;
use crate::root;

/// `a/b/../c` → `a/c`, so that a link out of the book can be told.
fn plain(path: &Path) -> PathBuf {
    path.components().fold(PathBuf::new(), |mut plain, part| {
        if part == Component::ParentDir {
            plain.pop();
        } else {
            plain.push(part);
        }
        plain
    })
}

#[test]
fn links_lead_to_pages_of_the_book() {
    let pages = Page::all();
    let known: BTreeSet<PathBuf> = pages.iter().map(|page| PathBuf::from(&page.path)).collect();
    let mut wrong = Vec::new();
    for page in &pages {
        let whole = page.whole();
        let text = whole.split("```").step_by(2); // what is not a block
        for target in text.flat_map(|text| text.split("](").skip(1)).filter_map(|rest| rest.split_once(')')) {
            let target = target.0.split('#').next().unwrap_or_default();
            let place = plain(&Path::new(&page.path).parent().unwrap().join(target));
            if !target.is_empty() && !target.contains("://") && !known.contains(&place) {
                wrong.push(format!("{}: {target}", page.path));
            }
        }
    }
    assert!(wrong.is_empty(), "links that lead nowhere:\n{}", wrong.join("\n"));
}

#[test]
fn every_page_is_in_the_table_of_contents() {
    let known: BTreeSet<String> = Page::all().into_iter().map(|page| page.path).collect();
    let base = root().join("book/src");
    let mut folders = vec![base.clone()];
    while let Some(folder) = folders.pop() {
        for path in folder.read_dir().unwrap().map(|entry| entry.unwrap().path()) {
            let name = path.strip_prefix(&base).unwrap().display().to_string();
            if path.is_dir() {
                folders.push(path);
            } else if name.ends_with(".md") && name != "SUMMARY.md" {
                assert!(known.contains(&name), "{name} is not in SUMMARY.md");
            }
        }
    }
}
