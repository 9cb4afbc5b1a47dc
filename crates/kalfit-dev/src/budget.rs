//! The cost of building: each budget of CONTRIBUTING beside the figure of this machine.

use std::path::PathBuf;
use std::process::{Command, ExitCode, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::places;

/// Crates whose kernels take long to compile.
const KERNELS: [&str; 4] = ["kalfit-lanes", "kalfit-algebra", "kalfit-filter", "kalfit-estimate"];

/// Options of the task.
#[derive(Debug, clap::Args)]
pub(crate) struct BudgetOptions {
    /// Also install the program and run the test command, each from nothing in folders of their own: half an hour or more.
    #[arg(long)]
    all: bool,
}

/// One figure beside what it may be.
struct BudgetLine {
    what: &'static str,
    found: String,
    budget: &'static str,
    holds: bool,
}

/// Measures and prints a table; fails where a budget does not hold.
pub(crate) fn run(options: &BudgetOptions) -> ExitCode {
    match measured(options) {
        Ok(lines) => {
            println!("\n| what | found | budget | |\n|---|--:|--:|---|");
            for BudgetLine { what, found, budget, holds } in &lines {
                println!("| {what} | {found} | {budget} | {} |", if *holds { "holds" } else { "does not hold" });
            }
            if lines.iter().all(|line| line.holds) { ExitCode::SUCCESS } else { ExitCode::FAILURE }
        }
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

fn measured(options: &BudgetOptions) -> Result<Vec<BudgetLine>, String> {
    let mut lines = vec![edited("kalfit-infer", "a line of inference changed, its unit tests run")?];
    lines.push(edited("kalfit-record", "a line of records changed, its unit tests run")?);
    if options.all {
        lines.extend(installed()?);
        lines.push(tested()?);
    }
    Ok(lines)
}

/// The seconds from a change of a crate to the end of its unit tests, and that no kernel is compiled between them.
fn edited(package: &'static str, what: &'static str) -> Result<BudgetLine, String> {
    let arguments = ["test", "--package", package, "--lib", "--message-format", "json"];
    run_quietly(&arguments)?; // all else is built before
    let root = places::root().join("crates").join(package).join("src/lib.rs");
    let now = std::time::SystemTime::now();
    let touched = std::fs::File::options().append(true).open(&root).and_then(|file| file.set_modified(now));
    touched.map_err(|error| format!("{}: {error}", root.display()))?;
    let started = Instant::now();
    let text = run_quietly(&arguments)?;
    let seconds = started.elapsed().as_secs_f64();
    let compiled = compiled(&text);
    println!("{package}: {seconds:.0} s, compiled {}", compiled.join(", "));
    let kernels = compiled.iter().filter(|name| KERNELS.contains(&name.as_str())).count();
    let holds = seconds <= 40.0 && kernels == 0;
    Ok(BudgetLine {
        what,
        found: format!("{seconds:.0} s, {kernels} crates with kernels compiled"),
        budget: "40 s, 0",
        holds,
    })
}

/// Names of the packages that cargo did not take as they were.
fn compiled(messages: &str) -> Vec<String> {
    let name = |line: &str| {
        let message: Value = serde_json::from_str(line).ok()?;
        let is_fresh = message["reason"] != "compiler-artifact" || message["fresh"] == true;
        let id = message["package_id"].as_str().filter(|_| !is_fresh)?;
        Some(id.split('#').next()?.rsplit('/').next()?.to_owned())
    };
    let mut names: Vec<String> = messages.lines().filter_map(name).collect();
    names.sort_unstable();
    names.dedup();
    names
}

fn run_quietly(arguments: &[&str]) -> Result<String, String> {
    let output = Command::new("cargo").args(arguments).current_dir(places::root()).stderr(Stdio::null()).output();
    let output = output.map_err(|error| format!("cargo: {error}"))?;
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    if output.status.success() { Ok(text) } else { Err(format!("cargo {} failed:\n{text}", arguments.join(" "))) }
}

/// A folder that did not exist.
fn empty_folder(name: &str) -> Result<PathBuf, String> {
    let folder = places::target()?.join(name);
    if folder.exists() {
        std::fs::remove_dir_all(&folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    }
    Ok(folder)
}

/// Minutes of processor time of an installation from nothing, and the size of the stripped program.
fn installed() -> Result<[BudgetLine; 2], String> {
    let (build, root) = (empty_folder("budget-build")?, empty_folder("budget-install")?);
    let mut install = Command::new("cargo");
    install.args(["install", "--locked", "--path", "crates/kalfit-cli", "--root"]).arg(&root);
    install.env("CARGO_TARGET_DIR", &build).current_dir(places::root());
    let before = children_time()?;
    succeeded(&mut install)?;
    let minutes = (children_time()? - before).as_secs_f64() / 60.0;
    let (program, stripped) = (root.join("bin/kalfit"), root.join("stripped"));
    succeeded(Command::new("strip").arg("-o").arg(&stripped).arg(&program))?;
    let bytes = std::fs::metadata(&stripped).map_err(|error| format!("{}: {error}", stripped.display()))?.len();
    let megabytes = bytes as f64 / 1e6;
    Ok([
        BudgetLine {
            what: "`cargo install` from nothing, processor time",
            found: format!("{minutes:.1} min"),
            budget: "10 min",
            holds: minutes <= 10.0,
        },
        BudgetLine {
            what: "the stripped program",
            found: format!("{megabytes:.1} MB"),
            budget: "25 MB",
            holds: megabytes <= 25.0,
        },
    ])
}

/// Minutes of the test command from nothing.
fn tested() -> Result<BudgetLine, String> {
    let build = empty_folder("budget-test")?;
    let started = Instant::now();
    let mut test = Command::new("cargo");
    succeeded(test.args(["dev", "test"]).env("CARGO_TARGET_DIR", &build).current_dir(places::root()))?;
    let minutes = started.elapsed().as_secs_f64() / 60.0;
    let found = format!("{minutes:.1} min");
    Ok(BudgetLine { what: "`cargo dev test` from nothing", found, budget: "25 min", holds: minutes <= 25.0 })
}

fn succeeded(command: &mut Command) -> Result<(), String> {
    let status = command.status().map_err(|error| format!("{}: {error}", command.get_program().display()))?;
    if status.success() { Ok(()) } else { Err(format!("{} failed: {status}", command.get_program().display())) }
}

/// Processor time of all processes that have ended so far.
#[cfg(unix)]
fn children_time() -> Result<Duration, String> {
    use nix::sys::resource::{UsageWho, getrusage};
    let usage = getrusage(UsageWho::RUSAGE_CHILDREN).map_err(|error| error.to_string())?;
    let micros = |time: nix::sys::time::TimeVal| time.tv_sec() as u64 * 1_000_000 + time.tv_usec() as u64;
    Ok(Duration::from_micros(micros(usage.user_time()) + micros(usage.system_time())))
}

/// Processor time is not known here.
#[cfg(not(unix))]
fn children_time() -> Result<Duration, String> {
    Err("processor time of other programs is measured on Unix only".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packages_that_were_compiled_are_named() {
        let messages = r#"{"reason":"compiler-artifact","package_id":"path+file:///a/crates/kalfit-infer#0.2.0","fresh":false}
{"reason":"compiler-artifact","package_id":"path+file:///a/crates/kalfit-filter#0.2.0","fresh":true}
{"reason":"build-finished","success":true}
test result: ok"#;
        assert_eq!(compiled(messages), ["kalfit-infer"]);
    }
}
