//! The columns of a file, and which of them was probably meant.

use crate::cell::shown;

/// The columns a file has, and the one that was probably meant.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FileColumns {
    /// The column whose name is close, if there is one.
    pub near: Option<String>,
    /// All names, in the order of the file.
    pub names: Vec<String>,
    /// What else may have been meant, in words: a state or a parameter of the model.
    pub elsewhere: Option<String>,
}

impl FileColumns {
    /// What to do when the column that is needed is not there.
    pub(crate) fn hint(&self) -> String {
        const MOST: usize = 12;
        match (&self.near, &self.elsewhere) {
            (Some(near), None) => return format!("there is a column `{near}`"),
            (None, Some(other)) => return format!("what is no state or parameter is a column: is {other} meant?"),
            (Some(near), Some(other)) => return format!("there is {other}, and a column `{near}`"),
            (None, None) => {}
        }
        if let Some(hint) = self.blanks() {
            return hint;
        }
        if let Some(mark @ ('#' | '%')) = self.names.first().and_then(|name| name.chars().next()) {
            return comment_hint(mark);
        }
        let shown: Vec<String> =
            self.names.iter().take(MOST).map(|name| format!("`{}`", shown(name.as_bytes()))).collect();
        let more = self.names.len().saturating_sub(MOST);
        let more = if more > 0 { format!(" and {more} more") } else { String::new() };
        format!("its columns are {}{more}", shown.join(", "))
    }

    /// What to do where one name holds blanks as if they stood between the names of several columns.
    fn blanks(&self) -> Option<String> {
        let [only] = self.names.as_slice() else { return None };
        let words = only.split_whitespace().count();
        (words > 1).then(|| {
            format!(
                "its header is one name of {words} words: if blanks stand between columns, write commas in their place, for instance \
                 by `sed -E 's/^ +//; s/ +/,/g' data.txt > data.csv`"
            )
        })
    }
}

/// The name that was probably meant: the same but for case, else one within a third of its letters.
pub(crate) fn nearest(name: &str, names: &[String]) -> Option<String> {
    const LONGEST: usize = 128; // longer names are not compared: the cost grows with the product of the lengths
    if name.len() > LONGEST {
        return None;
    }
    let lower = name.to_lowercase();
    names
        .iter()
        .filter(|found| found.len() <= LONGEST)
        .map(|found| (strsim::osa_distance(&lower, &found.to_lowercase()), found))
        .min_by_key(|(distance, _)| *distance)
        .filter(|(distance, _)| *distance <= (name.chars().count() / 3).max(1) && *distance < name.chars().count())
        .map(|(_, found)| found.clone())
}

/// What to do about lines that begin as comments do.
pub(crate) fn comment_hint(mark: char) -> String {
    format!("if lines that begin with `{mark}` are comments, set `comment = \"{mark}\"` in `[data]`")
}
