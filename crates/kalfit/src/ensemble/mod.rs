//! What was observed: tests, and the texts in them.

mod labels;
mod layout;
mod test;

pub use labels::{Label, Labels};
pub use layout::{Layout, TestKey};
pub use test::{Source, Test};
