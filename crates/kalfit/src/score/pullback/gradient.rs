//! dℓ/dα of one test.

/// Gradient of one test: (slot, dℓ/dvalue), each slot at most once, ascending.
pub(crate) type Gradient = Vec<(usize, f64)>;

/// Adds one gradient to another.
pub(crate) fn add(gradient: &mut Gradient, other: &Gradient) {
    for &(slot, x) in other {
        match gradient.binary_search_by_key(&slot, |&(slot, _)| slot) {
            Ok(at) => gradient[at].1 += x,
            Err(at) => gradient.insert(at, (slot, x)),
        }
    }
}
