//! The built command, run as a user runs it.

mod broken;
mod folder;
mod innovations;
mod scales;
mod sound;
mod starts;
