//! The sensitivity of a constraint is the derivative of the maximum: refits on either side of the value say so.

use crate::simulated;

use kalfit::estimate::{Solver, Stop};
use kalfit::infer::{self, Element};
use kalfit::model::{CovarianceKind, CovarianceStructure, Expression, MeanElement, MeanStructure};
use simulated::{Assumed, Recipe, ensemble, fit, fixed};

/// A structure by the value of one of its constrained elements.
struct Case {
    name: &'static str,
    element: Element,
    value: f64,
    at: Box<dyn Fn(f64) -> Assumed>,
    /// On a boundary of what can be: the value may only grow.
    one_sided: bool,
}

fn case(name: &'static str, element: Element, value: f64, at: impl Fn(f64) -> Assumed + 'static) -> Case {
    Case { name, element, value, at: Box::new(at), one_sided: false }
}

fn ml(covariance: CovarianceStructure) -> Assumed {
    Assumed::ml(MeanStructure::free(3), covariance)
}

fn means(elements: Vec<MeanElement>) -> Assumed {
    Assumed::ml(MeanStructure { elements, ..MeanStructure::free(3) }, CovarianceStructure::full())
}

fn of(kind: CovarianceKind) -> CovarianceStructure {
    CovarianceStructure { kind, ..CovarianceStructure::full() }
}

fn known(v: f64, i: usize, j: usize) -> Assumed {
    let entry = |a: usize, b: usize| match (a.max(b), a.min(b)) {
        at if at == (i, j) => v,
        (a, b) if a == b => 1.5,
        _ => 0.2,
    };
    ml(of(CovarianceKind::Fixed((0..3).map(|a| (0..3).map(|b| Expression::Number(entry(a, b))).collect()).collect())))
}

/// Off-diagonal zeros but for one element.
fn zeros(v: f64, i: usize, j: usize) -> Assumed {
    if v == 0.0 {
        return ml(of(CovarianceKind::Diagonal));
    }
    let all = [(1, 0), (2, 0), (2, 1)];
    ml(fixed(&all.map(|(a, b)| (a, b, if (a, b) == (i, j) { v } else { 0.0 }))))
}

fn cases() -> Vec<Case> {
    let (free, cov) = (MeanElement::Free, Element::Covariance);
    let tied = || MeanElement::Tied { constant: 0.3, terms: vec![(0, 0.5), (2, -1.0)] };
    let (f1, f2) = (free.clone(), free.clone());
    let reml = |a: Assumed| Assumed::reml(a.mean, a.covariance);
    let mut cases = vec![
        case("fixed mean", Element::Mean(0), 1.0, move |v| means(vec![MeanElement::Fixed(v), f1.clone(), f1.clone()])),
        case("fixed mean that another is tied to", Element::Mean(0), 1.0, move |v| {
            means(vec![MeanElement::Fixed(v), tied(), f2.clone()])
        }),
        case("fixed mean, restricted", Element::Mean(0), 1.0, move |v| {
            reml(means(vec![MeanElement::Fixed(v), free.clone(), free.clone()]))
        }),
        case("variance", cov(0, 0), 1.3, |v| ml(fixed(&[(0, 0, v)]))),
        case("covariance", cov(1, 0), 0.4, |v| ml(fixed(&[(1, 0, v)]))),
        case("zero covariance", cov(1, 0), 0.0, |v| ml(fixed(&[(1, 0, v)]))),
        case("one of a zero pattern", cov(2, 0), 0.0, |v| ml(fixed(&[(1, 0, 0.0), (2, 0, v)]))),
        case("zero of a diagonal", cov(2, 1), 0.0, |v| zeros(v, 2, 1)),
        case("beside fixed ones", cov(2, 0), 0.1, |v| ml(fixed(&[(2, 2, 1.5), (2, 0, v), (2, 1, 0.2)]))),
        case("variance beside fixed ones", cov(2, 2), 1.5, |v| ml(fixed(&[(2, 2, v), (2, 0, 0.1), (2, 1, 0.2)]))),
        case("variance beside equal ones", cov(2, 2), 1.5, |v| {
            ml(CovarianceStructure { equal: vec![vec![(0, 0), (1, 1)]], ..fixed(&[(2, 2, v)]) })
        }),
        case("variance of a known matrix", cov(1, 1), 1.5, |v| known(v, 1, 1)),
        case("covariance of a known matrix", cov(2, 1), 0.2, |v| known(v, 2, 1)),
        case("variance, restricted", cov(0, 0), 1.3, move |v| reml(ml(fixed(&[(0, 0, v)])))),
        case("covariance, restricted", cov(1, 0), 0.4, move |v| reml(ml(fixed(&[(1, 0, v)])))),
        case("zero of a diagonal, restricted", cov(2, 1), 0.0, move |v| reml(zeros(v, 2, 1))),
    ];
    // where the covariances beside it stay zero
    let alone = |v: f64| if v == 0.0 { fixed(&[(2, 2, 0.0)]) } else { fixed(&[(2, 2, v), (2, 0, 0.0), (2, 1, 0.0)]) };
    for (name, restricted) in [("no variance", false), ("no variance, restricted", true)] {
        let at = move |v: f64| if restricted { reml(ml(alone(v))) } else { ml(alone(v)) };
        cases.push(Case { one_sided: true, ..case(name, cov(2, 2), 0.0, at) });
    }
    cases
}

/// Richardson's extrapolation of differences of the refitted maximum.
fn slope(f: &dyn Fn(f64) -> f64, h: f64, one_sided: bool) -> f64 {
    if one_sided {
        let at = [0.0, h, 2.0 * h, 4.0 * h].map(f);
        let d = |k: usize, x: f64| (at[k] - at[0]) / x;
        let (a, b, c) = (d(1, h), d(2, 2.0 * h), d(3, 4.0 * h));
        let (ab, bc) = (2.0 * a - b, 2.0 * b - c);
        return (4.0 * ab - bc) / 3.0;
    }
    let central = |h: f64| (f(h) - f(-h)) / (2.0 * h);
    (4.0 * central(h) - central(2.0 * h)) / 3.0
}

#[test]
fn sensitivities_are_derivatives_of_the_refitted_maximum() {
    let plain =
        Recipe { p: 3, tests: 40, rank: 3, observed: 6, strength: 1.5, designs: 40, regressors: 0, mild: false };
    let singular = Recipe { rank: 2, tests: 20, designs: 20, ..plain };
    for recipe in [plain, singular] {
        for case in cases() {
            for seed in 0..4 {
                let what = format!("{}, rank {}, seed {seed}", case.name, recipe.rank);
                let data = ensemble(recipe, seed);
                let refit = |step: f64| {
                    let found = fit(&data, &(case.at)(case.value + step), Solver::Newton);
                    assert_eq!(found.stop, Stop::Certified, "{what} at step {step}: {:?}", found.certificate);
                    found.log_likelihood
                };
                let found = fit(&data, &(case.at)(case.value), Solver::Newton);
                let all = infer::sensitivities(&found);
                let own = all.iter().find(|s| s.element == case.element);
                let analytic = own.unwrap_or_else(|| panic!("{what}: not among {all:?}")).sensitivity;
                let numeric = slope(&refit, 1e-3, case.one_sided);
                let error = (analytic - numeric).abs() / (1.0 + numeric.abs());
                assert!(error < 1e-4, "{what}: sensitivity {analytic}, by differences {numeric}: error {error:.1e}");
            }
        }
    }
}
