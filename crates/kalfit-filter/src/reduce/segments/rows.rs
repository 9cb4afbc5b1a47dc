//! The gains of every row of a stretch that is cut into segments: the covariance filter from the moments before each
//! segment, many segments in lanes.
#![expect(non_snake_case, reason = "the letters of the theory: P, Psi, K, T")]

use kalfit_lanes::{Isa, Kernel, Lanes, MAX_LANES};
use rayon::prelude::*;

use crate::reduce::covariance_filter::CovarianceFilter;
use crate::reduce::design::{Design, Stretch};
use crate::reduce::entries::{Common, SideBySide};
use crate::reduce::segments::SegmentedStretch;
use crate::reduce::sums::InformationSums;

/// Relative change of P and Ψ over a segment that counts as none.
const NO_CHANGE: f64 = 1e-15;

/// (1/S, K) and T of the first rows of a stretch; all further rows have the values of the last one.
#[derive(Debug, Default)]
pub(crate) struct RowGains {
    /// 1 + r numbers a row.
    pub(crate) gains: Vec<f64>,
    /// p numbers a row.
    pub(crate) sensitivities: Vec<f64>,
    /// Number of rows.
    pub(crate) rows: usize,
}

impl SegmentedStretch {
    /// The gains of the rows of the stretch; `None` where plain arithmetic loses too many digits.
    pub(crate) fn row_gains(&self, design: &Design, stretch: &Stretch<'_>) -> Option<RowGains> {
        let segments: Vec<usize> = (0..self.steady_segment().map_or(self.segments(), |steady| steady + 1)).collect();
        let run = |some: &[usize]| Isa::best().run(RowPass { of: self, design, stretch, segments: some });
        let found: Vec<RowGains> = segments.par_chunks(Isa::best().lanes()).map(run).collect::<Option<_>>()?;
        Some(found.into_iter().fold(RowGains::default(), RowGains::then))
    }

    /// The first segment over which neither P nor Ψ changes.
    fn steady_segment(&self) -> Option<usize> {
        let N = self.prefix.size();
        let is_steady = |&segment: &usize| {
            let ((P, Psi), (next_P, next_Psi)) = (self.before(segment), self.before(segment + 1));
            let size = |i: usize, j: usize| (P[i * N + i] * P[j * N + j]).sqrt();
            let same = |a: f64, b: f64, size: f64| (a - b).abs() <= NO_CHANGE * size;
            (0..N * N).all(|ij| same(P[ij], next_P[ij], size(ij / N, ij % N)))
                && Psi.iter().zip(next_Psi).all(|(a, b)| same(*a, *b, a.abs().max(b.abs())))
        };
        (0..self.segments().saturating_sub(2)).find(is_steady)
    }
}

/// The covariance filter over some segments, one in each lane.
struct RowPass<'a> {
    of: &'a SegmentedStretch,
    design: &'a Design,
    stretch: &'a Stretch<'a>,
    segments: &'a [usize],
}

impl Kernel for RowPass<'_> {
    type Output = Option<RowGains>;

    #[inline(always)]
    fn run<T: Lanes>(self) -> Option<RowGains> {
        let RowPass { of, design, stretch, segments } = self;
        let frame = &*design.frame;
        let (r, p, N) = (frame.r, frame.p, of.prefix.size());
        let in_lanes = |number: &dyn Fn(usize) -> f64, out: &mut [f64]| {
            (0..T::COUNT).for_each(|lane| out[lane] = number(segments[lane.min(segments.len() - 1)]));
        };
        let mut before = vec![0.0; r * r * T::COUNT];
        for (ij, lanes) in before.chunks_exact_mut(T::COUNT).enumerate() {
            in_lanes(&|segment| of.before(segment).0[ij / r * N + ij % r], lanes);
        }
        let mut filter = CovarianceFilter::<T>::new(frame, SideBySide(&before));
        let mut lanes = [0.0; MAX_LANES];
        for (i, &state) in of.prefix.states.iter().enumerate() {
            for k in 0..p {
                in_lanes(&|segment| of.before(segment).1[k * N + i], &mut lanes);
                filter.Psi[state * p + k] = T::load(&lanes);
            }
        }
        let rows = of.rows_of(segments[0]);
        let mut out: Vec<RowGains> =
            segments.iter().map(|&segment| RowGains::with_room(of.rows_of(segment), r, p)).collect();
        let (terms, h) = design.terms(stretch.lines.start);
        let noise = T::splat(design.noise[stretch.lines.start]);
        for row in 0..rows {
            if let Some(transition) = stretch.transition {
                filter.predict(frame, transition.common());
            }
            let update = filter.measure(frame, (terms, Common(h), noise));
            let mut store = |k: usize, number: &T, list: fn(&mut RowGains) -> &mut [f64], width: usize| {
                number.store(&mut lanes);
                for (out, &number) in out.iter_mut().zip(&lanes).filter(|(out, _)| row < out.rows) {
                    list(out)[row * width + k] = number;
                }
            };
            let gains = std::iter::once(&update.weight).chain(&filter.K).enumerate();
            gains.for_each(|(k, number)| store(k, number, |out| &mut out.gains, 1 + r));
            filter.T.iter().enumerate().for_each(|(k, number)| store(k, number, |out| &mut out.sensitivities, p));
        }
        let (mut sums, mut total) = (Vec::new(), InformationSums::new(p));
        filter.sums.lanes(&mut sums);
        let mut is_accurate = |lane: usize| {
            total.take_lane(&sums, lane, T::COUNT);
            total.is_accurate()
        };
        (0..segments.len()).all(&mut is_accurate).then(|| out.into_iter().fold(RowGains::default(), RowGains::then))
    }
}

impl RowGains {
    fn with_room(rows: usize, r: usize, p: usize) -> RowGains {
        RowGains { gains: vec![0.0; rows * (1 + r)], sensitivities: vec![0.0; rows * p], rows }
    }

    /// These rows, then those of `next`.
    fn then(mut self, next: RowGains) -> RowGains {
        self.gains.extend(next.gains);
        self.sensitivities.extend(next.sensitivities);
        self.rows += next.rows;
        self
    }
}
