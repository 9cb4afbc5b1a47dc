//! Examples at the end of each `--help`. A test reads every one of them as if it had been typed.

pub(crate) const PROGRAM: &str = "\
Examples:
  kalfit init gyro-bench bench            a model to start from, and its data, in the folder `bench`
  kalfit fit bench/gyro-bench.toml bench/gyro-bench.csv --out fit.json --report fit.html
  kalfit check model.toml data.csv        before a fit: what the data can identify

Exit status: 0 success; 1 a fit did not converge, or a file could not be written beside others; 2 bad input, no file was \
written; 130 interrupted: a fit shows and writes the best so far, other commands write nothing.
Colours: on terminals, unless NO_COLOR is set; CLICOLOR_FORCE=1 or `--color always` asks for them everywhere.";

pub(crate) const INIT: &str = "\
Examples:
  kalfit init                             the templates, a line each
  kalfit init gyro-bench                  gyro-bench.toml and gyro-bench.csv in this folder
  kalfit init random-coefficients sleep   in the folder `sleep`, which is made if need be

Files that exist are never replaced.";

pub(crate) const SCHEMA: &str = "\
Examples:
  kalfit schema > kalfit-model.schema.json   beside the models
  kalfit schema | jq .properties.data        the keys of `[data]`

An editor that knows TOML uses it for a model file whose first line is `#:schema kalfit-model.schema.json`. \
`kalfit init` writes both.";

pub(crate) const FIT: &str = "\
Examples:
  kalfit fit model.toml data.csv
  kalfit fit model.toml 'runs/*.csv' --out fit.json --report fit.html
  kalfit fit model.toml data.csv --tests tests.parquet --parameters parameters.csv
  kalfit fit model.toml data.parquet --set tau=90 --intervals profile --starts 5
  kalfit fit model.toml data.csv -o - | jq .log_likelihood

Ctrl-C ends the search: the best so far is shown, and written to `--out` and `--report`, marked as not converged, with \
exit status 130. A second Ctrl-C ends at once, and writes nothing.";

pub(crate) const REDUCE: &str = "\
Examples:
  kalfit reduce model.toml data.csv --out reductions.parquet
  kalfit reduce model.toml 'runs/*.csv' --from fit.json --out reductions.parquet
  kalfit fit model.toml reductions.parquet";

pub(crate) const ESTIMATES: &str = "\
Examples:
  kalfit estimates model.toml data.csv --out estimates.parquet
  kalfit fit model.toml estimates.parquet";

pub(crate) const SUMS: &str = "\
Examples:
  kalfit sums model.toml data.csv --out here.sums
  kalfit sums model.toml data.csv --at theta.json --at-least 20 --out here.sums";

pub(crate) const JOIN: &str = "\
Examples:
  kalfit join model.toml north.sums south.sums --out theta.json
  kalfit join model.toml *.sums --out theta.json --fit fit.json";

pub(crate) const TEST: &str = "\
Examples:
  kalfit test model.toml data.csv --null null.toml
  kalfit test model.toml data.csv --null null.toml --bootstrap 1000 --out test.json

