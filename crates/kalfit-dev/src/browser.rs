//! The report in a real browser: fits are made, and a script drives Chromium over their pages.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::places;
use crate::places::MEASURE;

/// Names that Chromium goes by.
const BROWSERS: &[&str] = &["chromium", "chromium-browser", "google-chrome"];

/// One page to look at: the name, then model and data from the root of the repository.
struct BrowserPage {
    name: &'static str,
    model: &'static str,
    data: &'static str,
    options: &'static [&'static str],
}

const fn page(name: &'static str, model: &'static str, data: &'static str) -> BrowserPage {
    BrowserPage { name, model, data, options: &[] }
}

const PAGES: &[BrowserPage] = &[
    page("gyro-bench", "examples/gyro-bench/bench.toml", "examples/gyro-bench/bench.csv"),
    page("two-phase", "examples/two-phase/platform.toml", "examples/two-phase/platform.csv"),
    BrowserPage {
        options: &["--intervals", "profile"],
        ..page(
            "random-coefficients",
            "examples/random-coefficients/sleepstudy.toml",
            "examples/random-coefficients/sleepstudy.csv",
        )
    },
    page("hostile", "crates/kalfit-dev/tests/browser/hostile.toml", "crates/kalfit-dev/tests/browser/hostile.csv"),
    page(
        "unidentified",
        "crates/kalfit-dev/tests/browser/unidentified.toml",
        "crates/kalfit-dev/tests/browser/unidentified.csv",
    ),
];

/// Tests of the large ensemble: more than are listed or drawn.
const MANY: &str = "2500";

/// Makes the reports and runs the script over them.
pub(crate) fn run() -> Result<(), String> {
    let (root, target) = (places::root(), places::target()?);
    let scripts = root.join("crates/kalfit-dev/tests/browser");
    let work = target.join("browser");
    std::fs::create_dir_all(&work).map_err(|error| format!("cannot make {}: {error}", work.display()))?;
    let browser = browser()?;
    modules(&scripts, &work)?;
    let reports = reports(&ReportProgram { program: program(root, &target)?, root }, &work)?;
    let mut node = Command::new("node");
    node.arg(scripts.join("report.mjs")).arg(browser).arg(&work).args(reports);
    done(&mut node, "the browser test")
}

/// Chromium, installed first where it is missing and that can be done.
fn browser() -> Result<PathBuf, String> {
    if let Some(found) = find(BROWSERS) {
        return Ok(found);
    }
    println!("== Chromium is not installed: asking apt-get for it");
    let install = |arguments: &[&str]| {
        let mut apt = Command::new("apt-get");
        apt.args(arguments).env("DEBIAN_FRONTEND", "noninteractive");
        done(&mut apt, &format!("apt-get {}", arguments[0]))
    };
    let installed = install(&["update", "-qq"])
        .and_then(|()| install(&["install", "-y", "-qq", "--no-install-recommends", "chromium", "fonts-dejavu-core"]));
    find(BROWSERS).ok_or_else(|| {
        let why = installed.err().unwrap_or_else(|| "it is still not found".to_owned());
        format!(
            "the report is tested in Chromium, which is not installed and could not be: {why}; install it as `chromium`"
        )
    })
}

fn find(names: &[&str]) -> Option<PathBuf> {
    let folders: Vec<PathBuf> = std::env::split_paths(&std::env::var_os("PATH")?).collect();
    names.iter().flat_map(|name| folders.iter().map(move |folder| folder.join(name))).find(|path| path.is_file())
}

/// The packages that the script takes, at the versions of its lock file.
fn modules(scripts: &Path, work: &Path) -> Result<(), String> {
    if find(&["node"]).is_none() || find(&["npm"]).is_none() {
        return Err(
            "the report is tested by a script for Node.js, of which `node` or `npm` is not installed".to_owned()
        );
    }
    let lock =
        std::fs::read(scripts.join("package-lock.json")).map_err(|error| format!("package-lock.json: {error}"))?;
    let installed = work.join("node_modules/.package-lock.json").is_file();
    if installed && std::fs::read(work.join("package-lock.json")).is_ok_and(|old| old == lock) {
        return Ok(());
    }
    for name in ["package.json", "package-lock.json"] {
        std::fs::copy(scripts.join(name), work.join(name)).map_err(|error| format!("{name}: {error}"))?;
    }
    let mut npm = Command::new("npm");
    npm.args(["ci", "--silent", "--no-audit", "--no-fund", "--ignore-scripts"]).current_dir(work);
    done(&mut npm, "npm ci")
}

/// Fits all pages, and an ensemble too large to be shown test by test.
fn reports(kalfit: &ReportProgram<'_>, work: &Path) -> Result<Vec<PathBuf>, String> {
    let mut pages = Vec::new();
    for page in PAGES {
        let report = work.join(format!("{}.html", page.name));
        let mut arguments = words(&["fit", page.model, page.data, "--quiet", "--report"]);
        arguments.push(report.clone().into());
        arguments.extend(words(page.options));
        kalfit.run(arguments)?;
        pages.push(report);
    }
    let small = PAGES.iter().find(|page| page.name == "random-coefficients").ok_or("there is no small ensemble")?;
    let (drawn, results, report) = (work.join("many.csv"), work.join("many.json"), work.join("many.html"));
    let from = work.join("small.json");
    let mut first = words(&["fit", small.model, small.data, "--quiet", "--out"]);
    first.push(from.clone().into());
    kalfit.run(first)?;
    let mut simulate =
        words(&["simulate", small.model, "--design", small.data, "--tests", MANY, "--seed", "1", "--quiet"]);
    simulate.extend(["--from".into(), from.into(), "--out".into(), drawn.clone().into()]);
    kalfit.run(simulate)?;
    let mut fit = words(&["fit", small.model]);
    fit.extend([drawn.into(), "--quiet".into(), "--out".into(), results.clone().into()]);
    kalfit.run(fit)?;
    kalfit.run(vec!["report".into(), results.into(), "--quiet".into(), "--out".into(), report.clone().into()])?;
    pages.push(report);
    Ok(pages)
}

fn words(words: &[&str]) -> Vec<OsString> {
    words.iter().map(OsString::from).collect()
}

/// The program as the tests have built it, with all that they need, so that nothing is built twice.
fn program(root: &Path, target: &Path) -> Result<PathBuf, String> {
    let mut cargo = Command::new("cargo");
    cargo.args(["test", "--quiet", "--locked", "--workspace", "--no-run", "--features", MEASURE]).current_dir(root);
    cargo.env("CARGO_TARGET_DIR", target).env("CARGO_INCREMENTAL", "0"); // as the other steps
    done(&mut cargo, "cargo build")?;
    Ok(places::kalfit(target, "debug"))
}

/// The program in the root of the repository.
struct ReportProgram<'a> {
    program: PathBuf,
    root: &'a Path,
}

impl ReportProgram<'_> {
    fn run(&self, arguments: Vec<OsString>) -> Result<(), String> {
        done(Command::new(&self.program).args(arguments).current_dir(self.root), "kalfit")
    }
}

fn done(command: &mut Command, what: &str) -> Result<(), String> {
    match command.status() {
        Ok(status) if status.success() => Ok(()),
        Ok(status) => Err(format!("{what}: {status}")),
        Err(error) => Err(format!("{what} could not be started: {error}")),
    }
}
