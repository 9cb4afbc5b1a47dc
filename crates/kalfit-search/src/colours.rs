//! Sets of values that can move in one run of the filters.

/// Sets of values without a common test, among `tests` tests. `values`: (value, indices of the tests that depend on the
/// value), with `None` for a value that cannot share a set.
pub(super) fn colours<'t>(values: impl Iterator<Item = (usize, Option<&'t [usize]>)>, tests: usize) -> Vec<Vec<usize>> {
    let mut colours: Vec<(Vec<usize>, Vec<bool>)> = Vec::new();
    for (s, own) in values {
        let free = |taken: &[bool]| own.is_some_and(|own| own.iter().all(|&j| !taken[j]));
        let place = colours.iter().position(|(_, taken)| free(taken));
        let place = place.unwrap_or_else(|| {
            colours.push((Vec::new(), vec![false; tests]));
            colours.len() - 1
        });
        let (colour, taken) = &mut colours[place];
        colour.push(s);
        match own {
            Some(own) => own.iter().for_each(|&j| taken[j] = true),
            None => taken.fill(true),
        }
    }
    colours.into_iter().map(|(colour, _)| colour).collect()
}
