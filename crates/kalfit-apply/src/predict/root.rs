//! Roots of functions of one number that rise or fall all along.

/// Where a function is zero, between two points at which its signs differ: regula falsi, where a side that stays counts half (Illinois), and
/// halves of the line where the function is infinite.
fn between(of: &dyn Fn(f64) -> f64, mut before: (f64, f64), mut last: (f64, f64)) -> f64 {
    const CLOSE: f64 = 1e-11;
    for _ in 0..100 {
        let is_finite = before.1.is_finite() && last.1.is_finite();
        let middle = match is_finite {
            true => before.0 - before.1 * (last.0 - before.0) / (last.1 - before.1),
            false => 0.5 * (before.0 + last.0),
        };
        let found = of(middle);
        if found.abs() < CLOSE || (last.0 - before.0).abs() < CLOSE * last.0.abs().max(1.0) {
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

/// Where roots of a function that changes little from one search to the next were found.
#[derive(Debug, Default)]
pub(super) struct KnownRoots {
    /// Logarithms of the last two.
    last: [Option<f64>; 2],
}

impl KnownRoots {
    /// Where to begin, and how far the next point is.
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

/// Where a function that falls from above comes down to a level; zero where it is below from the start. About a power of c, it is sought
/// in logarithms, from where it was found before.
pub(super) fn crossing(of: &dyn Fn(f64) -> f64, level: f64, near: &mut KnownRoots) -> f64 {
    const FAR: f64 = 20.0;
    let above = |u: f64| {
        let found = of(u.exp());
        if found > 0.0 { (found / level).ln() } else { f64::NEG_INFINITY }
    };
    let (at, step) = near.start();
    let start = (at, above(at));
    let side = if start.1 > 0.0 { step } else { -step };
    let next = |to: f64| (to, above(to));
    let (mut low, mut high, mut far) = (start, next(at + side), side);
    let root = loop {
        if low.1 == 0.0 {
            break low.0;
        }
        if (high.1 > 0.0) != (start.1 > 0.0) {
            break between(&above, low, high);
        }
        far *= 3.0;
        (low, high) = (high, next(high.0 + far));
        if high.0.abs() > FAR {
            break if side > 0.0 { f64::INFINITY } else { f64::NEG_INFINITY };
        }
    };
    near.found(root);
    root.exp()
}

/// Where an increasing function that begins with zero at zero is as large as asked; `None` where it never is. `size`: about as large as the
/// root.
pub(super) fn rising(of: &dyn Fn(f64) -> f64, wanted: f64, size: f64) -> Option<f64> {
    let at = |x: f64| (x, of(x * size) - wanted);
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
    Some(size * if low.1 >= 0.0 { low.0 } else { between(&|x| at(x).1, low, high) })
}
