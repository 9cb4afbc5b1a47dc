//! Tests in several phases against the dense joint Gaussian of all their measurements, and theory §7 as it is written.

use crate::{dense, journey};

use journey::{Journey, PhaseMatrices, law, log_likelihood, normal};
use kalfit::model::{PhasedModel, Regression};
use kalfit::reduce::{
    Evidence, PhaseReduction, PhasedReducer, PhasedTest, Plain, Reducer, Reduction, Reductions, Terminal,
};
use kalfit::{Alpha, Labels};
use kalfit_fixtures::dense::{Linear, marginal, unpacked};
use kalfit_fixtures::near;
use nalgebra::{DMatrix, DVector};
use proptest::prelude::{ProptestConfig, any, prop_assume, proptest};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn reducer(model: &PhasedModel) -> PhasedReducer {
    PhasedReducer::new(model, &Alpha::default()).expect("sound")
}

fn reduce_all(model: &PhasedModel, tests: &[PhasedTest]) -> Reductions {
    reducer(model).reduce(tests).expect("sound")
}

fn reduce(journey: &Journey) -> Reduction {
    reduce_all(&journey.model, std::slice::from_ref(&journey.test)).get(0).into()
}

fn pieces(journey: &Journey) -> Vec<PhaseReduction> {
    reducer(&journey.model).pieces(std::slice::from_ref(&journey.test)).expect("sound").remove(0)
}

/// Another test of the model of a journey: as many rows, other values.
fn another(journey: &Journey, id: usize, rng: &mut ChaCha8Rng) -> PhasedTest {
    let mut test = journey.test.clone();
    test.id = format!("t{id}").into();
    for (evidence, phase) in test.phases.iter_mut().zip(&journey.phases) {
        let Evidence::Rows(rows) = evidence else { unreachable!("journeys have rows") };
        rows.id.clone_from(&test.id);
        for row in 0..rows.rows() {
            (0..phase.h.nrows()).for_each(|k| rows.set_number(row, k, normal(rng)));
        }
    }
    test
}

