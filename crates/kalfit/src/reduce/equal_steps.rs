//! Whether equal steps are so many that a test has a pass of its own over them.

/// So many equal steps are not worth a scan.
pub(crate) const FEW: usize = 64;

/// Steps after which it is looked for the first time, then after twice as many, and so on.
const FIRST_LOOK: usize = 1024;

/// Counts steps, and those in stretches of more than [`FEW`] equal ones.
#[derive(Debug, Default)]
pub(crate) struct EqualStepCount {
    steps: usize,
    /// Steps on end that are equal, up to the last one.
    stretch: usize,
    long: usize,
}

impl EqualStepCount {
    /// Takes the next step, which equals the one before or not. True where it is known already that most are in long stretches.
    pub(crate) fn take(&mut self, equal: bool) -> bool {
        self.steps += 1;
        self.stretch = if equal { self.stretch + 1 } else { 1 };
        self.long += match self.stretch {
            stretch if stretch <= FEW => 0,
            stretch if stretch == FEW + 1 => stretch,
            _ => 1,
        };
        self.steps >= FIRST_LOOK && self.steps.is_power_of_two() && self.are_most_long()
    }

    /// Most steps are in long stretches.
    pub(crate) fn are_most_long(&self) -> bool {
        2 * self.long > self.steps
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn most_steps_are_in_long_stretches_or_not() {
        // stretches of so many equal steps; whether most are in long ones, and after how many steps that is known
        let cases: [(&[usize], bool, usize); 6] = [
            (&[64], false, 64),
            (&[65], true, 65),
            (&[65, 64, 2], false, 131),
            (&[65, 64], true, 129),
            (&[5000], true, 1024),
            (&[60, 60, 60, 60, 60, 60, 60, 60, 60, 60, 60, 60, 60, 60, 60, 60, 60, 1500], true, 2048),
        ];
        for (stretches, expected, known) in cases {
            let mut count = EqualStepCount::default();
            let mut steps = stretches.iter().flat_map(|&many| (0..many).map(|step| step > 0));
            let early = steps.by_ref().any(|equal| count.take(equal));
            assert_eq!((early || count.are_most_long(), count.steps), (expected, known), "{stretches:?}");
        }
    }
}
