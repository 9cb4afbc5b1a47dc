//! Tables of a fit: of tests, parameters, constraints and suspicious rows, with the numbers of fit.json.

use std::fs::File;

use kalfit::FitRecord;
use kalfit::record::{
    ConstraintRecord, DeletionRecord, Figure, FigureKind, FigureValue, InnovationRecord, PosteriorRecord,
    QuantityRecord, TestRecord, WhitenessRecord, WrongRowRecord,
};
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
    /// Measurements that contradict the others of their test.
    Rows,
}

/// A table of a fit as `kalfit fit` writes it, as an Arrow IPC file without a name.
///
/// # Errors
/// The temporary file cannot be written.
pub fn fit_table(record: &FitRecord, which: FitTableKind) -> Result<File, Failure> {
    let table = OutputTable::prepare(&TableDestination::Back, &[])?.expect("it is handed back");
    Ok(pending(&table, record, which)?.finish()?.expect("it has no name"))
}

/// A table of a fit, whole, not yet in its place.
pub(crate) fn pending<'t>(
    table: &'t OutputTable,
    record: &FitRecord,
    which: FitTableKind,
) -> Result<PendingFile<'t>, Failure> {
    match which {
        FitTableKind::Tests => tests(table, record),
        FitTableKind::Parameters => listed(table, &QuantityRecord::FIGURES, &record.quantities()),
        FitTableKind::Constraints => listed(table, &ConstraintRecord::FIGURES, &record.constraints),
        FitTableKind::Rows => {
            let why = "the fit has no innovations of any test, as its notes say";
            let misfit = record.misfit.as_ref().ok_or(Failure::NoRows { why })?;
            listed(table, &WrongRowRecord::FIGURES, &misfit.wrong_rows)
        }
    }
}

type TableColumns = Vec<(String, CellKind)>;

fn text(text: Option<&String>) -> TableCell<'_> {
    text.map_or(TableCell::Missing, |text| TableCell::Text(text))
}

fn number(x: Option<f64>) -> TableCell<'static> {
    x.map_or(TableCell::Missing, TableCell::Number)
}

/// A column of a table and its cell in one row.
struct ColumnCell<'r> {
    name: &'static str,
    kind: CellKind,
    cell: TableCell<'r>,
}

/// The columns of figures of a record; without a record the cells are missing.
fn figures<'r, R>(figures: &[Figure<R>], record: Option<&'r R>) -> impl Iterator<Item = ColumnCell<'r>> {
    figures.iter().filter_map(move |figure| {
        let kind = match figure.kind {
            FigureKind::Text => CellKind::Text,
            FigureKind::Number => CellKind::Number,
            FigureKind::Count => CellKind::Count,
        };
        let cell = match record.map_or(FigureValue::Missing, |record| figure.of(record)) {
            FigureValue::Text(text) => TableCell::Text(text),
            FigureValue::Number(x) => TableCell::Number(x),
            FigureValue::Count(n) => TableCell::Count(n),
            FigureValue::Missing => TableCell::Missing,
        };
        Some(ColumnCell { name: figure.column?, kind, cell })
    })
}

/// Names and kinds of columns.
fn head<'r>(columns: impl IntoIterator<Item = ColumnCell<'r>>) -> TableColumns {
    columns.into_iter().map(|column| (column.name.to_owned(), column.kind)).collect()
}

/// A table with a row for each record and a column for each figure.
fn listed<'t, R>(table: &'t OutputTable, list: &[Figure<R>], records: &[R]) -> Result<PendingFile<'t>, Failure> {
    let row = |record| -> Vec<TableCell<'_>> { figures(list, Some(record)).map(|column| column.cell).collect() };
    table.write(&head(figures(list, None)), |writer| {
        records.iter().try_for_each(|record| writer.write(row(record))).map_err(table.failed())
    })
}

