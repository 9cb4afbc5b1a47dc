//! The tests of the core from outside, one program: they share the dense reference and drawn ensembles.

mod dense;
mod dynamic_record;
mod inference;
mod innovations;
mod journey;
mod linear;
mod long_records;
mod meta_analysis;
mod observability;
mod passes;
mod phased;
mod phases_single;
mod plan;
mod random_ensembles;
mod reduction;
mod reduction_models;
mod restricted;
mod same_point;
mod sensitivities;
mod simulate;
mod simulated;
mod unobservable;
