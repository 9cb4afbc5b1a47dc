//! Columns with a value per test, without a separate piece of memory for each test.

/// Texts stored one after the other.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Texts {
    all: String,
    ends: Vec<usize>,
}

impl Texts {
    /// Number of texts.
    pub(crate) fn len(&self) -> usize {
        self.ends.len()
    }

    /// The text with index `number`. Panics if there are fewer texts.
    pub fn get(&self, number: usize) -> &str {
        let start = number.checked_sub(1).map_or(0, |before| self.ends[before]);
        &self.all[start..self.ends[number]]
    }

    /// Appends a text.
    pub fn push(&mut self, text: &str) {
        self.all.push_str(text);
        self.ends.push(self.all.len());
    }

    /// Appends all texts of `others`.
    pub fn append(&mut self, others: &Texts) {
        let shift = self.all.len();
        self.all.push_str(&others.all);
        self.ends.extend(others.ends.iter().map(|end| end + shift));
    }

    /// Reserves memory for all texts of `others`.
    pub fn reserve<'a>(&mut self, others: impl Iterator<Item = &'a Texts>) {
        let (bytes, texts) = others.fold((0, 0), |sum, one| (sum.0 + one.all.len(), sum.1 + one.len()));
        self.all.reserve_exact(bytes);
        self.ends.reserve_exact(texts);
    }
}

/// Values of a column that is empty for most tests; the list ends with the last test that has a value.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SparseColumn<T>(Vec<Option<T>>);

impl<T> Default for SparseColumn<T> {
    fn default() -> SparseColumn<T> {
        SparseColumn(Vec::new())
    }
}

impl<T> SparseColumn<T> {
    /// An empty list with room for `tests` tests.
    pub fn with_room(tests: usize) -> SparseColumn<T> {
        SparseColumn(Vec::with_capacity(tests))
    }

    /// Value of the test with index `number`; `None` without a value.
    pub fn get(&self, number: usize) -> Option<&T> {
        self.0.get(number)?.as_ref()
    }

    /// Value of the test with index `number`, for writing; `None` without a value.
    pub fn get_mut(&mut self, number: usize) -> Option<&mut T> {
        self.0.get_mut(number)?.as_mut()
    }

    /// Whether any test has a value.
    pub fn has_any(&self) -> bool {
        self.0.iter().rev().any(Option::is_some)
    }

    /// Sets the value of the test with index `number`; `None` removes the value.
    pub fn set(&mut self, number: usize, one: Option<T>) {
        if number >= self.0.len() {
            if one.is_none() {
                return;
            }
            self.0.resize_with(number + 1, || None);
        }
        self.0[number] = one;
    }

    /// Appends the values of `others` after the values of the present tests, whose number is given.
    pub fn append(&mut self, tests_before: usize, others: SparseColumn<T>) {
        if !others.0.is_empty() {
            self.0.resize_with(tests_before, || None);
            self.0.extend(others.0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_are_as_they_were_put() {
        let mut some = Texts::default();
        ["a", "", "bé"].iter().for_each(|text| some.push(text));
        let mut all = Texts::default();
        all.push("first");
        all.reserve([&some].into_iter());
        all.append(&some);
        let found: Vec<&str> = (0..all.len()).map(|number| all.get(number)).collect();
        assert_eq!(found, ["first", "a", "", "bé"]);
    }

    #[test]
    fn what_is_rare_is_with_its_tests() {
        let mut some = SparseColumn::default();
        some.set(3, None);
        assert_eq!((some.get(0), some.0.len()), (None, 0), "no memory for nothing");
        some.set(1, Some("b"));
        let mut others = SparseColumn::default();
        others.set(0, Some("e"));
        some.append(4, others);
        let found: Vec<Option<&&str>> = (0..6).map(|number| some.get(number)).collect();
        assert_eq!(found, [None, Some(&"b"), None, None, Some(&"e"), None]);
        some.append(5, SparseColumn::default());
        assert_eq!(some.0.len(), 5);
    }
}
