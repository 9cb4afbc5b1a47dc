//! The columns that are wanted of a table.

use std::hash::RandomState;

use kalfit::{Layout, Model, TestKey};

use crate::cell::shown;
use crate::cell::{CellFault, MissingTexts};
use crate::columns::{FileColumns, nearest};
use crate::error::DataError;
use crate::moment::Moment;
use crate::place::CellPlace;

/// Bytes of a text that names something, at most: each is kept, and compared with others.
const TEXT: usize = 1 << 16;

/// Every column that the model or the layout names, once, with its uses.
#[derive(Debug)]
pub(crate) struct WantedColumns {
    /// The columns.
    pub(crate) columns: Vec<WantedColumn>,
    /// Number of numeric cells of a row.
    pub(crate) numbers: usize,
    /// Number of text cells of a row.
    pub(crate) texts: usize,
    /// Columns whose texts, in this order, are the id of the row's test; none where no column holds ids.
    pub(crate) ids: Vec<usize>,
    /// Text cells with the groups of the row's test, and their columns.
    pub(crate) groups: Vec<(usize, usize)>,
    /// What stands for a missing cell.
    pub(crate) tokens: MissingTexts,
    /// Lines of CSV that begin with this are comments.
    pub(crate) comment: Option<String>,
    /// What hashes ids.
    pub(crate) hasher: RandomState,
}

/// One column and its uses.
#[derive(Debug)]
pub(crate) struct WantedColumn {
    /// Its name.
    pub(crate) name: String,
    /// Where it is used first, in words.
    pub(crate) used_in: String,
    /// Numeric cells of a row that it fills.
    pub(crate) numbers: Vec<usize>,
    /// Text cells of a row that it fills.
    pub(crate) texts: Vec<usize>,
    /// It holds the test's id.
    pub(crate) is_test: bool,
    /// It holds the group of the test at a level.
    pub(crate) is_group: bool,
    /// It holds the time of the row.
    pub(crate) is_time: bool,
}

impl WantedColumns {
    pub(crate) fn new(model: &Model, layout: &Layout) -> WantedColumns {
        let (numbers, texts) = (model.columns.len(), model.text_columns.len());
        let (tokens, comment) =
            (MissingTexts::new(&layout.missing), layout.comment.clone().filter(|text| !text.is_empty()));
        let (ids, groups) = (Vec::new(), Vec::new());
        let hasher = RandomState::new();
        let mut wanted = WantedColumns { columns: Vec::new(), numbers, texts, ids, groups, tokens, comment, hasher };
        wanted.tests(layout);
        for (index, column) in model.columns.iter().enumerate() {
            let wanted = wanted.column(&column.name, &column.used_in);
            wanted.numbers.push(index);
            wanted.is_time |= model.clock.time == Some(index);
        }
        for (index, column) in model.text_columns.iter().enumerate() {
            wanted.column(&column.name, &column.used_in).texts.push(index);
        }
        let cells =
            |(at, column): (usize, &WantedColumn)| Some((*column.texts.first()?, at)).filter(|_| column.is_group);
        wanted.groups = wanted.columns.iter().enumerate().filter_map(cells).collect();
        wanted
    }

    /// The columns that tell tests apart: the test's own, and those of its groups, which go before it in its id.
    fn tests(&mut self, layout: &Layout) {
        let own = match &layout.test {
            TestKey::Column(name) => {
                self.column(name, "`test` of `[data]`").is_test = true;
                Some(0)
            }
            TestKey::File | TestKey::Single | TestKey::Row => None,
        };
        for name in &layout.levels {
            self.column(name, "`levels` of `[data]`").is_group = true;
        }
        self.ids = own.iter().flat_map(|own| (1..self.columns.len()).chain([*own])).collect();
        for name in &layout.crossed {
            self.column(name, "`crossed` of `[data]`").is_group = true;
        }
    }

    /// The column of this name, known or new.
    fn column(&mut self, name: &str, used_in: &str) -> &mut WantedColumn {
        let index = self.columns.iter().position(|column| column.name == name).unwrap_or_else(|| {
            self.columns.push(WantedColumn {
                name: name.to_owned(),
                used_in: used_in.to_owned(),
                numbers: Vec::new(),
                texts: Vec::new(),
                is_test: false,
                is_group: false,
                is_time: false,
            });
            self.columns.len() - 1
        });
        &mut self.columns[index]
    }

