//! The number of tests that a thread takes at a time.

/// Number of chunks per thread.
const SHARES: usize = 4;
/// Most tests in a chunk.
const MOST: usize = 512;
/// Fewest tests in a chunk, unless fewer tests have `FEW_ROWS` rows.
const FEWEST: usize = 32;
const FEW_ROWS: usize = 8192;
/// Most rows in a chunk of several tests.
const MOST_ROWS: usize = 1 << 20;

/// Number of tests per chunk, for `tests` tests with `rows` rows in all.
pub(crate) fn chunk_size(tests: usize, rows: usize) -> usize {
    let fewest = (FEW_ROWS * tests / rows.max(1)).clamp(1, FEWEST);
    let most = (MOST_ROWS * tests / rows.max(1)).clamp(1, MOST);
    (tests / (SHARES * rayon::current_num_threads())).clamp(fewest.min(most), most)
}
