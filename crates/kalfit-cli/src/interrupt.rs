//! Ctrl-C, and the signals by which a process is asked to end. A search is asked to end with what it has, and everything else ends
//! at once; so does a search that is asked again.

use std::io::IsTerminal;
#[cfg(unix)]
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::terminal;

/// Exit status of whatever was interrupted: 128 and the number of the signal, as shells have it.
pub(crate) const STATUS: u8 = 130;

/// Exit status of what could not be done, as of bad input.
#[cfg(unix)]
const UNDONE: i32 = 2;

/// Whether a signal ends the process at once: until the command listens itself.
#[cfg(unix)]
static EARLY: std::sync::LazyLock<Arc<AtomicBool>> = std::sync::LazyLock::new(|| Arc::new(AtomicBool::new(true)));

/// Somebody asked for the end.
static ASKED: AtomicBool = AtomicBool::new(false);

/// True once somebody asked for the end.
pub(crate) fn asked() -> bool {
    ASKED.load(Ordering::Relaxed)
}

/// Ends the process with the status of an interrupted one on a signal that comes before the command listens.
#[cfg(unix)]
pub(crate) fn end_early() {
    for signal in heard() {
        let _ = signal_hook::flag::register_conditional_shutdown(signal, i32::from(STATUS), Arc::clone(&EARLY));
    }
}

#[cfg(not(unix))]
pub(crate) fn end_early() {}

/// Listens for Ctrl-C, and for SIGTERM and SIGHUP where there are such. `searches` says that the command can end with the best so
/// far, `quiet` that nobody wants to hear of it. A signal that is ignored, as by `nohup`, or in jobs that a script runs in the
/// background, stays so.
pub(crate) fn listen(searches: bool, quiet: bool) {
    survive_large_files();
    let shows = !quiet && std::io::stderr().is_terminal();
    hear(move |again_ends| {
        let first = !ASKED.swap(true, Ordering::Relaxed);
        if searches && !first && !again_ends {
            return;
        }
        if first && searches {
            if shows {
                terminal::complain("\nStopping with the best so far; Ctrl-C again ends at once\n");
            }
            return;
        }
        if kalfit_job::abandon() {
            end();
        }
    });
}

/// Calls `asked` for every signal, in a thread of its own; with false for one that tells nothing new when it comes again. Where that
/// cannot be, signals do what they do to any program.
#[cfg(unix)]
fn hear(asked: impl Fn(bool) + Send + 'static) {
    use signal_hook::consts::SIGHUP;
    let Ok(mut signals) = signal_hook::iterator::Signals::new(heard()) else { return };
    EARLY.store(false, Ordering::SeqCst);
    // a terminal that goes may say so twice, itself and by its shell
    let listens = move || signals.forever().for_each(|signal| asked(signal != SIGHUP));
    let _ = std::thread::Builder::new().name("signals".to_owned()).spawn(listens);
}

/// The signals that ask for the end, without those that are ignored.
#[cfg(unix)]
fn heard() -> Vec<i32> {
    use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
    /// Signals that this program was started with as ignored: what it registers itself changes what the system tells.
    static IGNORED: std::sync::OnceLock<Option<u64>> = std::sync::OnceLock::new();
    let ignored = *IGNORED.get_or_init(ignored);
    let is_heard = |signal: &i32| match ignored {
        Some(ignored) => (ignored >> (signal - 1)) & 1 == 0,
        None => *signal != SIGHUP, // `nohup` may have been there
    };
    [SIGINT, SIGTERM, SIGHUP].into_iter().filter(is_heard).collect()
}

/// A file that grows beyond the limit of the process is an error of the one who writes it, as on a full disk. By default a signal would
/// end the process without a word, and its temporary files would stay.
#[cfg(unix)]
fn survive_large_files() {
    let _ = signal_hook::flag::register(signal_hook::consts::SIGXFSZ, Arc::new(AtomicBool::new(false)));
}

#[cfg(not(unix))]
fn survive_large_files() {}

/// Memory that is refused in the middle of work ends the process, as the standard library has it, but with the exit status of whatever
/// could not be done, and without a core file. What it says of it stands on standard error by then, and files are written at the end.
#[cfg(unix)]
pub(crate) fn end_in_order_without_memory() {
    let always = Arc::new(AtomicBool::new(true));
    let _ = signal_hook::flag::register_conditional_shutdown(signal_hook::consts::SIGABRT, UNDONE, always);
}

#[cfg(not(unix))]
pub(crate) fn end_in_order_without_memory() {}

/// The signals that are ignored, a bit for each, where the system tells.
#[cfg(unix)]
fn ignored() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"))?;
    u64::from_str_radix(mask.trim(), 16).ok()
}

#[cfg(not(unix))]
fn hear(asked: impl Fn(bool) + Send + 'static) {
    let _ = ctrlc::try_set_handler(move || asked(true));
}

/// Ends the process while others of its threads work.
#[expect(clippy::exit, reason = "nobody waits for the work any longer, and it cannot be told to stop sooner")]
fn end() -> ! {
    std::process::exit(i32::from(STATUS))
}
