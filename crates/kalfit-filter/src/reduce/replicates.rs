//! Replicates among tests: tests that differ only in measured values and covariates.

use rayon::prelude::*;

use crate::reduce::cell_mask::CellMask;
use kalfit_model::Test;

/// Number of adjacent tests that are compared as one task.
const TESTS_PER_TASK: usize = 256;

/// Fewest successive tests whose sets are reduced together, so few that the cells of the tests stay in the caches.
const LEAST_LIST_TESTS: usize = 1 << 11;
/// Fewest successive tests of a list, per set of replicates: each list evaluates one test of every set anew.
const LEAST_TESTS_PER_SET: usize = 64;

/// Some tests of an ensemble, by index, each in a set of replicates or alone. The sets depend only on the cells of the
/// tests.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Replicates {
    /// Sets of two or more test indices, each set ascending; the sets are in the order of first tests.
    pub(crate) sets: Vec<Vec<usize>>,
    /// Indices of the tests that are in no set, ascending.
    pub(crate) alone: Vec<usize>,
}

impl Replicates {
    /// `tests` tests, none of which is in a set.
    pub(crate) fn none(tests: usize) -> Replicates {
        Replicates { sets: Vec::new(), alone: (0..tests).collect() }
    }

    /// The replicates among all tests. `mask`: the cells that must agree; `None` where no two tests count as
    /// replicates.
    pub(crate) fn of(mask: Option<&CellMask>, tests: &[&Test]) -> Replicates {
        let Some(mask) = mask else { return Replicates::none(tests.len()) };
        let mut firsts = neighbours(mask, tests);
        let mut left: Vec<usize> = (0..tests.len()).filter(|&number| firsts[number] == number).collect();
        // tests with per-test designs mostly differ in the first rows
        let mut whole = false;
        while left.len() > 1 {
            let mut hashes: Vec<(u64, usize)> =
                left.par_iter().map(|&number| (mask.hash(tests[number], whole), number)).collect();
            hashes.par_sort_unstable();
            for run in hashes.chunk_by(|a, b| a.0 == b.0) {
                run.iter().for_each(|&(_, number)| firsts[number] = run[0].1);
            }
            let differs = |&number: &usize| {
                let first = firsts[number];
                (first != number && !mask.agrees_on(tests[number], tests[first])).then_some(number)
            };
            left = left.par_iter().filter_map(differs).collect();
            left.iter().for_each(|&number| firsts[number] = number);
            whole = true;
        }
        // a test that equals the test before joins the set of that test
        (0..tests.len()).for_each(|number| firsts[number] = firsts[firsts[number]]);
        Replicates::from_firsts(&firsts)
    }

    /// The sets of tests with equal entries in `firsts`: the index of the first test that each test equals, possibly
    /// the test itself.
    pub(crate) fn from_firsts(firsts: &[usize]) -> Replicates {
        let (mut sizes, mut places) = (vec![0; firsts.len()], vec![0; firsts.len()]);
        firsts.iter().for_each(|&first| sizes[first] += 1);
        let mut found = Replicates::default();
        for (number, &first) in firsts.iter().enumerate() {
            if sizes[first] == 1 {
                found.alone.push(number);
                continue;
            }
            if number == first {
                places[first] = found.sets.len();
                found.sets.push(Vec::with_capacity(sizes[first]));
            }
            found.sets[places[first]].push(number);
        }
        found
    }

    /// Number of tests.
    pub(crate) fn len(&self) -> usize {
        self.alone.len() + self.sets.iter().map(Vec::len).sum::<usize>()
    }

    /// The sets without each test i with `marked[i]`.
    pub(crate) fn without(self, marked: &[bool]) -> Replicates {
        self.regrouped(|number| !marked[number], |set| set.len() > 1)
    }

    /// Dissolves each set for which `is_kept` is false: the tests of such a set are then in no set.
    pub(crate) fn retain(self, is_kept: impl Fn(&[usize]) -> bool) -> Replicates {
        self.regrouped(|_| true, is_kept)
    }

    fn regrouped(self, is_member: impl Fn(usize) -> bool, is_kept: impl Fn(&[usize]) -> bool) -> Replicates {
        let mut found = Replicates { sets: Vec::new(), alone: self.alone };
        found.alone.retain(|&number| is_member(number));
        for mut set in self.sets {
            set.retain(|&number| is_member(number));
            if is_kept(&set) {
                found.sets.push(set);
            } else {
                found.alone.extend(set);
            }
        }
        found.sets.sort_unstable_by_key(|set| set[0]);
        found.alone.sort_unstable();
        found
    }

    /// The parts of all sets in ranges of successive tests, one list for each range. A range has far more tests than
    /// there are sets.
    pub(crate) fn lists(&self) -> Vec<Vec<&[usize]>> {
        let range_len = LEAST_LIST_TESTS.max(LEAST_TESTS_PER_SET * self.sets.len());
        let last = self.sets.iter().filter_map(|set| set.last()).max();
        let mut lists = vec![Vec::new(); last.map_or(0, |last| last / range_len + 1)];
        for part in self.sets.iter().flat_map(|set| set.chunk_by(|a, b| a / range_len == b / range_len)) {
            lists[part[0] / range_len].push(part);
        }
        lists
    }
}

