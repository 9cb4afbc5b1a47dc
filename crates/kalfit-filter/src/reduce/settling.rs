//! When P and Ψ of equal steps have stopped changing.
#![expect(non_snake_case, reason = "the letters of the theory: P, Psi")]

/// Nothing is looked at before so many steps, and looks are at least so many steps apart.
const WINDOW: usize = 32;
/// Looks are this part of the steps so far apart.
const PART: usize = 4;
/// What may change over a window of w steps, as a part of its size: w times the first, and no less or more than the others.
const CREEP: f64 = 1e-17;
const LEAST: f64 = 1e-15;
const MOST: f64 = 1e-13;
/// A sensitivity that has shrunk to this part of its largest value is measured against that.
const FADED: f64 = 1e-3;

/// What has stopped changing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum SteadyState {
    Nothing,
    /// P, and with it S and K.
    Gains,
    /// Ψ too, and with it T.
    All,
}

/// Looks at P and Ψ from time to time.
///
/// P goes to its limit like λ^k, and the windows between looks grow with k: what is left to change after a window in which
/// nothing changed is far less than the rounding in it, however slow the filter. (A change over one step would not show that: it
/// is small in slow filters too.) What creeps, such as the variance of a state that is never measured, is let go at 1e-17 of
/// itself a step: over 10⁶ steps 1e-11.
/// Without noise P falls like 1/k, a fifth over any window, and is never frozen.
#[derive(Debug, Clone, Default)]
pub(crate) struct SteadyStateMonitor {
    /// Nothing is ever frozen.
    pub(crate) off: bool,
    P: Vec<f64>,
    Psi: Vec<f64>,
    /// Largest magnitudes of Ψ so far, as far as looked at.
    peaks: Vec<f64>,
    /// The last look.
    last: usize,
    next: usize,
}

impl SteadyStateMonitor {
    /// Begins a design.
    pub(crate) fn start(&mut self, Psi: &[f64]) {
        self.peaks.clear();
        self.peaks.extend(Psi.iter().map(|x| x.abs()));
    }

    /// Begins so many equal steps. False where they are too few to look at.
    pub(crate) fn begin(&mut self, count: usize) -> bool {
        (self.last, self.next) = (0, 1);
        !self.off && count > 2 * WINDOW
    }

    /// The number of steps to look after.
    pub(crate) fn next_look(&self) -> usize {
        self.next
    }

    /// Looks, if it is time: after `step` of these steps. Shapes: `P` r × r, row-major, lower triangle.
    #[inline]
    pub(crate) fn look(
        &mut self,
        step: usize,
        (P, r): (&[f64], usize),
        Psi: &[f64],
        frozen: SteadyState,
    ) -> SteadyState {
        if step < self.next {
            return frozen;
        }
        let slack = ((step - self.last) as f64 * CREEP).clamp(LEAST, MOST);
        let first = self.last == 0;
        for (peak, x) in self.peaks.iter_mut().zip(Psi) {
            *peak = peak.max(x.abs());
        }
        let frozen = match frozen {
            _ if first => frozen,
            SteadyState::Nothing if !self.variance_rests(P, r, slack) => SteadyState::Nothing,
            _ if self.sensitivity_rests(Psi, slack) => SteadyState::All,
            _ => SteadyState::Gains,
        };
        self.P.clear();
        self.P.extend_from_slice(P);
        self.Psi.clear();
        self.Psi.extend_from_slice(Psi);
        self.last = step;
        self.next = step + WINDOW.max(step / PART);
        frozen
    }

    fn variance_rests(&self, P: &[f64], r: usize, slack: f64) -> bool {
        (0..r).all(|i| {
            (0..=i).all(|j| {
                let change = (P[i * r + j] - self.P[i * r + j]).abs();
                // against √(P_ii P_jj), without the root and without underflow
                change <= 0.0 || change * (change / P[i * (r + 1)]) <= slack * slack * P[j * (r + 1)].abs()
            })
        })
    }

    fn sensitivity_rests(&self, Psi: &[f64], slack: f64) -> bool {
        Psi.iter().zip(&self.Psi).zip(&self.peaks).all(|((&now, &before), &peak)| {
            let size = now.abs().max(peak * FADED);
            (now - before).abs() <= size * slack
        })
    }
}
