//! The data's part over equal steps of one scalar measurement.
#![expect(non_snake_case, reason = "the letters of the theory: K")]

use kalfit_lanes::{Lanes, Part};

use crate::score::backward::{Answers, Equal};

/// Forth over them, from x̄ before them. `e`: z - d of each step, then ē; x̄ at the beginning of each block goes to `marks`.
pub(super) struct Forth<'a, T, const N: usize> {
    pub(super) leg: &'a Equal<'a>,
    pub(super) x: &'a mut [T],
    pub(super) e: &'a mut [T],
    pub(super) marks: &'a mut Vec<T>,
}

impl<T: Lanes, const N: usize> Part for Forth<'_, T, N> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Forth { leg, x: all, e, marks } = self;
        let filter = leg.course::<T, N>(all).filter;
        let mut x = known(all);
        for (from, to) in leg.blocks() {
            marks.extend_from_slice(&x);
            let still = leg.moving().clamp(from, to);
            for k in from..still {
                e[k] = filter.take(&mut x, &leg.weighted(k).1, e[k]);
            }
            if still < to {
                let (_, K) = leg.weighted(still);
                for e in &mut e[still..to] {
                    *e = filter.take(&mut x, &K, *e);
                }
            }
        }
        all[..N].copy_from_slice(&x);
    }
}

/// Back over them, from r after them to r before them.
pub(super) struct Back<'a, T, const N: usize> {
    pub(super) leg: &'a Equal<'a>,
    /// x̄ of all states before them.
    pub(super) first: &'a [T],
    pub(super) marks: &'a [T],
    pub(super) e: &'a [T],
    pub(super) r: &'a mut [T],
}

impl<T: Lanes, const N: usize> Part for Back<'_, T, N> {
    type Output = Answers<T, N>;

    #[inline(always)]
    fn run(self) -> Answers<T, N> {
        let Back { leg, first, marks, e, r: all } = self;
        let course = leg.course::<T, N>(first);
        let mut r = known(all);
        let (mut answers, mut xs) = (Answers::none(), Vec::new());
        for (number, (from, to)) in leg.blocks().enumerate().rev() {
            let mut x = known(&marks[number * N..]);
            let ahead = leg.ahead::<N>((from, to));
            let still = leg.moving().clamp(from, to);
            xs.clear();
            for k in from..to {
                xs.push(x);
                x = course.filter.state(&x, &leg.weighted(k).1, e[k]);
            }
            if still < to {
                let (gain, ahead) = (leg.weighted::<N>(still), ahead[ahead.len() - 1]);
                for k in (still..to).rev() {
                    course.back(&mut r, (gain.0, &gain.1), e[k], (&xs[k - from], &ahead), &mut answers);
                }
            }
            for k in (from..still).rev() {
                let (gain, ahead) = (leg.weighted::<N>(k), &ahead[(k - from).min(ahead.len() - 1)]);
                course.back(&mut r, (gain.0, &gain.1), e[k], (&xs[k - from], ahead), &mut answers);
            }
        }
        all[..N].copy_from_slice(&r);
        answers
    }
}

/// The first numbers of a list.
#[inline(always)]
fn known<T: Lanes, const N: usize>(all: &[T]) -> [T; N] {
    let mut first = [T::splat(0.0); N];
    first.copy_from_slice(&all[..N]);
    first
}
