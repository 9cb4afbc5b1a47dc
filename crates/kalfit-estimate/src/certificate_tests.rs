//! Points that the certificate must refuse, one for each of its conditions, and points next to them that it must
//! accept.
//!
//! All tests share one design R, and their d - Rμ =: z have exactly the second moment C. With S = I + RΣR' then
//! G = ½ N R'S⁻¹(C - S)S⁻¹R, so that optima, slopes and their standard errors are known without the code under test.

use nalgebra::{DMatrix, DVector};

use super::certificate::{Certificate, certificate};
use super::climb::{ClimbLimits, climb, step_off_boundary};
use super::{NewtonIterate, Point, Problem, Settings, Stop, Structure};
use kalfit_filter::reduce::Reductions;
use kalfit_model::Path;
use kalfit_model::Reduction;
use kalfit_model::{Alpha, CovarianceKind, CovarianceStructure, Expression, FixedElement, MeanStructure};

/// Number of tests, all of one design.
const TESTS: usize = 48;
/// Tolerance of a search that rounding does not stop: a hundred times that of the settings.
const TOLERANCE: f64 = 1e-6;

/// An orthonormal basis none of whose directions is near an axis.
fn slanted(p: usize) -> DMatrix<f64> {
    DMatrix::from_fn(p, p, |i, k| ((3 * i + 5 * k + 1) as f64).sin()).qr().q()
}

/// An invertible R, upper triangular, whose R'R is not diagonal.
fn design(p: usize) -> DMatrix<f64> {
    DMatrix::from_fn(p, p, |i, k| match k as i64 - i as i64 {
        0 => 0.8 + 0.5 * i as f64,
        d if d > 0 => 0.7 - 0.4 * d as f64,
        _ => 0.0,
    })
}

/// The matrices that define an ensemble and a point of Σ.
struct Case {
    /// R of every test.
    factor: DMatrix<f64>,
    /// F with FF' = RΣR', p × r.
    spread: DMatrix<f64>,
    /// C, the second moment of z.
    moment: DMatrix<f64>,
}

impl Case {
    /// RΣR' = V diag(λ) V' and C = S + U diag(m) U', with V the first columns of a slanted basis and U the others: G
    /// vanishes on the range of Σ, and along U it is ½ N m.
    fn new(factor: DMatrix<f64>, range: &[f64], off: &[f64]) -> Case {
        let (p, r) = (range.len() + off.len(), range.len());
        let basis = slanted(p);
        let spread = DMatrix::from_fn(p, r, |i, k| basis[(i, k)] * range[k].sqrt());
        let rest = basis.columns(r, p - r).clone_owned();
        let s = DMatrix::identity(p, p) + &spread * spread.transpose();
        let moment = s + &rest * DMatrix::from_diagonal(&DVector::from_column_slice(off)) * rest.transpose();
        Case { factor, spread, moment }
    }

    /// The case R = I at Σ = 0.
    fn at_zero(moment: DMatrix<f64>) -> Case {
        let p = moment.nrows();
        Case { factor: DMatrix::identity(p, p), spread: DMatrix::zeros(p, 0), moment }
    }

    fn mean(&self) -> DVector<f64> {
        DVector::from_fn(self.factor.nrows(), |i, _| 1.0 + i as f64)
    }

    /// Tests whose z are pairs ±√p C^½ e_k, repeated until there are `TESTS` of them.
    fn data(&self) -> Reductions {
        let p = self.factor.nrows();
        assert_eq!(TESTS % (2 * p), 0, "the second moment needs whole pairs");
        let half = self.moment.clone().cholesky().expect("C is positive definite").l() * (p as f64).sqrt();
        let centre = &self.factor * self.mean();
        let data = |j: usize| &centre + half.column(j / 2 % p) * if j.is_multiple_of(2) { 1.0 } else { -1.0 };
        let packed: Vec<f64> = (0..p).flat_map(|k| (0..=k).map(move |i| (i, k))).map(|at| self.factor[at]).collect();
        (0..TESTS)
            .map(|j| Reduction {
                test: format!("t{j:02}"),
                constant: 0.0,
                residual: None,
                data: data(j).as_slice().to_vec(),
                factor: packed.clone(),
                covariates: Vec::new(),
                steps: p,
                observations: p,
                path: Path::Information,
                design: 0,
                chain: None,
                exact: None,
            })
            .collect()
    }

