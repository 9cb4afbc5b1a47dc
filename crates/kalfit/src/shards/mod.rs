//! Fits of tests that are spread over several places: on a cluster, and between laboratories that exchange nothing but
//! sums.
//!
//! ```text
//! Shard::answer(θ, kind) → sums          where tests are: a pure function of what is asked and of them
//! remote::sum(sums, sums, …) → sums      in the order of the places
//! go_on(all sums so far) → Next          what is to be asked next, or the fit
//! ```
//!
//! [`go_on`] repeats the search of [`estimate`](crate::estimate) and [`dynamic`](crate::dynamic) from its beginning
//! with the answers known so far. It stores nothing itself: whoever has the answers can continue.
//!
//! ```
//! use kalfit::build::{Columns, constant, free, measurement, name};
//! use kalfit::estimate::Silent;
//! use kalfit::remote::{Answer, sum};
//! use kalfit::shards::{Asks, Next, Shard, go_on};
//! use kalfit::{Ensemble, Provenance};
//!
//! let model = kalfit::Model::builder("Three places")
//!     .state(constant("bias"))
//!     .measurement(measurement("y", name("bias"), "sigma"))
//!     .parameter(free("sigma"))
//!     .build()?;
//! let wave = |k: u32| 3.0 + (f64::from(k) * 0.7).sin() + 0.3 * (f64::from(k) * 12.9).cos();
//! let test = |j: u32| Columns::new(format!("unit {j}")).numbers("y", (0..5).map(|i| wave(5 * j) + 0.1 * wave(5 * j + i)));
//! let tests: Vec<Columns> = (0..30).map(test).collect();
//!
//! // in each place
//! let shards: Vec<Shard> = tests
//!     .chunks(10)
//!     .map(|own| {
//!         let own = Ensemble::new(&model, own).expect("columns of the model");
//!         Shard::new(model.clone(), own.labels(), own.tests().to_vec(), Default::default())
//!     })
//!     .collect::<Result<_, _>>()?;
//! // between them
//! let mut known = Vec::new();
//! let record = loop {
//!     match go_on(&model, &Asks::default(), known.clone(), Provenance::default(), &mut Silent)? {
//!         Next::Ends(record) => break record,
//!         Next::Asks(all) => {
//!             for asked in all {
//!                 let answers: Vec<Answer> = shards.iter().map(|shard| shard.answer(&asked)).collect::<Result<_, _>>()?;
//!                 known.push((asked, sum(&answers).expect("answers to one question are of one length")));
//!             }
//!         }
//!     }
//! };
//! let whole = kalfit::fit(&model, &tests)?;
//! assert!(record.converged && (record.log_likelihood - whole.log_likelihood()).abs() < 1e-9);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod audit;
mod error;
mod search;
mod shard;
#[cfg(test)]
mod tests;

pub use audit::Audit;
pub use error::ShardError;
pub use search::{Asks, Next, first, go_on};
pub use shard::Shard;
