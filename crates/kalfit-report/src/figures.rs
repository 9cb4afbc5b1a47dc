//! Figures of records as people read them: heading, digits and sentence come from the figure's own entry in kalfit-record.

use kalfit::record::{Figure, FigureKind, FigureUnit, FigureValue};

use crate::number::{DIGITS, hundredths, plain, probability};
use crate::table::{ColumnSide, TextColumn};

/// Digits of a statistic.
const STATISTIC_DIGITS: usize = 3;
/// Digits of a number of standard deviations.
const DEVIATION_DIGITS: usize = 2;

/// The figure of one record, in the digits that its unit deserves; a dash where it is unknown or there is no record.
pub(crate) fn shown<R>(figure: Figure<R>, record: Option<&R>) -> String {
    match record.map_or(FigureValue::Missing, |record| figure.of(record)) {
        FigureValue::Missing => "-".to_owned(),
        FigureValue::Text(text) => text.to_owned(),
        FigureValue::Count(n) => n.to_string(),
        FigureValue::Number(x) => match figure.unit {
            FigureUnit::Number => plain(x, STATISTIC_DIGITS),
            FigureUnit::LogLikelihood => hundredths(x),
            FigureUnit::Probability => probability(x),
            FigureUnit::Deviations => plain(x, DEVIATION_DIGITS),
            FigureUnit::Element => plain(x, DIGITS),
        },
    }
}

/// A column of the figure under its heading.
pub(crate) fn column<'r, R: 'r>(
    figure: Figure<R>,
    records: impl IntoIterator<Item = impl Into<Option<&'r R>>>,
) -> TextColumn {
    let side = if figure.kind == FigureKind::Text { ColumnSide::Left } else { ColumnSide::Right };
    let cells = records.into_iter().map(|record| shown(figure, record.into())).collect();
    TextColumn::new(figure.heading.unwrap_or(figure.name), side, cells)
}

/// A column for each figure with a heading.
pub(crate) fn columns<'r, R: 'r>(
    figures: &[Figure<R>],
    records: impl IntoIterator<Item = impl Into<Option<&'r R>>> + Clone,
) -> Vec<TextColumn> {
    let headed = figures.iter().filter(|figure| figure.heading.is_some());
    headed.map(|figure| column(*figure, records.clone())).collect()
}

/// The sentences that explain the headings of figures.
pub(crate) fn sentences<R>(figures: &[Figure<R>]) -> String {
    figures.iter().filter_map(|figure| figure.sentence).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_figure_added_to_a_list_has_a_column_and_a_sentence() {
        let get: for<'r> fn(&'r f64) -> FigureValue<'r> = |x| FigureValue::Number(*x);
        let plain = Figure::new("plain", "A number.", FigureKind::Number, get);
        let added = plain.heading("p-value").sentence("It is probable.").unit(FigureUnit::Probability);
        let columns = columns(&[plain, added], &[0.25, 1e-12]);
        assert_eq!(crate::table::table(&columns, 80), "  p-value\n     0.25\n  < 1e-10\n");
        assert_eq!(sentences(&[plain, added]), "It is probable.");
        assert_eq!(shown(added, None), "-");
    }
}
