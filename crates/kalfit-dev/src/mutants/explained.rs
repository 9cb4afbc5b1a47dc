//! Changes that no test can notice, with the reason: the answer is the same with them.

/// A line for each: the key of the change, a tab, the reason.
const EXPLAINED: &str = include_str!("explained.txt");

/// Why a change is none.
pub(super) fn reason(key: &str) -> Option<&'static str> {
    EXPLAINED.lines().filter_map(|line| line.split_once('\t')).find(|(of, _)| *of == key).map(|(_, reason)| reason)
}
