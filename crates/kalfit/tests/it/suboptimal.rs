//! Estimates of suboptimal filters: golden numbers of the public case, and laws against dense constructions.

mod beside;
mod drawn;
mod edges;
mod random;
mod schmidt;
mod two_phases;
