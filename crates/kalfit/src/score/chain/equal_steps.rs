//! Room for steps that are equally long.

/// Steps on end that are equally long.
#[derive(Debug, Clone, Default)]
pub(super) struct EqualSteps {
    /// Their length, by its bits.
    pub(super) length: Option<u64>,
    /// Adjoints of φ, Q and the flows, summed.
    pub(super) sums: Vec<f64>,
    /// The flows, where inputs or held states need them.
    pub(super) flows: Vec<f64>,
}

impl EqualSteps {
    /// Forgets it.
    pub(super) fn clear(&mut self) {
        self.length = None;
    }
}
