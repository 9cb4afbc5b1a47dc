//! Tables of results on their way to a file.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

use kalfit_data::{CellKind, TableFormat, TableWriter, WriteError};

use crate::failure::Failure;
use crate::job::TableDestination;
use crate::output::{OutputTarget, PendingFile};

/// A table that will be written.
pub(crate) struct OutputTable {
    pub(crate) target: OutputTarget,
    format: TableFormat,
}

pub(crate) type OutputTableWriter<'a> = TableWriter<BufWriter<&'a File>>;

impl OutputTable {
    pub(crate) fn prepare(to: &TableDestination, used: &[&Path]) -> Result<Option<OutputTable>, Failure> {
        let (path, format) = match to {
            TableDestination::Nowhere => return Ok(None),
            TableDestination::Back => (None, TableFormat::Arrow),
            TableDestination::File(path) => {
                let format = TableFormat::of(path).map_err(|error| failed(error, path.display().to_string()))?;
                (Some(path.as_path()), format)
            }
        };
        Ok(Some(OutputTable { target: OutputTarget::prepare(path, used)?, format }))
    }

    /// Writes it; it is in place when it is finished.
    pub(crate) fn write(
        &self,
        columns: &[(String, CellKind)],
        rows: impl FnOnce(&mut OutputTableWriter<'_>) -> Result<(), Failure>,
    ) -> Result<PendingFile<'_>, Failure> {
        let pending = self.target.begin()?;
        let mut writer =
            TableWriter::new(columns, self.format, BufWriter::new(pending.file())).map_err(self.failed())?;
        rows(&mut writer)?;
        writer.finish().and_then(|mut sink| Ok(sink.flush()?)).map_err(self.failed())?;
        Ok(pending)
    }

    pub(crate) fn failed(&self) -> impl Fn(WriteError) -> Failure {
        move |error| failed(error, self.target.name().unwrap_or_default())
    }
}

fn failed(error: WriteError, path: String) -> Failure {
    Failure::Write { error: Box::new(error), path }
}
