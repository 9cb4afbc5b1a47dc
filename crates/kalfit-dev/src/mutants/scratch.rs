//! A copy of the workspace with switches in it, built once: mutants that do not compile give way to others.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use serde_json::Value;

use super::choose::{Mutant, chosen};
use super::rewrite::{MutantSwitch, rewritten};
use super::sources::GROUPS;
use crate::places;

/// The module that says which mutant is on.
const SWITCH: &str = include_str!("switch.rs");
/// Rounds of leaving out what does not compile: types first, then borrows.
const ROUNDS: usize = 12;

/// The file of changes that do not compile.
const REFUSED: &str = "does-not-compile";

/// The file of programs that were built.
const BUILT: &str = "built";

fn sources() -> PathBuf {
    places::root().join("crates")
}

/// The crates that mutants and their tests stand in: those of the changed files, and the one that users name.
fn packages() -> BTreeSet<&'static str> {
    let of = |file: &'static str| file.split('/').next();
    GROUPS.iter().flat_map(|group| group.files).filter_map(|(file, _)| of(file)).chain(["kalfit"]).collect()
}

/// Where the copy lies and what cargo builds of it.
pub(super) struct ScratchCopy {
    folder: PathBuf,
}

/// A program of tests.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct TestProgram {
    pub(super) name: String,
    pub(super) program: PathBuf,
    /// The folder of its crate, where it runs.
    pub(super) folder: PathBuf,
}

impl ScratchCopy {
    pub(super) fn new() -> Result<ScratchCopy, String> {
        let folder = places::target()?.join("mutants");
        std::fs::create_dir_all(&folder).map_err(|error| format!("{}: {error}", folder.display()))?;
        Ok(ScratchCopy { folder })
    }

