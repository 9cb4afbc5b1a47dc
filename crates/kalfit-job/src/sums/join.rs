//! `kalfit join`: the sums of all places together, and what is to be asked next, or the fit.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use kalfit::estimate::{Criterion, Settings};
use kalfit::model::Slots;
use kalfit::remote::{Answer, Asked, Question, sum};
use kalfit::shards::{Asks, Audit, Next, ShardError};
use kalfit::{FitRecord, Labels, Provenance};
use kalfit_spec::Spec;

use crate::document::Document;
use crate::failure::Failure;
use crate::job::{JobDone, ModelJob};
use crate::output::OutputFile;
use crate::sums::error::SumsError;
use crate::sums::theta::{SiteSums, Theta};
use crate::work::{JobWatch, JobWork};
use crate::{memory, model, write};

/// Put the sums of all places together.
#[derive(Debug, Clone)]
pub struct JoinJob {
    /// The model.
    pub model: ModelJob,
    /// The sums of all places.
    pub sums: Vec<Document>,
    /// What is maximised.
    pub criterion: Criterion,
    /// File for what is asked next.
    pub out: PathBuf,
    /// File for the results, once the search has ended.
    pub fit: PathBuf,
}

/// How a fit by sums goes on.
#[derive(Debug)]
pub enum JoinedSums {
    /// One more round.
    Asks(Box<Theta>),
    /// It has ended.
    Ends(Box<FitRecord>),
}

/// What `kalfit join` ended with.
#[derive(Debug)]
pub struct JoinedRound {
    /// Number of places.
    pub places: usize,
    /// Number of tests.
    pub tests: usize,
    /// Rounds so far.
    pub rounds: usize,
    /// The results, if the search has ended.
    pub record: Option<Box<FitRecord>>,
}

/// Puts the sums of all places together, and writes what is to be asked next, or the results.
///
/// # Errors
/// Sums of other models, versions, rounds or places; what keeps a fit of all tests in one place from an answer.
pub fn join(job: &JoinJob, watch: &mut dyn JobWatch) -> Result<JobDone<JoinedRound>, Failure> {
    let spec = model::load(&job.model, &[])?;
    memory::suffices(&spec)?;
    let read: Vec<&Path> = std::iter::once(&job.model.document).chain(&job.sums).filter_map(Document::path).collect();
    let (out, fit) = (OutputFile::prepare(&job.out, &read)?, OutputFile::prepare(&job.fit, &read)?);
    out.refuse_same(Some(&fit))?;
    let names: Vec<String> = job.sums.iter().map(Document::name).collect();
    let sums = job.sums.iter().map(SiteSums::read).collect::<Result<Vec<_>, _>>()?;
    if let Some((at, other)) = twice(&sums) {
        let [file, first] = [at, other].map(|at| names[at].clone());
        return Err(SumsError::Twice { file, first }.into());
    }
    let theta = sums.first().ok_or(SumsError::Shard(ShardError::NoTests))?.theta.clone();
    let (rounds, tests) = (theta.round + 1, sums.iter().map(|sums| sums.tests).sum());
    let named: Vec<(&str, &SiteSums)> = names.iter().map(String::as_str).zip(&sums).collect();
    let round = |record| JoinedRound { places: sums.len(), tests, rounds, record };
    match go_on((&spec, job.criterion), theta, &named, watch)? {
        JoinedSums::Asks(theta) => {
            out.write(&*theta)?;
            Ok(JobDone::new(round(None), Vec::new(), vec![out.name()]))
        }
        JoinedSums::Ends(mut record) => {
            record.data.files = names.clone();
            write::record(&fit, &mut record)?;
            Ok(JobDone::new(round(Some(record)), Vec::new(), vec![fit.name()]))
        }
    }
}

/// What is asked first of every place.
///
/// # Errors
/// A model that is none, or that is not fitted by sums.
pub fn first(job: &ModelJob) -> Result<Theta, Failure> {
    Ok(Theta::first(&model::load(job, &[])?)?)
}

