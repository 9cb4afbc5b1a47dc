//! How many tests one thread takes at a time.

/// So many shares for each thread, but neither more tests than these, nor, while their rows are few, fewer.
const SHARES: usize = 4;
const MOST: usize = 512;
const FEWEST: usize = 32;
const FEW_ROWS: usize = 8192;
/// Nor, where tests are long, more rows than these.
const MOST_ROWS: usize = 1 << 20;

/// Of so many tests, with so many rows in all.
pub(crate) fn share(tests: usize, rows: usize) -> usize {
    let fewest = (FEW_ROWS * tests / rows.max(1)).clamp(1, FEWEST);
    let most = (MOST_ROWS * tests / rows.max(1)).clamp(1, MOST);
    (tests / (SHARES * rayon::current_num_threads())).clamp(fewest.min(most), most)
}
