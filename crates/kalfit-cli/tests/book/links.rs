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

/// What mdBook makes of a heading.
fn slug(heading: &str) -> String {
    let kept = heading.trim().to_lowercase();
    let kept = kept.chars().filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'));
    kept.map(|c| if c == ' ' { '-' } else { c }).collect()
}

/// The headings of a page, outside its blocks.
fn headings(page: &Page) -> BTreeSet<String> {
    let whole = page.whole();
    let text = whole.split("```").step_by(2).collect::<Vec<_>>().join("\n");
    text.lines().filter(|line| line.starts_with('#')).map(|line| slug(line.trim_start_matches('#'))).collect()
}

#[test]
fn links_lead_to_pages_and_headings_of_the_book() {
    let pages = Page::all();
    let mut wrong = Vec::new();
    for page in &pages {
        let whole = page.whole();
        let text = whole.split("```").step_by(2); // what is not a block
        for target in text.flat_map(|text| text.split("](").skip(1)).filter_map(|rest| rest.split_once(')')) {
            let (file, heading) = target.0.split_once('#').unwrap_or((target.0, ""));
            let beside = plain(&Path::new(&page.path).parent().unwrap().join(file));
            let place = if file.is_empty() { PathBuf::from(&page.path) } else { beside };
            let leads = pages.iter().find(|other| Path::new(&other.path) == place);
            let found = leads.is_some_and(|other| heading.is_empty() || headings(other).contains(heading));
            if !file.contains("://") && !found {
                wrong.push(format!("{}: {}", page.path, target.0));
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
