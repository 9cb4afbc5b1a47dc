//! Conversion of a record back to the population it describes.

use nalgebra::DMatrix;

use crate::cut::BlockCut;
use crate::{FitRecord, LevelRecord, PhaseRecord};
use kalfit_algebra::symmetric;
use kalfit_model::{PhasedModel, Population, PopulationError};

/// Why a record has no population for a model.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RecordError {
    /// A schema that cannot be read.
    #[error("the schema is `{found}`, expected `{expected}`")]
    Schema {
        /// Schema of the record.
        found: String,
        /// Schema that can be read.
        expected: &'static str,
    },
    /// Names that differ from the model's.
    #[error("{what} are {}, expected {} as in the model", shown(found), shown(expected))]
    Names {
        /// What is named, with its phase where there are several.
        what: String,
        /// Names in the record.
        found: Vec<String>,
        /// Names in the model.
        expected: Vec<String>,
    },
    /// A count that differs from the number of states.
    #[error("found {found} {what}, expected {expected}, one for each state")]
    Count {
        /// What was counted, with its phase where there are several.
        what: String,
        /// Number that was found.
        found: usize,
        /// Number that was expected.
        expected: usize,
    },
    /// Values that are not a population.
    #[error(transparent)]
    Population(#[from] PopulationError),
}

fn shown(names: &[String]) -> String {
    const MOST_NAMES: usize = 12;
    if names.is_empty() {
        return "none".to_owned();
    }
    let more = if names.len() > MOST_NAMES { format!(" and {} more", names.len() - MOST_NAMES) } else { String::new() };
    let first: Vec<String> = names.iter().take(MOST_NAMES).map(|name| format!("`{name}`")).collect();
    format!("{}{more}", first.join(", "))
}

/// The schema of [`FitRecord`].
pub const FIT_SCHEMA: &str = "kalfit-fit/1";

impl FitRecord {
    /// Estimates of μ, the regression coefficients and Σ of all phases, in the order of a model with the same phases,
    /// estimated states and regressions; the order in the record may differ. Σ is zero between phases.
    ///
    /// # Errors
    /// A different schema; different phases, states or regressions; figures that are not a population.
    pub fn population(&self, model: &PhasedModel) -> Result<Population, RecordError> {
        if self.schema != FIT_SCHEMA {
            return Err(RecordError::Schema { found: self.schema.clone(), expected: FIT_SCHEMA });
        }
        let found: Vec<String> = self.phases.iter().map(|phase| phase.name.clone()).collect();
        let expected: Vec<String> = model.phases.iter().map(|phase| phase.name.clone()).collect();
        let place = places("the phases".to_owned(), &found, &expected)?;
        let p = model.element_names().len();
        let mut whole = Population { mean: Vec::new(), coefficients: Vec::new(), covariance: DMatrix::zeros(p, p) };
        for (cut, &place) in BlockCut::all(model).iter().zip(&place) {
            let of = if model.is_single() { String::new() } else { format!(" of phase `{}`", cut.phase.name) };
            add(&mut whole, cut, &self.phases[place], &of)?;
        }
        self.add_level_covariances(model, &mut whole)?;
        self.allow_for_rounding(model, &mut whole);
        whole.check(model)?;
        Ok(whole)
    }
}

/// Rounding of an estimated variance, relative to the squared size of the state.
const ROUNDING: f64 = f64::EPSILON;

impl FitRecord {
    /// Adds the covariances of all levels of groups.
    fn add_level_covariances(&self, model: &PhasedModel, whole: &mut Population) -> Result<(), RecordError> {
        let own: Vec<&LevelRecord> = self.all_levels().filter(|level| level.column.is_some()).collect();
        let found: Vec<String> = own.iter().map(|level| level.name.clone()).collect();
        let expected: Vec<String> = model.levels.iter().map(|level| level.name.clone()).collect();
        if found != expected {
            return Err(RecordError::Names { what: "the levels".to_owned(), found, expected });
        }
        for (cut, level) in BlockCut::blocks(model).iter().skip(model.phases.len()).zip(own.iter().rev()) {
            let of = format!(" of level `{}`", level.name);
            let place = places(format!("the estimated states{of}"), &level.states, &cut.states())?;
            let rows = &level.covariance.estimate;
            if rows.len() != place.len() || rows.iter().any(|row| row.len() != place.len()) {
                let what = format!("rows of the covariance{of}");
                return Err(RecordError::Count { what, found: rows.len(), expected: place.len() });
            }
            whole.mean.resize(cut.elements.end, 0.0);
            for (i, &row) in place.iter().enumerate() {
                for (k, &column) in place.iter().enumerate() {
                    whole.covariance[(cut.elements.start + i, cut.elements.start + k)] = rows[row][column];
                }
            }
        }
        Ok(())
    }
}

