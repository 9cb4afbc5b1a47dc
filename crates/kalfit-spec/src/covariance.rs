//! `[covariance]`: the structure of Σ.

use kalfit::model::{CovarianceKind, CovarianceStructure, FixedElement, State};
use nalgebra::DMatrix;

use crate::constraints::{FixedElements, OpenStructure, equal_groups, fixed_elements};
use crate::elements::NamedElements;
use crate::error::{Result, SpecError, SpecProblem, StructureProblem};
use crate::keys;
use crate::matrix::ExpressionMatrix;
use crate::names::NameContext;
use crate::states;
use crate::suggest::either;
use crate::table::{TomlField, TomlTable};

/// Structures that other constraints combine with.
const OPEN: [&str; 3] = ["full", "diagonal", "blocks"];
const WITH_MATRIX: [&str; 3] = ["proportional", "correlation", "fixed"];

/// Opens `[covariance]` and reads the order of the estimated states.
pub(crate) fn open<'d>(
    context: &NameContext<'_>,
    field: Option<&TomlField<'d>>,
    states: &[State],
) -> Result<(Option<TomlTable<'d>>, Vec<usize>)> {
    let mut estimated = states::estimated(states);
    let Some(field) = field else { return Ok((None, estimated)) };
    let section = field.section(context.phase.table("covariance"))?;
    if let (false, Some(states)) = (context.grouped, section.peek("states")) {
        let hint = "`random = false` of a state says that it has one value common to all tests";
        return Err(states.no_effect("without `levels` in `[data]`").hint(hint));
    }
    let mut section = section.with_keys(if context.grouped { keys::COVARIANCE_IN_GROUPS } else { keys::COVARIANCE })?;
    if let Some(order) = section.take("order") {
        let elements = NamedElements::new(states, &estimated);
        let place = &order.what();
        let mut listed = vec![false; estimated.len()];
        let mut ordered = Vec::with_capacity(estimated.len());
        for (name, span) in order.texts()? {
            let i = elements.find(name, place, &span)?;
            if std::mem::replace(&mut listed[i], true) {
                let problem = StructureProblem::ListedTwice { name: name.to_owned(), place: place.to_owned() };
                return Err(SpecError::new(problem).at(span));
            }
            ordered.push(estimated[i]);
        }
        if let Some(i) = listed.iter().position(|listed| !listed) {
            let problem = StructureProblem::NotListed { name: elements.name(i), place: place.to_owned() };
            return Err(SpecError::new(problem).at(order.span).hint("the order names every estimated state once"));
        }
        estimated = ordered;
    }
    Ok((Some(section), estimated))
}

/// Opens the covariance of a level of groups.
pub(crate) fn open_level<'d>(field: &TomlField<'d>, place: String) -> Result<TomlTable<'d>> {
    let section = field.section(place)?;
    for (key, hint) in [
        ("order", "at every level the states have the order of `[covariance]`"),
        ("known", "known covariance is that of tests: it stands in `[covariance]`"),
    ] {
        if let Some(field) = section.peek(key) {
            let problem = SpecProblem::UnknownKey { key: key.to_owned(), place: section.place.clone() };
            return Err(SpecError::new(problem).at(field.key_span).hint(hint));
        }
    }
    section.with_keys(keys::COVARIANCE_OF_LEVEL)
}

/// Reads the rest of `[covariance]`, or the covariance of a level of groups.
pub(crate) fn read(
    context: &mut NameContext<'_>,
    section: Option<TomlTable<'_>>,
    elements: &NamedElements,
) -> Result<CovarianceStructure> {
    let mut covariance = CovarianceStructure::full();
    let Some(mut section) = section else {
        covariance.fixed = FixedElements::of_still(elements).into_elements();
        return Ok(covariance);
    };
    let listed = section.take("states").map(|list| elements.varying(&list)).transpose()?;
    let elements = listed.as_ref().unwrap_or(elements);
    let named = section.take("structure");
    let word = named.as_ref().map_or(Ok(0), |field| field.word(&keys::STRUCTURES))?;
    let word = keys::STRUCTURES[word];
    refuse_idle(&section, word)?;
    let blocks = blocks(&mut section, elements, word)?;
    let matrix = matrix(context, &mut section, elements, word)?;
    let structure = OpenStructure { word, block_of: block_of(&blocks, elements.len()), elements };
    let mut fixed = fixed_elements(&structure, section.take("fixed").as_ref())?;
    covariance.equal = equal_groups(&structure, section.take("equal").as_ref(), &fixed)?;
    if let Some(start) = section.take("start") {
        covariance.start = Some(start_matrix(&structure, &start, &fixed, &covariance.equal)?);
    }
    if WITH_MATRIX.contains(&word) {
        fixed = FixedElements::of_still(elements);
    }
    covariance.fixed = fixed.into_elements();
    if let Some(known) = section.take("known") {
        covariance.known = Some(ExpressionMatrix::read(context, &known, elements)?.entries);
    }
    covariance.kind = match (word, matrix) {
        ("diagonal", _) => CovarianceKind::Diagonal,
        ("blocks", _) => CovarianceKind::Blocks(blocks.expect("blocks were read")),
        ("proportional", Some(matrix)) => CovarianceKind::Proportional(matrix),
        ("correlation", Some(matrix)) => CovarianceKind::Correlation(matrix),
        ("fixed", Some(matrix)) => CovarianceKind::Fixed(matrix),
        _ => CovarianceKind::Full,
    };
    section.finish("here", None)?;
    Ok(covariance)
}

