//! What a fit found as tables: its tests, its parameters, its constraints. Their numbers are those of fit.json.

use std::fs::File;

use kalfit::FitRecord;
use kalfit::record::{ConstraintRecord, PosteriorRecord, QuantityRecord, TestRecord};
use kalfit_data::{CellKind, TableCell};

use crate::failure::Failure;
use crate::job::TableDestination;
use crate::output::PendingFile;
use crate::table::OutputTable;

/// Which table of a fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FitTableKind {
    /// What each test says: a row for each of its phases.
    Tests,
    /// Means, spreads, correlations and dynamic parameters, a row for each number.
    Parameters,
    /// What each constraint costs.
    Constraints,
}

/// A table of a fit as `kalfit fit` writes it, as an Arrow IPC file without a name.
///
/// # Errors
/// The temporary file cannot be written.
pub fn fit_table(record: &FitRecord, which: FitTableKind) -> Result<File, Failure> {
    let table = OutputTable::prepare(&TableDestination::Back, &[])?.expect("it is handed back");
    let pending = match which {
        FitTableKind::Tests => tests(&table, record)?,
        FitTableKind::Parameters => parameters(&table, record)?,
        FitTableKind::Constraints => constraints(&table, record)?,
    };
    Ok(pending.finish()?.expect("it has no name"))
}

type TableColumns = Vec<(String, CellKind)>;

fn columns<const N: usize>(names: [&str; N], kind: CellKind) -> TableColumns {
    names.map(|name| (name.to_owned(), kind)).to_vec()
}

fn text(text: Option<&String>) -> TableCell<'_> {
    text.map_or(TableCell::Missing, |text| TableCell::Text(text))
}

fn number(x: Option<f64>) -> TableCell<'static> {
    x.map_or(TableCell::Missing, TableCell::Number)
}

fn counted(n: Option<usize>) -> TableCell<'static> {
    n.map_or(TableCell::Missing, TableCell::Count)
}

/// Means, spreads, correlations and dynamic parameters, a row for each number.
pub(crate) fn parameters<'t>(table: &'t OutputTable, record: &FitRecord) -> Result<PendingFile<'t>, Failure> {
    let mut head =
        columns(["name", "kind", "phase", "level", "state", "other_state", "column", "unit"], CellKind::Text);
    head.extend(columns(["estimate", "std_error", "lower", "upper"], CellKind::Number));
    head.extend(columns(["status"], CellKind::Text));
    let all = record.quantities();
    table.write(&head, |writer| all.iter().try_for_each(|own| writer.write(quantity(own))).map_err(table.failed()))
}

fn quantity(own: &QuantityRecord) -> Vec<TableCell<'_>> {
    vec![
        TableCell::Text(&own.name),
        TableCell::Text(&own.kind),
        text(own.phase.as_ref()),
        text(own.level.as_ref()),
        text(own.state.as_ref()),
        text(own.other_state.as_ref()),
        text(own.column.as_ref()),
        text(own.unit.as_ref()),
        number(own.estimate),
        number(own.std_error),
        number(own.lower),
        number(own.upper),
        TableCell::Text(&own.status),
    ]
}

/// What each constraint costs, a row for each constrained element.
pub(crate) fn constraints<'t>(table: &'t OutputTable, record: &FitRecord) -> Result<PendingFile<'t>, Failure> {
    let mut head = columns(["element", "phase", "level"], CellKind::Text);
    let numbers = ["value", "sensitivity", "score_statistic", "p_value", "expected_change"];
    head.extend(columns(numbers, CellKind::Number));
    head.extend(columns(["likelihood_ratio", "likelihood_ratio_p_value"], CellKind::Number));
    let all = &record.constraints;
    table.write(&head, |writer| all.iter().try_for_each(|own| writer.write(constraint(own))).map_err(table.failed()))
}

fn constraint(own: &ConstraintRecord) -> Vec<TableCell<'_>> {
    vec![
        TableCell::Text(&own.element),
        TableCell::Text(&own.phase),
        text(own.level.as_ref()),
        TableCell::Number(own.value),
        number(own.sensitivity),
        number(own.score_statistic),
        number(own.p_value),
        number(own.expected_change),
        number(own.likelihood_ratio),
        number(own.likelihood_ratio_p_value),
    ]
}

/// What each test says: a row for each of its phases.
pub(crate) fn tests<'t>(table: &'t OutputTable, record: &FitRecord) -> Result<PendingFile<'t>, Failure> {
    let shape = TestTableColumns::of(record);
    table.write(&shape.head(), |writer| {
        for test in record.tests.iter() {
            for phase in test.phases.iter() {
                writer.write(shape.row(test, phase)).map_err(table.failed())?;
            }
        }
        Ok(())
    })
}

