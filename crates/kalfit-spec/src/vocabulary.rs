//! The vocabulary of the expression language: words with a meaning of their own, and how functions and operators are written.

use kalfit::model::{Function, Operator};

/// Words that are neither functions of numbers nor names.
const WORDS: [&str; 6] = ["and", "or", "not", "pi", "dt", "if"];
const FUNCTIONS: [(&str, Function); 9] = [
    ("sqrt", Function::Sqrt),
    ("exp", Function::Exp),
    ("log", Function::Log),
    ("sin", Function::Sin),
    ("cos", Function::Cos),
    ("tan", Function::Tan),
    ("abs", Function::Abs),
    ("min", Function::Min),
    ("max", Function::Max),
];
const OPERATORS: [(&str, Operator); 13] = [
    ("+", Operator::Add),
    ("-", Operator::Subtract),
    ("*", Operator::Multiply),
    ("/", Operator::Divide),
    ("^", Operator::Power),
    ("<", Operator::Less),
    ("<=", Operator::LessEqual),
    (">", Operator::Greater),
    (">=", Operator::GreaterEqual),
    ("==", Operator::Equal),
    ("!=", Operator::NotEqual),
    ("and", Operator::And),
    ("or", Operator::Or),
];

/// True for words that cannot name states or parameters.
pub(crate) fn is_reserved(word: &str) -> bool {
    WORDS.contains(&word) || function_called(word).is_some()
}

/// All that can be called, by name.
pub(crate) fn functions() -> impl Iterator<Item = &'static str> {
    FUNCTIONS.iter().map(|(name, _)| *name).chain(["if"])
}

/// The function of a name.
pub(crate) fn function_called(name: &str) -> Option<Function> {
    FUNCTIONS.iter().find(|(own, _)| *own == name).map(|(_, function)| *function)
}

/// The name of a function.
pub(crate) fn function(function: Function) -> &'static str {
    written(&FUNCTIONS, function)
}

/// The operator between two operands that is written so.
pub(crate) fn operator_written(symbol: &str) -> Option<Operator> {
    OPERATORS.iter().find(|(own, _)| *own == symbol).map(|(_, operator)| *operator)
}

/// How an operator is written.
pub(crate) fn symbol(operator: Operator) -> &'static str {
    written(&OPERATORS, operator)
}

fn written<T: PartialEq>(table: &[(&'static str, T)], wanted: T) -> &'static str {
    table.iter().find(|(_, own)| *own == wanted).map(|(word, _)| *word).expect("every one has its word")
}
