//! Decides whether so many steps of a test are equal that the test is reduced alone, with scans.

/// Number of equal steps up to which a stretch is not worth a scan.
pub(crate) const MAX_UNSCANNED_STEPS: usize = 64;

/// Counts the steps of a test that are in stretches of more than [`MAX_UNSCANNED_STEPS`] equal steps.
#[derive(Debug)]
pub(crate) struct EqualStepCount {
    steps: usize,
    /// Length of the current stretch of equal steps.
    stretch: usize,
    long_steps: usize,
}

impl EqualStepCount {
    /// Count for a test with `steps` steps, of which none is taken yet.
    pub(crate) fn new(steps: usize) -> EqualStepCount {
        EqualStepCount { steps, stretch: 0, long_steps: 0 }
    }

    /// Takes the next step; `equal`: the step equals the step before. True as soon as most steps of the test are in
    /// long stretches.
    pub(crate) fn take(&mut self, equal: bool) -> bool {
        self.stretch = if equal { self.stretch + 1 } else { 1 };
        self.long_steps += match self.stretch {
            stretch if stretch <= MAX_UNSCANNED_STEPS => 0,
            stretch if stretch == MAX_UNSCANNED_STEPS + 1 => stretch,
            _ => 1,
        };
        is_majority(self.long_steps, self.steps)
    }
}

/// True if the steps in long stretches are more than half of all steps.
pub(crate) fn is_majority(long_steps: usize, steps: usize) -> bool {
    2 * long_steps > steps
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn most_steps_are_in_long_stretches_or_not() {
        // lengths of stretches of equal steps, and the step after which it is known that most are in long stretches
        let cases: [(&[usize], Option<usize>); 7] = [
            (&[], None),
            (&[64], None),
            (&[65], Some(65)),
            (&[64, 65, 2], None),
            (&[64, 65], Some(129)),
            (&[5000], Some(2501)),
            (&[60, 60, 60, 1500], Some(1021)),
        ];
        for (stretches, expected) in cases {
            let mut count = EqualStepCount::new(stretches.iter().sum());
            let mut steps = stretches.iter().flat_map(|&many| (0..many).map(|step| step > 0));
            let known = steps.position(|equal| count.take(equal)).map(|step| step + 1);
            assert_eq!(known, expected, "{stretches:?}");
        }
    }
}
