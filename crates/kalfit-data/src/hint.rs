//! What to do about an error, where that is known.

use crate::columns::comment_hint;
use crate::error::DataError;
use crate::moment::Moment;
use crate::most_rows::MOST_ROWS;

impl DataError {
    /// What to do about it, in one sentence; None when the message says all.
    pub fn hint(&self) -> Option<String> {
        Some(match self {
            DataError::NoInput => return None,
            DataError::Exchange(error) => return error.hint(),
            DataError::Pattern { .. } => "give the file's whole name, or write `[*]` for a star and `[?]` for a question mark".into(),
            DataError::NoMatch { .. } => "`*` stands for any text, `?` for one character, `[ab]` for a or b, `**/` for any folders".into(),
            DataError::SameFile { .. } => "give each file once: its rows would count twice".into(),
            DataError::SameTest { .. } => "with `test = \"@file\"` each file needs a name of its own".into(),
            DataError::Directory { file } => format!("give its files: `{}/*.csv`", file.trim_end_matches('/')),
            DataError::Kind { found, .. } => kind_hint(found),
            DataError::MissingColumn { columns, .. } => columns.hint(),
            DataError::DuplicateColumn { .. } => "rename one of them: the model cannot tell which is meant".into(),
            DataError::ColumnType { found, .. } => type_hint(found)?,
            DataError::RowLength { begins: Some(mark @ ('#' | '%')), .. } => comment_hint(*mark),
            DataError::RowLength { found, expected, lines, .. } => length_hint(*found, *expected, *lines),
            DataError::UnitsRow { row, .. } => format!("row {row} looks like a row of units: remove it, and give units in the model file, as `unit = \"deg/h\"`"),
            DataError::OpenQuote { .. } => "a quote opens a cell that ends at the next quote; write `\"\"` for a quote inside it".into(),
            DataError::BlankRow { .. } => "write `NA` for a missing cell, or remove the line".into(),
            DataError::LongRow { .. } => "a quote that is not closed makes one row of many lines".into(),
            DataError::LongText { .. } => "ids, names of groups and values of columns of text are short; the file may be damaged".into(),
            DataError::CarriageReturns { .. } => "save the file with the line ends of Unix or Windows".into(),
            DataError::NotUtf8 { .. } => "save the file as UTF-8".into(),
            DataError::NotANumber { at, found, used_in } => {
                text_hint(&at.column, found, used_in).unwrap_or_else(|| number_hint(found))
            }
            DataError::Infinite { .. } => "write `NA` where there is no measurement".into(),
            DataError::MissingTest { .. } => "every row needs the id of its test".into(),
            DataError::MissingGroup { .. } => "every row needs the group of its test in every column of `levels` and `crossed` of `[data]`".into(),
            DataError::TwoGroups { joined: true, .. } => "names that hold a `/` make two tests look like one: write them with another character".into(),
            DataError::TwoGroups { .. } => "a test is of one group of each column of `levels` and `crossed` of `[data]`: split the test, or take the column out there".into(),
            DataError::MissingTime { .. } => "every row needs a time when the model names a time column".into(),
            DataError::NotATime { found, .. } => time_hint(found),
            DataError::TimeDecreases { phase: None, .. } => {
                "sort the rows of each test by time; if these are two tests, give them two ids".into()
            }
            DataError::TimeDecreases { .. } => {
                "sort the rows of each phase by time; times may start again with the next phase only".into()
            }
            DataError::TimeUnit { .. } => "date-times are read as time since the test's first row: set `time_unit` in `[data]` to `s`, `ms`, `us`, `ns`, `min`, `h` or `d`".into(),
            DataError::MixedTimes { .. } => "write the whole column one way".into(),
            DataError::Codec { .. } => "write the file again with snappy or zstd".into(),
            DataError::Oversized { what: "rows" | "values", .. } => format!(
                "the file is damaged, or made to exhaust memory; if it is sound, set the variable {MOST_ROWS} to the number of rows"
            ),
            DataError::Oversized { .. } => {
                "the file is damaged, or made to exhaust memory; if it is sound, split it into several files".into()
            }
            DataError::Encrypted { .. } => "write the table again without encryption".into(),
            DataError::TimeZone { .. } => "write the column with an offset such as `+01:00`, or with a zone such as `Europe/Berlin`".into(),
            DataError::Parquet { .. } | DataError::Arrow { .. } | DataError::Crashed { .. } => "the file may be damaged, or not copied whole; if other programs read it, write it again with one of them".into(),
            DataError::Memory { .. } => "see that the input ends; rows are kept until those of their test are read, so write these one below the other".into(),
            DataError::Io { .. } | DataError::Empty { .. } | DataError::NoRows { .. } => return None,
        })
    }
}

fn kind_hint(found: &str) -> String {
    if found.contains("workbook") {
        "save the sheet as CSV".into()
    } else if found.contains("Feather") {
        "write it again as Feather version 2, which is Arrow IPC, or as Parquet".into()
    } else {
        "unpack it first, for instance `gunzip -c data.csv.gz | kalfit fit model.toml -`".into()
    }
}

