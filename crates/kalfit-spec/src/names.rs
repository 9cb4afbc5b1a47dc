//! What names mean, and what was made of the data's columns so far.

use std::collections::{BTreeMap, HashMap};

use kalfit::model::Column;

use crate::error::{ExpressionProblem, Result, Span, SpecError, SpecProblem};
use crate::token::is_name;
use crate::vocabulary::is_reserved;

/// Longest name of a state, parameter or measurement, in bytes.
const MAX_NAME: usize = 100;
/// Parts of all expanded equations together: it bounds the memory that a small file can ask for.
const MAX_PARTS: usize = 1_000_000;

/// Names with their indices.
#[derive(Debug, Clone, Default)]
pub(crate) struct NameIndex {
    names: Vec<String>,
    by_name: HashMap<String, usize>,
    spans: Vec<Span>,
}

impl NameIndex {
    /// Adds a name; a name added before keeps its index.
    pub(crate) fn add(&mut self, name: &str, span: Span) -> usize {
        if let Some(&index) = self.by_name.get(name) {
            return index;
        }
        self.by_name.insert(name.to_owned(), self.names.len());
        self.names.push(name.to_owned());
        self.spans.push(span);
        self.names.len() - 1
    }

    pub(crate) fn get(&self, name: &str) -> Option<usize> {
        self.by_name.get(name).copied()
    }

    pub(crate) fn name(&self, index: usize) -> &str {
        &self.names[index]
    }

    pub(crate) fn names(&self) -> impl Iterator<Item = &str> {
        self.names.iter().map(String::as_str)
    }

    pub(crate) fn span(&self, index: usize) -> Span {
        self.spans[index].clone()
    }

    /// Name and place of each.
    pub(crate) fn spans(&self) -> BTreeMap<String, Span> {
        self.names.iter().cloned().zip(self.spans.iter().cloned()).collect()
    }
}

/// A phase as messages name it, and which tables it has of its own.
#[derive(Debug, Default)]
pub(crate) struct PhaseInWords {
    /// Its name; `None` in a file without phases.
    pub(crate) name: Option<String>,
    /// Tables that stand in `[phases.NAME]`; the others are those of the top level.
    pub(crate) own: Vec<&'static str>,
}

impl PhaseInWords {
    /// The name of the phase, where it has the table itself.
    fn owner(&self, table: &str) -> Option<&str> {
        self.name.as_deref().filter(|_| self.own.contains(&table))
    }

    /// "`[mean]`", or "`[phases.coast.mean]`" where the phase has its own.
    pub(crate) fn table(&self, table: &str) -> String {
        match self.owner(table) {
            None => format!("`[{table}]`"),
            Some(phase) => format!("`[{}.{table}]`", phase_key(phase)),
        }
    }

    /// "state `a`", or "state `a` of phase `coast`" where the phase has the table of the states itself.
    pub(crate) fn entry(&self, table: &str, what: &str, name: &str) -> String {
        match self.owner(table) {
            None => format!("{what} `{name}`"),
            Some(phase) => format!("{what} `{name}` of phase `{phase}`"),
        }
    }
}

/// `phases.coast`, quoted where TOML wants it.
pub(crate) fn phase_key(phase: &str) -> String {
    table_key("phases", phase)
}

/// `table.name`, quoted where TOML wants it.
pub(crate) fn table_key(table: &str, name: &str) -> String {
    let bare = !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-');
    if bare { format!("{table}.{name}") } else { format!("{table}.\"{name}\"") }
}

/// What a parameter does, as far as its sign is concerned; the strictest use counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum ParameterRole {
    /// Any number.
    Coefficient,
    /// A noise variance: not negative.
    Variance,
    /// A standard deviation: not negative.
    StandardDeviation,
    /// A time constant: positive.
    TimeConstant,
}

impl From<kalfit::model::Role> for ParameterRole {
    fn from(role: kalfit::model::Role) -> ParameterRole {
        use kalfit::model::Role as Served;
        match role {
            Served::Scale { power: 2 } => ParameterRole::StandardDeviation,
            Served::Scale { .. } => ParameterRole::Variance,
            Served::TimeConstant => ParameterRole::TimeConstant,
            Served::Other => ParameterRole::Coefficient,
        }
    }
}

impl ParameterRole {
    pub(crate) fn words(self) -> &'static str {
        match self {
            ParameterRole::Coefficient => "parameter",
            ParameterRole::Variance => "noise variance",
            ParameterRole::StandardDeviation => "standard deviation",
            ParameterRole::TimeConstant => "time constant",
        }
    }

    /// What values may be, when not all.
    pub(crate) fn expected(self, value: f64) -> Option<&'static str> {
        match self {
            ParameterRole::TimeConstant if value <= 0.0 => Some("more than 0"),
            ParameterRole::Variance | ParameterRole::StandardDeviation if value < 0.0 => Some("0 or more"),
            _ => None,
        }
    }
}

/// What is read of a model file beside its motion and its population.
#[derive(Debug, Clone, Copy)]
pub(crate) struct OptionalTables {
    /// Measurements, their filters, and the groups of reports.
    pub(crate) measurements: bool,
    /// Levels of groups.
    pub(crate) levels: bool,
}

