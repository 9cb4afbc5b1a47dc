//! Laws of likelihood-ratio statistics: mixtures of χ².

use statrs::distribution::{ChiSquared, ContinuousCDF};

/// χ² with `degrees_of_freedom`, with this weight. Zero degrees of freedom: the constant zero.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Component {
    /// Degrees of freedom.
    pub degrees_of_freedom: usize,
    /// Weight.
    pub weight: f64,
}

/// The large-sample law of a likelihood-ratio statistic under the null hypothesis.
#[derive(Debug, Clone, PartialEq)]
pub struct ReferenceLaw {
    /// The mixture; weights add up to one.
    pub components: Vec<Component>,
    /// Weights as if the variances that the hypothesis puts at zero were estimated independently of each other, as textbooks
    /// have them; equal to `components` for fewer than two such variances.
    pub independent: Vec<Component>,
    /// The mixture is an upper bound of the law, not the law itself: p-values are then too large, never too small.
    pub is_bound: bool,
}

impl ReferenceLaw {
    /// χ² with so many degrees of freedom.
    pub fn chi_squared(degrees_of_freedom: usize) -> ReferenceLaw {
        let components = vec![Component { degrees_of_freedom, weight: 1.0 }];
        ReferenceLaw { independent: components.clone(), components, is_bound: false }
    }

    /// Whether it is one χ².
    pub fn is_chi_squared(&self) -> bool {
        self.components.len() == 1
    }

    /// P(X ≥ x).
    pub fn tail(&self, x: f64) -> f64 {
        tail(&self.components, x)
    }

    /// The same with the weights of independent variances.
    pub fn tail_if_independent(&self, x: f64) -> f64 {
        tail(&self.independent, x)
    }
}

/// P(X ≥ x) of χ²: one at zero.
pub(crate) fn chi_squared_tail(degrees_of_freedom: usize, x: f64) -> f64 {
    match ChiSquared::new(degrees_of_freedom as f64) {
        _ if x <= 0.0 => 1.0,
        Ok(chi) => chi.sf(x),
        Err(_) => 0.0, // no degrees of freedom: the constant zero
    }
}

fn tail(components: &[Component], x: f64) -> f64 {
    components.iter().map(|c| c.weight * chi_squared_tail(c.degrees_of_freedom, x)).sum::<f64>().min(1.0)
}
