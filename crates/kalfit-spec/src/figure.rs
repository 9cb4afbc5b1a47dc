//! Numbers as a person would write them.

/// A number as a person would write it: very large and very small ones with an exponent.
pub(crate) fn figure(x: f64) -> String {
    if x != 0.0 && !(1e-4..1e15).contains(&x.abs()) { format!("{x:e}") } else { x.to_string() }
}
