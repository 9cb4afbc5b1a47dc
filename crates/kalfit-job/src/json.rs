//! Records as JSON for people and programs: one line for each member of an object and for each text or structure in a list, and
//! numbers in a list side by side, so that a matrix has one line for each row. Each test has one line.

use std::io::{self, Write};

use kalfit::record::{directs_text, undirected};
use serde::Serialize;
use serde_json::Serializer;
use serde_json::ser::Formatter;

/// A record in words.
///
/// # Errors
/// When the record cannot be put into JSON.
pub fn to_vec(record: &impl Serialize) -> serde_json::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    to_writer(&mut bytes, record)?;
    Ok(bytes)
}

/// The same, as text.
///
/// # Errors
/// As [`to_vec`].
pub fn to_string(record: &impl Serialize) -> serde_json::Result<String> {
    to_vec(record).map(|bytes| String::from_utf8(bytes).expect("JSON is text"))
}

/// Writes a record in words.
pub(crate) fn to_writer(writer: impl Write, record: &impl Serialize) -> serde_json::Result<()> {
    record.serialize(&mut Serializer::with_formatter(writer, JsonLines::default()))
}

/// Writes a structure on one line, as it stands in a list of tests.
pub(crate) fn line(writer: impl Write, record: &impl Serialize) -> serde_json::Result<()> {
    record.serialize(&mut Serializer::with_formatter(writer, JsonLines { inline: 1, ..JsonLines::default() }))
}

/// A list of this name in a record has each element on one line: there may be a million of them.
const ROWS: &[u8] = b"tests";

/// Two spaces for each level, as far as levels go without a loop.
const SPACES: &[u8] = b"                                ";

/// Where lines end.
#[derive(Debug, Default)]
struct JsonLines {
    /// For each list or object that is open, whether it has begun a line of its own.
    open: Vec<bool>,
    /// An element of a list is to come: whether it is the first.
    element: Option<bool>,
    /// A member's name is being written; the last one was that of a list with one line for each element.
    name: bool,
    rows: bool,
    /// So many are open inside such an element, itself among them, and stay on its line.
    inline: usize,
}

/// Elements of a list of tests are in it and in the record.
const ROW_DEPTH: usize = 2;

impl JsonLines {
    fn line<W: ?Sized + Write>(writer: &mut W, depth: usize) -> io::Result<()> {
        writer.write_all(b"\n")?;
        let mut left = 2 * depth;
        while left > 0 {
            let some = left.min(SPACES.len());
            writer.write_all(&SPACES[..some])?;
            left -= some;
        }
        Ok(())
    }

    /// Before an element that stays on the line.
    fn beside<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        match self.element.take() {
            Some(false) => writer.write_all(b", "),
            _ => Ok(()),
        }
    }

    /// Before an element that begins a line, unless it is within one.
    fn below<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        if self.inline > 0 {
            return self.beside(writer);
        }
        let Some(first) = self.element.take() else { return Ok(()) };
        if !first {
            writer.write_all(b",")?;
        }
        if let Some(begun) = self.open.last_mut() {
            *begun = true;
        }
        JsonLines::line(writer, self.open.len())
    }

    fn begin<W: ?Sized + Write>(&mut self, writer: &mut W, bracket: &[u8]) -> io::Result<()> {
        self.below(writer)?;
        if self.inline > 0 || (self.rows && self.open.len() == ROW_DEPTH) {
            self.inline += 1;
        }
        self.open.push(false);
        writer.write_all(bracket)
    }

    fn end<W: ?Sized + Write>(&mut self, writer: &mut W, bracket: &[u8]) -> io::Result<()> {
        if self.open.pop() == Some(true) {
            JsonLines::line(writer, self.open.len())?;
        }
        self.inline = self.inline.saturating_sub(1);
        writer.write_all(bracket)
    }
}

/// What is written of numbers and words that stand beside each other.
macro_rules! beside {
    ($($method:ident: $number:ty),*) => {
        $(fn $method<W: ?Sized + Write>(&mut self, writer: &mut W, value: $number) -> io::Result<()> {
            self.beside(writer)?;
            serde_json::ser::CompactFormatter.$method(writer, value)
        })*
    };
}

impl Formatter for JsonLines {
    beside!(write_bool: bool, write_i8: i8, write_i16: i16, write_i32: i32, write_i64: i64, write_i128: i128);
    beside!(write_u8: u8, write_u16: u16, write_u32: u32, write_u64: u64, write_u128: u128);
    beside!(write_f32: f32, write_f64: f64, write_number_str: &str);

    fn write_null<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.beside(writer)?;
        writer.write_all(b"null")
    }

    fn begin_string<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.below(writer)?;
        writer.write_all(b"\"")
    }

    fn write_string_fragment<W: ?Sized + Write>(&mut self, writer: &mut W, fragment: &str) -> io::Result<()> {
        if self.name && self.open.len() == 1 {
            self.rows = fragment.as_bytes() == ROWS;
        }
        match fragment.contains(directs_text) {
            // another program reads the same text, and a person sees what is there
            true => writer.write_all(undirected(fragment.to_owned()).as_bytes()),
            false => writer.write_all(fragment.as_bytes()),
        }
    }

    fn begin_array<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.begin(writer, b"[")
    }

    fn end_array<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.end(writer, b"]")
    }

    fn begin_array_value<W: ?Sized + Write>(&mut self, _: &mut W, first: bool) -> io::Result<()> {
        self.element = Some(first);
        Ok(())
    }

    fn begin_object<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.begin(writer, b"{")
    }

    fn end_object<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.end(writer, b"}")
    }

    fn begin_object_key<W: ?Sized + Write>(&mut self, writer: &mut W, first: bool) -> io::Result<()> {
        self.element = Some(first);
        self.name = true;
        self.below(writer)
    }

    fn begin_object_value<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.name = false;
        writer.write_all(b": ")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_stand_side_by_side_tests_have_a_line_each_and_all_else_has_lines_of_its_own() {
        let record = serde_json::json!({
            "empty": {}, "none": [], "flag": true, "mean": [1.5, null, -2], "matrix": [[1, 2], [3, 4]],
            "names": ["a \"b\"", "c"], "tests": [{ "id": "x", "phases": [{ "m": [0.1, 2] }] }, { "id": "y", "phases": [] }],
            "ways": [{ "tests": [{ "id": 1 }] }]
        });
        let text = to_string(&record).unwrap();
        let expected = r#"{
  "empty": {},
  "flag": true,
  "matrix": [
    [1, 2],
    [3, 4]
  ],
  "mean": [1.5, null, -2],
  "names": [
    "a \"b\"",
    "c"
  ],
  "none": [],
  "tests": [
    {"id": "x", "phases": [{"m": [0.1, 2]}]},
    {"id": "y", "phases": []}
  ],
  "ways": [
    {
      "tests": [
        {
          "id": 1
        }
      ]
    }
  ]
}"#;
        assert_eq!(text, expected);
        assert_eq!(serde_json::from_str::<serde_json::Value>(&text).unwrap(), record);
    }

    #[test]
    fn lines_of_any_depth_are_indented() {
        let mut deep = serde_json::json!([{}]);
        for _ in 0..40 {
            deep = serde_json::json!([deep]);
        }
        let text = to_string(&deep).unwrap();
        assert!(text.contains(&format!("\n{}{{}}\n", "  ".repeat(41))), "{text}");
        assert_eq!(serde_json::from_str::<serde_json::Value>(&text).unwrap(), deep);
    }
}
