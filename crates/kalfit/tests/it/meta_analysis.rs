//! Random-effects meta-analyses whose optima independent programs know (metafor 3.8.1 and a dense maximisation,
//! refined to about 1e-9): interior and singular optima, constraints of μ and Σ.

use kalfit::estimate::{self, Estimate, Settings, Silent, Solver, Stop, Structure};
use kalfit::infer::{self, Element, Inference};
use kalfit::model::{Alpha, CovarianceKind, CovarianceStructure, Expression, FixedElement, MeanElement, MeanStructure};
use kalfit::reduce::{Path, Reduction, Reductions};
use kalfit_fixtures::near;
use nalgebra::{DMatrix, DVector};

/// Bivariate studies of a file `test, y1, y2, v1, v2, c12`, reduced by plain dense algebra.
fn studies(text: &str) -> Reductions {
    let cell = |s: &str| s.trim().parse::<f64>().ok();
    text.lines()
        .skip(1)
        .map(|line| {
            let cells: Vec<&str> = line.split(',').collect();
            let y = [cell(cells[1]), cell(cells[2])];
            let v = [cell(cells[3]), cell(cells[4])];
            let seen: Vec<usize> = (0..2).filter(|&i| y[i].is_some()).collect();
            let m = seen.len();
            let noise = DMatrix::from_fn(m, m, |a, b| {
                if a == b { v[seen[a]].expect("sound numbers") } else { cell(cells[5]).expect("sound numbers") }
            });
            let design = DMatrix::from_fn(m, 2, |a, k| f64::from(u8::from(seen[a] == k)));
            let z = DVector::from_fn(m, |a, _| y[seen[a]].expect("sound numbers"));
            reduce(cells[0], &design, &noise, &z)
        })
        .collect()
}

fn reduce(id: &str, design: &DMatrix<f64>, noise: &DMatrix<f64>, z: &DVector<f64>) -> Reduction {
    let p = design.ncols();
    let root = noise.clone().cholesky().expect("sound numbers").l();
    let whitened = root.solve_lower_triangular(design).expect("sound numbers");
    let residual = root.solve_lower_triangular(z).expect("sound numbers");
    let mut stacked = DMatrix::zeros(p + z.len(), p + 1);
    stacked.view_mut((p, 0), (z.len(), p)).copy_from(&whitened);
    stacked.view_mut((p, p), (z.len(), 1)).copy_from(&residual);
    let r = stacked.qr().r();
    let sign = |i: usize| if r[(i, i)] < 0.0 { -1.0 } else { 1.0 };
    let log_det = 2.0 * root.diagonal().map(f64::ln).sum();
    let left = if r.nrows() > p { r[(p, p)].powi(2) } else { 0.0 };
    Reduction {
        test: id.to_owned(),
        constant: -0.5 * (z.len() as f64 * (2.0 * std::f64::consts::PI).ln() + log_det + left),
        residual: None,
        data: (0..p).map(|i| sign(i) * r[(i, p)]).collect(),
        factor: (0..p).flat_map(|k| (0..=k).map(move |i| (i, k))).map(|(i, k)| sign(i) * r[(i, k)]).collect(),
        covariates: Vec::new(),
        steps: 1,
        observations: z.len(),
        path: Path::Information,
        design: 0,
        chain: None,
        exact: None,
    }
}

fn berkey() -> Reductions {
    studies(include_str!("../data/berkey1998.csv"))
}

fn kalaian() -> Reductions {
    studies(include_str!("../data/kalaian1996.csv"))
}

fn riley() -> Reductions {
    studies(include_str!("../data/riley2003.csv"))
}

fn numbers(rows: [[f64; 2]; 2]) -> Vec<Vec<Expression>> {
    rows.iter().map(|row| row.iter().map(|&x| Expression::Number(x)).collect()).collect()
}

fn fixed(elements: &[(usize, usize, f64)]) -> CovarianceStructure {
    let fixed = elements.iter().map(|&(i, j, value)| FixedElement { i, j, value }).collect();
    CovarianceStructure { fixed, ..CovarianceStructure::full() }
}

