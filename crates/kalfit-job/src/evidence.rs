//! What is given of the tests: rows, reductions and estimates, in any mixture.

use std::cell::RefCell;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::io::Read;

use kalfit::model::Parameter;
use kalfit::record::Provenance;
use kalfit::reduce::SplitError;
use kalfit::{Evidence, Labels, PhasedModel, PhasedTest, Reductions, Test};
use kalfit_data::exchange::{
    ExchangeEntry, ExchangeError, ExchangeFile, ExchangeMetadata, ParameterValue, SortedInputs, TestAssembly,
    difference, merge, read_estimates, read_reductions, sort, twice,
};
use kalfit_data::{DataError, DataReading, Datum, Input, TestSink};
use kalfit_spec::Spec;
use rayon::prelude::*;

use crate::failure::Failure;
use crate::refused::{self, SinkRefusal};
use crate::truth::error::TruthError;
use crate::work::JobWork;

/// The inputs of a command, told apart.
pub(crate) struct CommandInputs {
    /// All of them, as they were given.
    pub(crate) inputs: Vec<Input>,
    rows: Vec<Input>,
    reductions: Vec<ExchangeFile>,
    estimates: Vec<ExchangeFile>,
    /// Names of the inputs, those of rows first.
    files: Vec<String>,
    stdin: RefCell<Option<Box<dyn Read>>>,
    /// Some reductions are of estimates.
    of_estimates: bool,
    /// What the user should know.
    pub(crate) notes: Vec<String>,
}

impl CommandInputs {
    /// Looks into the inputs. Where some were made by filters at known parameters, free parameters of the model are held there.
    ///
    /// # Errors
    /// Inputs that cannot be opened, reductions of another model, other values of parameters than the model's.
    pub(crate) fn open(spec: &mut Spec, data: &[Datum]) -> Result<CommandInputs, Failure> {
        let inputs = Input::expand(data).map_err(|error| Failure::data(error, spec))?;
        let sorted = sort(&inputs, stdin(&inputs)).map_err(|error| Failure::data(error, spec))?;
        let SortedInputs { rows, reductions, estimates, files, stdin, .. } = sorted;
        let stdin = RefCell::new(Some(stdin));
        let mut given =
            CommandInputs { inputs, rows, reductions, estimates, files, stdin, of_estimates: false, notes: Vec::new() };
        given.hold(spec)?;
        Ok(given)
    }

    /// Inputs that are read as rows, whatever they hold.
    pub(crate) fn rows_of(inputs: Vec<Input>) -> CommandInputs {
        let (rows, files) = (inputs.clone(), inputs.iter().map(Input::name).collect());
        let stdin = stdin(&inputs);
        let (reductions, estimates, notes) = (Vec::new(), Vec::new(), Vec::new());
        CommandInputs {
            inputs,
            rows,
            reductions,
            estimates,
            files,
            stdin: RefCell::new(Some(stdin)),
            of_estimates: false,
            notes,
        }
    }

    /// Names of the inputs, as they were given.
    pub(crate) fn names(&self) -> Vec<String> {
        self.inputs.iter().map(Input::name).collect()
    }

    /// Nothing but rows is given.
    pub(crate) fn is_rows(&self) -> bool {
        self.reductions.is_empty() && self.estimates.is_empty()
    }

    /// Nothing but reductions is given.
    pub(crate) fn is_reductions(&self) -> bool {
        self.rows.is_empty() && self.estimates.is_empty() && !self.reductions.is_empty()
    }

    /// The reductions of all tests, of a model of one phase, as they stand in the files: nothing else is kept of a test.
    ///
    /// # Errors
    /// Files that are wrong, a test given twice, or nobody who waits.
    pub(crate) fn reduced(&self, spec: &Spec, work: &mut JobWork<'_>) -> Result<Reductions, Failure> {
        let mut tests = PlacedReductions { reductions: Reductions::new(), places: Vec::new() };
        let mut stopped = false;
        for source in &self.reductions {
            let read = read_reductions(source, &spec.model, &mut Labels::default(), &mut |entry| {
                let done = tests.reductions.len();
                if done.is_multiple_of(ASK) && work.is_stopped() {
                    stopped = true;
                    return Err(DataError::NoInput); // whatever ends the reading
                }
                work.say(|| format!("reading: {done} tests"));
                tests.take(entry);
                Ok(())
            });
            if stopped {
                return Err(Failure::Interrupted);
            }
            if let Err(error) = read {
                // of two things that are wrong the first is said
                let error = tests.refuse_twice(&spec.model, &self.files).err().unwrap_or(error);
                return Err(Failure::data(error, spec));
            }
        }
        tests.refuse_twice(&spec.model, &self.files).map_err(|error| Failure::data(error, spec))?;
        Ok(tests.reductions)
    }

