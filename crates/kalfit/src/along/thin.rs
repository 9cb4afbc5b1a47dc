//! Selects some of very many values for a chart.

use statrs::distribution::{ContinuousCDF, Normal};

/// Number of largest values that are included in addition to the values at equal distances.
const MAX_LARGEST: usize = 20;

/// Indices of about `most` of n values at equal distances, including the first and the last.
pub(super) fn thinned(n: usize, most: usize) -> Vec<usize> {
    let stride = n.div_ceil(most.max(2)).max(1);
    let mut places: Vec<usize> = (0..n).step_by(stride).collect();
    if let Some(last) = n.checked_sub(1).filter(|last| places.last() != Some(last)) {
        places.push(last);
    }
    places
}

/// The indices of [`thinned`], and the indices of the values that are largest in magnitude.
pub(super) fn with_largest(values: &[f64], most: usize) -> Vec<usize> {
    let mut places = thinned(values.len(), most);
    if places.len() < values.len() {
        let mut order: Vec<usize> = (0..values.len()).collect();
        let far = MAX_LARGEST.min(values.len());
        let larger = |i: &usize, k: &usize| values[*k].abs().total_cmp(&values[*i].abs()).then(i.cmp(k));
        order.select_nth_unstable_by(far - 1, larger);
        places.extend(&order[..far]);
        places.sort_unstable();
        places.dedup();
    }
    places
}

/// Sorted values, each with the quantile Φ⁻¹((i - ½)/n) of the rank i of the value among n values. More than `most`
/// values are thinned at equal distances of the quantile, so that both tails are complete.
pub(super) fn quantiles(values: &[f64], most: usize) -> Vec<[f64; 2]> {
    let mut sorted: Vec<f64> = values.iter().copied().filter(|x| x.is_finite()).collect();
    sorted.sort_unstable_by(f64::total_cmp);
    let (normal, n) = (Normal::standard(), sorted.len());
    let quantile = |i: usize| normal.inverse_cdf((i as f64 + 0.5) / n as f64);
    let places: Vec<usize> = if n <= most {
        (0..n).collect()
    } else {
        let end = -quantile(0);
        let wanted = (0..most).map(|k| end * (2.0 * k as f64 / (most - 1) as f64 - 1.0));
        let place = |q: f64| ((normal.cdf(q) * n as f64 - 0.5).round().max(0.0) as usize).min(n - 1);
        let mut places: Vec<usize> = wanted.map(place).collect();
        places.dedup();
        places
    };
    places.into_iter().map(|i| [quantile(i), sorted[i]]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thinned_values_are_at_equal_distances_and_bounded() {
        assert!(thinned(0, 10).is_empty());
        assert_eq!(thinned(1, 10), [0]);
        assert_eq!(thinned(5, 10), [0, 1, 2, 3, 4]);
        assert_eq!(thinned(25, 10), [0, 3, 6, 9, 12, 15, 18, 21, 24]);
        assert_eq!(thinned(26, 10), [0, 3, 6, 9, 12, 15, 18, 21, 24, 25]);
        for n in [11, 99, 1000, 123_457] {
            let places = thinned(n, 100);
            assert!(
                places.len() <= 101 && places[0] == 0 && places[places.len() - 1] == n - 1,
                "{n}: {}",
                places.len()
            );
        }
    }

    #[test]
    fn the_largest_are_kept() {
        let mut values = vec![0.0; 1000];
        (values[123], values[777]) = (-9.0, 8.0);
        let places = with_largest(&values, 10);
        assert!(places.contains(&123) && places.contains(&777), "{places:?}");
        assert!(places.is_sorted() && places.len() <= 31, "{places:?}");
        assert_eq!(with_largest(&values[..5], 10), [0, 1, 2, 3, 4]);
        assert!(with_largest(&[], 10).is_empty());
    }

    #[test]
    fn quantiles_are_in_order_and_have_both_ends() {
        let values: Vec<f64> = (0..5000).map(|k| f64::from((k * 7919) % 5003) - 2500.0).collect();
        let found = quantiles(&values, 200);
        assert!(found.len() <= 200 && found.len() > 150, "{}", found.len());
        assert!(found.is_sorted_by(|a, b| a[0] < b[0] && a[1] <= b[1]));
        let (least, most) = values.iter().fold((f64::MAX, f64::MIN), |(a, b), &x| (a.min(x), b.max(x)));
        assert_eq!((found[0][1], found[found.len() - 1][1]), (least, most));
        // R: qnorm(ppoints(3, a = 0.5))
        let three = quantiles(&[5.0, 1.0, f64::NAN, 3.0], 200);
        assert_eq!(three.iter().map(|pair| pair[1]).collect::<Vec<_>>(), [1.0, 3.0, 5.0]);
        assert!((three[0][0] + 0.967_421_566_101_701).abs() < 1e-9 && three[1][0].abs() < 1e-12, "{three:?}");
        assert!(quantiles(&[], 200).is_empty());
    }
}