The hypothesis is a TOML file with `[mean]`, `[covariance]` or `[parameters]`. Its keys replace the model's; \
`structure` drops the model's other keys of `[covariance]`. For example, no spread of the slope, whose mean is 10:

  [mean]
  fixed = { slope = 10 }
  [covariance]
  fixed = { \"slope, slope\" = 0 }";

pub(crate) const CHECK: &str = "\
Examples:
  kalfit check model.toml                 is the model file valid, and how is it understood
  kalfit check model.toml data.csv        also what the data can identify
  kalfit check model.toml data.csv -o -   the same as JSON";

pub(crate) const SIMULATE: &str = "\
Examples:
  kalfit simulate model.toml --from fit.json --design data.csv --seed 7 --out drawn.csv
  kalfit simulate model.toml --from truth.toml --design data.csv --tests 100 --seed 7 --out drawn.parquet --truth states.csv";

pub(crate) const PLAN: &str = "\
Examples:
  kalfit plan model.toml --from fit.json --design data.csv --tests 5,10,20,50
  kalfit plan model.toml --from guess.toml --design planned.csv --tests 20 --out plan.json
  kalfit plan units.toml --from fit.json --design data.csv --groups serial=5,10,20 --tests 1,2,4
  kalfit plan model.toml --from fit.json --candidates kinds.csv --budget 20 --for \"sd(scale)\" --with fit.json";

pub(crate) const APPLY: &str = "\
Examples:
  kalfit apply model.toml new.csv --from fit.json
  kalfit apply model.toml new.csv --from fit.json --out tests.parquet
  kalfit apply model.toml data.csv --from fit.json --states states.parquet --kind filtered";

pub(crate) const VALIDATE: &str = "\
Examples:
  kalfit validate model.toml data.csv
  kalfit validate model.toml data.csv --against simpler.toml --out validate.json
  kalfit validate model.toml data.csv --by laboratory";

pub(crate) const PREDICT: &str = "\
Examples:
  kalfit predict model.toml --from fit.json --design mission.csv
  kalfit predict model.toml --from fit.json --design mission.csv --outputs position.toml --out mission.parquet
  kalfit predict units.toml --from fit.json --design mission.csv --units known --confidence 0.95 --content 0.99";

pub(crate) const EXPORT: &str = "\
Examples:
  kalfit export model.toml --from fit.json --step 0.01 --out filter.json
  kalfit export model.toml --from fit.json --step 0.01 --as c --out gyro_filter.h
  kalfit export model.toml --from fit.json --step 0.01 --at temperature=20 --at unit=A7 --out filter.npz

x = F x + B u + w with w ~ N(0, Q), z = H x + D u + v with v ~ N(0, R); x0 and P0 are mean and covariance of the initial state of a new \
test. `inputs` says what u is made of.";

pub(crate) const DATASHEET: &str = "\
Examples:
  kalfit datasheet model.toml --from fit.json data.csv
  kalfit datasheet model.toml --from fit.json 'runs/*.csv' --out datasheet.json
  kalfit datasheet model.toml --from fit.json --step 0.01 --at temperature=20

deg/h, deg/s and rad/s become deg/h, and m/s^2, g, mg and ug become ug; white noise of them is given in deg/sqrt(h) and m/s/sqrt(h). Other \
labels stay.";

pub(crate) const COMPARE: &str = "\
Examples:
  kalfit compare full.json diagonal.json
  kalfit compare full.json diagonal.json fixed.json --out compared.json
  kalfit compare full-validated.json diagonal-validated.json";

pub(crate) const REPORT: &str = "\
Examples:
  kalfit report fit.json --out fit.html
  kalfit report fit.json --test test.json --out compared.html";

pub(crate) const PLOT: &str = "\
Examples:
  kalfit plot fit.json --out forest.svg
  kalfit plot fit.json --what ellipses --width 1200 --out ellipses.png
  kalfit plot fit.json data.csv --what records --model model.toml --test A7 --out record.svg
  kalfit plot plan.json --what sensitivities --out candidates.svg";

pub(crate) const COMPLETIONS: &str = "\
Examples:
  kalfit completions bash > ~/.local/share/bash-completion/completions/kalfit
  kalfit completions zsh > ~/.zfunc/_kalfit
  kalfit completions fish > ~/.config/fish/completions/kalfit.fish";

pub(crate) const MAN: &str = "\
Examples:
  kalfit man | man -l -                   the page of the program
  kalfit man ~/.local/share/man/man1      the pages of all commands, for `man kalfit` and `man kalfit-fit`";

#[cfg(test)]
mod tests {
    use clap::{CommandFactory, Parser};

    use crate::args::Args;

    /// What would be typed: up to the explanation, a pipe or a redirection.
    fn typed(line: &str) -> Option<Vec<String>> {
        let line = line.strip_prefix("  kalfit ")?;
        let end = ["  ", " | ", " > "].iter().filter_map(|stop| line.find(stop)).min().unwrap_or(line.len());
        Some(std::iter::once("kalfit").chain(line[..end].split(' ')).map(|word| word.replace('\'', "")).collect())
    }

    #[test]
    fn every_command_has_examples_that_can_be_typed() {
        let program = Args::command();
        for command in program.get_subcommands().chain([&program]) {
            let help = command.get_after_help().map(ToString::to_string).unwrap_or_default();
            let examples: Vec<_> = help.lines().filter_map(typed).collect();
            assert!(examples.len() > 1, "{} has {} examples", command.get_name(), examples.len());
            for example in examples {
                assert!(Args::try_parse_from(&example).is_ok(), "{example:?}");
            }
        }
    }

    #[test]
    fn the_definition_of_the_commands_is_sound() {
        Args::command().debug_assert();
    }
}
