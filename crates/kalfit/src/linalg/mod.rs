//! Small dense linear algebra. Own kernels on slices for inner loops; nalgebra for everything else.

pub(crate) mod algebra;
mod conditional;
pub(crate) mod echelon;
pub(crate) mod elements;
pub(crate) mod exponential;
pub(crate) mod factors;
pub(crate) mod fixed;
pub(crate) mod fold;
pub(crate) mod folded;
pub(crate) mod parts;
mod posterior;
mod products;
pub(crate) mod regular;
pub(crate) mod row_lists;
pub(crate) mod rows;
pub(crate) mod sparse;
pub(crate) mod symmetric;
mod whiten;
pub(crate) use conditional::Conditional;
pub(crate) use posterior::posterior_root;
pub(crate) use whiten::{compressed, log_determinant, whitened, whitener};
