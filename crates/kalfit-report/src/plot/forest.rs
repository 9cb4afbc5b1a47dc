//! Estimates with their 95 % intervals: the rows of the report's forest plots.

use kalfit::FitRecord;

use crate::html::forest::{ForestPanel, panels};
use crate::html::{estimates, parameters};
use crate::plot::axis::PlotAxis;
use crate::plot::canvas::{BLUE, FAINT, INK, PlotCanvas, SMALL, TextAnchor, WORDS, cut, widest};
use crate::plot::error::PlotError;
use crate::plot::picture::DrawablePlot;
use crate::words::clean;

/// Heights, in points.
const LABEL: f64 = 26.0;
const ROW: f64 = 20.0;
const TICKS: f64 = 26.0;
/// A narrower figure has no room for figures beside the marks.
const WIDE: f64 = 560.0;

pub(super) struct ForestPlot {
    panels: Vec<ForestPanel>,
}

impl ForestPlot {
    pub(super) fn of(record: &FitRecord) -> Result<ForestPlot, PlotError> {
        let several = record.phases.len() > 1;
        let mut groups = Vec::new();
        for phase in &record.phases {
            groups.extend(estimates::groups(record, phase).into_iter().map(|mut group| {
                if several {
                    group.label = format!("{}: {}", clean(&phase.name), group.label);
                }
                group
            }));
        }
        groups.extend(parameters::groups(record));
        let panels = panels(groups);
        if panels.is_empty() {
            return Err(PlotError::Nothing("no mean, spread or parameter is estimated".to_owned()));
        }
        Ok(ForestPlot { panels })
    }
}

impl DrawablePlot for ForestPlot {
    fn caption(&self) -> String {
        "Estimates with 95 % intervals; open marks have none".to_owned()
    }

    fn height(&self, _: f64) -> f64 {
        self.panels.iter().map(|panel| LABEL + ROW * panel.rows.len() as f64 + TICKS).sum::<f64>() + 6.0
    }

    fn draw(&self, on: &mut PlotCanvas<'_>) {
        let rows = || self.panels.iter().flat_map(|panel| &panel.rows);
        let left = 12.0 + widest(rows().map(|row| row.name.as_str()), WORDS, 0.35 * on.width) + 10.0;
        let words = if on.width < WIDE {
            16.0
        } else {
            12.0 + widest(rows().map(|row| short(&row.words)), WORDS, 0.3 * on.width)
        };
        let right = on.width - words - 10.0;
        let mut top = 0.0;
        for panel in &self.panels {
            put(panel, &mut on.below(top), left, right);
            top += LABEL + ROW * panel.rows.len() as f64 + TICKS;
        }
    }
}

/// Without the interval, which is drawn.
fn short(words: &str) -> &str {
    words.split(" (95 %").next().unwrap_or(words)
}

fn put(panel: &ForestPanel, on: &mut PlotCanvas<'_>, left: f64, right: f64) {
    let known = |end: Option<f64>| end.filter(|x| x.is_finite());
    let ends = panel.rows.iter().flat_map(|row| row.ends.unwrap_or([None, None]).map(known)).flatten();
    let axis = PlotAxis::over(ends.chain(panel.rows.iter().map(|row| row.estimate)), left, right);
    let bottom = LABEL + ROW * panel.rows.len() as f64;
    on.text([12.0, 14.0], &cut(&panel.label, on.width - 24.0, WORDS), WORDS, TextAnchor::Left, INK);
    axis.below(on, LABEL, bottom);
    if axis.holds(0.0) {
        on.line(&[[axis.at(0.0), LABEL], [axis.at(0.0), bottom]], FAINT, 1.0);
    }
    for (k, row) in panel.rows.iter().enumerate() {
        let y = LABEL + ROW * (k as f64 + 0.5);
        on.text([left - 8.0, y], &cut(&row.name, left - 18.0, WORDS), WORDS, TextAnchor::Right, INK);
        if let Some([low, high]) = row.ends {
            // an open end reaches the edge
            let from = known(low).map_or(left, |x| axis.at(x));
            let to = known(high).map_or(right, |x| axis.at(x));
            on.line(&[[from, y], [to, y]], BLUE, 2.0);
        }
        on.dot([axis.at(row.estimate), y], 4.0, BLUE, row.ends.is_some());
        if on.width >= WIDE {
            on.text(
                [right + 10.0, y],
                &cut(short(&row.words), on.width - right - 12.0, SMALL),
                SMALL,
                TextAnchor::Left,
                INK,
            );
        }
    }
}
