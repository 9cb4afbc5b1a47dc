//! Reductions files: what the filters made of each phase, to the last bit.

use kalfit::reduce::{Inherited, Path, PhaseReduction, Terminal};
use kalfit::{Evidence, PhasedModel, Reduction};
use nalgebra::{DMatrix, DVector};

use super::Entry;
use super::content::{Source, opened};
use super::error::ExchangeError;
use super::keys::{PHASE, Phases, TEST};
use super::metadata::Metadata;
use super::sheet::{Column, Row, Shape, Sheet, Wish};
use crate::error::DataError;

pub(super) const KIND: &str = "reductions";
pub(super) const INFORMATION: &str = "information";
pub(super) const SQUARE_ROOT: &str = "square-root";

/// The schema `kalfit-reductions/1`.
pub(super) const COLUMNS: [Column; 17] = [
    Column::needed(TEST, Shape::Text),
    Column::needed(PHASE, Shape::Text),
    Column::needed("states", Shape::Words),
    Column::needed("constant", Shape::Number),
    Column::needed("data", Shape::Numbers),
    Column::needed("factor", Shape::Numbers),
    Column::needed("covariates", Shape::Numbers),
    Column::needed("path", Shape::Text),
    Column::needed("design", Shape::Text),
    Column::needed("steps", Shape::Number),
    Column::needed("observations", Shape::Number),
    Column::optional("terminal_states", Shape::Words),
    Column::optional("terminal_mean", Shape::Numbers),
    Column::optional("terminal_sensitivity", Shape::Numbers),
    Column::optional("terminal_root", Shape::Numbers),
    Column::optional("inherited_transition", Shape::Numbers),
    Column::optional("inherited_input", Shape::Numbers),
];

/// Reads a reductions file and hands its rows on. That it was made with this model and α is for
/// [`Metadata::check_digest`] and [`difference`](super::difference) to say.
///
/// # Errors
/// What is wrong with the file, with its place; whatever `take` returns.
pub fn read_reductions(
    source: &Source,
    model: &PhasedModel,
    take: &mut dyn FnMut(Entry) -> Result<(), DataError>,
) -> Result<Metadata, DataError> {
    opened!(source, |builder| {
        let metadata = Metadata::read(&source.name, builder.metadata())?.ok_or_else(|| ExchangeError::Metadata {
            file: source.name.clone(),
            key: super::metadata::SCHEMA,
            reason: "it is missing".to_owned(),
        })?;
        let wish = Wish { kind: KIND, columns: &COLUMNS, further: Vec::new() };
        let mut sheet = Sheet::new(&source.name, builder, &wish)?;
        let phases = Phases::new(model);
        let mut rows = 0;
        while let Some(batch) = sheet.next()? {
            for row in batch.rows() {
                let test = row.text(TEST).ok_or_else(|| DataError::MissingTest { at: row.place(TEST) })?;
                let phase = phases.of(row)?;
                let at = kalfit::Source { file: source.number, row: row.number() };
                let evidence = Evidence::Reduced(Box::new(piece(row, model, phase, &test)?));
                take(Entry { test, phase, evidence, at })?;
                rows += 1;
            }
        }
        if rows == 0 { Err(DataError::NoRows { file: source.name.clone() }) } else { Ok(metadata) }
    })
}

/// One row. q entering coordinates, n states.
fn piece(row: Row<'_>, model: &PhasedModel, phase: usize, test: &str) -> Result<PhaseReduction, ExchangeError> {
    let own = &model.phases[phase];
    let named = |states: &[usize], of: &kalfit::Model| -> Vec<String> {
        states.iter().map(|&state| of.states[state].name.clone()).collect()
    };
    let entering = named(&own.entering(), &own.model);
    same_names(row, "states", &entering, &own.name)?;
    let q = entering.len();
    let reduction = reduction(row, q, own.model.mean.regression.len(), test)?;
    let follows = phase + 1 < model.phases.len();
    let terminal = if follows {
        let all: Vec<usize> = (0..own.model.states.len()).collect();
        same_names(row, "terminal_states", &named(&all, &own.model), &own.name)?;
        Some(terminal(row, all.len(), q)?)
    } else {
        None
    };
    let inherited = match phase.checked_sub(1).map(|before| model.phases[before].model.states.len()) {
        None => None,
        Some(before) => {
            let rule = || format!("q × n with q = {q} entering states and n = {before} states of the phase before");
            let transition = row.exact("inherited_transition", q * before, rule)?;
            let input = row.exact("inherited_input", q, || format!("one for each of the {q} entering states"))?;
            let transition = DMatrix::from_row_slice(q, before, transition);
            Some(Inherited { transition, input: DVector::from_column_slice(input) })
        }
    };
    Ok(PhaseReduction { reduction, terminal, inherited })
}

fn reduction(row: Row<'_>, q: usize, covariates: usize, test: &str) -> Result<Reduction, ExchangeError> {
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
        data: data.to_vec(),
        factor: factor.to_vec(),
        covariates: covariates.to_vec(),
        steps: counted("steps")?,
        observations: counted("observations")?,
        path: path(row)?,
        design: design(row)?,
        chain: None,
    })
}

fn path(row: Row<'_>) -> Result<Path, ExchangeError> {
    match row.text("path").as_deref() {
        Some(INFORMATION) => Ok(Path::Information),
        Some(SQUARE_ROOT) => Ok(Path::SquareRoot),
        _ => Err(unfit(row, "path", "`information` or `square-root`")),
    }
}

fn design(row: Row<'_>) -> Result<u128, ExchangeError> {
    let text = row.text("design").filter(|text| text.len() == 32 && text.bytes().all(|b| b.is_ascii_hexdigit()));
    let digest = text.and_then(|text| u128::from_str_radix(&text, 16).ok());
    digest.ok_or_else(|| unfit(row, "design", "32 hexadecimal digits"))
}

fn unfit(row: Row<'_>, column: &str, expected: &'static str) -> ExchangeError {
    match row.shown(column) {
        None => ExchangeError::Missing { at: row.place(column), expected },
        Some(found) => ExchangeError::Value { at: row.place(column), found: format!("`{found}`"), expected },
    }
}

fn terminal(row: Row<'_>, n: usize, q: usize) -> Result<Terminal, ExchangeError> {
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

fn same_names(row: Row<'_>, column: &str, expected: &[String], phase: &str) -> Result<(), ExchangeError> {
    let Some(found) = row.words(column) else {
        return Err(ExchangeError::Missing { at: row.place(column), expected: "the names of the states" });
    };
    if found == expected {
        return Ok(());
    }
    Err(ExchangeError::States {
        at: row.place(column),
        found: found.iter().map(|name| crate::error::shown(name.as_bytes())).collect(),
        phase: phase.to_owned(),
        expected: expected.to_vec(),
        ordered: true,
    })
}
