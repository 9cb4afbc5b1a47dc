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
        write!(
            model,
            "[states.s{state}]\n[measurements.y{state}]\ncolumn = \"y{state}\"\nequation = \"s{state}\"\nnoise = 0.1\n"
        )
        .unwrap();
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
    let refused = "error: the fit of a model with 200 estimated states needs about 16 GB of memory, and there are ";
    let hint = "\n\nhint: half the states take a sixteenth of it";
    for args in ["fit many.toml many.csv --out fit.json", "check many.toml many.csv", "validate many.toml many.csv"] {
        let found = shown(&within(&folder, 4000, args));
        let error = found.strip_prefix("exit 2\n----- stdout\n----- stderr\n").unwrap_or_default();
        assert!(error.starts_with(refused) && error.contains(hint), "{args}: {found}");
    }
    assert_eq!(folder.contents(), before);
    // without data a check takes no more than the model
    let checked = shown(&within(&folder, 4000, "check many.toml"));
    assert!(checked.starts_with("exit 0"), "{checked}");
}

/// Runs the command on rows that never end.
fn endless(folder: &Folder, header: &str, row: &str) -> String {
    let kalfit = env!("CARGO_BIN_EXE_kalfit");
    let line = format!("ulimit -v 600000; (echo {header}; yes {row}) | '{kalfit}' check m.toml -");
    shown(&Command::new("sh").args(["-c", &line]).current_dir(folder.path("")).output().unwrap())
}

#[test]
fn a_test_that_does_not_end_is_refused_before_memory_does() {
    let folder = Folder::new(&[]);
    let found = endless(&folder, "id,x,y", "a,1,2");
    println!("{found}");
    assert!(found.starts_with("exit 2\n"), "{found}");
    assert!(found.contains(" are left, which may not be enough for more\n\nhint: see that the input ends"), "{found}");
}