/// Nothing is estimated, and nothing lies between the parts: stacking has no rotations, and no columns but those of the data.
#[test]
fn a_test_without_unknowns_cut_in_two_is_the_whole_test() {
    let mut rng = ChaCha8Rng::seed_from_u64(2_328_247_911_063_894_935);
    let (journey, whole) = cut(&mut rng, 2);
    let (two, one) = (reduce(&journey), reduce(&whole));
    assert_eq!((journey.dimension(), two.factor.len()), (0, 0), "the case that this is about");
    near::mixed("likelihood", two.constant, one.constant, 1e-8);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    /// The stacked reduction is log p(all measurements | ξ_1, …, ξ_I) and, with Σ zero, singular or full, log p(all measurements).
    #[test]
    fn the_stacked_reduction_is_the_dense_likelihood(seed in any::<u64>()) {
        let journey = Journey::random(seed);
        let reduction = reduce(&journey);
        let whole = dense::dense(&journey.whole());
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        if whole.values.is_empty() {
            assert_eq!((reduction.constant, reduction.observations), (0.0, 0));
            return Ok(());
        }
        let p = journey.dimension();
        for _ in 0..3 {
            let xi = DVector::from_fn(p, |_, _| normal(&mut rng));
            near::mixed("given ξ", log_likelihood(&reduction, &xi), whole.log_likelihood(&xi), 1e-8);
            let (mu, sigma) = law(&mut rng, p, true);
            near::mixed("marginal", marginal(reduction.view(), &mu, &sigma), whole.marginal(&mu, &sigma), 1e-6);
        }
        assert_eq!(reduction.observations, whole.values.len());
        assert_eq!(reduction.steps, journey.phases[..journey.present].iter().map(|phase| phase.rows.len()).sum::<usize>());
    }

    /// Each piece is the phase by itself in its entering coordinates, its last state included.
    #[test]
    fn pieces_are_the_phases_by_themselves(seed in any::<u64>()) {
        let journey = Journey::random(seed);
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        for (at, piece) in pieces(&journey).iter().enumerate() {
            let alone = dense::dense(&journey.phases[at].plain());
            let q = journey.model.phases[at].entering().len();
            let sigma = DVector::from_fn(q, |_, _| normal(&mut rng));
            if !alone.values.is_empty() {
                near::mixed("given σ", log_likelihood(&piece.reduction, &sigma), alone.log_likelihood(&sigma), 1e-8);
            }
            assert_eq!(piece.terminal.is_some(), at + 1 < journey.phases.len());
            assert_eq!(piece.inherited.is_some(), at > 0);
            if let Some(terminal) = &piece.terminal {
                let (mean, covariance) = alone.last_given(&sigma);
                let found = &terminal.mean + &terminal.sensitivity * &sigma;
                assert!((&found - &mean).amax() <= 1e-7 * (1.0 + mean.amax()), "x_K {found} against {mean}");
                near::matrices("P_K", &terminal.covariance(), &covariance, 1e-7);
            }
            if let Some(inherited) = &piece.inherited {
                let (transition, input) = journey.phases[at].carried();
                for (row, state) in journey.model.phases[at].entering().into_iter().enumerate() {
                    assert_eq!(inherited.transition.row(row), transition.row(state), "T of phase {at}");
                    assert_eq!(inherited.input[row], input[state], "t of phase {at}");
                }
            }
        }
    }

    /// Theory §7 as it is written, forward and backward, on (c, y, J) of the pieces: ℓ and the posterior of each ξ_i.
    #[test]
    fn the_recursion_of_the_theory_gives_the_stacked_likelihood_and_posterior(seed in any::<u64>()) {
        let journey = Journey::random(seed);
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let (mu, sigma) = block_law(&mut rng, &journey.model);
        let reduction = reduce(&journey);
        let (likelihood, means, size) = recursion(&journey.model, &pieces(&journey), &mu, &sigma);
        prop_assume!(size < 1e4); // beyond, (I + JP)⁻¹ as written loses too many digits
        near::mixed("ℓ", likelihood, marginal(reduction.view(), &mu, &sigma), 1e-6);
        let (posterior, _) = Linear::of(reduction.view()).given(&mu, &sigma);
        for (found, range) in means.iter().zip(journey.model.ranges()) {
            let expected = posterior.rows_range(range).into_owned();
            assert!((found - &expected).amax() <= 1e-5 * (1.0 + expected.amax()), "{found} against {expected}");
        }
    }

    /// The chain of a reduction says what the stacked arrays say.
    #[test]
    fn the_chain_is_the_stacked_reduction(seed in any::<u64>()) {
        let journey = Journey::random(seed);
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let (mu, sigma) = block_law(&mut rng, &journey.model);
        let reduction = reduce(&journey);
        let chain = reduction.chain.clone().expect("several phases have a chain");
        assert_eq!(chain.phases.len(), journey.present);
        let ranges = journey.model.ranges();
        let (mut mean, mut covariance) = (DVector::zeros(0), DMatrix::zeros(0, 0));
        let (mut likelihood, mut size) = (0.0, 0.0_f64);
        for (at, (phase, range)) in chain.phases.iter().zip(ranges).enumerate() {
            let q = phase.data.len();
            let (mut m, mut v) = (DVector::zeros(q), DMatrix::zeros(q, q));
            assert_eq!((phase.own, phase.link.is_some()), (range.len(), at > 0));
            if let Some(link) = &phase.link {
                m += &link.mean + &link.sensitivity * &mean;
                v += &link.sensitivity * &covariance * link.sensitivity.transpose() + &link.root * link.root.transpose();
            }
            let own = range.len();
            m.rows_mut(0, own).add_assign_rows(&mu.rows_range(range.clone()).into_owned());
            let block = sigma.view((range.start, range.start), (own, own)).into_owned();
            let mut top = v.view_mut((0, 0), (own, own));
            top += block;
            let one = Reduction {
                data: phase.data.clone(), factor: phase.factor.clone(), constant: phase.constant, ..reduction.clone()
            };
            likelihood += marginal(one.view(), &m, &v);
            size = size.max(unpacked(&one.factor, q).norm_squared() * v.norm());
            (mean, covariance) = filtered(&one, &m, &v);
        }
        prop_assume!(size < 1e4); // beyond, the covariances of this test lose too many digits
        near::mixed("ℓ of the chain", likelihood, marginal(reduction.view(), &mu, &sigma), 1e-6);
    }

    /// A test cut in two phases with T = I, μ_2 = 0, Σ_2 = 0, the step into the second part's first row kept, is the whole test.
    #[test]
    fn a_test_cut_in_two_is_the_whole_test(seed in any::<u64>(), rows in 2..40_usize) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let (journey, whole) = cut(&mut rng, rows);
        let (two, one) = (reduce(&journey), reduce(&whole));
        let (p, more) = (whole.dimension(), journey.dimension() - whole.dimension());
        let xi = DVector::from_fn(p, |_, _| normal(&mut rng));
        let expected = log_likelihood(&one, &xi);
        near::mixed("given ξ", log_likelihood(&two, &xi.clone().resize_vertically(p + more, 0.0)), expected, 1e-8);
        let (mu, sigma) = law(&mut rng, p, true);
        let found = marginal(two.view(), &mu.clone().resize_vertically(p + more, 0.0), &sigma.clone().resize(p + more, p + more, 0.0));
        near::mixed("marginal", found, marginal(one.view(), &mu, &sigma), 1e-8);
    }

    /// (49): with all of x_0 estimated in every phase, least-squares estimates of the phases' own parts, errors correlated
    /// between neighbours alone, are all that the test says.
    #[test]
    fn the_banded_covariance_49_is_the_inverse_of_the_stacked_information(seed in any::<u64>()) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let journey = observable(&mut rng);
        let (n, count) = (journey.phases[0].n(), journey.phases.len());
        let parts = pieces(&journey);
        let mut band = DMatrix::zeros(n * count, n * count);
        let mut estimates = DVector::zeros(n * count);
        let mut carried = (DVector::zeros(n), DMatrix::zeros(n, n)); // x̂_T and P_T of the phase before
        for (i, part) in parts.iter().enumerate() {
            let r = unpacked(&part.reduction.factor, n);
            let inverse = r.clone().try_inverse().expect("observable");
            let covariance = &inverse * inverse.transpose(); // P_i = J⁻¹
            let start = &inverse * DVector::from_column_slice(&part.reduction.data); // x̂_0 by least squares
            let (mut own, mut block) = (start.clone(), covariance.clone());
            if let Some(inherited) = &part.inherited {
                own -= &inherited.transition * &carried.0 + &inherited.input;
                block += &inherited.transition * &carried.1 * inherited.transition.transpose();
            }
            estimates.rows_mut(i * n, n).copy_from(&own);
            band.view_mut((i * n, i * n), (n, n)).copy_from(&block);
            if let (Some(terminal), Some(next)) = (&part.terminal, parts.get(i + 1)) {
                let cross = &terminal.sensitivity * &covariance; // P_C = C P
                let transition = &next.inherited.as_ref().expect("a later phase inherits").transition;
                let below = -(transition * &cross);
                band.view_mut(((i + 1) * n, i * n), (n, n)).copy_from(&below);
                band.view_mut((i * n, (i + 1) * n), (n, n)).copy_from(&below.transpose());
                carried = (
                    &terminal.mean + &terminal.sensitivity * &start,
                    &cross * terminal.sensitivity.transpose() + terminal.covariance(),
                );
            }
        }
        let reduction = reduce(&journey);
        let r = unpacked(&reduction.factor, n * count);
        let inverse = r.clone().try_inverse().expect("observable");
        near::matrices("(49)", &(&inverse * inverse.transpose()), &band, 1e-7);
        let found = &inverse * DVector::from_column_slice(&reduction.data);
        assert!((&found - &estimates).amax() <= 1e-7 * (1.0 + estimates.amax()), "{found} against {estimates}");
    }

    /// (46)-(48): C = P_CN P_N⁻¹ from a Bayesian filter's covariances is Ψ_K, and the least-squares covariance of (x_0, x_T)
    /// built on it has the Bayesian information less that of the prior.
    #[test]
    fn equations_46_to_48_relate_bayesian_and_least_squares_covariances(seed in any::<u64>()) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let journey = observable(&mut rng);
        let (part, plain) = (&pieces(&journey)[0], journey.phases[0].plain());
        let n = journey.phases[0].n();
        let terminal = part.terminal.as_ref().expect("a phase follows");
        let root = DMatrix::from_fn(n, n, |_, _| normal(&mut rng));
        let prior = DMatrix::identity(n, n) + &root * root.transpose();
        let bayes = bayesian(&plain, &prior); // of (x_0, x_T) given z
        let block = |i: usize, j: usize| bayes.view((i * n, j * n), (n, n)).into_owned();
        let inverse = |matrix: &DMatrix<f64>| matrix.clone().try_inverse().expect("positive definite");
        let c = block(1, 0) * inverse(&block(0, 0)); // (46)
        near::matrices("(46)", &c, &terminal.sensitivity, 1e-7);
        let r = unpacked(&part.reduction.factor, n);
        let p = inverse(&(r.transpose() * &r));
        let mut least_squares = DMatrix::zeros(2 * n, 2 * n); // (48)
        least_squares.view_mut((0, 0), (n, n)).copy_from(&p);
        least_squares.view_mut((n, 0), (n, n)).copy_from(&(&c * &p));
        least_squares.view_mut((0, n), (n, n)).copy_from(&(&p * c.transpose()));
        least_squares.view_mut((n, n), (n, n)).copy_from(&(&c * &p * c.transpose() + terminal.covariance()));
        let mut information = inverse(&bayes); // (47)
        let mut top = information.view_mut((0, 0), (n, n));
        top -= inverse(&prior);
        near::matrices("(47) × (48)", &(&information * &least_squares), &DMatrix::identity(2 * n, 2 * n), 1e-6);
    }

    /// Rows may come in any order of phases; each phase keeps the order of its own.
    #[test]
    fn splitting_undoes_mixing(seed in any::<u64>()) {
        let journey = Journey::random(seed);
        let labels = Labels::new(&journey.model.shared().literals);
        // missing cells are not a number, so texts are compared
        let (found, expected) = (journey.model.split(journey.mixed.clone(), &labels), Ok::<_, ()>(&journey.test));
        let (found, expected) = (format!("{found:?}"), format!("{expected:?}"));
        assert!(found == expected, "{found} against {expected}");
    }

    /// Reductions made before stand for rows: the same bits.
    #[test]
    fn pieces_given_as_evidence_give_the_bits_of_the_rows(seed in any::<u64>()) {
        let journey = Journey::random(seed);
        let given = pieces(&journey).into_iter().map(|piece| Evidence::Reduced(Box::new(piece))).collect();
        let given = PhasedTest { id: "t".into(), phases: given };
        let mut mixed = journey.test.clone();
        mixed.phases[0] = given.phases[0].clone();
        let expected = reduce(&journey);
        for test in [given, mixed] {
            assert_eq!(reduce_all(&journey.model, &[test]).get(0), expected.view());
        }
    }
}

