//! The test command: what the README names and CI runs.

use std::path::Path;
use std::process::{Command, ExitCode};
use std::time::Instant;

use crate::places::MEASURE;
use crate::{browser, fuzz, places, python};

/// One thing that must hold.
struct Step {
    name: &'static str,
    program: &'static str,
    arguments: &'static [&'static str],
    environment: &'static [(&'static str, &'static str)],
    /// Where the program is missing, the step is left out with these words.
    optional: Option<&'static str>,
}

const STEPS: &[Step] = &[
    Step {
        name: "format",
        program: "cargo",
        arguments: &["fmt", "--all", "--", "--check"],
        environment: &[],
        optional: None,
    },
    Step {
        name: "lints",
        program: "cargo",
        arguments: &[
            "clippy",
            "--workspace",
            "--all-targets",
            "--locked",
            "--features",
            MEASURE,
            "--",
            "-D",
            "warnings",
        ],
        environment: &[],
        optional: None,
    },
    Step {
        name: "tests",
        program: "cargo",
        arguments: &["test", "--workspace", "--locked", "--features", MEASURE],
        environment: &[("RUST_BACKTRACE", "0")],
        optional: None,
    },
    Step {
        name: "documentation",
        program: "cargo",
        arguments: &["doc", "--workspace", "--no-deps", "--locked", "--features", MEASURE],
        environment: &[("RUSTDOCFLAGS", "-D warnings")],
        optional: None,
    },
    Step {
        name: "dependencies",
        program: "cargo-deny",
        arguments: &["deny", "check", "licenses", "bans", "sources"],
        environment: &[],
        optional: Some("cargo-deny is not installed: cargo install --locked cargo-deny"),
    },
];

/// What is more than one command: its name, what it does, and how.
type Other = (&'static str, &'static str, fn() -> Result<(), String>);

const OTHERS: &[Other] = &[
    (OTHER_REGISTERS, "the registers of other processors compile", other_processor),
    ("fuzz", "the program on damaged files", fuzz::short),
    ("python", "the wheel in a fresh environment, and its tests", python::run),
    ("browser", "the report in Chromium", browser::run),
];

/// Says what will be done, and what that installs.
fn announce(only: Option<&str>) {
    let all = STEPS.iter().map(|step| step.name).chain(OTHERS.iter().map(|other| other.0));
    let chosen: Vec<&str> = all.filter(|name| only.is_none_or(|word| name.contains(word))).collect();
    println!("== steps: {}", chosen.join(", "));
    println!("   all of them take 20 to 45 minutes from nothing on two cores; --only NAME runs one");
    let installs = [
        (
            "python",
            "the packages of python/tests/requirements.txt into an environment in the target directory; the module `venv` by apt-get, where \
             it is missing",
        ),
        ("browser", "packages of npm into the target directory; Chromium by apt-get, where it is missing"),
    ];
    for (step, what) in installs.iter().filter(|(step, _)| chosen.contains(step)) {
        println!("   {step} installs {what}");
    }
    println!();
}

/// Runs the steps in order and stops at the first that fails.
pub(crate) fn run(only: Option<&str>) -> ExitCode {
    announce(only);
    if let Err(message) = minimum_toolchain() {
        eprintln!("toolchain: {message}");
        return ExitCode::FAILURE;
    }
    let begun = Instant::now();
    for step in STEPS.iter().filter(|step| only.is_none_or(|word| step.name.contains(word))) {
        let started = Instant::now();
        println!("== {}: {} {}", step.name, step.program, step.arguments.join(" "));
        match step.run() {
            Outcome::Passed => println!("== {} passed in {:.0} s\n", step.name, started.elapsed().as_secs_f64()),
            Outcome::LeftOut(why) => println!("== {} left out: {why}\n", step.name),
            Outcome::Failed(why) => {
                eprintln!("== {} failed: {why}", step.name);
                return ExitCode::FAILURE;
            }
        }
    }
    for (name, what, run) in OTHERS.iter().filter(|(name, ..)| only.is_none_or(|word| name.contains(word))) {
        if let Some(why) = left_out(name) {
            println!("== {name} left out: {why}\n");
            continue;
        }
        let started = Instant::now();
        println!("== {name}: {what}");
        match run() {
            Ok(()) => println!("== {name} passed in {:.0} s\n", started.elapsed().as_secs_f64()),
            Err(why) => {
                eprintln!("== {name} failed: {why}");
                return ExitCode::FAILURE;
            }
        }
    }
    println!("everything holds, in {:.0} s", begun.elapsed().as_secs_f64());
    ExitCode::SUCCESS
}

