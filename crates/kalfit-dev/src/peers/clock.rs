//! Processor time: what a piece of work takes whatever else the machine does.

use std::process::{Command, Output};
use std::time::Instant;

/// Seconds that a piece of work took.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct TimeTaken {
    /// Of all processors, the system's work included.
    pub(crate) processor: f64,
    /// By the clock on the wall.
    pub(crate) elapsed: f64,
}

/// Whose processor time.
#[derive(Debug, Clone, Copy)]
enum ClockedProcesses {
    This,
    Children,
}

#[cfg(unix)]
fn processor(who: ClockedProcesses) -> Result<f64, String> {
    use nix::sys::resource::{UsageWho, getrusage};
    let who = match who {
        ClockedProcesses::This => UsageWho::RUSAGE_SELF,
        ClockedProcesses::Children => UsageWho::RUSAGE_CHILDREN,
    };
    let usage = getrusage(who).map_err(|error| format!("processor time: {error}"))?;
    let parts = [usage.user_time(), usage.system_time()];
    Ok(parts.iter().map(|part| part.tv_sec() as f64 + 1e-6 * part.tv_usec() as f64).sum())
}

#[cfg(not(unix))]
fn processor(_: ClockedProcesses) -> Result<f64, String> {
    Err("processor time is read by `getrusage`, which only Unix has".to_owned())
}

fn timed<T>(who: ClockedProcesses, work: impl FnOnce() -> T) -> Result<(T, TimeTaken), String> {
    let (before, started) = (processor(who)?, Instant::now());
    let result = work();
    let elapsed = started.elapsed().as_secs_f64();
    Ok((result, TimeTaken { processor: processor(who)? - before, elapsed }))
}

/// Runs a child process to its end. No other child may run meanwhile.
pub(super) fn child(command: &mut Command) -> Result<(std::io::Result<Output>, TimeTaken), String> {
    timed(ClockedProcesses::Children, || command.output())
}

/// Seconds of one run of `work` in this process: batches long enough for the clock, and the least of them.
pub(super) fn repeated(mut work: impl FnMut()) -> Result<TimeTaken, String> {
    const BATCHES: usize = 5;
    const BATCH: f64 = 0.3;
    work();
    let mut least = TimeTaken { processor: f64::INFINITY, elapsed: f64::INFINITY };
    for _ in 0..BATCHES {
        let (runs, taken) = timed(ClockedProcesses::This, || {
            let (started, mut runs) = (Instant::now(), 0.0);
            while started.elapsed().as_secs_f64() < BATCH {
                work();
                runs += 1.0;
            }
            runs
        })?;
        least.processor = least.processor.min(taken.processor / runs);
        least.elapsed = least.elapsed.min(taken.elapsed / runs);
    }
    Ok(least)
}

/// Several runs of `work`, fewer when they take long, and the one with the median processor time.
pub(super) fn median<T>(
    runs: usize,
    taken: impl Fn(&T) -> TimeTaken,
    mut work: impl FnMut() -> Result<T, String>,
) -> Result<T, String> {
    const ENOUGH: f64 = 20.0;
    let started = Instant::now();
    let mut all = vec![work()?];
    while all.len() < runs && started.elapsed().as_secs_f64() < ENOUGH {
        all.push(work()?);
    }
    all.sort_by(|a, b| taken(a).processor.total_cmp(&taken(b).processor));
    Ok(all.swap_remove(all.len() / 2))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_run_is_neither_the_first_nor_the_least() {
        let mut seconds = [5.0, 1.0, 3.0].into_iter();
        let run = || Ok(TimeTaken { processor: seconds.next().unwrap(), elapsed: 0.0 });
        assert_eq!(median(3, |taken| *taken, run).unwrap().processor, 3.0);
    }

    #[cfg(unix)]
    #[test]
    fn the_time_of_a_child_is_its_work_and_not_its_sleep() {
        let (_, sleeping) = child(Command::new("sleep").arg("0.3")).unwrap();
        assert!(sleeping.elapsed >= 0.3, "{sleeping:?}");
        assert!(sleeping.processor < 0.2, "{sleeping:?}");
    }
}
