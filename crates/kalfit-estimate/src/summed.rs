//! The answers of a place that holds some of the tests: sums over the reductions of these tests.

use std::borrow::Cow;
use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use crate::Settings;
use crate::classes::{Classes, present};
use crate::evidence::evidence;
use crate::frame::Frame;
use crate::frame::Pooled;
use crate::initial_law::within_units;
use crate::order::FlatMean;
use crate::pass;
use crate::point::{Point, Regressors};
use crate::remote::Counts;
use crate::structure::Structure;
use kalfit_algebra::elements::Elements;
use kalfit_filter::reduce::Reductions;
use kalfit_filter::score::{InitialLaw, by_columns};
use kalfit_model::Grouping;
use kalfit_model::remote::{Answer, Flat, Law, Place, Question};

/// The reductions of one place at one α, prepared for sums over them.
#[derive(Debug)]
pub struct Summed {
    /// The reductions, one for each test.
    pub reductions: Reductions,
    /// For tests in groups, the reductions in the states of each test and of each group of the test; `None` without
    /// groups.
    stacked: Option<Reductions>,
    grouping: Option<Arc<Grouping>>,
    /// p, the number of states of a test.
    states: usize,
    elements: Elements,
    regressors: Vec<usize>,
    /// The classes in the coordinates of the last request.
    gathered: Option<(Frame, Classes)>,
}

impl Summed {
    /// Prepares reductions under a structure for sums over them.
    pub fn new(reductions: Reductions, structure: &Structure<'_>) -> Summed {
        let regressors = structure.regressions().iter().map(|r| r.element).collect();
        let stacked = match evidence(&reductions, structure, &Settings::default()) {
            Ok(Cow::Owned(stacked)) => Some(stacked),
            _ => None,
        };
        Summed {
            reductions,
            stacked,
            grouping: structure.grouping.clone(),
            states: structure.reduced_dimension(),
            elements: Elements::new(structure.ranges()),
            regressors,
            gathered: None,
        }
    }

    /// The reductions that the likelihood is computed from.
    fn evidence(&self) -> &Reductions {
        self.stacked.as_ref().unwrap_or(&self.reductions)
    }

    /// The answer to a question about μ and Σ; `None` where the question is of another kind or does not fit this model.
    pub fn answer(&mut self, question: &Question) -> Option<Answer> {
        let numbers = match question {
            Question::Survey => self.survey(),
            Question::Excess { frame, mean } if self.is_state(mean) => {
                let (excess, weight) = self.classes(frame)?.0.excess(&DVector::from_column_slice(mean));
                excess.iter().chain(weight.iter()).copied().collect()
            }
            Question::Pass { frame, place, detail, flat } => {
                let (point, flat) = (self.point(place)?, flat.as_ref());
                let flat = flat.map_or(Some(None), |flat| self.flat(flat).map(Some))?;
                let flat =
                    flat.as_ref().map(|(jacobian, covariance)| FlatMean { jacobian, covariance: covariance.as_ref() });
                let (classes, regressors) = self.classes(frame)?;
                pass::pass_for_remote(classes, regressors, &point, *detail, flat.as_ref()).numbers()
            }
            _ => return None,
        };
        Some(numbers.iter().all(|x| x.is_finite()).then_some(numbers))
    }

    /// The classes in these coordinates, with the elements that regressions act on; `None` where the coordinates do not
    /// fit this model.
    pub(crate) fn classes(&mut self, frame: &Frame) -> Option<(&Classes, &Regressors)> {
        let fits = self.is_state(&frame.centre) && self.is_state(&frame.scale);
        if !fits || !self.has_each_covariate(frame) {
            return None;
        }
        if self.gathered.as_ref().is_none_or(|(known, _)| known != frame) {
            let classes = Classes::in_frame(self.evidence(), frame, self.elements.clone(), true);
            let classes = match &self.grouping {
                Some(grouping) => classes.in_groups(self.evidence(), grouping),
                None => classes,
            };
            self.gathered = Some((frame.clone(), classes));
        }
        let (_, classes) = self.gathered.as_ref()?;
        Some((classes, &self.regressors))
    }

    /// The classes of the tests as if there were no groups, in these coordinates; `None` where the coordinates do not
    /// fit this model.
    pub fn apart(&mut self, frame: &Frame) -> Option<Cow<'_, Classes>> {
        if self.grouping.is_none() {
            return self.classes(frame).map(|(classes, _)| Cow::Borrowed(classes));
        }
        let fits = [&frame.centre, &frame.scale].iter().all(|numbers| numbers.len() == self.states);
        if !fits || !self.has_each_covariate(frame) {
            return None;
        }
        let elements = Elements::new(self.elements.blocks()[..1].to_vec());
        Some(Cow::Owned(Classes::in_frame(&self.reductions, frame, elements, true)))
    }

    /// The distribution of ξ of each test, from the form that is sent; `None` where the form does not fit this model.
    pub fn law(&mut self, law: &Law) -> Option<InitialLaw> {
        let own = InitialLaw::from_message(law, (self.states, self.regressors.len()))?;
        let Some(given) = &law.given else { return self.grouping.is_none().then_some(own) };
        let point = self.point(&given.place)?;
        let (classes, regressors) = self.classes(&given.frame)?;
        Some(within_units(own, (classes.units.as_ref()?, &classes.frame), (&point, regressors)))
    }

    fn survey(&self) -> Vec<f64> {
        let (evidence, all) = (self.evidence(), (0..self.reductions.len()).collect::<Vec<usize>>());
        let pooled = Pooled::all(evidence, &all, (self.elements.states(), self.regressors.len()));
        let head = Counts::of(evidence).numbers();
        let present = match &self.grouping {
            Some(grouping) => {
                let groups = (0..grouping.depth()).map(|level| grouping.groups(level).len());
                std::iter::once(all.len()).chain(groups).map(|count| count as f64).collect()
            }
            None => present(evidence, &self.elements),
        };
        head.into_iter().chain(present).chain(pooled.numbers()).collect()
    }

    /// Whether a frame has a centre and a scale for each covariate.
    fn has_each_covariate(&self, frame: &Frame) -> bool {
        [&frame.covariate_centre, &frame.covariate_scale].iter().all(|of| of.len() == self.regressors.len())
    }

    fn is_state(&self, numbers: &[f64]) -> bool {
        numbers.len() == self.elements.states()
    }

    fn point(&self, place: &Place) -> Option<Point> {
        let p = self.elements.states();
        let fits = self.is_state(&place.mean) && place.coefficients.len() == self.regressors.len();
        let root = by_columns(p, &place.root).filter(|_| fits)?;
        Some(Point { mean: place.mean.clone(), coefficients: place.coefficients.clone(), root })
    }

    fn flat(&self, flat: &Flat) -> Option<(DMatrix<f64>, Option<DMatrix<f64>>)> {
        let rows = self.elements.states() + self.regressors.len();
        let jacobian = by_columns(rows, &flat.jacobian).filter(|jacobian| jacobian.ncols() == flat.free)?;
        let covariance = match &flat.covariance {
            Some(numbers) => Some(by_columns(flat.free, numbers).filter(|square| square.is_square())?),
            None => None,
        };
        Some((jacobian, covariance))
    }
}