    /// A square root of Σ, p × p with columns of zeros.
    fn root(&self) -> DMatrix<f64> {
        let inverse = self.factor.clone().try_inverse().expect("R is invertible");
        let (p, r) = self.spread.shape();
        let mut root = DMatrix::zeros(p, p);
        root.columns_mut(0, r).copy_from(&(inverse * &self.spread));
        root
    }

    /// G and Σ_j W_j, densely.
    fn dense(&self) -> (DMatrix<f64>, DMatrix<f64>) {
        let (r, p, n) = (&self.factor, self.factor.nrows(), TESTS as f64);
        let s = DMatrix::identity(p, p) + &self.spread * self.spread.transpose();
        let inverse = s.clone().try_inverse().expect("S is positive definite");
        let score = r.transpose() * &inverse * (&self.moment - &s) * &inverse * r * (0.5 * n);
        (score, r.transpose() * inverse * r * n)
    }

    /// The score along dΣ in standard errors: slope / √(½ Σ tr(WDWD)).
    fn slope(&self, direction: &DMatrix<f64>) -> f64 {
        let (score, weight) = self.dense();
        let spread = &weight * direction * &weight * direction;
        (score * direction).trace() / (0.5 * spread.trace() / TESTS as f64).sqrt()
    }

    fn candidate(&self, covariance: &CovarianceStructure) -> Candidate {
        Candidate::new(&self.data(), covariance, self.mean().as_slice(), &self.root())
    }
}

/// A problem and an iterate to be certified.
struct Candidate {
    problem: Problem,
    iterate: NewtonIterate,
}

impl Candidate {
    fn new(data: &Reductions, covariance: &CovarianceStructure, mean: &[f64], root: &DMatrix<f64>) -> Candidate {
        let (free, alpha) = (MeanStructure::free(mean.len()), Alpha::default());
        let structure = Structure::single(&free, covariance, &alpha);
        let problem = super::problem(data, &structure, &Settings::default()).expect("a legal problem");
        let frame = &problem.classes.frame;
        let point = Point {
            mean: frame.mean_in(mean),
            coefficients: Vec::new(),
            root: DMatrix::from_fn(mean.len(), mean.len(), |i, c| root[(i, c)] / frame.scale[i]),
        };
        let iterate = NewtonIterate::new(&problem, &problem.covariance, point, None).expect("a finite place");
        Candidate { problem, iterate }
    }

    /// The iterate at a Σ of the structure, with a root in the form of the structure.
    fn of_members(
        data: &Reductions,
        covariance: &CovarianceStructure,
        mean: &[f64],
        sigma: &DMatrix<f64>,
    ) -> Candidate {
        let candidate = Candidate::new(data, covariance, mean, &DMatrix::zeros(mean.len(), mean.len()));
        let map = &candidate.problem.covariance;
        let root = map.root_of(&candidate.problem.classes.frame.covariance_in(sigma));
        let iterate = NewtonIterate::new(&candidate.problem, map, Point { root, ..candidate.iterate.point }, None)
            .expect("a finite place");
        Candidate { iterate, problem: candidate.problem }
    }

    fn certificate(&self) -> Certificate {
        certificate(&self.problem.covariance, &self.iterate, TESTS as f64).0
    }

    /// Gain in ℓ of a probe off the boundary, if one is found.
    fn probe(&self) -> Option<f64> {
        let next = step_off_boundary(&self.problem, &self.problem.covariance, TESTS as f64, &mut self.iterate.clone())?;
        Some(next.local.value - self.iterate.local.value)
    }

