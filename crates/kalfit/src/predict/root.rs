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

/// Where a function that falls from above comes down to a level; zero where it is below from the start. About a power of c, it is sought
/// in logarithms.
pub(super) fn crossing(of: &dyn Fn(f64) -> f64, level: f64) -> f64 {
    const FAR: f64 = 20.0;
    let above = |u: f64| {
        let found = of(u.exp());
        if found > 0.0 { (found / level).ln() } else { f64::NEG_INFINITY }
    };
    let start = above(0.0);
    if start == 0.0 {
        return 1.0;
    }
    let side = if start > 0.0 { 1.0 } else { -1.0 };
    let (mut low, mut high) = ((0.0, start), (side, above(side)));
    while (high.1 > 0.0) == (start > 0.0) {
        low = high;
        high = (high.0 + 2.0 * side, above(high.0 + 2.0 * side));
        if high.0.abs() > FAR {
            return if side > 0.0 { f64::INFINITY } else { 0.0 };
        }
    }
    between(&above, low, high).exp()
}

/// Where an increasing function that begins with zero at zero is as large as asked; `None` where it never is. `size`: of the root.
pub(super) fn rising(of: &dyn Fn(f64) -> f64, wanted: f64, size: f64) -> Option<f64> {
    let above = |x: f64| of(x * size) - wanted;
    let (mut low, mut high) = ((1e-9, above(1e-9)), (1.0, above(1.0)));
    while high.1 < 0.0 {
        low = high;
        high = (2.0 * high.0, above(2.0 * high.0));
        if high.0 > 1e9 {
            return None;
        }
    }
    Some(size * between(&above, low, high))
}