/// Keys that the structure has no place for.
fn refuse_idle(section: &TomlTable<'_>, word: &str) -> Result<()> {
    let why = format!("with structure `{word}`");
    for (key, allowed) in
        [("blocks", &["blocks"][..]), ("matrix", &WITH_MATRIX), ("fixed", &OPEN), ("equal", &OPEN), ("start", &OPEN)]
    {
        if let Some(field) = section.peek(key)
            && !allowed.contains(&word)
        {
            return Err(field.no_effect(&why).hint(format!("`{key}` goes with structure {}", either(allowed))));
        }
    }
    Ok(())
}

type StateBlocks = Option<Vec<Vec<usize>>>;

fn blocks(section: &mut TomlTable<'_>, elements: &NamedElements, word: &str) -> Result<StateBlocks> {
    if word != "blocks" {
        return Ok(None);
    }
    let field = section.need("blocks")?;
    let place = &field.what();
    let mut listed = vec![false; elements.len()];
    let mut blocks = Vec::new();
    for block in field.items("an array of arrays of names")? {
        let mut members = Vec::new();
        for (name, span) in block.texts()? {
            let i = elements.find(name, place, &span)?;
            if std::mem::replace(&mut listed[i], true) {
                let problem = StructureProblem::ListedTwice { name: name.to_owned(), place: place.to_owned() };
                return Err(SpecError::new(problem).at(span));
            }
            members.push(i);
        }
        if members.is_empty() {
            let (place, found, expected) = (place.to_owned(), "an empty block", "names of states");
            return Err(SpecError::new(StructureProblem::TooFew { place, found, expected }).at(block.span));
        }
        blocks.push(members);
    }
    blocks.extend((0..elements.len()).filter(|&i| !listed[i]).map(|i| vec![i]));
    Ok(Some(blocks))
}

fn block_of(blocks: &StateBlocks, p: usize) -> Vec<usize> {
    let mut block_of = vec![0; p];
    for (block, members) in blocks.iter().flatten().enumerate() {
        for &i in members {
            block_of[i] = block;
        }
    }
    block_of
}

fn matrix(
    context: &mut NameContext<'_>,
    section: &mut TomlTable<'_>,
    elements: &NamedElements,
    word: &str,
) -> Result<Option<Vec<Vec<kalfit::Expression>>>> {
    if !WITH_MATRIX.contains(&word) {
        return Ok(None);
    }
    let Some(field) = section.take("matrix") else {
        let problem = SpecProblem::MissingKey { key: "matrix".to_owned(), place: section.place.clone() };
        let hint = format!("structure `{word}` needs `matrix`, with a row for every estimated state");
        return Err(SpecError::new(problem).at(section.span.clone()).hint(hint));
    };
    let matrix = ExpressionMatrix::read(context, &field, elements)?;
    match word {
        "correlation" => matrix.check_unit_diagonal(elements)?,
        "proportional" => matrix.check_not_zero()?,
        _ => {}
    }
    matrix.check_still(elements, word == "correlation")?;
    Ok(Some(matrix.entries))
}

/// A start value: numbers that meet the other constraints.
fn start_matrix(
    structure: &OpenStructure<'_>,
    field: &TomlField<'_>,
    fixed: &FixedElements,
    equal: &[Vec<(usize, usize)>],
) -> Result<DMatrix<f64>> {
    let (elements, p) = (structure.elements, structure.elements.len());
    let matrix = ExpressionMatrix::read_numbers(field, elements)?;
    let value = |i: usize, j: usize| matrix.entries[i][j].as_number().expect("only numbers were read");
    let wrong = |i: usize, j: usize, why: String| {
        let element = elements.pair_name(i, j);
        Err(matrix.at(i, j, StructureProblem::Start { element, found: value(i, j), why }))
    };
    for i in 0..p {
        for j in 0..=i {
            if structure.is_zero(i, j) && value(i, j) != 0.0 {
                return wrong(i, j, format!("structure `{}` makes it 0", structure.word));
            }
            if let Some(known) = fixed.value(i, j).filter(|known| *known != value(i, j)) {
                return wrong(i, j, format!("it is fixed at {known}"));
            }
        }
    }
    for group in equal {
        let (first, rest) = group.split_first().expect("a group has elements");
        if let Some(&(i, j)) = rest.iter().find(|(i, j)| value(*i, *j) != value(first.0, first.1)) {
            let other = elements.pair_name(first.0, first.1);
            return wrong(i, j, format!("it equals element `{other}`, which starts at {}", value(first.0, first.1)));
        }
    }
    Ok(DMatrix::from_fn(p, p, value))
}

impl FixedElements {
    fn into_elements(self) -> Vec<FixedElement> {
        self.values.into_iter().map(|((i, j), (value, _))| FixedElement { i, j, value }).collect()
    }
}
