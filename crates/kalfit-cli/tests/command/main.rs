//! The built command, run as a user runs it.

mod broken;
mod dynamic;
mod em;
mod ensembles;
mod exchange;
mod folder;
mod hypotheses;
mod inference;
mod innovations;
mod phases;
mod plan;
mod report;
mod scales;
mod simulate;
mod sound;
mod starts;
mod undrawable;