trait AddRows {
    fn add_assign_rows(self, other: &DVector<f64>);
}

impl AddRows for nalgebra::DVectorViewMut<'_, f64> {
    fn add_assign_rows(mut self, other: &DVector<f64>) {
        self += other;
    }
}

/// (μ, Σ), Σ block-diagonal over phases: of each, zero, of rank 1, or full.
fn block_law(rng: &mut ChaCha8Rng, model: &PhasedModel) -> (DVector<f64>, DMatrix<f64>) {
    let p = model.dimension();
    let (mut mu, mut sigma) = (DVector::zeros(p), DMatrix::zeros(p, p));
    for range in model.ranges() {
        let (m, s) = law(rng, range.len(), false);
        mu.rows_range_mut(range.clone()).copy_from(&m);
        sigma.view_mut((range.start, range.start), s.shape()).copy_from(&s);
    }
    (mu, sigma)
}

/// (mean, covariance) of σ given one phase's data and a prior, without inverses of J or of the prior.
fn filtered(reduction: &Reduction, mean: &DVector<f64>, prior: &DMatrix<f64>) -> (DVector<f64>, DMatrix<f64>) {
    let q = mean.len();
    let r = unpacked(&reduction.factor, q);
    let j = r.transpose() * &r;
    let b = (DMatrix::identity(q, q) + &j * prior).try_inverse().expect("I + JP is regular");
    let rho = &b * (r.transpose() * DVector::from_column_slice(&reduction.data) - &j * mean);
    (mean + prior * rho, prior - prior * b * j * prior)
}

