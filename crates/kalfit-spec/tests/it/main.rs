//! The tests of model files, one program.

mod accepts;
mod give;
mod hypothesis;
mod linear;
mod never_panics;
mod refuses;
mod set;
