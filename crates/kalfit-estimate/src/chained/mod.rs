//! Classes of tests in phases that share all matrices, and their likelihood terms at a point, phase by phase (theory
//! §7).
//!
//! Data of a class: r is linear in d, so n tests are represented by the mean of d over the tests, and by columns whose
//! outer products add up to the scatter about this mean: at most as many columns as numbers in d.

mod kernel;
mod packed;
mod phase;
mod shape;
mod store;

use std::ops::Range;
use std::sync::Arc;

use kalfit_lanes::Real;
use nalgebra::DMatrix;

use crate::chained::kernel::{ChainPhases, Prior, compressed};
use crate::chained::phase::{LinkView, PhaseView};
use crate::frame::Frame;
use kalfit_algebra::factors::{CrossFactors, Factors, Rotations};
use kalfit_algebra::rows::Rows;
use kalfit_model::{Chain, ChainPhase};

pub use kernel::ChainDetail;
pub(crate) use kernel::{ChainTerms, Root};
pub(crate) use packed::Packed;
pub(crate) use shape::ChainShape;
pub use store::ChainStore;
pub(crate) use store::grouped;

/// Tests whose chains share all matrices, in η: the coordinates of σ that are new in a phase are centred and in units
/// of the frame.
#[derive(Debug, Clone)]
pub struct ChainedClass<T = f64> {
    phases: Vec<PhaseView<Rows<T>, Rows<T>>>,
    /// The sizes of the class's matrices.
    shape: Arc<ChainShape>,
    /// n, number of tests.
    count: T,
    /// Whether some phase needs square-root arithmetic.
    needs_rotations: bool,
}

impl ChainedClass {
    /// n J of one phase without the other phases, on σ of the phase, q × q.
    pub fn own_information(&self, phase: usize) -> DMatrix<f64> {
        let factor = &self.phases[phase].factor;
        let gram = factor.transpose_times(factor);
        DMatrix::from_fn(gram.nrows(), gram.ncols(), |i, k| self.count * gram[(i, k)])
    }

    /// n J of the first `phases` phases together on the initial states of all phases, `states` × `states`.
    pub fn information(&self, phases: usize, states: usize) -> DMatrix<f64> {
        let first = ChainedClass { phases: self.phases[..phases].to_vec(), ..self.clone() };
        let evaluated = first.at(&vec![0.0; states], &Root::of(&DMatrix::zeros(states, states)), ChainDetail::Between);
        let mut information = DMatrix::zeros(states, states);
        let own: Vec<&Range<usize>> = first.ranges().collect();
        let mut blocks = evaluated.W.iter().flatten();
        for (k, one) in own.iter().enumerate() {
            for (other, block) in own[..=k].iter().zip(&mut blocks) {
                for (a, row) in (**one).clone().enumerate() {
                    for (b, column) in (**other).clone().enumerate() {
                        information[(row, column)] = self.count * block[(a, b)];
                        information[(column, row)] = information[(row, column)];
                    }
                }
            }
        }
        information
    }

    /// Likelihood terms of the class at a point: `mean` is μ of the tests of the class, `root` is F with Σ = FF', both
    /// over the states of all phases.
    pub(crate) fn at(&self, mean: &[f64], root: &Root<'_>, detail: ChainDetail) -> ChainTerms {
        let prior = Prior { root, mean };
        let plain =
            if self.needs_rotations { None } else { self.phases_with::<CrossFactors<f64>>().evaluated(&prior, detail) };
        plain
            .unwrap_or_else(|| self.phases_with::<Rotations<f64>>().evaluated(&prior, detail).expect(ROTATIONS_SUCCEED))
    }

    /// A class with the matrices of this class, but no tests: n = 0 and d = 0.
    fn without_tests(&self) -> ChainedClass {
        let mut none = self.clone();
        none.count = 0.0;
        for phase in &mut none.phases {
            phase.data = Rows::zeros(phase.data.nrows(), phase.data.ncols());
        }
        none
    }

    /// For each phase the range of the new states, as indices into the states of all phases.
    pub(crate) fn ranges(&self) -> impl Iterator<Item = &Range<usize>> {
        self.phases.iter().map(|phase| &phase.own)
    }
}

impl<T: Real> ChainedClass<T> {
    #[inline(always)]
    fn phases_with<F: Factors<Number = T>>(&self) -> ChainPhases<'_, F> {
        ChainPhases { phases: &self.phases, count: self.count }
    }
}

/// Message for the case, which never occurs, that square-root arithmetic gives no result.
const ROTATIONS_SUCCEED: &str = "rotations bear any size";

