//! What was observed: tests, and the texts in them.

mod labels;
mod test;

pub use labels::{Label, Labels};
pub use test::{Source, Test};