/// (ℓ, posterior means of each ξ_i, largest ‖J‖‖P⁻‖) by the recursions of theory §7, word for word.
fn recursion(
    model: &PhasedModel,
    pieces: &[PhaseReduction],
    mu: &DVector<f64>,
    sigma: &DMatrix<f64>,
) -> (f64, Vec<DVector<f64>>, f64) {
    let ranges = model.ranges();
    let (mut likelihood, mut passed, mut size) = (0.0, Vec::new(), 0.0_f64);
    let mut before: Option<(DVector<f64>, DMatrix<f64>, &Terminal)> = None;
    for (piece, range) in pieces.iter().zip(&ranges) {
        let q = piece.reduction.data.len();
        let a = DMatrix::from_fn(q, range.len(), |i, j| f64::from(i == j));
        let own = sigma.view((range.start, range.start), (range.len(), range.len()));
        let mut m = &a * mu.rows_range(range.clone());
        let mut p = &a * own * a.transpose();
        let mut g = DMatrix::zeros(q, 0);
        if let Some((mean, covariance, terminal)) = &before {
            let inherited = piece.inherited.as_ref().expect("a later phase inherits");
            g = &inherited.transition * &terminal.sensitivity;
            m += &inherited.transition * &terminal.mean + &inherited.input + &g * mean;
            p += &g * covariance * g.transpose();
            p += &inherited.transition * terminal.covariance() * inherited.transition.transpose();
        }
        likelihood += marginal(piece.reduction.view(), &m, &p);
        let r = unpacked(&piece.reduction.factor, q);
        let j = r.transpose() * &r;
        size = size.max(j.norm() * p.norm());
        let b = (DMatrix::identity(q, q) + &j * &p).try_inverse().expect("I + JP is regular");
        let rho = &b * (r.transpose() * DVector::from_column_slice(&piece.reduction.data) - &j * &m);
        let (mean, covariance) = filtered(&piece.reduction, &m, &p);
        passed.push((g, b, rho, a));
        before = piece.terminal.as_ref().map(|terminal| (mean, covariance, terminal));
    }
    // r_i = ρ_i + F_i'r_{i+1} with F_i = G_iB_i'
    let mut means: Vec<DVector<f64>> = ranges.iter().map(|range| mu.rows_range(range.clone()).into_owned()).collect();
    let mut next: Option<(DVector<f64>, DMatrix<f64>)> = None;
    for (at, (g, b, rho, a)) in passed.into_iter().enumerate().rev() {
        let mut r = rho;
        if let Some((later, g_later)) = next {
            r += &b * g_later.transpose() * later;
        }
        let range = &ranges[at];
        let own = sigma.view((range.start, range.start), (range.len(), range.len()));
        means[at] += own * a.transpose() * &r;
        next = Some((r, g));
    }
    (likelihood, means, size)
}