/// What each test says: a row for each of its phases.
fn tests<'t>(table: &'t OutputTable, record: &FitRecord) -> Result<PendingFile<'t>, Failure> {
    let shape = TestTableColumns::of(record);
    table.write(&shape.head(), |writer| {
        for test in record.tests.iter() {
            for phase in test.phases.iter() {
                writer.write(shape.row(&test, phase)).map_err(table.failed())?;
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

/// Columns that every table of tests has, after those of groups: the phase and the figures of the test, of its innovations
/// and of the fit without it.
fn of_test<'r>(row: Option<(&'r TestRecord<'r>, PosteriorRecord<'r>)>) -> impl Iterator<Item = ColumnCell<'r>> {
    let (test, phase) = row.unzip();
    let seen = test.and_then(|test| test.innovations);
    let phase = phase.map_or(TableCell::Missing, |phase| TableCell::Text(phase.name));
    std::iter::once(ColumnCell { name: "phase", kind: CellKind::Text, cell: phase })
        .chain(figures(&TestRecord::FIGURES, test))
        .chain(figures(&InnovationRecord::FIGURES, seen))
        .chain(figures(&WhitenessRecord::FIGURES, seen.and_then(|own| own.whiteness.as_ref())))
        .chain(figures(&DeletionRecord::FIGURES, test.and_then(|test| test.deletion)))
}

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
        let of_test = head(of_test(None));
        let taken = |name: &str| name == "test" || of_test.iter().any(|(other, _)| other == name);
        // two columns of one name would be one too many
        let free = |name: &str| if taken(name) { format!("level[{name}]") } else { name.to_owned() };
        let mut head = vec![("test".to_owned(), CellKind::Text)];
        head.extend(self.levels.iter().map(|name| (free(name), CellKind::Text)));
        head.extend(self.record.group_column.iter().map(|name| (format!("group[{name}]"), CellKind::Text)));
        head.extend(of_test);
        for what in ["mean", "std_dev"] {
            head.extend(self.states.iter().map(|state| (format!("{what}[{state}]"), CellKind::Number)));
        }
        head
    }

    fn row<'r>(&self, test: &'r TestRecord<'r>, phase: PosteriorRecord<'r>) -> Vec<TableCell<'r>> {
        let mut cells = vec![TableCell::Text(test.id)];
        cells.extend((0..self.levels.len()).map(|level| text(test.groups.get(level))));
        cells.extend(self.record.group_column.iter().map(|_| text(test.group)));
        cells.extend(of_test(Some((test, phase))).map(|column| column.cell));
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

#[cfg(test)]
mod tests {
    use super::*;

    fn names(columns: TableColumns) -> Vec<String> {
        columns.into_iter().map(|(name, _)| name).collect()
    }

    fn assert_unique(mut names: Vec<String>) {
        names.sort();
        let repeated: Vec<&[String]> = names.chunk_by(|a, b| a == b).filter(|same| same.len() > 1).collect();
        assert!(repeated.is_empty(), "columns of one name: {repeated:?}");
    }

    #[test]
    fn columns_of_each_table_have_different_names() {
        assert_unique(names(head(of_test(None))));
        assert_unique(names(head(figures(&QuantityRecord::FIGURES, None))));
        assert_unique(names(head(figures(&ConstraintRecord::FIGURES, None))));
        assert_unique(names(head(figures(&WrongRowRecord::FIGURES, None))));
    }

    #[test]
    fn a_figure_added_to_a_list_appears_in_the_table() {
        let constraint = ConstraintRecord {
            element: "mean[a]".to_owned(),
            phase: "main".to_owned(),
            level: None,
            value: 0.5,
            sensitivity: None,
            score_statistic: Some(4.0),
            p_value: Some(0.0455),
            expected_change: None,
            likelihood_ratio: None,
            likelihood_ratio_p_value: None,
            f: None,
            f_df: None,
            f_p_value: None,
        };
        let doc = "Square root of the score statistic.";
        let root = |own: &ConstraintRecord| {
            own.score_statistic.map_or(FigureValue::Missing, |s| FigureValue::Number(s.sqrt()))
        };
        let added = Figure::new("score", doc, FigureKind::Number, root);
        let hidden = Figure::new("hidden", doc, FigureKind::Number, root).column(None);
        let list = [&ConstraintRecord::FIGURES[..], &[hidden, added.column(Some("z"))]].concat();
        let before = names(head(figures(&ConstraintRecord::FIGURES, None)));
        let after = head(figures(&list, None));
        assert_eq!(after.last(), Some(&("z".to_owned(), CellKind::Number)));
        assert_eq!(names(after), [before, vec!["z".to_owned()]].concat());
        let row: Vec<TableCell<'_>> = figures(&list, Some(&constraint)).map(|column| column.cell).collect();
        assert_eq!(row.first(), Some(&TableCell::Text("mean[a]")));
        assert_eq!(row.last(), Some(&TableCell::Number(2.0)));
    }
}
