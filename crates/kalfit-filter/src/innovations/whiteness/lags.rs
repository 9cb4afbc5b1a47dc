//! Number of lags in the test of whiteness.

/// Largest number of lags of one measurement.
pub(super) const MOST_LAGS: usize = 10;
/// Number of innovations needed for each lag.
pub(super) const PER_LAG: usize = 5;

/// Number of lags for n innovations.
pub(super) fn most_lags(n: usize) -> usize {
    (n / PER_LAG).min(MOST_LAGS)
}
