//! Correlation between tests at the steps, or times, that they share: a station, a supply or a room that disturbs some
//! tests at once.
//!
//! For tests j and k with n innovations at common steps, c_jk = Σ e_j e_k / √(Σ e_j² Σ e_k²). If the tests are
//! independent, c² ~ Beta(1/2, (n-1)/2), so that x = n c² has these cumulants, and two pairs are uncorrelated (Breusch and
//! Pagan 1980); three pairs of three tests are not, as their e are directions that are uniform on a sphere:
//!
//! ```text
//! E x = 1,   Var x = 2(n-1)/(n+2),   κ₃(x) = 8(n-1)(n-2)/((n+2)(n+4)),   κ(x_jk, x_kl, x_lj) = 4(n-1)/(n+2)²
//! ```
//!
//! The sum over pairs is compared with a shifted gamma law of the same mean, variance and third cumulant.

use std::collections::BTreeMap;

use kalfit_filter::innovations::Innovation;
use nalgebra::DMatrix;
use statrs::distribution::{ContinuousCDF, Gamma};
use statrs::statistics::Distribution;

use crate::misfit::TermTest;
use crate::misfit::columns::UnitColumns;
use crate::misfit::steps::{ordered, position};
use crate::misfit::terms::TermKind;

/// Most products of innovations, a fraction of a second; where all pairs are more, those of near neighbours are taken.
const MAX_PRODUCTS: usize = 20_000_000;

/// Innovations of one measurement of a test: (step or time as [`ordered`], innovation).
type Series = Vec<(u64, f64)>;

/// Innovations of each test by step, for each phase and measurement.
#[derive(Default)]
pub(super) struct SharedSteps(BTreeMap<(usize, usize), Vec<Series>>);

impl SharedSteps {
    /// `columns`: the residuals are the first one.
    pub(super) fn add(&mut self, unit: &UnitColumns, columns: &DMatrix<f64>) {
        for (_, rows) in &unit.tests {
            let mut of_test: BTreeMap<(usize, usize), Series> = BTreeMap::new();
            for row in rows.clone() {
                let place: &Innovation = &unit.places[row];
                let of_measurement = of_test.entry((place.phase, place.measurement)).or_default();
                of_measurement.push((ordered(position(place)), columns[(row, 0)]));
            }
            for (owner, mut series) in of_test {
                series.sort_by_key(|(at, _)| *at);
                self.0.entry(owner).or_default().push(series);
            }
        }
    }

    /// One test for each measurement of which tests share steps.
    pub(super) fn tests(&self) -> Vec<TermTest> {
        self.0.iter().filter_map(|(owner, series)| test(*owner, series)).collect()
    }
}

/// Sums over pairs of tests.
#[derive(Debug, Default, Clone, Copy)]
struct PairSums {
    pairs: usize,
    /// n c², its variance and its third cumulant under independence, and n.
    statistic: f64,
    variance: f64,
    third: f64,
    common: f64,
    /// Largest n.
    most_common: usize,
}

fn test((phase, measurement): (usize, usize), series: &[Series]) -> Option<TermTest> {
    let rows: usize = series.iter().map(Vec::len).sum();
    // neighbours at growing distances, so that every test takes part however few pairs there is time for
    let distances = (MAX_PRODUCTS / rows.max(1)).clamp(1, series.len());
    let mut sums = PairSums::default();
    let (mut all, mut triangles) = (0, 0);
    for distance in 1..=distances {
        let neighbours = series.len().saturating_sub(distance);
        (all, triangles) = (all + neighbours, triangles + neighbours * (distance - 1));
        for (first, second) in series.iter().zip(series.iter().skip(distance)) {
            sums.add(first, second);
        }
    }
    let mean = sums.pairs as f64;
    // so many pairs cannot have more triangles
    let triangles = triangles as f64 * (mean / all.max(1) as f64).powf(1.5);
    let law = sums.law(triangles)?;
    Some(TermTest {
        phase,
        measurement,
        kind: TermKind::Shared,
        statistic: sums.statistic / mean,
        degrees_of_freedom: [sums.pairs, sums.most_common],
        p_value: law.sf(sums.statistic - (mean - law.mean()?)),
        largest: None,
    })
}

impl PairSums {
    fn add(&mut self, first: &[(u64, f64)], second: &[(u64, f64)]) {
        let (mut n, mut product, mut squares) = (0_usize, 0.0, [0.0_f64; 2]);
        let (mut a, mut b) = (first.iter().peekable(), second.iter().peekable());
        while let (Some((at, x)), Some((other, y))) = (a.peek(), b.peek()) {
            match at.cmp(other) {
                std::cmp::Ordering::Less => drop(a.next()),
                std::cmp::Ordering::Greater => drop(b.next()),
                std::cmp::Ordering::Equal => {
                    n += 1;
                    product += x * y;
                    squares = [squares[0] + x * x, squares[1] + y * y];
                    a.next();
                    b.next();
                }
            }
        }
        let squared = n as f64 * product * product / (squares[0] * squares[1]);
        // c² of a single step is always 1
        if n < 2 || !squared.is_finite() {
            return;
        }
        self.pairs += 1;
        self.statistic += squared;
        self.most_common = self.most_common.max(n);
        let n = n as f64;
        self.variance += 2.0 * (n - 1.0) / (n + 2.0);
        self.third += 8.0 * (n - 1.0) * (n - 2.0) / ((n + 2.0) * (n + 4.0));
        self.common += n;
    }

    /// The gamma law with the variance and the third cumulant of the sum; its mean is another.
    fn law(&self, triangles: f64) -> Option<Gamma> {
        let n = self.common / self.pairs as f64;
        // each product of three different pairs stands six times in the third cumulant
        let third = self.third + 6.0 * triangles * 4.0 * (n - 1.0) / (n + 2.0).powi(2);
        let scale = 0.5 * third / self.variance;
        Gamma::new(self.variance / (scale * scale), scale.recip()).ok()
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    use super::*;

    #[test]
    fn independent_tests_have_the_law_that_is_claimed() {
        let (tests, steps, draws) = (12, 6, 4000);
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let mut below = [0; 3];
        for _ in 0..draws {
            let one = |_| (0..steps).map(|k| (k, random.sample(StandardNormal))).collect();
            let series: Vec<Series> = (0..tests).map(one).collect();
            let found = test((0, 0), &series).expect("common steps");
            assert_eq!(found.degrees_of_freedom, [66, 6]);
            for (count, level) in below.iter_mut().zip([0.1, 0.01, 0.001]) {
                *count += usize::from(found.p_value < level);
            }
        }
        // within four sampling errors
        assert!((324..=476).contains(&below[0]), "{below:?}");
        assert!((15..=65).contains(&below[1]) && below[2] <= 12, "{below:?}");
    }

    #[test]
    fn tests_without_common_steps_are_not_compared() {
        let series: Vec<Series> = (0..4).map(|test| (0..5).map(|k| (10 * test + k, 1.0)).collect()).collect();
        assert!(test((0, 0), &series).is_none());
    }
}
