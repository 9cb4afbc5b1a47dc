//! Figures: the numbers and words that a record reports. Each is declared once, as a field of its record: what it
//! means, its name in fit.json, its column in tables, and what people read beside it.

/// One figure of records `R`.
#[derive(Debug)]
pub struct Figure<R> {
    /// Name of the field, in the record and in fit.json.
    pub name: &'static str,
    /// What the figure is, in the words of the reference of fit.json.
    pub doc: &'static str,
    /// What its values are.
    pub kind: FigureKind,
    /// Unit of its values, which decides how many digits people read.
    pub unit: FigureUnit,
    /// Name of its column in tables that a fit writes; `None` where it has none.
    pub column: Option<&'static str>,
    /// Heading in the tables of summary and report; `None` where it is not in them.
    pub heading: Option<&'static str>,
    /// A sentence that explains the heading.
    pub sentence: Option<&'static str>,
    /// Value of the figure in a record.
    pub get: for<'r> fn(&'r R) -> FigureValue<'r>,
}

/// What the values of a figure are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FigureKind {
    /// Texts.
    Text,
    /// Numbers.
    Number,
    /// Whole numbers from zero on.
    Count,
}

/// Unit of a figure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FigureUnit {
    /// A number without a unit of its own, such as a statistic.
    Number,
    /// Logarithm of a density, in nats.
    LogLikelihood,
    /// Probability, 0 to 1.
    Probability,
    /// Standard deviations of what the figure is of.
    Deviations,
    /// The unit of the element that the record is of.
    Element,
}

/// Value of a figure in one record.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FigureValue<'r> {
    /// A text.
    Text(&'r str),
    /// A number.
    Number(f64),
    /// A whole number.
    Count(usize),
    /// Unknown, or not applicable: null in fit.json.
    Missing,
}

/// Types of fields that are figures.
pub trait FigureField {
    /// What the values are.
    const KIND: FigureKind;

    /// The value.
    fn value(&self) -> FigureValue<'_>;
}

impl FigureField for f64 {
    const KIND: FigureKind = FigureKind::Number;

    fn value(&self) -> FigureValue<'_> {
        FigureValue::Number(*self)
    }
}

impl FigureField for usize {
    const KIND: FigureKind = FigureKind::Count;

    fn value(&self) -> FigureValue<'_> {
        FigureValue::Count(*self)
    }
}

impl FigureField for String {
    const KIND: FigureKind = FigureKind::Text;

    fn value(&self) -> FigureValue<'_> {
        FigureValue::Text(self)
    }
}

impl<T: FigureField> FigureField for Option<T> {
    const KIND: FigureKind = T::KIND;

    fn value(&self) -> FigureValue<'_> {
        self.as_ref().map_or(FigureValue::Missing, T::value)
    }
}

impl<R> Clone for Figure<R> {
    fn clone(&self) -> Figure<R> {
        *self
    }
}

impl<R> Copy for Figure<R> {}

impl<R> Figure<R> {
    /// A figure with a column of its own name and without a heading.
    pub const fn new(
        name: &'static str,
        doc: &'static str,
        kind: FigureKind,
        get: for<'r> fn(&'r R) -> FigureValue<'r>,
    ) -> Figure<R> {
        let (doc, unit, column) = (doc.trim_ascii(), FigureUnit::Number, Some(name));
        Figure { name, doc, kind, unit, column, heading: None, sentence: None, get }
    }

    /// The figure in another unit.
    pub const fn unit(self, unit: FigureUnit) -> Figure<R> {
        Figure { unit, ..self }
    }

    /// The figure with another name of its column, or without one.
    pub const fn column(self, column: Option<&'static str>) -> Figure<R> {
        Figure { column, ..self }
    }

    /// The figure with a heading.
    pub const fn heading(self, heading: &'static str) -> Figure<R> {
        Figure { heading: Some(heading), ..self }
    }

    /// The figure with a sentence that explains its heading.
    pub const fn sentence(self, sentence: &'static str) -> Figure<R> {
        Figure { sentence: Some(sentence), ..self }
    }

    /// Value of the figure in a record.
    pub fn of<'r>(&self, record: &'r R) -> FigureValue<'r> {
        (self.get)(record)
    }
}

