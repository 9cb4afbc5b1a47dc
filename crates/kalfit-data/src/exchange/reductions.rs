//! Reductions files: what the filters made of each phase, to the last bit.

use std::fs::File;
use std::io;

use kalfit::model::Phase;
use kalfit::reduce::{Inherited, Path, PhaseReduction, Terminal};
use kalfit::{Evidence, Label, Labels, PhasedModel, Reduction};
use nalgebra::{DMatrix, DVector};
use parquet::file::metadata::RowGroupMetaData;
use parquet::file::reader::ChunkReader;

use super::assembly::ExchangeEntry;
use super::content::{ExchangeBytes, ExchangeFile};
use super::error::ExchangeError;
use super::keys::PhaseFinder;
use super::metadata::ExchangeMetadata;
use super::schema::{GROUPS, REDUCTIONS, REDUCTIONS_KIND, TEST};
use super::sheet::{ExchangeSheet, RowGroupPart, SheetPlan, SheetRequest, SheetRow};
use crate::error::DataError;
use crate::kind::PARQUET;
use crate::table::ahead::{BlockTask, BlockTasks, Demand, MakeBlock, TableProgress, each};

pub(super) const INFORMATION: &str = "information";
pub(super) const SQUARE_ROOT: &str = "square-root";

/// Reads a reductions file and hands its rows on. That it was made with this model and α is for
/// [`ExchangeMetadata::check_digest`] and [`difference`](super::difference) to say. Names of groups are added to `labels`.
///
/// # Errors
/// What is wrong with the file, with its place: of a model with levels also that it does not say the groups of its tests; whatever
/// `take` returns.
pub fn read_reductions(
    source: &ExchangeFile,
    model: &PhasedModel,
    labels: &mut Labels,
    take: &mut dyn FnMut(ExchangeEntry) -> Result<(), DataError>,
) -> Result<ExchangeMetadata, DataError> {
    let mut labelled = |(mut entry, groups): (ExchangeEntry, Vec<String>)| {
        if let Evidence::Reduced(piece) = &mut entry.evidence {
            let label = |name: &String| if name.is_empty() { Label::MISSING } else { labels.intern(name) };
            piece.groups = groups.iter().map(label).collect();
        }
        take(entry)
    };
    match &source.bytes {
        ExchangeBytes::Path(path) => read(source, model, || File::open(path), &mut labelled),
        ExchangeBytes::Memory(bytes) => read(source, model, || Ok(bytes.clone()), &mut labelled),
    }
}

fn read<R: ChunkReader + 'static>(
    source: &ExchangeFile,
    model: &PhasedModel,
    again: impl Fn() -> io::Result<R> + Sync,
    take: &mut dyn FnMut(GroupedEntry) -> Result<(), DataError>,
) -> Result<ExchangeMetadata, DataError> {
    let reader = ReductionReader {
        source,
        phases: PhaseFinder::new(model),
        expected: expected_phases(model),
        may_be_empty: model
            .levels
            .iter()
            .flat_map(|level| level.columns().map(|_| !level.members.is_empty()))
            .collect(),
    };
    let open = || again().map_err(|error| DataError::Io { file: source.name.clone(), source: error });
    let opened = super::sheet::open(&source.name, open()?)?;
    let about = opened.about.metadata();
    let metadata = ExchangeMetadata::read(&source.name, about)?.ok_or_else(|| ExchangeError::Metadata {
        file: source.name.clone(),
        key: super::metadata::SCHEMA,
        reason: "it is missing".to_owned(),
    })?;
    let request = SheetRequest { kind: REDUCTIONS_KIND, columns: &REDUCTIONS, further: Vec::new() };
    let plan = SheetPlan::new(&source.name, &opened, &request)?;
    let make = |part: RowGroupPart| -> MakeBlock<'_, ReductionRows> {
        let (reader, open, plan) = (&reader, &open, plan.clone());
        Box::new(move || {
            let mut rows = Vec::new();
            let end = open().and_then(|bytes| reader.rows(plan.sheet(bytes, Some(part))?, part, &mut rows)).err();
            (rows, end)
        })
    };
    let mut parts = RowGroupParts { groups: about.row_groups(), group: 0, within: 0, before: 0, make };
    let mut rows = 0_usize;
    each::<ReductionRows, DataError>(&mut parts, &mut |(entries, end), _| {
        rows += entries.len();
        entries.into_iter().try_for_each(&mut *take)?;
        end.map_or(Ok(Demand::More), Err)
    })?;
    if rows == 0 { Err(DataError::NoRows { file: source.name.clone() }) } else { Ok(metadata) }
}

/// Rows, and what is wrong with the row after them.
type ReductionRows = (Vec<GroupedEntry>, Option<DataError>);

/// A row with the names of the groups of its test.
type GroupedEntry = (ExchangeEntry, Vec<String>);

/// Most rows that are read at a time, and about how many bytes they may have: rows may hold matrices.
const PART_ROWS: usize = 1 << 16;
const PART_BYTES: u64 = 32 << 20;

