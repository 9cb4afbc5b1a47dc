//! How much of the spread of the estimates of single tests their noise explains: Cochran's Q, I² and H².
//!
//! For tests of one state with known noise, y_j the estimate of test j alone, w_j = 1/variance, X the columns of the mean:
//!
//! ```text
//! Q = Σ w_j (y_j - x_j'b)²,  b by least squares with weights w        χ² with k - q degrees of freedom without spread
//! s² = (k - q) / tr P,       P = W - WX(X'WX)⁻¹X'W                     the variance of a typical test
//! I² = σ² / (σ² + s²),       H² = (σ² + s²) / s²                        (Higgins and Thompson, Stat. Med. 21, 2002)
//! ```

use nalgebra::{DMatrix, DVector};
use statrs::distribution::{ChiSquared, ContinuousCDF};

use crate::constraint::is_held;
use kalfit_estimate::Estimate;
use kalfit_filter::reduce::Reductions;
use kalfit_model::MeanElement;

/// Heterogeneity of tests of one state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Heterogeneity {
    /// Cochran's Q.
    pub q: f64,
    /// Degrees of freedom of Q: tests that inform the state less free columns of the mean.
    pub degrees_of_freedom: usize,
    /// P(χ² at least Q) where tests do not differ.
    pub p_value: f64,
    /// I²: share of the variance of typical estimates that is spread between tests, from 0 to 1.
    pub i_squared: f64,
    /// H²: variance of typical estimates over that of their noise.
    pub h_squared: f64,
    /// s², the noise variance of a typical test, in squared units of the state.
    pub typical_variance: f64,
}

/// Heterogeneity of the tests of an estimate with one state, whose variance is estimated and whose noise is known; `None` for
/// any other model, for tests in groups or elsewhere, and for too few tests.
pub fn heterogeneity(estimate: &Estimate, reductions: &Reductions) -> Option<Heterogeneity> {
    let (state, structure) = (&estimate.state, estimate.state.structure());
    let is_one = structure.dimension() == 1 && structure.grouping.is_none() && reductions.remote().is_none();
    if !is_one || state.joint.is_some() || is_held(state, 0, 0) {
        return None;
    }
    let offset = match structure.elements()[0] {
        MeanElement::Free => None,
        MeanElement::Fixed(value) => Some(value),
        MeanElement::Tied { .. } | MeanElement::Proportional(_) => return None,
    };
    let mut rows: Vec<(f64, f64, Vec<f64>)> = Vec::new();
    for test in reductions.iter() {
        if test.exact.is_some() {
            return None;
        }
        let root = test.factor[0];
        if root == 0.0 {
            continue; // the test does not inform the state
        }
        let intercept = offset.is_none().then_some(1.0);
        let columns = intercept.into_iter().chain(test.covariates.iter().copied()).collect();
        rows.push((root * root, test.data[0] / root - offset.unwrap_or(0.0), columns));
    }
    let (k, q) = (rows.len(), rows.first()?.2.len());
    let degrees_of_freedom = k.checked_sub(q).filter(|left| *left > 0)?;
    let x = DMatrix::from_fn(k, q, |j, c| rows[j].2[c]);
    let w = DVector::from_iterator(k, rows.iter().map(|row| row.0));
    let y = DVector::from_iterator(k, rows.iter().map(|row| row.1));
    let weighted = |power: i32| {
        let mut scaled = x.clone();
        scaled.row_iter_mut().zip(w.iter()).for_each(|(mut row, w)| row *= w.powi(power));
        x.tr_mul(&scaled)
    };
    let (inverse, b) = match q {
        0 => (DMatrix::zeros(0, 0), DVector::zeros(0)),
        _ => {
            let inverse = weighted(1).try_inverse()?;
            let b = &inverse * x.tr_mul(&y.component_mul(&w));
            (inverse, b)
        }
    };
    let left = &y - &x * b;
    let statistic = left.component_mul(&left).dot(&w);
    let typical_variance = degrees_of_freedom as f64 / (w.sum() - (inverse * weighted(2)).trace());
    let spread = estimate.covariance[(0, 0)];
    let found = Heterogeneity {
        q: statistic,
        degrees_of_freedom,
        p_value: ChiSquared::new(degrees_of_freedom as f64).ok()?.sf(statistic),
        i_squared: spread / (spread + typical_variance),
        h_squared: (spread + typical_variance) / typical_variance,
        typical_variance,
    };
    let is_finite = [found.q, found.i_squared, found.h_squared].iter().all(|x| x.is_finite());
    (is_finite && typical_variance > 0.0).then_some(found)
}
