//! Score tests of mean terms from sums of products of whitened columns.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};
use statrs::function::beta::beta_reg;

use crate::misfit::columns::{Columns, UnitColumns};
use crate::misfit::terms::Term;
use crate::misfit::{Deviation, TermTest};

/// A column counts as determined by others when this part of its square or less is left without them.
const DEPENDENT: f64 = 1e-8;

/// Sums over all rows.
pub(super) struct Score {
    /// C'C of the columns [residual, mean coordinates, terms], after [`Score::of_means`].
    products: DMatrix<f64>,
    /// From columns as they come to these.
    combine: DMatrix<f64>,
    means: Range<usize>,
    rows: usize,
    /// Sum of variances and number of rows by (phase, measurement) of each term.
    sizes: Vec<(f64, f64)>,
    owners: Vec<(usize, usize)>,
}

/// An F test.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct FTest {
    pub(super) value: f64,
    pub(super) degrees_of_freedom: [usize; 2],
}

impl FTest {
    /// F of a χ² with k degrees of freedom among a square of `all` degrees of freedom; `None` where one of both parts
    /// has none.
    pub(super) fn of(part: f64, k: usize, square: f64, all: usize) -> Option<FTest> {
        let rest = all.checked_sub(k).filter(|rest| *rest > 0 && k > 0)?;
        let left = (square - part).max(f64::MIN_POSITIVE);
        let value = (part / k as f64) / (left / rest as f64);
        value.is_finite().then_some(FTest { value, degrees_of_freedom: [k, rest] })
    }

    /// Probability of an F as large as this.
    pub(super) fn p_value(&self) -> f64 {
        let [k, rest] = self.degrees_of_freedom.map(|n| n as f64);
        beta_reg(0.5 * rest, 0.5 * k, rest / (rest + k * self.value))
    }
}

impl Score {
    pub(super) fn new(columns: &Columns<'_>, terms: &[Term]) -> Score {
        let (states, regressors, basis) = (columns.states(), columns.regressors(), columns.basis());
        let q = basis.ncols();
        let means = 1..1 + q + regressors.len();
        let added: usize = terms.iter().map(Term::width).sum();
        let (from, to) = (columns.passes(), means.end + added);
        let mut combine = DMatrix::zeros(from, to);
        combine[(0, 0)] = 1.0;
        combine.view_mut((states.start, 1), basis.shape()).copy_from(basis);
        (0..from - regressors.start).for_each(|k| combine[(regressors.start + k, 1 + q + k)] = 1.0);
        Score {
            products: DMatrix::zeros(to, to),
            combine,
            means,
            rows: 0,
            sizes: vec![(0.0, 0.0); terms.len()],
            owners: terms.iter().map(|term| (term.phase, term.measurement)).collect(),
        }
    }

    /// The columns [residual, mean coordinates, terms] of a unit.
    pub(super) fn of_means(&self, unit: &UnitColumns) -> DMatrix<f64> {
        &unit.values * &self.combine
    }

    /// `columns`: those of [`Score::of_means`].
    pub(super) fn add(&mut self, unit: &UnitColumns, columns: &DMatrix<f64>) {
        self.products += columns.transpose() * columns;
        self.rows += columns.nrows();
        for (size, owner) in self.sizes.iter_mut().zip(&self.owners) {
            for place in unit.places.iter().filter(|place| (place.phase, place.measurement) == *owner) {
                *size = (size.0 + place.variance, size.1 + 1.0);
            }
        }
    }

    /// X'V⁻¹X and X'V⁻¹r.
    pub(super) fn of_mean_coordinates(&self) -> (DMatrix<f64>, DVector<f64>) {
        let (from, q) = (self.means.start, self.means.len());
        (self.products.view((from, from), (q, q)).into(), self.products.view((from, 0), (q, 1)).column(0).into())
    }

    /// (r'V⁻¹r without the part that a change of the mean could explain, n - q).
    pub(super) fn left(&self) -> (f64, usize) {
        let (products, score) = self.of_mean_coordinates();
        let all: Vec<usize> = (0..score.len()).collect();
        let cut = Eliminated::new(&products, &score, &all);
        (self.products[(0, 0)] - cut.square, self.rows.saturating_sub(cut.rank))
    }

