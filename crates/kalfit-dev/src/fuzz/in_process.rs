//! Damaged input to the libraries, in this process: thousands in a second where a process for each is a hundred. A panic is
//! caught and counted, a hang and a memory that grows are seen by a watch. The same seed makes the same input.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::corpus::FuzzCorpus;
use super::targets::{FuzzInput, FuzzTargets};

/// No input may take longer.
const LONGEST: Duration = Duration::from_secs(120);
/// Memory of the process, in bytes: all threads and what they were given.
const MEMORY: u64 = 1 << 30;
/// Time between two looks at the clock.
const TICK: Duration = Duration::from_millis(200);
/// Inputs that a thread takes at a time.
const ROUND: u64 = 64;
/// Wrong inputs after which the campaign ends.
const MOST_WRONG: usize = 20;

thread_local! {
    /// The last words of a panic of this thread.
    static LAST_WORDS: RefCell<String> = const { RefCell::new(String::new()) };
}

/// What is asked of a campaign.
#[derive(Debug, Clone, Copy)]
pub(super) struct InProcessBounds {
    pub(super) seed: u64,
    pub(super) inputs: u64,
    pub(super) time: Duration,
}

/// An input that was not dealt with as it must be.
struct WrongInput {
    seed: u64,
    why: String,
    input: FuzzInput,
}

#[derive(Default)]
struct InputTally {
    /// Inputs by kind and by whether they were read.
    by: BTreeMap<(&'static str, bool), u64>,
    slowest: Duration,
    wrong: Vec<WrongInput>,
}

/// What threads share.
struct InProcessCampaign {
    targets: FuzzTargets,
    next: AtomicU64,
    end: u64,
    over: AtomicBool,
    tally: Mutex<InputTally>,
    /// Of each thread: the seed that it works on, and since when.
    at_work: Vec<Mutex<Option<(u64, Instant)>>>,
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Runs a campaign, and prints what came of it.
pub(super) fn campaign(corpus: &FuzzCorpus, kept: &Path, asked: InProcessBounds) -> Result<(), String> {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let shared = Arc::new(InProcessCampaign {
        targets: FuzzTargets::new(corpus)?,
        next: AtomicU64::new(asked.seed),
        end: asked.seed.saturating_add(asked.inputs),
        over: AtomicBool::new(false),
        tally: Mutex::default(),
        at_work: (0..threads).map(|_| Mutex::new(None)).collect(),
    });
    let before = std::panic::take_hook();
    std::panic::set_hook(Box::new(|panic| LAST_WORDS.with(|words| *words.borrow_mut() = panic.to_string())));
    let begun = Instant::now();
    let handles: Vec<JoinHandle<()>> = (0..threads)
        .map(|thread| {
            let (shared, folder) = (shared.clone(), kept.join(format!("thread-{thread}")));
            std::thread::spawn(move || shared.work(thread, &folder))
        })
        .collect();
    let (peak, stuck) = shared.watch(&handles, asked.time, kept);
    if stuck.is_none() {
        handles.into_iter().for_each(|handle| drop(handle.join()));
    }
    std::panic::set_hook(before);
    (0..threads).for_each(|thread| drop(std::fs::remove_dir_all(kept.join(format!("thread-{thread}")))));
    let tally = locked(&shared.tally);
    tally.report(begun.elapsed(), peak, kept)?;
    stuck.map_or(Ok(()), Err)
}

impl InProcessCampaign {
    /// Takes one input after another, with one thread of its own for what the libraries do side by side.
    fn work(&self, thread: usize, folder: &Path) {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build();
        let (Ok(pool), Ok(())) = (pool, std::fs::create_dir_all(folder)) else { return };
        while !self.over.load(Ordering::Relaxed) {
            let first = self.next.fetch_add(ROUND, Ordering::Relaxed);
            if first >= self.end {
                return;
            }
            let mut own = InputTally::default();
            for seed in first..first.saturating_add(ROUND).min(self.end) {
                let begun = Instant::now();
                *locked(&self.at_work[thread]) = Some((seed, begun));
                pool.install(|| self.one(seed, folder, &mut own));
                own.slowest = own.slowest.max(begun.elapsed());
            }
            *locked(&self.at_work[thread]) = None;
            locked(&self.tally).add(own);
        }
    }

