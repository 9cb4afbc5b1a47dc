//! The threads of the command: as many as are asked for, but not many more than there are processors.

use std::env;

use kalfit_job::Failure;

/// Threads for each processor beyond which more of them only wait for each other.
const MOST_PER_PROCESSOR: usize = 4;
/// What rayon's own variable may ask for, as `--threads`.
const MOST_ASKED: usize = 1024;

/// Starts the threads; `asked` by `--threads`, else by `RAYON_NUM_THREADS`, else one for each processor.
///
/// # Errors
/// A variable that says no number from 1 to 1024, or threads that the system refuses.
pub(crate) fn start(asked: Option<usize>) -> Result<(), Failure> {
    let processors = std::thread::available_parallelism().map_or(1, usize::from);
    let asked = match asked {
        Some(asked) => Some(asked),
        None => of_variable(env::var("RAYON_NUM_THREADS").ok().as_deref())?,
    };
    let threads = number(asked, processors);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build_global();
    pool.map_err(|error| Failure::Threads { threads, reason: error.to_string() })
}

/// Number of threads: what is asked for makes no difference to results, only to time.
fn number(asked: Option<usize>, processors: usize) -> usize {
    asked.unwrap_or(processors).min(MOST_PER_PROCESSOR * processors).max(1)
}

/// What the variable asks for; empty and 0 ask for nothing.
fn of_variable(text: Option<&str>) -> Result<Option<usize>, Failure> {
    let Some(text) = text.map(str::trim).filter(|text| !matches!(*text, "" | "0")) else { return Ok(None) };
    match text.parse::<usize>() {
        Ok(asked) if asked <= MOST_ASKED => Ok(Some(asked)),
        _ => Err(Failure::ThreadsVariable { found: text.to_owned(), most: MOST_ASKED }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn threads_are_bounded_by_the_processors() {
        for (asked, processors, expected) in
            [(None, 2, 2), (Some(1), 2, 1), (Some(8), 2, 8), (Some(1000), 2, 8), (Some(1000), 512, 1000)]
        {
            assert_eq!(number(asked, processors), expected, "{asked:?} on {processors}");
        }
    }

    #[test]
    fn a_variable_asks_as_the_option_does() {
        for (text, expected) in [(None, None), (Some(""), None), (Some("0"), None), (Some(" 3 "), Some(3))] {
            assert_eq!(of_variable(text).expect("a number"), expected, "{text:?}");
        }
        for text in ["1025", "-1", "many", "99999999999999999999"] {
            let error = of_variable(Some(text)).expect_err("no such number").to_string();
            assert!(error.contains(text), "{error}");
        }
    }
}
