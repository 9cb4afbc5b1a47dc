//! What goes between places: θ, which asks for sums, and the sums.

use kalfit::remote::{Answer, Asked};
use kalfit_data::exchange::{ParameterValue, difference};
use kalfit_spec::Spec;
use serde::{Deserialize, Serialize};

use crate::document::Document;
use crate::failure::Failure;
use crate::results::{self, ResultKind};
use crate::sums::error::SumsError;

/// What `kalfit join --out` writes.
pub(crate) const THETA: ResultKind = ResultKind { schema: "kalfit-theta/1", command: "join" };
/// What `kalfit sums --out` writes.
pub(crate) const SUMS: ResultKind = ResultKind { schema: "kalfit-sums/1", command: "sums" };

/// The round of a fit by sums: what is asked for, and the sums over all places of the rounds before.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Theta {
    /// `kalfit-theta/1`.
    pub schema: String,
    /// Version of the program.
    pub kalfit_version: String,
    /// SHA-256 of the model file, `sha256:…`.
    pub model_digest: String,
    /// The values that parameters have before the fit.
    pub parameters: Vec<ParameterValue>,
    /// Rounds before this one.
    pub round: usize,
    /// Number of places, and of tests in them; null before the first round.
    pub places: Option<[usize; 2]>,
    /// What is asked for.
    pub ask: Vec<Asked>,
    /// What was asked for before, with the sums over all places.
    pub known: Vec<(Asked, Answer)>,
}

/// What one place answers: sums over its tests, and nothing of a single test.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SiteSums {
    /// `kalfit-sums/1`.
    pub schema: String,
    /// Number of tests.
    pub tests: usize,
    /// In the first round of a model with levels: digests of the names of its groups of the outermost level, in their order.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub groups: Vec<String>,
    /// An answer to each question; null where what was asked for is not defined.
    pub answers: Vec<Answer>,
    /// What was asked.
    pub theta: Theta,
}

impl Theta {
    /// The first round.
    pub(crate) fn first(spec: &Spec) -> Result<Theta, SumsError> {
        let ask = kalfit::shards::first(&spec.model, &kalfit::estimate::Settings::default())?;
        Ok(Theta {
            schema: THETA.schema.to_owned(),
            kalfit_version: env!("CARGO_PKG_VERSION").to_owned(),
            model_digest: spec.digest.clone(),
            parameters: ParameterValue::known(spec.model.shared()),
            round: 0,
            places: None,
            ask,
            known: Vec::new(),
        })
    }

    /// That of a file.
    pub(crate) fn read(from: &Document) -> Result<Theta, SumsError> {
        Ok(results::read(from, THETA)?)
    }

    /// That of a text, which messages call `name`.
    ///
    /// # Errors
    /// [`Failure::Sums`] for anything else.
    pub fn of_text(name: &str, text: &str) -> Result<Theta, Failure> {
        let read = results::of_bytes(name.to_owned(), text.as_bytes(), THETA);
        Ok(read.map_err(SumsError::from)?)
    }

    /// What is asked, without what is known: all that a place needs.
    #[must_use]
    pub fn bare(&self) -> Theta {
        Theta { known: Vec::new(), ..self.clone() }
    }

    /// It is of this model and of this version of the program.
    pub(crate) fn check(&self, name: &str, spec: &Spec) -> Result<(), SumsError> {
        let own = env!("CARGO_PKG_VERSION");
        if self.kalfit_version != own {
            return Err(SumsError::Version { file: name.to_owned(), found: self.kalfit_version.clone(), own });
        }
        if self.model_digest != spec.digest {
            return Err(SumsError::Model { file: name.to_owned(), model: spec.name.clone() });
        }
        let known = ParameterValue::known(spec.model.shared());
        if let Some(found) = difference(&self.parameters, &known) {
            let [parameter, there, here] = [found.to_string(), found.first.to_string(), found.second.to_string()];
            return Err(SumsError::Value { file: name.to_owned(), parameter, there, here });
        }
        let open = |all: &[ParameterValue]| -> Vec<String> {
            all.iter().filter(|p| p.value.is_none() && p.levels.is_empty()).map(|p| p.name.clone()).collect()
        };
        let (there, here) = (open(&self.parameters), open(&known));
        match there.iter().chain(&here).find(|name| there.contains(name) != here.contains(name)) {
            Some(parameter) => Err(SumsError::Free { file: name.to_owned(), parameter: parameter.clone() }),
            None => Ok(()),
        }
    }
}

impl SiteSums {
    /// Those of a text, which messages call `name`.
    ///
    /// # Errors
    /// [`Failure::Sums`] for anything else.
    pub fn of_text(name: &str, text: &str) -> Result<SiteSums, Failure> {
        let read = results::of_bytes(name.to_owned(), text.as_bytes(), SUMS);
        Ok(read.map_err(SumsError::from)?)
    }

    /// Those of a file.
    pub(crate) fn read(from: &Document) -> Result<SiteSums, SumsError> {
        Ok(results::read(from, SUMS)?)
    }
}