/// Index of the first test that each test equals, as far as comparisons of adjacent tests show: tests of one design are
/// often adjacent.
fn neighbours(mask: &CellMask, tests: &[&Test]) -> Vec<usize> {
    let mut firsts: Vec<usize> = (0..tests.len()).collect();
    firsts.par_chunks_mut(TESTS_PER_TASK).for_each(|chunk| {
        for k in 1..chunk.len() {
            if mask.agrees_on(tests[chunk[k]], tests[chunk[k - 1]]) {
                chunk[k] = chunk[k - 1];
            }
        }
    });
    firsts
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reduce::subject::Uses;
    use kalfit_fixtures::by_hand::Lcg;
    use kalfit_model::{Label, Source};

    const VALUES: [f64; 4] = [0.0, -0.0, 2.5, f64::NAN];

    /// Tests of a few lengths whose cells mostly follow one of a few kinds. Columns: one read, one measured, one
    /// ignored, and two texts.
    fn drawn(tests: usize, random: &mut impl FnMut(usize) -> usize) -> Vec<Test> {
        let one = |number: usize| {
            let (kind, rows) = (random(3), [0, 3, 8, 9, 13][random(5)]);
            let mut test = Test::new(format!("t{number}"), 3, 2);
            let odd = if random(3) == 0 { random(14) } else { 99 };
            for row in 0..rows {
                let texts = [Label::literal(if row == odd { random(2) } else { kind }), Label::literal(random(3))];
                let x = if row == odd { random(4) } else { (row + kind / 2) % 4 };
                let y = if row == odd + 1 { f64::NAN } else { random(5) as f64 };
                test.push(&[VALUES[x], y, random(9) as f64], &texts, Source::default());
            }
            test
        };
        (0..tests).map(one).collect()
    }

    /// Whether all cells that count are the same in both tests.
    fn are_alike(a: &Test, b: &Test) -> bool {
        let row = |row: usize| {
            let (x, y) = (a.numbers(row), b.numbers(row));
            (x[0].to_bits(), x[1].is_nan(), a.texts(row)[0]) == (y[0].to_bits(), y[1].is_nan(), b.texts(row)[0])
        };
        a.rows() == b.rows() && (0..a.rows()).all(row)
    }

    #[test]
    fn replicates_are_those_that_all_pairs_say() {
        let mut seed = Lcg(11);
        let mut random = |below: usize| ((0.5 + seed.next()) * below as f64) as usize % below;
        let mask = CellMask::new(3, &Uses { numbers: vec![0], texts: vec![0] }, [1].into_iter());
        let mut many = 0;
        for round in 0..300 {
            let tests = drawn(1 + 2 * (round % 20), &mut random);
            let tests: Vec<&Test> = tests.iter().collect();
            let mut sets: Vec<Vec<usize>> = Vec::new();
            for (number, test) in tests.iter().enumerate() {
                match sets.iter_mut().find(|set| are_alike(test, tests[set[0]])) {
                    Some(set) => set.push(number),
                    None => sets.push(vec![number]),
                }
            }
            let (sets, alone): (Vec<_>, Vec<_>) = sets.into_iter().partition(|set| set.len() > 1);
            many += sets.len();
            let expected = Replicates { sets, alone: alone.concat() };
            let found = Replicates::of(Some(&mask), &tests);
            assert_eq!(found, expected, "round {round}");
            assert_eq!(found.lists().concat().concat(), found.sets.concat(), "all of them");
            // without every third test
            let marked: Vec<bool> = (0..tests.len()).map(|number| number % 3 == 0).collect();
            let left: Vec<&Test> =
                tests.iter().zip(&marked).filter(|(_, marked)| !**marked).map(|(test, _)| *test).collect();
            let numbers: Vec<usize> = (0..tests.len()).filter(|&number| !marked[number]).collect();
            let by_number = |places: Vec<usize>| places.into_iter().map(|place| numbers[place]).collect::<Vec<_>>();
            let Replicates { sets, alone } = Replicates::of(Some(&mask), &left);
            let expected = Replicates { sets: sets.into_iter().map(by_number).collect(), alone: by_number(alone) };
            assert_eq!(found.without(&marked), expected, "round {round}");
        }
        assert!(many > 1000, "{many} sets");
    }

    #[test]
    fn lists_have_tests_that_stand_together() {
        let (even, odd) = ((0..5000).step_by(2).collect(), (1..9999).step_by(2).collect());
        let all = Replicates { sets: vec![even, odd], alone: Vec::new() };
        let lists = all.lists();
        assert_eq!(lists.iter().map(Vec::len).collect::<Vec<_>>(), [2, 2, 2, 1, 1]);
        for (at, list) in lists.iter().enumerate() {
            assert!(list.concat().iter().all(|number| number / LEAST_LIST_TESTS == at), "list {at}");
        }
        assert_eq!(lists.concat().concat().len(), 2500 + 4999);
    }
}
