//! `kalfit simulate`.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use kalfit::Test;
use kalfit::reduce::Evidence;
use kalfit::simulate::{Designs, Drawn, Simulator};
use kalfit_data::{Format, Ids, Input, Reading, StateWriter, TestWriter, WriteError, added_id_column};
use kalfit_spec::Spec;

use crate::failure::Failure;
use crate::job::{Outcome, SimulateJob};
use crate::output::{Output, Pending};
use crate::progress::Line;
use crate::{model, terminal, tests, truth};

/// Tests are drawn this many at a time, or fewer if they have many rows.
const BATCH_TESTS: u64 = 1024;
const BATCH_ROWS: u64 = 200_000;

pub(crate) fn run(job: &SimulateJob) -> Result<Outcome, Failure> {
    let mut spec = model::read(&job.model.path)?;
    let truth = truth::load(&mut spec, &job.from, &job.model.set)?;
    let inputs = Input::expand(&job.design).map_err(|error| Failure::data(error, &spec))?;
    let format = Format::of(&job.out).map_err(|error| failed(error, &job.out))?;
    let used = used(&job.model.path, &job.from, &inputs);
    let used: Vec<&Path> = used.iter().map(PathBuf::as_path).collect();
    let output = Output::prepare(&job.out, &used)?;
    let states = job.states.as_deref().map(|path| Output::prepare(path, &used)).transpose()?;
    output.refuse_same(states.as_ref())?;
    let mut line = Line::new(job.quiet);
    let refused = |error, reading| Failure::Simulate { error: Box::new(error), reading };
    let simulator = Simulator::new(&spec.model, &truth.alpha, truth.population.clone(), job.seed)
        .map_err(|error| refused(error, None))?;
    let (tests, reading) = tests::read(&spec, &inputs, &mut line)?;
    let designs = Designs::new(tests).map_err(|error| refused(error, None))?;
    let count = job.tests.unwrap_or(designs.tests().len() as u64);
    let ids = if count > designs.tests().len() as u64 { Ids::New } else { Ids::Same };
    let task = Task { spec: &spec, simulator: &simulator, designs: &designs, reading: &reading, count, ids };
    let rows = task.write((&output, format), states.as_ref(), &mut line)?;
    line.clear();
    if !job.quiet {
        terminal::warn(&truth.warnings);
        terminal::complain(&task.words(job.seed, rows, &output, states.as_ref()));
    }
    Ok(Outcome::Done)
}

/// All that a drawn file depends on.
struct Task<'a> {
    spec: &'a Spec,
    simulator: &'a Simulator,
    designs: &'a Designs,
    reading: &'a Reading,
    /// Number of tests.
    count: u64,
    ids: Ids,
}

impl Task<'_> {
    /// Draws and writes; nothing is in place before all is written. The number of rows.
    fn write(
        &self,
        (output, format): (&Output, Format),
        states: Option<&Output>,
        line: &mut Line,
    ) -> Result<u64, Failure> {
        let data_file = output.begin()?;
        let states_file = states.map(Output::begin).transpose()?;
        let rows = self.fill((&data_file, format), states_file.as_ref(), line)?;
        data_file.finish()?;
        states_file.map_or(Ok(()), Pending::finish)?;
        Ok(rows)
    }

    fn fill(
        &self,
        (data, format): (&Pending<'_>, Format),
        states: Option<&Pending<'_>>,
        line: &mut Line,
    ) -> Result<u64, Failure> {
        let spec = self.spec;
        let in_data = |error: WriteError| failed(error, data.path());
        let sink = BufWriter::new(data.file());
        let mut table = TestWriter::new(spec.model.shared(), &spec.layout, self.ids, format, sink).map_err(in_data)?;
        let names = spec.model.estimated_names();
        let begin = |pending| StateTable::new(pending, &names);
        let mut truths = states.map(begin).transpose()?;
        let (mut rows, mut done) = (0, 0);
        while done < self.count {
            let next = self.count.min(done + self.batch(done));
            let drawn = self.draw(done..next)?;
            truths.as_mut().map_or(Ok(()), |truths| truths.write(&drawn))?;
            let tests: Vec<Test> = drawn.into_iter().map(|drawn| drawn.test.joined()).collect();
            rows += tests.iter().map(|test| test.rows() as u64).sum::<u64>();
            table.write(tests.iter(), &self.reading.labels).map_err(in_data)?;
            done = next;
            line.say(|| format!("drawing: {done} of {} tests", self.count));
        }
        let mut sink = table.finish().map_err(in_data)?;
        sink.flush().map_err(|error| failed(error.into(), data.path()))?;
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

    /// What was done, and what the reader of the file must know.
    fn words(&self, seed: u64, rows: u64, output: &Output, states: Option<&Output>) -> String {
        let plural = |n: u64, what: &str| if n == 1 { format!("1 {what}") } else { format!("{n} {what}s") };
        let (tests, rows) = (plural(self.count, "test"), plural(rows, "row"));
        let mut text = format!("Wrote {}: {tests}, {rows}, drawn with seed {seed}\n", output.name());
        if let Some(states) = states {
            text.push_str(&format!("Wrote {}: the initial states that were drawn\n", states.name()));
        }
        if let Some(column) = added_id_column(self.spec.model.shared(), &self.spec.layout, self.ids) {
            text.push_str(&format!(
                "The tests are told apart by column `{column}`: to fit this file, set `test = \"{column}\"` in `[data]`\n"
            ));
        }
        text
    }
}

/// The file of true initial states.
struct StateTable<'a> {
    writer: StateWriter<BufWriter<&'a File>>,
    path: &'a Path,
    /// Columns of states.
    width: usize,
}

impl<'a> StateTable<'a> {
    fn new(pending: &'a Pending<'_>, states: &[String]) -> Result<StateTable<'a>, Failure> {
        let path = pending.path();
        let writer = StateWriter::new(BufWriter::new(pending.file()), states).map_err(|error| failed(error, path))?;
        Ok(StateTable { writer, path, width: states.len() })
    }

    fn write(&mut self, drawn: &[Drawn]) -> Result<(), Failure> {
        let width = self.width;
        let mut write = |drawn: &Drawn| {
            let mut initial = drawn.initial.clone();
            initial.resize(width, f64::NAN); // empty cells for phases that the test lacks
            self.writer.write(&drawn.test.id, &initial)
        };
        drawn.iter().try_for_each(&mut write).map_err(|error| failed(error, self.path))
    }

    fn finish(self) -> Result<(), Failure> {
        let mut sink = self.writer.finish().map_err(|error| failed(error, self.path))?;
        sink.flush().map_err(|error| failed(error.into(), self.path))
    }
}

fn failed(error: WriteError, path: &Path) -> Failure {
    Failure::Write { error: Box::new(error), path: path.display().to_string() }
}

/// Files that are read, which no output may replace.
pub(crate) fn used(model: &Path, from: &Path, inputs: &[Input]) -> Vec<PathBuf> {
    let data = inputs.iter().filter_map(|input| match input {
        Input::Path(path) => Some(path.clone()),
        Input::Stdin => None,
    });
    [model.to_owned(), from.to_owned()].into_iter().chain(data).collect()
}