    /// The certificate holds at the tolerance, and no direction upwards is found.
    fn is_accepted(&self, what: &str) {
        let found = self.certificate();
        assert!(found.holds(TOLERANCE), "{what} must be accepted: {found:?}");
        assert_eq!(self.probe(), None, "{what}: no way up");
    }

    /// The certificate is refused for a positive score on the null space of Σ alone, of this many standard errors; all
    /// else vanishes.
    fn is_refused_off_the_range(&self, score: f64, what: &str) {
        self.is_refused_between((1.0 - 1e-7) * score, (1.0 + 1e-7) * score, what);
    }

    fn is_refused_between(&self, least: f64, most: f64, what: &str) {
        let found = self.certificate();
        assert!(found.decrement < 1e-7, "{what}: all but the null space is as it must be: {found:?}");
        let score = found.null_space;
        assert!((least..=most).contains(&score), "{what}: score {score} on the null space, not {least} to {most}");
        self.is_refused(what);
    }

    fn is_refused(&self, what: &str) {
        let (found, gain) = (self.certificate(), self.probe());
        assert!(!found.holds(1.0), "{what} must be refused: {found:?}");
        assert!(gain.is_some_and(|gain| gain > 0.0), "{what}: the probe finds a way up, {gain:?}");
    }
}

fn full() -> CovarianceStructure {
    CovarianceStructure::full()
}

fn of(kind: CovarianceKind) -> CovarianceStructure {
    CovarianceStructure { kind, ..full() }
}

fn numbers(matrix: &DMatrix<f64>) -> Vec<Vec<Expression>> {
    matrix.row_iter().map(|row| row.iter().map(|&x| Expression::Number(x)).collect()).collect()
}

fn fixed(i: usize, j: usize, value: f64) -> CovarianceStructure {
    CovarianceStructure { fixed: vec![FixedElement { i, j, value }], ..full() }
}

fn symmetric(elements: [f64; 3]) -> DMatrix<f64> {
    let [a, b, c] = elements;
    DMatrix::from_row_slice(2, 2, &[a, b, b, c])
}

fn turned_about_first(angle: f64) -> DMatrix<f64> {
    let (s, c) = angle.sin_cos();
    DMatrix::from_row_slice(3, 3, &[1.0, 0.0, 0.0, 0.0, c, -s, 0.0, s, c])
}

#[test]
fn a_mean_off_the_optimum_is_refused() {
    for (range, off) in [(vec![0.7], vec![-0.3, -0.2]), (vec![0.7, 2.0], vec![-0.4]), (vec![1.1, 0.5, 3.0], vec![])] {
        let case = Case::new(design(3), &range, &off);
        case.candidate(&full()).is_accepted("the optimum");
        let (_, weight) = case.dense();
        for i in 0..3 {
            let far = 1e-5;
            let mut mean = case.mean();
            mean[i] += far / weight[(i, i)].sqrt();
            let found = Candidate::new(&case.data(), &full(), mean.as_slice(), &case.root()).certificate();
            let what = format!("mean {i} off by {far:e} standard errors, rank {}: {found:?}", range.len());
            assert!((found.mean - far).abs() < 1e-4 * far, "{what}");
            assert!(found.covariance < 1e-3 * far, "{what}");
            assert!((found.decrement - far).abs() < 1e-3 * far, "{what}");
            assert!(!found.holds(TOLERANCE) && !found.holds(0.1 * far) && found.holds(1.1 * far), "{what}");
        }
    }
}

