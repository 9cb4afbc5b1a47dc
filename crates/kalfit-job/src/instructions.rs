//! The instructions that all work of this process is done with.

use kalfit::Isa;

use crate::failure::Failure;

/// The variable that fixes them where no option does.
pub const INSTRUCTIONS: &str = Isa::VARIABLE;

/// Fixes the instructions by their word, or else by the variable [`INSTRUCTIONS`] if that is set: results then have the same bits on every
/// machine that has them. Without either the widest registers of the machine are used.
///
/// # Errors
/// Words for instructions that this machine does not have, or that mean none; others that are fixed already.
pub fn fix_instructions(option: Option<&str>) -> Result<(), Failure> {
    let variable = || std::env::var(INSTRUCTIONS).ok().filter(|word| !word.is_empty());
    let Some(word) = option.map(str::to_owned).or_else(variable) else { return Ok(()) };
    let refused = |word: String| {
        let set = if option.is_some() { "--instructions" } else { INSTRUCTIONS };
        Failure::Instructions { set, word, machine: Isa::all().iter().map(|isa| isa.word()).collect() }
    };
    match Isa::named(&word) {
        Some(isa) => isa.fix().map_err(|_| refused(word)),
        None => Err(refused(word)),
    }
}