    /// The tests of all terms that have a rank.
    pub(super) fn tests(&self, terms: &[Term]) -> Vec<TermTest> {
        let (square, all) = self.left();
        let mut at = self.means.end;
        let mut found = Vec::new();
        for (term, size) in terms.iter().zip(&self.sizes) {
            let own = at..at + term.width();
            at = own.end;
            let columns: Vec<usize> = self.means.clone().chain(own).collect();
            let products = self.products.select_rows(&columns).select_columns(&columns);
            let score = DVector::from_iterator(columns.len(), columns.iter().map(|&column| self.products[(column, 0)]));
            let q = self.means.len();
            let without = Eliminated::new(&products, &score, &(0..q).collect::<Vec<_>>());
            let with = Eliminated::new(&products, &score, &(0..columns.len()).collect::<Vec<_>>());
            let k = with.rank - without.rank;
            let Some(statistic) = FTest::of(with.square - without.square, k, square, all) else { continue };
            let scale = if size.1 > 0.0 { (size.0 / size.1).sqrt() } else { 1.0 };
            found.push(term.tested(statistic, largest(term, &without, q, scale)));
        }
        found
    }
}

/// The column of a term that deviates most, each by itself beside the mean coordinates.
fn largest(term: &Term, without: &Eliminated, q: usize, scale: f64) -> Option<Deviation> {
    let of = |column: usize| {
        let information = without.products[(q + column, q + column)];
        let score = without.score[q + column];
        (information > DEPENDENT * without.whole[q + column]).then(|| {
            let std_dev = information.sqrt().recip();
            let deviation =
                Deviation { at: term.ranges[column], value: scale * score / information, std_dev: scale * std_dev };
            (score.abs() * std_dev, deviation)
        })
    };
    let each = (0..term.width()).filter_map(of);
    each.max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, deviation)| deviation)
}

/// Products and score after the elimination of some columns, as in a Cholesky factorisation: a column that depends on
/// those before is passed over.
struct Eliminated {
    products: DMatrix<f64>,
    score: DVector<f64>,
    whole: Vec<f64>,
    rank: usize,
    /// The part of the residual square that the columns explain.
    square: f64,
}

impl Eliminated {
    fn new(products: &DMatrix<f64>, score: &DVector<f64>, columns: &[usize]) -> Eliminated {
        let whole: Vec<f64> = products.diagonal().iter().copied().collect();
        let mut left = Eliminated { products: products.clone(), score: score.clone(), whole, rank: 0, square: 0.0 };
        columns.iter().for_each(|&column| left.eliminate(column));
        left
    }

    fn eliminate(&mut self, column: usize) {
        let pivot = self.products[(column, column)];
        if pivot.is_nan() || pivot <= DEPENDENT * self.whole[column] {
            return;
        }
        let (own, score) = (self.products.column(column).clone_owned(), self.score[column]);
        self.rank += 1;
        self.square += score * score / pivot;
        self.score.axpy(-score / pivot, &own, 1.0);
        self.products.ger(-1.0 / pivot, &own, &own, 1.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tail_of_f_is_that_of_tables() {
        let of = |value, k, rest| FTest { value, degrees_of_freedom: [k, rest] }.p_value();
        assert!((of(4.965, 1, 10) - 0.05).abs() < 1e-5);
        assert!((of(2.3479, 8, 30) / 0.0434 - 1.0).abs() < 0.05);
        let far = of(2734.0, 7, 63);
        assert!(far > 1e-78 && far < 1e-72, "{far:e}");
    }

    #[test]
    fn a_term_is_tested_as_in_a_regression() {
        // y on a constant, with x = (0, 1, 2, 3) added: F = R²(n - 2) / (1 - R²)
        let (x, y) = ([0.0, 1.0, 2.0, 3.0], [0.1, 0.9, 2.2, 2.8_f64]);
        let mean = y.iter().sum::<f64>() / 4.0;
        let columns = DMatrix::from_fn(4, 2, |i, k| if k == 0 { 1.0 } else { x[i] });
        let residuals = DVector::from_iterator(4, y.iter().map(|y| y - mean));
        let (products, score) = (columns.transpose() * &columns, columns.transpose() * &residuals);
        let without = Eliminated::new(&products, &score, &[0]);
        let with = Eliminated::new(&products, &score, &[0, 1]);
        let (square, explained) = (residuals.norm_squared(), with.square - without.square);
        let slope: f64 = x.iter().zip(&y).map(|(x, y)| (x - 1.5) * (y - mean)).sum::<f64>() / 5.0;
        assert!((explained - slope * slope * 5.0).abs() < 1e-12);
        let found = FTest::of(explained, with.rank - without.rank, square, 3).unwrap();
        assert!((found.value - explained * 2.0 / (square - explained)).abs() < 1e-9);
        assert_eq!(found.degrees_of_freedom, [1, 2]);
    }
}
