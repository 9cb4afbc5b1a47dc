//! What `--for` asks for.

use kalfit::Population;
use kalfit::dynamic::UnitInformation;
use kalfit::model::PhasedModel;
use kalfit::plan::{CandidateInformation, Figure, Goal, PlannedFigure, Quantity};
use kalfit::record::{PlanNames, PlannedRecord};

use crate::plan::error::BestPlanError;

/// The figures of a model with their names.
pub(super) struct Figures {
    pub(super) all: Vec<Figure>,
    pub(super) names: Vec<String>,
    /// Names of figures that the model fixes.
    pub(super) fixed: Vec<String>,
    /// Names of parameters that are taken as known.
    pub(super) known: Vec<String>,
}

impl Figures {
    /// All figures that the model leaves free, with their names.
    pub(super) fn of_model(free: &PhasedModel, names: &PlanNames, found: &UnitInformation) -> Figures {
        let Population { mean, coefficients, .. } = found.population();
        let elements: Vec<(usize, usize)> = found.elements().collect();
        let off_diagonal = || elements.iter().filter(|(i, j)| i != j);
        let own = free.dimension();
        let means = (0..mean.len().min(own)).map(Quantity::Mean);
        let quantities = means
            .chain((0..coefficients.len()).map(Quantity::Coefficient))
            .chain(elements.iter().filter(|(i, j)| i == j).map(|&(i, _)| Quantity::StdDev(i)))
            .chain(off_diagonal().map(|&(i, j)| Quantity::Correlation(i, j)))
            .chain(elements.iter().map(|&(i, j)| Quantity::Covariance(i, j)));
        let (left, fixed): (Vec<Quantity>, Vec<Quantity>) =
            quantities.partition(|quantity| found.gradient(*quantity).amax() > 0.0);
        let values = (0..names.parameters.len()).map(Figure::Value);
        let of_mission = (0..names.mission.len()).flat_map(|at| [Figure::Output(at), Figure::Limit(at)]);
        let all: Vec<Figure> = left.into_iter().map(Figure::Quantity).chain(values).chain(of_mission).collect();
        let several = !free.is_single();
        let name = |figure: Figure| {
            let bare = PlannedFigure { figure, value: None, before: None, after: None, df: None, informed_by: None };
            PlannedRecord::of_figure((free, names), &bare).name(several)
        };
        let known = free.shared().parameters.iter().map(|own| own.name.clone());
        Figures {
            names: all.iter().map(|figure| name(*figure)).collect(),
            fixed: fixed.into_iter().map(|quantity| name(Figure::Quantity(quantity))).collect(),
            known: known.filter(|name| !names.parameters.contains(name)).collect(),
            all,
        }
    }

    pub(super) fn name(&self, figure: Figure) -> String {
        self.all.iter().position(|own| *own == figure).map_or_else(String::new, |at| self.names[at].clone())
    }

    fn find(&self, text: &str) -> Result<Figure, BestPlanError> {
        let plain = |text: &str| text.split_whitespace().collect::<String>();
        let turned = |name: &str| {
            let (kind, rest) = name.split_once('(')?;
            let (one, other) = rest.strip_suffix(')')?.split_once(", ")?;
            matches!(kind, "corr" | "cov").then(|| format!("{kind}({other}, {one})"))
        };
        let is_named = |name: &String| {
            plain(name) == plain(text) || turned(name).is_some_and(|turned| plain(&turned) == plain(text))
        };
        if let Some(at) = self.names.iter().position(is_named) {
            return Ok(self.all[at]);
        }
        let figure = || text.trim().to_owned();
        Err(if self.fixed.iter().any(is_named) {
            BestPlanError::Fixed { figure: figure() }
        } else if self.known.iter().any(is_named) {
            BestPlanError::Known { figure: figure() }
        } else {
            BestPlanError::UnknownFigure { found: figure(), known: self.names.clone() }
        })
    }

    fn each(&self, text: &str) -> Result<Vec<Figure>, BestPlanError> {
        parts(text).into_iter().map(|part| self.find(part)).collect()
    }

    /// The goal that a text names: `D`, `A`, figures, or `D(…)` of figures.
    pub(super) fn goal(&self, text: &str, candidates: &CandidateInformation) -> Result<Goal, BestPlanError> {
        let text = text.trim();
        if text == "D" {
            return Ok(Goal::All);
        }
        if let Some(inner) = text.strip_prefix("D(").and_then(|rest| rest.strip_suffix(')')) {
            return Ok(Goal::FiguresTogether(self.each(inner)?));
        }
        let figures = match text {
            "A" => {
                let is_mean = |figure: &Figure| matches!(figure, Figure::Quantity(Quantity::Mean(_)));
                let means = self.all.iter().copied().filter(is_mean);
                means.filter(|figure| candidates.gradient(*figure).amax() > 0.0).collect()
            }
            _ => self.each(text)?,
        };
        Ok(Goal::Figures(sized(&figures, text == "A", candidates)))
    }
}

/// Figures with the sizes that their errors are compared with: nothing for a single figure; for `A` the standard deviation
/// of the state; else the standard error by one test of each candidate.
fn sized(figures: &[Figure], over_deviations: bool, candidates: &CandidateInformation) -> Vec<(Figure, f64)> {
    let of_each = candidates.one_of_each(figures);
    let deviation = |figure: Figure| match figure {
        Figure::Quantity(Quantity::Mean(i)) if over_deviations => candidates.candidates.value(Quantity::StdDev(i)),
        _ => None,
    };
    let size = |(&figure, error): (&Figure, &Option<f64>)| {
        let own = if figures.len() == 1 && !over_deviations { Some(1.0) } else { deviation(figure) };
        (figure, own.filter(|size| *size > 0.0).or(*error).unwrap_or(1.0))
    };
    figures.iter().zip(&of_each).map(size).collect()
}

/// The parts of a text between commas that are in no brackets.
fn parts(text: &str) -> Vec<&str> {
    let (mut parts, mut depth, mut start) = (Vec::new(), 0usize, 0);
    for (at, letter) in text.char_indices() {
        match letter {
            '(' => depth += 1,
            ')' => depth = depth.saturating_sub(1),
            ',' if depth == 0 => {
                parts.push(&text[start..at]);
                start = at + 1;
            }
            _ => {}
        }
    }
    parts.push(&text[start..]);
    parts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_are_found_however_they_are_spelled() {
        let all =
            vec![Figure::Quantity(Quantity::Mean(0)), Figure::Quantity(Quantity::Correlation(1, 0)), Figure::Value(0)];
        let names = ["mean(bias)", "corr(bias, scale)", "tau"].map(str::to_owned).to_vec();
        let figures = Figures { all: all.clone(), names, fixed: vec!["sd(bias)".to_owned()], known: Vec::new() };
        let found = figures.each(" corr( scale,bias ), mean(bias),tau").expect("all are there");
        assert_eq!(found, [all[1], all[0], all[2]]);
        let unknown = figures.each("mean(bais)").expect_err("there is none");
        assert_eq!(unknown.hint().as_deref(), Some("did you mean `mean(bias)`?"));
        assert!(matches!(figures.each("sd( bias )"), Err(BestPlanError::Fixed { .. })));
        assert_eq!(parts("a(b, c), d"), ["a(b, c)", " d"]);
    }
}
