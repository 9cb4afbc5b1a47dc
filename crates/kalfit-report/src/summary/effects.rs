//! The effects of the levels of a crossed factor: which station, which day.

use kalfit::record::{EffectRecord, FactorRecord};

use super::levels::is_held_at_zero;
use crate::number::FigurePrecision;
use crate::page::PageLayout;
use crate::table::{ColumnSide, TextColumn};
use crate::words::{clean, count};

/// Levels of the table.
const MOST_ROWS: usize = 12;

/// A row for each level with its effect on each state that varies with the factor, the largest effects where not all
/// have room. `units`: those of the states.
pub(crate) fn section(factor: &FactorRecord, units: &[Option<String>], page: &PageLayout<'_>) -> String {
    let level = &factor.level;
    let states: Vec<usize> = (0..level.states.len()).filter(|&i| !is_held_at_zero(level, i)).collect();
    let varies = level.std_dev.estimate.iter().any(|deviation| *deviation > 0.0);
    if factor.effects.is_empty() || states.is_empty() || !varies {
        return String::new();
    }
    let size = |effect: &EffectRecord| {
        let relative = |&i: &usize| match level.std_dev.estimate[i] {
            deviation if deviation > 0.0 => effect.mean[i].abs() / deviation,
            _ => 0.0,
        };
        states.iter().map(relative).fold(0.0, f64::max)
    };
    let mut shown: Vec<&EffectRecord> = factor.effects.iter().collect();
    let most = page.rows(MOST_ROWS);
    if shown.len() > most {
        shown.sort_by(|a, b| size(b).total_cmp(&size(a)).then_with(|| a.id.cmp(&b.id)));
        shown.truncate(most);
    } else {
        shown.sort_by(|a, b| a.id.cmp(&b.id));
    }
    let name = clean(&level.name);
    let mut columns = vec![
        TextColumn::new(&name, ColumnSide::Left, shown.iter().map(|one| clean(&one.id)).collect()),
        TextColumn::new("tests", ColumnSide::Right, shown.iter().map(|one| one.tests.to_string()).collect()),
    ];
    for i in states {
        let precision = |one: &EffectRecord| FigurePrecision::of(one.mean[i], Some(one.std_dev[i]));
        let figure = shown.iter().map(|one| precision(one).show(one.mean[i])).collect();
        let beside = shown.iter().map(|one| format!("± {}", precision(one).show(one.std_dev[i]))).collect();
        columns.push(TextColumn::new(&clean(&level.states[i]), ColumnSide::Right, figure));
        let unit = units.get(i).cloned().flatten().map_or(String::new(), |unit| clean(&unit));
        columns.push(TextColumn::new(&unit, ColumnSide::Left, beside));
    }
    let all = factor.effects.len();
    let left_out = match all > shown.len() {
        true => vec![format!("Of {}, the {} that differ most are shown.", count(all, "level"), shown.len())],
        false => Vec::new(),
    };
    let heading = format!("Effect of each {name} (± posterior standard deviation)");
    page.section(&heading, &(page.table(&columns) + &page.items(&left_out)))
}
