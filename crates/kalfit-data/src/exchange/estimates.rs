//! Estimates files: what somebody's filters made of each phase.

use kalfit::reduce::Estimates;
use kalfit::{Evidence, Labels, Layout, PhasedModel};
use nalgebra::{DMatrix, DVector};

use super::assembly::ExchangeEntry;
use super::constants::ConstantColumns;
use super::content::{ExchangeFile, opened};
use super::error::ExchangeError;
use super::keys::{PhaseFinder, TestIdFinder};
use super::metadata::ExchangeMetadata;
use super::schema::ESTIMATES;
use super::sheet::{ExchangeSheet, SheetRequest, SheetRow};
use crate::error::DataError;

const KIND: &str = "estimates";

/// Reads an estimates file, of any origin, and hands its rows on. Texts of constants are added to `labels`.
///
/// # Errors
/// A model with levels of groups; what is wrong with the file, with its place; whatever `take` returns.
pub fn read_estimates(
    source: &ExchangeFile,
    (model, layout): (&PhasedModel, &Layout),
    labels: &mut Labels,
    take: &mut dyn FnMut(ExchangeEntry) -> Result<(), DataError>,
) -> Result<Option<ExchangeMetadata>, DataError> {
    if !model.levels.is_empty() {
        return Err(ExchangeError::Levels { file: source.name.clone(), kind: KIND }.into());
    }
    opened!(source, |opened| {
        let metadata = ExchangeMetadata::read(&source.name, opened.about.metadata())?;
        let constants = ConstantColumns::new(model, layout, opened.about.schema());
        let request = SheetRequest { kind: KIND, columns: &ESTIMATES, further: constants.columns(layout) };
        let mut sheet = ExchangeSheet::new(&source.name, opened, &request)?;
        let key = TestIdFinder::new(layout);
        let phases = PhaseFinder::new(model);
        let mut rows = 0;
        while let Some(batch) = sheet.next()? {
            for row in batch.rows() {
                let test = key.id(row)?;
                let phase = phases.of(row)?;
                let at = kalfit::Source { file: source.number, row: row.number() };
                let constants = constants.test(row, (&test, phase), at, labels)?;
                let estimates = estimates(row, model, phase, constants)?;
                take(ExchangeEntry { test, phase, evidence: Evidence::Estimates(Box::new(estimates)), at })?;
                rows += 1;
            }
        }
        if rows == 0 { Err(DataError::NoRows { file: source.name.clone() }) } else { Ok(metadata) }
    })
}

/// One row. n states, m estimates.
fn estimates(
    row: SheetRow<'_>,
    model: &PhasedModel,
    phase: usize,
    constants: kalfit::Test,
) -> Result<Estimates, ExchangeError> {
    let names: Vec<&str> = model.phases[phase].model.states.iter().map(|state| state.name.as_str()).collect();
    let place = order(row, &names, &model.phases[phase].name)?;
    let n = names.len();
    let estimates = row.needed("estimates")?;
    let m = estimates.len();
    let offsets = row.exact("offsets", m, || format!("one for each of the {m} estimates"))?;
    let rule = || format!("m × n with m = {m} estimates and n = {n} states");
    let sensitivities = row.exact("sensitivities", m * n, rule)?;
    let transition = row.exact("transition", n * n, || format!("n × n with n = {n} states"))?;
    let drift = match row.list("drift")? {
        Some(_) => row.exact("drift", n, || format!("one for each of the {n} states"))?.to_vec(),
        None => vec![0.0; n],
    };
    let root = root(row, n, m)?;
    let own = |i: usize| if i < n { place[i] } else { i };
    Ok(Estimates {
        estimates: DVector::from_column_slice(estimates),
        offsets: DVector::from_column_slice(offsets),
        sensitivities: DMatrix::from_fn(m, n, |i, j| sensitivities[i * n + place[j]]),
        transition: DMatrix::from_fn(n, n, |i, j| transition[place[i] * n + place[j]]),
        drift: DVector::from_fn(n, |i, _| drift[place[i]]),
        root: DMatrix::from_fn(n + m, root.ncols(), |i, k| root[(own(i), k)]),
        constants,
        steps: row.count("steps")?.unwrap_or(1),
        observations: row.count("observations")?.unwrap_or(m),
    })
}

/// Where each state of the model stands in the file's vectors.
fn order(row: SheetRow<'_>, names: &[&str], phase: &str) -> Result<Vec<usize>, ExchangeError> {
    let Some(found) = row.words("states") else {
        return Err(ExchangeError::Missing { at: row.place("states"), expected: "the names of the states" });
    };
    let place: Option<Vec<usize>> = names.iter().map(|name| found.iter().position(|other| other == name)).collect();
    place.filter(|_| found.len() == names.len()).ok_or_else(|| ExchangeError::States {
        at: row.place("states"),
        found: found.iter().map(|name| crate::cell::shown(name.as_bytes())).collect(),
        phase: phase.to_owned(),
        expected: names.iter().map(|&name| name.to_owned()).collect(),
        ordered: false,
    })
}

/// D with DD' = Γ, (n + m) × k.
fn root(row: SheetRow<'_>, n: usize, m: usize) -> Result<DMatrix<f64>, ExchangeError> {
    let size = n + m;
    let covariance = row.list("covariance")?;
    if row.list("covariance_root")?.is_none() {
        if covariance.is_none() {
            let at = row.place("covariance_root");
            return Err(ExchangeError::Missing { at, expected: "a list of numbers, here or in `covariance`" });
        }
        let rule = || format!("(n + m) × (n + m) with n = {n} states and m = {m} estimates");
        return root_of(row, row.exact("covariance", size * size, rule)?, size);
    }
    if covariance.is_some() {
        return Err(ExchangeError::Both { at: row.place("covariance") });
    }
    let rule = || format!("(n + m) × any number of columns with n = {n} states and m = {m} estimates");
    row.rows("covariance_root", size, rule)
}

/// A root of Γ.
fn root_of(row: SheetRow<'_>, covariance: &[f64], size: usize) -> Result<DMatrix<f64>, ExchangeError> {
    const COLUMN: &str = "covariance";
    let precision = if row.is_single(COLUMN) { f64::from(f32::EPSILON) } else { f64::EPSILON };
    let a = DMatrix::from_row_slice(size, size, covariance);
    let rounding = 16.0 * size as f64 * precision;
    for i in 0..size {
        for j in 0..i {
            let (found, other) = (a[(i, j)], a[(j, i)]);
            if (found - other).abs() > 1e3 * rounding * a[(i, i)].sqrt() * a[(j, j)].sqrt() {
                let (at, row, column) = (row.place(COLUMN), i + 1, j + 1);
                return Err(ExchangeError::NotSymmetric { at, row, column, found, other });
            }
        }
    }
    let refused = |[least, largest]: [f64; 2]| ExchangeError::NotSemidefinite { at: row.place(COLUMN), least, largest };
    Estimates::root_of(&a, rounding).map_err(refused)
}