fn kind(kind: CovarianceKind) -> CovarianceStructure {
    CovarianceStructure { kind, ..CovarianceStructure::full() }
}

fn mean_of(elements: Vec<MeanElement>) -> MeanStructure {
    MeanStructure { elements, ..MeanStructure::free(2) }
}

struct Expected {
    log_likelihood: f64,
    mean: [f64; 2],
    /// σ11, σ12, σ22.
    covariance: [f64; 3],
    tolerance: f64,
}

fn fit(reductions: &Reductions, mean: &MeanStructure, covariance: &CovarianceStructure, solver: Solver) -> Estimate {
    let alpha = Alpha::default();
    let structure = Structure::single(mean, covariance, &alpha);
    let settings = Settings { tolerance: if solver == Solver::Em { 1e-6 } else { 1e-8 }, ..Settings::of(solver) };
    estimate::fit(reductions, &structure, &settings, &mut Silent).expect("sound numbers")
}

/// Both solvers reach the reference optimum, certified; Newton within 15 passes. Returns the number of Newton passes.
fn agrees(data: &Reductions, mean: &MeanStructure, covariance: &CovarianceStructure, want: &Expected) -> usize {
    let newton = fit(data, mean, covariance, Solver::Newton);
    close(&newton, want, 1.0);
    assert_eq!(newton.stop, Stop::Certified, "{:?} after {:?}", newton.certificate, newton.trace);
    assert!(newton.passes <= 15, "{} passes: {:?}", newton.passes, newton.trace);
    let em = fit(data, mean, covariance, Solver::Em);
    close(&em, want, if em.stop == Stop::Certified { 10.0 } else { 1e4 });
    newton.passes
}

fn close(found: &Estimate, want: &Expected, factor: f64) {
    let same = |what: &str, a: f64, b: f64, unit: f64| {
        near::absolute(format_args!("{what}; {:?} {:?}", found.stop, found.certificate), a, b, factor * unit);
    };
    same("log-likelihood", found.log_likelihood, want.log_likelihood, 1e-7 * want.tolerance / 1e-6);
    for i in 0..2 {
        same("mean", found.mean[i], want.mean[i], want.tolerance * 0.05);
    }
    let s = &found.covariance;
    for (k, (i, j)) in [(0, 0), (1, 0), (1, 1)].into_iter().enumerate() {
        same("covariance", s[(i, j)], want.covariance[k], want.tolerance * 0.05);
    }
}

macro_rules! case {
    ($name:ident, $data:expr, $mean:expr, $covariance:expr, $ll:expr, $mu:expr, $sigma:expr, $tolerance:expr) => {
        #[test]
        fn $name() {
            let want = Expected { log_likelihood: $ll, mean: $mu, covariance: $sigma, tolerance: $tolerance };
            agrees(&$data, &$mean, &$covariance, &want);
        }
    };
}

fn free() -> MeanStructure {
    MeanStructure::free(2)
}

fn full() -> CovarianceStructure {
    CovarianceStructure::full()
}

