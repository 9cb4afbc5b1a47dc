//! How many tests one thread takes at a time.

/// Chunks for each thread.
const SHARES: usize = 4;
/// Most tests of a chunk.
const MOST: usize = 512;
/// Fewest tests of a chunk, unless they have more rows than that.
const FEWEST: usize = 32;
const FEW_ROWS: usize = 8192;
/// Most rows of a chunk of several tests.
const MOST_ROWS: usize = 1 << 20;

/// Of so many tests, with so many rows in all.
pub(crate) fn chunk_size(tests: usize, rows: usize) -> usize {
    let fewest = (FEW_ROWS * tests / rows.max(1)).clamp(1, FEWEST);
    let most = (MOST_ROWS * tests / rows.max(1)).clamp(1, MOST);
    (tests / (SHARES * rayon::current_num_threads())).clamp(fewest.min(most), most)
}
