//! Tests that are elsewhere: on other machines, in other laboratories. Nothing of a single test leaves its place; what is asked for
//! are sums over tests, each a list of numbers that those of other places are added to.
//!
//! ```text
//! (θ, kind, tests) → sums        sums + sums → sums
//! ```
//!
//! A search is made again from its beginning with all answers that are there ([`Answers`]) until it asks for one that is not: every
//! step that it takes follows from the answers, so that it comes to the same place.

mod answers;
mod coordinates;
mod question;

pub use answers::{Answer, Answers, Remote, sum};
pub use coordinates::Coordinates;
pub use question::{Asked, Detail, Flat, InGroups, Law, Place, Question};
