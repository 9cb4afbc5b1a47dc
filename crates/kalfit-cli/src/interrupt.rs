//! Ctrl-C. A search is asked to end with what it has, and everything else ends at once; so does a search that is asked again.

use std::io::IsTerminal;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::terminal;

/// Exit status of whatever was interrupted: 128 and the number of the signal, as shells have it.
pub(crate) const STATUS: u8 = 130;

/// Somebody pressed Ctrl-C.
static ASKED: AtomicBool = AtomicBool::new(false);

/// True once somebody pressed Ctrl-C.
pub(crate) fn asked() -> bool {
    ASKED.load(Ordering::Relaxed)
}

/// Listens for Ctrl-C. `searches` says that the command can end with the best so far, `quiet` that nobody wants to hear of it.
/// Where the signal is ignored, as in jobs that a shell runs in the background, it stays so.
pub(crate) fn listen(searches: bool, quiet: bool) {
    let shows = !quiet && std::io::stderr().is_terminal();
    let pressed = move || {
        let first = !ASKED.swap(true, Ordering::Relaxed);
        if first && searches {
            if shows {
                terminal::complain("\nStopping with the best so far; Ctrl-C again ends at once\n");
            }
            return;
        }
        kalfit_job::abandon();
        end();
    };
    let _ = ctrlc::try_set_handler(pressed); // without it Ctrl-C does what it does to any program
}

/// Ends the process while others of its threads work.
#[expect(clippy::exit, reason = "nobody waits for the work any longer, and it cannot be told to stop sooner")]
fn end() -> ! {
    std::process::exit(i32::from(STATUS))
}