/// A test in two phases, and the same in one.
fn cut(rng: &mut ChaCha8Rng, rows: usize) -> (Journey, Journey) {
    let mut whole = PhaseMatrices::random(rng, None);
    let m = whole.h.nrows();
    whole.rows = (0..rows).map(|_| (normal(rng), (0..m).map(|_| normal(rng)).collect())).collect();
    let n = whole.n();
    let at = rng.random_range(1..rows);
    let first = PhaseMatrices { rows: whole.rows[..at].to_vec(), ..whole.clone() };
    let second = PhaseMatrices {
        inheriting: (0..n).collect(),
        start: DVector::zeros(n),
        variance: DVector::zeros(n),
        transition: DMatrix::identity(n, n),
        input: DVector::zeros(n),
        step_first: true,
        rows: whole.rows[at..].to_vec(),
        coefficient: 1.0,
        offset: 0.0,
        ..whole.clone()
    };
    (Journey::new(vec![first, second], 2, rng), Journey::new(vec![whole], 1, rng))
}

/// Phases of the same two or three states, all estimated, noisy, carried and well observed.
fn observable(rng: &mut ChaCha8Rng) -> Journey {
    let (n, count) = (rng.random_range(2..=3), rng.random_range(2..=4));
    let phase = |at: usize| {
        let matrix =
            |rng: &mut ChaCha8Rng, size: f64| DMatrix::from_fn(n, n, |i, j| f64::from(i == j) + size * normal(rng));
        PhaseMatrices {
            estimated: (0..n).collect(),
            inheriting: if at > 0 { (0..n).collect() } else { Vec::new() },
            start: DVector::zeros(n),
            variance: DVector::zeros(n),
            transition: if at > 0 { matrix(rng, 0.3) } else { DMatrix::zeros(n, 0) },
            input: DVector::from_fn(n, |_, _| if at > 0 { normal(rng) } else { 0.0 }),
            phi: 0.8 * matrix(rng, 0.2),
            noise: DVector::from_fn(n, |_, _| rng.random_range(0.1..1.0)),
            driven: None,
            step_first: false,
            h: matrix(rng, 0.3),
            constant: DVector::zeros(n),
            variances: DVector::from_fn(n, |_, _| rng.random_range(0.1..1.0)),
            rows: (0..5).map(|_| (0.0, (0..n).map(|_| normal(rng)).collect())).collect(),
            coefficient: 1.0,
            offset: normal(rng),
        }
    };
    let phases: Vec<PhaseMatrices> = (0..count).map(phase).collect();
    Journey::new(phases, count, rng)
}

