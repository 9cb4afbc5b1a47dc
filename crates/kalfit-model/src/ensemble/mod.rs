//! Observations: tests with numeric and text cells, and groups of tests.

mod batch;
mod columns;
mod grouping;
mod id;
mod labels;
mod layout;
mod records;
mod selection;
mod test;

pub use batch::TestBatch;
pub use columns::SparseColumn;
pub use columns::Texts;
pub use grouping::{Group, Grouping, Member};
pub use id::TestId;
pub use labels::{Label, Labels};
pub use layout::{Layout, TestKey};
pub use selection::{LevelSlots, Selection};
pub use test::{Source, Test};
