//! A wall between us and libraries that panic on broken files.

use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind};

use crate::error::DataError;

thread_local! {
    static GUARDED: Cell<bool> = const { Cell::new(false) };
}

/// Sets a panic hook that says nothing of panics that become an error, since the error does, and leaves all others to the hook before.
pub fn keep_quiet_of_broken_files() {
    let tell = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        if !GUARDED.get() {
            tell(panic);
        }
    }));
}

/// Runs what reads untrusted bytes; a panic becomes an error. Whatever it touched must not be used again after one.
pub(crate) fn guarded<T>(
    file: &str,
    format: &'static str,
    read: impl FnOnce() -> Result<T, DataError>,
) -> Result<T, DataError> {
    let before = GUARDED.replace(true);
    let done = catch_unwind(AssertUnwindSafe(read));
    GUARDED.set(before);
    done.unwrap_or_else(|_| Err(DataError::Crashed { file: file.to_owned(), format }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_becomes_an_error_and_the_wall_goes() {
        let broken = || -> Result<(), DataError> {
            assert!(GUARDED.get());
            guarded("inner", "Arrow", || Ok(()))?;
            assert!(GUARDED.get(), "the outer wall stands when the inner one goes");
            panic!("a library's")
        };
        let error = guarded("a file", "Parquet", broken).expect_err("it panicked").to_string();
        assert_eq!(error, "a file is not a sound Parquet file: its contents contradict each other");
        assert!(!GUARDED.get());
    }
}