#[test]
fn a_covariance_off_along_its_range_is_refused() {
    for (range, off) in [(vec![0.7], vec![-0.3, -0.2]), (vec![0.7, 2.0], vec![-0.4]), (vec![1.1, 0.5, 3.0], vec![])] {
        let case = Case::new(design(3), &range, &off);
        for k in 0..range.len() {
            // the variance of z along V_k is 1 + λ, with the standard error (1 + λ) √(2/N)
            let (lambda, step): (f64, f64) = (range[k], 1e-5);
            let far = step * lambda / ((1.0 + lambda) * (2.0 / TESTS as f64).sqrt());
            let mut moved = Case { moment: case.moment.clone(), factor: design(3), spread: case.spread.clone() };
            moved.spread.column_mut(k).scale_mut((1.0 + step).sqrt());
            let found = moved.candidate(&full()).certificate();
            let what = format!("λ_{k} off by {far:.3e} standard errors, rank {}: {found:?}", range.len());
            assert!((found.covariance - far).abs() < 1e-3 * far && found.mean < 1e-3 * far, "{what}");
            assert!(!found.holds(TOLERANCE) && !found.holds(0.1 * far) && found.holds(1.1 * far), "{what}");
        }
        // a rotated range
        let mut turned = Case { moment: case.moment.clone(), factor: design(3), spread: case.spread.clone() };
        turned.spread = turned_about_first(1e-4) * &turned.spread;
        let found = turned.candidate(&full()).certificate();
        assert!(found.covariance > 1e-5 && !found.holds(TOLERANCE), "rank {}: {found:?}", range.len());
    }
}

#[test]
fn a_small_variance_is_no_null_direction() {
    let mut case = Case::new(DMatrix::identity(2, 2), &[1.0, 1e-3], &[]);
    case.moment = &case.moment * 1.5; // ℓ rises with both
    let found = case.candidate(&full()).certificate();
    assert_eq!(found.null_space, 0.0, "Σ has no null space: {found:?}");
    assert!(found.covariance > 0.1, "{found:?}");
}

/// The variance of z along U is 1 + m where Σ gives 1, with the standard error √(2/N) if all else is known. Directions
/// that overlap the range give a smaller score, several directions together a larger one.
#[test]
fn a_positive_score_on_a_slanted_null_space_is_refused() {
    for m in [0.3, 1e-3] {
        let cases =
            [(1, vec![]), (2, vec![0.9]), (3, vec![0.7, 2.0]), (3, vec![0.7]), (2, vec![]), (4, vec![0.7, 0.2])];
        for (p, range) in cases {
            for factor in [design(p), DMatrix::identity(p, p) * 1.3] {
                let of = |m: f64| Case::new(factor.clone(), &range, &vec![m; p - range.len()]);
                let (free, size) = ((p - range.len()) as f64, m * (TESTS as f64 / 2.0).sqrt());
                let what = format!("G = {m} off the range, rank {} of {p}", range.len());
                let least = if range.is_empty() { size } else { 0.75 * size };
                of(m).candidate(&full()).is_refused_between(
                    least * (1.0 - 1e-7),
                    size * free.sqrt() * (1.0 + 1e-7),
                    &what,
                );
                of(-m).candidate(&full()).is_accepted("a negative score there");
            }
        }
        // positive in one of two directions
        let mixed = Case::new(design(3), &[0.7], &[-0.4, m]).candidate(&full()).certificate();
        assert!(mixed.decrement < 1e-7 && mixed.null_space > 0.1 * m && !mixed.holds(1.0), "{mixed:?}");
    }
}

#[test]
fn the_threshold_on_the_null_space_is_a_hundred_thousandth_of_a_standard_error() {
    for (score, accepted) in [(1e-4, false), (1e-6, true)] {
        let m = score / (TESTS as f64 / 2.0).sqrt();
        for range in [vec![0.9], vec![]] {
            let p = range.len() + 1;
            let found = Case::new(DMatrix::identity(p, p), &range, &[m]).candidate(&full()).certificate();
            assert!(found.decrement < 1e-7, "{found:?}");
            assert!((0.8 * score..1.01 * score).contains(&found.null_space), "{score}: {found:?}");
            assert_eq!(found.holds(1.0), accepted, "{score}: {found:?}");
        }
    }
}

