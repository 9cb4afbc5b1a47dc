//! Each pair of states: ellipses of the population, and the tests.

use kalfit::FitRecord;
use kalfit::record::PhaseRecord;

use crate::html::outlying::stands_out;
use crate::plot::axis::PlotAxis;
use crate::plot::canvas::{BLUE, FAINT, INK, ORANGE, PlotCanvas, SMALL, TextAnchor, WORDS, cut};
use crate::plot::error::PlotError;
use crate::plot::picture::DrawablePlot;
use crate::words::clean;

/// Pairs that are drawn: those of the first four states.
const MOST_PAIRS: usize = 6;
/// Outliers that are named.
const MOST_NAMES: usize = 12;
/// Points of an ellipse.
const POINTS: usize = 90;
/// Parts of the population that the ellipses hold.
const HELD: [f64; 2] = [0.5, 0.95];
/// Room for the numbers beside and below a pair, and for its names.
const LEFT: f64 = 58.0;
const BELOW: f64 = 40.0;

/// Two states.
struct StatePair {
    names: [String; 2],
    mean: [f64; 2],
    covariance: [f64; 3],
    tests: Vec<TestPoint>,
}

/// A test.
struct TestPoint {
    id: String,
    at: [f64; 2],
    outlier: bool,
}

pub(super) struct EllipsePlot {
    pairs: Vec<StatePair>,
    /// The means depend on columns of the data.
    regression: bool,
}

impl EllipsePlot {
    pub(super) fn of(record: &FitRecord) -> Result<EllipsePlot, PlotError> {
        let several = record.phases.len() > 1;
        let mut pairs = Vec::new();
        for phase in &record.phases {
            let varies = |i: &usize| phase.std_dev.estimate.get(*i).is_some_and(|s| *s > 0.0 && s.is_finite());
            let states: Vec<usize> = (0..phase.states.len()).filter(varies).collect();
            for (a, &i) in states.iter().enumerate() {
                pairs.extend(states[..a].iter().filter_map(|&k| pair(record, phase, (k, i), several)));
            }
        }
        pairs.truncate(MOST_PAIRS);
        if pairs.is_empty() {
            return Err(PlotError::Nothing("it takes two estimated states that vary from test to test".to_owned()));
        }
        let regression = record.phases.iter().any(|phase| !phase.mean.regression.is_empty());
        Ok(EllipsePlot { pairs, regression })
    }

    /// Pairs beside each other.
    fn columns(&self, width: f64) -> usize {
        let room = (width / 280.0).floor().max(1.0) as usize;
        match self.pairs.len() {
            4 => 2, // a square
            n => n.min(3),
        }
        .min(room)
    }

    fn side(&self, width: f64) -> f64 {
        ((width - 16.0) / self.columns(width) as f64).min(520.0)
    }
}

fn pair(record: &FitRecord, phase: &PhaseRecord, (k, i): (usize, usize), several: bool) -> Option<StatePair> {
    let name = |i: usize| {
        let unit = phase.units.get(i).cloned().flatten().filter(|unit| !unit.is_empty());
        let unit = unit.map_or_else(String::new, |unit| format!(" [{}]", clean(&unit)));
        let place = if several { format!("{}: ", clean(&phase.name)) } else { String::new() };
        format!("{place}{}{unit}", clean(&phase.states[i]))
    };
    let element = |i: usize, k: usize| phase.covariance.estimate.get(i)?.get(k).copied();
    let of = |test: kalfit::record::TestRecord<'_>| {
        let part = test.phases.iter().find(|part| part.name == phase.name)?;
        let at = [*part.mean.get(k)?, *part.mean.get(i)?];
        Some(TestPoint { id: clean(test.id), at, outlier: stands_out(test, record.tests.len()) })
    };
    Some(StatePair {
        names: [name(k), name(i)],
        mean: [*phase.mean.estimate.get(k)?, *phase.mean.estimate.get(i)?],
        covariance: [element(k, k)?, element(i, k)?, element(i, i)?],
        tests: record.tests.iter().filter_map(of).collect(),
    })
}

