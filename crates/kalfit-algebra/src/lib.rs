//! Small dense linear algebra: kernels on slices for inner loops, nalgebra for everything else.

pub mod algebra;
mod conditional;
pub mod echelon;
pub mod elements;
pub mod exponential;
pub mod factors;
pub mod fixed;
pub mod fold;
pub mod folded;
pub mod parts;
mod posterior;
mod products;
pub mod regular;
pub mod row_lists;
pub mod rows;
pub mod sparse;
pub mod symmetric;
mod whiten;
pub use conditional::Conditional;
pub use posterior::posterior_root;
pub use whiten::{compressed, log_determinant, whitened, whitener};
