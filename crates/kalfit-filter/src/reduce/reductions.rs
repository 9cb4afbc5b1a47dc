//! The reductions of an ensemble, column by column.

use std::ops::Range;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};

use rayon::iter::{IndexedParallelIterator, IntoParallelIterator, ParallelIterator};

use kalfit_algebra::row_lists::RowLists;
use kalfit_model::Chain;
use kalfit_model::ExactRows;
use kalfit_model::Path;
use kalfit_model::remote::Remote;
use kalfit_model::{Reduction, ReductionRef};
use kalfit_model::{SparseColumn, Texts};

/// The [`Reduction`]s of tests, in the order of the tests, stored by column: the reductions of a million short tests
/// take a few pieces of memory, which are read from front to back.
///
/// ```
/// # mod kalfit { pub use {kalfit_filter::reduce::{self, Reductions}, kalfit_model::Reduction}; }
/// use kalfit::{Reduction, Reductions};
/// # use kalfit::reduce::Path;
/// # let test = |id: &str| Reduction {
/// #     test: id.into(), constant: 0.0, residual: None, data: vec![0.5], factor: vec![2.0], covariates: vec![], steps: 1,
/// #     observations: 1, path: Path::Information, design: 0, chain: None, exact: None,
/// # };
/// let reductions: Reductions = ["a", "b"].map(test).into_iter().collect();
/// assert_eq!((reductions.len(), reductions.get(1).test, reductions.get(1).data), (2, "b", &[0.5][..]));
/// ```
#[derive(Debug, Clone, Default)]
pub struct Reductions {
    /// Number that identifies the reductions, shared only with clones: assigned on the first request, reset by any
    /// change.
    stamp: OnceLock<u64>,
    ids: Texts,
    constants: Vec<f64>,
    residuals: Vec<Option<f64>>,
    data: RowLists,
    factors: RowLists,
    covariates: RowLists,
    steps: Vec<usize>,
    observations: Vec<usize>,
    paths: Vec<Path>,
    designs: Vec<u128>,
    chains: SparseColumn<Box<Chain>>,
    exact: SparseColumn<Box<ExactRows>>,
    /// Place of reductions that are stored elsewhere; else `None`.
    remote: Option<Remote>,
}

/// The parts of the reduction of one test that may be changed.
pub struct ReductionMut<'a> {
    pub constant: &'a mut f64,
    pub residual: &'a mut Option<f64>,
    pub data: &'a mut [f64],
    pub factor: &'a mut [f64],
    pub chain: Option<&'a mut Chain>,
    pub exact: Option<&'a mut ExactRows>,
}

impl Reductions {
    /// An empty list of reductions.
    pub fn new() -> Reductions {
        Reductions::default()
    }

    /// Reductions that are stored elsewhere, of which only sums can be requested.
    pub fn elsewhere(remote: Remote) -> Reductions {
        Reductions { remote: Some(remote), ..Reductions::default() }
    }

    /// Place of reductions that are stored elsewhere; else `None`.
    pub fn remote(&self) -> Option<&Remote> {
        self.remote.as_ref()
    }

    /// Number of tests.
    pub fn len(&self) -> usize {
        self.constants.len()
    }

    /// Whether there are no tests.
    pub fn is_empty(&self) -> bool {
        self.constants.is_empty()
    }

