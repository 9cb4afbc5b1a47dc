//! Tests with designs of their own that wait for others of the same shape, to be worked on side by side.

use kalfit_lanes::Isa;

/// Most lines: one for each shape.
const LINES: usize = 16;

/// Something that waits.
pub(crate) trait Waits {
    /// How long its record is.
    fn length(&self) -> usize;

    /// Whether a shorter one goes beside it: what goes with the longest of a line goes with all.
    fn goes_with(&self, other: &Self) -> bool;
}

/// Lines of those that go side by side.
#[derive(Debug)]
pub(crate) struct Lines<T> {
    lines: Vec<Vec<T>>,
}

impl<T> Default for Lines<T> {
    fn default() -> Self {
        Lines { lines: Vec::new() }
    }
}

impl<T: Waits> Lines<T> {
    /// Puts one at the end of its line. Returns the number of a line that is to be taken now.
    pub(crate) fn push(&mut self, own: T) -> Option<usize> {
        let longest = |line: &Vec<T>| line.iter().max_by_key(|other| other.length()).is_some_and(|l| l.goes_with(&own));
        let found = self.lines.iter().position(longest).or_else(|| self.lines.iter().position(Vec::is_empty));
        let line = found.unwrap_or_else(|| {
            self.lines.push(Vec::new());
            self.lines.len() - 1
        });
        self.lines[line].push(own);
        if self.lines[line].len() == Isa::best().lanes() {
            return Some(line);
        }
        // the fullest line is the least loss
        let fullest = || (0..self.lines.len()).max_by_key(|&at| self.lines[at].len());
        (self.lines.iter().filter(|line| !line.is_empty()).count() > LINES).then(fullest).flatten()
    }

    /// A line in which such a one waits.
    pub(crate) fn find(&self, wanted: impl Fn(&T) -> bool) -> Option<usize> {
        self.lines.iter().position(|line| line.iter().any(&wanted))
    }

    /// All of a line, which is empty then.
    pub(crate) fn take(&mut self, line: usize) -> Vec<T> {
        std::mem::take(&mut self.lines[line])
    }
}
