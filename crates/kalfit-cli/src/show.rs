//! Jobs done and their results shown: results on standard output, everything else on standard error.

use std::path::Path;

use clap_complete::Shell;
use kalfit_job::sums::{JoinJob, Round, SumsJob};
use kalfit_job::{
    ApplyJob, CheckJob, CompareJob, DatasheetJob, Done, ExchangeJob, Exchanged, ExportJob, Failure, FitJob, PlanJob,
    PredictJob, ReportJob, SimulateJob, TestJob, ValidateJob, Watch,
};
use kalfit_report::{
    applied_summary, check_summary, compared_summary, datasheet_summary, exported_summary, plan_summary,
    predicted_summary, ratio_summary, summary, validated_summary,
};

use crate::ended::{Ended, Outcome};
use crate::generate;
use crate::init::{self, InitJob};
use crate::interrupt;
use crate::progress::Line;
use crate::terminal;

pub(crate) fn fit(job: &FitJob, quiet: bool) -> Result<Outcome, Ended> {
    let done = watched(quiet, |line| kalfit_job::fit(job, line))?;
    let ended = if interrupt::asked() { Outcome::Interrupted } else { Outcome::of(done.record.converged) };
    tell(quiet, &done, |record| summary(record, &terminal::style()), ended)
}

pub(crate) fn test(job: &TestJob, quiet: bool) -> Result<Outcome, Ended> {
    let done = watched(quiet, |line| kalfit_job::test(job, line))?;
    tell(quiet, &done, |record| ratio_summary(record, &terminal::style()), Outcome::of(done.record.converged))
}

pub(crate) fn plan(job: &PlanJob, quiet: bool) -> Result<Outcome, Ended> {
    let done = watched(quiet, |line| kalfit_job::plan(job, line))?;
    tell(quiet, &done, |record| plan_summary(record, &terminal::style()), Outcome::Done)
}

pub(crate) fn apply(job: &ApplyJob, quiet: bool) -> Result<Outcome, Ended> {
    let done = watched(quiet, |line| kalfit_job::apply(job, line))?;
    tell(quiet, &done, |record| applied_summary(&record.record, &terminal::style()), Outcome::Done)
}

/// Exit status 1 says that some fit is not certified.
pub(crate) fn validate(job: &ValidateJob, quiet: bool) -> Result<Outcome, Ended> {
    let done = watched(quiet, |line| kalfit_job::validate(job, line))?;
    tell(quiet, &done, |record| validated_summary(record, &terminal::style()), Outcome::of(done.record.is_certified()))
}

pub(crate) fn predict(job: &PredictJob, quiet: bool) -> Result<Outcome, Ended> {
    let done = watched(quiet, |line| kalfit_job::predict(job, line))?;
    tell(quiet, &done, |record| predicted_summary(&record.record, &terminal::style()), Outcome::Done)
}

pub(crate) fn export(job: &ExportJob, quiet: bool) -> Result<Outcome, Ended> {
    let done = kalfit_job::export(job)?;
    tell(quiet, &done, |record| exported_summary(record, &terminal::style()), Outcome::Done)
}

pub(crate) fn datasheet(job: &DatasheetJob, quiet: bool) -> Result<Outcome, Ended> {
    let done = watched(quiet, |line| kalfit_job::datasheet(job, line))?;
    tell(quiet, &done, |record| datasheet_summary(record, &terminal::style()), Outcome::Done)
}

pub(crate) fn compare(job: &CompareJob, quiet: bool) -> Result<Outcome, Ended> {
    let done = kalfit_job::compare(job)?;
    tell(quiet, &done, |record| compared_summary(record, &terminal::style()), Outcome::Done)
}

pub(crate) fn check(job: &CheckJob) -> Result<Outcome, Ended> {
    let done = watched(false, |line| kalfit_job::check(job, line))?;
    tell(false, &done, |record| check_summary(record, &terminal::style()), Outcome::Done)
}

/// Exit status 0 says that the report was made; what it says of the fit is in it.
pub(crate) fn report(job: &ReportJob, quiet: bool) -> Result<Outcome, Ended> {
    let Done { written, .. } = kalfit_job::report(job)?;
    if !quiet {
        written.iter().for_each(|name| terminal::complain(&format!("Wrote {name}\n")));
    }
    Ok(Outcome::Done)
}

pub(crate) fn init(job: &InitJob, quiet: bool) -> Result<Outcome, Ended> {
    let told = init::init(job).map_err(Ended::NotBegun)?;
    if !quiet {
        terminal::complain(&told);
    }
    Ok(Outcome::Done)
}

pub(crate) fn completions(shell: Shell) -> Result<Outcome, Ended> {
    terminal::print(&generate::completions(shell)).map_err(Ended::Unheard)?;
    Ok(Outcome::Done)
}