/// How many rows of a group are read at a time, by what it declares of its size.
fn part_rows(group: &RowGroupMetaData) -> usize {
    let count = |number: i64| u64::try_from(number).unwrap_or(0);
    let numbers: u64 = group.columns().iter().map(|column| count(column.num_values())).fold(0, u64::saturating_add);
    let bytes = count(group.total_byte_size()).max(numbers.saturating_mul(8));
    let of_row = bytes / count(group.num_rows()).max(1);
    usize::try_from(PART_BYTES / of_row.max(1)).unwrap_or(PART_ROWS).clamp(1, PART_ROWS)
}

/// A file in parts of row groups.
struct RowGroupParts<'a, F> {
    groups: &'a [RowGroupMetaData],
    /// The next row group, and its rows that are handed out.
    group: usize,
    within: usize,
    /// Rows handed out.
    before: u64,
    make: F,
}

impl<'a, F: Fn(RowGroupPart) -> MakeBlock<'a, ReductionRows>> BlockTasks<'a, ReductionRows> for RowGroupParts<'a, F> {
    fn next(&mut self) -> Result<Option<BlockTask<'a, ReductionRows>>, DataError> {
        let rows = |group: &RowGroupMetaData| usize::try_from(group.num_rows()).unwrap_or(0);
        while self.groups.get(self.group).is_some_and(|group| rows(group) <= self.within) {
            (self.group, self.within) = (self.group + 1, 0);
        }
        let Some(group) = self.groups.get(self.group) else { return Ok(None) };
        let rows = part_rows(group).min(rows(group) - self.within);
        let part = RowGroupPart { group: self.group, skip: self.within, rows, before: self.before };
        self.within += rows;
        self.before += rows as u64;
        Ok(Some(BlockTask { make: (self.make)(part), done: TableProgress::Share(0.0) }))
    }

    fn alone(&self) -> usize {
        usize::from(self.groups.len() <= 1 && self.groups.iter().all(|group| group.num_rows() <= 1024))
    }
}

/// What rows are compared with.
struct ReductionReader<'a> {
    source: &'a ExchangeFile,
    phases: PhaseFinder<'a>,
    expected: Vec<ExpectedPhase<'a>>,
    /// For each name of a group of a test, whether it is that of a slot, which may be empty.
    may_be_empty: Vec<bool>,
}

/// What is known of a phase.
struct ExpectedPhase<'a> {
    phase: &'a Phase,
    /// Names of its entering states.
    entering: Vec<String>,
    /// Names of all its states, where a phase follows.
    terminal: Option<Vec<String>>,
    /// Number of states of the phase before.
    before: Option<usize>,
}

fn expected_phases(model: &PhasedModel) -> Vec<ExpectedPhase<'_>> {
    let phases = &model.phases;
    let named = |phase: &Phase, states: &mut dyn Iterator<Item = usize>| -> Vec<String> {
        states.map(|state| phase.model.states[state].name.clone()).collect()
    };
    let all = phases.iter().enumerate().map(|(index, phase)| ExpectedPhase {
        phase,
        entering: named(phase, &mut phase.entering().into_iter()),
        terminal: (index + 1 < phases.len()).then(|| named(phase, &mut (0..phase.model.states.len()))),
        before: index.checked_sub(1).map(|before| phases[before].model.states.len()),
    });
    all.collect()
}

impl ReductionReader<'_> {
    fn rows(
        &self,
        mut sheet: ExchangeSheet<'_>,
        part: RowGroupPart,
        rows: &mut Vec<GroupedEntry>,
    ) -> Result<(), DataError> {
        while let Some(batch) = sheet.next()? {
            for row in batch.rows() {
                let test = row.text(TEST).ok_or_else(|| DataError::MissingTest { at: row.place(TEST) })?;
                let phase = self.phases.of(row)?;
                let at = kalfit::Source { file: self.source.number, row: row.number() };
                let evidence = Evidence::Reduced(Box::new(piece(row, &self.expected[phase], &test)?));
                rows.push((ExchangeEntry { test, phase, evidence, at }, self.groups(row)?));
            }
        }
        // to go on would take a declared row group of any length in vain
        let whole = rows.len() == part.rows;
        whole.then_some(()).ok_or_else(|| DataError::Crashed { file: self.source.name.clone(), format: PARQUET })
    }

    /// Names of the groups of a test, where the model has levels.
    fn groups(&self, row: SheetRow<'_>) -> Result<Vec<String>, ExchangeError> {
        if self.may_be_empty.is_empty() {
            return Ok(Vec::new());
        }
        let names = row.words(GROUPS);
        let names =
            names.ok_or_else(|| ExchangeError::Levels { file: self.source.name.clone(), kind: REDUCTIONS_KIND })?;
        let sound = |(name, may_be_empty): (&&str, &bool)| *may_be_empty || !name.is_empty();
        match names.len() == self.may_be_empty.len() && names.iter().zip(&self.may_be_empty).all(sound) {
            true => Ok(names.into_iter().map(str::to_owned).collect()),
            false => Err(ExchangeError::Value {
                at: row.place(GROUPS),
                found: format!("{names:?}"),
                expected: "the name of a group for each level of the model",
            }),
        }
    }
}

