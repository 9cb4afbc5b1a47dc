//! A callback that decides before each run of the filters whether it is made.

/// Called before each run of the filters with the number of earlier runs; returns whether this one is made.
#[derive(Clone, Copy)]
pub struct BeforeRuns<'a>(pub &'a (dyn Fn(usize) -> bool + Sync));

impl std::fmt::Debug for BeforeRuns<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("BeforeRuns").finish_non_exhaustive()
    }
}