/// Covariance of (x_0, x_K) given the data when x_0 ~ N(a, prior), from the joint Gaussian; all of x_0 is estimated.
fn bayesian(plain: &Plain, prior: &DMatrix<f64>) -> DMatrix<f64> {
    let law = dense::dense(plain);
    let n = prior.nrows();
    // (x_0, x_K, z) before z is known
    let joint = |a: &DMatrix<f64>, b: &DMatrix<f64>| a * prior * b.transpose();
    let (start, last, h) = (DMatrix::identity(n, n), &law.last_sensitivity, &law.sensitivity);
    let mut covariance = DMatrix::zeros(2 * n, 2 * n);
    covariance.view_mut((0, 0), (n, n)).copy_from(prior);
    covariance.view_mut((n, 0), (n, n)).copy_from(&joint(last, &start));
    covariance.view_mut((0, n), (n, n)).copy_from(&joint(&start, last));
    covariance.view_mut((n, n), (n, n)).copy_from(&(joint(last, last) + &law.last_covariance));
    let mut cross = DMatrix::zeros(2 * n, h.nrows());
    cross.rows_mut(0, n).copy_from(&joint(&start, h));
    cross.rows_mut(n, n).copy_from(&(joint(last, h) + &law.last_cross));
    let omega = (joint(h, h) + &law.covariance).cholesky().expect("positive definite");
    &covariance - &cross * omega.solve(&cross.transpose())
}

