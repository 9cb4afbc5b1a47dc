//! Files of results that cannot be written, or only some of them: exit status 2 says that nothing was, and nothing that was done is lost.

#![cfg(target_os = "linux")]
#![expect(clippy::unwrap_used, reason = "a test that cannot be set up must fail")]

use std::os::unix::fs::{PermissionsExt, symlink};
use std::process::{Command, Stdio};

use crate::folder::{Folder, shown};

/// Names of the files beside those that every folder has.
fn names(folder: &Folder) -> Vec<String> {
    let name = |(path, _): (String, Vec<u8>)| path.rsplit('/').next().unwrap_or_default().to_owned();
    folder.contents().into_iter().map(name).filter(|name| name != "m.toml" && name != "d.csv").collect()
}

/// Runs the command with a full disk for standard output.
fn unheard(folder: &Folder, args: &str) -> String {
    let full = std::fs::File::options().write(true).open("/dev/full").unwrap();
    shown(&folder.command(args).stdin(Stdio::null()).stdout(full).stderr(Stdio::piped()).output().unwrap())
}

#[test]
fn a_full_standard_output_does_not_undo_files() {
    let folder = Folder::new(&[]);
    let error = "error: cannot write to standard output: No space left on device (os error 28)\n";
    let nothing = unheard(&folder, "fit m.toml d.csv");
    assert_eq!(nothing, format!("exit 2\n----- stdout\n----- stderr\n{error}"));
    assert!(names(&folder).is_empty());
    let some = unheard(&folder, "fit m.toml d.csv --out fit.json");
    assert_eq!(some, format!("exit 1\n----- stdout\n----- stderr\nWrote fit.json\n{error}"));
    assert_eq!(names(&folder), ["fit.json"]);
}

#[test]
fn files_that_can_be_written_are() {
    let folder = Folder::new(&[]);
    // no file may be larger than 100 kB: the results are not, the page is
    let limited = |args: &str| {
        let kalfit = env!("CARGO_BIN_EXE_kalfit");
        let line = format!("trap '' XFSZ; ulimit -f 200; exec '{kalfit}' {args}");
        shown(&Command::new("sh").args(["-c", &line]).current_dir(folder.path("")).output().unwrap())
    };
    let some = limited("fit m.toml d.csv --out fit.json --report fit.html");
    assert!(some.starts_with("exit 1\n"), "{some}");
    assert!(some.ends_with("Wrote fit.json\nerror: cannot write `fit.html`: File too large (os error 27)\n"), "{some}");
    assert_eq!(names(&folder), ["fit.json"]);
    std::fs::remove_file(folder.path("fit.json")).unwrap();
    let nothing = limited("fit m.toml d.csv --report fit.html");
    assert!(nothing.starts_with("exit 2\n"), "{nothing}");
    let pages = limited("man pages");
    assert!(pages.starts_with("exit 0\n"), "{pages}");
    let names = names(&folder);
    assert_eq!(names, ["pages"]);
}

#[test]
fn links_stay_links_also_to_what_is_not_there_yet() {
    let folder = Folder::new(&[]);
    symlink("new.json", folder.path("link.json")).unwrap();
    symlink("nowhere/new.json", folder.path("astray.json")).unwrap();
    symlink("round.json", folder.path("round.json")).unwrap();
    let written = shown(&folder.run("fit m.toml d.csv --quiet --out link.json"));
    assert_eq!(written, "exit 0\n----- stdout\n----- stderr\n");
    assert!(folder.path("link.json").is_symlink() && !folder.path("new.json").is_symlink());
    let astray = shown(&folder.run("fit m.toml d.csv --out astray.json"));
    assert!(astray.contains("error: the folder `nowhere` for the output does not exist"), "{astray}");
    let round = shown(&folder.run("fit m.toml d.csv --out round.json"));
    assert!(round.starts_with("exit 2\n") && round.contains("error: cannot write `round.json`: "), "{round}");
}

#[test]
fn what_cannot_be_replaced_is_found_before_work() {
    let folder = Folder::new(&[("kept.json", b"{}")]);
    std::fs::set_permissions(folder.path("kept.json"), std::fs::Permissions::from_mode(0o444)).unwrap();
    let refused = shown(&folder.run("fit m.toml d.csv --out kept.json"));
    assert!(refused.starts_with("exit 2\n"), "{refused}");
    assert!(
        refused.contains("error: the output `kept.json` is read-only, expected a file that can be replaced"),
        "{refused}"
    );
    assert_eq!(std::fs::read(folder.path("kept.json")).unwrap(), b"{}");
    let long = format!("fit m.toml d.csv --out {}.json", "n".repeat(300));
    let refused = shown(&folder.run(&long));
    assert!(refused.starts_with("exit 2\n") && refused.contains("File name too long"), "{refused}");
}
