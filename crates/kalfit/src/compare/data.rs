//! Checks whether fits are of the same data.

use std::collections::BTreeMap;

use kalfit_record::FitRecord;

/// Why fits cannot be compared.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CompareError {
    /// Fewer than two fits.
    #[error("found {found} of the results of a fit, expected two or more")]
    TooFew {
        /// Number of fits.
        found: usize,
    },
    /// A file that is given twice.
    #[error("`{name}` is given twice")]
    Twice {
        /// Name of the file.
        name: String,
    },
    /// Fits of different data.
    #[error("`{first}` and `{second}` are not fits of the same data: {what}")]
    OtherData {
        /// Name of one fit.
        first: String,
        /// Name of the other fit.
        second: String,
        /// How the data differ.
        what: String,
    },
}

impl CompareError {
    /// A hint at what to do about the error.
    pub fn hint(&self) -> &'static str {
        match self {
            CompareError::TooFew { .. } => {
                "name two or more files that `kalfit fit --out` wrote, or two or more of `kalfit validate --out`"
            }
            CompareError::Twice { .. } => "name each file once",
            CompareError::OtherData { .. } => {
                "likelihoods can be compared only for the same measured values: fit all models to the same data"
            }
        }
    }
}

pub(super) fn check(fits: &[(String, FitRecord)]) -> Result<(), CompareError> {
    if fits.len() < 2 {
        return Err(CompareError::TooFew { found: fits.len() });
    }
    for (k, (name, _)) in fits.iter().enumerate() {
        if fits[..k].iter().any(|(other, _)| other == name) {
            return Err(CompareError::Twice { name: name.clone() });
        }
    }
    let (first, own) = &fits[0];
    for (second, other) in &fits[1..] {
        if let Some(what) = difference(own, other) {
            return Err(CompareError::OtherData { first: first.clone(), second: second.clone(), what });
        }
    }
    Ok(())
}

/// Number of measured values of each test.
fn observations(fit: &FitRecord) -> BTreeMap<&str, usize> {
    fit.tests.iter().map(|test| (test.id, test.observations)).collect()
}

/// First difference between the data of two fits, in words; `None` where they are the same.
fn difference(first: &FitRecord, second: &FitRecord) -> Option<String> {
    let (one, two) = (&first.data, &second.data);
    if one.tests != two.tests {
        return Some(format!("{} tests against {}", one.tests, two.tests));
    }
    let levels =
        |fit: &FitRecord| -> Vec<String> { fit.levels.iter().filter_map(|level| level.column.clone()).collect() };
    // ids of tests contain the names of groups, so that they compare only between equal levels
    if !first.tests.is_empty() && !second.tests.is_empty() && levels(first) == levels(second) {
        let (one, two) = (observations(first), observations(second));
        let missing = |one: &BTreeMap<&str, usize>, two: &BTreeMap<&str, usize>| {
            one.keys().find(|id| !two.contains_key(*id)).map(|id| (*id).to_owned())
        };
        if let Some(id) = missing(&one, &two) {
            return Some(format!("test `{id}` is in the first only"));
        }
        if let Some(id) = missing(&two, &one) {
            return Some(format!("test `{id}` is in the second only"));
        }
        if let Some((id, count)) = one.iter().find(|(id, count)| two[*id] != **count) {
            return Some(format!("test `{id}` has {count} measured values against {}", two[id]));
        }
    }
    (one.observations != two.observations)
        .then(|| format!("{} measured values against {}", one.observations, two.observations))
}
