//! Laws of likelihood-ratio statistics: mixtures of χ².

use statrs::distribution::{ChiSquared, ContinuousCDF};

/// One component of a mixture: χ² with `degrees_of_freedom`; with zero degrees of freedom, the component is the
/// constant zero.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Component {
    /// Degrees of freedom.
    pub degrees_of_freedom: usize,
    /// Weight of the component in the mixture.
    pub weight: f64,
}

/// The large-sample law of a likelihood-ratio statistic under the null hypothesis.
#[derive(Debug, Clone, PartialEq)]
pub struct ReferenceLaw {
    /// Components of the mixture; the weights add up to 1.
    pub components: Vec<Component>,
    /// The mixture as if the variances that the hypothesis puts at zero were estimated independently of each other, as
    /// in textbooks; equal to `components` for fewer than two such variances.
    pub independent: Vec<Component>,
    /// Whether the mixture is an upper bound of the law, not the law itself: p-values are then too large, never too
    /// small.
    pub is_bound: bool,
}

impl ReferenceLaw {
    /// The law χ² with `degrees_of_freedom`.
    pub fn chi_squared(degrees_of_freedom: usize) -> ReferenceLaw {
        let components = vec![Component { degrees_of_freedom, weight: 1.0 }];
        ReferenceLaw { independent: components.clone(), components, is_bound: false }
    }

    /// Whether the law is a single χ².
    pub fn is_chi_squared(&self) -> bool {
        self.components.len() == 1
    }

    /// P(X ≥ x) under the mixture.
    pub fn tail(&self, x: f64) -> f64 {
        tail(&self.components, x)
    }

    /// P(X ≥ x) under the mixture for independently estimated variances.
    pub fn tail_if_independent(&self, x: f64) -> f64 {
        tail(&self.independent, x)
    }
}

/// P(X ≥ x) under χ²; 1 for x ≤ 0.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tails_are_those_of_tables() {
        let half = |degrees_of_freedom: usize| Component { degrees_of_freedom, weight: 0.5 };
        let halves = ReferenceLaw { components: vec![half(0), half(1)], ..ReferenceLaw::chi_squared(1) };
        let (one, none) = (ReferenceLaw::chi_squared(1), ReferenceLaw::chi_squared(0));
        let cases = [
            (&one, 3.841_458_820_694_124, 0.05),
            (&halves, 2.705_543_454_095_404, 0.05),
            (&halves, 1e-30, 0.5),
            (&none, 1e-30, 0.0),
            (&one, 0.0, 1.0),
            (&halves, 0.0, 1.0),
            (&none, 0.0, 1.0),
        ];
        for (law, x, expected) in cases {
            let found = law.tail(x);
            assert!((found - expected).abs() < 1e-9, "{:?} beyond {x}: {found}, expected {expected}", law.components);
        }
        assert_eq!(halves.tail_if_independent(3.841_458_820_694_124), one.tail(3.841_458_820_694_124));
        assert!(one.is_chi_squared() && !halves.is_chi_squared());
    }
}
