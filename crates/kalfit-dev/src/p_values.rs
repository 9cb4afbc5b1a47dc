//! How many p-values lie below nominal probabilities.

/// Nominal probabilities.
pub(crate) const LEVELS: [f64; 6] = [1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6];

/// How many p-values there are, and below each level.
#[derive(Debug, Default, Clone, Copy)]
pub(crate) struct PValueCount {
    all: u64,
    below: [u64; LEVELS.len()],
}

/// Prints the head of a table.
pub(crate) fn head(what: &str) {
    println!("| {what} | {} |", LEVELS.map(|p| format!("{p:e}")).join(" | "));
    println!("|---{}|", "|---".repeat(LEVELS.len()));
}

impl PValueCount {
    pub(crate) fn take(&mut self, p: Option<f64>) {
        let Some(p) = p else { return };
        self.all += 1;
        self.below.iter_mut().zip(LEVELS).filter(|(_, level)| p < *level).for_each(|(n, _)| *n += 1);
    }

    pub(crate) fn with(self, other: PValueCount) -> PValueCount {
        PValueCount { all: self.all + other.all, below: std::array::from_fn(|k| self.below[k] + other.below[k]) }
    }

    /// Prints counts as multiples of what they should be; none where that is too few to tell.
    pub(crate) fn row(&self, name: &str) {
        let cell = |k: usize| match LEVELS[k] * self.all as f64 {
            few if few < 3.0 => "-".to_owned(),
            expected => format!("{:.2}", self.below[k] as f64 / expected),
        };
        println!("| {name} | {} |", (0..LEVELS.len()).map(cell).collect::<Vec<_>>().join(" | "));
    }
}
