//! The threads of the command.

use std::env;

use kalfit_job::{Failure, threads_of_variable, used_threads};

/// Starts the threads; `asked` by `--threads`, else by `RAYON_NUM_THREADS`, else one for each processor.
///
/// # Errors
/// A variable that names no number from 0 to 1024, or threads that the system refuses.
pub(crate) fn start(asked: Option<usize>) -> Result<(), Failure> {
    let asked = match asked {
        Some(asked) => Some(asked),
        None => threads_of_variable(env::var("RAYON_NUM_THREADS").ok().as_deref())?,
    };
    let threads = used_threads(asked);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build_global();
    pool.map_err(|error| Failure::Threads { threads, reason: error.to_string() })
}
