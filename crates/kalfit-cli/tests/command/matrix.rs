//! Every command on every example and template: each ends well, or with a refusal that is listed here.

use crate::folder::{Folder, shown};
use crate::unit_means;

/// Commands in an order in which each finds the files of those before it, with the beginnings of the messages that are
/// in order where the model or the data are not those that the command is for.
const COMMANDS: [(&str, &[&str]); 23] = [
    ("check m.toml d.csv", &[]),
    ("fit m.toml d.csv --max-iterations 4 --out fit.json --report fit.html", &[]),
    ("reduce m.toml d.csv --at fit.json --out reductions.parquet", &[]),
    ("estimates m.toml d.csv --out estimates.parquet", NO_ESTIMATES),
    ("sums m.toml d.csv --out site.sums", &[]),
    ("join m.toml site.sums --out theta.json", &[]),
    ("test m.toml d.csv --null null.toml", &["cannot test this hypothesis: "]),
    ("simulate m.toml --from fit.json --design d.csv --seed 1 --out drawn.csv", &[]),
    ("plan m.toml --from fit.json --design d.csv --tests 5,10", &["how many groups of level `"]),
    ("plan m.toml --from fit.json --design d.csv --tests 5 --groups batch=4", &["found groups of `batch`, expected"]),
    ("apply m.toml d.csv --from fit.json --out tests.csv --states states.csv", &[]),
    ("apply m.toml d.csv --from fit.json --states states.csv --kind filtered", &[]),
    ("apply m.toml drawn.csv --from fit.json --states states.csv --kind predicted", &[]),
    ("predict m.toml --from fit.json --design d.csv --out mission.csv", &[]),
    ("predict m.toml --from fit.json --design d.csv --units known", &["`--units known` has no effect"]),
    ("export m.toml --from fit.json --as json --out filter.json", NO_FILTER),
    ("export m.toml --from fit.json --step 0.01 --as c --out filter.c", NO_FILTER),
    ("datasheet m.toml --from fit.json", &[]),
    ("datasheet m.toml --from fit.json d.csv", &[]),
    ("compare fit.json other.json", &[]),
    ("report fit.json --out again.html", &[]),
    ("plot fit.json --out figure.svg", &[]),
    ("validate m.toml d.csv --folds 2", &[]),
];

/// Estimates are those of a `[filter]`.
const NO_ESTIMATES: &[&str] = &[
    "cannot write `estimates.parquet`: the model has levels of groups",
    "d.csv, row 2: found rows of phase `",
    "no value is given for parameter `",
];
/// A filter of constant matrices is wanted.
const NO_FILTER: &[&str] = &[
    "the filter has no constant matrices: ",
    "the model has the phases `",
    "a step of 0.01 has no effect: the rows of the model have no times",
];
/// Words that no message for a user has.
const INTERNAL: [&str; 4] = ["panicked", "unwrap", "NaN", "src/"];

/// Runs all commands on a model and its data, both by their paths from this crate.
fn every_command(model: &str, data: &str) {
    let folder = Folder::new(&[("null.toml", b"[covariance]\nstructure = \"diagonal\"\n")]);
    for (path, name) in [(model, "m.toml"), (data, "d.csv")] {
        folder.copy(path);
        let copied = path.rsplit('/').next().unwrap_or_default();
        std::fs::rename(folder.path(copied), folder.path(name)).unwrap_or_else(|error| panic!("{path}: {error}"));
    }
    let mut wrong = Vec::new();
    for (command, refusals) in COMMANDS {
        let output = folder.run(&format!("{command} --quiet"));
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        let is_refused = |start: &&&str| message.starts_with(&format!("error: {start}"));
        let ended = match output.status.code() {
            Some(0) => true,
            // few iterations do not always reach the maximum
            Some(1) => command.starts_with("fit ") || command.starts_with("validate ") || command.starts_with("test "),
            Some(2) => refusals.iter().any(|start| is_refused(&start)),
            _ => false,
        };
        if !ended || INTERNAL.iter().any(|word| message.contains(word)) {
            wrong.push(format!("kalfit {command}\n{}", shown(&output)));
        }
        if command.starts_with("fit ") {
            let record = std::fs::read(folder.path("fit.json")).unwrap_or_default();
            folder.write("other.json", &record);
        }
    }
    assert!(wrong.is_empty(), "{model}:\n{}", wrong.join("\n"));
}

/// One test for each model, so that they run side by side.
macro_rules! every_command_runs_on {
    ($($name:ident: $model:literal, $data:literal;)*) => {
        $(#[test]
        fn $name() {
            every_command($model, $data);
        })*
    };
}

every_command_runs_on! {
    every_command_on_pastes: "../../examples/levels/pastes.toml", "../../examples/levels/pastes.csv";
    every_command_on_platform: "../../examples/two-phase/platform.toml", "../../examples/two-phase/platform.csv";
    every_command_on_sleepstudy:
        "../../examples/random-coefficients/sleepstudy.toml", "../../examples/random-coefficients/sleepstudy.csv";
    every_command_on_berkey:
        "../../examples/meta-analysis/berkey1998.toml", "../../examples/meta-analysis/berkey1998.csv";
    every_command_on_ovary: "../../examples/gauss-markov/ovary.toml", "../../examples/gauss-markov/ovary.csv";
    every_command_on_bench: "../../examples/gyro-bench/bench.toml", "../../examples/gyro-bench/bench.csv";
    every_command_on_the_template_random_coefficients:
        "templates/random-coefficients.toml", "templates/random-coefficients.csv";
    every_command_on_the_template_meta_analysis: "templates/meta-analysis.toml", "templates/meta-analysis.csv";
    every_command_on_the_template_gyro_bench: "templates/gyro-bench.toml", "templates/gyro-bench.csv";
    every_command_on_the_template_static_imu: "templates/static-imu.toml", "templates/static-imu.csv";
    every_command_on_the_template_two_phase: "templates/two-phase.toml", "templates/two-phase.csv";
    every_command_on_the_template_levels: "templates/levels.toml", "templates/levels.csv";
    every_command_on_the_template_six_position: "templates/six-position.toml", "templates/six-position.csv";
    every_command_on_the_template_moderators: "templates/moderators.toml", "templates/moderators.csv";
}

/// States that vary at some levels only.
#[test]
fn every_command_on_levels_of_some_states() {
    let folder = Folder::new(&[
        ("some.toml", unit_means::SOME_STATES.as_bytes()),
        ("some.csv", unit_means::rows(1.0).as_bytes()),
    ]);
    let [model, data] = ["some.toml", "some.csv"].map(|name| folder.path(name).display().to_string());
    every_command(&model, &data);
}
