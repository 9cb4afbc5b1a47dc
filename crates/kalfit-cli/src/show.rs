//! Jobs done and their results shown: results on standard output, everything else on standard error.

use std::path::Path;

use clap_complete::Shell;
use kalfit_job::sums::{JoinJob, JoinedRound, SumsJob};
use kalfit_job::{
    ApplyJob, CheckJob, CompareJob, DatasheetJob, ExchangeJob, ExchangedTable, ExportJob, Failure, FitJob, JobDone,
    JobWatch, PlanJob, PlotJob, PredictJob, ReportJob, SimulateJob, TestJob, ValidateJob,
};
use kalfit_report::{
    TextStyle, applied_summary, check_summary, compared_summary, datasheet_summary, exported_summary, plan_summary,
    predicted_summary, ratio_summary, summary, validated_summary,
};
use serde::Serialize;

use crate::ended::{CommandFailure, CommandOutcome};
use crate::generate;
use crate::init::{self, InitJob};
use crate::interrupt;
use crate::progress::ProgressLine;
use crate::templates::Template;
use crate::terminal;

/// What is told of a job that was done.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ShowOptions {
    /// Nothing but errors.
    pub(crate) quiet: bool,
    /// Results as JSON in place of their summary.
    pub(crate) json: bool,
}

impl ShowOptions {
    /// What goes to standard output.
    fn put<R: Serialize>(self, record: &R, summary: fn(&R, &TextStyle) -> String) -> String {
        match self.json {
            true => kalfit_job::json::to_string(record).expect("records can be put into JSON") + "\n",
            false => summary(record, &terminal::style()),
        }
    }
}

pub(crate) fn fit(job: &FitJob, how: ShowOptions) -> Result<CommandOutcome, CommandFailure> {
    let done = watched(how.quiet, |line| kalfit_job::fit(job, line))?;
    let ended =
        if interrupt::asked() { CommandOutcome::Interrupted } else { CommandOutcome::of(done.record.converged) };
    tell(how, &done, |record| how.put(record, summary), ended)
}

pub(crate) fn test(job: &TestJob, how: ShowOptions) -> Result<CommandOutcome, CommandFailure> {
    let done = watched(how.quiet, |line| kalfit_job::test(job, line))?;
    tell(how, &done, |record| how.put(record, ratio_summary), CommandOutcome::of(done.record.converged))
}

pub(crate) fn plan(job: &PlanJob, how: ShowOptions) -> Result<CommandOutcome, CommandFailure> {
    let done = watched(how.quiet, |line| kalfit_job::plan(job, line))?;
    tell(how, &done, |record| how.put(record, plan_summary), CommandOutcome::Done)
}

pub(crate) fn apply(job: &ApplyJob, how: ShowOptions) -> Result<CommandOutcome, CommandFailure> {
    let done = watched(how.quiet, |line| kalfit_job::apply(job, line))?;
    tell(how, &done, |record| applied_summary(&record.record, &terminal::style()), CommandOutcome::Done)
}

/// Exit status 1 says that some fit is not certified.
pub(crate) fn validate(job: &ValidateJob, how: ShowOptions) -> Result<CommandOutcome, CommandFailure> {
    let done = watched(how.quiet, |line| kalfit_job::validate(job, line))?;
    tell(how, &done, |record| how.put(record, validated_summary), CommandOutcome::of(done.record.is_certified()))
}

pub(crate) fn predict(job: &PredictJob, how: ShowOptions) -> Result<CommandOutcome, CommandFailure> {
    let done = watched(how.quiet, |line| kalfit_job::predict(job, line))?;
    tell(how, &done, |record| predicted_summary(&record.record, &terminal::style()), CommandOutcome::Done)
}

pub(crate) fn export(job: &ExportJob, how: ShowOptions) -> Result<CommandOutcome, CommandFailure> {
    let done = kalfit_job::export(job)?;
    tell(how, &done, |record| exported_summary(record, &terminal::style()), CommandOutcome::Done)
}

pub(crate) fn datasheet(job: &DatasheetJob, how: ShowOptions) -> Result<CommandOutcome, CommandFailure> {
    let done = watched(how.quiet, |line| kalfit_job::datasheet(job, line))?;
    tell(how, &done, |record| how.put(record, datasheet_summary), CommandOutcome::Done)
}

pub(crate) fn compare(job: &CompareJob, how: ShowOptions) -> Result<CommandOutcome, CommandFailure> {
    let done = kalfit_job::compare(job)?;
    tell(how, &done, |record| how.put(record, compared_summary), CommandOutcome::Done)
}

pub(crate) fn check(job: &CheckJob, how: ShowOptions) -> Result<CommandOutcome, CommandFailure> {
    let done = watched(how.quiet, |line| kalfit_job::check(job, line))?;
    tell(how, &done, |record| how.put(record, check_summary), CommandOutcome::Done)
}

/// Exit status 0 says that the report was made; what it says of the fit is in it.
pub(crate) fn report(job: &ReportJob, how: ShowOptions) -> Result<CommandOutcome, CommandFailure> {
    let JobDone { written, .. } = kalfit_job::report(job)?;
    if !how.quiet {
        written.iter().for_each(|name| terminal::complain(&format!("Wrote {name}\n")));
    }
    Ok(CommandOutcome::Done)
}

pub(crate) fn plot(job: &PlotJob, how: ShowOptions) -> Result<CommandOutcome, CommandFailure> {
    let done = watched(how.quiet, |line| kalfit_job::plot(job, line))?;
    tell(how, &done, |()| String::new(), CommandOutcome::Done)
}

