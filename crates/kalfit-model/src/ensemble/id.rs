//! Ids of tests; many ids share one piece of memory.

use std::borrow::Borrow;
use std::fmt::{self, Debug, Display, Formatter};
use std::hash::{Hash, Hasher};
use std::ops::{Deref, Range};
use std::sync::Arc;

/// The id of a test: a part of one text with the ids of all tests that were read together. A copy of an id copies no
/// text.
///
/// ```
/// # use kalfit_model as kalfit;
/// use kalfit::TestId;
/// let id = TestId::from("unit 7");
/// assert_eq!((&id[..4], id == "unit 7", id.to_string()), ("unit", true, "unit 7".to_owned()));
/// ```
#[derive(Clone)]
pub struct TestId {
    /// Text with all ids, behind a thin pointer because an ensemble has many ids.
    ids: Arc<Box<str>>,
    start: u32,
    end: u32,
}

impl TestId {
    /// The id at bytes `place` of a text with many ids.
    pub(super) fn part(ids: &Arc<Box<str>>, place: Range<usize>) -> TestId {
        match (u32::try_from(place.start), u32::try_from(place.end)) {
            (Ok(start), Ok(end)) => TestId { ids: ids.clone(), start, end },
            _ => TestId::from(&ids[place]),
        }
    }
}

impl TestId {
    /// Text of the id.
    pub fn as_str(&self) -> &str {
        self
    }
}

impl Deref for TestId {
    type Target = str;

    fn deref(&self) -> &str {
        &self.ids[self.start as usize..self.end as usize]
    }
}

impl AsRef<str> for TestId {
    fn as_ref(&self) -> &str {
        self
    }
}

impl Borrow<str> for TestId {
    fn borrow(&self) -> &str {
        self
    }
}

impl From<&str> for TestId {
    /// # Panics
    /// If the text has 4 GB or more.
    fn from(text: &str) -> TestId {
        let end = u32::try_from(text.len()).expect("the id of a test has fewer than 2^32 bytes");
        TestId { ids: Arc::new(text.into()), start: 0, end }
    }
}

impl From<String> for TestId {
    fn from(text: String) -> TestId {
        TestId::from(text.as_str())
    }
}

impl From<&String> for TestId {
    fn from(text: &String) -> TestId {
        TestId::from(text.as_str())
    }
}

impl From<&TestId> for TestId {
    fn from(id: &TestId) -> TestId {
        id.clone()
    }
}

impl From<&TestId> for String {
    fn from(id: &TestId) -> String {
        id.to_string()
    }
}

impl From<TestId> for String {
    fn from(id: TestId) -> String {
        id.to_string()
    }
}

impl Debug for TestId {
    fn fmt(&self, out: &mut Formatter<'_>) -> fmt::Result {
        Debug::fmt(&**self, out)
    }
}

impl Display for TestId {
    fn fmt(&self, out: &mut Formatter<'_>) -> fmt::Result {
        Display::fmt(&**self, out)
    }
}

impl Eq for TestId {}

impl Ord for TestId {
    fn cmp(&self, other: &TestId) -> std::cmp::Ordering {
        (**self).cmp(&**other)
    }
}

impl PartialOrd for TestId {
    fn partial_cmp(&self, other: &TestId) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Hash for TestId {
    fn hash<H: Hasher>(&self, state: &mut H) {
        (**self).hash(state);
    }
}

/// An id equals another text when their characters are equal.
impl<T: AsRef<str> + ?Sized> PartialEq<T> for TestId {
    fn eq(&self, other: &T) -> bool {
        **self == *other.as_ref()
    }
}

impl PartialEq<TestId> for str {
    fn eq(&self, other: &TestId) -> bool {
        *self == **other
    }
}

impl PartialEq<TestId> for &str {
    fn eq(&self, other: &TestId) -> bool {
        **self == **other
    }
}

impl PartialEq<TestId> for String {
    fn eq(&self, other: &TestId) -> bool {
        **self == **other
    }
}