#[test]
fn a_trap_of_zero_columns_is_left_for_the_maximum() {
    for (range, off) in [(vec![], vec![0.4, 1.3, 0.2]), (vec![0.7], vec![1.3, 0.2]), (vec![0.7, 2.0], vec![0.3])] {
        let case = Case::new(design(3), &range, &off);
        let candidate = case.candidate(&full());
        assert!(
            candidate.iterate.decrement() < 1e-7,
            "no gradient in L leads away from here: {}",
            candidate.iterate.decrement()
        );
        let limits = ClimbLimits { tolerance: 1e-8, steps: 60 };
        let map = &candidate.problem.covariance;
        let (end, stop) = climb(&candidate.problem, map, TESTS as f64, candidate.iterate.clone(), limits);
        assert_eq!(stop, Stop::Certified);
        // C - I is positive definite, so the maximum is at S = C
        let inverse = case.factor.clone().try_inverse().expect("R is invertible");
        let expected = &inverse * (&case.moment - DMatrix::identity(3, 3)) * inverse.transpose();
        let found = candidate.problem.values_of(&end.point).covariance;
        assert!((&found - &expected).amax() < 1e-6, "rank {}: {found} {expected}", range.len());
        // one step leaves the trap
        let (end, _) =
            climb(&candidate.problem, map, TESTS as f64, candidate.iterate.clone(), ClimbLimits { steps: 1, ..limits });
        let gain = end.local.value - candidate.iterate.local.value;
        assert!(gain > 0.1, "rank {}: {gain}", range.len());
        // where no step may follow, the end is not certified
        let none = ClimbLimits { steps: 0, ..limits };
        assert_eq!(climb(&candidate.problem, map, TESTS as f64, candidate.iterate.clone(), none).1, Stop::PassLimit);
    }
}

#[test]
fn blocks_are_looked_at_one_by_one() {
    let blocks = of(CovarianceKind::Blocks(vec![vec![0, 2], vec![1, 3]]));
    let along = DVector::from_vec(vec![0.8, 0.0, -0.6, 0.0]);
    let other = DVector::from_vec(vec![0.0, 0.6, 0.0, 0.8]);
    for (first, second) in [(0.2, -0.3), (-0.3, 0.2), (0.1, 0.2)] {
        let moment = DMatrix::identity(4, 4) * 0.9
            + &along * along.transpose() * (0.1 + first)
            + &other * other.transpose() * (0.1 + second);
        let score = f64::max(first, second) * (TESTS as f64 / 2.0).sqrt();
        let case = Case { moment, ..Case::at_zero(DMatrix::identity(4, 4)) };
        case.candidate(&blocks).is_refused_off_the_range(score, &format!("scores {first} and {second} in two blocks"));
    }
    // a covariance between blocks does not concern the blocks
    let between = DMatrix::identity(4, 4) * 0.8 + &(&along + &other) * (&along + &other).transpose() * 0.15;
    Case::at_zero(between.clone()).candidate(&blocks).is_accepted("a covariance between blocks");
    assert!(!Case::at_zero(between).candidate(&full()).certificate().holds(1.0), "in a full Σ it counts");
}

#[test]
fn a_scale_of_zero_is_refused_where_it_would_grow() {
    let star = symmetric([1.0, 0.7, 2.0]);
    let scaled = of(CovarianceKind::Proportional(numbers(&star)));
    for (moment, grows) in [([1.3, 0.0, 1.0], true), ([1.3, -0.4, 1.0], false), ([0.9, 0.3, 1.0], true)] {
        let case = Case { factor: design(2), ..Case::at_zero(symmetric(moment)) };
        let slope = case.slope(&star);
        assert_eq!(slope > 0.0, grows, "{moment:?}: {slope}");
        match grows {
            true => case.candidate(&scaled).is_refused_off_the_range(slope, &format!("β = 0, C = {moment:?}")),
            false => case.candidate(&scaled).is_accepted(&format!("β = 0, C = {moment:?}")),
        }
    }
}