case!(
    berkey_full,
    berkey(),
    free(),
    full(),
    5.8406568847751,
    [0.344839168023, -0.337938115107],
    [0.00700199850109, 0.00946066480785, 0.0261445173081],
    1e-6
);
case!(
    berkey_diagonal,
    berkey(),
    free(),
    kind(CovarianceKind::Diagonal),
    5.1654176411984,
    [0.357255262241, -0.353888624725],
    [0.00714553846695, 0.0, 0.0254734078331],
    1e-6
);
case!(
    berkey_blocks,
    berkey(),
    free(),
    kind(CovarianceKind::Blocks(vec![vec![0], vec![1]])),
    5.1654176411984,
    [0.357255262241, -0.353888624725],
    [0.00714553846695, 0.0, 0.0254734078331],
    1e-6
);
case!(
    berkey_correlation_known,
    berkey(),
    free(),
    kind(CovarianceKind::Correlation(numbers([[1.0, 0.5], [0.5, 1.0]]))),
    5.7629456971343,
    [0.350320538973, -0.343177760906],
    [0.00707260270367, 0.00658197149106, 0.0245015027843],
    1e-6
);
case!(
    berkey_variance_fixed,
    berkey(),
    free(),
    fixed(&[(1, 1, 0.03)]),
    5.8208291581031,
    [0.344854712376, -0.337587399534],
    [0.00755277086572, 0.010914897966, 0.03],
    1e-6
);
case!(
    berkey_covariance_fixed,
    berkey(),
    free(),
    fixed(&[(1, 0, 0.004)]),
    5.621142368871,
    [0.349724951987, -0.347061571557],
    [0.00515487091974, 0.004, 0.0219976301051],
    1e-6
);
case!(
    berkey_equal_variances,
    berkey(),
    free(),
    CovarianceStructure { equal: vec![vec![(0, 0), (1, 1)]], ..full() },
    5.2055574070082,
    [0.360471711172, -0.336806677305],
    [0.0197396101531, 0.0109172143415, 0.0197396101531],
    1e-6
);
case!(
    berkey_proportional,
    berkey(),
    free(),
    kind(CovarianceKind::Proportional(numbers([[0.01, 0.006], [0.006, 0.03]]))),
    5.6244422286235,
    [0.354017327488, -0.346129875544],
    [0.00781362426721, 0.00468817456033, 0.0234408728016],
    1e-6
);
case!(
    berkey_mean_fixed,
    berkey(),
    mean_of(vec![MeanElement::Fixed(0.3), MeanElement::Free]),
    full(),
    5.4708998213148,
    [0.3, -0.378984684054],
    [0.00732796338439, 0.0115939005308, 0.027831320023],
    1e-6
);
case!(
    berkey_means_fixed,
    berkey(),
    mean_of(vec![MeanElement::Fixed(0.3), MeanElement::Fixed(-0.3)]),
    full(),
    4.6785238612295,
    [0.3, -0.3],
    [0.00932776810587, 0.00983728949481, 0.0278232207749],
    1e-6
);
case!(
    berkey_means_proportional,
    berkey(),
    mean_of(vec![MeanElement::Proportional(1.0), MeanElement::Proportional(-1.0)]),
    full(),
    5.8389398784346,
    [0.342317796648, -0.342317796648],
    [0.00691587416742, 0.00941827324531, 0.0261433407694],
    1e-6
);
case!(
    berkey_covariance_known,
    berkey(),
    free(),
    kind(CovarianceKind::Fixed(numbers([[0.01, 0.006], [0.006, 0.03]]))),
    5.540448677914,
    [0.356617030348, -0.346324602134],
    [0.01, 0.006, 0.03],
    1e-6
);
case!(
    berkey_common_effect,
    berkey(),
    free(),
    fixed(&[(0, 0, 0.0), (1, 1, 0.0)]),
    -45.441631433239,
    [0.307218608491, -0.394377007899],
    [0.0, 0.0, 0.0],
    1e-6
);
case!(
    kalaian_full_is_singular,
    kalaian(),
    free(),
    full(),
    7.0555213245556,
    [0.116707031265, 0.13772924706],
    [0.00242314044699, -0.00515832863656, 0.0109809377149],
    1e-5
);
case!(
    kalaian_diagonal_has_a_zero_variance,
    kalaian(),
    free(),
    kind(CovarianceKind::Diagonal),
    6.2178683486165,
    [0.118762122014, 0.139583234417],
    [0.0, 0.0, 0.0186580029728],
    1e-5
);
case!(
    kalaian_zero_variance_imposed,
    kalaian(),
    free(),
    fixed(&[(1, 1, 0.0)]),
    4.0796434071995,
    [0.117647295206, 0.132742609351],
    [0.00864985071215, 0.0, 0.0],
    1e-6
);
case!(
    kalaian_fixed_covariance_makes_the_cone_active,
    kalaian(),
    free(),
    fixed(&[(1, 0, -0.002)]),
    6.6848068309199,
    [0.117915714596, 0.139188916699],
    [0.000290065993592, -0.002, 0.0137899653471],
    1e-5
);
case!(
    riley_full,
    riley(),
    free(),
    full(),
    -120.54971974283,
    [1.48104558782, 1.64127734602],
    [0.374576054552, 0.324228274133, 0.359746572211],
    1e-6
);
case!(
    riley_variance_fixed,
    riley(),
    free(),
    fixed(&[(0, 0, 0.5)]),
    -120.91313457092,
    [1.49871175255, 1.64168198019],
    [0.5, 0.40080882755, 0.389109342834],
    1e-6
);
case!(
    riley_means_tied,
    riley(),
    mean_of(vec![MeanElement::Free, MeanElement::Tied { constant: 0.0, terms: vec![(0, 1.0)] }]),
    full(),
    -121.46055687969,
    [1.57306859177, 1.57306859177],
    [0.409241191053, 0.316660973666, 0.332558027782],
    1e-6
);
case!(
    riley_correlation_known,
    riley(),
    free(),
    kind(CovarianceKind::Correlation(numbers([[1.0, 0.9], [0.9, 1.0]]))),
    -120.55723943135,
    [1.48135315648, 1.64101483103],
    [0.378393021736, 0.332114597665, 0.359871780202],
    1e-6
);