/// What the table of the tests has columns for.
struct TestTableColumns<'a> {
    record: &'a FitRecord,
    /// Levels of groups, the outermost first, without the tests' own.
    levels: Vec<&'a str>,
    /// Estimated states of all phases, each name once.
    states: Vec<&'a str>,
}

/// Columns that every such table has, after those of groups.
const OF_TEST: [(&str, CellKind); 18] = [
    ("phase", CellKind::Text),
    ("log_likelihood", CellKind::Number),
    ("observations", CellKind::Count),
    ("steps", CellKind::Count),
    ("design_class", CellKind::Count),
    ("distance", CellKind::Number),
    ("degrees_of_freedom", CellKind::Count),
    ("p_value", CellKind::Number),
    ("nis", CellKind::Number),
    ("nis_p_value", CellKind::Number),
    ("innovations_mean", CellKind::Number),
    ("whiteness", CellKind::Number),
    ("whiteness_degrees_of_freedom", CellKind::Count),
    ("whiteness_p_value", CellKind::Number),
    ("log_density_without", CellKind::Number),
    ("distance_without", CellKind::Number),
    ("p_value_without", CellKind::Number),
    ("displacement", CellKind::Number),
];

impl<'a> TestTableColumns<'a> {
    fn of(record: &'a FitRecord) -> TestTableColumns<'a> {
        let own = record.levels.iter().filter(|level| level.column.is_some());
        let mut states: Vec<&str> = Vec::new();
        for state in record.phases.iter().flat_map(|phase| &phase.states) {
            if !states.contains(&state.as_str()) {
                states.push(state);
            }
        }
        TestTableColumns { record, levels: own.map(|level| level.name.as_str()).collect(), states }
    }

    fn head(&self) -> TableColumns {
        let taken = |name: &str| name == "test" || OF_TEST.iter().any(|(other, _)| *other == name);
        // two columns of one name would be one too many
        let free = |name: &str| if taken(name) { format!("level[{name}]") } else { name.to_owned() };
        let mut head = columns(["test"], CellKind::Text);
        head.extend(self.levels.iter().map(|name| (free(name), CellKind::Text)));
        head.extend(self.record.group_column.iter().map(|name| (format!("group[{name}]"), CellKind::Text)));
        head.extend(OF_TEST.map(|(name, kind)| (name.to_owned(), kind)));
        for what in ["mean", "std_dev"] {
            head.extend(self.states.iter().map(|state| (format!("{what}[{state}]"), CellKind::Number)));
        }
        head
    }

    fn row<'r>(&self, test: TestRecord<'r>, phase: PosteriorRecord<'r>) -> Vec<TableCell<'r>> {
        let mut cells = vec![TableCell::Text(test.id)];
        cells.extend((0..self.levels.len()).map(|level| text(test.groups.get(level))));
        cells.extend(self.record.group_column.iter().map(|_| text(test.group)));
        let (seen, without) = (test.innovations, test.deletion);
        let white = seen.and_then(|own| own.whiteness.as_ref());
        cells.extend([
            TableCell::Text(phase.name),
            TableCell::Number(test.log_likelihood),
            TableCell::Count(test.observations),
            counted(test.steps),
            counted(test.design_class),
            number(test.distance),
            TableCell::Count(test.degrees_of_freedom),
            number(test.p_value),
            number(seen.and_then(|own| own.nis)),
            number(seen.and_then(|own| own.nis_p_value)),
            number(seen.and_then(|own| own.mean)),
            number(white.map(|own| own.statistic)),
            counted(white.map(|own| own.degrees_of_freedom)),
            number(white.map(|own| own.p_value)),
            number(without.map(|own| own.log_density)),
            number(without.and_then(|own| own.distance)),
            number(without.and_then(|own| own.p_value)),
            number(without.map(|own| own.displacement)),
        ]);
        let own = self.record.phases.iter().find(|own| own.name == phase.name);
        let place = |state: &str| own.and_then(|own| own.states.iter().position(|other| other == state));
        let deviation = |i: usize| Some(phase.covariance.rows().nth(i)?.get(i)?.max(0.0).sqrt());
        let mean = |state: &&str| number(place(state).and_then(|i| phase.mean.get(i).copied()));
        let std_dev = |state: &&str| number(place(state).and_then(deviation));
        cells.extend(self.states.iter().map(mean));
        cells.extend(self.states.iter().map(std_dev));
        cells
    }
}
