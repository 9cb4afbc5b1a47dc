//! The number of threads: as many as are asked for, but not many more than there are processors.

use crate::failure::Failure;

/// Threads for each processor beyond which more of them only wait for each other: a fit of 18 tests on two processors
/// takes 0.02 s with eight threads, and 2.2 s with a thousand.
const MOST_PER_PROCESSOR: usize = 4;
/// Largest number of threads that `RAYON_NUM_THREADS` may name, as `--threads`.
const MOST_ASKED: usize = 1024;

/// Number of threads that are used where `asked` are asked for, one for each processor without; it makes no difference
/// to results, only to time.
pub fn used(asked: Option<usize>) -> usize {
    number(asked, std::thread::available_parallelism().map_or(1, usize::from))
}

fn number(asked: Option<usize>, processors: usize) -> usize {
    asked.unwrap_or(processors).min(MOST_PER_PROCESSOR * processors).max(1)
}

/// Number of threads that the text of `RAYON_NUM_THREADS` asks for; `None` where it is empty or 0.
///
/// # Errors
/// A text that is no number from 0 to 1024.
pub fn of_variable(text: Option<&str>) -> Result<Option<usize>, Failure> {
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
