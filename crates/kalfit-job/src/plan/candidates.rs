//! Candidates: the tests, or units of the outermost level, of a table, with cost and largest number of each.

use kalfit::model::Column;
use kalfit::plan::optimal::{Kinds, MOST_TESTS};
use kalfit::{Evidence, Label, Labels, PhasedModel, PhasedTest};
use kalfit_data::{DataError, DataReading, Datum, Input};
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
                // a column that nobody named may be absent, but not from one of several files
                let absent = |name: &Option<(String, bool)>| match (name, &failure) {
                    (Some((name, false)), Failure::Data { error, .. }) => {
                        matches!(&**error, DataError::MissingColumn { column, .. } if column == name)
                    }
                    _ => false,
                };
                let Some(at) = names.iter().position(absent) else { return Err(failure) };
                let column = names[at].take().map_or_else(String::new, |(name, _)| name);
                if given.inputs.iter().any(|input| matches!(input, Input::Stdin)) {
                    return Err(BestPlanError::Stdin { column }.into());
                }
                if given.inputs.len() > 1 && is_in_some(spec, &column, given, work)? {
                    return Err(failure);
                }
            }
        }
    }
}

/// Whether some of several files has a column.
fn is_in_some(spec: &Spec, column: &str, given: &CommandInputs, work: &mut JobWork<'_>) -> Result<bool, Failure> {
    for input in &given.inputs {
        let (model, _) = with_columns(&spec.model, &[Some((column.to_owned(), true)), None]);
        match tests::read_for(spec, &model, &CommandInputs::rows_of(vec![input.clone()]), work) {
            Ok(_) => return Ok(true),
            Err(Failure::Interrupted) => return Err(Failure::Interrupted),
            Err(_) => {}
        }
    }
    Ok(false)
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
                let read = |text: &str| match text.trim() {
                    "" if which == 1 => Ok(otherwise),
                    text => text.parse().ok().filter(|number| is_possible(*number)).ok_or_else(|| {
                        let (candidate, column, found) = (name.clone(), column.clone(), text.to_owned());
                        BestPlanError::Number { candidate, column, found, expected }
                    }),
                };
                let mut first: Option<(&str, f64)> = None;
                for text in self.texts(members, *place, labels) {
                    let number = read(text)?;
                    match first {
                        Some((other, found)) if found != number => {
                            let (candidate, column) = (name.clone(), column.clone());
                            let (first, second) = (other.to_owned(), text.to_owned());
                            return Err(BestPlanError::Varies { candidate, column, first, second });
                        }
                        _ => first = Some((text, number)),
                    }
                }
                Ok(first.map_or(otherwise, |(_, number)| number))
            };
            names.iter().zip(members).map(of).collect::<Result<Vec<f64>, _>>()
        };
        let costs = numbers(0, 1.0, "a number above zero", &|cost| cost > 0.0 && cost.is_finite())?;
        let is_whole = |most: f64| most >= 0.0 && most == most.floor() && most.is_finite();
        let most = numbers(1, f64::INFINITY, "a whole number, or nothing where there is no limit", &is_whole)?;
        let most = most.into_iter().map(|most| most.min(MOST_TESTS)).collect();
        Ok(Kinds { costs, most, budget })
    }

    /// The texts that the rows of a candidate have in a column, each once in a row.
    fn texts<'a>(&self, members: &[usize], place: usize, labels: &'a Labels) -> Vec<&'a str> {
        let rows = members.iter().flat_map(|&at| self.tests[at].phases.iter().filter_map(Evidence::cells));
        let mut found: Vec<Label> = rows.flat_map(|test| (0..test.rows()).map(|row| test.texts(row)[place])).collect();
        found.dedup();
        found.into_iter().map(|label| labels.text(label)).collect()
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
