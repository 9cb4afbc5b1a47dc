//! Allan deviations of the records and of the fitted model, against the averaging time.

use kalfit::record::{AllanPoint, AlongRecord, CurveRecord};

use crate::plot::axis::PlotAxis;
use crate::plot::canvas::{BLUE, FAINT, INK, PlotCanvas, SMALL, TextAnchor, WORDS, cut};
use crate::plot::error::PlotError;
use crate::plot::picture::DrawablePlot;
use crate::words::clean;

/// Measurements that are drawn.
const MOST: usize = 6;
/// Height of a panel, and of what stands around it.
const PANEL: f64 = 230.0;
const AROUND: f64 = 58.0;
const LEFT: f64 = 66.0;

pub(super) struct AllanPlot<'a> {
    curves: Vec<&'a CurveRecord>,
    /// Whether names need the phase.
    several: bool,
    unit: Option<String>,
}

impl<'a> AllanPlot<'a> {
    pub(super) fn of(along: Option<&'a AlongRecord>) -> Result<AllanPlot<'a>, PlotError> {
        let Some(along) = along else {
            return Err(PlotError::Nothing("Allan deviations need a model with `time`, and the data".to_owned()));
        };
        let is_known = |point: &AllanPoint| point.model.or(point.data).is_some_and(|x| x > 0.0);
        let curves: Vec<&CurveRecord> =
            along.allan.iter().filter(|curve| curve.points.iter().any(is_known)).take(MOST).collect();
        if curves.is_empty() {
            let notes = along.allan.iter().flat_map(|curve| &curve.notes).chain(&along.allan_notes);
            let why = notes.map(|note| clean(note)).next();
            return Err(PlotError::Nothing(why.unwrap_or_else(|| "no measurement has an Allan deviation".to_owned())));
        }
        let several = along.allan.iter().any(|curve| curve.phase != along.allan[0].phase);
        Ok(AllanPlot { curves, several, unit: along.time_unit.as_deref().map(clean) })
    }
}

impl DrawablePlot for AllanPlot<'_> {
    fn caption(&self) -> String {
        "Allan deviation against the averaging time. Points with bars: the records with 95 % limits. Line: the fitted model"
            .to_owned()
    }

    fn height(&self, _: f64) -> f64 {
        self.curves.len() as f64 * (PANEL + AROUND) + 10.0
    }

    fn draw(&self, on: &mut PlotCanvas<'_>) {
        for (k, curve) in self.curves.iter().enumerate() {
            let name = clean(&curve.measurement);
            let name = if self.several { format!("{}: {name}", clean(&curve.phase)) } else { name };
            let unit = curve.unit.as_deref().map_or(String::new(), |unit| format!(" [{}]", clean(unit)));
            panel(curve, &(name + &unit), self.unit.as_deref(), &mut on.below(k as f64 * (PANEL + AROUND)));
        }
    }
}

fn panel(curve: &CurveRecord, name: &str, unit: Option<&str>, on: &mut PlotCanvas<'_>) {
    let (right, top, bottom) = (on.width - 18.0, 24.0, 24.0 + PANEL);
    let positive = |x: Option<f64>| x.filter(|x| *x > 0.0 && x.is_finite()).map(f64::log10);
    let limits = |point: &AllanPoint| point.interval95.map(|[low, high]| [positive(low), positive(high)]);
    let values = curve.points.iter().flat_map(|point| {
        let limits = limits(point).into_iter().flatten().flatten();
        [positive(point.model), positive(point.data)].into_iter().flatten().chain(limits)
    });
    let x = PlotAxis::over(curve.points.iter().filter_map(|point| positive(Some(point.time))), LEFT, right);
    let y = PlotAxis::over(values, bottom, top);
    on.text([12.0, 10.0], &cut(name, on.width - 24.0, WORDS), WORDS, TextAnchor::Left, INK);
    x.below_in_powers(on, top, bottom);
    y.beside_in_powers(on, LEFT, right);
    let at = |point: &AllanPoint, value: Option<f64>| Some([x.at(positive(Some(point.time))?), y.at(positive(value)?)]);
    let line: Vec<[f64; 2]> = curve.points.iter().filter_map(|point| at(point, point.model)).collect();
    if line.len() > 1 {
        on.line(&line, BLUE, 1.4);
    }
    for point in &curve.points {
        let Some(place) = at(point, point.data) else { continue };
        if let Some([Some(low), Some(high)]) = limits(point) {
            on.line(&[[place[0], y.at(low)], [place[0], y.at(high)]], INK, 1.0);
        }
        on.dot(place, 2.2, INK, true);
    }
    let words = unit.map_or("averaging time".to_owned(), |unit| format!("averaging time [{unit}]"));
    on.text([right, bottom + 23.0], &words, SMALL, TextAnchor::Right, FAINT);
}
