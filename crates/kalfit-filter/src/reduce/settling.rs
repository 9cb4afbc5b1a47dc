//! Detects when P and Ψ of equal steps have stopped changing.
#![expect(non_snake_case, reason = "the letters of the theory: P, Psi")]

/// Least number of steps before P and Ψ are first compared, and between successive looks.
const WINDOW: usize = 32;
/// Divisor of the number of steps so far that gives the number of steps to the next look.
const LOOK_DIVISOR: usize = 4;
/// Relative change that counts as none over a window of w steps: w × CHANGE_PER_STEP, but at least LEAST_CHANGE and at
/// most MOST_CHANGE.
const CHANGE_PER_STEP: f64 = 1e-17;
const LEAST_CHANGE: f64 = 1e-15;
const MOST_CHANGE: f64 = 1e-13;
/// An entry of Ψ below this fraction of the entry's largest magnitude so far is compared on the scale of that fraction.
const FADED_FRACTION: f64 = 1e-3;

/// Which quantities have stopped changing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum SteadyState {
    Nothing,
    /// P, S and K.
    Gains,
    /// P, Ψ, S, K and T.
    All,
}

/// Compares P and Ψ at looks that become rarer as steps go on.
///
/// P converges like λ^k, and the windows between looks grow with k: after a window without change, the change still to
/// come is far less than the rounding in that window, however slow the filter is. (A small change over one step would
/// not show this: slow filters, too, change little in one step.) Slow growth, such as that of the variance of a state
/// that is never measured, is neglected up to 1e-17 of the value per step: 1e-11 over 10⁶ steps. Without noise P falls
/// like 1/k, by a fifth over any window, and is never frozen.
#[derive(Debug, Clone, Default)]
pub(crate) struct SteadyStateMonitor {
    /// Whether P and Ψ are never frozen.
    pub(crate) off: bool,
    P: Vec<f64>,
    Psi: Vec<f64>,
    /// Largest magnitude of each entry of Ψ at the looks so far.
    peaks: Vec<f64>,
    /// Number of steps at the last look; `next`: number of steps at which the next look is due.
    last: usize,
    next: usize,
}

impl SteadyStateMonitor {
    /// Begins a design.
    pub(crate) fn start(&mut self, Psi: &[f64]) {
        self.peaks.clear();
        self.peaks.extend(Psi.iter().map(|x| x.abs()));
    }

    /// Begins a stretch of `count` equal steps. False where the steps are too few for a look.
    pub(crate) fn begin(&mut self, count: usize) -> bool {
        (self.last, self.next) = (0, 1);
        !self.off && count > 2 * WINDOW
    }

    /// The number of steps after which the next look is due.
    pub(crate) fn next_look(&self) -> usize {
        self.next
    }

    /// Compares P and Ψ after `step` steps, if a look is due, and returns what is frozen. Shape: `P` r × r, row-major,
    /// lower triangle.
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
        let slack = ((step - self.last) as f64 * CHANGE_PER_STEP).clamp(LEAST_CHANGE, MOST_CHANGE);
        let is_first_look = self.last == 0;
        for (peak, x) in self.peaks.iter_mut().zip(Psi) {
            *peak = peak.max(x.abs());
        }
        let frozen = match frozen {
            _ if is_first_look => frozen,
            SteadyState::Nothing if !self.variance_rests(P, r, slack) => SteadyState::Nothing,
            _ if self.sensitivity_rests(Psi, slack) => SteadyState::All,
            _ => SteadyState::Gains,
        };
        self.P.clear();
        self.P.extend_from_slice(P);
        self.Psi.clear();
        self.Psi.extend_from_slice(Psi);
        self.last = step;
        self.next = step + WINDOW.max(step / LOOK_DIVISOR);
        frozen
    }

    fn variance_rests(&self, P: &[f64], r: usize, slack: f64) -> bool {
        (0..r).all(|i| {
            (0..=i).all(|j| {
                let change = (P[i * r + j] - self.P[i * r + j]).abs();
                // compares with √(P_ii P_jj), without the root and without underflow
                change <= 0.0 || change * (change / P[i * (r + 1)]) <= slack * slack * P[j * (r + 1)].abs()
            })
        })
    }

    fn sensitivity_rests(&self, Psi: &[f64], slack: f64) -> bool {
        Psi.iter().zip(&self.Psi).zip(&self.peaks).all(|((&now, &before), &peak)| {
            let size = now.abs().max(peak * FADED_FRACTION);
            (now - before).abs() <= size * slack
        })
    }
}