#[test]
fn standard_deviations_of_zero_are_tried_by_themselves_and_in_pairs() {
    let given = |r: f64| of(CovarianceKind::Correlation(numbers(&symmetric([1.0, r, 1.0]))));
    let n = (TESTS as f64 / 2.0).sqrt();
    // one alone: u² G_11
    let single = Case::at_zero(symmetric([0.9, 0.0, 1.2]));
    single.candidate(&given(0.6)).is_refused_off_the_range(0.2 * n, "one standard deviation");
    Case::at_zero(symmetric([0.9, 0.0, 0.8])).candidate(&given(0.6)).is_accepted("neither of them");
    // together: -a u² - b v² + 2 c r u v
    for (a, b, c, grows) in
        [(0.1, 0.1, 0.4, true), (0.1, 0.1, -0.4, false), (0.1, 0.1, 0.1, false), (0.01, 0.64, 0.3, true)]
    {
        let case = Case::at_zero(symmetric([1.0 - a, c, 1.0 - b]));
        let (found, what) = (case.candidate(&given(0.6)), format!("-{a}, -{b} and {c}"));
        if grows { found.is_refused(&what) } else { found.is_accepted(&what) }
    }
}

/// One of two standard deviations is zero and the other is not. C = S + N, with N_10 = c and N_11 = m, makes G_11 = ½ N
/// m and, where the standard deviation is zero, ∂ℓ/∂σ_1 = 2 G_10 r σ_0 of the sign of c r.
#[test]
fn a_standard_deviation_of_zero_beside_another_follows_their_correlation() {
    let s: f64 = 0.8;
    for r in [0.6, -0.6] {
        let given = of(CovarianceKind::Correlation(numbers(&symmetric([1.0, r, 1.0]))));
        let candidate = |c: f64, m: f64| {
            let moment = symmetric([1.0 + s, c, 1.0 + m]);
            let case = Case { moment, ..Case::at_zero(DMatrix::identity(2, 2)) };
            Candidate::of_members(&case.data(), &given, case.mean().as_slice(), &symmetric([s, 0.0, 0.0]))
        };
        let n = (TESTS as f64 / 2.0).sqrt();
        candidate(0.0, 0.2).is_refused_off_the_range(0.2 * n, &format!("no slope, r = {r}"));
        candidate(0.0, -0.2).is_accepted(&format!("no slope, but a loss, r = {r}"));
        // ℓ falls at first, whatever comes after
        candidate(-0.1 * r, 0.2).is_accepted(&format!("a slope downwards, r = {r}"));
        // ℓ rises at first, as the gradient shows
        for m in [0.2, -0.2] {
            let found = candidate(0.1 * r, m).certificate();
            assert!(found.decrement > 0.05 && !found.holds(1e-2), "a slope upwards, m = {m}, r = {r}: {found:?}");
        }
    }
}

