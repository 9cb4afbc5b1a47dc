//! The tests of what is shown, one program.

mod advice;
mod check;
mod choices;
mod common;
mod diagnosis;
mod html;
mod levels;
mod model_check;
mod parameters;
mod phases;
mod plan;
mod plot;
mod ratio;
mod summary;
