//! Small dense linear algebra. Own kernels on slices for inner loops; nalgebra for everything else.

pub mod echelon;
pub mod exponential;
pub mod fold;
pub mod real;
pub mod symmetric;
