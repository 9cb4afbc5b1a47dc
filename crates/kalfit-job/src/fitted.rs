//! The files of a fit: results, report, tables.

use std::path::{Path, PathBuf};

use kalfit::FitRecord;

use crate::along::Held;
use crate::failure::Failure;
use crate::job::FitJob;
use crate::output::{Contents, Output, Pending, Target};
use crate::table::Table;
use crate::work::Work;
use crate::{report, tables, write};

/// The files that were asked for, found sound before the work began.
pub(crate) struct Files {
    out: Option<Output>,
    page: Option<Output>,
    tests: Option<Table>,
    parameters: Option<Table>,
    constraints: Option<Table>,
    /// Also of a search that was stopped.
    keeps_stopped: bool,
}

impl Files {
    /// Checks that all can be written, each to a place of its own, and that none is read.
    pub(crate) fn prepare(job: &FitJob, read: &[&Path]) -> Result<Files, Failure> {
        let table = |path: &Option<PathBuf>| Table::prepare(&path.clone().into(), read);
        let files = Files {
            out: Output::results(job.out.as_deref(), read)?,
            page: Output::prepare_for(("--report", Contents::Page), job.report.as_deref(), read)?,
            tests: table(&job.tables.tests)?,
            parameters: table(&job.tables.parameters)?,
            constraints: table(&job.tables.constraints)?,
            keeps_stopped: job.keeps_stopped,
        };
        let named: Vec<&Output> = files.named().collect();
        for (k, one) in named.iter().enumerate() {
            named[..k].iter().try_for_each(|other| one.refuse_same(Some(other)))?;
        }
        Ok(files)
    }

    /// Their places, in the order in which they are told.
    fn named(&self) -> impl Iterator<Item = &Output> {
        fn own(table: &Option<Table>) -> Option<&Output> {
            match table {
                Some(Table { target: Target::Named(output), .. }) => Some(output),
                _ => None,
            }
        }
        let tables = [&self.tests, &self.parameters, &self.constraints].map(own);
        [self.out.as_ref(), self.page.as_ref()].into_iter().chain(tables).flatten()
    }

    /// Writes them, each as soon as it can be made, so that what is done is not lost for what is not.
    ///
    /// # Errors
    /// None of them could be written.
    pub(crate) fn write(
        &self,
        record: &mut FitRecord,
        held: Held,
        model: &kalfit::PhasedModel,
        work: &mut Work<'_>,
    ) -> Result<Written, Failure> {
        // asked for each file: whoever does not want what was stopped does not wait for files either
        let wanted = |work: &Work<'_>| self.keeps_stopped || !work.is_stopped();
        let mut written = Written::default();
        if let Some(output) = self.out.as_ref().filter(|_| wanted(work)) {
            written.note(vec![output.name()], write::record(output, record).map_err(Failure::from));
        }
        if let Some(page) = self.page.as_ref().filter(|_| wanted(work)) {
            let along = held.along(model, record, work);
            let html = kalfit_report::html_along(record, along.as_ref());
            written.note(vec![page.name()], report::write(page, &html).map_err(Failure::from));
        }
        if wanted(work) {
            match self.tables(record) {
                Ok(tables) => {
                    let names = tables.iter().map(Pending::name).collect();
                    written.note(names, tables.into_iter().try_for_each(|one| Ok(one.finish().map(drop)?)));
                }
                Err(failure) => written.failed.push(failure),
            }
        }
        written.or_failed()
    }

    /// The tables, whole; none is in place yet.
    fn tables(&self, record: &FitRecord) -> Result<Vec<Pending<'_>>, Failure> {
        let mut pending: Vec<Pending<'_>> = Vec::new();
        if let Some(table) = &self.tests {
            pending.push(tables::tests(table, record)?);
        }
        if let Some(table) = &self.parameters {
            pending.push(tables::parameters(table, record)?);
        }
        if let Some(table) = &self.constraints {
            pending.push(tables::constraints(table, record)?);
        }
        Ok(pending)
    }
}

/// What became of the files.
#[derive(Debug, Default)]
pub(crate) struct Written {
    /// Those that are written, as the user named them.
    pub(crate) names: Vec<String>,
    /// Why others are not.
    pub(crate) failed: Vec<Failure>,
}

impl Written {
    fn note(&mut self, names: Vec<String>, written: Result<(), Failure>) {
        match written {
            Ok(()) => self.names.extend(names),
            Err(failure) => self.failed.push(failure),
        }
    }

    /// The first failure, where there is nothing else.
    fn or_failed(mut self) -> Result<Written, Failure> {
        if self.names.is_empty() && !self.failed.is_empty() { Err(self.failed.swap_remove(0)) } else { Ok(self) }
    }
}
