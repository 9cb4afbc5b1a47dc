//! Which files of the core are changed, and how many of a hundred mutants each has.

/// Files that say one thing together.
pub(super) struct SourceGroup {
    pub(super) name: &'static str,
    /// Below the sources of the core, with their parts of a hundred mutants.
    pub(super) files: &'static [(&'static str, usize)],
}

/// Where their survivors mean that a wrong answer may be called right.
pub(super) const CERTIFICATE: &str = "certificate";

/// From the filter's steps to the laws of test statistics.
pub(super) const GROUPS: [SourceGroup; 5] = [
    SourceGroup {
        name: "kernels",
        files: &[
            ("reduce/kernel.rs", 6),
            ("reduce/batches.rs", 1),
            ("reduce/batches/layout.rs", 1),
            ("reduce/batches/values.rs", 2),
            ("reduce/outcome.rs", 1),
            ("reduce/design_pass.rs", 2),
            ("reduce/lanes/pass.rs", 1),
            ("reduce/lanes/least_squares.rs", 1),
            ("reduce/root.rs", 2),
            ("reduce/semidefinite.rs", 2),
            ("score/backward/adjoint.rs", 4),
            ("score/backward/filtered.rs", 3),
            ("score/backward/smooth.rs", 1),
            ("estimate/chained/kernel.rs", 3),
        ],
    },
    SourceGroup {
        name: CERTIFICATE,
        files: &[
            ("estimate/certificate.rs", 11),
            ("estimate/chart.rs", 2),
            ("estimate/climb.rs", 1),
            ("estimate/covariance.rs", 2),
            ("estimate/curvature.rs", 3),
            ("estimate/likelihood.rs", 2),
            ("estimate/local.rs", 3),
            ("estimate/newton.rs", 2),
            ("estimate/relaxed.rs", 3),
            ("estimate/rounding.rs", 1),
        ],
    },
    SourceGroup {
        name: "laws",
        files: &[
            ("infer/constraint.rs", 2),
            ("infer/information.rs", 2),
            ("infer/interval.rs", 2),
            ("infer/law.rs", 2),
            ("infer/ratio/cone.rs", 4),
            ("infer/ratio/law.rs", 1),
            ("infer/ratio/nested.rs", 1),
            ("infer/ratio/restricted.rs", 1),
        ],
    },
    SourceGroup {
        name: "algebra",
        files: &[
            ("linalg/algebra.rs", 2),
            ("linalg/elements.rs", 1),
            ("linalg/exponential.rs", 2),
            ("linalg/factors.rs", 1),
            ("linalg/fold.rs", 2),
            ("linalg/parts.rs", 1),
            ("linalg/regular.rs", 2),
            ("linalg/rows.rs", 1),
            ("linalg/symmetric.rs", 2),
            ("linalg/whiten.rs", 1),
        ],
    },
    SourceGroup {
        name: "dynamics",
        files: &[
            ("dynamic/edges.rs", 2),
            ("dynamic/joint.rs", 4),
            ("dynamic/outer.rs", 1),
            ("dynamic/search.rs", 1),
            ("dynamic/unbounded.rs", 1),
            ("dynamic/zero.rs", 1),
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
