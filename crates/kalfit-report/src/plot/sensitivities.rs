//! What one more unit of cost for each candidate brings: the function of the equivalence theorem.

use kalfit::record::{BestPlanRecord, CandidateRecord, PlanRecord};

use crate::plot::axis::PlotAxis;
use crate::plot::canvas::{BLUE, FAINT, INK, ORANGE, PlotCanvas, SMALL, TextAnchor, WORDS, cut, widest};
use crate::plot::error::PlotError;
use crate::plot::picture::DrawablePlot;
use crate::words::{clean, count};

/// Candidates that are drawn: those of the plan, then those with the largest sensitivities.
const MOST: usize = 40;
const ROW: f64 = 18.0;
/// Room above and below the bars.
const TOP: f64 = 18.0;
const BOTTOM: f64 = 30.0;

pub(super) struct SensitivityPlot<'a> {
    best: &'a BestPlanRecord,
    shown: Vec<&'a CandidateRecord>,
}

impl<'a> SensitivityPlot<'a> {
    pub(super) fn of(record: &'a PlanRecord) -> Result<SensitivityPlot<'a>, PlotError> {
        let Some(best) = &record.best else {
            let why = "it is no plan among candidates; `kalfit plan --candidates` makes one".to_owned();
            return Err(PlotError::Nothing(why));
        };
        let mut shown: Vec<&CandidateRecord> = best.candidates.iter().collect();
        shown.sort_by(|a, b| (b.tests > 0).cmp(&(a.tests > 0)).then(b.sensitivity.total_cmp(&a.sensitivity)));
        shown.truncate(MOST);
        Ok(SensitivityPlot { best, shown })
    }
}

impl DrawablePlot for SensitivityPlot<'_> {
    fn caption(&self) -> String {
        let all = self.best.candidates.len();
        let which = if all > MOST { format!("{MOST} of {}", count(all, "candidate")) } else { count(all, "candidate") };
        format!(
            "What the next unit of cost brings by each candidate, times the budget, at the best plan for {}: {which}. Orange: in the plan",
            clean(&self.best.criterion)
        )
    }

    fn height(&self, _: f64) -> f64 {
        TOP + ROW * self.shown.len() as f64 + BOTTOM
    }

    fn draw(&self, on: &mut PlotCanvas<'_>) {
        let label = |one: &CandidateRecord| match one.tests {
            0 => clean(&one.name),
            tests => format!("{tests} × {}", clean(&one.name)),
        };
        let labels: Vec<String> = self.shown.iter().map(|one| label(one)).collect();
        let left = 22.0 + widest(labels.iter().map(String::as_str), WORDS, 0.35 * on.width);
        let right = on.width - 20.0;
        let largest = self.best.candidates.iter().map(|one| one.sensitivity).fold(0.0, f64::max);
        let axis = PlotAxis::from_zero(std::iter::once(largest), left, right);
        let bottom = TOP + ROW * self.shown.len() as f64;
        axis.below(on, TOP, bottom);
        for (k, (one, label)) in self.shown.iter().zip(&labels).enumerate() {
            let y = TOP + ROW * (k as f64 + 0.5);
            on.text([left - 8.0, y], &cut(label, left - 18.0, WORDS), WORDS, TextAnchor::Right, INK);
            let color = if one.tests > 0 { ORANGE } else { BLUE };
            on.bar([axis.at(0.0), y - 5.0], [axis.at(one.sensitivity), y + 5.0], color);
        }
        let x = axis.at(largest);
        on.dashed([x, TOP - 4.0], [x, bottom], FAINT);
        on.text(
            [x - 6.0, TOP - 8.0],
            "largest: candidates of the plan that have room for more",
            SMALL,
            TextAnchor::Right,
            FAINT,
        );
    }
}
