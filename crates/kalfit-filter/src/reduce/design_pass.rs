//! The design pass: one run of the covariance filter per design class, which gives a schedule of weights, gains and
//! sensitivities.
#![expect(non_snake_case, reason = "the letters of the theory: P, Psi, G = P h, K, T, S, J")]

use std::sync::Arc;

use kalfit_lanes::{Isa, Kernel, Lanes, Real};

use crate::reduce::covariance_filter::CovarianceFilter;
use crate::reduce::design::{Design, StateFrame, Stretch};
use crate::reduce::entries::Common;
use crate::reduce::gains::{GainSpan, Gains};
use crate::reduce::kernel;
use crate::reduce::moment_path::MomentPath;
use crate::reduce::schedule::{GainSchedule, GainsWork};
use crate::reduce::segments::prefix::Prefix;
use crate::reduce::segments::rows::RowGains;
use crate::reduce::segments::{SegmentFilter, SegmentedStretch, prefixes};
use crate::reduce::settling::SteadyState;
use crate::reduce::sums::InformationSums;
use crate::reduce::terminal::TerminalRoot;

/// The design pass in plain covariance and information arithmetic; `None` where plain arithmetic would lose too
/// many digits.
/// `states`: the model's state at each position in kernel order, given if the last state is wanted.
pub(crate) fn information_gains(design: &Design, states: Option<&[usize]>, work: &mut GainsWork) -> Option<Gains> {
    let (p, r) = (design.frame.p, design.frame.r);
    let cut = if work.settling.off { Vec::new() } else { prefixes(design, &work.prefixes) };
    let pass = |prefixes: &[Option<Arc<Prefix>>], work: &mut GainsWork| {
        Isa::best().alone().run(DesignPass { design, prefixes, work })?.finish((r, p), design.rows())
    };
    let in_segments = if cut.iter().any(Option::is_some) { pass(&cut, work) } else { None };
    let mut gains = match in_segments {
        Some(gains) => gains,
        None => pass(&[], work)?,
    };
    if let Some(states) = states {
        gains.end = Some(Arc::new(TerminalRoot::of_covariance(states, &work.Psi, &work.P, r)?));
    }
    Some(gains)
}

/// The design pass over one design, as a kernel.
struct DesignPass<'a> {
    design: &'a Design,
    /// The prefix of each run that is cut into segments; empty where none is.
    prefixes: &'a [Option<Arc<Prefix>>],
    work: &'a mut GainsWork,
}

impl Kernel for DesignPass<'_> {
    type Output = Option<GainSchedule>;

    #[inline(always)]
    fn run<T: Lanes>(self) -> Option<GainSchedule> {
        let DesignPass { design, prefixes, work } = self;
        let (p, r) = (design.frame.p, design.frame.r);
        work.settling.start(&design.frame.sensitivity);
        let mut filter = CovarianceFilter::<T>::new(&design.frame, Common(&design.variance));
        let mut out = GainSchedule {
            gains: Vec::with_capacity((1 + r) * design.ends.len()),
            sensitivities: Vec::with_capacity(p * design.ends.len()),
            pieces: vec![GainSpan::all(0)],
            sums: InformationSums::new(p),
            many: Vec::new(),
            paths: Vec::new(),
            segments: Vec::new(),
            log_determinant: 0.0,
        };
        for (run, stretch) in design.stretches().enumerate() {
            match prefixes.get(run) {
                Some(Some(prefix)) => out.segments((design, &stretch), prefix, (&mut filter, work))?,
                _ => out.stretch(design, &stretch, (&mut filter, work)),
            }
        }
        let mut sums = Vec::new();
        filter.sums.lanes(&mut sums);
        out.sums.take_lane(&sums, 0, T::COUNT);
        work.take(&filter);
        Some(out)
    }
}

impl GainsWork {
    /// Copies the current P and Ψ of the filter.
    #[inline(always)]
    fn take<T: Lanes>(&mut self, filter: &CovarianceFilter<T>) {
        for (list, in_lanes) in [(&mut self.P, &filter.P), (&mut self.Psi, &filter.Psi)] {
            list.clear();
            for x in in_lanes {
                list.push(x.lane(0));
            }
        }
    }
}