/// The edge of the ellipse that holds a part of the population: mean + r L (cos t, sin t) with Σ = LLᵀ, r² the quantile of χ²₂.
fn edge(pair: &StatePair, part: f64) -> Vec<[f64; 2]> {
    let [xx, xy, yy] = pair.covariance;
    let l = [xx.sqrt(), xy / xx.sqrt(), (yy - xy * xy / xx).max(0.0).sqrt()];
    let radius = (-2.0 * (1.0 - part).ln()).sqrt();
    let point = |k: usize| {
        let (sin, cos) = (std::f64::consts::TAU * k as f64 / POINTS as f64).sin_cos();
        [pair.mean[0] + radius * l[0] * cos, pair.mean[1] + radius * (l[1] * cos + l[2] * sin)]
    };
    (0..=POINTS).map(point).collect()
}

impl DrawablePlot for EllipsePlot {
    fn caption(&self) -> String {
        let at = if self.regression { ", regression columns at zero" } else { "" };
        format!("Population (50 % and 95 %{at}) and estimates of the tests given it")
    }

    fn height(&self, width: f64) -> f64 {
        let rows = self.pairs.len().div_ceil(self.columns(width));
        rows as f64 * 0.8 * self.side(width) + 8.0
    }

    fn draw(&self, on: &mut PlotCanvas<'_>) {
        let (columns, side) = (self.columns(on.width), self.side(on.width));
        for (k, pair) in self.pairs.iter().enumerate() {
            let left = 8.0 + (k % columns) as f64 * side;
            put(pair, &mut on.below((k / columns) as f64 * 0.8 * side), left, side);
        }
    }
}

fn put(pair: &StatePair, on: &mut PlotCanvas<'_>, left: f64, side: f64) {
    let edges = HELD.map(|part| edge(pair, part));
    let all = || edges[1].iter().copied().chain(pair.tests.iter().map(|test| test.at));
    let (from, to) = (left + LEFT, left + side - 14.0);
    let (top, bottom) = (22.0, 0.8 * side - BELOW);
    let x = PlotAxis::over(all().map(|at| at[0]), from, to);
    let y = PlotAxis::over(all().map(|at| at[1]), bottom, top);
    let at = |value: [f64; 2]| [x.at(value[0]), y.at(value[1])];
    x.below(on, top, bottom);
    y.beside(on, from, to);
    on.text([left + 4.0, 10.0], &cut(&pair.names[1], side - 20.0, WORDS), WORDS, TextAnchor::Left, INK);
    on.text([to, bottom + 25.0], &cut(&pair.names[0], side - 20.0, WORDS), WORDS, TextAnchor::Right, INK);
    for edge in &edges {
        on.line(&edge.iter().map(|point| at(*point)).collect::<Vec<_>>(), FAINT, 1.2);
    }
    for test in &pair.tests {
        on.dot(at(test.at), 2.5, if test.outlier { ORANGE } else { BLUE }, true);
    }
    for test in pair.tests.iter().filter(|test| test.outlier).take(MOST_NAMES) {
        let [x, y] = at(test.at);
        // inwards from the right edge
        let (side, shift) = if x > 0.7 * to + 0.3 * from { (TextAnchor::Right, -6.0) } else { (TextAnchor::Left, 6.0) };
        on.text([x + shift, y - 6.0], &cut(&test.id, 100.0, SMALL), SMALL, side, INK);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_edge_is_at_its_distance_from_the_mean() {
        let pair =
            StatePair { names: Default::default(), mean: [1.0, -2.0], covariance: [4.0, -1.2, 0.9], tests: Vec::new() };
        let det = 4.0 * 0.9 - 1.2 * 1.2;
        for (part, chi2) in [(0.5, 1.386_294_361), (0.95, 5.991_464_547)] {
            for [x, y] in edge(&pair, part) {
                let (dx, dy) = (x - 1.0, y + 2.0);
                let squared = (0.9 * dx * dx + 2.4 * dx * dy + 4.0 * dy * dy) / det;
                assert!((squared - chi2).abs() < 1e-8, "{squared} for {chi2}");
            }
        }
    }
}
