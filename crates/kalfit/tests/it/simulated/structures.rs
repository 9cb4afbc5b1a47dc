//! Every structure of μ and Σ, and both criteria.

use kalfit::model::{
    CovarianceKind, CovarianceStructure, Expression, FixedElement, MeanElement, MeanStructure, Regression,
};
use nalgebra::DMatrix;

use super::{Assumed, fixed};

pub(crate) fn of(kind: CovarianceKind) -> CovarianceStructure {
    CovarianceStructure { kind, ..CovarianceStructure::full() }
}

pub(crate) fn numbers(p: usize, entry: impl Fn(usize, usize) -> f64) -> Vec<Vec<Expression>> {
    (0..p).map(|i| (0..p).map(|j| Expression::Number(entry(i, j))).collect()).collect()
}

pub(crate) fn pattern(p: usize, zero: impl Fn(usize, usize) -> bool) -> CovarianceStructure {
    let all = (0..p).flat_map(|i| (0..i).map(move |j| (i, j)));
    fixed(&all.filter(|&(i, j)| zero(i, j)).map(|(i, j)| (i, j, 0.0)).collect::<Vec<_>>())
}

/// Σ22 of the last two states known, with Σ12 free or known.
pub(crate) fn held(p: usize, beside: bool) -> CovarianceStructure {
    let mut elements = vec![(p - 1, p - 1, 1.2), (p - 2, p - 2, 1.0), (p - 1, p - 2, 0.3)];
    if beside {
        elements.extend((0..p - 2).map(|j| (p - 1, j, 0.1)));
    }
    CovarianceStructure {
        fixed: elements.into_iter().map(|(i, j, value)| FixedElement { i, j, value }).collect(),
        ..CovarianceStructure::full()
    }
}

pub(crate) fn structures(p: usize) -> Vec<(&'static str, Assumed)> {
    let free = MeanStructure::free(p);
    let ml = |covariance| Assumed::ml(free.clone(), covariance);
    let mean = |element: MeanElement| {
        let mut elements = vec![MeanElement::Free; p];
        elements[p - 1] = element;
        Assumed::ml(MeanStructure { elements, ..free.clone() }, CovarianceStructure::full())
    };
    let proportional = (0..p).map(|i| MeanElement::Proportional(1.0 + i as f64)).collect();
    let regression = vec![Regression { element: 0, column: 0 }];
    let regressed = MeanStructure { regression, ..free.clone() };
    let band = |k: usize| DMatrix::from_fn(p, p, |i, j| if i.abs_diff(j) == k { 1.0 } else { 0.0 });
    let bands = (0..p).map(band).collect();
    let equal = vec![(0..p).map(|i| (i, i)).collect()];
    let blocks = vec![(0..p / 2).collect(), (p / 2..p).collect()];
    vec![
        ("full", ml(CovarianceStructure::full())),
        ("diagonal", ml(of(CovarianceKind::Diagonal))),
        ("blocks", ml(of(CovarianceKind::Blocks(blocks)))),
        ("variance fixed", ml(fixed(&[(0, 0, 1.0)]))),
        ("covariance fixed", ml(fixed(&[(1, 0, 0.2)]))),
        ("no variance", ml(fixed(&[(p - 1, p - 1, 0.0)]))),
        ("zero pattern", ml(pattern(p, |i, j| i - j > 1))),
        ("arrow pattern", ml(pattern(p, |_, j| j != 0))),
        ("Σ22 fixed", ml(held(p, false))),
        ("Σ12, Σ22 fixed", ml(held(p, true))),
        ("equal", ml(CovarianceStructure { equal, ..CovarianceStructure::full() })),
        ("proportional", ml(of(CovarianceKind::Proportional(numbers(p, |i, j| if i == j { 1.0 } else { 0.3 }))))),
        ("correlation", ml(of(CovarianceKind::Correlation(numbers(p, |i, j| if i == j { 1.0 } else { 0.3 }))))),
        ("known", ml(of(CovarianceKind::Fixed(numbers(p, |i, j| if i == j { 1.0 } else { 0.3 }))))),
        ("toeplitz", ml(of(CovarianceKind::Linear { constant: DMatrix::zeros(p, p), generators: bands }))),
        ("mean fixed", mean(MeanElement::Fixed(p as f64))),
        ("mean tied", mean(MeanElement::Tied { constant: p as f64 + 1.5, terms: vec![(0, 0.5), (1, -1.0)] })),
        (
            "mean proportional",
            Assumed::ml(MeanStructure { elements: proportional, ..free.clone() }, CovarianceStructure::full()),
        ),
        ("regression", Assumed::ml(regressed.clone(), CovarianceStructure::full())),
        ("reml", Assumed::reml(free.clone(), CovarianceStructure::full())),
        ("reml diagonal", Assumed::reml(free.clone(), of(CovarianceKind::Diagonal))),
        ("reml regression", Assumed::reml(regressed, CovarianceStructure::full())),
    ]
}
