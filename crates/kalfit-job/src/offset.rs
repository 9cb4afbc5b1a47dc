//! Columns that lie so far from zero that what they multiply can hardly be told from a constant: years, epochs, pressures.

use std::collections::BTreeSet;

use kalfit::model::{Expression, Operator, Phase, Value};
use kalfit::record::plain;
use kalfit::{Evidence, PhasedModel, PhasedTest};

/// So many standard deviations from zero is far.
const FAR: f64 = 1e3;

/// Columns that something unknown is multiplied by as they are, and their cells so far.
pub(crate) struct Multipliers<'m> {
    model: &'m PhasedModel,
    columns: Vec<(usize, Moments)>,
}

impl<'m> Multipliers<'m> {
    /// Without cells.
    pub(crate) fn of(model: &'m PhasedModel) -> Multipliers<'m> {
        let columns: BTreeSet<usize> = model.phases.iter().flat_map(multipliers).collect();
        Multipliers { model, columns: columns.into_iter().map(|column| (column, Moments::default())).collect() }
    }

    /// With the cells of these tests.
    pub(crate) fn among(model: &'m PhasedModel, tests: &[PhasedTest]) -> Multipliers<'m> {
        let mut found = Multipliers::of(model);
        tests.iter().for_each(|test| found.add(test));
        found
    }

    /// Adds the cells of a test.
    pub(crate) fn add(&mut self, test: &PhasedTest) {
        let rows = test.phases.iter().filter_map(|phase| match phase {
            Evidence::Rows(rows) => Some(rows),
            Evidence::Estimates(_) | Evidence::Reduced(_) => None,
        });
        for row in rows.flat_map(|rows| (0..rows.rows()).map(move |row| rows.numbers(row))) {
            for (column, moments) in &mut self.columns {
                moments.add(row[*column]);
            }
        }
    }

    /// A sentence for each that lies far from zero.
    pub(crate) fn notes(&self) -> Vec<String> {
        let name = |column: usize| &self.model.shared().columns[column].name;
        self.columns
            .iter()
            .filter(|(_, moments)| moments.is_far())
            .map(|(c, moments)| note(name(*c), moments))
            .collect()
    }
}

fn note(name: &str, moments: &Moments) -> String {
    let (mean, deviation) = (moments.mean(), moments.deviation());
    let unit = 10_f64.powf(deviation.log10().ceil());
    let sign = if mean > 0.0 { "-" } else { "+" };
    format!(
        "column `{name}` lies {} standard deviations from zero, so what it multiplies can hardly be told from what is constant: with \
         `({name} {sign} {})` in its place digits are kept, and the constant is that at this value",
        plain((mean / deviation).abs(), 2),
        plain(((mean / unit).round() * unit).abs(), 15),
    )
}

/// Sums of cells and of their squares, less the first of them.
#[derive(Default)]
struct Moments {
    first: Option<f64>,
    count: f64,
    sum: f64,
    squares: f64,
}

impl Moments {
    fn add(&mut self, cell: f64) {
        if cell.is_finite() {
            let off = cell - *self.first.get_or_insert(cell);
            self.count += 1.0;
            self.sum += off;
            self.squares += off * off;
        }
    }

    fn mean(&self) -> f64 {
        self.first.unwrap_or(0.0) + self.sum / self.count
    }

    fn deviation(&self) -> f64 {
        (self.squares / self.count - (self.sum / self.count).powi(2)).max(0.0).sqrt()
    }

    /// It varies, but far from zero.
    fn is_far(&self) -> bool {
        let deviation = self.deviation();
        deviation > 0.0 && self.mean().abs() > FAR * deviation
    }
}

/// Columns that states, or parameters that are sought, are multiplied by in what is measured beside a constant of which the same is true, or
/// that means are regressed on which are not free: other such columns are centred.
fn multipliers(phase: &Phase) -> BTreeSet<usize> {
    let model = &phase.model;
    let mut is_sought = |part: &Expression| match part {
        Expression::Parameter(index) => matches!(model.parameters[*index].value, Value::Free { .. }),
        _ => false,
    };
    let mut found: BTreeSet<usize> = {
        let kept = model.mean.regression.iter().filter(|regression| !model.mean.is_free_alone(regression.element));
        kept.map(|regression| regression.column).collect()
    };
    for measurement in &model.measurements {
        let of_states = measurement.equation.terms.iter().map(|(_, coefficient)| coefficient);
        let others = summands(&measurement.equation.constant).into_iter().filter(|term| term.any(&mut is_sought));
        let unknown: Vec<&Expression> = of_states.chain(others).collect();
        if unknown.iter().any(|term| !has_column(term)) {
            unknown.into_iter().for_each(|term| add_bare(term, &mut found));
        }
    }
    found
}

fn has_column(expression: &Expression) -> bool {
    expression.any(&mut |part| matches!(part, Expression::Column(_)))
}

fn summands(sum: &Expression) -> Vec<&Expression> {
    match sum {
        Expression::Binary(Operator::Add | Operator::Subtract, a, b) => [summands(a), summands(b)].concat(),
        Expression::Negate(a) => summands(a),
        term => vec![term],
    }
}

/// Columns that are factors as they are: `x`, `2 * x`, but not `x - 2020`, nor `x * z`, which would leave another term.
fn add_bare(factor: &Expression, found: &mut BTreeSet<usize>) {
    match factor {
        Expression::Column(column) => {
            found.insert(*column);
        }
        Expression::Negate(a) => add_bare(a, found),
        Expression::Binary(Operator::Multiply, a, b) if has_column(a) != has_column(b) => {
            [a, b].into_iter().for_each(|part| add_bare(part, found));
        }
        Expression::Binary(Operator::Divide, a, _) => add_bare(a, found),
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn moments(cells: &[f64]) -> Moments {
        let mut found = Moments::default();
        cells.iter().for_each(|cell| found.add(*cell));
        found
    }

    #[test]
    fn a_column_is_far_where_it_varies_by_a_thousandth_of_its_size() {
        for (cells, far) in [
            (vec![2020.0, 2021.0, f64::NAN, 2022.0], true),
            (vec![1980.0, 2000.0, 2020.0], false),
            (vec![-1.7e9, -1.7e9 - 5.0], true),
            (vec![5.0, 5.0, 5.0], false),
            (vec![f64::NAN], false),
            (Vec::new(), false),
        ] {
            assert_eq!(moments(&cells).is_far(), far, "{cells:?}");
        }
        let found = moments(&[1.7e9 + 1.0, 1.7e9 + 3.0, 1.7e9 - 1.0]);
        assert!((found.mean() - 1.7e9 - 1.0).abs() < 1e-6, "{}", found.mean());
        assert!((found.deviation() - f64::sqrt(8.0 / 3.0)).abs() < 1e-12, "{}", found.deviation());
        assert!(note("epoch", &found).contains("`(epoch - 1.7e9)`"), "{}", note("epoch", &found));
        let below = note("x", &moments(&[-2020.0, -2021.0]));
        assert!(below.contains("`(x + 2021)`") && below.contains("lies 4041 standard deviations"), "{below}");
    }

    #[test]
    fn columns_count_where_they_are_factors_as_they_are() {
        let (x, five) = (|| Box::new(Expression::Column(3)), || Box::new(Expression::Number(5.0)));
        let binary = Expression::Binary;
        for (factor, counts) in [
            (*x(), true),
            (Expression::Negate(x()), true),
            (binary(Operator::Multiply, five(), x()), true),
            (binary(Operator::Divide, x(), five()), true),
            (binary(Operator::Divide, five(), x()), false),
            (binary(Operator::Subtract, x(), five()), false),
            (binary(Operator::Multiply, x(), x()), false),
        ] {
            let mut found = BTreeSet::new();
            add_bare(&factor, &mut found);
            assert_eq!(found.contains(&3), counts, "{factor:?}");
        }
    }
}
