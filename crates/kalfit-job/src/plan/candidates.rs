//! Candidates: the tests, or units of the outermost level, of a table, with cost and largest number of each.

use kalfit::model::Column;
use kalfit::plan::optimal::Kinds;
use kalfit::{Evidence, Labels, PhasedModel, PhasedTest};
use kalfit_data::{DataError, DataReading, Datum};
use kalfit_spec::Spec;

use crate::evidence::CommandInputs;
use crate::failure::Failure;
use crate::job::BestPlanRequest;
use crate::plan::error::BestPlanError;
use crate::tests;
use crate::work::JobWork;

/// The columns that are read where the data have them and none is named.
const COST: &str = "cost";
const MOST: &str = "most";

/// The tests of the candidates, as they were read.
pub(super) struct ReadCandidates {
    pub(super) tests: Vec<PhasedTest>,
    pub(super) reading: DataReading,
    /// Columns of cost and largest number: name, and place among the columns of texts.
    columns: [Option<(String, usize)>; 2],
}

/// Reads the tests of the candidates with their costs and numbers.
pub(super) fn read(
    spec: &Spec,
    request: &BestPlanRequest,
    given: &CommandInputs,
    work: &mut JobWork<'_>,
) -> Result<ReadCandidates, Failure> {
    let mut names = [
        (request.cost.clone().unwrap_or_else(|| COST.to_owned()), request.cost.is_some()),
        (request.most.clone().unwrap_or_else(|| MOST.to_owned()), request.most.is_some()),
    ]
    .map(Some);
    loop {
        let (model, columns) = with_columns(&spec.model, &names);
        match tests::read_for(spec, &model, given, work) {
            Ok((tests, reading)) => return Ok(ReadCandidates { tests, reading, columns }),
            Err(failure) => {
                // a column that nobody named may be absent
                let absent = |name: &Option<(String, bool)>| match (name, &failure) {
                    (Some((name, false)), Failure::Data { error, .. }) => {
                        matches!(&**error, DataError::MissingColumn { column, .. } if column == name)
                    }
                    _ => false,
                };
                match names.iter().position(absent) {
                    Some(at) if !given.inputs.iter().any(|input| matches!(input, kalfit_data::Input::Stdin)) => {
                        names[at] = None
                    }
                    _ => return Err(failure),
                }
            }
        }
    }
}

/// The model with columns of texts for costs and numbers.
fn with_columns(
    model: &PhasedModel,
    names: &[Option<(String, bool)>; 2],
) -> (PhasedModel, [Option<(String, usize)>; 2]) {
    let mut model = model.clone();
    let options = ["`--cost`", "`--most`"];
    let mut places = [None, None];
    for (at, name) in names.iter().enumerate() {
        let Some((name, _)) = name else { continue };
        let known = model.shared().text_columns.iter().position(|column| column.name == *name);
        let place = known.unwrap_or(model.shared().text_columns.len());
        if known.is_none() {
            for own in model.models_mut() {
                own.text_columns.push(Column { name: name.clone(), used_in: options[at].to_owned() });
            }
        }
        places[at] = Some((name.clone(), place));
    }
    (model, places)
}

impl ReadCandidates {
    /// Cost and largest number of each candidate; `members`: the tests of each.
    pub(super) fn kinds(&self, names: &[String], members: &[Vec<usize>], budget: f64) -> Result<Kinds, BestPlanError> {
        let labels = &self.reading.labels;
        let numbers = |which: usize, otherwise: f64, expected, is_possible: &dyn Fn(f64) -> bool| {
            let Some((column, place)) = &self.columns[which] else { return Ok(vec![otherwise; names.len()]) };
            let of = |(name, members): (&String, &Vec<usize>)| {
                let text = self.text((name, members), (column, *place), labels)?;
                match text.trim() {
                    "" if which == 1 => Ok(otherwise),
                    text => text.parse().ok().filter(|number| is_possible(*number)).ok_or_else(|| {
                        let (candidate, column, found) = (name.clone(), column.clone(), text.to_owned());
                        BestPlanError::Number { candidate, column, found, expected }
                    }),
                }
            };
            names.iter().zip(members).map(of).collect::<Result<Vec<f64>, _>>()
        };
        let costs = numbers(0, 1.0, "a number above zero", &|cost| cost > 0.0 && cost.is_finite())?;
        let is_whole = |most: f64| most >= 0.0 && most == most.floor() && most <= 1e9;
        let most = numbers(1, f64::INFINITY, "a whole number, or nothing where there is no limit", &is_whole)?;
        Ok(Kinds { costs, most, budget })
    }

    /// The text that all rows of a candidate have in a column.
    fn text(
        &self,
        (name, members): (&String, &[usize]),
        (column, place): (&str, usize),
        labels: &Labels,
    ) -> Result<String, BestPlanError> {
        let rows = members.iter().flat_map(|&at| self.tests[at].phases.iter().filter_map(Evidence::cells));
        let mut texts = rows.flat_map(|test| (0..test.rows()).map(|row| test.texts(row)[place]));
        let Some(first) = texts.next() else { return Ok(String::new()) };
        match texts.find(|other| *other != first) {
            Some(other) => Err(BestPlanError::Varies {
                candidate: name.clone(),
                column: column.to_owned(),
                first: labels.text(first).to_owned(),
                second: labels.text(other).to_owned(),
            }),
            None => Ok(labels.text(first).to_owned()),
        }
    }
}

/// Tests that were made, from their files.
pub(super) fn read_made(
    spec: &mut Spec,
    data: &[Datum],
    work: &mut JobWork<'_>,
) -> Result<(Vec<PhasedTest>, DataReading), Failure> {
    let given = CommandInputs::open(spec, data)?;
    tests::read(spec, &given, work)
}
