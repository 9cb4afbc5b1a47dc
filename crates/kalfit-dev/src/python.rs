//! The Python package: its wheel, built and installed into a fresh environment, and its tests.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::places;
use crate::places::MEASURE;

/// Where things are.
struct PythonPlaces {
    /// The project.
    root: &'static Path,
    /// What cargo builds.
    target: PathBuf,
    /// The environment.
    environment: PathBuf,
}

impl PythonPlaces {
    fn new() -> Result<PythonPlaces, String> {
        let target = places::target()?;
        Ok(PythonPlaces { environment: target.join("python-tests"), root: places::root(), target })
    }

    fn python(&self) -> PathBuf {
        self.environment.join(if cfg!(windows) { "Scripts/python.exe" } else { "bin/python" })
    }

    fn run(&self, program: &Path, arguments: &[&str]) -> Result<(), String> {
        let mut command = Command::new(program);
        command.args(arguments).current_dir(self.root).env("CARGO_TARGET_DIR", &self.target);
        command.env("CARGO_INCREMENTAL", "0").env("KALFIT_COMMAND", places::kalfit(&self.target, "debug"));
        command.env("PIP_DISABLE_PIP_VERSION_CHECK", "1").env_remove("PYTHONPATH");
        let shown = format!("{} {}", program.display(), arguments.join(" "));
        println!("   {shown}");
        match command.status() {
            Ok(status) if status.success() => Ok(()),
            Ok(status) => Err(format!("{shown}: {status}")),
            Err(error) => Err(format!("{shown}: {error}")),
        }
    }
}

/// Builds the wheel, installs it where nothing else is, and runs its tests there.
pub(crate) fn run() -> Result<(), String> {
    let places = PythonPlaces::new()?;
    environment(&places)?;
    let python = places.python();
    places.run(&python, &["-m", "pip", "install", "--quiet", "--requirement", "python/tests/requirements.txt"])?;
    spark(&places)?;
    // the program as the tests have built it, with all that they need, so that nothing is built twice
    let tests = ["test", "--quiet", "--locked", "--workspace", "--no-run", "--features", MEASURE];
    places.run(Path::new("cargo"), &tests)?;
    let wheels = places.environment.join("wheels");
    let folder = wheels.to_str().ok_or("the target folder has no name in UTF-8")?;
    // the profile of the other tests: what they have built of it is used again
    places.run(&python, &["-m", "maturin", "build", "--quiet", "--locked", "--profile", "dev", "--out", folder])?;
    let wheel = only_wheel(&wheels)?;
    places
        .run(&python, &["-m", "pip", "install", "--quiet", "--no-index", "--no-deps", "--force-reinstall", &wheel])?;
    places.run(&python, &["-m", "pytest", "python/tests"])
}

/// Spark itself is tried where there is Java to run it.
fn spark(places: &PythonPlaces) -> Result<(), String> {
    if Command::new("java").arg("-version").output().is_ok_and(|done| done.status.success()) {
        return places.run(&places.python(), &["-m", "pip", "install", "--quiet", "pyspark>=3.4"]);
    }
    println!("   there is no Java: Spark itself is not tried");
    Ok(())
}

/// A fresh environment.
fn environment(places: &PythonPlaces) -> Result<(), String> {
    let system = Path::new(if cfg!(windows) { "python" } else { "python3" });
    let works = |code: &str| Command::new(system).args(["-c", code]).output().is_ok_and(|done| done.status.success());
    if !works("import sys; sys.exit(sys.version_info < (3, 10))") {
        return Err("Python 3.10 or newer is needed, as `python3`".to_owned());
    }
    if !works("import ensurepip, venv") {
        println!("   python3 has no module `venv`: trying to install it");
        let install = "apt-get update -qq && apt-get install -y -qq python3-venv";
        let installed = Command::new("sh").args(["-c", install]).status().is_ok_and(|status| status.success());
        if !installed || !works("import ensurepip, venv") {
            return Err("python3 cannot make environments: install its module `venv`, on Debian and Ubuntu by `apt install python3-venv`".to_owned());
        }
    }
    let folder = places.environment.to_str().ok_or("the target folder has no name in UTF-8")?;
    places.run(system, &["-m", "venv", "--clear", folder])
}

/// The wheel that was built.
fn only_wheel(folder: &Path) -> Result<String, String> {
    let entries = folder.read_dir().map_err(|error| format!("{}: {error}", folder.display()))?;
    let paths = entries.filter_map(|entry| Some(entry.ok()?.path()));
    let wheels: Vec<PathBuf> = paths.filter(|path| path.extension().is_some_and(|kind| kind == "whl")).collect();
    match &wheels[..] {
        [wheel] => Ok(wheel.display().to_string()),
        _ => Err(format!("found {} wheels in {}, expected one", wheels.len(), folder.display())),
    }
}