/// One row. q entering coordinates, n states.
fn piece(row: SheetRow<'_>, expected: &ExpectedPhase<'_>, test: &str) -> Result<PhaseReduction, ExchangeError> {
    let own = expected.phase;
    same_names(row, "states", &expected.entering, &own.name)?;
    let q = expected.entering.len();
    let reduction = reduction(row, q, own.model.mean.regression.len(), test)?;
    let terminal = match &expected.terminal {
        Some(all) => {
            same_names(row, "terminal_states", all, &own.name)?;
            Some(terminal(row, all.len(), q)?)
        }
        None => None,
    };
    let inherited = match expected.before {
        None => None,
        Some(before) => {
            let rule = || format!("q × n with q = {q} entering states and n = {before} states of the phase before");
            let transition = row.exact("inherited_transition", q * before, rule)?;
            let input = row.exact("inherited_input", q, || format!("one for each of the {q} entering states"))?;
            let transition = DMatrix::from_row_slice(q, before, transition);
            Some(Inherited { transition, input: DVector::from_column_slice(input) })
        }
    };
    Ok(PhaseReduction { reduction, terminal, inherited, groups: Vec::new() })
}

fn reduction(row: SheetRow<'_>, q: usize, covariates: usize, test: &str) -> Result<Reduction, ExchangeError> {
    let data = row.exact("data", q, || format!("one for each of the {q} entering states"))?;
    let rule = || format!("the upper triangle of q × q with q = {q} entering states");
    let factor = row.exact("factor", q * (q + 1) / 2, rule)?;
    if let Some(k) = (0..q).find(|&k| factor[k + k * (k + 1) / 2] < 0.0) {
        let (at, found) = (row.place("factor"), factor[k + k * (k + 1) / 2].to_string());
        return Err(ExchangeError::Value { at, found, expected: "a diagonal that is not negative" });
    }
    let rule = || format!("one for each of the {covariates} regressions of the model");
    let covariates = row.exact("covariates", covariates, rule)?;
    let counted = |column: &str| {
        row.count(column)?.ok_or_else(|| ExchangeError::Missing { at: row.place(column), expected: "a count" })
    };
    Ok(Reduction {
        test: test.to_owned(),
        constant: row.finite("constant")?,
        residual: None,
        data: data.to_vec(),
        factor: factor.to_vec(),
        covariates: covariates.to_vec(),
        steps: counted("steps")?,
        observations: counted("observations")?,
        path: path(row)?,
        design: design(row)?,
        chain: None,
        exact: None,
    })
}

fn path(row: SheetRow<'_>) -> Result<Path, ExchangeError> {
    let path = row.with_text("path", |text| match text {
        INFORMATION => Some(Path::Information),
        SQUARE_ROOT => Some(Path::SquareRoot),
        _ => None,
    });
    match path.flatten() {
        Some(path) => Ok(path),
        None => Err(unfit(row, "path", "`information` or `square-root`")),
    }
}

fn design(row: SheetRow<'_>) -> Result<u128, ExchangeError> {
    let digest = |text: &str| {
        let sound = text.len() == 32 && text.bytes().all(|b| b.is_ascii_hexdigit());
        if sound { u128::from_str_radix(text, 16).ok() } else { None }
    };
    row.with_text("design", digest).flatten().ok_or_else(|| unfit(row, "design", "32 hexadecimal digits"))
}

fn unfit(row: SheetRow<'_>, column: &str, expected: &'static str) -> ExchangeError {
    match row.shown(column) {
        None => ExchangeError::Missing { at: row.place(column), expected },
        Some(found) => ExchangeError::Value { at: row.place(column), found: format!("`{found}`"), expected },
    }
}

fn terminal(row: SheetRow<'_>, n: usize, q: usize) -> Result<Terminal, ExchangeError> {
    let mean = row.exact("terminal_mean", n, || format!("one for each of the {n} states"))?;
    let rule = || format!("n × q with n = {n} states and q = {q} entering states");
    let sensitivity = row.exact("terminal_sensitivity", n * q, rule)?;
    let root = row.rows("terminal_root", n, || format!("n × any number of columns with n = {n} states"))?;
    Ok(Terminal {
        mean: DVector::from_column_slice(mean),
        sensitivity: DMatrix::from_row_slice(n, q, sensitivity),
        root,
    })
}

fn same_names(row: SheetRow<'_>, column: &str, expected: &[String], phase: &str) -> Result<(), ExchangeError> {
    if row.has_words(column, expected) {
        return Ok(());
    }
    let Some(found) = row.words(column) else {
        return Err(ExchangeError::Missing { at: row.place(column), expected: "the names of the states" });
    };
    if found == expected {
        return Ok(());
    }
    Err(ExchangeError::States {
        at: row.place(column),
        found: found.iter().map(|name| crate::cell::shown(name.as_bytes())).collect(),
        phase: phase.to_owned(),
        expected: expected.to_vec(),
        ordered: true,
    })
}
