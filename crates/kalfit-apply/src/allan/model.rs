//! Allan's variance of a linear model; the sum of the measured values over a span is an additional state.
#![expect(non_snake_case, reason = "the letters of the equations")]

use nalgebra::{DMatrix, DVector};

use crate::export::Exported;
use kalfit_model::Expression;

/// Effect of a span of rows on [x; s], with s the sum of the measured values: [x; s] becomes M [x; s] + d + e, e ~ N(0,
/// W).
#[derive(Debug, Clone)]
struct SpanMap {
    M: DMatrix<f64>,
    d: DVector<f64>,
    W: DMatrix<f64>,
}

impl SpanMap {
    /// The map of one row: a measurement, then a step.
    fn row(filter: &Exported, measurement: usize) -> SpanMap {
        let n = filter.F.nrows();
        // inputs that read columns are zero; the constant input is 1
        let constant = |u: &Expression| if *u == Expression::Number(1.0) { 1.0 } else { 0.0 };
        let u = DVector::from_iterator(filter.inputs.len(), filter.inputs.iter().map(constant));
        let (mut M, mut W, mut d) =
            (DMatrix::identity(n + 1, n + 1), DMatrix::zeros(n + 1, n + 1), DVector::zeros(n + 1));
        M.view_mut((0, 0), (n, n)).copy_from(&filter.F);
        M.view_mut((n, 0), (1, n)).copy_from(&filter.H.row(measurement));
        W.view_mut((0, 0), (n, n)).copy_from(&filter.Q);
        W[(n, n)] = filter.R[(measurement, measurement)];
        d.rows_mut(0, n).copy_from(&(&filter.B * &u));
        d[n] = (filter.D.row(measurement) * &u)[0];
        SpanMap { M, d, W }
    }

    /// The map of this span followed by the span of `next`.
    fn followed_by(&self, next: &SpanMap) -> SpanMap {
        SpanMap {
            M: &next.M * &self.M,
            d: &next.M * &self.d + &next.d,
            W: &next.M * &self.W * next.M.transpose() + &next.W,
        }
    }

    /// The map of m equal spans in a row, by repeated doubling.
    fn repeated(self, m: usize) -> SpanMap {
        let (mut whole, mut doubled, mut remaining) = (None, self, m);
        while remaining > 0 {
            if remaining & 1 == 1 {
                whole = Some(whole.map_or_else(|| doubled.clone(), |earlier: SpanMap| earlier.followed_by(&doubled)));
            }
            remaining >>= 1;
            if remaining > 0 {
                doubled = doubled.followed_by(&doubled);
            }
        }
        whole.unwrap_or(doubled)
    }
}

/// Allan's variance of the measurement with index `measurement` in the filter, over the first two spans of m rows of a
/// new test whose inputs are zero; `None` for a filter without a start, and where the variance is not finite.
///
/// With the states x_0 at the start of the first span and x_1 = A x_0 + a + w at the start of the second, the sums over
/// the spans are s_i = g x_{i-1} + b + e_i, and the difference is s_2 - s_1 = g(A - I) x_0 + g a + g w - e_1 + e_2.
pub fn variance(filter: &Exported, measurement: usize, m: usize) -> Option<f64> {
    let (mean, P) = filter.start.as_ref()?;
    if m == 0 || measurement >= filter.H.nrows() {
        return None;
    }
    let n = mean.len();
    let SpanMap { M, d, W } = SpanMap::row(filter, measurement).repeated(m);
    let g = M.view((n, 0), (1, n)).into_owned();
    let c = &g * (M.view((0, 0), (n, n)) - DMatrix::<f64>::identity(n, n));
    let mut weights = DMatrix::zeros(1, n + 1);
    weights.view_mut((0, 0), (1, n)).copy_from(&g);
    weights[(0, n)] = -1.0;
    let difference_mean = (&c * mean)[0] + (&g * d.rows(0, n))[0];
    let difference_variance = (&c * P * c.transpose())[0] + (&weights * &W * weights.transpose())[0] + W[(n, n)];
    let variance = 0.5 * (difference_variance.max(0.0) + difference_mean * difference_mean) / (m as f64).powi(2);
    variance.is_finite().then_some(variance)
}