    /// The likelihood of a fit is that of estimates.
    pub(crate) fn is_of_estimates(&self, model: &PhasedModel) -> bool {
        self.of_estimates
            || !self.estimates.is_empty()
            || (!self.rows.is_empty() && model.phases.iter().any(|phase| phase.filter.is_some()))
    }

    /// What the record of a fit says of where it comes from.
    pub(crate) fn provenance(&self, spec: &Spec, seconds: f64) -> Provenance {
        Provenance {
            model_digest: Some(spec.digest.clone()),
            model: spec.describe(),
            files: self.names(),
            seconds,
            of_estimates: self.is_of_estimates(&spec.model),
        }
    }

    /// Standard input, from its start; it comes once.
    pub(crate) fn stdin(&self) -> Box<dyn Read> {
        self.stdin.borrow_mut().take().unwrap_or_else(|| Box::new(std::io::empty()))
    }

    /// Checks what the files say of themselves, and fixes free parameters at their α.
    fn hold(&mut self, spec: &mut Spec) -> Result<(), Failure> {
        let digest = spec.reduction_digest();
        let own = ParameterValue::known(spec.model.shared());
        let mut held: Vec<ParameterValue> = Vec::new();
        let mut seen: Vec<(&str, ExchangeMetadata)> = Vec::new();
        for (source, is_reduction) in
            self.reductions.iter().map(|source| (source, true)).chain(self.estimates.iter().map(|s| (s, false)))
        {
            let Some(metadata) = source.metadata().map_err(|error| Failure::data(error, spec))? else { continue };
            if is_reduction {
                metadata.check_digest(&source.name, &digest).map_err(|error| Failure::data(error.into(), spec))?;
            } else if metadata.reduction_digest != digest {
                self.notes.push(format!("{} was made with another version of `{}`", source.name, spec.name));
            }
            let known = seen.iter().map(|(name, other)| (*name, other.parameters.as_slice()));
            let others = std::iter::once((spec.name.as_str(), own.as_slice())).chain(known);
            for (other, parameters) in others {
                if let Some(found) = difference(parameters, &metadata.parameters) {
                    let (file, difference, other) = (source.name.clone(), Box::new(found), other.to_owned());
                    return Err(Failure::data(ExchangeError::Parameter { file, difference, other }.into(), spec));
                }
            }
            merge(&mut held, &metadata.parameters);
            self.of_estimates |= metadata.of_estimates;
            seen.push((&source.name, metadata));
        }
        if let Some((first, _)) = seen.first() {
            let name = (*first).to_owned();
            let note = fix(spec, &held, &name)?;
            self.notes.extend(note);
        }
        Ok(())
    }

    /// All that is known of each phase of each test, whether the phases before it are known or not.
    pub(crate) fn parts(
        &self,
        spec: &Spec,
        model: &PhasedModel,
        work: &mut JobWork<'_>,
    ) -> Result<(Vec<ExchangeEntry>, DataReading), Failure> {
        let (assembly, reading) = self.assembly(spec, model, work)?;
        Ok((assembly.into_entries(), reading))
    }

    /// All tests.
    pub(crate) fn tests(
        &self,
        spec: &Spec,
        model: &PhasedModel,
        work: &mut JobWork<'_>,
    ) -> Result<(Vec<PhasedTest>, DataReading), Failure> {
        let (assembly, mut reading) = self.assembly(spec, model, work)?;
        let tests = assembly.finish().map_err(|error| Failure::data(error, spec))?;
        reading.tests = tests.len();
        Ok((tests, reading))
    }

    fn assembly<'a>(
        &'a self,
        spec: &Spec,
        model: &'a PhasedModel,
        work: &mut JobWork<'_>,
    ) -> Result<(TestAssembly<'a>, DataReading), Failure> {
        let refused = |error: DataError| Failure::data(error, spec);
        let (rows, mut reading) = self.rows(spec, model, work)?;
        reading.files = self.files.clone();
        let mut assembly = TestAssembly::new(model, &self.files);
        rows.into_iter().try_for_each(|entry| assembly.add(entry)).map_err(refused)?;
        let mut done = 0;
        let mut add = |entry: ExchangeEntry| {
            done += 1;
            work.say(|| format!("reading: {done} phases of tests"));
            assembly.add(entry)
        };
        for source in &self.reductions {
            read_reductions(source, model, &mut reading.labels, &mut add).map_err(refused)?;
        }
        for source in &self.estimates {
            read_estimates(source, (model, &spec.layout), &mut reading.labels, &mut add).map_err(refused)?;
        }
        Ok((assembly, reading))
    }

    fn rows(
        &self,
        spec: &Spec,
        model: &PhasedModel,
        work: &mut JobWork<'_>,
    ) -> Result<(Vec<ExchangeEntry>, DataReading), Failure> {
        if self.rows.is_empty() {
            let labels = Labels::new(&model.shared().literals);
            return Ok((Vec::new(), DataReading { labels, ..DataReading::default() }));
        }
        let mut sink = EntrySink { model, entries: Vec::new(), work };
        let reading = kalfit_data::read_from(model, &spec.layout, &self.rows, &mut sink, &mut self.stdin());
        let reading = reading.map_err(|error| refused::failure(error, spec))?;
        Ok((sink.entries, reading))
    }
}