    /// The reduction of test `number`.
    ///
    /// # Panics
    /// If `number` is not below the number of tests.
    pub fn get(&self, number: usize) -> ReductionRef<'_> {
        ReductionRef {
            test: self.id(number),
            constant: self.constants[number],
            residual: self.residuals[number],
            data: self.data.row(number),
            factor: self.factor(number),
            covariates: self.covariates(number),
            steps: self.steps[number],
            observations: self.observations[number],
            path: self.paths[number],
            design: self.designs[number],
            chain: self.chain(number),
            exact: self.exact(number),
        }
    }

    /// The reductions of all tests, in order.
    pub fn iter(&self) -> Rows<'_> {
        Rows { source: self, numbers: 0..self.len() }
    }

    /// The reductions of all tests, as a parallel iterator.
    pub fn par_iter(&self) -> impl IndexedParallelIterator<Item = ReductionRef<'_>> {
        (0..self.len()).into_par_iter().map(|number| self.get(number))
    }

    /// The reductions of the tests with indices `numbers`, in the order of `numbers`.
    #[must_use]
    pub fn select(&self, numbers: &[usize]) -> Reductions {
        numbers.iter().map(|&number| self.get(number)).collect()
    }

    /// The reductions sorted by `numbers`, the index of the test of each reduction.
    pub(crate) fn in_order(self, numbers: &[usize]) -> Reductions {
        if numbers.is_sorted() {
            return self;
        }
        let mut places: Vec<usize> = (0..numbers.len()).collect();
        places.sort_by_key(|&place| numbers[place]); // mostly a few ascending runs
        self.select(&places)
    }

    /// Appends the reduction of a test.
    pub fn push(&mut self, reduction: Reduction) {
        self.put(reduction.view());
        self.put_chain_and_exact(reduction.chain, reduction.exact);
    }

    /// Appends all reductions of `others`.
    pub fn append(&mut self, mut others: Reductions) {
        if self.is_empty() {
            *self = others;
            return;
        }
        self.stamp.take();
        let (own, added) = (self.len(), others.len());
        self.chains.append(own, others.chains);
        self.exact.append(own, others.exact);
        self.ids.append(&others.ids);
        self.data.append(own, &others.data, added);
        self.factors.append(own, &others.factors, added);
        self.covariates.append(own, &others.covariates, added);
        self.constants.append(&mut others.constants);
        self.residuals.append(&mut others.residuals);
        self.steps.append(&mut others.steps);
        self.observations.append(&mut others.observations);
        self.paths.append(&mut others.paths);
        self.designs.append(&mut others.designs);
    }

    /// All reductions of `parts`, one part after the other.
    pub(crate) fn joined(parts: Vec<Reductions>) -> Reductions {
        let (mut all, tests) = (Reductions::new(), parts.iter().map(Reductions::len).sum());
        all.take(parts, tests);
        all
    }

    /// Appends all reductions of `others`, one list after the other. `tests`: final number of tests, for which memory
    /// is reserved.
    pub(crate) fn take(&mut self, others: Vec<Reductions>, tests: usize) {
        let mut others = others.into_iter();
        if self.is_empty() {
            *self = others.next().unwrap_or_default();
        }
        let added = tests - self.len();
        self.ids.reserve(others.as_slice().iter().map(|part| &part.ids));
        [&mut self.steps, &mut self.observations].into_iter().for_each(|x| x.reserve_exact(added));
        [&mut self.data, &mut self.factors, &mut self.covariates].into_iter().for_each(|x| x.reserve(added));
        self.constants.reserve_exact(added);
        self.residuals.reserve_exact(added);
        self.paths.reserve_exact(added);
        self.designs.reserve_exact(added);
        others.for_each(|part| self.append(part));
    }

    /// A number that identifies the reductions: clones have the same number, all other reductions have different
    /// numbers.
    pub fn stamp(&self) -> u64 {
        static NEXT: AtomicU64 = AtomicU64::new(0);
        *self.stamp.get_or_init(|| NEXT.fetch_add(1, Ordering::Relaxed))
    }

    /// c' = c + ½ d'd of a test.
    pub fn constant(&self, number: usize) -> f64 {
        self.constants[number]
    }

    /// The arithmetic that made the reduction of a test.
    pub fn path(&self, number: usize) -> Path {
        self.paths[number]
    }

    /// The arithmetic that made the reduction of each test.
    pub fn paths(&self) -> &[Path] {
        &self.paths
    }

    /// Number of steps of each test.
    pub fn steps(&self) -> &[usize] {
        &self.steps
    }

    /// Number of scalar measurements used, for each test.
    pub fn observations(&self) -> &[usize] {
        &self.observations
    }

    /// Digest of the design of each test.
    pub fn designs(&self) -> &[u128] {
        &self.designs
    }

    /// (residual sum of squares, number of scalar measurements) of a test; `None` where the sum is unknown.
    pub fn residual(&self, number: usize) -> (Option<f64>, usize) {
        (self.residuals[number], self.observations[number])
    }

    /// d of a test, p numbers.
    pub fn data(&self, number: usize) -> &[f64] {
        self.data.row(number)
    }

    /// Id of a test.
    pub fn id(&self, number: usize) -> &str {
        self.ids.get(number)
    }

    /// R of a test, p × p, packed by columns.
    pub fn factor(&self, number: usize) -> &[f64] {
        self.factors.row(number)
    }

    /// Covariates of a test.
    pub fn covariates(&self, number: usize) -> &[f64] {
        self.covariates.row(number)
    }

    /// The reduction of a test phase by phase, for a model with several phases.
    pub fn chain(&self, number: usize) -> Option<&Chain> {
        self.chains.get(number).map(Box::as_ref)
    }

    /// Rows Cξ = g that a test measured without any noise.
    pub fn exact(&self, number: usize) -> Option<&ExactRows> {
        self.exact.get(number).map(Box::as_ref)
    }

    /// Whether any test has exact rows Cξ = g.
    pub fn has_exact(&self) -> bool {
        self.exact.has_any()
    }

    /// The reduction of test `number`, to be changed.
    pub fn get_mut(&mut self, number: usize) -> ReductionMut<'_> {
        self.stamp.take();
        ReductionMut {
            constant: &mut self.constants[number],
            residual: &mut self.residuals[number],
            data: self.data.row_mut(number),
            factor: self.factors.row_mut(number),
            chain: self.chains.get_mut(number).map(Box::as_mut),
            exact: self.exact.get_mut(number).map(Box::as_mut),
        }
    }

    /// The reductions with only the covariates at `places`.
    #[must_use]
    pub fn with_covariates(mut self, places: &[usize]) -> Reductions {
        self.stamp.take();
        let mut covariates = RowLists::default();
        for number in 0..self.len() {
            covariates.push(number, places.iter().map(|&at| self.covariates(number)[at]));
        }
        self.covariates = covariates;
        self
    }

    /// Appends a reduction without chain and exact rows.
    pub(super) fn put(&mut self, one: ReductionRef<'_>) {
        self.stamp.take();
        let number = self.len();
        self.ids.push(one.test);
        self.constants.push(one.constant);
        self.residuals.push(one.residual);
        self.data.push(number, one.data.iter().copied());
        self.factors.push(number, one.factor.iter().copied());
        self.covariates.push(number, one.covariates.iter().copied());
        self.steps.push(one.steps);
        self.observations.push(one.observations);
        self.paths.push(one.path);
        self.designs.push(one.design);
    }

    /// Sets the chain and the exact rows of the last test.
    pub(super) fn put_chain_and_exact(&mut self, chain: Option<Box<Chain>>, exact: Option<Box<ExactRows>>) {
        let last = self.len() - 1;
        self.chains.set(last, chain);
        self.exact.set(last, exact);
    }
}

