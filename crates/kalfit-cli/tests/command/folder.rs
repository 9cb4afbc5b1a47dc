//! Runs the built command in a folder of its own.

#![expect(clippy::unwrap_used, reason = "a test that cannot be set up must fail")]

use std::collections::HashMap;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

/// A folder with a sound model `m.toml`, sound data `d.csv`, and whatever a test adds.
pub(crate) struct Folder(tempfile::TempDir);

pub(crate) const MODEL: &str = r#"[data]
test = "id"

[states.level]
[states.slope]

[measurements.y]
column = "y"
equation = "level + slope * x"
noise = 0.1
"#;

pub(crate) const DATA: &str =
    "id,x,y\na,0,1.1\na,1,2.0\na,2,3.2\nb,0,0.4\nb,1,0.9\nb,2,1.2\nc,0,2.0\nc,1,2.1\nc,2,2.3\n";

impl Folder {
    pub(crate) fn new(files: &[(&str, &[u8])]) -> Folder {
        let folder = Folder(tempfile::tempdir().unwrap());
        folder.write("m.toml", MODEL.as_bytes());
        folder.write("d.csv", DATA.as_bytes());
        files.iter().for_each(|(name, bytes)| folder.write(name, bytes));
        folder
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub(crate) fn write(&self, name: &str, bytes: &[u8]) {
        std::fs::write(self.path(name), bytes).unwrap();
    }

    /// Copies a file of this crate, by its path from here.
    pub(crate) fn copy(&self, path: &str) {
        let from = Path::new(env!("CARGO_MANIFEST_DIR")).join(path);
        let name = from.file_name().and_then(|name| name.to_str()).unwrap();
        std::fs::copy(&from, self.path(name)).unwrap_or_else(|error| panic!("{}: {error}", from.display()));
    }

    /// Names and contents of all files.
    pub(crate) fn contents(&self) -> Vec<(String, Vec<u8>)> {
        let read = |entry: std::io::Result<std::fs::DirEntry>| {
            let path = entry.unwrap().path();
            (path.display().to_string(), std::fs::read(&path).unwrap_or_default())
        };
        let mut all: Vec<_> = self.0.path().read_dir().unwrap().map(read).collect();
        all.sort();
        all
    }

    /// The rows of a table of text, each by the names of its columns.
    pub(crate) fn table(&self, name: &str) -> Vec<HashMap<String, String>> {
        let mut reader = csv::Reader::from_path(self.path(name)).unwrap();
        reader.deserialize().map(|row| row.unwrap()).collect()
    }

    /// The command, to be run in the folder.
    pub(crate) fn command(&self, args: &str) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_kalfit"));
        command
            .args(args.split_whitespace())
            .current_dir(self.0.path())
            .env_remove("NO_COLOR")
            .env_remove("CLICOLOR_FORCE")
            .env("COLUMNS", "100");
        command
    }

    pub(crate) fn run(&self, args: &str) -> Output {
        self.command(args).stdin(Stdio::null()).output().unwrap()
    }

    pub(crate) fn run_with_input(&self, args: &str, input: &[u8]) -> Output {
        let mut command = self.command(args);
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let _ = child.stdin.take().unwrap().write_all(input); // it may have given up reading
        child.wait_with_output().unwrap()
    }
}

/// Exit status, standard output and standard error.
pub(crate) fn shown(output: &Output) -> String {
    let text = |bytes: &[u8]| String::from_utf8(bytes.to_vec()).expect("output is UTF-8");
    let (out, err) = (text(&output.stdout), text(&output.stderr));
    assert!(!err.contains("panicked"), "it panicked:\n{err}");
    format!("exit {}\n----- stdout\n{out}----- stderr\n{err}", output.status.code().unwrap_or(-1))
}

/// The line on the work done differs from run to run, and with every change of the solver.
pub(crate) fn steady(text: &str) -> String {
    let steady = |line: &str| match line.starts_with("Computation: ") {
        true => line.split(',').next().unwrap_or_default().to_owned() + ", [work].\n",
        false => line.to_owned() + "\n",
    };
    text.lines().map(steady).collect()
}

/// The number in a column of a row of a table.
pub(crate) fn number(row: &HashMap<String, String>, column: &str) -> f64 {
    row[column].parse().unwrap_or_else(|_| panic!("{column}: {row:?}"))
}
