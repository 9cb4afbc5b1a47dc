//! A model as it describes tests that nobody has made: without measurements, and with outputs, which are linear in the states as
//! measurements are.
//!
//! The tables of the two files are read together. Places in the file of outputs are counted from the end of the model's text, so that
//! every message still knows its file.

use kalfit::predict::Output;

use crate::beside::{self, BesideError};
use crate::build;
use crate::error::Result;
use crate::outputs::listed;
use crate::phase::ReadPurpose;
use crate::spec::Spec;
use crate::table::TomlTable;

/// The file of outputs in messages.
const PLACE: &str = "the file of outputs";

/// A model for designs of tests.
#[derive(Debug, Clone)]
pub struct DesignSpec {
    /// The model, which measures nothing.
    pub spec: Spec,
    /// The outputs of each phase.
    pub outputs: Vec<Vec<Output>>,
}

impl Spec {
    /// The same model for designs of tests that nobody has made: it reads the columns of its motion and of the outputs, not those of its
    /// measurements; and those of its levels only with `levels`. `outputs`: the text of a file of `[outputs.NAME]`.
    ///
    /// # Errors
    /// What is wrong with the text.
    pub fn design(&self, outputs: Option<&str>, levels: bool) -> std::result::Result<DesignSpec, BesideError> {
        beside::read(&self.text, outputs.unwrap_or_default(), |text, offset| {
            self.designed(text, offset, (outputs.is_some(), levels))
        })
    }

    fn designed(&self, text: &str, offset: usize, (named, levels): (bool, bool)) -> Result<DesignSpec> {
        let [base, own] = beside::tables(text, offset)?;
        let mut table = TomlTable::open(PLACE, offset..text.len(), &own).only(&["outputs"])?;
        let outputs = match table.take("outputs") {
            Some(field) => Some(listed(&field)?),
            None if named => {
                return Err(table.missing("outputs").hint("an output is a table, as in `[outputs.range]`"));
            }
            None => None,
        };
        let root = TomlTable::open("the model file", 0..text.len(), &base);
        let purpose = ReadPurpose::Designs { outputs: outputs.as_ref(), levels };
        let build::BuiltSpec { model, layout, mut places, outputs } = build::model(text, root, purpose)?;
        places.columns.retain(|_, span| span.start < offset); // places are those of the model file
        let spec = Spec { model, layout, places, ..self.clone() };
        Ok(DesignSpec { spec, outputs })
    }
}