/// Iterator over the reductions of [`Reductions`].
#[derive(Debug, Clone)]
pub struct Rows<'a> {
    source: &'a Reductions,
    numbers: Range<usize>,
}

impl<'a> Iterator for Rows<'a> {
    type Item = ReductionRef<'a>;

    fn next(&mut self) -> Option<ReductionRef<'a>> {
        self.numbers.next().map(|number| self.source.get(number))
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        self.numbers.size_hint()
    }
}

impl DoubleEndedIterator for Rows<'_> {
    fn next_back(&mut self) -> Option<Self::Item> {
        self.numbers.next_back().map(|number| self.source.get(number))
    }
}

impl ExactSizeIterator for Rows<'_> {}

impl<'a> IntoIterator for &'a Reductions {
    type Item = ReductionRef<'a>;
    type IntoIter = Rows<'a>;

    fn into_iter(self) -> Rows<'a> {
        self.iter()
    }
}

impl PartialEq for Reductions {
    fn eq(&self, other: &Reductions) -> bool {
        self.iter().eq(other.iter())
    }
}

impl Extend<Reduction> for Reductions {
    fn extend<I: IntoIterator<Item = Reduction>>(&mut self, all: I) {
        all.into_iter().for_each(|one| self.push(one));
    }
}

impl FromIterator<Reduction> for Reductions {
    fn from_iter<I: IntoIterator<Item = Reduction>>(all: I) -> Reductions {
        let mut reductions = Reductions::new();
        reductions.extend(all);
        reductions
    }
}

impl<'a> FromIterator<ReductionRef<'a>> for Reductions {
    fn from_iter<I: IntoIterator<Item = ReductionRef<'a>>>(all: I) -> Reductions {
        let mut reductions = Reductions::new();
        for one in all {
            reductions.put(one);
            reductions.put_chain_and_exact(one.chain.cloned().map(Box::new), one.exact.cloned().map(Box::new));
        }
        reductions
    }
}

impl From<Vec<Reduction>> for Reductions {
    fn from(all: Vec<Reduction>) -> Reductions {
        all.into_iter().collect()
    }
}

#[cfg(test)]
mod tests;
