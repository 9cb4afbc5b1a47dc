//! One row of a table, on its way into a test.

use kalfit::Label;

use crate::moment::Moment;

/// The cells of one row that the model and the layout name. A table fills it anew for each row.
#[derive(Debug)]
pub(crate) struct Row {
    /// Its number in the file, as a person counts.
    pub(crate) number: u64,
    /// Id of its test.
    pub(crate) id: String,
    /// Numeric cells, NaN where missing; those of the time column are filled in when the test's first row is known.
    pub(crate) numbers: Vec<f64>,
    /// Text cells.
    pub(crate) texts: Vec<Label>,
    /// Its time, with a time column.
    pub(crate) time: Option<Moment>,
}

impl Row {
    pub(crate) fn new(numbers: usize, texts: usize) -> Row {
        Row {
            number: 0,
            id: String::new(),
            numbers: vec![f64::NAN; numbers],
            texts: vec![Label::MISSING; texts],
            time: None,
        }
    }

    /// Sets the id without allocating when it is the one of the row before.
    pub(crate) fn set_id(&mut self, id: &str) {
        if self.id != id {
            self.id.clear();
            self.id.push_str(id);
        }
    }
}
