//! `kalfit sums`: what one place answers.

use std::path::PathBuf;

use kalfit::dynamic::Settings;
use kalfit::shards::Shard;
use kalfit_data::Datum;
use kalfit_spec::Spec;

use crate::document::Document;
use crate::evidence::CommandInputs;
use crate::failure::Failure;
use crate::job::{JobDone, ModelJob, files};
use crate::output::OutputFile;
use crate::sums::error::SumsError;
use crate::sums::theta::{SUMS, SiteSums, Theta};
use crate::work::{JobWatch, JobWork};
use crate::{memory, model, tests};

/// Make the sums that are asked for.
#[derive(Debug, Clone)]
pub struct SumsJob {
    /// The model.
    pub model: ModelJob,
    /// The data of this place.
    pub data: Vec<Datum>,
    /// What is asked for; the first round when none.
    pub at: Option<Document>,
    /// Sums of fewer tests are not told.
    pub at_least: usize,
    /// File for the sums.
    pub out: PathBuf,
}

/// Sums that were made.
#[derive(Debug)]
pub struct SumsMade {
    /// Number of tests.
    pub tests: usize,
    /// Rounds before this one.
    pub round: usize,
}

/// The tests of one place, read.
#[derive(Debug)]
pub struct SumsSite {
    spec: Spec,
    shard: Shard,
    /// What the user should know.
    pub notes: Vec<String>,
}

impl SumsSite {
    /// Reads the data of a place.
    ///
    /// # Errors
    /// Bad input, a model that is not fitted by sums, or [`Failure::Interrupted`].
    pub fn open(job: &ModelJob, data: &[Datum], watch: &mut dyn JobWatch) -> Result<SumsSite, Failure> {
        let mut spec = model::load(job, data)?;
        let given = CommandInputs::open(&mut spec, data)?;
        SumsSite::read(spec, &given, &mut JobWork::new(watch))
    }

    fn read(spec: Spec, given: &CommandInputs, work: &mut JobWork<'_>) -> Result<SumsSite, Failure> {
        memory::suffices(&spec)?;
        let (tests, reading) = tests::read(&spec, given, work)?;
        let shard =
            Shard::new(spec.model.clone(), &reading.labels, tests, Settings::default()).map_err(SumsError::from)?;
        Ok(SumsSite { spec, shard, notes: given.notes.clone() })
    }

    /// Number of tests.
    pub fn tests(&self) -> usize {
        self.shard.tests()
    }

    /// What is asked for first.
    ///
    /// # Errors
    /// A model that is not fitted by sums.
    pub fn first(&self) -> Result<Theta, Failure> {
        Ok(Theta::first(&self.spec)?)
    }

    /// What this place answers; messages call what is asked `name`.
    ///
    /// # Errors
    /// What is asked is of another model or of another version.
    pub fn answer(&self, theta: Theta, name: &str) -> Result<SiteSums, Failure> {
        theta.check(name, &self.spec)?;
        let answers = theta.ask.iter().map(|asked| self.shard.answer(asked)).collect::<Result<_, _>>();
        let answers = answers.map_err(SumsError::from)?;
        let mut groups: Vec<String> = match theta.round {
            0 => self.shard.groups().iter().map(|group| self.spec.group_digest(group)).collect(),
            _ => Vec::new(), // they were compared before
        };
        groups.sort(); // not in the order of the names
        Ok(SiteSums { schema: SUMS.schema.to_owned(), tests: self.tests(), groups, answers, theta })
    }
}

/// Makes the sums that are asked for, and writes them.
///
/// # Errors
/// Bad input, fewer tests than may be told of, what is asked is of another model or version, or [`Failure::Interrupted`].
pub fn sums(job: &SumsJob, watch: &mut dyn JobWatch) -> Result<JobDone<SumsMade>, Failure> {
    let mut spec = model::load(&job.model, &job.data)?;
    let theta = job.at.as_ref().map(Theta::read).transpose()?;
    let given = CommandInputs::open(&mut spec, &job.data)?;
    let documents: Vec<&Document> = std::iter::once(&job.model.document).chain(&job.at).collect();
    let output = OutputFile::prepare(&job.out, &files(&documents, &given.inputs))?;
    let mut work = JobWork::new(watch);
    let name = job.at.as_ref().map_or_else(String::new, Document::name);
    if let Some(theta) = &theta {
        theta.check(&name, &spec)?; // before the data are read
    }
    let site = SumsSite::read(spec, &given, &mut work)?;
    let (found, least) = (site.tests(), job.at_least);
    if found < least {
        return Err(SumsError::Few { found, least }.into());
    }
    work.go_on()?;
    work.say(|| "sums over the tests".to_owned());
    let theta = theta.map_or_else(|| site.first(), Ok)?;
    let round = theta.round;
    output.write(&site.answer(theta, &name)?)?;
    Ok(JobDone::new(SumsMade { tests: found, round }, site.notes.clone(), vec![output.name()]))
}
