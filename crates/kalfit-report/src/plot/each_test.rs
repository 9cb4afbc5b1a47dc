//! Each test by itself, as the population sees it, and the mean of the population: the forest plot of a meta-analysis.

use kalfit::FitRecord;
use kalfit::record::PhaseRecord;

use crate::plot::axis::PlotAxis;
use crate::plot::canvas::{BLUE, FAINT, INK, ORANGE, PlotCanvas, SMALL, TextAnchor, WORDS, cut, widest};
use crate::plot::error::PlotError;
use crate::plot::picture::DrawablePlot;
use crate::words::{clean, count};

/// Tests that are drawn of each state, and states.
const MOST: usize = 60;
const MOST_STATES: usize = 6;
const ROW: f64 = 17.0;
const LABEL: f64 = 24.0;
const TICKS: f64 = 30.0;
/// Half of the interval that holds 95 % of a standard normal number.
const LIMIT: f64 = 1.96;

/// A test: its name, its own estimate with its standard error, and its estimate with the population.
struct TestMark {
    name: String,
    own: (f64, f64),
    posterior: f64,
}

/// The tests that determine a state, and the mean of the state.
struct StatePanel {
    label: String,
    tests: Vec<TestMark>,
    /// `None` where covariates move the mean from test to test.
    mean: Option<f64>,
    interval: Option<[f64; 2]>,
    /// Where 95 % of new tests are at these values.
    spread: Option<[f64; 2]>,
}

pub(super) struct TestsPlot {
    panels: Vec<StatePanel>,
    of: usize,
}

impl TestsPlot {
    pub(super) fn of(record: &FitRecord) -> Result<TestsPlot, PlotError> {
        let several = record.phases.len() > 1;
        let states = record.phases.iter().flat_map(|phase| (0..phase.states.len()).map(move |i| (phase, i)));
        let panels: Vec<StatePanel> =
            states.filter_map(|(phase, i)| panel(record, phase, i, several)).take(MOST_STATES).collect();
        if panels.is_empty() {
            let why = "no test determines a state by itself, or results of single tests were left out".to_owned();
            return Err(PlotError::Nothing(why));
        }
        Ok(TestsPlot { panels, of: record.data.tests })
    }
}

fn panel(record: &FitRecord, phase: &PhaseRecord, i: usize, several: bool) -> Option<StatePanel> {
    let mark = |row: &kalfit::record::TestRecord<'_>| {
        let of_phase = row.phases.iter().find(|own| own.name == phase.name)?;
        let own = of_phase.own?;
        let (value, variance) = (own.mean.get(i).copied()??, own.covariance.get(i)?.get(i).copied()??);
        let posterior = of_phase.mean.get(i).copied().filter(|x| x.is_finite())?;
        let is_usable = value.is_finite() && variance.is_finite() && variance >= 0.0;
        is_usable.then(|| TestMark { name: clean(row.id), own: (value, variance.sqrt()), posterior })
    };
    let tests: Vec<TestMark> = record.tests.iter().filter_map(|row| mark(&row)).take(MOST).collect();
    let is_common = phase.mean.regression.iter().all(|one| phase.states.get(i) != Some(&one.state));
    let mean = phase.mean.estimate.get(i).copied().filter(|x| x.is_finite() && is_common);
    let interval = phase.mean.interval95.get(i).copied().flatten().and_then(|[low, high]| Some([low?, high?]));
    let interval = interval.filter(|_| is_common);
    let std_dev = phase.std_dev.estimate.get(i).copied().filter(|x| x.is_finite() && *x > 0.0);
    let unit = phase.units.get(i).cloned().flatten().map_or(String::new(), |unit| format!(" [{}]", clean(&unit)));
    let name = clean(phase.states.get(i)?) + &unit;
    let label = if several { format!("{}: {name}", clean(&phase.name)) } else { name };
    let spread = std_dev.zip(mean).map(|(s, mean)| [mean - LIMIT * s, mean + LIMIT * s]);
    (!tests.is_empty()).then_some(StatePanel { label, tests, mean, interval, spread })
}

