//! What was observed: tests, and the texts in them.

mod grouping;
mod labels;
mod layout;
mod test;

pub use grouping::{Group, Grouping};
pub use labels::{Label, Labels};
pub use layout::{Layout, TestKey};
pub use test::{Source, Test};
