//! Where data come from: files, patterns of file names, standard input.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use crate::error::DataError;
use crate::memory::MemoryTable;

/// One source of rows.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Input {
    /// A file.
    Path(PathBuf),
    /// Standard input.
    Stdin,
    /// A table in memory.
    Table(MemoryTable),
}

/// Data as they are asked for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Datum {
    /// A file, a pattern of file names, or `-` for standard input.
    Named(String),
    /// A table in memory.
    Table(MemoryTable),
}

impl From<String> for Datum {
    fn from(name: String) -> Datum {
        Datum::Named(name)
    }
}

impl Input {
    /// The inputs that are meant, in their order: a table is itself, `-` is standard input, an existing path is itself,
    /// anything else with `*`, `?` or `[` is a pattern whose files come in alphabetical order (directories it matches
    /// are left out).
    ///
    /// # Errors
    /// No argument; a path that does not exist or is a directory; a pattern that matches no file; the same file twice,
    /// by whatever names.
    pub fn expand<D: Clone + Into<Datum>>(data: &[D]) -> Result<Vec<Input>, DataError> {
        let mut inputs = Vec::new();
        for datum in data {
            let arg = match datum.clone().into() {
                Datum::Named(arg) => arg,
                Datum::Table(table) => {
                    inputs.push(Input::Table(table));
                    continue;
                }
            };
            if arg == "-" {
                inputs.push(Input::Stdin);
            } else if !Path::new(&arg).exists() && arg.contains(['*', '?', '[']) {
                inputs.extend(matches(&arg)?.into_iter().map(Input::Path));
            } else {
                inputs.push(Input::Path(PathBuf::from(arg)));
            }
        }
        if inputs.is_empty() {
            return Err(DataError::NoInput);
        }
        refuse_repeats(&inputs)?;
        Ok(inputs)
    }

    /// What messages call it.
    pub fn name(&self) -> String {
        match self {
            Input::Path(path) => path.display().to_string(),
            Input::Stdin => "standard input".to_owned(),
            Input::Table(table) => table.name().to_owned(),
        }
    }

    /// The file's name without folder and extension; "stdin" for standard input.
    fn stem(&self) -> String {
        match self {
            Input::Path(path) => path.file_stem().unwrap_or(path.as_os_str()).to_string_lossy().into_owned(),
            Input::Stdin => "stdin".to_owned(),
            Input::Table(table) => table.name().to_owned(),
        }
    }

    /// The extension in lower case, without its dot.
    pub(crate) fn extension(&self) -> Option<String> {
        match self {
            Input::Path(path) => Some(path.extension()?.to_str()?.to_ascii_lowercase()),
            Input::Stdin | Input::Table(_) => None,
        }
    }

    /// The file, when it is one.
    pub fn path(&self) -> Option<&Path> {
        match self {
            Input::Path(path) => Some(path),
            Input::Stdin | Input::Table(_) => None,
        }
    }
}

/// Ids of the tests when each file is one: its stem, and for files that share a stem the path as given.
pub(crate) fn test_ids(inputs: &[Input]) -> Result<Vec<String>, DataError> {
    let stems: Vec<String> = inputs.iter().map(Input::stem).collect();
    let mut count: HashMap<&str, usize> = HashMap::new();
    for stem in &stems {
        *count.entry(stem).or_default() += 1;
    }
    let mut first: HashMap<String, usize> = HashMap::new();
    let mut ids = Vec::with_capacity(inputs.len());
    for (index, (input, stem)) in inputs.iter().zip(&stems).enumerate() {
        let shared = count[stem.as_str()] > 1 && input.path().is_some();
        let id = if shared { input.name() } else { stem.clone() };
        if let Some(&other) = first.get(&id) {
            return Err(DataError::SameTest { id, first: inputs[other].name(), second: input.name() });
        }
        first.insert(id.clone(), index);
        ids.push(id);
    }
    Ok(ids)
}

/// The files a pattern matches, sorted.
fn matches(pattern: &str) -> Result<Vec<PathBuf>, DataError> {
    let paths = glob::glob(pattern).map_err(|error| DataError::Pattern {
        pattern: pattern.to_owned(),
        position: error.pos + 1,
        reason: error.msg,
    })?;
    let mut found = Vec::new();
    for path in paths {
        let path =
            path.map_err(|error| DataError::Io { file: error.path().display().to_string(), source: error.into() })?;
        if !path.is_dir() {
            found.push(path);
        }
    }
    found.sort();
    if found.is_empty() { Err(DataError::NoMatch { pattern: pattern.to_owned() }) } else { Ok(found) }
}

fn refuse_repeats(inputs: &[Input]) -> Result<(), DataError> {
    let mut seen: HashMap<Option<PathBuf>, &Input> = HashMap::new();
    for (index, input) in inputs.iter().enumerate() {
        let identity = match input {
            Input::Stdin => None,
            Input::Table(table) => match inputs[..index].contains(input) {
                true => return Err(DataError::SameFile { first: input.name(), second: table.name().to_owned() }),
                false => continue,
            },
            Input::Path(path) => {
                Some(path.canonicalize().map_err(|source| DataError::Io { file: input.name(), source })?)
            }
        };
        if identity.as_ref().is_some_and(|path| path.is_dir()) {
            return Err(DataError::Directory { file: input.name() });
        }
        if let Some(first) = seen.insert(identity, input) {
            return Err(DataError::SameFile { first: first.name(), second: input.name() });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ids(paths: &[&str]) -> Result<Vec<String>, DataError> {
        let inputs: Vec<Input> =
            paths.iter().map(|p| if *p == "-" { Input::Stdin } else { Input::Path(p.into()) }).collect();
        test_ids(&inputs)
    }

    #[test]
    fn files_are_tests_by_their_stem_and_by_their_path_where_stems_are_shared() {
        let found = ids(&["runs/b.csv", "day1/a.csv", "day2/a.csv", "-", "stdin.csv"]).unwrap();
        assert_eq!(found, ["b", "day1/a.csv", "day2/a.csv", "stdin", "stdin.csv"]);
        assert!(matches!(ids(&["a.csv", "a.csv"]), Err(DataError::SameTest { .. })));
    }
}
