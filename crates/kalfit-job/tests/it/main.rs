//! Jobs, done without a terminal.

mod interruption;
mod memory;