/// The names of a model and what its expressions used of them.
#[derive(Debug)]
pub(crate) struct NameContext<'t> {
    /// The model file.
    pub(crate) source: &'t str,
    /// What is read of it.
    pub(crate) reads: OptionalTables,
    /// The phase that is being read.
    pub(crate) phase: PhaseInWords,
    /// States of the phase that is being read.
    pub(crate) states: NameIndex,
    pub(crate) parameters: NameIndex,
    /// Column that each parameter has a value per level of.
    pub(crate) levels: Vec<Option<usize>>,
    /// How each parameter is used; `None` when it is not.
    pub(crate) roles: Vec<Option<ParameterRole>>,
    /// The data have time.
    pub(crate) time: bool,
    /// Tests stand in groups.
    pub(crate) grouped: bool,
    pub(crate) columns: Vec<Column>,
    pub(crate) text_columns: Vec<Column>,
    columns_by_name: HashMap<String, usize>,
    text_columns_by_name: HashMap<String, usize>,
    pub(crate) literals: TextLiterals,
    /// First use of each column, numeric or text.
    pub(crate) column_spans: BTreeMap<String, Span>,
    parts: usize,
}

/// Texts that the model names, each once.
#[derive(Debug, Default)]
pub(crate) struct TextLiterals {
    pub(crate) texts: Vec<String>,
    by_text: HashMap<String, usize>,
}

impl TextLiterals {
    /// The index of a text.
    pub(crate) fn add(&mut self, text: &str) -> usize {
        if let Some(&index) = self.by_text.get(text) {
            return index;
        }
        self.by_text.insert(text.to_owned(), self.texts.len());
        self.texts.push(text.to_owned());
        self.texts.len() - 1
    }
}

impl<'t> NameContext<'t> {
    pub(crate) fn new(source: &'t str) -> NameContext<'t> {
        NameContext {
            source,
            reads: OptionalTables { measurements: true, levels: true },
            phase: PhaseInWords::default(),
            states: NameIndex::default(),
            parameters: NameIndex::default(),
            levels: Vec::new(),
            roles: Vec::new(),
            time: false,
            grouped: false,
            columns: Vec::new(),
            text_columns: Vec::new(),
            columns_by_name: HashMap::new(),
            text_columns_by_name: HashMap::new(),
            literals: TextLiterals::default(),
            column_spans: BTreeMap::new(),
            parts: 0,
        }
    }

    /// Index of a numeric column.
    pub(crate) fn column(&mut self, name: &str, span: Span, place: &str) -> usize {
        self.see_column(name, span);
        intern(&mut self.columns, &mut self.columns_by_name, name, place)
    }

    /// Index of a text column.
    pub(crate) fn text_column(&mut self, name: &str, span: Span, place: &str) -> usize {
        self.see_column(name, span);
        intern(&mut self.text_columns, &mut self.text_columns_by_name, name, place)
    }

    /// Remembers where a column is used first.
    pub(crate) fn see_column(&mut self, name: &str, span: Span) {
        self.column_spans.entry(name.to_owned()).or_insert(span);
    }

    /// Notes what a parameter is used as.
    pub(crate) fn use_parameter(&mut self, index: usize, role: ParameterRole) {
        let known = &mut self.roles[index];
        *known = (*known).max(Some(role));
    }

    /// Counts parts of expanded equations; an error when there are too many.
    pub(crate) fn spend(&mut self, parts: usize) -> std::result::Result<(), ExpressionProblem> {
        self.parts = self.parts.saturating_add(parts);
        if self.parts > MAX_PARTS { Err(ExpressionProblem::ModelTooLarge { limit: MAX_PARTS }) } else { Ok(()) }
    }
}

fn intern(columns: &mut Vec<Column>, by_name: &mut HashMap<String, usize>, name: &str, place: &str) -> usize {
    if let Some(&index) = by_name.get(name) {
        return index;
    }
    by_name.insert(name.to_owned(), columns.len());
    columns.push(Column { name: name.to_owned(), used_in: place.to_owned() });
    columns.len() - 1
}

/// Refuses names of states and parameters that expressions could not hold.
pub(crate) fn check_name(what: &'static str, name: &str, span: &Span) -> Result<()> {
    let why = if name.len() > MAX_NAME {
        "it is longer than 100 bytes"
    } else if is_reserved(name) {
        "it is a word of the expression language"
    } else if !is_name(name) {
        "only letters, digits and `_` can stand in expressions, and a digit cannot come first"
    } else {
        return Ok(());
    };
    Err(SpecError::new(SpecProblem::BadName { what, name: shortened(name), why }).at(span.clone()))
}

/// Refuses names of measurements that element names could not hold.
pub(crate) fn check_label(what: &'static str, name: &str, span: &Span) -> Result<()> {
    let why = if name.len() > MAX_NAME {
        "it is longer than 100 bytes"
    } else if name.trim() != name || name.is_empty() {
        "it is empty or has spaces around it"
    } else if name.contains([',', '"']) || name.chars().any(char::is_control) {
        "commas, quotes and control characters are not allowed"
    } else {
        return Ok(());
    };
    Err(SpecError::new(SpecProblem::BadName { what, name: shortened(name), why }).at(span.clone()))
}

/// The start of a long name.
fn shortened(name: &str) -> String {
    if name.len() <= MAX_NAME { name.to_owned() } else { format!("{}…", name.chars().take(20).collect::<String>()) }
}
