//! Sums over the rows of a design pass.
#![expect(non_snake_case, reason = "the letters of the theory: S, J")]

use crate::reduce::semidefinite::information_root_to;
use kalfit_algebra::symmetric::pairs;
use kalfit_lanes::{Lanes, Real};

/// Least scaled pivot of J at which sums of T'S⁻¹T are accurate enough.
const LEAST_PIVOT: f64 = 1e-9;

/// Sums over the rows of a design pass: J, Π S, and two measures of accuracy (`margin`, `least`).
#[derive(Debug, Clone)]
pub(crate) struct InformationSums<R = f64> {
    /// J, packed by columns.
    pub(crate) J: Vec<R>,
    /// Π S = mantissa × 2^exponent.
    mantissa: R,
    exponent: R,
    /// Smallest accuracy margin of the updates: negative where an update cancelled too many digits.
    margin: R,
    /// Smallest S.
    least: R,
}

impl<R: Real> InformationSums<R> {
    #[inline(always)]
    pub(crate) fn new(p: usize) -> InformationSums<R> {
        let (zero, one) = (R::splat(0.0), R::splat(1.0));
        InformationSums { J: vec![zero; pairs(p)], mantissa: one, exponent: zero, margin: one, least: one }
    }

    /// Multiplies Π S by the S of a row, and takes the row's accuracy margin into account.
    #[inline(always)]
    pub(crate) fn count(&mut self, S: R, margin: R) {
        self.margin = self.margin.minimum(margin);
        self.least = self.least.minimum(S);
        self.times_determinant(S);
    }

    #[inline(always)]
    pub(super) fn times_determinant(&mut self, S: R) {
        let (mantissa, exponent) = (self.mantissa * S.or_one()).split();
        (self.mantissa, self.exponent) = (mantissa, self.exponent + exponent);
    }
}

impl<R: Lanes> InformationSums<R> {
    /// Writes the sums of all lanes to `all`, interleaved.
    #[inline(always)]
    pub(crate) fn lanes(&self, all: &mut Vec<f64>) {
        all.clear();
        all.resize((self.J.len() + 4) * R::COUNT, 0.0);
        let scalars = [self.mantissa, self.exponent, self.margin, self.least];
        for (k, entry) in all.chunks_exact_mut(R::COUNT).enumerate() {
            let x = if k < self.J.len() { self.J[k] } else { scalars[k - self.J.len()] };
            x.store(entry);
        }
    }
}

impl InformationSums {
    /// Replaces the sums by the sums of one lane, from the list of [`InformationSums::lanes`].
    pub(crate) fn take_lane(&mut self, all: &[f64], lane: usize, lanes: usize) {
        let entries = all.len() / lanes - 4;
        let at = |k: usize| all[k * lanes + lane];
        self.J.clear();
        self.J.extend((0..entries).map(at));
        (self.mantissa, self.exponent) = (at(entries), at(entries + 1));
        (self.margin, self.least) = (at(entries + 2), at(entries + 3));
    }

    /// Whether no update cancelled too many digits, and every S is positive.
    pub(crate) fn is_accurate(&self) -> bool {
        self.margin >= 0.0 && self.least > 0.0 && self.J.iter().all(|x| x.is_finite())
    }

    /// (R, Σ log S), or `None` where square-root arrays are needed. `many`: (S, number of rows) of further rows.
    pub(crate) fn root(&self, many: &[(f64, usize)]) -> Option<(Vec<f64>, f64)> {
        self.root_in(Vec::new(), many)
    }

    /// As [`InformationSums::root`], with R written to the vector `root` in place of the old contents.
    pub(crate) fn root_in(&self, mut root: Vec<f64>, many: &[(f64, usize)]) -> Option<(Vec<f64>, f64)> {
        if !self.is_accurate() || !self.mantissa.is_finite() {
            return None;
        }
        let p = (0..).find(|&p| pairs(p) == self.J.len()).expect("J is a packed triangle");
        let least = information_root_to(&mut root, &self.J, p, LEAST_PIVOT);
        let repeated: f64 = many.iter().map(|&(S, many)| many as f64 * S.ln()).sum();
        let log_determinant = self.mantissa.ln() + self.exponent * std::f64::consts::LN_2 + repeated;
        (least >= LEAST_PIVOT).then_some((root, log_determinant))
    }
}