    fn one(&self, seed: u64, folder: &Path, tally: &mut InputTally) {
        let input = self.targets.input(seed);
        let ended = catch_unwind(AssertUnwindSafe(|| self.targets.run(&input, folder)));
        let read = match ended {
            Ok(Ok(read)) => read,
            Ok(Err(why)) => return tally.wrong.push(WrongInput { seed, why, input }),
            Err(_) => {
                let why = format!("it panicked: {}", LAST_WORDS.with(|words| words.borrow().clone()));
                return tally.wrong.push(WrongInput { seed, why, input });
            }
        };
        *tally.by.entry((input.kind, read)).or_default() += 1;
    }

    /// Looks at the clock and at the memory until all is done: the most memory, and what keeps threads from their end, if anything does.
    fn watch(&self, handles: &[JoinHandle<()>], time: Duration, kept: &Path) -> (u64, Option<String>) {
        let (begun, mut peak) = (Instant::now(), 0);
        loop {
            let done = handles.iter().all(JoinHandle::is_finished);
            let memory = memory();
            peak = peak.max(memory);
            let at_work: Vec<(u64, Instant)> = self.at_work.iter().filter_map(|at| *locked(at)).collect();
            if memory > MEMORY {
                let inputs: Vec<String> = at_work.iter().map(|(seed, _)| self.keep(*seed, kept)).collect();
                return (peak, Some(format!("{} MB of memory at work on {}", memory >> 20, inputs.join(" and "))));
            }
            if let Some((seed, since)) = at_work.iter().find(|(_, since)| since.elapsed() > LONGEST) {
                let told = format!("{} has not ended in {} s", self.keep(*seed, kept), since.elapsed().as_secs());
                return (peak, Some(told));
            }
            if done {
                return (peak, None);
            }
            if begun.elapsed() > time || locked(&self.tally).wrong.len() >= MOST_WRONG {
                self.over.store(true, Ordering::Relaxed);
            }
            std::thread::sleep(TICK);
        }
    }
}

impl InProcessCampaign {
    /// Writes the input of a seed to a file, and says where.
    fn keep(&self, seed: u64, kept: &Path) -> String {
        let input = self.targets.input(seed);
        let place = kept.join(format!("{seed}-{}", input.name));
        let written = std::fs::write(&place, &input.bytes).map(|()| place.display().to_string());
        format!("seed {seed} ({}, {})", input.kind, written.unwrap_or_else(|error| error.to_string()))
    }
}

/// Bytes of memory that this process has; zero where the system does not tell.
fn memory() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let resident = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let kilobytes = resident.and_then(|rest| rest.split_whitespace().next()?.parse::<u64>().ok());
    kilobytes.unwrap_or(0) << 10
}

impl InputTally {
    fn add(&mut self, other: InputTally) {
        other.by.into_iter().for_each(|(kind, count)| *self.by.entry(kind).or_default() += count);
        self.slowest = self.slowest.max(other.slowest);
        self.wrong.extend(other.wrong);
    }

    fn report(&self, time: Duration, peak: u64, kept: &Path) -> Result<(), String> {
        let inputs = self.by.values().sum::<u64>() + self.wrong.len() as u64;
        println!(
            "{inputs} inputs in {:.0} s, {:.0} a second; the slowest in {:.1} s; {} MB of memory at most",
            time.as_secs_f64(),
            inputs as f64 / time.as_secs_f64(),
            self.slowest.as_secs_f64(),
            peak >> 20
        );
        let kinds: BTreeSet<&str> = self.by.keys().map(|(kind, _)| *kind).collect();
        for kind in kinds {
            let of = |read: bool| self.by.get(&(kind, read)).copied().unwrap_or(0);
            println!("  {kind:<12} {:>10} read {:>10} refused", of(true), of(false));
        }
        for WrongInput { seed, why, input } in &self.wrong {
            println!("\nseed {seed}: {}", why.replace('\n', "\n  "));
            let place: PathBuf = kept.join(format!("{seed}-{}", input.name));
            std::fs::write(&place, &input.bytes).map_err(|error| format!("{}: {error}", place.display()))?;
            println!("  {}: {}", input.kind, place.display());
        }
        if self.wrong.is_empty() { Ok(()) } else { Err(format!("{} inputs ended as none may", self.wrong.len())) }
    }
}
