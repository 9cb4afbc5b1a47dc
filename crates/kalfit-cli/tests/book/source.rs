//! What the sources say: public structures with their words, and whether a name exists.

use std::path::{Path, PathBuf};

use crate::root;

/// A structure, a field or an enumeration with what its documentation says.
pub(crate) struct Item {
    pub(crate) name: String,
    pub(crate) kind: String,
    pub(crate) words: String,
    pub(crate) attributes: String,
}

/// A structure and its public fields.
pub(crate) struct Structure {
    pub(crate) item: Item,
    pub(crate) fields: Vec<Item>,
}

/// All Rust files under a folder of the project, sorted.
pub(crate) fn files(folder: &str) -> Vec<PathBuf> {
    let mut open = vec![root().join(folder)];
    let mut found = Vec::new();
    while let Some(path) = open.pop() {
        if path.is_dir() {
            open.extend(path.read_dir().unwrap().map(|entry| entry.unwrap().path()));
        } else if path.extension().is_some_and(|end| end == "rs") {
            found.push(path);
        }
    }
    found.sort();
    found
}

/// The public structures of a file, also those within a macro that declares figures: there a field may go on, after
/// ` as ` or ` = `, with what only the macro reads.
pub(crate) fn structures(file: &Path) -> Vec<Structure> {
    let text = std::fs::read_to_string(file).unwrap();
    let mut found: Vec<Structure> = Vec::new();
    let (mut words, mut attributes) = (String::new(), String::new());
    let mut inside: Option<&str> = None; // the indentation of the open structure
    for line in text.lines() {
        let bare = line.trim();
        if let Some(said) = bare.strip_prefix("///") {
            if !words.is_empty() {
                words.push(' ');
            }
            words.push_str(said.trim());
            continue;
        }
        if bare.starts_with("#[") {
            attributes.push_str(bare);
            continue;
        }
        let (words, attributes) = (std::mem::take(&mut words), std::mem::take(&mut attributes));
        let item = |name: &str, kind: &str| Item { name: name.to_owned(), kind: kind.to_owned(), words, attributes };
        let indentation = &line[..line.len() - line.trim_start().len()];
        if let Some(name) = bare.strip_prefix("pub struct ").and_then(|rest| rest.strip_suffix(" {")) {
            inside = Some(indentation);
            let (name, _) = name.split_once('<').unwrap_or((name, "")); // without its lifetime
            found.push(Structure { item: item(name, "struct"), fields: Vec::new() });
        } else if bare == "}" && inside == Some(indentation) {
            inside = None;
        } else if let Some((name, kind)) = bare.strip_prefix("pub ").and_then(|rest| rest.split_once(": "))
            && inside.is_some()
        {
            let kind = [" as ", " = "].iter().fold(kind, |kind, end| kind.split(end).next().unwrap_or(kind));
            found.last_mut().expect("a structure is open").fields.push(item(name, kind.trim_end_matches(',')));
        }
    }
    found
}
