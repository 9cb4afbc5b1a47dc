//! Mutants of the core: small changes, such as `a - b` for `a + b`, each of which a test must notice.
//!
//! All mutants of a sample are compiled together, as switches of which the environment turns on one at a time: one build serves
//! all. Each test is first run by itself, with none on, and notes which mutants it meets; a mutant is then tried with these tests.

mod choose;
mod explained;
mod find;
mod rewrite;
mod scratch;
mod sources;
mod trial;

use std::collections::BTreeMap;
use std::process::ExitCode;
use std::time::Instant;

use choose::Mutant;
use scratch::ScratchCopy;
use sources::{CERTIFICATE, GROUPS};
use trial::MutantFate;

/// Survivors among a hundred that the task puts up with, none of them in the certificate.
const BEARABLE: usize = 3;

/// What is asked of the task.
#[derive(Debug, clap::Args)]
pub(crate) struct MutantOptions {
    /// How many.
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u16).range(1..=4000))]
    mutants: u16,
    /// Which of all: another seed, another sample.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Show the sample; nothing is built.
    #[arg(long)]
    list: bool,
    /// With the copy and the tests as they were built last, whatever has been written since.
    #[arg(long)]
    as_built: bool,
    /// So many seconds of tests for each mutant at most, the quickest first: survivors may then be none.
    #[arg(long, default_value_t = f64::INFINITY)]
    seconds: f64,
    /// Only these mutants of the sample.
    #[arg(long, value_delimiter = ',')]
    only: Vec<usize>,
}

/// Runs the task; it fails where too many survive.
pub(crate) fn run(options: &MutantOptions) -> ExitCode {
    match campaign(options) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(message) => {
            eprintln!("{message}");
            ExitCode::FAILURE
        }
    }
}

fn campaign(options: &MutantOptions) -> Result<bool, String> {
    let scratch = ScratchCopy::new()?;
    let sample = (usize::from(options.mutants), options.seed);
    if options.list {
        let mutants = scratch.sample(sample)?;
        mutants.iter().enumerate().for_each(|(k, mutant)| println!("{}", line(k, mutant)));
        return Ok(true);
    }
    let (mutants, programs) = if options.as_built {
        (scratch.sample(sample)?, scratch.as_built()?)
    } else {
        println!("== a copy of the workspace with switches");
        let mutants = scratch.compiled(sample)?;
        println!("== the tests of the copy, some minutes at first");
        (mutants, scratch.built()?)
    };
    let trials = trial::trials(&scratch, &programs)?;
    println!("== {} mutants", mutants.len());
    let mut fates = Vec::new();
    for (k, mutant) in mutants.iter().enumerate() {
        if options.only.is_empty() || options.only.contains(&k) {
            let begun = Instant::now();
            let fate = trial::fate(&programs, &trials, k, options.seconds)?;
            println!("{}\n       {}, {:.0} s", line(k, mutant), said(mutant, &fate), begun.elapsed().as_secs_f64());
            fates.push((k, fate));
        }
    }
    Ok(report(&mutants, &fates))
}

fn line(k: usize, mutant: &Mutant) -> String {
    format!("{k:>4}   {}:{}: {}", mutant.file, mutant.change.line, mutant.change.what)
}

fn said(mutant: &Mutant, fate: &MutantFate) -> String {
    match (fate, explained::reason(&mutant.key)) {
        (MutantFate::Killed(by), _) => format!("killed by {by}"),
        (MutantFate::Survived(..), Some(reason)) => format!("the same program: {reason}"),
        (MutantFate::Survived(_, 0), None) => "SURVIVED: no test meets it".to_owned(),
        (MutantFate::Survived(asked, all), None) => format!("SURVIVED {asked} of {all} tests that meet it"),
    }
}

/// Survivors of a group or file, and those of them that are none.
#[derive(Default, Clone, Copy)]
struct SurvivorCount {
    all: usize,
    killed: usize,
    same: usize,
}

impl SurvivorCount {
    fn and(self, other: SurvivorCount) -> SurvivorCount {
        SurvivorCount { all: self.all + other.all, killed: self.killed + other.killed, same: self.same + other.same }
    }

    fn row(self, name: &str) -> String {
        format!("| {name} | {} | {} | {} | {} |", self.all, self.killed, self.same, self.all - self.killed - self.same)
    }
}

/// The table by groups and files, and the survivors; whether they are few enough.
fn report(mutants: &[Mutant], fates: &[(usize, MutantFate)]) -> bool {
    let mut files: BTreeMap<(&str, &str), SurvivorCount> = BTreeMap::new();
    let mut survivors = Vec::new();
    for &(k, ref fate) in fates {
        let (mutant, killed) = (&mutants[k], matches!(fate, MutantFate::Killed(_)));
        let same = !killed && explained::reason(&mutant.key).is_some();
        let count = files.entry((mutant.group, mutant.file)).or_default();
        *count = count.and(SurvivorCount { all: 1, killed: usize::from(killed), same: usize::from(same) });
        if !killed && !same {
            survivors.push(k);
        }
    }
    println!("\n| file | mutants | killed | the same program | survived |\n|---|---|---|---|---|");
    for group in &GROUPS {
        let of_group = || files.iter().filter(|((name, _), _)| *name == group.name);
        of_group().for_each(|((_, file), count)| println!("{}", count.row(&format!("`{file}`"))));
        let sum = of_group().fold(SurvivorCount::default(), |sum, (_, count)| sum.and(*count));
        println!("{}", sum.row(&format!("**{}**", group.name)));
    }
    println!("{}", files.values().fold(SurvivorCount::default(), |sum, count| sum.and(*count)).row("**all**"));
    survivors.iter().for_each(|&k| println!("survived {k}: {}", mutants[k].key));
    let in_certificate = survivors.iter().any(|&k| mutants[k].group == CERTIFICATE);
    survivors.len() * 100 <= BEARABLE * fates.len().max(100) && !in_certificate
}
