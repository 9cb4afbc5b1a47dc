//! Work that takes more memory than there is, or would if it were believed: it ends in a message, and writes nothing.

#![cfg(target_os = "linux")]
#![expect(clippy::unwrap_used, reason = "a test that cannot be set up must fail")]

use std::fmt::Write;
use std::process::{Command, Output};

use crate::folder::{Folder, shown};

/// Runs the command with so much address space, in megabytes.
fn within(folder: &Folder, megabytes: u64, args: &str) -> Output {
    let kalfit = env!("CARGO_BIN_EXE_kalfit");
    let line = format!("ulimit -v {} && exec '{kalfit}' {args}", megabytes << 10);
    Command::new("sh").args(["-c", &line]).current_dir(folder.path("")).output().unwrap()
}

/// A model of so many states, all estimated, and data of one column for each.
fn states(count: usize) -> (String, String) {
    let mut model = "[data]\ntest = \"id\"\n".to_owned();
    for state in 0..count {
        write!(model, "[states.s{state}]\n[measurements.y{state}]\ncolumn = \"y{state}\"\nequation = \"s{state}\"\nnoise = 0.1\n").unwrap();
    }
    let names: Vec<String> = (0..count).map(|state| format!("y{state}")).collect();
    let mut data = format!("id,{}\n", names.join(","));
    for test in 0..3 {
        let row: Vec<String> = (0..count).map(|state| (test * state % 7).to_string()).collect();
        writeln!(data, "{test},{}", row.join(",")).unwrap();
    }
    (model, data)
}

#[test]
fn more_states_than_memory_holds_are_refused_before_work_begins() {
    let (model, data) = states(200);
    let folder = Folder::new(&[("many.toml", model.as_bytes()), ("many.csv", data.as_bytes())]);
    let before = folder.contents();
    let refused = "\
exit 2
----- stdout
----- stderr
error: the fit of a model with 200 estimated states needs about 43 GB of memory, and there are 4 GB
  hint: half the states take a sixteenth of it; a state with `initial = \"stationary\"` or `initial = { mean = …, sigma = … }` is not estimated
";
    for args in ["fit many.toml many.csv --out fit.json", "check many.toml many.csv", "validate many.toml many.csv"] {
        assert_eq!(shown(&within(&folder, 4000, args)), refused, "{args}");
    }
    assert_eq!(folder.contents(), before);
    // without data a check takes no more than the model
    let checked = shown(&within(&folder, 4000, "check many.toml"));
    assert!(checked.starts_with("exit 0"), "{checked}");
}
