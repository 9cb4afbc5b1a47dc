//! Whether the filters are to run once more.

/// Hears how many runs there were, before the next one, and says whether there is to be one.
#[derive(Clone, Copy)]
pub struct BeforeRuns<'a>(pub &'a (dyn Fn(usize) -> bool + Sync));

impl std::fmt::Debug for BeforeRuns<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("BeforeRuns").finish_non_exhaustive()
    }
}
