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

/// Pages beside the book.
fn beside_the_book() -> Vec<PathBuf> {
    let decisions = root().join("docs/decisions").read_dir().unwrap().map(|entry| entry.unwrap().path());
    ["README.md", "CONTRIBUTING.md", "CHANGELOG.md"]
        .map(|name| root().join(name))
        .into_iter()
        .chain(decisions)
        .collect()
}

#[test]
fn links_of_other_pages_lead_to_files() {
    let mut wrong = Vec::new();
    for path in beside_the_book() {
        let text = std::fs::read_to_string(&path).unwrap();
        let outside = text.split("```").step_by(2);
        for target in outside.flat_map(|text| text.split("](").skip(1)).filter_map(|rest| rest.split_once(')')) {
            let file = target.0.split_once('#').map_or(target.0, |(file, _)| file);
            if !file.contains("://") && !path.parent().unwrap().join(file).exists() {
                wrong.push(format!("{}: {}", path.display(), target.0));
            }
        }
    }
    assert!(wrong.is_empty(), "links that lead nowhere:\n{}", wrong.join("\n"));
}

/// The most characters of a line that is no row of a table and was not printed by a program.
const WIDTH: usize = 100;

#[test]
fn lines_are_short_enough_to_read_in_a_terminal() {
    let own = ["README.md", "CONTRIBUTING.md", "CHANGELOG.md"].map(|name| (name.to_owned(), root().join(name)));
    let wrapped = Page::all().into_iter().filter(|page| page.path != "speed.md");
    let pages = wrapped.map(|page| (page.path.clone(), page.file()));
    let mut wrong = Vec::new();
    for (name, file) in own.into_iter().chain(pages) {
        let text = std::fs::read_to_string(file).unwrap();
        let mut block = None;
        for (at, line) in text.lines().enumerate() {
            if let Some(info) = line.strip_prefix("```") {
                block = if block.is_some() { None } else { Some(info) };
            }
            let printed =
                block.is_some_and(|info| info == "text" || info.starts_with("console") && !line.starts_with('$'));
            let size = line.chars().count();
            if size > WIDTH && !printed && !line.starts_with('|') {
                wrong.push(format!("{name}, line {}: {size} characters", at + 1));
            }
        }
    }
    assert!(wrong.is_empty(), "lines of more than {WIDTH} characters:\n{}", wrong.join("\n"));
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
