//! The tables of `kalfit apply`: what each test says, and states at every step.

use kalfit::apply::{Applied, Laws, PhaseStates, Said, StateKind};
use kalfit::{PhasedModel, PhasedTest};
use kalfit_data::{CellKind, DataReading, TableCell, WriteError};
use kalfit_spec::Spec;

use crate::failure::Failure;
use crate::output::PendingFile;
use crate::refused::by_apply;
use crate::table::{OutputTable, OutputTableWriter};
use crate::tests;
use crate::work::JobWork;

/// States of this many rows, or of one test, are held at a time.
const BATCH_ROWS: usize = 200_000;

/// What the tables are of.
pub(super) struct AppliedTests<'a> {
    pub(super) spec: &'a Spec,
    pub(super) applied: &'a Applied<'a>,
    pub(super) tests: &'a [PhasedTest],
    pub(super) reading: &'a DataReading,
}

impl AppliedTests<'_> {
    fn model(&self) -> &PhasedModel {
        &self.spec.model
    }

    /// Estimated states of all phases, each name once.
    fn estimated(&self) -> Vec<String> {
        let mut names: Vec<String> = Vec::new();
        for phase in &self.model().phases {
            for name in phase.model.estimated_names() {
                if !names.contains(&name) {
                    names.push(name);
                }
            }
        }
        names
    }

    /// A row for each phase of each test.
    pub(super) fn tests<'t>(&self, table: &'t OutputTable, said: (&Said, &Laws)) -> Result<PendingFile<'t>, Failure> {
        let names = self.estimated();
        let numbers = ["log_density", "distance"].map(|name| (name.to_owned(), CellKind::Number));
        let of =
            |what: &str| names.iter().map(|name| (format!("{what}[{name}]"), CellKind::Number)).collect::<Vec<_>>();
        let mut columns = vec![("test".to_owned(), CellKind::Text), ("phase".to_owned(), CellKind::Text)];
        columns.extend(numbers);
        columns.push(("degrees_of_freedom".to_owned(), CellKind::Count));
        columns.push(("p_value".to_owned(), CellKind::Number));
        columns.push(("observations".to_owned(), CellKind::Count));
        columns.extend(["nis", "nis_p_value", "residual"].map(|name| (name.to_owned(), CellKind::Number)));
        columns.push(("residual_degrees_of_freedom".to_owned(), CellKind::Count));
        columns.extend(of("mean").into_iter().chain(of("std_dev")));
        table.write(&columns, |writer| {
            for number in 0..self.tests.len() {
                for phase in 0..self.tests[number].phases.len() {
                    let cells = self.test((number, phase), said, &names);
                    writer.write(cells).map_err(table.failed())?;
                }
            }
            Ok(())
        })
    }

    fn test<'a>(
        &'a self,
        (number, phase): (usize, usize),
        (said, laws): (&Said, &Laws),
        names: &[String],
    ) -> Vec<TableCell<'a>> {
        let (test, posterior) = (&self.tests[number], said.posteriors.get(number));
        let model = &self.model().phases[phase];
        let number_or = |x: Option<f64>| x.map_or(TableCell::Missing, TableCell::Number);
        let summary = said.innovations[number].as_ref().map(|own| &own.summary);
        let residual = said.residuals[number];
        let mut cells = vec![
            TableCell::Text(&test.id),
            TableCell::Text(&model.name),
            TableCell::Number(posterior.log_likelihood),
            TableCell::Number(posterior.distance.squared),
            TableCell::Count(posterior.distance.degrees_of_freedom),
            number_or(laws.tests[number].and_then(|law| law.tails(posterior.distance.squared)).map(|tails| tails[1])),
            summary.map_or(TableCell::Missing, |own| TableCell::Count(own.count)),
            number_or(summary.map(|own| own.nis + 0.0)), // of nothing it is -0
            number_or(summary.and_then(|own| own.upper_tail)),
            number_or(residual.map(|own| own.0)),
            residual.map_or(TableCell::Missing, |own| TableCell::Count(own.1)),
        ];
        let (own, first) = (model.model.estimated_names(), self.model().ranges()[phase].start);
        let place = |name: &String| own.iter().position(|other| other == name);
        let mean = |i: usize| posterior.mean.get(first + i).copied();
        let deviation = |i: usize| Some(posterior.covariances().nth(phase)?[(i, i)].max(0.0).sqrt());
        cells.extend(names.iter().map(|name| number_or(place(name).and_then(mean))));
        cells.extend(names.iter().map(|name| number_or(place(name).and_then(deviation))));
        cells
    }

    /// A row for each state at each step, and for each measured value.
    pub(super) fn states<'t>(
        &self,
        table: &'t OutputTable,
        kind: StateKind,
        work: &mut JobWork<'_>,
    ) -> Result<PendingFile<'t>, Failure> {
        let text = |name: &str| (name.to_owned(), CellKind::Text);
        let number = |name: &str| (name.to_owned(), CellKind::Number);
        let columns = [
            text("test"),
            text("phase"),
            ("row".to_owned(), CellKind::Count),
            number("time"),
            text("name"),
            number("value"),
            number("std_dev"),
            text("what"),
        ];
        table.write(&columns, |writer| {
            let mut done = 0;
            while done < self.tests.len() {
                let next = tests::batch(self.tests, done, BATCH_ROWS);
                work.go_on()?;
                let states = self.applied.states(kind, done..next).map_err(|error| by_apply(error, self.reading))?;
                for (test, phases) in self.tests[done..next].iter().zip(&states) {
                    phases.iter().try_for_each(|phase| self.phase(&test.id, phase, writer)).map_err(table.failed())?;
                }
                done = next;
                work.share("writing states", done as u64, self.tests.len() as u64);
                work.say(|| format!("writing states: {done} of {} tests", self.tests.len()));
            }
            Ok(())
        })
    }

    fn phase(&self, test: &str, states: &PhaseStates, writer: &mut OutputTableWriter<'_>) -> Result<(), WriteError> {
        let phase = &self.model().phases[states.phase];
        let begin = |row: usize, time: Option<f64>| {
            let time = time.map_or(TableCell::Missing, TableCell::Number);
            // rows are counted from one
            [TableCell::Text(test), TableCell::Text(&phase.name), TableCell::Count(row + 1), time]
        };
        for step in &states.steps {
            for ((state, mean), std_dev) in phase.model.states.iter().zip(&step.mean).zip(&step.std_dev) {
                let own = [
                    TableCell::Text(&state.name),
                    TableCell::Number(*mean),
                    TableCell::Number(*std_dev),
                    TableCell::Text("state"),
                ];
                writer.write(begin(step.rows.start, step.time).into_iter().chain(own))?;
            }
            for prediction in &step.measurements {
                let name = &phase.model.measurements[prediction.measurement].name;
                let (value, std_dev) = (TableCell::Number(prediction.value), TableCell::Number(prediction.std_dev));
                let own = [TableCell::Text(name), value, std_dev, TableCell::Text("measurement")];
                writer.write(begin(prediction.row, step.time).into_iter().chain(own))?;
            }
        }
        Ok(())
    }
}
