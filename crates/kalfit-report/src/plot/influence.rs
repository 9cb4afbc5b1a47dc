//! How far the estimates move when a test is left out.

use kalfit::FitRecord;
use kalfit::record::displacement_limit;

use crate::plot::axis::PlotAxis;
use crate::plot::canvas::{BLUE, FAINT, INK, ORANGE, PlotCanvas, SMALL, TextAnchor, WORDS, cut, widest};
use crate::plot::error::PlotError;
use crate::plot::picture::DrawablePlot;
use crate::summary::influence::deleted;
use crate::words::{clean, count};

/// Tests that are drawn, the most influential first.
const MOST: usize = 30;
const ROW: f64 = 18.0;
/// Room above and below the bars.
const TOP: f64 = 18.0;
const BOTTOM: f64 = 30.0;

pub(super) struct InfluencePlot {
    /// Test and displacement.
    tests: Vec<(String, f64)>,
    /// Of all tests.
    of: usize,
    limit: f64,
}

impl InfluencePlot {
    pub(super) fn of(record: &FitRecord) -> Result<InfluencePlot, PlotError> {
        let all: Vec<(String, f64)> =
            deleted(record).into_iter().map(|(test, deletion)| (clean(test), deletion.displacement)).collect();
        if all.is_empty() {
            let why = "the fit was not repeated without each test; `kalfit fit --deletion all` does that".to_owned();
            return Err(PlotError::Nothing(why));
        }
        let of = all.len();
        let tests = all.into_iter().take(MOST).collect();
        Ok(InfluencePlot { tests, of, limit: displacement_limit(record.free_parameters) })
    }
}

impl DrawablePlot for InfluencePlot {
    fn caption(&self) -> String {
        let which = if self.of > MOST {
            format!("the {MOST} most influential of {}", count(self.of, "test"))
        } else {
            count(self.of, "test")
        };
        format!("Cook's displacement without each test: {which}")
    }

    fn height(&self, _: f64) -> f64 {
        TOP + ROW * self.tests.len() as f64 + BOTTOM
    }

    fn draw(&self, on: &mut PlotCanvas<'_>) {
        let left = 22.0 + widest(self.tests.iter().map(|(id, _)| id.as_str()), WORDS, 0.35 * on.width);
        let right = on.width - 20.0;
        let axis = PlotAxis::from_zero(self.tests.iter().map(|one| one.1).chain([self.limit]), left, right);
        let bottom = TOP + ROW * self.tests.len() as f64;
        axis.below(on, TOP, bottom);
        for (k, (id, displacement)) in self.tests.iter().enumerate() {
            let y = TOP + ROW * (k as f64 + 0.5);
            let color = if *displacement > self.limit { ORANGE } else { BLUE };
            on.text([left - 8.0, y], &cut(id, left - 18.0, WORDS), WORDS, TextAnchor::Right, INK);
            on.bar([axis.at(0.0), y - 5.0], [axis.at(*displacement), y + 5.0], color);
        }
        let x = axis.at(self.limit);
        on.dashed([x, TOP - 4.0], [x, bottom], FAINT);
        // on the side that has room
        let (side, shift) = if x > 0.5 * (left + right) { (TextAnchor::Right, -6.0) } else { (TextAnchor::Left, 6.0) };
        on.text([x + shift, TOP - 8.0], "edge of the 50 % confidence region", SMALL, side, FAINT);
    }
}