/// Sets `scale` to the units of the q coordinates of σ of a phase: units of the frame for the states that are new in
/// the phase, 1 for all other coordinates.
fn scales(q: usize, own: &Range<usize>, frame: &Frame, scale: &mut Vec<f64>) {
    scale.clear();
    scale.extend_from_slice(&frame.scale[own.clone()]);
    scale.resize(q, 1.0);
}

/// Sets `sigma` to σ of a phase at the centre of the frame without noise; `before` is σ of the phase before.
fn centre(phase: &ChainPhase, own: &Range<usize>, frame: &Frame, previous_sigma: &[f64], sigma: &mut Vec<f64>) {
    sigma.clear();
    sigma.extend_from_slice(&frame.centre[own.clone()]);
    sigma.resize(phase.data.len(), 0.0);
    if let Some(link) = &phase.link {
        for (i, s) in sigma.iter_mut().enumerate() {
            *s += link.mean[i]
                + previous_sigma.iter().enumerate().map(|(k, x)| link.sensitivity[(i, k)] * x).sum::<f64>();
        }
    }
}

/// Product of row i of a phase's R with σ.
fn factor_row_times(phase: &ChainPhase, i: usize, sigma: &[f64]) -> f64 {
    (i..sigma.len()).map(|k| packed(&phase.factor, i, k) * sigma[k]).sum()
}

/// d_i - R_i × (σ_i at the centre of the frame without noise), phase after phase.
fn centred(chain: &Chain, ranges: &[Range<usize>], frame: &Frame) -> Vec<f64> {
    let (mut all, mut sigma, mut previous_sigma) = (Vec::new(), Vec::new(), Vec::new());
    for (phase, own) in chain.phases.iter().zip(ranges) {
        centre(phase, own, frame, &previous_sigma, &mut sigma);
        all.extend((0..phase.data.len()).map(|i| phase.data[i] - factor_row_times(phase, i, &sigma)));
        std::mem::swap(&mut sigma, &mut previous_sigma);
    }
    all
}

/// The mean of the data of several tests, then columns whose outer products add up to the scatter about this mean: one
/// for each test, or one for each number in d if d has fewer numbers than there are tests.
fn columns(chains: &[&Chain], ranges: &[Range<usize>], frame: &Frame) -> Rows {
    let all: Vec<Vec<f64>> = chains.iter().map(|chain| centred(chain, ranges, frame)).collect();
    let (n, size) = (all.len(), all[0].len());
    let mut mean = vec![0.0; size];
    all.iter().for_each(|test| mean.iter_mut().zip(test).for_each(|(m, d)| *m += d));
    mean.iter_mut().for_each(|m| *m /= n as f64);
    let deviation = |j: usize, i: usize| all[j][i] - mean[i];
    let scatter = match n {
        n if n <= size => Rows::from_fn(n, size, deviation),
        n => compressed::<CrossFactors<f64>>(Rows::from_fn(n, size, deviation)),
    };
    let m = scatter.nrows();
    Rows::from_fn(size, 1 + m, |i, k| if k == 0 { mean[i] } else { scatter[(k - 1, i)] })
}

