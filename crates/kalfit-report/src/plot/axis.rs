//! From values to points.

use crate::number::plain;
use crate::plot::canvas::{FAINT, GRID, PlotCanvas, SMALL, TextAnchor, width_of};

/// Digits of the number at a tick.
const DIGITS: usize = 6;
/// Ticks are no closer than so many points.
const CLOSEST: f64 = 18.0;
/// A lower figure has ticks as close as this, any other half as many.
const LOW: f64 = 120.0;

/// One axis.
#[derive(Debug, Clone, Copy)]
pub(super) struct PlotAxis {
    low: f64,
    high: f64,
    /// Points of the ends.
    from: f64,
    to: f64,
}

impl PlotAxis {
    /// From `from` to `to`, with room for all values that are finite and some to spare.
    pub(super) fn over(values: impl Iterator<Item = f64>, from: f64, to: f64) -> PlotAxis {
        let ends = values.filter(|x| x.abs() < 1e150).fold(None, |ends: Option<(f64, f64)>, x| match ends {
            Some((low, high)) => Some((low.min(x), high.max(x))),
            None => Some((x, x)),
        });
        let (low, high) = ends.unwrap_or((0.0, 1.0));
        // of values that are all the same, and near the end of what numbers can tell apart
        let room = (0.05 * (high - low)).max(1e-9 * low.abs().max(high.abs())).max(f64::MIN_POSITIVE * 1e6);
        PlotAxis { low: low - room, high: high + room, from, to }
    }

    /// The same from zero, which has no room below it.
    pub(super) fn from_zero(values: impl Iterator<Item = f64>, from: f64, to: f64) -> PlotAxis {
        PlotAxis { low: 0.0, ..PlotAxis::over(values.chain([0.0]), from, to) }
    }

    pub(super) fn at(&self, x: f64) -> f64 {
        self.from + (self.to - self.from) * ((x - self.low) / (self.high - self.low)).clamp(-0.01, 1.01)
    }

    pub(super) fn holds(&self, x: f64) -> bool {
        (self.low..=self.high).contains(&x)
    }

    /// Round values, multiples of 1, 2 or 5 times a power of ten, as close as each has the points that it needs.
    fn ticks(&self, needs: impl Fn(&str) -> f64) -> Vec<(f64, String)> {
        let (span, length) = (self.high - self.low, (self.to - self.from).abs());
        let power = 10f64.powf((CLOSEST * span / length).log10().floor());
        for factor in [1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0] {
            let step = factor * power;
            let (first, last) = ((self.low / step).ceil(), (self.high / step).floor());
            // of a range that numbers hardly resolve
            let count = (last - first).clamp(0.0, length / CLOSEST) as usize;
            let all = (0..=count).map(|k| (first + k as f64) * step).filter(|tick| self.holds(*tick));
            let ticks: Vec<(f64, String)> = all.map(|tick| (tick, plain(tick, DIGITS))).collect();
            if ticks.iter().all(|(_, words)| needs(words) <= step / span * length) {
                return ticks;
            }
        }
        Vec::new()
    }

    /// Logarithms of round values: powers of ten, with multiples of them where each has the points that it needs.
    fn powers(&self, needs: f64) -> Vec<(f64, String)> {
        let per_point = (self.high - self.low) / (self.to - self.from).abs();
        let decades = (self.low.floor().max(-300.0) as i32)..=(self.high.ceil().min(300.0) as i32);
        let factors: &[f64] = match needs * per_point {
            least if least <= 0.09 => &[1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0],
            least if least <= 0.3 => &[1.0, 2.0, 5.0],
            _ => &[1.0],
        };
        let every = ((needs * per_point).ceil() as i32).max(1);
        let decades = decades.filter(|decade| decade.rem_euclid(every) == 0);
        let all = decades.flat_map(|decade| factors.iter().map(move |factor| factor * 10f64.powi(decade)));
        all.map(|value| (value.log10(), plain(value, DIGITS))).filter(|(at, _)| self.holds(*at)).collect()
    }

