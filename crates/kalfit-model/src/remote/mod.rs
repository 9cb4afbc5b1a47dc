//! Tests that are elsewhere: on other machines, in other laboratories. No data of a single test leave their site; only
//! sums over tests are requested, each a list of numbers to which those of other sites are added.
//!
//! ```text
//! (θ, kind, tests) → sums        sums + sums → sums
//! ```
//!
//! A search is repeated from its beginning with all answers that are known ([`Answers`]) until it asks for one that is
//! not. Every step of the search follows from the answers, so that it reaches the same point again.

mod answers;
mod coordinates;
mod question;

pub use answers::{Answer, Answers, Remote, sum};
pub use coordinates::Coordinates;
pub use question::{Asked, Detail, Flat, InGroups, Law, Place, Question};
