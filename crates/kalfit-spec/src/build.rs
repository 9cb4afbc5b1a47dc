//! From the text of a model file to the model.

use std::collections::BTreeMap;

use kalfit::Model;
use sha2::{Digest, Sha256};
use toml::de::DeTable;

use crate::data::Data;
use crate::elements::Elements;
use crate::error::{Problem, Result, Span, SpecError};
use crate::names::{Context, Index, Role};
use crate::table::Section;
use crate::{Spec, covariance, data, mean, measurements, noise, parameters, states};

/// Largest model file, in bytes.
pub(crate) const MAX_BYTES: u64 = 4 * 1024 * 1024;
const KEYS: [&str; 11] = [
    "title",
    "data",
    "states",
    "process_noise_covariance",
    "measurements",
    "noise_covariance",
    "parameters",
    "mean",
    "covariance",
    "phases",
    "filter",
];

/// Places that messages about data and results point to.
#[derive(Debug, Clone, Default)]
pub(crate) struct Places {
    pub(crate) columns: BTreeMap<String, Span>,
    pub(crate) parameters: BTreeMap<String, Span>,
    pub(crate) states: BTreeMap<String, Span>,
    pub(crate) measurements: BTreeMap<String, Span>,
    pub(crate) roles: Vec<Role>,
}

/// Reads a whole model file.
pub(crate) fn spec(name: &str, text: &str) -> Result<Spec> {
    let found = text.len() as u64;
    if found > MAX_BYTES {
        return Err(SpecError::new(Problem::TooLarge { found, limit: MAX_BYTES }));
    }
    let table = DeTable::parse(text).map_err(|error| not_toml(&error, text))?;
    let root = Section::open("the model file", table.span(), table.get_ref()).only(&KEYS)?;
    for key in ["phases", "filter"] {
        if let Some(field) = root.peek(key) {
            let problem = Problem::Unsupported { what: format!("`[{key}]`") };
            return Err(SpecError::new(problem).at(field.key_span));
        }
    }
    let (model, data, places) = model(text, root)?;
    Ok(Spec {
        model: model.into(),
        layout: data.layout,
        digest: digest(text),
        name: name.to_owned(),
        text: text.to_owned(),
        places,
    })
}

pub(crate) fn model(text: &str, mut root: Section<'_>) -> Result<(Model, Data, Places)> {
    let title = root.take("title").map_or(Ok(""), |title| title.text())?.to_owned();
    let mut context = Context::new(text);
    let mut data = data::read(&mut context, root.take("data"))?;
    let declared = parameters::read(&mut context, root.take("parameters"))?;
    let named = states::declare(&mut context, root.take("states").as_ref())?;
    let states = states::lower(&mut context, named)?;
    let process_noise = root.take("process_noise_covariance");
    let process_noise_covariance = noise::between_states(&mut context, process_noise, &states)?;
    let (measurements, measured) = measurements::read(&mut context, root.take("measurements").as_ref())?;
    let noises = root.take("noise_covariance");
    let noise_covariance = noise::between_measurements(&mut context, noises, &measurements, &measured)?;
    let (section, estimated) = covariance::open(root.take("covariance").as_ref(), &states)?;
    let elements = Elements::new(&states, &estimated);
    let mean = mean::read(&mut context, root.take("mean").as_ref(), &estimated, &elements)?;
    let covariance = covariance::read(&mut context, section, &elements)?;
    let parameters = parameters::finish(&context, declared)?;
    let (clock, group) = (std::mem::take(&mut data.clock), data.group);
    let places = places(&mut context, measured);
    let (columns, text_columns, literals) = (context.columns, context.text_columns, context.literals.texts);
    let model = Model {
        title,
        columns,
        text_columns,
        literals,
        parameters,
        states,
        process_noise_covariance,
        measurements,
        noise_covariance,
        clock,
        group,
        estimated,
        mean,
        covariance,
    };
    data.check(&model)?;
    Ok((model, data, places))
}

fn places(context: &mut Context<'_>, measured: Index) -> Places {
    Places {
        columns: std::mem::take(&mut context.column_spans),
        parameters: std::mem::take(&mut context.parameters).into_spans(),
        states: std::mem::take(&mut context.states).into_spans(),
        measurements: measured.into_spans(),
        roles: context.roles.iter().map(|role| role.unwrap_or(Role::Coefficient)).collect(),
    }
}

pub(crate) fn not_toml(error: &toml::de::Error, text: &str) -> SpecError {
    let what = error.message().lines().next().unwrap_or_default().trim_end_matches('.').to_owned();
    let wrong = SpecError::new(Problem::Toml { what });
    match error.span() {
        Some(span) => wrong.at(span.start.min(text.len())..span.end.min(text.len())),
        None => wrong,
    }
}

pub(crate) fn digest(text: &str) -> String {
    let bytes = Sha256::digest(text.as_bytes());
    let hex: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
    format!("sha256:{hex}")
}