#[test]
fn one_phase_has_the_bits_of_the_plain_reducer() {
    for seed in 0..50 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let journey = Journey::new(vec![PhaseMatrices::random(&mut rng, None)], 1, &mut rng);
        let model = journey.model.shared();
        let Evidence::Rows(rows) = &journey.test.phases[0] else { unreachable!("rows") };
        let expected = Reducer::new(model, &Alpha::default()).expect("sound").reduce(std::slice::from_ref(rows));
        let expected = expected.expect("sound");
        for model in [PhasedModel::from(model.clone()), journey.model.clone()] {
            assert_eq!(reduce_all(&model, &[PhasedTest::from(rows.clone())]), expected, "seed {seed}");
        }
    }
}

#[test]
fn threads_batches_and_the_order_of_tests_change_no_bit() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let journey = Journey::random(5);
    let mut tests: Vec<PhasedTest> = (0..60).map(|id| another(&journey, id, &mut rng)).collect();
    tests[7].phases.truncate(1);
    let expected = reduce_all(&journey.model, &tests);
    let reducer = reducer(&journey.model);
    let mut one_by_one = Reductions::new();
    for test in tests.iter().rev() {
        one_by_one.append(reducer.reduce(std::slice::from_ref(test)).expect("sound"));
    }
    assert!(one_by_one.iter().rev().eq(&expected), "one by one, backward");
    for threads in [1, 3] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        assert_eq!(pool.install(|| reduce_all(&journey.model, &tests)), expected, "{threads} threads");
    }
    let designs: std::collections::BTreeSet<u128> = expected.iter().map(|reduction| reduction.design).collect();
    assert_eq!(designs.len(), 2, "all tests have one design but the one that ends after its first phase");
    assert_eq!(expected.get(0).factor, expected.get(1).factor);
}

#[test]
fn designs_have_the_information_of_the_tests_and_nothing_of_the_values() {
    let journey = Journey::random(5);
    let expected = reduce(&journey);
    let found = reducer(&journey.model).reduce_designs(std::slice::from_ref(&journey.test)).expect("sound");
    let zero = vec![0.0; expected.data.len()];
    assert_eq!(found.get(0), Reduction { constant: 0.0, data: zero, chain: None, exact: None, ..expected }.view());
}

/// Gains that no longer change, and steps in closed form, leave the last state as full steps do.
#[test]
fn long_phases_end_where_their_steps_in_full_end() {
    for seed in 0..20 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let (journey, _) = cut(&mut rng, 3000);
        let found = reducer(&journey.model).pieces(std::slice::from_ref(&journey.test)).expect("sound").remove(0);
        let full = reducer(&journey.model).unfrozen().pieces(std::slice::from_ref(&journey.test));
        let (found, full) = (found[0].terminal.clone(), full.expect("sound").remove(0)[0].terminal.clone());
        let (found, full) = (found.expect("a phase follows"), full.expect("a phase follows"));
        let size = 1.0 + full.mean.amax();
        assert!((&found.mean - &full.mean).amax() <= 1e-9 * size, "{seed}: {} against {}", found.mean, full.mean);
        near::matrices("Ψ_K", &found.sensitivity, &full.sensitivity, 1e-9);
        near::matrices("P_K", &found.covariance(), &full.covariance(), 1e-9);
    }
}