/// ℓ falls with one of two standard deviations, is flat in the other, and rises with both if the first is small enough:
/// at the smallest ratio that is tried, in natural units. These units differ where a third one that is not zero masks
/// the first.
#[test]
fn a_pair_of_standard_deviations_is_tried_in_their_own_units() {
    let (s, r, a, c) = (4.0_f64, 0.6, 0.05, 0.1);
    let correlation = DMatrix::from_row_slice(3, 3, &[1.0, r, 0.0, r, 1.0, 0.0, 0.0, 0.0, 1.0]);
    let factor = DMatrix::from_row_slice(3, 3, &[1.0, 0.0, 0.9, 0.0, 1.0, 0.0, 0.0, 0.0, 0.5]);
    let spread = &factor * DMatrix::from_column_slice(3, 1, &[0.0, 0.0, s.sqrt()]);
    let inner = DMatrix::identity(3, 3) + &spread * spread.transpose();
    // C = S + S R'⁻¹ M R⁻¹ S gives G = ½ N M
    let back = &inner * factor.clone().try_inverse().expect("R is invertible").transpose();
    let wanted = DMatrix::from_row_slice(3, 3, &[-a, c, 0.0, c, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let case = Case { moment: &inner + &back * wanted * back.transpose(), factor, spread };
    let (_, weight) = case.dense();
    let unit = |i: usize| (TESTS as f64 / weight[(i, i)]).sqrt();
    assert!(unit(0) > 1.2 * unit(1), "{} {}", unit(0), unit(1));
    let grown = [1e-3 * unit(0), unit(1), 0.0];
    let along = DMatrix::from_fn(3, 3, |i, k| grown[i] * grown[k] * correlation[(i, k)]);
    let given = of(CovarianceKind::Correlation(numbers(&correlation)));
    let sigma = DMatrix::from_diagonal(&DVector::from_vec(vec![0.0, 0.0, s]));
    let candidate = Candidate::of_members(&case.data(), &given, case.mean().as_slice(), &sigma);
    candidate.is_refused_off_the_range(case.slope(&along), "flat in one, but not in both");
}

/// β = 0 is on the boundary; any other β is not, and there the gradient is enough.
#[test]
fn a_scale_that_is_not_zero_has_no_null_space() {
    let star = symmetric([1.0, 0.7, 2.0]);
    let scaled = of(CovarianceKind::Proportional(numbers(&star)));
    for scale in [1.0, 1e-6] {
        let case = Case { factor: design(2), ..Case::at_zero(symmetric([3.0, 0.1, 4.0])) };
        let candidate = Candidate::of_members(&case.data(), &scaled, case.mean().as_slice(), &(&star * scale));
        let found = candidate.certificate();
        assert_eq!(found.null_space, 0.0, "β = {scale}: {found:?}");
        assert!(found.decrement > 1e-4 && found.covariance > 1e-4, "β = {scale}: ℓ rises with it, {found:?}");
    }
}

#[test]
fn constraints_take_their_share_of_the_score() {
    // Σ = s (1, 1)'(1, 1) with σ_00 fixed, so that C = S + S (m uu' + λ e_0 e_0') S, u = (1, -1)/√2, has the multiplier
    // ½ N λ
    let s: f64 = 0.8;
    let spread = DMatrix::from_element(2, 1, s.sqrt());
    let inner = DMatrix::identity(2, 2) + &spread * spread.transpose();
    for (m, lambda) in [(-0.1, 0.4), (-0.1, -0.2), (0.1, -0.4), (0.1, 0.3)] {
        let left = symmetric([0.5 * m + lambda, -0.5 * m, 0.5 * m]);
        let case =
            Case { moment: &inner + &inner * left * &inner, spread: spread.clone(), factor: DMatrix::identity(2, 2) };
        let candidate = case.candidate(&fixed(0, 0, s));
        let what = format!("m = {m}, λ = {lambda}");
        if m > 0.0 {
            candidate.is_refused_off_the_range(m * (TESTS as f64 / 2.0).sqrt(), &what)
        } else {
            candidate.is_accepted(&what)
        }
        let free = case.candidate(&full()).certificate();
        assert!(!free.holds(1e-2), "{what}: without the constraint it is no optimum: {free:?}");
    }
}

#[test]
fn multipliers_that_are_not_determined_are_chosen_for_the_point() {
    // σ_00 = σ_11 at Σ = 0: (a, c; c, b) less t (1, 0; 0, -1) can be made negative where a + b + 2|c| < 0
    let equal = CovarianceStructure { equal: vec![vec![(0, 0), (1, 1)]], ..full() };
    for (a, b, c) in [(0.3, -0.5, 0.05), (-0.5, 0.3, -0.05)] {
        Case::at_zero(symmetric([1.0 + a, c, 1.0 + b])).candidate(&equal).is_accepted(&format!("{a}, {b}, {c}"));
    }
    for (a, b, c) in [(0.5, -0.3, 0.05), (0.3, -0.5, 0.3), (-0.5, 0.3, -0.3)] {
        Case::at_zero(symmetric([1.0 + a, c, 1.0 + b])).candidate(&equal).is_refused(&format!("{a}, {b}, {c}"));
    }
}
