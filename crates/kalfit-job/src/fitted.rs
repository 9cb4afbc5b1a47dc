//! The files of a fit: results, report, tables.

use std::path::{Path, PathBuf};

use kalfit::FitRecord;

use crate::along::HeldTests;
use crate::failure::Failure;
use crate::job::FitJob;
use crate::output::{FileContents, OutputFile, OutputTarget, PendingFile};
use crate::table::OutputTable;
use crate::tables::{self, FitTableKind};
use crate::work::JobWork;
use crate::{report, write};

/// The files that were asked for, found sound before the work began.
pub(crate) struct FitFiles {
    out: Option<OutputFile>,
    page: Option<OutputFile>,
    tables: Vec<(FitTableKind, OutputTable)>,
    /// Also of a search that was stopped.
    keeps_stopped: bool,
}

impl FitFiles {
    /// Checks that all can be written, each to a place of its own, and that none is read.
    pub(crate) fn prepare(job: &FitJob, read: &[&Path]) -> Result<FitFiles, Failure> {
        let table = |(kind, path): (FitTableKind, &Option<PathBuf>)| {
            let table = OutputTable::prepare(&path.clone().into(), read)?;
            Ok(table.map(|table| (kind, table)))
        };
        if job.tables.rows.is_some() && !job.innovations {
            return Err(Failure::NoRows { why: "single measurements are examined by innovations, which are off" });
        }
        let tables: Result<Vec<Option<(FitTableKind, OutputTable)>>, Failure> =
            job.tables.all().into_iter().map(table).collect();
        let files = FitFiles {
            out: OutputFile::results(job.out.as_deref(), read)?,
            page: OutputFile::prepare_for(("--report", FileContents::Page), job.report.as_deref(), read)?,
            tables: tables?.into_iter().flatten().collect(),
            keeps_stopped: job.keeps_stopped,
        };
        let named: Vec<&OutputFile> = files.named().collect();
        for (k, one) in named.iter().enumerate() {
            named[..k].iter().try_for_each(|other| one.refuse_same(Some(other)))?;
        }
        Ok(files)
    }

    /// Their places, in the order in which they are told.
    fn named(&self) -> impl Iterator<Item = &OutputFile> {
        let tables = self.tables.iter().filter_map(|(_, table)| match &table.target {
            OutputTarget::Named(output) => Some(output),
            _ => None,
        });
        self.out.iter().chain(&self.page).chain(tables)
    }

    /// Writes them, each as soon as it can be made, so that what is done is not lost for what is not.
    ///
    /// # Errors
    /// None of them could be written.
    pub(crate) fn write(
        &self,
        record: &mut FitRecord,
        held: HeldTests,
        model: &kalfit::PhasedModel,
        work: &mut JobWork<'_>,
    ) -> Result<WrittenFiles, Failure> {
        // asked for each file: whoever does not want what was stopped does not wait for files either
        let wanted = |work: &JobWork<'_>| self.keeps_stopped || !work.is_stopped();
        let mut written = WrittenFiles::default();
        if let Some(output) = self.out.as_ref().filter(|_| wanted(work)) {
            written.note(vec![output.name()], write::record(output, record).map_err(Failure::from));
        }
        if let Some(page) = self.page.as_ref().filter(|_| wanted(work)) {
            let along = held.along(model, record, work);
            let html = kalfit_report::html_along(record, along.as_ref());
            written.note(vec![page.name()], report::write(page, &html).map_err(Failure::from));
        }
        if wanted(work) {
            let mut whole = Vec::new(); // none is in place before all are made
            for (kind, table) in &self.tables {
                match tables::pending(table, record, *kind) {
                    Ok(table) => whole.push(table),
                    Err(failure) => written.failed.push(failure),
                }
            }
            let names: Vec<String> = whole.iter().map(PendingFile::name).collect();
            if !names.is_empty() {
                written.note(names, whole.into_iter().try_for_each(|one| Ok(one.finish().map(drop)?)));
            }
        }
        written.or_failed()
    }
}

/// What became of the files.
#[derive(Debug, Default)]
pub(crate) struct WrittenFiles {
    /// Those that are written, as the user named them.
    pub(crate) names: Vec<String>,
    /// Why others are not.
    pub(crate) failed: Vec<Failure>,
}

impl WrittenFiles {
    fn note(&mut self, names: Vec<String>, written: Result<(), Failure>) {
        match written {
            Ok(()) => self.names.extend(names),
            Err(failure) => self.failed.push(failure),
        }
    }

    /// The first failure, where there is nothing else.
    fn or_failed(mut self) -> Result<WrittenFiles, Failure> {
        if self.names.is_empty() && !self.failed.is_empty() { Err(self.failed.swap_remove(0)) } else { Ok(self) }
    }
}