    /// The time column, if there is one.
    pub(crate) fn time(&self) -> Option<&WantedColumn> {
        self.columns.iter().find(|column| column.is_time)
    }

    /// Position in the header of each wanted column. Spaces around names do not count.
    pub(crate) fn positions(&self, file: &str, header: &[&str]) -> Result<Vec<usize>, DataError> {
        self.columns.iter().map(|column| column.position(file, header)).collect()
    }
}

impl WantedColumn {
    fn position(&self, file: &str, header: &[&str]) -> Result<usize, DataError> {
        let name = self.name.trim();
        let mut places = header.iter().enumerate().filter(|(_, found)| found.trim() == name).map(|(place, _)| place);
        let Some(first) = places.next() else {
            let names: Vec<String> = header.iter().map(|found| found.trim().to_owned()).collect();
            return Err(DataError::MissingColumn {
                file: file.to_owned(),
                column: self.name.clone(),
                used_in: self.used_in.clone(),
                columns: Box::new(FileColumns { near: nearest(name, &names), names, elsewhere: None }),
            });
        };
        match places.next() {
            None => Ok(first),
            Some(second) => Err(DataError::DuplicateColumn {
                file: file.to_owned(),
                column: self.name.clone(),
                first: first + 1,
                second: second + 1,
            }),
        }
    }

    /// True when its cells are read as plain numbers.
    pub(crate) fn is_number(&self) -> bool {
        !self.is_time && !self.numbers.is_empty()
    }

    /// True when its cells are read as text.
    pub(crate) fn is_text(&self) -> bool {
        self.is_test || self.is_group || !self.texts.is_empty()
    }

    /// Its cell in a row of a file.
    pub(crate) fn place(&self, file: &str, row: u64) -> Box<CellPlace> {
        Box::new(CellPlace { file: file.to_owned(), row, column: self.name.clone() })
    }

    /// The error for a row that does not say of which test, or of which group, it is.
    pub(crate) fn without_id(&self, file: &str, row: u64) -> DataError {
        let at = self.place(file, row);
        if self.is_group { DataError::MissingGroup { at } } else { DataError::MissingTest { at } }
    }

    /// An error for a text of so many bytes that is too long to name a test, a group or a kind.
    pub(crate) fn measure(&self, length: usize, file: &str, row: impl FnOnce() -> u64) -> Result<(), DataError> {
        if length <= TEXT {
            return Ok(());
        }
        Err(DataError::LongText { at: self.place(file, row()), found: length, limit: TEXT })
    }

    /// The error for a cell that is not a number.
    pub(crate) fn fault(&self, fault: CellFault, file: &str, row: u64, cell: &[u8]) -> DataError {
        let at = self.place(file, row);
        match fault {
            CellFault::NotANumber => {
                DataError::NotANumber { at, found: shown(cell), used_in: self.used_in.as_str().into() }
            }
            CellFault::Infinite => DataError::Infinite { at, found: shown(cell) },
            CellFault::NotUtf8 => self.not_utf8(file, row),
        }
    }

    /// The error for a cell that is not text.
    pub(crate) fn not_utf8(&self, file: &str, row: u64) -> DataError {
        DataError::NotUtf8 { file: file.to_owned(), row, column: Some(self.name.clone()) }
    }

    /// The time in a cell of text, in a row of a file; `number`: the number in it.
    pub(crate) fn moment(
        &self,
        number: Result<f64, CellFault>,
        (file, row): (&str, u64),
        cell: &[u8],
    ) -> Result<Moment, DataError> {
        match number {
            Ok(value) if value.is_nan() => Err(DataError::MissingTime { at: self.place(file, row) }),
            Ok(value) => Ok(Moment::of_number(value, cell)),
            Err(CellFault::NotANumber) => {
                let text = std::str::from_utf8(cell.trim_ascii()).map_err(|_| self.not_utf8(file, row))?;
                Moment::parse(text)
                    .ok_or_else(|| DataError::NotATime { at: self.place(file, row), found: shown(text.as_bytes()) })
            }
            Err(fault) => Err(self.fault(fault, file, row, cell)),
        }
    }
}
