//! The built command, run as a user runs it.

mod broken;
mod check;
mod dynamic;
mod em;
mod ensembles;
mod exchange;
mod folder;
mod generated;
mod help;
mod hypotheses;
mod inference;
mod init;
mod innovations;
mod interrupted;
mod phases;
mod plan;
mod report;
mod scales;
mod simulate;
mod sound;
mod starts;
mod terminal;
mod undrawable;