/// Entry (i, k) of a packed upper triangle.
fn packed(factor: &[f64], i: usize, k: usize) -> f64 {
    if i <= k { factor[i + k * (k + 1) / 2] } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use nalgebra::DVector;

    use kalfit_fixtures::near;

    use super::*;
    use kalfit_lanes::{Counted, Isa, Kernel, Lanes};
    use kalfit_model::Path;

    /// A class of one test in phases of three states.
    fn chain(phases: usize) -> (ChainedClass, Frame) {
        let (chain, ranges, _) = test(phases, (3, 3));
        let frame = Frame {
            centre: vec![0.0; 3 * phases],
            scale: vec![1.0; 3 * phases],
            covariate_centre: Vec::new(),
            covariate_scale: Vec::new(),
        };
        (ChainedClass::new(&[&chain], &ranges, &frame), frame)
    }

    /// A test in phases of q states, the first p of which are new in their phase; the ranges of the new states, and a
    /// frame.
    fn test(phases: usize, (q, p): (usize, usize)) -> (Chain, Vec<Range<usize>>, Frame) {
        let wave =
            |seed: usize, size: usize| -> Vec<f64> { (0..size).map(|k| ((seed + 3 * k) as f64).sin()).collect() };
        let diagonal = |k: &usize| (0..q).any(|i| i * (i + 3) / 2 == *k);
        let phase = |f: usize| ChainPhase {
            own: p,
            constant: 0.0,
            data: wave(f, q),
            factor: wave(7 * f, q * (q + 1) / 2)
                .iter()
                .enumerate()
                .map(|(k, x)| if diagonal(&k) { 2.0 + x } else { *x })
                .collect(),
            path: Path::Information,
            link: (f > 0).then(|| kalfit_model::Link {
                mean: DVector::from_vec(wave(f + 1, q)),
                sensitivity: DMatrix::from_vec(q, q, wave(f + 2, q * q)),
                root: DMatrix::from_vec(q, q - 1, wave(f + 3, q * (q - 1))),
            }),
        };
        let scale = wave(5, p * phases).iter().map(|x| 1.5 + x).collect();
        let frame =
            Frame { centre: wave(11, p * phases), scale, covariate_centre: Vec::new(), covariate_scale: Vec::new() };
        let chain = Chain { phases: (0..phases).map(phase).collect() };
        (chain, (0..phases).map(|f| p * f..p * f + p).collect(), frame)
    }

    fn counted(chained: &ChainedClass) -> ChainedClass<Counted> {
        let rows = |m: &Rows| Rows::from_fn(m.nrows(), m.ncols(), |i, k| Counted(m[(i, k)]));
        let phase = |phase: &PhaseView<Rows, Rows>| PhaseView {
            own: phase.own.clone(),
            factor: rows(&phase.factor),
            data: rows(&phase.data),
            link: phase
                .link
                .as_ref()
                .map(|link| LinkView { sensitivity: rows(&link.sensitivity), root: rows(&link.root) }),
        };
        ChainedClass {
            phases: chained.phases.iter().map(phase).collect(),
            shape: chained.shape.clone(),
            count: Counted(chained.count),
            needs_rotations: false,
        }
    }

    #[test]
    fn the_cost_of_first_derivatives_is_linear_in_the_number_of_phases() {
        let flops = |phases: usize| {
            let chained = counted(&chain(phases).0);
            let (root, mean) = (DMatrix::identity(3 * phases, 3 * phases), vec![Counted::splat(0.1); 3 * phases]);
            let prior = Prior { root: &Root::of(&root), mean: &mean };
            let flops = Counted::count(|| {
                chained
                    .phases_with::<CrossFactors<Counted>>()
                    .evaluated(&prior, ChainDetail::Phases)
                    .expect("of common size");
            });
            flops.add + flops.mul + flops.div
        };
        let each: Vec<u64> = (2..8).map(flops).collect();
        let steps: Vec<u64> = each.windows(2).map(|pair| pair[1] - pair[0]).collect();
        assert!(steps.iter().all(|step| *step == steps[0]), "{each:?}: {steps:?}");
    }

    #[test]
    fn rotations_give_what_reflections_give() {
        let (chained, _) = chain(4);
        let (root, mean) = (DMatrix::identity(12, 12), vec![0.1; 12]);
        let root = Root::of(&root);
        let plain = chained.at(&mean, &root, ChainDetail::Between);
        let needs_rotations =
            ChainedClass { needs_rotations: true, ..chained.clone() }.at(&mean, &root, ChainDetail::Between);
        near::mixed("quadratic form", plain.quadratic, needs_rotations.quadratic, 1e-12);
        near::mixed(
            "determinant",
            plain.root_det.0 * 2f64.powf(plain.root_det.1),
            needs_rotations.root_det.0 * 2f64.powf(needs_rotations.root_det.1),
            1e-12,
        );
        for (a, b) in plain.W.iter().flatten().zip(needs_rotations.W.iter().flatten()) {
            (0..3).flat_map(|i| (0..3).map(move |k| (i, k))).for_each(|at| near::mixed("W", a[at], b[at], 1e-12));
        }
    }

    /// Two states of law N(0, I): their sum is measured with standard deviation σ, the second with 1; in the next
    /// phase, whose r is checked, the first is measured with 1.
    #[test]
    fn however_exact_a_phase_is_the_next_one_begins_from_its_mean() {
        for sigma in [1e-2, 1e-4, 1e-6, 1e-8] {
            let (sum, second, first) = (0.7, -0.4, 1.9);
            let phase = |data: [f64; 2], factor: [f64; 3], link: Option<kalfit_model::Link>| ChainPhase {
                own: 2,
                constant: 0.0,
                data: data.to_vec(),
                factor: factor.to_vec(),
                path: Path::Information,
                link,
            };
            let link = kalfit_model::Link {
                mean: DVector::zeros(2),
                sensitivity: DMatrix::identity(2, 2),
                root: DMatrix::zeros(2, 1),
            };
            let phases = vec![
                phase([sum / sigma, second], [sigma.recip(), sigma.recip(), 1.0], None),
                phase([first, 0.0], [1.0, 0.0, 0.0], Some(link)),
            ];
            let ranges = [0..2, 2..4];
            let frame = Frame {
                centre: vec![0.0; 4],
                scale: vec![1.0; 4],
                covariate_centre: Vec::new(),
                covariate_scale: Vec::new(),
            };
            let chained = ChainedClass::new(&[&Chain { phases }], &ranges, &frame);
            let mut root = DMatrix::zeros(4, 4);
            root.view_mut((0, 0), (2, 2)).fill_with_identity();
            let evaluated = chained.at(&[0.0; 4], &Root::of(&root), ChainDetail::Phases);
            // one measurement after the other: the second state from N(0, 1) to N(-0.2, 1/2), then the sum, with gain K
            let (mean, variance) = (0.5 * second, 0.5);
            let total = 1.0 + variance + sigma * sigma;
            let (posterior, left) = ((sum - mean) / total, (variance + sigma * sigma) / total);
            let (found, expected) = (evaluated.r[1][(0, 0)], (first - posterior) / (1.0 + left));
            assert!((found / expected - 1.0).abs() < 1e-15 / sigma + 1e-14, "{sigma}: {found} {expected}");
        }
    }

    #[test]
    fn tests_side_by_side_say_what_they_say_alone_whatever_their_size() {
        for (q, p) in [(1, 1), (2, 1), (3, 3), (4, 2), (5, 5), (6, 3), (7, 7), (8, 8), (9, 4)] {
            let phases = 3;
            let (chain, ranges, frame) = test(phases, (q, p));
            let chained = ChainedClass::new(&[&chain], &ranges, &frame);
            let mean: Vec<f64> = (0..p * phases).map(|k| (k as f64).cos()).collect();
            let root = DMatrix::from_fn(p * phases, p * phases, |i, k| match (i / p == k / p, i.cmp(&k)) {
                (true, std::cmp::Ordering::Equal) => 0.5 + i as f64 / 10.0,
                (true, std::cmp::Ordering::Greater) => ((i + 2 * k) as f64).sin(),
                _ => 0.0,
            });
            for isa in Isa::all() {
                let (shape, members) = (chained.shape.clone(), vec![0, 1, 2]);
                let of = |_| std::borrow::Cow::Borrowed(&chained);
                let packed = Packed::new(shape.clone(), members.clone(), isa.lanes(), of);
                assert_eq!(
                    format!("{:?}", packed.chained(1)),
                    format!("{chained:?}"),
                    "a lane is what it was made from"
                );
                let gathered = Packed::of_tests(shape, members, isa.lanes(), (&ranges, &frame), |_| vec![&chain]);
                assert_eq!(format!("{gathered:?}"), format!("{packed:?}"), "and so it is as gathered");
                for detail in [ChainDetail::Phases, ChainDetail::Between, ChainDetail::Posterior] {
                    let alone = figures(&chained.at(&mean, &Root::of(&root), detail), |x| x);
                    let found = isa.run(Told(&packed, &mean, &root, detail));
                    assert_eq!(found.len(), alone.len());
                    for (at, (found, alone)) in found.iter().zip(&alone).enumerate() {
                        let off = (found - alone).abs() / (1.0 + alone.abs());
                        assert!(off < 1e-11, "{q} states, {isa:?}, {detail:?}, figure {at}: {found} {alone}");
                    }
                }
            }
        }
    }

    /// All likelihood terms of a class, in one lane.
    fn figures<T: Real>(evaluated: &ChainTerms<T>, lane: impl Fn(T) -> f64) -> Vec<f64> {
        let root_det = |(mantissa, exponent): (T, T)| lane(mantissa).log2() + lane(exponent);
        let matrices = evaluated.r.iter().chain(evaluated.W.iter().flatten()).chain(&evaluated.covariances);
        let mut all: Vec<f64> = matrices.flat_map(Rows::as_slice).map(|x| lane(*x)).collect();
        all.extend([lane(evaluated.quadratic), root_det(evaluated.root_det), root_det(evaluated.link_root_det)]);
        all
    }

    struct Told<'a>(&'a Packed, &'a [f64], &'a DMatrix<f64>, ChainDetail);

    impl Kernel for Told<'_> {
        type Output = Vec<f64>;

        #[inline(always)]
        fn run<T: Lanes>(self) -> Vec<f64> {
            let mean: Vec<T> = self.1.iter().map(|x| T::splat(*x)).collect();
            let evaluated = self.0.evaluated::<T>(&mean, &Root::of(self.2), self.3).expect("of common size");
            figures(&evaluated, |x| x.lane(2))
        }
    }
}
