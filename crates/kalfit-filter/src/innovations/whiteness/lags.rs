//! Number of lags in the test of whiteness.

/// Largest number of lags of one measurement.
pub(super) const MAX_LAGS: usize = 10;
/// Number of innovations needed for each lag.
pub(super) const INNOVATIONS_PER_LAG: usize = 5;

/// Number of lags for n innovations.
pub(super) fn lag_count(n: usize) -> usize {
    (n / INNOVATIONS_PER_LAG).min(MAX_LAGS)
}
