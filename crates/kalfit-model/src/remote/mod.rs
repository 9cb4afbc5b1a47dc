//! Remote tests: tests on other machines, in other laboratories. No data of a single test leave a site; a site sends
//! only sums over tests, as lists of numbers, and the lists of all sites are added.
//!
//! ```text
//! (θ, kind, tests) → sums        sums + sums → sums
//! ```
//!
//! A search is repeated from the beginning with all known answers ([`Answers`]) until the search puts a question
//! without a known answer. Every step of the search follows from the answers, so that a repeated search reaches the
//! same point.

mod answers;
mod coordinates;
mod question;

pub use answers::{Answer, Answers, Remote, sum};
pub use coordinates::Coordinates;
pub use question::{Asked, Detail, Flat, InGroups, Law, Place, Question};