/// The page of the program to standard output, or all pages to a folder.
pub(crate) fn man(folder: Option<&Path>) -> Result<Outcome, Ended> {
    match folder {
        None => generate::man().and_then(|page| terminal::print(&page)).map_err(Ended::Unheard)?,
        Some(folder) => {
            let pages = generate::man_pages(folder).map_err(Ended::NoPages)?;
            terminal::complain(&format!("Wrote {pages} pages to {}\n", folder.display()));
        }
    }
    Ok(Outcome::Done)
}

/// A job that writes an exchange file.
type Exchange = fn(&ExchangeJob, &mut dyn Watch) -> Result<Done<Exchanged>, Failure>;

pub(crate) fn exchange(job: &ExchangeJob, run: Exchange, quiet: bool) -> Result<Outcome, Ended> {
    let Done { record, notes, written, .. } = watched(quiet, |line| run(job, line))?;
    if let (false, Some(name)) = (quiet, written.first()) {
        terminal::warn(&notes);
        let (rows, tests) = (plural(record.rows as u64, record.row), plural(record.tests as u64, "test"));
        terminal::complain(&format!("Wrote {name}: {rows} of {tests}\n"));
    }
    Ok(Outcome::Done)
}

pub(crate) fn sums(job: &SumsJob, quiet: bool) -> Result<Outcome, Ended> {
    let Done { record, notes, written, .. } = watched(quiet, |line| kalfit_job::sums::sums(job, line))?;
    if let (false, Some(name)) = (quiet, written.first()) {
        terminal::warn(&notes);
        let tests = plural(record.tests as u64, "test");
        terminal::complain(&format!("Wrote {name}: sums of round {} over {tests}\n", record.round + 1));
    }
    Ok(Outcome::Done)
}

/// The next round, or the fit.
pub(crate) fn join(job: &JoinJob, quiet: bool) -> Result<Outcome, Ended> {
    let done = watched(quiet, |line| kalfit_job::sums::join(job, line))?;
    let Round { places, tests, rounds, record } = &done.record;
    if let Some(record) = record {
        let outcome = Outcome::of(record.converged);
        return tell(quiet, &done, |_| summary(record, &terminal::style()), outcome);
    }
    if let (false, Some(name)) = (quiet, done.written.first()) {
        let (places, tests) = (plural(*places as u64, "place"), plural(*tests as u64, "test"));
        terminal::complain(&format!("Wrote {name}: round {rounds} of {tests} in {places} does not end the search\n"));
    }
    Ok(Outcome::Done)
}

pub(crate) fn simulate(job: &SimulateJob, quiet: bool) -> Result<Outcome, Ended> {
    let Done { record, notes, written, .. } = watched(quiet, |line| kalfit_job::simulate(job, line))?;
    if let (false, Some(name)) = (quiet, written.first()) {
        terminal::warn(&notes);
        let (tests, rows, seed) = (plural(record.tests, "test"), plural(record.rows, "row"), job.seed);
        let mut text = format!("Wrote {name}: {tests}, {rows}, drawn with seed {seed}\n");
        if let Some(states) = &record.states {
            text.push_str(&format!("Wrote {states}: the initial states that were drawn\n"));
        }
        if let Some(column) = &record.added {
            text.push_str(&format!(
                "The tests are told apart by column `{column}`: to fit this file, set `test = \"{column}\"` in `[data]`\n"
            ));
        }
        terminal::complain(&text);
    }
    Ok(Outcome::Done)
}

/// Does a job under the line of progress, which is gone again before anything is shown.
fn watched<R>(quiet: bool, job: impl FnOnce(&mut Line) -> Result<R, Failure>) -> Result<R, Ended> {
    Ok(job(&mut Line::new(quiet))?)
}

/// Warnings, the text, and the files that were written. What could not be written or said does not undo what was written.
fn tell<R>(quiet: bool, done: &Done<R>, text: impl FnOnce(&R) -> String, outcome: Outcome) -> Result<Outcome, Ended> {
    let mut lost = done.unwritten.clone();
    if !quiet {
        terminal::warn(&done.notes);
        if let Err(error) = terminal::print(&text(&done.record)) {
            let unheard = Ended::Unheard(error);
            if done.written.is_empty() {
                return Err(unheard);
            }
            lost.push(unheard.message());
        }
        done.written.iter().for_each(|name| terminal::complain(&format!("Wrote {name}\n")));
    }
    lost.iter()
        .for_each(|message| terminal::complain(&kalfit_job::render_message(message, terminal::color_on_stderr())));
    Ok(if lost.is_empty() { outcome } else { outcome.with_losses() })
}

fn plural(n: u64, what: &str) -> String {
    if n == 1 { format!("1 {what}") } else { format!("{n} {what}s") }
}
