//! Small dense linear algebra. Own kernels on slices for inner loops; nalgebra for everything else.

pub mod echelon;
pub mod elements;
pub mod exponential;
pub mod fold;
pub(crate) mod parts;
mod posterior;
mod products;
pub(crate) mod rows;
pub mod symmetric;
mod whiten;
pub(crate) use posterior::posterior_root;
pub(crate) use whiten::{compressed, log_determinant, whitened, whitener};