    /// Numbers below a figure, and lines up to its top.
    pub(super) fn below(&self, on: &mut PlotCanvas<'_>, top: f64, bottom: f64) {
        self.below_with(on, top, bottom, self.ticks(|words| (width_of(words, SMALL) + 14.0).max(55.0)));
    }

    /// As [`PlotAxis::below`], of logarithms to base ten.
    pub(super) fn below_in_powers(&self, on: &mut PlotCanvas<'_>, top: f64, bottom: f64) {
        self.below_with(on, top, bottom, self.powers(55.0));
    }

    fn below_with(&self, on: &mut PlotCanvas<'_>, top: f64, bottom: f64, ticks: Vec<(f64, String)>) {
        for (tick, words) in ticks {
            let x = self.at(tick);
            on.line(&[[x, top], [x, bottom]], GRID, 0.7);
            on.text([x, bottom + 9.0], &words, SMALL, TextAnchor::Middle, FAINT);
        }
        on.line(&[[self.from, bottom], [self.to, bottom]], FAINT, 0.8);
    }

    /// Numbers at the left of a figure, and lines to its right.
    pub(super) fn beside(&self, on: &mut PlotCanvas<'_>, left: f64, right: f64) {
        let least = if (self.to - self.from).abs() < LOW { CLOSEST } else { 2.0 * CLOSEST };
        self.beside_with(on, left, right, self.ticks(|_| least));
    }

    /// As [`PlotAxis::beside`], of logarithms to base ten.
    pub(super) fn beside_in_powers(&self, on: &mut PlotCanvas<'_>, left: f64, right: f64) {
        self.beside_with(on, left, right, self.powers(2.0 * CLOSEST));
    }

    fn beside_with(&self, on: &mut PlotCanvas<'_>, left: f64, right: f64, ticks: Vec<(f64, String)>) {
        for (tick, words) in ticks {
            let y = self.at(tick);
            on.line(&[[left, y], [right, y]], GRID, 0.7);
            on.text([left - 5.0, y], &words, SMALL, TextAnchor::Right, FAINT);
        }
        on.line(&[[left, self.from], [left, self.to]], FAINT, 0.8);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_values_are_inside_and_ticks_are_round() {
        let axis = PlotAxis::over([2.0, -1.0, f64::NAN].into_iter(), 100.0, 400.0);
        assert!(axis.at(-1.0) > 100.0 && axis.at(2.0) < 400.0, "{axis:?}");
        let words = |needs: f64| axis.ticks(|_| needs).into_iter().map(|(_, words)| words).collect::<Vec<_>>();
        assert_eq!(words(50.0), ["-1", "0", "1", "2"]);
        assert_eq!(words(40.0), ["-1", "-0.5", "0", "0.5", "1", "1.5", "2"]);
    }

    #[test]
    fn ticks_of_logarithms_are_as_close_as_there_is_room() {
        let words = |low: f64, high: f64, needs: f64| {
            let axis = PlotAxis::over([low.log10(), high.log10()].into_iter(), 0.0, 300.0);
            axis.powers(needs).into_iter().map(|(_, words)| words).collect::<Vec<_>>()
        };
        assert_eq!(words(1e-3, 1e3, 40.0), ["0.001", "0.01", "0.1", "1", "10", "100", "1000"]);
        assert_eq!(words(1e-3, 1e3, 90.0), ["0.01", "1", "100"]);
        assert_eq!(words(1.0, 10.0, 40.0), ["1", "2", "5", "10"]);
        assert_eq!(words(40.0, 90.0, 40.0), ["40", "50", "70"]);
    }

    #[test]
    fn values_that_are_all_the_same_have_an_axis() {
        for x in [0.0, 3.0, 1e-300, 1e12, -7e140] {
            let axis = PlotAxis::over(std::iter::once(x), 0.0, 100.0);
            assert!((axis.at(x) - 50.0).abs() < 1.0, "{x} is at {}", axis.at(x));
            assert!(axis.ticks(|_| 20.0).len() < 10);
        }
    }
}