/// Declares a record. A field with `= figure { … }` is also a figure: the constant of the record that has the name of
/// the field, and an entry of its `FIGURES`. Inside the braces stand `unit`, `column`, `heading` and `sentence` where
/// they differ from those of [`Figure::new`].
macro_rules! figures {
    (
        $(#[$($head:tt)*])*
        pub struct $record:ident $(<$life:lifetime>)? {
            $(
                $(#[$($attribute:tt)*])*
                pub $field:ident: $kind:ty $(as $owned:ty)? $(= figure $entry:tt)?,
            )*
        }
    ) => {
        $(#[$($head)*])*
        pub struct $record $(<$life>)? {
            $($(#[$($attribute)*])* pub $field: $kind,)*
        }

        impl $(<$life>)? $record $(<$life>)? {
            /// The figures of the record, in the order of its fields.
            pub const FIGURES: [$crate::Figure<Self>; [$($($crate::figure::only!($entry => ()),)?)*].len()] =
                [$($($crate::figure::only!($entry => Self::$field),)?)*];
        }

        #[allow(non_upper_case_globals, reason = "a figure has the name of its field")]
        impl $(<$life>)? $record $(<$life>)? {
            $($crate::figure::entry! { $field: $kind, [$([$($attribute)*])*] $($entry)? })*
        }
    };
}

/// Declares a record that is a view, as `figures!` does, and two companions: a row that owns its data, in which a field
/// with `as Type` has that type, and the figures alone.
macro_rules! viewed_figures {
    (
        $(#[$($head:tt)*])*
        pub struct $view:ident<$life:lifetime> {
            $(
                $(#[$($attribute:tt)*])*
                pub $field:ident: $kind:ty $(as $owned:ty)? $(= figure $entry:tt)?,
            )*
        }

        $(#[$($row_head:tt)*])*
        pub struct $row:ident;

        $(#[$($alone_head:tt)*])*
        pub(crate) struct $alone:ident;
    ) => {
        $crate::figure::figures! {
            $(#[$($head)*])*
            pub struct $view<$life> {
                $($(#[$($attribute)*])* pub $field: $kind $(= figure $entry)?,)*
            }
        }

        $(#[$($row_head)*])*
        pub struct $row {
            $($(#[$($attribute)*])* pub $field: $crate::figure::last!($kind $(, $owned)?),)*
        }

        $(#[$($alone_head)*])*
        pub(crate) struct $alone {
            $($(pub(crate) $field: $crate::figure::only!($entry => $kind),)?)*
        }

        impl<$life> $view<$life> {
            /// A record of figures and of what else it has, in the order of its fields.
            pub(crate) fn with(figures: $alone, $($($field: $crate::figure::only!($owned => $kind),)?)*) -> Self {
                $view { $($field $(: $crate::figure::only!($entry => figures.$field))?,)* }
            }

            /// Its figures alone.
            pub(crate) fn figures(&self) -> $alone {
                $alone { $($($field: $crate::figure::only!($entry => self.$field),)?)* }
            }
        }

        impl $row {
            /// A row of figures and of what else it has, in the order of its fields.
            pub(crate) fn with(figures: $alone, $($($field: $owned,)?)*) -> Self {
                $row { $($field $(: $crate::figure::only!($entry => figures.$field))?,)* }
            }

            /// Its figures alone.
            pub(crate) fn figures(&self) -> $alone {
                $alone { $($($field: $crate::figure::only!($entry => self.$field),)?)* }
            }
        }
    };
}

/// The constant of one field, if it is a figure.
macro_rules! entry {
    ($field:ident: $kind:ty, [$([$($attribute:tt)*])*]) => {};
    ($field:ident: $kind:ty, [$([$($attribute:tt)*])*] { $($key:ident: $value:expr),* $(,)? }) => {
        $(#[doc = $crate::figure::words!($($attribute)*)])*
        pub const $field: $crate::Figure<Self> = $crate::Figure::new(
            stringify!($field),
            concat!($($crate::figure::words!($($attribute)*)),*),
            <$kind as $crate::figure::FigureField>::KIND,
            |record: &Self| $crate::figure::FigureField::value(&record.$field),
        )$(.$key($value))*;
    };
}

/// What follows the arrow; what stands before it says only that a field is a figure, or that it is none.
macro_rules! only {
    ($mark:tt => $($kept:tt)*) => { $($kept)* };
}

/// The last of one or two types.
macro_rules! last {
    ($kind:ty) => {
        $kind
    };
    ($kind:ty, $owned:ty) => {
        $owned
    };
}

/// The words of an attribute that is a line of documentation; of another attribute, none.
macro_rules! words {
    (doc = $words:literal) => {
        $words
    };
    ($($other:tt)*) => {
        ""
    };
}

pub(crate) use {entry, figures, last, only, viewed_figures, words};

#[cfg(test)]
#[expect(unreachable_pub, reason = "the example is declared as records are")]
mod tests {
    use serde::{Deserialize, Serialize};

    use super::*;
    use crate::{
        ConstraintRecord, DeletionRecord, GroupRecord, InnovationRecord, QuantityRecord, TestRecord, UnitRecord,
        WhitenessRecord,
    };

    figures! {
        /// A record of a test.
        #[derive(Debug, PartialEq, Serialize, Deserialize)]
        pub struct Example {
            /// Name,
            /// in two lines.
            pub name: String = figure {},
            /// A list is no figure.
            #[serde(default)]
            pub list: Vec<usize>,
            /// p-value.
            #[serde(default, skip_serializing_if = "Option::is_none")]
            pub p_value: Option<f64> = figure { heading: "p", unit: FigureUnit::Probability, column: Some("of_example") },
        }
    }

    #[test]
    fn a_field_is_a_figure_by_one_entry() {
        let [name, p_value] = Example::FIGURES;
        assert_eq!((name.name, name.kind, name.doc), ("name", FigureKind::Text, "Name, in two lines."));
        assert_eq!((name.unit, name.column, name.heading), (FigureUnit::Number, Some("name"), None));
        assert_eq!((p_value.name, p_value.kind, p_value.doc), ("p_value", FigureKind::Number, "p-value."));
        assert_eq!(
            (p_value.unit, p_value.column, p_value.heading),
            (FigureUnit::Probability, Some("of_example"), Some("p"))
        );
        let example = Example { name: "a".to_owned(), list: vec![], p_value: Some(0.5) };
        assert_eq!(
            (name.of(&example), Example::p_value.of(&example)),
            (FigureValue::Text("a"), FigureValue::Number(0.5))
        );
        let read: Example = serde_json::from_str(r#"{"name": "a"}"#).unwrap(); // its fields keep their attributes
        assert_eq!(p_value.of(&read), FigureValue::Missing);
        assert_eq!(serde_json::to_string(&read).unwrap(), r#"{"name":"a","list":[]}"#);
    }

    fn assert_unique<R>(figures: &[Figure<R>]) {
        let distinct = |names: Vec<&str>| names.iter().collect::<std::collections::BTreeSet<_>>().len() == names.len();
        let names: Vec<&str> = figures.iter().map(|figure| figure.name).collect();
        let columns: Vec<&str> = figures.iter().filter_map(|figure| figure.column).collect();
        assert!(distinct(names.clone()) && distinct(columns.clone()), "{names:?}, {columns:?}");
        for figure in figures {
            assert!(!figure.doc.is_empty(), "{} has no words", figure.name);
            assert!(
                figure.sentence.is_none() || figure.heading.is_some(),
                "{}: a sentence explains nothing",
                figure.name
            );
        }
    }

    #[test]
    fn figures_of_each_list_have_different_names() {
        assert_unique(&TestRecord::FIGURES);
        assert_unique(&InnovationRecord::FIGURES);
        assert_unique(&WhitenessRecord::FIGURES);
        assert_unique(&DeletionRecord::FIGURES);
        assert_unique(&ConstraintRecord::FIGURES);
        assert_unique(&QuantityRecord::FIGURES);
        assert_unique(&GroupRecord::FIGURES);
        assert_unique(&UnitRecord::FIGURES);
    }
}