/// Goes on from θ with the sums of all partitions of one table, in their order.
///
/// # Errors
/// As [`join`].
pub fn of_partitions(
    (job, criterion): (&ModelJob, Criterion),
    theta: Theta,
    sums: &[SiteSums],
    watch: &mut dyn JobWatch,
) -> Result<JoinedSums, Failure> {
    let spec = model::load(job, &[])?;
    memory::suffices(&spec)?;
    let names: Vec<String> = (1..=sums.len()).map(|k| format!("partition {k}")).collect();
    let named: Vec<(&str, &SiteSums)> = names.iter().map(String::as_str).zip(sums).collect();
    go_on((&spec, criterion), theta, &named, watch)
}

/// A fit of tests takes about thirty rounds at most; a search that goes on has sums that contradict each other.
const MOST_ROUNDS: usize = 60;

/// Goes on from θ with the sums of all places, which messages call by their names.
fn go_on(
    (spec, criterion): (&Spec, Criterion),
    theta: Theta,
    sums: &[(&str, &SiteSums)],
    watch: &mut dyn JobWatch,
) -> Result<JoinedSums, Failure> {
    let mut work = JobWork::new(watch);
    let next = together(theta, sums, spec)?;
    let provenance = Provenance {
        model_digest: Some(spec.digest.clone()),
        model: spec.describe(),
        files: Vec::new(),
        seconds: work.seconds(),
        of_estimates: spec.model.phases.iter().any(|phase| phase.filter.is_some()),
    };
    let asks = Asks { settings: Settings { criterion, ..Settings::default() }, ..Asks::default() };
    let found = kalfit::shards::go_on(&spec.model, &asks, next.known.clone(), provenance, &mut work);
    match found.map_err(SumsError::from)? {
        Next::Asks(ask) => Ok(JoinedSums::Asks(Box::new(Theta { ask, ..next }))),
        Next::Ends(mut record) => {
            record.notes.splice(0..0, spec.questions());
            Ok(JoinedSums::Ends(record))
        }
    }
}

/// Of sums of some tests that are there before, the first, and where they were. Counts may well be alike, start values are where the
/// model gives them, what equal designs inform of the mean without spread, and all answers where what was asked for is not defined.
fn twice(sums: &[SiteSums]) -> Option<(usize, usize)> {
    let tells = |(asked, answer): (&Asked, &Answer)| {
        answer.is_some()
            && match &asked.question {
                Question::Observability { .. } | Question::Opening => false,
                Question::Pass { place, .. } => place.root.iter().any(|x| *x != 0.0),
                _ => true,
            }
    };
    let is_told = |sums: &SiteSums| sums.tests > 0 && sums.theta.ask.iter().zip(&sums.answers).any(tells);
    let before = |at: usize| sums[..at].iter().position(|other| is_told(other) && *other == sums[at]);
    (0..sums.len()).find_map(|at| Some((at, before(at)?)))
}

/// Each group of the outermost level, and each level of a crossed factor, is in one place.
fn apart(sums: &[(&str, &SiteSums)], spec: &Spec) -> Result<(), SumsError> {
    let mut places: HashMap<&str, usize> = HashMap::new();
    let outermost = spec.model.nested().iter().take(1).chain(spec.model.factors());
    let levels: Vec<String> = outermost.map(|level| format!("`{}`", level.name)).collect();
    for (at, (file, own)) in sums.iter().enumerate() {
        let before: Vec<usize> = own.groups.iter().filter_map(|group| places.insert(group, at)).collect();
        let Some(&first) = before.iter().min() else { continue };
        return Err(SumsError::Groups {
            file: (*file).to_owned(),
            first: sums[first].0.to_owned(),
            found: before.iter().filter(|place| **place == first).count(),
            level: levels.join(" or "),
        });
    }
    Ok(())
}

