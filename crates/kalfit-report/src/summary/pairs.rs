//! Two states of which the data determine one combination: their sum, say.

use kalfit::record::UnidentifiedRecord;

use super::combination::{covariance_of, weighted};
use crate::number::plain;
use crate::words::clean;

/// A weight is one within this.
const EXACT: f64 = 1e-6;

/// Takes out of `found` what belongs to such pairs, and says it of each pair in a sentence with its cure.
pub(super) fn joined(found: &mut Vec<UnidentifiedRecord>, states: &[String], estimated: bool) -> Vec<String> {
    let mut sentences = Vec::new();
    let mut at = 0;
    while let Some(one) = found.get(at) {
        let Some((sentence, pair)) = sentence(one, found, states, estimated) else {
            at += 1;
            continue;
        };
        sentences.push(sentence);
        found.retain(|other| !of_pair(other, &pair));
    }
    sentences
}

/// What the pair of a direction of the mean is, in words, and its names.
fn sentence(
    mean: &UnidentifiedRecord,
    found: &[UnidentifiedRecord],
    states: &[String],
    estimated: bool,
) -> Option<(String, [String; 2])> {
    if mean.what != "mean" || !inseparable(mean) {
        return None;
    }
    let names = if mean.elements.is_empty() { states } else { &mean.elements };
    let mut pair = weighted(&mean.direction, names);
    pair.sort_by_key(|(_, name)| states.iter().position(|state| state == *name));
    let [(one, first), (other, second)] = pair[..] else { return None };
    if !states.contains(first) || !states.contains(second) {
        return None;
    }
    let names = [first.clone(), second.clone()];
    let variances = found.iter().any(|other| other.what == "covariance" && of_pair(other, &names));
    // orthogonal to what is not determined
    let ratio = -one / other;
    let (first, second) = (clean(first), clean(second));
    let what = match ratio {
        r if (r - 1.0).abs() < EXACT => format!("the sum {first} + {second}"),
        r if (r + 1.0).abs() < EXACT => format!("the difference {first} - {second}"),
        r => format!("{first} {} {} {second}", if r < 0.0 { "-" } else { "+" }, plain(r.abs(), 3)),
    };
    let which = if variances { "means and variances" } else { "means" };
    let open = if estimated { " Other values of what is not fit as well." } else { "" };
    let text = format!(
        "Not identified: only {what} is determined, not each alone ({which}).{open} Fix one, e.g. `{second}.initial = {{ mean = 0, \
         sigma = 0 }}`."
    );
    Some((text, names))
}

/// The data know combinations of states, but not each alone, by the words that the fit gives; before version 0.2 these were "apart".
fn inseparable(found: &UnidentifiedRecord) -> bool {
    ["test separates", "separate the levels", "separate their", " apart"]
        .iter()
        .any(|words| found.reason.contains(words))
}

/// The direction is about these two states only.
fn of_pair(found: &UnidentifiedRecord, pair: &[String; 2]) -> bool {
    let of = |name: &String| match covariance_of(name) {
        Some((a, b)) if found.what == "covariance" => [a, b].iter().all(|one| pair.iter().any(|name| name == one)),
        _ => pair.contains(name),
    };
    let terms = weighted(&found.direction, &found.elements);
    !terms.is_empty() && inseparable(found) && terms.into_iter().all(|(_, name)| of(name))
}
