//! On a terminal and elsewhere: colours and the line of progress.

use std::process::{Command, Output};

use crate::folder::{Folder, shown};

const ESCAPE: char = '\u{1b}';

/// Standard output and standard error of a command that runs elsewhere than on a terminal, with these variables.
fn elsewhere(folder: &Folder, args: &str, variables: &[(&str, &str)]) -> (String, String) {
    let output = folder.command(args).envs(variables.iter().copied()).output().expect("it runs");
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("output is UTF-8");
    (text(output.stdout), text(output.stderr))
}

/// What a terminal is sent, with these variables; `script` is the terminal.
#[cfg(target_os = "linux")]
fn on_a_terminal(folder: &Folder, args: &str, variables: &[(&str, &str)]) -> String {
    let line = format!("'{}' {args}", env!("CARGO_BIN_EXE_kalfit"));
    let mut command = Command::new("script");
    command
        .args(["-q", "-e", "-c", &line, "/dev/null"])
        .current_dir(folder.path(""))
        .stdin(std::process::Stdio::null());
    // with `CI` set, colours are asked for whatever `TERM` says
    for name in ["NO_COLOR", "CLICOLOR", "CLICOLOR_FORCE", "CI"] {
        command.env_remove(name);
    }
    let Output { stdout, .. } =
        command.env("TERM", "xterm").envs(variables.iter().copied()).output().expect("`script` runs");
    String::from_utf8(stdout).expect("output is UTF-8")
}

/// A summary, an error with a place and a hint, the help, and an error of the command line.
const ALL: [&str; 4] = ["fit m.toml d.csv", "fit m.toml d.csv --set nothing=1", "fit --help", "fit --nothing"];

#[test]
fn elsewhere_there_is_no_colour_unless_it_is_forced() {
    let folder = Folder::new(&[]);
    for args in ALL {
        let (out, err) = elsewhere(&folder, args, &[]);
        assert!(!out.contains(ESCAPE) && !err.contains(ESCAPE), "{args}: {out}{err}");
        let (out, err) = elsewhere(&folder, args, &[("CLICOLOR_FORCE", "1")]);
        assert!(out.contains(ESCAPE) || err.contains(ESCAPE), "{args}: {out}{err}");
        let (out, err) = elsewhere(&folder, args, &[("CLICOLOR_FORCE", "1"), ("NO_COLOR", "1")]);
        assert!(!out.contains(ESCAPE) && !err.contains(ESCAPE), "{args}: {out}{err}");
    }
}

#[test]
#[cfg(target_os = "linux")]
fn terminals_have_colours_unless_nobody_wants_them() {
    let folder = Folder::new(&[]);
    for args in ALL {
        let shown = on_a_terminal(&folder, args, &[]);
        assert!(shown.contains(ESCAPE), "{args}: {shown}");
        for no in [("NO_COLOR", "1"), ("TERM", "dumb"), ("CLICOLOR", "0")] {
            let shown = on_a_terminal(&folder, args, &[no]);
            assert!(!shown.contains(ESCAPE), "{args}, {no:?}: {shown}");
            assert!(shown.len() > 20, "{args}, {no:?}: {shown}");
        }
        assert!(on_a_terminal(&folder, args, &[("NO_COLOR", "")]).contains(ESCAPE), "{args}: empty is not set");
    }
}

#[test]
#[cfg(target_os = "linux")]
fn who_waits_at_a_terminal_sees_how_far_it_is_and_how_long_it_takes() {
    let folder = Folder::new(&[]);
    let args = "simulate m.toml --from m.toml --design d.csv --seed 1 --out drawn.csv --tests 100000000";
    folder.write(
        "m.toml",
        (crate::folder::MODEL.to_owned()
            + "[mean]\nstart = { level = 1, slope = 0 }\n[covariance]\nstart = [[1, 0], [0, 1]]\n")
            .as_bytes(),
    );
    let line = format!("timeout --signal=INT 4 '{}' {args}", env!("CARGO_BIN_EXE_kalfit"));
    let mut command = Command::new("script");
    command
        .args(["-q", "-e", "-c", &line, "/dev/null"])
        .current_dir(folder.path(""))
        .stdin(std::process::Stdio::null());
    let output = command.env("TERM", "xterm").env("NO_COLOR", "1").output().expect("`script` runs");
    let seen = shown(&output);
    assert!(seen.contains(" %, about "), "{seen}");
    assert!(seen.contains(" left"), "{seen}");
    assert!(seen.contains("drawing: "), "{seen}");
    assert!(!folder.path("drawn.csv").exists(), "it was interrupted");
}

#[test]
fn elsewhere_nothing_is_said_of_progress() {
    let folder = Folder::new(&[]);
    folder.write(
        "m.toml",
        (crate::folder::MODEL.to_owned()
            + "[mean]\nstart = { level = 1, slope = 0 }\n[covariance]\nstart = [[1, 0], [0, 1]]\n")
            .as_bytes(),
    );
    let args = "simulate m.toml --from m.toml --design d.csv --seed 1 --out drawn.csv --tests 200000";
    let (out, err) = elsewhere(&folder, args, &[("CLICOLOR_FORCE", "1")]);
    assert_eq!((out.as_str(), err.as_str()), ("", "Wrote drawn.csv: 200000 tests, 600000 rows, drawn with seed 1\n"));
}