/// Refuses answers that cannot come from tests.
fn audit(ask: &[Asked], sums: &[(&str, &SiteSums)], spec: &Spec) -> Result<(), SumsError> {
    let slots = Slots::in_phases(&spec.model, &Labels::new(&spec.model.shared().literals), &[]);
    let Some(audit) = Audit::new(&spec.model, &slots) else { return Ok(()) };
    for (k, asked) in ask.iter().enumerate() {
        for (file, own) in sums {
            let fault = own.answers[k].as_ref().and_then(|numbers| audit.fault(&asked.question, numbers, own.tests));
            if let Some(why) = fault {
                return Err(SumsError::Impossible { file: (*file).to_owned(), why });
            }
        }
    }
    Ok(())
}

/// What is known after a round.
fn together(theta: Theta, sums: &[(&str, &SiteSums)], spec: &Spec) -> Result<Theta, SumsError> {
    if theta.round >= MOST_ROUNDS {
        return Err(SumsError::Rounds { rounds: theta.round });
    }
    let bare = theta.bare();
    let Some(&(first, _)) = sums.first() else { return Err(ShardError::NoTests.into()) };
    for &(file, own) in sums {
        own.theta.check(file, spec)?;
        let (file, first) = (file.to_owned(), first.to_owned());
        if own.theta.round != theta.round {
            return Err(SumsError::Round { file, found: own.theta.round, first, expected: theta.round });
        }
        if own.theta != theta && own.theta != bare {
            return Err(SumsError::Fit { file, first, round: theta.round });
        }
        if own.answers.len() != theta.ask.len() {
            return Err(SumsError::Answers { file });
        }
    }
    let found = [sums.len(), sums.iter().map(|(_, sums)| sums.tests).sum()];
    if let Some(expected) = theta.places.filter(|expected| *expected != found) {
        let ([found, found_tests], [places, tests]) = (found, expected);
        return Err(SumsError::Places { found, found_tests, places, tests });
    }
    apart(sums, spec)?;
    audit(&theta.ask, sums, spec)?;
    let mut known = theta.known;
    for (k, asked) in theta.ask.into_iter().enumerate() {
        let answers: Vec<Answer> = sums.iter().map(|(_, sums)| sums.answers[k].clone()).collect();
        let length = |answer: &Answer| answer.as_ref().map(Vec::len);
        let odd = answers.iter().position(|answer| answer.is_some() && length(answer) != length(&answers[0]));
        let file = sums[odd.unwrap_or(0)].0.to_owned();
        known.push((asked, sum(&answers).ok_or(SumsError::Answers { file })?));
    }
    Ok(Theta { round: theta.round + 1, places: Some(found), ask: Vec::new(), known, ..theta })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(question: &str, answers: &str) -> SiteSums {
        let asked = format!(r#"{{"values": [0.0], "question": "{question}"}}"#);
        let theta = format!(
            r#"{{"schema": "kalfit-theta/1", "kalfit_version": "0.2.0", "model_digest": "sha256:0", "parameters": [], "round": 1, "places": [2, 14], "ask": [{asked}], "known": []}}"#
        );
        let text = format!(r#"{{"schema": "kalfit-sums/1", "tests": 7, "answers": [{answers}], "theta": {theta}}}"#);
        SiteSums::of_text("place", &text).expect("sums")
    }

    #[test]
    fn two_places_of_which_nothing_is_defined_are_not_one_place() {
        let places = |answers: [&str; 2]| answers.map(|answers| place("survey", answers));
        assert_eq!(twice(&places(["[1.5, 2.0]", "[1.5, 2.0]"])), Some((1, 0)));
        assert_eq!(twice(&places(["[1.5, 2.0]", "[1.5, 2.5]"])), None);
        assert_eq!(twice(&places(["null", "null"])), None);
        // both begin where the model says
        assert_eq!(twice(&["[7.0, 0.0, -8.0]"; 2].map(|answers| place("opening", answers))), None);
    }
}
