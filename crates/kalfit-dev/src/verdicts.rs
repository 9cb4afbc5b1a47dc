//! Verdicts of the check of a fit: how often it doubts a correct model, and how often it finds a fault in the data.

mod correct;
mod drawn;
mod fault;
mod kind;
mod planted;

use std::process::ExitCode;

use kalfit::infer::{Choices, DeletionChoice};
use kalfit::{Ensemble, FitRecord, Options, PhasedModel, estimate};

use self::drawn::DrawnEnsemble;

/// Arguments of the task.
#[derive(Debug, clap::Args)]
pub(crate) struct VerdictOptions {
    /// Correct ensembles, of all kinds in turns; none with 0.
    #[arg(long, default_value_t = 1_000)]
    correct: usize,
    /// Ensembles with a fault, of all faults in turns; none with 0.
    #[arg(long, default_value_t = 300)]
    faults: usize,
    /// The first seed.
    #[arg(long, default_value_t = crate::seed::SEED)]
    seed: u64,
    /// Only the kinds and faults whose name contains this.
    #[arg(long, default_value = "")]
    only: String,
    /// Prints the findings of every ensemble that is doubted.
    #[arg(long)]
    list: bool,
}

/// Prints the tables; fails when correct models are doubted too often.
pub(crate) fn run(options: &VerdictOptions) -> ExitCode {
    let correct = if options.correct > 0 { correct::run(options) } else { Ok(true) };
    let result = correct.and_then(|sound| {
        if options.faults > 0 {
            planted::run(options)?;
        }
        Ok(sound)
    });
    match result {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

/// The findings of a fit and its two least probable terms, on one line.
fn findings(record: &FitRecord) -> String {
    let found = record.model_check.iter().flat_map(|check| &check.findings);
    let terms = record.misfit.iter().flat_map(|misfit| misfit.terms.iter().take(2));
    let terms = terms.map(|term| format!("{} p = {:.1e}", term.words(), term.p_value));
    found.map(|finding| format!("{}: {}", finding.kind, finding.text)).chain(terms).collect::<Vec<_>>().join("; ")
}

/// The fit of a model to an ensemble; `None` where it is not certified.
fn fitted(model: &PhasedModel, drawn: &DrawnEnsemble) -> Result<Option<FitRecord>, String> {
    let ensemble = Ensemble::of_tests(model, drawn.labels.clone(), drawn.tests());
    let choices = Choices { deletion: DeletionChoice::None, ..Choices::default() };
    let options = Options { choices, ..Options::default() };
    let fit = ensemble.fit_with(&options, &mut estimate::Silent).map_err(|error| error.to_string())?;
    Ok(Some(fit.record).filter(|record| record.converged))
}

fn is_doubted(record: &FitRecord) -> bool {
    record.model_check.as_ref().is_some_and(|check| check.is_doubtful())
}
