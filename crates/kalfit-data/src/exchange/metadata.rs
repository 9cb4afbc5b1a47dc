//! What an exchange file says of itself: key-value metadata of Parquet.

use parquet::file::metadata::{KeyValue, ParquetMetaData};

use super::alpha::ParameterValue;
use super::error::ExchangeError;
use super::schema::{ESTIMATES_SCHEMA, REDUCTIONS_SCHEMA};

pub(super) const SCHEMA: &str = "kalfit.schema";
const VERSION: &str = "kalfit.version";
const TITLE: &str = "kalfit.title";
const MODEL: &str = "kalfit.model_digest";
const REDUCTION: &str = "kalfit.reduction_digest";
const PARAMETERS: &str = "kalfit.parameters";
const FILES: &str = "kalfit.files";
const LIKELIHOOD: &str = "kalfit.log_likelihood_kind";
const OF_ESTIMATES: &str = "estimates";
const OF_MEASUREMENTS: &str = "measurements";

/// Where an exchange file comes from.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ExchangeMetadata {
    /// Version of kalfit that wrote it.
    pub version: String,
    /// Title of the model.
    pub title: String,
    /// Digest of the text of the model file.
    pub model_digest: String,
    /// Digest of what reductions depend on: they are of use to a model of this digest only.
    pub reduction_digest: String,
    /// α: the dynamic parameters at which the filters ran.
    pub parameters: Vec<ParameterValue>,
    /// The files whose data are behind it.
    pub files: Vec<String>,
    /// The likelihood is that of estimates, not of measurements.
    pub of_estimates: bool,
}

impl ExchangeMetadata {
    /// What is written.
    pub(super) fn pairs(&self, schema: &str) -> Vec<KeyValue> {
        let pair = |key: &str, value: String| KeyValue::new(key.to_owned(), value);
        let parameters = serde_json::to_string(&self.parameters).expect("values of parameters are finite");
        vec![
            pair(SCHEMA, schema.to_owned()),
            pair(VERSION, self.version.clone()),
            pair(TITLE, self.title.clone()),
            pair(MODEL, self.model_digest.clone()),
            pair(REDUCTION, self.reduction_digest.clone()),
            pair(PARAMETERS, parameters),
            pair(LIKELIHOOD, if self.of_estimates { OF_ESTIMATES } else { OF_MEASUREMENTS }.to_owned()),
            pair(FILES, serde_json::to_string(&self.files).expect("texts")),
        ]
    }

    /// What a file says; `None` of one that is not kalfit's.
    pub(super) fn read(file: &str, metadata: &ParquetMetaData) -> Result<Option<ExchangeMetadata>, ExchangeError> {
        let text = |key: &'static str| value(metadata, key);
        let Some(schema) = text(SCHEMA) else { return Ok(None) };
        if schema != REDUCTIONS_SCHEMA && schema != ESTIMATES_SCHEMA {
            let (file, found) = (file.to_owned(), crate::cell::shown(schema.as_bytes()));
            return Err(ExchangeError::Schema { file, found });
        }
        let needed = |key: &'static str| {
            text(key).ok_or_else(|| ExchangeError::Metadata {
                file: file.to_owned(),
                key,
                reason: "it is missing".to_owned(),
            })
        };
        let refused = |key: &'static str| {
            move |error: serde_json::Error| ExchangeError::Metadata {
                file: file.to_owned(),
                key,
                reason: error.to_string(),
            }
        };
        let [version, model_digest, reduction_digest] = [needed(VERSION)?, needed(MODEL)?, needed(REDUCTION)?];
        let of_estimates = match needed(LIKELIHOOD)? {
            OF_ESTIMATES => true,
            OF_MEASUREMENTS => false,
            other => {
                let found = crate::cell::shown(other.as_bytes());
                let reason = format!("found `{found}`, expected `{OF_ESTIMATES}` or `{OF_MEASUREMENTS}`");
                return Err(ExchangeError::Metadata { file: file.to_owned(), key: LIKELIHOOD, reason });
            }
        };
        Ok(Some(ExchangeMetadata {
            of_estimates,
            version: version.to_owned(),
            title: text(TITLE).unwrap_or_default().to_owned(),
            model_digest: model_digest.to_owned(),
            reduction_digest: reduction_digest.to_owned(),
            parameters: serde_json::from_str(needed(PARAMETERS)?).map_err(refused(PARAMETERS))?,
            files: serde_json::from_str(needed(FILES)?).map_err(refused(FILES))?,
        }))
    }

    /// Refuses reductions that were made with another model.
    ///
    /// # Errors
    /// The digest is not the expected one; the message shows both.
    pub fn check_digest(&self, file: &str, expected: &str) -> Result<(), ExchangeError> {
        if self.reduction_digest == expected {
            return Ok(());
        }
        let digits = self.reduction_digest.strip_prefix("sha256:").unwrap_or_default();
        let found = if digits.len() == 64 && digits.bytes().all(|b| b.is_ascii_hexdigit()) {
            self.reduction_digest.clone() // longer than what messages show of other texts
        } else {
            crate::cell::shown(self.reduction_digest.as_bytes())
        };
        Err(ExchangeError::Digest { file: file.to_owned(), found, expected: expected.to_owned() })
    }
}

/// The value of a key.
pub(super) fn value<'a>(metadata: &'a ParquetMetaData, key: &str) -> Option<&'a str> {
    let pairs = metadata.file_metadata().key_value_metadata()?;
    pairs.iter().find(|pair| pair.key == key)?.value.as_deref()
}