/// So many tests are read before it is asked again whether somebody waits.
const ASK: usize = 1 << 14;

/// Reductions of tests in one phase, and where each stands.
struct PlacedReductions {
    reductions: Reductions,
    places: Vec<kalfit::Source>,
}

impl PlacedReductions {
    fn take(&mut self, entry: ExchangeEntry) {
        if let Evidence::Reduced(piece) = entry.evidence {
            self.reductions.push(piece.reduction);
            self.places.push(entry.at);
        }
    }

    /// Refuses the first test that was there before. Ids of equal hash are looked at, in their order.
    fn refuse_twice(&self, model: &PhasedModel, files: &[String]) -> Result<(), DataError> {
        let id = |j: usize| self.reductions.get(j).test;
        let hashed = |j: usize| {
            let mut hasher = DefaultHasher::new();
            id(j).hash(&mut hasher);
            (hasher.finish(), j)
        };
        let mut order: Vec<(u64, usize)> = (0..self.reductions.len()).into_par_iter().map(hashed).collect();
        order.par_sort_unstable();
        let of_group = |group: &[(u64, usize)]| {
            (1..group.len()).find_map(|at| {
                let (_, second) = group[at];
                let first = group[..at].iter().map(|(_, first)| *first).find(|&first| id(first) == id(second))?;
                Some((second, first))
            })
        };
        match order.chunk_by(|a, b| a.0 == b.0).filter_map(of_group).min() {
            Some((second, first)) => {
                Err(twice(model, files, (id(second), 0), [self.places[first], self.places[second]]))
            }
            None => Ok(()),
        }
    }
}

/// Standard input where it is read, and nothing elsewhere: others may be reading it.
pub(crate) fn stdin(inputs: &[Input]) -> Box<dyn Read> {
    if inputs.contains(&Input::Stdin) { Box::new(std::io::stdin().lock()) } else { Box::new(std::io::empty()) }
}

/// Rows by phase.
pub(crate) fn entries(
    model: &PhasedModel,
    tests: Vec<Test>,
    labels: &Labels,
) -> Result<Vec<ExchangeEntry>, SplitError> {
    let mut entries = Vec::new();
    for test in tests {
        for (phase, rows) in model.rows_by_phase(test, labels)?.into_iter().enumerate() {
            if rows.rows() > 0 {
                let (test, at) = (rows.id.to_string(), rows.source(0));
                entries.push(ExchangeEntry { test, phase, evidence: Evidence::Rows(rows), at });
            }
        }
    }
    Ok(entries)
}

struct EntrySink<'a, 'w> {
    model: &'a PhasedModel,
    entries: Vec<ExchangeEntry>,
    work: &'a mut JobWork<'w>,
}

impl TestSink for EntrySink<'_, '_> {
    type Error = SinkRefusal;

    fn tests(&mut self, tests: Vec<Test>, labels: &Labels) -> Result<(), SinkRefusal> {
        SinkRefusal::unless_stopped(self.work)?;
        self.entries.extend(entries(self.model, tests, labels).map_err(SinkRefusal::Split)?);
        let done = self.entries.len();
        self.work.say(|| format!("reading: {done} phases of tests"));
        Ok(())
    }

    fn bytes(&mut self, done: u64, of: Option<u64>) -> Result<(), SinkRefusal> {
        SinkRefusal::unless_stopped_at(self.work, done, of)
    }

    fn restart(&mut self) {
        self.entries.clear();
    }
}

/// Gives the model's free parameters the values of a file; a note that says so.
fn fix(spec: &mut Spec, held: &[ParameterValue], file: &str) -> Result<Option<String>, Failure> {
    let free: Vec<Parameter> = spec.model.shared().parameters.iter().filter(|p| p.is_free()).cloned().collect();
    let mut names = Vec::new();
    for parameter in free {
        let Some(known) = held.iter().find(|known| known.name == parameter.name) else { continue };
        let levels = known.levels.iter().map(|(level, value)| (Some(level.as_str()), *value));
        let values: Vec<(Option<&str>, f64)> = levels.chain(known.value.map(|value| (None, value))).collect();
        if values.is_empty() {
            continue;
        }
        spec.give(&parameter.name, &values)
            .map_err(|error| Failure::from(TruthError::Value { path: file.to_owned(), error: Box::new(error) }))?;
        names.push(format!("`{}`", parameter.name));
    }
    Ok((!names.is_empty()).then(|| {
        let (is, it) = if names.len() == 1 { ("is", "the value") } else { ("are", "the values") };
        format!("{} {is} held at {it} at which filters made `{file}`", names.join(", "))
    }))
}