impl GainSchedule {
    /// Filters a stretch of equal steps that is cut into segments; `None` where plain arithmetic would lose too many
    /// digits.
    #[inline(always)]
    fn segments<T: Lanes>(
        &mut self,
        (design, stretch): (&Design, &Stretch<'_>),
        prefix: &Arc<Prefix>,
        (filter, work): (&mut CovarianceFilter<T>, &mut GainsWork),
    ) -> Option<()> {
        work.take(filter);
        let mut J = vec![0.0; filter.sums.J.len()];
        let before =
            SegmentFilter { P: &mut work.P, Psi: &mut work.Psi, J: &mut J, log_determinant: &mut self.log_determinant };
        let sizes = (filter.K.len(), filter.T.len());
        let cut = SegmentedStretch::new(stretch.rows.clone(), prefix.clone(), sizes, before)?;
        if work.every_row {
            self.rows(stretch, sizes, cut.row_gains(design, stretch)?);
        } else {
            self.segments.push(cut);
        }
        for (list, in_lanes) in [(&work.P, &mut filter.P), (&work.Psi, &mut filter.Psi)] {
            for (x, lanes) in list.iter().zip(in_lanes) {
                *lanes = T::splat(*x);
            }
        }
        for (x, lanes) in J.iter().zip(&mut filter.sums.J) {
            *lanes = *lanes + T::splat(*x);
        }
        Some(())
    }

    /// Stores the gains of the rows of a stretch; r and p are the numbers of entries of K and T.
    fn rows(&mut self, stretch: &Stretch<'_>, (r, p): (usize, usize), found: RowGains) {
        let piece = GainSpan {
            row: stretch.rows.start,
            width: 1,
            gain: self.gains.len() / (1 + r),
            gain_steps: found.rows,
            sensitivity: self.sensitivities.len() / p.max(1),
            sensitivity_steps: found.rows,
        };
        self.gains.extend(found.gains);
        self.sensitivities.extend(found.sensitivities);
        self.note(piece, stretch);
    }

    /// Filters a stretch of equal steps: in full until P no longer changes, then for Ψ alone until Ψ no longer changes,
    /// then all remaining steps at once.
    #[inline(always)]
    fn stretch<T: Lanes>(
        &mut self,
        design: &Design,
        stretch: &Stretch<'_>,
        (filter, work): (&mut CovarianceFilter<T>, &mut GainsWork),
    ) {
        let frame = &*design.frame;
        let (gain, sensitivity) = (self.gains.len() / (1 + frame.r), self.sensitivities.len() / frame.p.max(1));
        let mut path = work.keeps_paths.then(|| MomentPath::new(design, stretch)).flatten();
        let monitored = design.is_long(stretch.count) && work.settling.begin(stretch.count);
        let (mut frozen, mut gain_steps, mut done) = (SteadyState::Nothing, 0, 0);
        while done < stretch.count && frozen != SteadyState::All {
            let before = done;
            done = if monitored { work.settling.next_look().min(stretch.count) } else { stretch.count };
            if frozen == SteadyState::Nothing {
                for _ in before..done {
                    filter.note(&mut path);
                    self.step(design, stretch, filter);
                }
                gain_steps = done;
            } else {
                for _ in before..done {
                    filter.note(&mut path);
                    self.sensitivities(design, stretch, filter);
                }
            }
            if monitored {
                work.take(filter);
                frozen = work.settling.look(done, (&work.P, frame.r), &work.Psi, frozen);
            }
        }
        filter.note(&mut path);
        self.paths.extend(path.map(MomentPath::complete));
        self.repeat(frame, stretch.lines.len(), stretch.count - done, filter);
        let piece = GainSpan {
            row: stretch.rows.start,
            width: stretch.lines.len(),
            gain,
            gain_steps,
            sensitivity,
            sensitivity_steps: done,
        };
        self.note(piece, stretch);
    }

    /// Filters one step: predicts and updates P and Ψ.
    #[inline(always)]
    fn step<T: Lanes>(&mut self, design: &Design, stretch: &Stretch<'_>, filter: &mut CovarianceFilter<T>) {
        if let Some(transition) = stretch.transition {
            filter.predict(&design.frame, transition.common());
        }
        for line in stretch.lines.clone() {
            let (states, h) = design.terms(line);
            let update = filter.measure(&design.frame, (states, Common(h), T::splat(design.noise[line])));
            self.gains.push(update.weight.lane(0));
            for K in &filter.K {
                self.gains.push(K.lane(0));
            }
            for T in &filter.T {
                self.sensitivities.push(T.lane(0));
            }
        }
    }

    /// Filters one step with the gains of the previous step: predicts and updates Ψ alone.
    #[inline(always)]
    fn sensitivities<T: Lanes>(&mut self, design: &Design, stretch: &Stretch<'_>, filter: &mut CovarianceFilter<T>) {
        if let Some(transition) = stretch.transition {
            filter.advance(&design.frame, transition.common());
        }
        let stride = 1 + design.frame.r;
        let last = self.gains.len() - stride * stretch.lines.len();
        for (gain, line) in self.gains[last..].chunks_exact(stride).zip(stretch.lines.clone()) {
            let (states, h) = design.terms(line);
            for (K, &gain) in filter.K.iter_mut().zip(&gain[1..]) {
                *K = T::splat(gain);
            }
            filter.measure_with_gains(&design.frame, (states, Common(h)), T::splat(gain[0]));
            for T in &filter.T {
                self.sensitivities.push(T.lane(0));
            }
        }
    }

    /// `many` = m more steps of `lines` measurements under the gains and sensitivities of the last step: J += m TT'/S.
    #[inline(always)]
    fn repeat<T: Lanes>(&mut self, frame: &StateFrame, lines: usize, many: usize, filter: &mut CovarianceFilter<T>) {
        if many == 0 {
            return;
        }
        let (p, stride) = (frame.p, 1 + frame.r);
        for back in (1..=lines).rev() {
            let weight = self.gains[self.gains.len() - back * stride];
            let T = &self.sensitivities[self.sensitivities.len() - back * p..][..p];
            for k in 0..p {
                filter.T[k] = T::splat(T[k]);
            }
            kernel::add_information(&filter.T, T::splat(weight * many as f64), &mut filter.sums.J);
            self.many.push((weight.recip_or_zero().or_one(), many));
        }
    }
}
