//! The environment variable that names the instruction set holds for the library, too.

use std::process::Command;

use kalfit_lanes::{Isa, UnknownInstructions};

/// What a process with this variable works with: it runs the test below, which prints it.
fn with_variable(word: &str) -> String {
    let mut child = Command::new(std::env::current_exe().expect("this program"));
    child.args(["--exact", "prints_its_instructions", "--nocapture"]).env(Isa::VARIABLE, word);
    let output = child.output().expect("the program runs");
    assert!(output.status.success(), "{output:?}");
    String::from_utf8(output.stdout).expect("text")
}

#[test]
fn prints_its_instructions() {
    println!("works with {}, {:?}", Isa::best().word(), Isa::chosen().map(Isa::word));
}

#[test]
fn the_variable_names_the_instructions() {
    for isa in Isa::all() {
        let word = isa.word();
        let text = with_variable(word);
        assert!(text.contains(&format!("works with {word}, Ok({word:?})")), "{word}: {text}");
    }
}

#[test]
fn a_variable_that_names_none_is_an_error() {
    let widest = Isa::all().last().expect("one").word();
    assert!(with_variable("").contains(&format!("works with {widest}, Ok({widest:?})")));
    let text = with_variable("sse");
    assert!(text.contains(&format!("works with {widest}, Err(")), "{text}");
    let error = UnknownInstructions { word: "sse".to_owned() }.to_string();
    assert!(error.starts_with("KALFIT_INSTRUCTIONS: found `sse`, expected one of `portable`"), "{error}");
}
