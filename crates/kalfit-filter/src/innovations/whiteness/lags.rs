//! How many lags are looked at.

/// No more lags than this.
pub(super) const MOST_LAGS: usize = 10;
/// One lag for each so many innovations.
pub(super) const PER_LAG: usize = 5;

/// Lags of n innovations.
pub(super) fn most_lags(n: usize) -> usize {
    (n / PER_LAG).min(MOST_LAGS)
}
