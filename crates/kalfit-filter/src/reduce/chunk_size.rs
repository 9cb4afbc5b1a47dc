//! The number of tests that a thread takes at a time.

/// Number of chunks per thread.
const CHUNKS_PER_THREAD: usize = 4;
/// Largest number of tests in a chunk.
const MAX_TESTS: usize = 512;
/// Least number of tests in a chunk, unless fewer tests have `SUFFICIENT_ROWS` rows.
const MIN_TESTS: usize = 32;
const SUFFICIENT_ROWS: usize = 8192;
/// Largest number of rows in a chunk of several tests.
const MAX_ROWS: usize = 1 << 20;

/// Number of rows of a test that are passed several times in a row: so few that they are read from memory once.
pub(crate) const CACHED_ROWS: usize = 1 << 10;

/// Number of tests per chunk, for `tests` tests with `rows` rows in all.
pub(crate) fn chunk_size(tests: usize, rows: usize) -> usize {
    let fewest = (SUFFICIENT_ROWS * tests / rows.max(1)).clamp(1, MIN_TESTS);
    let most = (MAX_ROWS * tests / rows.max(1)).clamp(1, MAX_TESTS);
    (tests / (CHUNKS_PER_THREAD * rayon::current_num_threads())).clamp(fewest.min(most), most)
}