/// Two states are each known to ± 100 and their sum to ± 1e-6: formed, P_K would not know the sum. The second phase, which
/// inherits the states or their sum alone, measures it as well.
#[test]
fn a_combination_that_is_known_far_better_than_its_parts_is_handed_on() {
    let first = |h: &[f64]| PhaseMatrices {
        estimated: vec![2],
        inheriting: Vec::new(),
        start: DVector::zeros(3),
        variance: DVector::from_vec(vec![1e4, 1e4, 0.0]),
        transition: DMatrix::zeros(3, 0),
        input: DVector::zeros(3),
        phi: DMatrix::identity(3, 3),
        noise: DVector::zeros(3),
        driven: None,
        step_first: false,
        h: DMatrix::from_row_slice(1, 3, h),
        constant: DVector::zeros(1),
        variances: DVector::from_element(1, 1e-12),
        rows: vec![(0.0, vec![3.0])],
        coefficient: 1.0,
        offset: 0.0,
    };
    let second = PhaseMatrices {
        inheriting: vec![0, 1, 2],
        variance: DVector::zeros(3),
        transition: DMatrix::identity(3, 3),
        rows: vec![(0.0, vec![3.000001])],
        ..first(&[1.0, 1.0, 1e-6])
    };
    let sum = PhaseMatrices {
        transition: DMatrix::from_row_slice(3, 3, &[1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
        h: DMatrix::from_row_slice(1, 3, &[1.0, 0.0, 1e-6]),
        inheriting: vec![0],
        ..second.clone()
    };
    for (second, name) in [(second, "both states"), (sum, "their sum")] {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let journey = Journey::new(vec![first(&[1.0, 1.0, 0.0]), second], 2, &mut rng);
        let (found, whole) = (reduce(&journey), journey.whole().reduce_square_root().expect("sound"));
        for xi in [[0.0, 0.0], [0.4, -1.1], [2.0, 1.5]].map(|xi| DVector::from_column_slice(&xi)) {
            let expected = log_likelihood(&whole, &xi);
            near::mixed(name, log_likelihood(&found, &xi), expected, 1e-9);
        }
    }
}

/// Roots of P_K may have any number of columns: these are as many as the phase that inherits has coordinates at most.
#[test]
fn wide_roots_are_narrowed() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for seed in 0..50 {
        let journey = Journey::random(seed);
        let expected = reduce(&journey);
        let mut parts = pieces(&journey);
        for terminal in parts.iter_mut().filter_map(|piece| piece.terminal.as_mut()) {
            let (root, columns) = (terminal.root.clone(), terminal.root.ncols());
            let twice = |i, c: usize| 0.5 * root[(i, c % columns)];
            terminal.root = DMatrix::from_fn(root.nrows(), 4 * columns, twice);
        }
        let phases = parts.into_iter().map(|piece| Evidence::Reduced(Box::new(piece))).collect();
        let found = reduce_all(&journey.model, &[PhasedTest { id: "t".into(), phases }]).get(0).into();
        let xi = DVector::from_fn(journey.dimension(), |_, _| normal(&mut rng));
        near::mixed("given ξ", log_likelihood(&found, &xi), log_likelihood(&expected, &xi), 1e-11);
        for phase in &found.chain.expect("several phases have a chain").phases {
            let Some(link) = &phase.link else { continue };
            assert!(link.root.ncols() <= link.root.nrows(), "{:?}", link.root.shape());
        }
    }
}

/// Covariates of all phases stand in a row, those of phases that a test lacks are zero.
#[test]
fn covariates_of_the_phases_follow_each_other() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut journey = observable(&mut rng);
    for phase in &mut journey.model.phases {
        phase.model.mean.regression = vec![Regression { element: 0, column: 4 }, Regression { element: 1, column: 5 }];
    }
    let mut tests = vec![journey.test.clone(), journey.test.clone()];
    tests[1].phases.truncate(1);
    let expected: Vec<f64> = journey.phases.iter().flat_map(|phase| [phase.offset, phase.coefficient]).collect();
    let found = reduce_all(&journey.model, &tests);
    assert_eq!(found.get(0).covariates, expected);
    assert_eq!(found.get(1).covariates[..2], expected[..2]);
    assert!(found.get(1).covariates[2..].iter().all(|&x| x == 0.0), "{:?}", found.get(1).covariates);
}
