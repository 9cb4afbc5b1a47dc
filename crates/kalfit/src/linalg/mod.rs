//! Small dense linear algebra. Own kernels on slices for inner loops; nalgebra for everything else.

pub mod symmetric;
