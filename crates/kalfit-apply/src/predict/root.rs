//! Roots of monotonic functions of one variable.

/// Root of a function between two points at which the function has opposite signs: by regula falsi, with the value at
/// the end that does not move halved (Illinois), and by bisection where the function is infinite.
fn root_between(function: &dyn Fn(f64) -> f64, mut before: (f64, f64), mut last: (f64, f64)) -> f64 {
    const ROOT_TOLERANCE: f64 = 1e-11;
    for _ in 0..100 {
        let is_finite = before.1.is_finite() && last.1.is_finite();
        let middle = match is_finite {
            true => before.0 - before.1 * (last.0 - before.0) / (last.1 - before.1),
            false => 0.5 * (before.0 + last.0),
        };
        let found = function(middle);
        if found.abs() < ROOT_TOLERANCE || (last.0 - before.0).abs() < ROOT_TOLERANCE * last.0.abs().max(1.0) {
            return middle;
        }
        if (found > 0.0) == (last.1 > 0.0) {
            (last, before.1) = ((middle, found), 0.5 * before.1);
        } else {
            (before, last) = (last, (middle, found));
        }
    }
    last.0
}

/// Roots of earlier searches, for a function that changes little from one search to the next.
#[derive(Debug, Default)]
pub(super) struct EarlierRoots {
    /// Logarithms of the last two roots.
    last: [Option<f64>; 2],
}

impl EarlierRoots {
    /// (Logarithm of the starting point, distance to the next point in logarithms).
    fn start(&self) -> (f64, f64) {
        match self.last {
            [Some(last), Some(before)] => (2.0 * last - before, 0.02),
            [Some(last), None] => (last, 0.2),
            _ => (0.0, 1.0),
        }
    }

    fn found(&mut self, root: f64) {
        self.last = if root.is_finite() { [Some(root), self.last[0]] } else { [None; 2] };
    }
}

/// Point c at which a decreasing function falls to `level`; zero where the function is below `level` at every c,
/// infinity where above. The function is nearly a power of c, so the search is in ln c, and starts from earlier roots.
pub(super) fn decreasing_root(function: &dyn Fn(f64) -> f64, level: f64, earlier_roots: &mut EarlierRoots) -> f64 {
    const MOST_LOG_DISTANCE: f64 = 20.0;
    let log_excess = |u: f64| {
        let found = function(u.exp());
        if found > 0.0 { (found / level).ln() } else { f64::NEG_INFINITY }
    };
    let (at, step) = earlier_roots.start();
    let start = (at, log_excess(at));
    let side = if start.1 > 0.0 { step } else { -step };
    let next = |point: f64| (point, log_excess(point));
    let (mut low, mut high, mut far) = (start, next(at + side), side);
    let root = loop {
        if low.1 == 0.0 {
            break low.0;
        }
        if (high.1 > 0.0) != (start.1 > 0.0) {
            break root_between(&log_excess, low, high);
        }
        far *= 3.0;
        (low, high) = (high, next(high.0 + far));
        if high.0.abs() > MOST_LOG_DISTANCE {
            break if side > 0.0 { f64::INFINITY } else { f64::NEG_INFINITY };
        }
    };
    earlier_roots.found(root);
    root.exp()
}

/// Point at which an increasing function that is zero at zero reaches `wanted`; `None` where the function stays below
/// `wanted`. `size`: order of magnitude of the root.
pub(super) fn increasing_root(function: &dyn Fn(f64) -> f64, wanted: f64, size: f64) -> Option<f64> {
    let at = |x: f64| (x, function(x * size) - wanted);
    let start = at(1.0);
    let (mut low, mut high, mut factor) = (start, start, 1.1);
    while high.1 < 0.0 {
        (low, high) = (high, at(factor * high.0));
        if high.0 > 1e9 {
            return None;
        }
        factor *= factor;
    }
    factor = 1.1;
    while low.1 >= 0.0 && low.0 > 1e-9 {
        (high, low) = (low, at(low.0 / factor));
        factor *= factor;
    }
    Some(size * if low.1 >= 0.0 { low.0 } else { root_between(&|x| at(x).1, low, high) })
}
