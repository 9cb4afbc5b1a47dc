//! Whether equal steps are so many that a test has a pass of its own over them.

/// So many equal steps are not worth a scan.
pub(crate) const FEW: usize = 64;

/// Counts those of so many steps that are in stretches of more than [`FEW`] equal ones.
#[derive(Debug)]
pub(crate) struct EqualStepCount {
    steps: usize,
    /// Steps on end that are equal, up to the last one.
    stretch: usize,
    long: usize,
}

impl EqualStepCount {
    /// Of a test with so many steps.
    pub(crate) fn new(steps: usize) -> EqualStepCount {
        EqualStepCount { steps, stretch: 0, long: 0 }
    }

    /// Takes the next step, which equals the one before or not. True as soon as most steps of the test are in long stretches.
    pub(crate) fn take(&mut self, equal: bool) -> bool {
        self.stretch = if equal { self.stretch + 1 } else { 1 };
        self.long += match self.stretch {
            stretch if stretch <= FEW => 0,
            stretch if stretch == FEW + 1 => stretch,
            _ => 1,
        };
        is_most(self.long, self.steps)
    }
}

/// So many of so many steps are most of them.
pub(crate) fn is_most(long: usize, steps: usize) -> bool {
    2 * long > steps
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn most_steps_are_in_long_stretches_or_not() {
        // stretches of so many equal steps, and after how many steps it is known that most are in long ones
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
