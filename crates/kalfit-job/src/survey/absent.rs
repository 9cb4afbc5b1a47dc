//! Values that are not there, and rows that stand for others.

use kalfit::PhasedModel;
use kalfit_data::is_total;

use super::listed;

/// Tests without a value, and those named as sums of others.
#[derive(Default)]
pub(super) struct AbsentValues {
    empty: Vec<String>,
    totals: Vec<String>,
    /// Some tests are known by other things than rows.
    others: bool,
}

impl AbsentValues {
    /// Adds a test by the numbers of its rows and of its values; `None` where it is not known by rows alone.
    pub(super) fn add(&mut self, id: &str, rows: usize, values: Option<usize>) {
        match values {
            Some(0) => self.empty.push(id.to_owned()),
            None => self.others = true,
            Some(_) => {}
        }
        let own = id.rsplit('/').next().unwrap_or(id);
        if rows == 1 && is_total(own) {
            self.totals.push(id.to_owned());
        }
    }

    /// `counts`: values of each measurement of each phase.
    pub(super) fn notes(&self, model: &PhasedModel, counts: &[Vec<usize>]) -> Vec<String> {
        let mut notes = Vec::new();
        if !self.totals.is_empty() {
            let (tests, is, it) = if self.totals.len() == 1 { ("test", "is", "it") } else { ("tests", "are", "them") };
            notes.push(format!(
                "{tests} {} of one row {is} named as if summing up others: if so, remove {it}",
                listed(&self.totals)
            ));
        }
        if self.others {
            return notes;
        }
        if counts.iter().flatten().all(|count| *count == 0) {
            notes.push("no row has a value of any measurement: these data say nothing of the model".to_owned());
            return notes;
        }
        for (phase, counts) in model.phases.iter().zip(counts) {
            for (measurement, _) in phase.model.measurements.iter().zip(counts).filter(|(_, count)| **count == 0) {
                let column = &phase.model.columns[measurement.column].name;
                let read = if measurement.filter.is_some() { "in the rows that `where` leaves it" } else { "at all" };
                notes.push(format!(
                    "column `{column}` has no value {read}: measurement `{}` says nothing",
                    measurement.name
                ));
            }
        }
        if !self.empty.is_empty() {
            let (tests, has, say) =
                if self.empty.len() == 1 { ("test", "has", "says") } else { ("tests", "have", "say") };
            notes.push(format!("{tests} {} {has} no value of any measurement and {say} nothing", listed(&self.empty)));
        }
        notes
    }
}