impl FitRecord {
    /// Adds rounding to the variances of a Σ that is not positive semidefinite. A variance that was estimated as zero is
    /// written as a number of the size of rounding, and its covariances have rounding of their own, so that correlations
    /// of such a state are arbitrary; the rounding of a variance is relative to the squared size of its state. A
    /// Σ that is wrong by more than rounding stays wrong.
    fn allow_for_rounding(&self, model: &PhasedModel, whole: &mut Population) {
        let sizes = self.squared_sizes(model, &whole.covariance);
        for BlockCut { elements, .. } in BlockCut::blocks(model) {
            let (start, p) = (elements.start, elements.len());
            if symmetric::is_semidefinite(&whole.covariance.view((start, start), (p, p)).into_owned()) {
                continue;
            }
            for i in elements {
                if whole.covariance[(i, i)] > 0.0 {
                    whole.covariance[(i, i)] += ROUNDING * sizes[i % sizes.len()];
                }
            }
        }
    }

    /// Squared size of each estimated state: its largest variance over the levels, or the squared standard error of its
    /// mean if that is larger.
    fn squared_sizes(&self, model: &PhasedModel, covariance: &DMatrix<f64>) -> Vec<f64> {
        let p = model.dimension();
        let mut sizes: Vec<f64> = (0..p)
            .map(|i| (i..covariance.nrows()).step_by(p).map(|k| covariance[(k, k)]).fold(0.0, f64::max))
            .collect();
        for cut in BlockCut::all(model) {
            let Some(phase) = self.phases.iter().find(|phase| phase.name == cut.phase.name) else { continue };
            for (i, name) in cut.elements.clone().zip(cut.states()) {
                let place = phase.states.iter().position(|own| *own == name);
                let error = place.and_then(|place| *phase.mean.std_error.get(place)?);
                sizes[i] = sizes[i].max(error.unwrap_or(0.0).powi(2));
            }
        }
        sizes
    }
}

/// Adds one phase to `whole`, the population of all phases. `of`: words after a name in messages, such as the phase.
fn add(whole: &mut Population, cut: &BlockCut<'_>, phase: &PhaseRecord, of: &str) -> Result<(), RecordError> {
    let place = places(format!("the estimated states{of}"), &phase.states, &cut.states())?;
    refuse_ragged(phase, place.len(), of)?;
    whole.mean.extend(place.iter().map(|&i| phase.mean.estimate[i]));
    whole.coefficients.extend(coefficients(phase, cut, of)?);
    for (i, &row) in place.iter().enumerate() {
        for (k, &column) in place.iter().enumerate() {
            let at = (cut.elements.start + i, cut.elements.start + k);
            whole.covariance[at] = phase.covariance.estimate[row][column];
        }
    }
    Ok(())
}

fn refuse_ragged(phase: &PhaseRecord, p: usize, of: &str) -> Result<(), RecordError> {
    let rows = &phase.covariance.estimate;
    let ragged = rows.iter().map(Vec::len).find(|&length| length != p);
    for (what, found) in [
        ("means", phase.mean.estimate.len()),
        ("rows of the covariance", rows.len()),
        ("columns of the covariance", ragged.unwrap_or(p)),
    ] {
        if found != p {
            return Err(RecordError::Count { what: format!("{what}{of}"), found, expected: p });
        }
    }
    Ok(())
}

fn coefficients(phase: &PhaseRecord, cut: &BlockCut<'_>, of: &str) -> Result<Vec<f64>, RecordError> {
    let (model, states) = (&cut.phase.model, cut.states());
    let found: Vec<String> = phase.mean.regression.iter().map(|r| format!("{} on {}", r.state, r.column)).collect();
    let structure = &model.mean.regression;
    let wanted = structure.iter().map(|r| format!("{} on {}", states[r.element], model.columns[r.column].name));
    let place = places(format!("the regressions{of}"), &found, &wanted.collect::<Vec<_>>())?;
    Ok(place.iter().map(|&r| phase.mean.regression[r].estimate).collect())
}

/// Index in `found` of each name of `expected`.
fn places(what: String, found: &[String], expected: &[String]) -> Result<Vec<usize>, RecordError> {
    let place: Option<Vec<usize>> = expected.iter().map(|name| found.iter().position(|other| other == name)).collect();
    match place {
        Some(place) if found.len() == expected.len() => Ok(place),
        _ => Err(RecordError::Names { what, found: found.to_vec(), expected: expected.to_vec() }),
    }
}
