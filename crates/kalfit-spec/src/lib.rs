//! Model files: TOML with equations, read into a [`kalfit::Model`].
//!
//! ```
//! let text = r#"
//! [states]
//! intercept = {}
//! slope = {}
//!
//! [measurements.reaction]
//! column = "Reaction"
//! equation = "intercept + slope * Days"
//! noise = "sigma"
//!
//! [parameters]
//! sigma = { start = 20 }
//! "#;
//! let spec = kalfit_spec::Spec::parse("sleep.toml", text)?;
//! assert_eq!(spec.model.estimated_names(), ["intercept", "slope"]);
//!
//! let error = kalfit_spec::Spec::parse("sleep.toml", &text.replace("Days", "intercept")).unwrap_err();
//! assert_eq!(error.message, "state `slope` times state `intercept` is not linear in the states");
//! # Ok::<(), kalfit_spec::SpecError>(())
//! ```
//!
//! Every message has its place in the file as a byte range ([`SpecError::span`]). A model file is untrusted: whatever
//! it holds, reading it ends, in bounded memory, with a [`Spec`] or a [`SpecError`].
//!
//! # Phases
//!
//! `[phases]` makes one [`Phase`](kalfit::model::Phase) of each of its tables, in the order in which the file names them first.
//! A phase has a table of its own whole (`[phases.coast.states]`), or takes that of the top level; a table of the top level that
//! no phase takes is refused, and so are `initial_time` and `step_first` of `[data]` beside `[phases]`. Phases share columns and
//! parameters; names of states and measurements are a phase's own.
//!
//! In `carry` the names are those of the phase before: its states, then parameters, then columns. A state that inherits adds
//! its own start, which cannot be stationary. The hidden rate of a second-order Gauss-Markov state goes where its owner goes,
//! by the same form, and adds nothing of its own. In a `[filter]` that considers such a state its rate is considered with it.
//!
//! # Levels
//!
//! `levels` of `[data]` names the columns of groups that tests stand in, the outermost first: they become text columns of the
//! model, and each a [`GroupLevel`](kalfit::model::GroupLevel). `[levels.NAME.covariance]` says what varies from group to group,
//! in the keys of `[covariance]` but `order` and `known`, which are the tests' own; `states` lists what varies there, and there
//! alone. The other states have a variance fixed at zero, as those with `random = false` have at every level. Levels go neither
//! with `[phases]` nor with `[filter]`.
//!
//! # The expression language
//!
//! ```text
//! expression  = number | name | `any text` | 'text' | ( expression ) | function ( expression, … )
//!             | - expression | not expression | expression operator expression
//! operator    = or | and | < <= > >= == != | + - | * / | ^
//! function    = sqrt exp log sin cos tan abs (one argument), min max (one or more),
//!               if (condition, value, other value)
//! ```
//!
//! From loosest to tightest: `or`, `and`, `not`, comparisons (which cannot be chained), `+ -`, `* /`, unary minus, `^`.
//! All operators group from the left except `^`, which groups from the right and takes a signed exponent: `2^-1` is a half,
//! `-2^2` is minus four. Numbers are decimal (`1`, `.5`, `1e-6`); names are letters, digits and `_`, not starting with a digit.
//! A quote inside a text is written twice.
//!
//! A name is a state of the phase, or else a parameter, or else `pi` or `dt`, or else a column of the data. A name in backticks is
//! always a column. Numbers, conditions and texts are different types: a condition becomes a number by `if(c, 1, 0)`, a number a
//! condition by `x != 0`, and a text can only be compared, by `==` or `!=`, with a column, which is then a text column.
//!
//! Equations must be linear in the states after expansion: products, quotients and functions of states are refused.
//! Constants are folded exactly; a constant that is not a finite number is refused.

mod beside;
mod build;
mod carry;
mod constraints;
mod covariance;
mod data;
mod describe;
mod design;
mod digest;
mod elements;
mod error;
mod expression;
mod figure;
mod filter;
mod give;
mod hypothesis;
mod keys;
mod levels;
mod matrix;
mod mean;
mod measurements;
mod merge;
mod motion;
mod names;
mod noise;
mod outputs;
mod parameters;
mod phase;
mod phases;
mod places;
mod question;
mod read;
mod schema;
mod semidefinite;
mod set;
mod show;
mod slots;
mod spec;
mod states;
mod suggest;
mod table;
mod token;
mod vocabulary;
mod words;

pub use beside::BesideError;
pub use design::DesignSpec;
pub use error::{ExpressionProblem, SpecError, SpecProblem, StructureProblem};
pub use hypothesis::Hypothesis;
pub use schema::schema;
pub use set::ParameterAssignment;
pub use show::PhaseWords;
pub use spec::Spec;
pub use suggest::nearest;