pub(crate) fn init(job: &InitJob, how: ShowOptions) -> Result<CommandOutcome, CommandFailure> {
    let told = init::init(job).map_err(CommandFailure::NotBegun)?;
    if !how.quiet {
        terminal::complain(&told);
    }
    Ok(CommandOutcome::Done)
}

/// The starter models, to standard output.
pub(crate) fn templates() -> Result<CommandOutcome, CommandFailure> {
    terminal::print(&Template::list()).map_err(CommandFailure::Unheard)?;
    Ok(CommandOutcome::Done)
}

/// The schema of model files, to standard output.
pub(crate) fn schema() -> Result<CommandOutcome, CommandFailure> {
    terminal::print(&kalfit_job::model_schema()).map_err(CommandFailure::Unheard)?;
    Ok(CommandOutcome::Done)
}

pub(crate) fn completions(shell: Shell) -> Result<CommandOutcome, CommandFailure> {
    terminal::print(&generate::completions(shell)).map_err(CommandFailure::Unheard)?;
    Ok(CommandOutcome::Done)
}

/// The page of the program to standard output, or all pages to a folder.
pub(crate) fn man(folder: Option<&Path>, how: ShowOptions) -> Result<CommandOutcome, CommandFailure> {
    match folder {
        None => generate::man().and_then(|page| terminal::print(&page)).map_err(CommandFailure::Unheard)?,
        Some(folder) => {
            let pages = generate::man_pages(folder).map_err(CommandFailure::NoPages)?;
            if !how.quiet {
                terminal::complain(&format!("Wrote {pages} pages to {}\n", folder.display()));
            }
        }
    }
    Ok(CommandOutcome::Done)
}

/// A job that writes an exchange file.
type RunExchange = fn(&ExchangeJob, &mut dyn JobWatch) -> Result<JobDone<ExchangedTable>, Failure>;

pub(crate) fn exchange(
    job: &ExchangeJob,
    run: RunExchange,
    how: ShowOptions,
) -> Result<CommandOutcome, CommandFailure> {
    let JobDone { record, notes, written, .. } = watched(how.quiet, |line| run(job, line))?;
    if let (false, Some(name)) = (how.quiet, written.first()) {
        terminal::warn(&notes);
        let (rows, tests) = (plural(record.rows as u64, record.row), plural(record.tests as u64, "test"));
        terminal::complain(&format!("Wrote {name}: {rows} of {tests}\n"));
    }
    Ok(CommandOutcome::Done)
}

pub(crate) fn sums(job: &SumsJob, how: ShowOptions) -> Result<CommandOutcome, CommandFailure> {
    let JobDone { record, notes, written, .. } = watched(how.quiet, |line| kalfit_job::sums::sums(job, line))?;
    if let (false, Some(name)) = (how.quiet, written.first()) {
        terminal::warn(&notes);
        let tests = plural(record.tests as u64, "test");
        terminal::complain(&format!("Wrote {name}: sums of round {} over {tests}\n", record.round + 1));
    }
    Ok(CommandOutcome::Done)
}

/// The next round, or the fit.
pub(crate) fn join(job: &JoinJob, how: ShowOptions) -> Result<CommandOutcome, CommandFailure> {
    let done = watched(how.quiet, |line| kalfit_job::sums::join(job, line))?;
    let JoinedRound { places, tests, rounds, record } = &done.record;
    if let Some(record) = record {
        let outcome = CommandOutcome::of(record.converged);
        return tell(how, &done, |_| summary(record, &terminal::style()), outcome);
    }
    if let (false, Some(name)) = (how.quiet, done.written.first()) {
        let (places, tests) = (plural(*places as u64, "place"), plural(*tests as u64, "test"));
        terminal::complain(&format!("Wrote {name}: round {rounds} of {tests} in {places} does not end the search\n"));
    }
    Ok(CommandOutcome::Done)
}

pub(crate) fn simulate(job: &SimulateJob, how: ShowOptions) -> Result<CommandOutcome, CommandFailure> {
    let JobDone { record, notes, written, .. } = watched(how.quiet, |line| kalfit_job::simulate(job, line))?;
    if let (false, Some(name)) = (how.quiet, written.first()) {
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
    Ok(CommandOutcome::Done)
}

/// Does a job under the line of progress, which is gone again before anything is shown.
fn watched<R>(quiet: bool, job: impl FnOnce(&mut ProgressLine) -> Result<R, Failure>) -> Result<R, CommandFailure> {
    Ok(job(&mut ProgressLine::new(quiet))?)
}

/// Warnings, the text, and the files that were written. What could not be written or said does not undo what was written.
fn tell<R>(
    how: ShowOptions,
    done: &JobDone<R>,
    text: impl FnOnce(&R) -> String,
    outcome: CommandOutcome,
) -> Result<CommandOutcome, CommandFailure> {
    let mut lost = done.unwritten.clone();
    if !how.quiet {
        terminal::warn(&done.notes);
    }
    if (!how.quiet || how.json)
        && let Err(error) = terminal::print(&text(&done.record))
    {
        let unheard = CommandFailure::Unheard(error);
        if done.written.is_empty() {
            return Err(unheard);
        }
        lost.push(unheard.message());
    }
    if !how.quiet {
        done.written.iter().for_each(|name| terminal::complain(&format!("Wrote {name}\n")));
    }
    lost.iter()
        .for_each(|message| terminal::complain(&kalfit_job::render_message(message, terminal::color_on_stderr())));
    Ok(if lost.is_empty() { outcome } else { outcome.with_losses() })
}

fn plural(n: u64, what: &str) -> String {
    if n == 1 { format!("1 {what}") } else { format!("{n} {what}s") }
}
