//! Drawing an ensemble: `kalfit simulate`.

use std::collections::HashMap;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::PathBuf;

use kalfit::record::PlanRecord;
use kalfit::reduce::Evidence;
use kalfit::simulate::{Designs, Drawn, Simulator};
use kalfit::{PhasedTest, Test};
use kalfit_data::{
    CellKind, DataReading, Input, TableCell, TableFormat, TableWriter, TestWriter, WriteError, WrittenIds,
    added_id_column,
};
use kalfit_spec::Spec;

use crate::document::Document;
use crate::evidence::CommandInputs;
use crate::failure::Failure;
use crate::job::{JobDone, SimulateJob, SimulatedEnsemble, files};
use crate::output::{OutputFile, OutputTarget, PendingFile, finish_together};
use crate::results::{self, PLAN};
use crate::work::{JobWatch, JobWork};
use crate::{tests, truth};

/// Tests are drawn this many at a time, or fewer if they have many rows.
const BATCH_TESTS: u64 = 1024;
const BATCH_ROWS: u64 = 200_000;

/// Draws an ensemble of tests.
///
/// # Errors
/// Bad input, or [`Failure::Interrupted`].
pub fn simulate(job: &SimulateJob, watch: &mut dyn JobWatch) -> Result<JobDone<SimulatedEnsemble>, Failure> {
    let (spec, truth) = truth::load(&job.model, &job.from)?;
    let inputs = Input::expand(&job.design).map_err(|error| Failure::data(error, &spec))?;
    let format_of = |path: &PathBuf| TableFormat::of(path).map_err(|error| failed(error, path.display().to_string()));
    let format = job.out.as_ref().map_or(Ok(TableFormat::Arrow), format_of)?;
    let used = files(&[&job.model.document, &job.from], &inputs);
    let output = OutputTarget::prepare(job.out.as_deref(), &used)?;
    let states_format = job.states.as_ref().map_or(Ok(TableFormat::Csv), format_of)?;
    let states = job.states.as_deref().map(|path| OutputFile::prepare(path, &used)).transpose()?;
    output.refuse_same(states.as_ref())?;
    let mut work = JobWork::new(watch);
    let refused = |error, reading| Failure::Simulate { error: Box::new(error), reading };
    let simulator = Simulator::new(&spec.model, &truth.alpha, truth.population.clone(), job.seed)
        .map_err(|error| refused(error, None))?;
    let (tests, reading) = tests::read(&spec, &CommandInputs::rows_of(inputs), &mut work)?;
    let tests = match &job.plan {
        Some(plan) => of_plan(&spec, tests, plan)?,
        None => tests,
    };
    let designs = Designs::of(&spec.model, tests).map_err(|error| refused(error, None))?;
    let count = job.tests.unwrap_or(designs.tests().len() as u64);
    if count > designs.tests().len() as u64 && !spec.model.levels.is_empty() {
        return Err(Failure::MoreThanDesign { found: count, expected: designs.tests().len() as u64 });
    }
    let has_new_ids = count > designs.tests().len() as u64 || job.plan.is_some();
    let ids = if has_new_ids { WrittenIds::New } else { WrittenIds::Same };
    let (simulator, designs, reading) = (&simulator, &designs, &reading);
    let task = SimulationTask { spec: &spec, simulator, designs, reading, count, ids, states_format };
    let WrittenEnsemble { rows, table, initial } = task.write((&output, format), states.as_ref(), &mut work)?;
    let added = added_id_column(spec.model.shared(), &spec.layout, ids);
    let states = states.map(|states| states.name());
    let state_names = spec.model.estimated_names();
    let record = SimulatedEnsemble { tests: count, rows, states, added, table, initial, state_names };
    Ok(JobDone::new(record, truth.warnings, output.name().into_iter().collect()))
}

/// The tests of the design, each as often as a plan has it.
fn of_plan(spec: &Spec, tests: Vec<PhasedTest>, plan: &Document) -> Result<Vec<PhasedTest>, Failure> {
    let refused = |problem| Failure::PlanToDraw { path: plan.name(), problem };
    let record: PlanRecord = results::read(plan, PLAN).map_err(|error| refused(error.to_string()))?;
    let best = record.best.ok_or_else(|| refused("it has no candidates".to_owned()))?;
    if !spec.model.levels.is_empty() {
        return Err(refused("the model has levels, whose groups need names of their own".to_owned()));
    }
    let counts: HashMap<&str, usize> = best.candidates.iter().map(|one| (one.name.as_str(), one.tests)).collect();
    let mut drawn = Vec::new();
    for test in tests {
        let count = counts.get(test.id.as_str());
        let count = *count.ok_or_else(|| refused(format!("it has no candidate `{}`", test.id)))?;
        let like = |k: usize| PhasedTest { id: format!("{}#{k}", test.id).into(), phases: test.phases.clone() };
        drawn.extend((1..=count).map(like));
    }
    if drawn.is_empty() {
        return Err(refused("it has no tests".to_owned()));
    }
    Ok(drawn)
}

/// Ids of tests and their true initial states.
type TrueStates = Vec<(String, Vec<f64>)>;

/// What was written.
struct WrittenEnsemble {
    rows: u64,
    table: Option<File>,
    initial: TrueStates,
}

/// All that a drawn file depends on.
struct SimulationTask<'a> {
    spec: &'a Spec,
    simulator: &'a Simulator,
    designs: &'a Designs,
    reading: &'a DataReading,
    /// Number of tests.
    count: u64,
    ids: WrittenIds,
    states_format: TableFormat,
}