fn inferred(data: &Reductions, mean: &MeanStructure, covariance: &CovarianceStructure) -> (Estimate, Inference) {
    let estimate = fit(data, mean, covariance, Solver::Newton);
    let inference = infer::infer(&estimate, data, infer::Choices::default());
    (estimate, inference)
}

/// Standard errors of μ1, μ2, σ11, σ12, σ22.
fn standard_errors(inference: &Inference) -> [Option<f64>; 5] {
    let u = &inference.uncertainty.errors;
    [u.mean[0], u.mean[1], u.covariance[0][0], u.covariance[1][0], u.covariance[1][1]]
}

#[track_caller]
fn assert_errors(inference: &Inference, expected: [Option<f64>; 5]) {
    for (found, expected) in standard_errors(inference).into_iter().zip(expected) {
        match (found, expected) {
            (Some(a), Some(b)) => assert!((a / b - 1.0).abs() < 1e-6, "standard error {a}, expected {b}"),
            (a, b) => assert_eq!(a, b),
        }
    }
}

#[track_caller]
fn assert_sensitivity(inference: &Inference, element: Element, expected: f64) {
    let found = inference.sensitivities.iter().find(|s| s.element == element).expect("the element is held");
    let error = (found.sensitivity / expected - 1.0).abs();
    assert!(error < 1e-6, "{element:?}: {} expected {expected}", found.sensitivity);
}

#[test]
fn standard_errors_equal_the_dense_observed_information() {
    let cases = [
        (free(), full(), [0.0536312122, 0.08124795, 0.00904972834, 0.00996976047, 0.0177409201].map(Some)),
        (
            free(),
            fixed(&[(1, 1, 0.03)]),
            [Some(0.05466354), Some(0.0862147227), Some(0.00922255905), Some(0.0084742447), None],
        ),
        (
            free(),
            fixed(&[(1, 0, 0.004)]),
            [Some(0.0483483593), Some(0.074382569), Some(0.00722778484), None, Some(0.0141070849)],
        ),
        (
            free(),
            CovarianceStructure { equal: vec![vec![(0, 0), (1, 1)]], ..full() },
            [0.0720772019, 0.0718201673, 0.0115935113, 0.0125868573, 0.0115935113].map(Some),
        ),
        (
            mean_of(vec![MeanElement::Fixed(0.3), MeanElement::Free]),
            full(),
            [None, Some(0.0634332833), Some(0.0100137908), Some(0.0107165534), Some(0.0194569299)],
        ),
    ];
    for (mean, covariance, expected) in cases {
        assert_errors(&inferred(&berkey(), &mean, &covariance).1, expected);
    }
    let rho = kind(CovarianceKind::Correlation(numbers([[1.0, 0.5], [0.5, 1.0]])));
    let (_, correlated) = inferred(&berkey(), &free(), &rho);
    let found = standard_errors(&correlated);
    for (k, expected) in [(0, 0.0511965653), (1, 0.0779512468), (2, 0.00857724212), (4, 0.0159382718)] {
        let found = found[k].expect("identified");
        assert!((found / expected - 1.0).abs() < 1e-6, "{found}, expected {expected}");
    }
}

