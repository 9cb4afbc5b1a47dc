//! Which files of the core are changed, and how many of a hundred mutants each has.

/// Files that say one thing together.
pub(super) struct SourceGroup {
    pub(super) name: &'static str,
    /// Below the folder of crates, with their parts of a hundred mutants.
    pub(super) files: &'static [(&'static str, usize)],
}

/// Where their survivors mean that a wrong answer may be called right.
pub(super) const CERTIFICATE: &str = "certificate";

/// From the filter's steps to the laws of test statistics.
pub(super) const GROUPS: [SourceGroup; 5] = [
    SourceGroup {
        name: "kernels",
        files: &[
            ("kalfit-filter/src/reduce/kernel.rs", 6),
            ("kalfit-filter/src/reduce/batches.rs", 1),
            ("kalfit-filter/src/reduce/batches/layout.rs", 1),
            ("kalfit-filter/src/reduce/batches/values.rs", 2),
            ("kalfit-filter/src/reduce/outcome.rs", 1),
            ("kalfit-filter/src/reduce/design_pass.rs", 2),
            ("kalfit-filter/src/reduce/lanes/pass.rs", 1),
            ("kalfit-filter/src/reduce/lanes/least_squares.rs", 1),
            ("kalfit-filter/src/reduce/root.rs", 2),
            ("kalfit-filter/src/reduce/semidefinite.rs", 2),
            ("kalfit-filter/src/score/backward/adjoint.rs", 4),
            ("kalfit-filter/src/score/backward/filtered.rs", 3),
            ("kalfit-filter/src/score/backward/smooth.rs", 1),
            ("kalfit-estimate/src/chained/kernel.rs", 3),
        ],
    },
    SourceGroup {
        name: CERTIFICATE,
        files: &[
            ("kalfit-estimate/src/certificate.rs", 11),
            ("kalfit-estimate/src/chart.rs", 2),
            ("kalfit-estimate/src/climb.rs", 1),
            ("kalfit-estimate/src/covariance.rs", 2),
            ("kalfit-estimate/src/curvature.rs", 3),
            ("kalfit-estimate/src/likelihood.rs", 2),
            ("kalfit-estimate/src/local.rs", 3),
            ("kalfit-estimate/src/newton.rs", 2),
            ("kalfit-estimate/src/relaxed.rs", 3),
            ("kalfit-estimate/src/rounding.rs", 1),
        ],
    },
    SourceGroup {
        name: "laws",
        files: &[
            ("kalfit-infer/src/constraint.rs", 2),
            ("kalfit-infer/src/information.rs", 2),
            ("kalfit-infer/src/interval.rs", 2),
            ("kalfit-infer/src/law.rs", 2),
            ("kalfit-infer/src/ratio/cone.rs", 4),
            ("kalfit-infer/src/ratio/law.rs", 1),
            ("kalfit-infer/src/ratio/nested.rs", 1),
            ("kalfit-infer/src/ratio/restricted.rs", 1),
        ],
    },
    SourceGroup {
        name: "algebra",
        files: &[
            ("kalfit-algebra/src/algebra.rs", 2),
            ("kalfit-algebra/src/elements.rs", 1),
            ("kalfit-algebra/src/exponential.rs", 2),
            ("kalfit-algebra/src/factors.rs", 1),
            ("kalfit-algebra/src/fold.rs", 2),
            ("kalfit-algebra/src/parts.rs", 1),
            ("kalfit-algebra/src/regular.rs", 2),
            ("kalfit-algebra/src/rows.rs", 1),
            ("kalfit-algebra/src/symmetric.rs", 2),
            ("kalfit-algebra/src/whiten.rs", 1),
        ],
    },
    SourceGroup {
        name: "dynamics",
        files: &[
            ("kalfit-search/src/correlation_bounds.rs", 2),
            ("kalfit-search/src/joint.rs", 4),
            ("kalfit-infer/src/dynamic/held_profile.rs", 1),
            ("kalfit-search/src/search.rs", 1),
            ("kalfit-search/src/unbounded.rs", 1),
            ("kalfit-search/src/zero.rs", 1),
        ],
    },
];

/// Every file, its group, and how many of so many mutants it has.
pub(super) fn shares(mutants: usize) -> impl Iterator<Item = (&'static str, &'static str, usize)> {
    let mut before = 0;
    let files = GROUPS.iter().flat_map(|group| group.files.iter().map(|&(file, part)| (group.name, file, part)));
    files.map(move |(group, file, part)| {
        let upto = before + part;
        let share = upto * mutants / 100 - before * mutants / 100;
        before = upto;
        (group, file, share)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_add_up() {
        for mutants in [1, 37, 100, 250] {
            assert_eq!(shares(mutants).map(|(_, _, share)| share).sum::<usize>(), mutants);
        }
    }
}