impl SimulationTask<'_> {
    /// Draws and writes; nothing is in place before all is written. The number of rows.
    fn write(
        &self,
        (output, format): (&OutputTarget, TableFormat),
        states: Option<&OutputFile>,
        work: &mut JobWork<'_>,
    ) -> Result<WrittenEnsemble, Failure> {
        let data_file = output.begin()?;
        let states_file = states.map(OutputFile::begin).transpose()?;
        let mut initial = Vec::new();
        let keep = matches!(output, OutputTarget::Nameless).then_some(&mut initial);
        let rows = self.fill((&data_file, format), (states_file.as_ref(), keep), work)?;
        let [table, _] = finish_together([Some(data_file), states_file])?;
        Ok(WrittenEnsemble { rows, table, initial })
    }

    fn fill(
        &self,
        (data, format): (&PendingFile<'_>, TableFormat),
        (states, mut keep): (Option<&PendingFile<'_>>, Option<&mut TrueStates>),
        work: &mut JobWork<'_>,
    ) -> Result<u64, Failure> {
        let spec = self.spec;
        let in_data = |error: WriteError| failed(error, data.name());
        let sink = BufWriter::new(data.file());
        let mut table = TestWriter::new(spec.model.shared(), &spec.layout, self.ids, format, sink).map_err(in_data)?;
        let names = spec.model.estimated_names();
        let begin = |pending| StateTable::new(pending, self.states_format, &names);
        let mut truths = states.map(begin).transpose()?;
        let (mut rows, mut done) = (0, 0);
        while done < self.count {
            let next = self.count.min(done + self.batch(done));
            work.go_on()?;
            let drawn = self.draw(done..next)?;
            truths.as_mut().map_or(Ok(()), |truths| truths.write(&drawn))?;
            if let Some(keep) = &mut keep {
                keep.extend(drawn.iter().map(|drawn| (drawn.test.id.to_string(), drawn.initial.clone())));
            }
            let tests: Vec<Test> = drawn.into_iter().map(|drawn| drawn.test.joined()).collect();
            rows += tests.iter().map(|test| test.rows() as u64).sum::<u64>();
            table.write(tests.iter(), &self.reading.labels).map_err(in_data)?;
            done = next;
            work.share("drawing", done, self.count);
            work.say(|| format!("drawing: {done} of {} tests", self.count));
        }
        let mut sink = table.finish().map_err(in_data)?;
        sink.flush().map_err(|error| failed(error.into(), data.name()))?;
        truths.map_or(Ok(()), StateTable::finish)?;
        Ok(rows)
    }

    fn draw(&self, places: std::ops::Range<u64>) -> Result<Vec<Drawn>, Failure> {
        self.simulator.draw(self.designs, places).map_err(|error| Failure::Simulate {
            error: Box::new(error),
            reading: Some(Box::new(self.reading.clone())),
        })
    }

    /// How many tests to draw at once, from this one on.
    fn batch(&self, from: u64) -> u64 {
        let mut rows = 0;
        let mut many = 0;
        while many < BATCH_TESTS && rows < BATCH_ROWS {
            let rows_of =
                |evidence: &Evidence| if let Evidence::Rows(rows) = evidence { rows.rows() as u64 } else { 0 };
            rows += self.designs.design(from + many).phases.iter().map(rows_of).sum::<u64>();
            many += 1;
        }
        many
    }
}

/// The file of true initial states.
struct StateTable<'a> {
    writer: TableWriter<BufWriter<&'a File>>,
    path: String,
    /// Columns of states.
    width: usize,
}

impl<'a> StateTable<'a> {
    /// The ids stand in column `test`, or in `test_2` and so on beside a state of that name.
    fn new(pending: &'a PendingFile<'_>, format: TableFormat, states: &[String]) -> Result<StateTable<'a>, Failure> {
        let path = pending.name();
        let mut names = std::iter::once("test".to_owned()).chain((2_u32..).map(|k| format!("test_{k}")));
        let id = names.find(|name| !states.contains(name)).expect("one of so many names is free");
        let numbers = states.iter().map(|state| (state.clone(), CellKind::Number));
        let columns: Vec<(String, CellKind)> = std::iter::once((id, CellKind::Text)).chain(numbers).collect();
        let writer = TableWriter::new(&columns, format, BufWriter::new(pending.file()));
        let writer = writer.map_err(|error| failed(error, path.clone()))?;
        Ok(StateTable { writer, path, width: states.len() })
    }

    fn write(&mut self, drawn: &[Drawn]) -> Result<(), Failure> {
        for Drawn { test, initial } in drawn {
            // no cells for phases that the test lacks
            let missing = std::iter::repeat_n(TableCell::Missing, self.width - initial.len());
            let states = initial.iter().map(|x| TableCell::Number(*x)).chain(missing);
            let written = self.writer.write(std::iter::once(TableCell::Text(&test.id)).chain(states));
            written.map_err(|error| failed(error, self.path.clone()))?;
        }
        Ok(())
    }

    fn finish(self) -> Result<(), Failure> {
        let path = &self.path;
        let mut sink = self.writer.finish().map_err(|error| failed(error, path.clone()))?;
        sink.flush().map_err(|error| failed(error.into(), path.clone()))
    }
}

fn failed(error: WriteError, path: String) -> Failure {
    Failure::Write { error: Box::new(error), path }
}