    /// A file beside the copy.
    pub(super) fn file(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    fn work(&self) -> PathBuf {
        self.folder.join("work")
    }

    /// Keys of changes that are known not to compile.
    fn refused(&self) -> BTreeSet<String> {
        let known = std::fs::read_to_string(self.file(REFUSED)).unwrap_or_default();
        known.lines().map(str::to_owned).collect()
    }

    /// A sample of mutants, as far as it is known which of them compile.
    pub(super) fn sample(&self, sample: (usize, u64)) -> Result<Vec<Mutant>, String> {
        chosen(&sources(), sample, &self.refused())
    }

    /// Copies the workspace with a sample of mutants, all of which compile.
    pub(super) fn compiled(&self, sample: (usize, u64)) -> Result<Vec<Mutant>, String> {
        let mut refused = self.refused();
        for _ in 0..ROUNDS {
            let mutants = chosen(&sources(), sample, &refused)?;
            let switches = self.write(&mutants)?;
            let wrong = self.wrong(&switches)?;
            if wrong.is_empty() {
                return Ok(mutants);
            }
            println!("   {} of {} mutants do not compile, others take their place", wrong.len(), mutants.len());
            refused.extend(wrong.iter().map(|&k| mutants[k].key.clone()));
            let lines: Vec<&str> = refused.iter().map(String::as_str).collect();
            write(&self.file(REFUSED), format!("{}\n", lines.join("\n")))?;
        }
        Err(format!("after {ROUNDS} rounds there are still mutants that do not compile"))
    }

    /// Writes the copy; the switches by file.
    fn write(&self, mutants: &[Mutant]) -> Result<BTreeMap<String, Vec<MutantSwitch>>, String> {
        let mut changed: BTreeMap<&str, Vec<(usize, &super::find::SourceChange)>> = BTreeMap::new();
        for (k, mutant) in mutants.iter().enumerate() {
            changed.entry(mutant.file).or_default().push((k, &mutant.change));
        }
        let mut switches = BTreeMap::new();
        copy(places::root(), &self.work(), &mut |relative, text| {
            let file = relative.strip_prefix("crates/")?;
            let root = file.strip_suffix("/src/lib.rs").filter(|package| packages().contains(package));
            let mut text = text.to_owned();
            if let Some(changes) = changed.get(file) {
                let (changed, placed) = rewritten(&text, changes);
                switches.insert(relative.to_owned(), placed);
                text = changed;
            } else if root.is_none() {
                return None;
            }
            if root.is_some() {
                text.push_str(
                    "\n#[allow(dead_code, reason = \"a crate may have no mutant of the sample\")]\nmod mutant;\n",
                );
            }
            Some(text)
        })?;
        for package in packages() {
            write(&self.work().join("crates").join(package).join("src/mutant.rs"), SWITCH)?;
        }
        Ok(switches)
    }

    fn cargo(&self, words: &[&str]) -> Command {
        let mut cargo = Command::new("cargo");
        cargo.args(words).args(["--message-format", "json"]);
        for package in packages() {
            cargo.args(["--package", package]);
            // the switches are what is slow; a build takes longer than what it saves
            cargo.args(["--config", &format!("profile.dev.package.{package}.opt-level=1")]);
        }
        cargo.env("CARGO_TARGET_DIR", self.folder.join("target")).env("CARGO_INCREMENTAL", "0");
        cargo.current_dir(self.work()).stderr(Stdio::inherit());
        cargo
    }

    /// What cargo says, line by line, and whether it succeeded.
    fn said(&self, words: &[&str]) -> Result<(Vec<Value>, bool), String> {
        let done = self.cargo(words).output().map_err(|error| format!("cargo: {error}"))?;
        let text = String::from_utf8_lossy(&done.stdout).into_owned();
        Ok((text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect(), done.status.success()))
    }

    /// Mutants that do not compile.
    fn wrong(&self, switches: &BTreeMap<String, Vec<MutantSwitch>>) -> Result<BTreeSet<usize>, String> {
        let (said, success) = self.said(&["check", "--quiet", "--lib"])?;
        if success {
            return Ok(BTreeSet::new());
        }
        let mut wrong = BTreeSet::new();
        let mut rest = String::new();
        for message in said.iter().map(|line| &line["message"]).filter(|message| message["level"] == "error") {
            let spans = message["spans"].as_array().map_or(&[][..], Vec::as_slice);
            let hit = |primary: bool| {
                let spans = spans.iter().filter(move |span| span["is_primary"] == primary);
                spans.flat_map(|span| hits(span, switches)).collect::<Vec<usize>>()
            };
            let found = Some(hit(true)).filter(|found| !found.is_empty()).unwrap_or_else(|| hit(false));
            if found.is_empty() && !spans.is_empty() {
                rest.push_str(message["rendered"].as_str().unwrap_or_default());
            }
            wrong.extend(found);
        }
        if wrong.is_empty() { Err(format!("the copy does not compile:\n{rest}")) } else { Ok(wrong) }
    }

    /// Builds the programs of tests.
    pub(super) fn built(&self) -> Result<Vec<TestProgram>, String> {
        let (said, success) = self.said(&["test", "--no-run", "--quiet"])?;
        let of = |line: &Value| {
            let program = line["executable"].as_str()?;
            let name = line["target"]["name"].as_str()?;
            let folder = Path::new(line["manifest_path"].as_str()?).parent()?.to_owned();
            (line["profile"]["test"] == true).then(|| TestProgram {
                name: name.to_owned(),
                program: PathBuf::from(program),
                folder,
            })
        };
        let tests: Vec<TestProgram> = said.iter().filter_map(of).collect();
        if !success || tests.is_empty() {
            return Err("the tests of the copy were not built".to_owned());
        }
        let lines = tests
            .iter()
            .map(|tests| format!("{}\t{}\t{}\n", tests.name, tests.program.display(), tests.folder.display()));
        write(&self.file(BUILT), lines.collect::<String>())?;
        Ok(tests)
    }

    /// The programs of tests as they were built last.
    pub(super) fn as_built(&self) -> Result<Vec<TestProgram>, String> {
        let path = self.file(BUILT);
        let text = std::fs::read_to_string(&path).map_err(|error| format!("{}: {error}", path.display()))?;
        let of = |line: &str| {
            let [name, program, folder] = line.split('\t').collect::<Vec<&str>>()[..] else { return None };
            let (name, program, folder) = (name.to_owned(), PathBuf::from(program), PathBuf::from(folder));
            Some(TestProgram { name, program, folder })
        };
        Ok(text.lines().filter_map(of).collect())
    }
}

/// Mutants that a place in a message is in.
fn hits(span: &Value, switches: &BTreeMap<String, Vec<MutantSwitch>>) -> Vec<usize> {
    let at = |name: &str| span[name].as_u64().unwrap_or(0) as usize;
    let file = span["file_name"].as_str().unwrap_or_default().replace('\\', "/");
    let Some(placed) = switches.iter().find(|(path, _)| file.ends_with(path.as_str())) else { return Vec::new() };
    let inside = |switch: &&MutantSwitch| switch.range.start <= at("byte_start") && at("byte_end") <= switch.range.end;
    let within: Vec<usize> = placed.1.iter().filter(inside).map(|switch| switch.mutant).collect();
    if !within.is_empty() {
        return within;
    }
    let shared = |switch: &&MutantSwitch| switch.range.start < at("byte_end") && at("byte_start") < switch.range.end;
    placed.1.iter().filter(shared).map(|switch| switch.mutant).collect()
}

/// Copies a folder without what cargo, git and npm make; texts pass through a function. What is the same already is left alone, so
/// that cargo need not build it again.
fn copy(from: &Path, to: &Path, change: &mut impl FnMut(&str, &str) -> Option<String>) -> Result<(), String> {
    let root = from.to_owned();
    let mut folders = vec![from.to_owned()];
    while let Some(folder) = folders.pop() {
        let entries = std::fs::read_dir(&folder).map_err(|error| format!("{}: {error}", folder.display()))?;
        for entry in entries {
            let entry = entry.map_err(|error| error.to_string())?;
            let (path, name) = (entry.path(), entry.file_name().to_string_lossy().into_owned());
            if path.is_dir() {
                let made = ["target", "node_modules", "__pycache__", "dist"].contains(&name.as_str());
                if !made && (!name.starts_with('.') || name == ".cargo") {
                    folders.push(path);
                }
                continue;
            }
            let relative = path.strip_prefix(&root).unwrap_or(&path);
            let bytes = std::fs::read(&path).map_err(|error| format!("{}: {error}", path.display()))?;
            let words = relative.to_string_lossy().replace('\\', "/");
            let text = std::str::from_utf8(&bytes).ok().filter(|_| words.ends_with(".rs"));
            let text = text.and_then(|text| change(&words, text));
            write(&to.join(relative), text.as_ref().map_or(&bytes[..], |text| text.as_bytes()))?;
        }
    }
    Ok(())
}

fn write(path: &Path, bytes: impl AsRef<[u8]>) -> Result<(), String> {
    let failed = |error: std::io::Error| format!("{}: {error}", path.display());
    if std::fs::read(path).is_ok_and(|old| old == bytes.as_ref()) {
        return Ok(());
    }
    path.parent().map_or(Ok(()), std::fs::create_dir_all).map_err(failed)?;
    std::fs::write(path, bytes).map_err(failed)
}
