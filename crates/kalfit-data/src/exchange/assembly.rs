//! What is known of each test, from wherever it came.

use std::collections::HashMap;

use kalfit::{Evidence, PhasedModel, PhasedTest, Source};

use super::error::ExchangeError;
use crate::cell::shown;
use crate::error::DataError;

/// What one row of an exchange file says.
#[derive(Debug, Clone, PartialEq)]
pub struct ExchangeEntry {
    /// Id of the test.
    pub test: String,
    /// Place of the phase in the model.
    pub phase: usize,
    /// What is known of it.
    pub evidence: Evidence,
    /// File and row.
    pub at: Source,
}

/// Puts tests together whose phases come from several files.
#[derive(Debug)]
pub struct TestAssembly<'a> {
    model: &'a PhasedModel,
    /// By [`Source::file`].
    files: &'a [String],
    /// In order of first appearance.
    tests: Vec<AssembledTest>,
    places: HashMap<String, usize>,
}

#[derive(Debug)]
struct AssembledTest {
    id: String,
    phases: Vec<Option<(Evidence, Source)>>,
}

impl<'a> TestAssembly<'a> {
    /// No test yet. `files`: names of files by [`Source::file`], for messages.
    pub fn new(model: &'a PhasedModel, files: &'a [String]) -> TestAssembly<'a> {
        TestAssembly { model, files, tests: Vec::new(), places: HashMap::new() }
    }

    /// Adds what is known of one phase of a test.
    ///
    /// # Errors
    /// The phase is known already.
    pub fn add(&mut self, entry: ExchangeEntry) -> Result<(), DataError> {
        let ExchangeEntry { test, phase, evidence, at } = entry;
        let place = *self.places.entry(test).or_insert_with_key(|id| {
            self.tests.push(AssembledTest { id: id.clone(), phases: self.model.phases.iter().map(|_| None).collect() });
            self.tests.len() - 1
        });
        let parts = &mut self.tests[place];
        if let Some((_, first)) = &parts.phases[phase] {
            return Err(twice(self.model, self.files, (&parts.id, phase), [*first, at]));
        }
        parts.phases[phase] = Some((evidence, at));
        Ok(())
    }

    /// True when something is known of a test.
    pub fn has(&self, test: &str) -> bool {
        self.places.contains_key(test)
    }

    /// All that was added, test by test, each phase by itself.
    pub fn into_entries(self) -> Vec<ExchangeEntry> {
        let of = |AssembledTest { id, phases }: AssembledTest| {
            let known = phases.into_iter().enumerate();
            known.filter_map(move |(phase, part)| {
                part.map(|(evidence, at)| ExchangeEntry { test: id.clone(), phase, evidence, at })
            })
        };
        self.tests.into_iter().flat_map(of).collect()
    }

    /// The tests, in order of first appearance.
    ///
    /// # Errors
    /// A test with a phase, but not the one before it.
    pub fn finish(self) -> Result<Vec<PhasedTest>, DataError> {
        let (model, files) = (self.model, self.files);
        self.tests.into_iter().map(|parts| whole(parts, model, files)).collect()
    }
}

/// The error of a phase of a test that is known from two places, the first one first. `files`: names by [`Source::file`].
pub fn twice(model: &PhasedModel, files: &[String], (test, phase): (&str, usize), at: [Source; 2]) -> DataError {
    let [first, second] = at.map(|at| crate::place::place(files, at));
    let (test, phase) = (shown(test.as_bytes()), model.phases[phase].name.clone());
    ExchangeError::Twice { test, phase, first, second }.into()
}

fn whole(parts: AssembledTest, model: &PhasedModel, files: &[String]) -> Result<PhasedTest, DataError> {
    let AssembledTest { id, phases } = parts;
    let mut known = Vec::new();
    let mut lacking = None;
    for (index, part) in phases.into_iter().enumerate() {
        match (part, lacking) {
            (Some((evidence, _)), None) => known.push(evidence),
            (None, _) => lacking = lacking.or(Some(index)),
            (Some((_, at)), Some(lacking)) => {
                let name = |phase: usize| model.phases[phase].name.clone();
                return Err(DataError::from(ExchangeError::Gap {
                    at: crate::place::place(files, at),
                    test: shown(id.as_bytes()),
                    phase: name(index),
                    lacking: name(lacking),
                }));
            }
        }
    }
    Ok(PhasedTest { id: id.into(), phases: known.into() })
}
