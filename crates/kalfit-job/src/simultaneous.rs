//! Tests that were made at the same time.

use kalfit::PhasedTest;

/// A note where tests overlap in time though the clock does not begin anew with each test: what stood on one platform
/// shares its motion, and is one test. `spans`: first and last time of each test on the clock of the data.
pub(crate) fn note(tests: &[PhasedTest], spans: &[[f64; 2]]) -> Option<String> {
    let mut order: Vec<usize> =
        (0..tests.len().min(spans.len())).filter(|&test| spans[test][1] > spans[test][0]).collect();
    let latest_start = order.iter().map(|&test| spans[test][0]).fold(f64::NEG_INFINITY, f64::max);
    let earliest_end = order.iter().map(|&test| spans[test][1]).fold(f64::INFINITY, f64::min);
    if latest_start <= earliest_end {
        return None; // times since the start of each test, which say nothing of other tests
    }
    order.sort_by(|&a, &b| spans[a][0].total_cmp(&spans[b][0]).then_with(|| tests[a].id.cmp(&tests[b].id)));
    let mut shares = vec![false; tests.len()];
    let mut pair = None;
    // the test that ends last of those before
    let mut open = *order.first()?;
    for &test in &order[1..] {
        if spans[test][0] < spans[open][1] {
            (shares[open], shares[test]) = (true, true);
            pair = pair.or(Some((open, test)));
        }
        if spans[test][1] > spans[open][1] {
            open = test;
        }
    }
    let (a, b) = pair?;
    let count = shares.iter().filter(|shares| **shares).count();
    let (first, second) = (&tests[a].id, &tests[b].id);
    let others = match count {
        2 => String::new(),
        _ => format!(", and {count} tests in all share their time with another"),
    };
    Some(format!(
        "tests `{first}` and `{second}` were made at the same time{others}: if they stood on one platform, they share its \
         motion and are not independent; make them one test with a slot for each instrument (`as` of `[crossed.NAME]`)"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn said(spans: &[[f64; 2]]) -> Option<String> {
        let tests: Vec<PhasedTest> =
            (0..spans.len()).map(|test| kalfit::Test::new(format!("t{test}"), 0, 0).into()).collect();
        note(&tests, spans)
    }

    #[test]
    fn tests_on_one_clock_that_overlap_are_named() {
        let found = said(&[[0.0, 10.0], [0.0, 10.0], [20.0, 30.0], [25.0, 40.0], [50.0, 60.0]]).expect("a note");
        assert!(found.starts_with("tests `t0` and `t1` were made at the same time, and 4 tests in all"), "{found}");
        // one after the other
        assert_eq!(said(&[[0.0, 10.0], [10.0, 20.0], [20.0, 30.0]]), None);
        // each on a clock of its own
        assert_eq!(said(&[[0.0, 10.0], [0.0, 12.0], [0.5, 9.0]]), None);
        assert_eq!(said(&[[0.0, 0.0], [5.0, 5.0], [f64::NAN; 2]]), None);
    }
}
