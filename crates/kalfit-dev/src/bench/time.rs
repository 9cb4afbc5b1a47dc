//! Times as the best of several runs, since other work on the machine only ever adds.

use std::time::Instant;

/// Best of `runs` times of `work`, in seconds.
pub(super) fn best(runs: usize, mut work: impl FnMut()) -> f64 {
    let time = |work: &mut dyn FnMut()| {
        let started = Instant::now();
        work();
        started.elapsed().as_secs_f64()
    };
    (0..runs).map(|_| time(&mut work)).fold(f64::INFINITY, f64::min)
}