enum Outcome {
    Passed,
    LeftOut(&'static str),
    Failed(String),
}

impl Step {
    fn run(&self) -> Outcome {
        let mut command = Command::new(self.program);
        command.args(self.arguments).current_dir(places::root()).envs(self.environment.iter().copied());
        command.env("CARGO_INCREMENTAL", "0"); // a run from nothing to the end has no use for it, and it takes disk space
        match (command.status(), self.optional) {
            (Ok(status), _) if status.success() => Outcome::Passed,
            (Ok(status), _) => Outcome::Failed(status.to_string()),
            (Err(error), Some(why)) if error.kind() == std::io::ErrorKind::NotFound => Outcome::LeftOut(why),
            (Err(error), _) => Outcome::Failed(error.to_string()),
        }
    }
}

/// The step that checks it.
const OTHER_REGISTERS: &str = "neon";

/// A processor whose registers have code of their own, which is not compiled here.
const OTHER_PROCESSOR: &str = "aarch64-unknown-linux-gnu";

/// Why a step is left out here.
fn left_out(name: &str) -> Option<String> {
    let is_missing = name == OTHER_REGISTERS && !has_other_processor();
    is_missing.then(|| format!("its standard library is not installed: rustup target add {OTHER_PROCESSOR}"))
}

/// Its standard library is installed.
fn has_other_processor() -> bool {
    let output = Command::new("rustc").args(["--print", "sysroot"]).current_dir(places::root()).output();
    let output = output.ok().filter(|output| output.status.success());
    output.is_some_and(|output| {
        let root = String::from_utf8_lossy(&output.stdout).trim().to_owned();
        Path::new(&root).join("lib/rustlib").join(OTHER_PROCESSOR).is_dir()
    })
}

/// Checks the code of another processor.
fn other_processor() -> Result<(), String> {
    let mut check = Command::new("cargo");
    check.args(["check", "--locked", "--package", "kalfit-lanes", "--target", OTHER_PROCESSOR]);
    let status = check.current_dir(places::root()).status().map_err(|e| e.to_string())?;
    if status.success() { Ok(()) } else { Err(status.to_string()) }
}

/// The stated minimum is tested when the toolchain at hand is that minimum; a newer one is said to be newer.
fn minimum_toolchain() -> Result<(), String> {
    let stated = env!("CARGO_PKG_RUST_VERSION");
    let output = Command::new("rustc").arg("--version").output().map_err(|e| e.to_string())?;
    let version = String::from_utf8_lossy(&output.stdout).trim().to_owned();
    let at_hand = version.split_whitespace().nth(1).unwrap_or_default();
    if at_hand.starts_with(stated) {
        println!("== toolchain: {version}, the minimum that Cargo.toml states\n");
    } else {
        println!("== toolchain: {version}; the stated minimum, {stated}, is tested where that is installed\n");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each of them is somebody's to look after: one more is to be noticed (docs/decisions/0004-libraries.md).
    #[test]
    fn dependencies_are_no_more_than_were_agreed() {
        let lock = std::fs::read_to_string(places::root().join("Cargo.lock")).expect("it is in the repository");
        let packages = lock.lines().filter(|line| line.starts_with("source = ")).count(); // our own crates have none
        assert!(packages <= 241, "Cargo.lock holds {packages} packages of others, expected no more than 241");
    }
}