fn type_hint(found: &str) -> Option<String> {
    if found.starts_with("Timestamp") || found.starts_with("Date") {
        Some("only the column that `time` of `[data]` names may hold date-times as times".into())
    } else if found.contains("Binary") {
        Some("write the column as text (UTF-8), not as bytes".into())
    } else {
        None
    }
}

fn length_hint(found: usize, expected: usize, lines: u64) -> String {
    if lines > 1 {
        format!("the row runs over {lines} lines: a quote may not be closed")
    } else if found > expected {
        "a cell that contains the delimiter needs quotes; a decimal comma needs another delimiter".into()
    } else {
        "a missing cell still needs its delimiter".into()
    }
}

fn time_hint(found: &str) -> String {
    if let Some(iso) = european(found) {
        format!("write date-times as in ISO 8601: `{found}` is `{iso}`")
    } else if found.contains('/') || found.contains('[') {
        "write date-times as `2024-03-01T12:00:00` or `2024-03-01T12:00:00+01:00`".into()
    } else {
        number_hint(found)
    }
}

/// A date as most of Europe writes it, 13.02.2026 or 13.02.2026 14:05, in ISO 8601.
fn european(found: &str) -> Option<String> {
    let (date, time) = found.split_once([' ', 'T']).map_or((found, None), |(date, time)| (date, Some(time.trim())));
    let parts: Vec<&str> = date.split('.').collect();
    let [day, month, year] = parts[..] else { return None };
    let number = |text: &str, most: usize| {
        let digits = !text.is_empty() && text.len() <= most && text.bytes().all(|b| b.is_ascii_digit());
        if digits { text.parse::<u16>().ok() } else { None }
    };
    let (day, month) = (number(day, 2)?, number(month, 2)?);
    let year = number(year, 4).filter(|_| year.len() == 4)?;
    let iso = format!("{year:04}-{month:02}-{day:02}{}", time.map_or(String::new(), |time| format!("T{time}")));
    Moment::parse(&iso).map(|_| iso)
}

/// Names that spreadsheets give to the row below the others.
const TOTALS: [&str; 10] =
    ["total", "totals", "grand total", "subtotal", "sum", "mean", "average", "median", "overall", "summe"];

/// A row by this name sums up others.
pub fn is_total(name: &str) -> bool {
    let name = name.trim().trim_end_matches(':').to_lowercase();
    TOTALS.contains(&name.as_str())
}

/// What a word in a column of numbers may have meant, by what the column is used for.
fn text_hint(column: &str, found: &str, used_in: &str) -> Option<String> {
    let is_word = found.starts_with(char::is_alphabetic) && !["true", "false"].contains(&found.to_lowercase().as_str());
    let (word, name) =
        (found.replace('\'', ""), if is_plain(column) { column.to_owned() } else { format!("`{column}`") });
    if is_total(found) {
        Some("the row seems to sum up others: remove it".into())
    } else if !is_word || used_in.is_empty() {
        None
    } else if used_in.starts_with("regression") {
        Some(format!(
            "a regression takes numbers: write a column of 0 and 1 for `{word}`, or give the equation a state with `random = false` \
             times `if({name} == '{word}', 1, 0)` in place of the regression; only a text for missing cells goes into `missing` of `[data]`"
        ))
    } else if used_in.contains("equation") {
        Some(format!(
            "a text is compared, as in `if({name} == '{word}', 1, 0)`; leave a missing cell empty, or add its text to `missing` of `[data]`"
        ))
    } else {
        None
    }
}

/// A name that needs no quotes in an equation.
fn is_plain(name: &str) -> bool {
    let mut letters = name.chars();
    letters.next().is_some_and(|c| c.is_alphabetic() || c == '_') && letters.all(|c| c.is_alphanumeric() || c == '_')
}

/// What a text in a numeric column may have meant.
fn number_hint(found: &str) -> String {
    let digits = |text: &str| !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit());
    let unsigned = found.trim_start_matches(['+', '-']);
    let parts: Vec<&str> = unsigned.split(',').collect();
    let whole = unsigned.split('.').next().unwrap_or_default();
    let groups: Vec<&str> = whole.split([',', ' ', '\'', '_', '\u{a0}', '\u{202f}']).collect();
    let grouped = groups.len() > 1
        && digits(groups[0])
        && groups[0].len() <= 3
        && groups[1..].iter().all(|group| digits(group) && group.len() == 3);
    let comma = parts.len() == 2 && digits(parts[0]) && parts[1].bytes().next().is_some_and(|b| b.is_ascii_digit());
    if grouped && comma {
        "write a decimal comma as `.`, and leave out a separator of thousands".into()
    } else if grouped {
        "leave out the separators of thousands".into()
    } else if comma {
        "write the decimal comma as `.`".into()
    } else if Moment::parse(found).is_some() || european(found).is_some() {
        "date-times are read in the column that `time` of `[data]` names, and nowhere else".into()
    } else if ["true", "false"].contains(&found.to_ascii_lowercase().as_str()) {
        "write 1 for true and 0 for false".into()
    } else if let Some(mark @ ('#' | '%')) = found.chars().next() {
        comment_hint(mark)
    } else if unsigned.starts_with(|c: char| c.is_ascii_digit()) {
        "a cell holds a number and nothing else; units go into the model file".into()
    } else {
        "leave a missing cell empty, or add its text to `missing` of `[data]`".into()
    }
}