#[test]
fn sensitivities_equal_the_derivative_of_the_maximum() {
    let (_, held) = inferred(&berkey(), &free(), &fixed(&[(1, 1, 0.03)]));
    assert_sensitivity(&held, Element::Covariance(1, 1), -9.4387727);
    let (_, held) = inferred(&berkey(), &free(), &fixed(&[(1, 0, 0.004)]));
    assert_sensitivity(&held, Element::Covariance(1, 0), 90.327822);
    let means = mean_of(vec![MeanElement::Fixed(0.3), MeanElement::Fixed(-0.3)]);
    let (_, held) = inferred(&berkey(), &means, &full());
    assert_sensitivity(&held, Element::Mean(0), 30.859003);
    assert_sensitivity(&held, Element::Mean(1), -16.885591);
    let (_, held) = inferred(&berkey(), &free(), &fixed(&[(0, 0, 0.0), (1, 1, 0.0)]));
    assert_sensitivity(&held, Element::Covariance(0, 0), 1218.6241);
    assert_sensitivity(&held, Element::Covariance(1, 0), -15447.472);
    let (_, held) =
        inferred(&kalaian(), &free(), &CovarianceStructure { kind: CovarianceKind::Diagonal, ..fixed(&[(0, 0, 0.0)]) });
    assert_sensitivity(&held, Element::Covariance(0, 0), -98.024677);
}

/// The cone is active: the sensitivity is the multiplier of the constraint, not the entry of G.
#[test]
fn sensitivity_on_the_boundary_equals_a_difference_quotient() {
    let at = |value: f64| fit(&kalaian(), &free(), &fixed(&[(1, 0, value)]), Solver::Newton).log_likelihood;
    let step = 1e-6;
    let quotient = (at(-0.002 + step) - at(-0.002 - step)) / (2.0 * step);
    let (_, held) = inferred(&kalaian(), &free(), &fixed(&[(1, 0, -0.002)]));
    let found = held.sensitivities[0].sensitivity;
    assert!((found / quotient - 1.0).abs() < 1e-4, "sensitivity {found}, difference quotient {quotient}");
}

#[test]
fn a_singular_covariance_is_named_and_keeps_the_standard_errors_of_its_rank() {
    let (estimate, inference) = inferred(&kalaian(), &free(), &full());
    let boundary = &inference.uncertainty.boundary;
    assert_eq!((boundary.len(), boundary[0].rank, boundary[0].states.len()), (1, 1, 2));
    assert!(standard_errors(&inference).iter().all(Option::is_some), "{:?}", standard_errors(&inference));
    // of rank one the correlation is ±1, and has none
    assert_eq!(inference.uncertainty.errors.correlation[1][0], None);
    assert!(estimate.certificate.holds(1e-8), "{:?}", estimate.certificate);
}

#[test]
fn tests_add_up_to_the_log_likelihood() {
    let (estimate, inference) = inferred(&riley(), &free(), &full());
    let sum: f64 = inference.posteriors.iter().map(|p| p.log_likelihood).sum();
    assert!((sum - estimate.log_likelihood).abs() < 1e-10, "{sum} and {}", estimate.log_likelihood);
}

#[test]
fn the_order_of_tests_changes_no_bit() {
    let mut data = riley();
    let first = fit(&data, &free(), &full(), Solver::Newton);
    data = data.iter().rev().collect();
    let second = fit(&data, &free(), &full(), Solver::Newton);
    assert_eq!(first.covariance, second.covariance);
    assert_eq!(first.log_likelihood.to_bits(), second.log_likelihood.to_bits());
}