impl StatePanel {
    fn height(&self) -> f64 {
        LABEL + ROW * (self.tests.len() as f64 + 1.0) + TICKS
    }
}

impl DrawablePlot for TestsPlot {
    fn caption(&self) -> String {
        let most = self.panels.iter().map(|panel| panel.tests.len()).max().unwrap_or(0);
        let which =
            if most < self.of { format!("{most} of {}", count(self.of, "test")) } else { count(self.of, "test") };
        let has_mean = self.panels.iter().any(|panel| panel.mean.is_some());
        let mean = match has_mean {
            true => ". Last row: the mean with its interval; grey: where 95 % of new tests are at these values",
            false => "",
        };
        format!("{which}: each by itself with its 95 % interval (dot), and as part of the population (ring){mean}")
    }

    fn height(&self, _: f64) -> f64 {
        self.panels.iter().map(StatePanel::height).sum::<f64>() + 6.0
    }

    fn draw(&self, on: &mut PlotCanvas<'_>) {
        let names = self.panels.iter().flat_map(|panel| &panel.tests).map(|test| test.name.as_str());
        let left = 22.0 + widest(names.chain(["mean"]), WORDS, 0.3 * on.width);
        let mut top = 0.0;
        for panel in &self.panels {
            draw(panel, left, &mut on.below(top));
            top += panel.height();
        }
    }
}

fn draw(panel: &StatePanel, left: f64, on: &mut PlotCanvas<'_>) {
    let right = on.width - 20.0;
    let ends = |(value, error): (f64, f64)| [value - LIMIT * error, value + LIMIT * error];
    let values = panel.tests.iter().flat_map(|test| ends(test.own).into_iter().chain([test.posterior]));
    let axis = PlotAxis::over(values.chain(panel.interval.into_iter().flatten()).chain(panel.mean), left, right);
    let bottom = LABEL + ROW * (panel.tests.len() as f64 + 1.0);
    on.text([12.0, 10.0], &cut(&panel.label, on.width - 24.0, WORDS), WORDS, TextAnchor::Left, INK);
    axis.below(on, LABEL, bottom);
    if let Some([low, high]) = panel.spread {
        let corners = [[low, LABEL], [high, LABEL], [high, bottom], [low, bottom]];
        on.area(&corners.map(|[x, y]| [axis.at(x), y]), FAINT);
    }
    if let Some(mean) = panel.mean {
        on.dashed([axis.at(mean), LABEL], [axis.at(mean), bottom], FAINT);
    }
    for (k, test) in panel.tests.iter().enumerate() {
        let y = LABEL + ROW * (k as f64 + 0.5);
        on.text([left - 8.0, y], &cut(&test.name, left - 18.0, WORDS), WORDS, TextAnchor::Right, INK);
        let [low, high] = ends(test.own);
        on.line(&[[axis.at(low), y], [axis.at(high), y]], INK, 1.2);
        on.dot([axis.at(test.own.0), y], 2.6, INK, true);
        on.dot([axis.at(test.posterior), y], 3.2, BLUE, false);
    }
    let y = bottom - 0.5 * ROW;
    match panel.mean {
        Some(mean) => {
            on.text([left - 8.0, y], "mean", WORDS, TextAnchor::Right, INK);
            if let Some([low, high]) = panel.interval {
                let diamond = [[low, y], [mean, y - 5.0], [high, y], [mean, y + 5.0]];
                let points = diamond.map(|[x, y]| [axis.at(x), y]);
                on.area(&points, ORANGE);
                on.line(&[&points[..], &points[..1]].concat(), ORANGE, 1.2);
            }
            on.dot([axis.at(mean), y], 2.6, ORANGE, true);
        }
        None => on.text([right, y], "the mean depends on covariates", SMALL, TextAnchor::Right, FAINT),
    }
    on.text([right, bottom + 23.0], &panel.label, SMALL, TextAnchor::Right, FAINT);
}
