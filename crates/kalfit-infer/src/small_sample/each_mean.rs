//! The t test and interval of each mean and regression coefficient.

use nalgebra::DVector;

use crate::small_sample::{DfMethod, MeanTest, NoDf, SmallSample};
use crate::{Holdable, Inference};

/// Tests of means with few tests.
#[derive(Debug, Clone)]
pub struct FewTests {
    /// Method of the standard errors and degrees of freedom.
    pub method: DfMethod,
    /// Test of each element of μ; `None` where fixed or not identified.
    pub mean: Vec<Option<MeanTest>>,
    /// Test of each regression coefficient.
    pub coefficients: Vec<Option<MeanTest>>,
    /// The law, for tests of other combinations.
    pub law: SmallSample,
}

impl FewTests {
    fn of(law: SmallSample, count: [usize; 2], is_known: &dyn Fn(Holdable) -> bool) -> FewTests {
        let [means, coefficients] = count;
        let row = |k: usize, what: Holdable| {
            let weights = DVector::from_fn(means + coefficients, |i, _| f64::from(u8::from(i == k)));
            is_known(what).then(|| law.row(&weights)).flatten()
        };
        FewTests {
            method: law.method(),
            mean: (0..means).map(|i| row(i, Holdable::Mean(i))).collect(),
            coefficients: (0..coefficients).map(|c| row(means + c, Holdable::Coefficient(c))).collect(),
            law,
        }
    }

    /// The test of a mean or coefficient.
    fn get(&self, what: Holdable) -> Option<&MeanTest> {
        match what {
            Holdable::Mean(i) => self.mean.get(i)?.as_ref(),
            Holdable::Coefficient(c) => self.coefficients.get(c)?.as_ref(),
            _ => None,
        }
    }
}

impl Inference {
    /// Adds tests of means, whose standard errors and intervals replace those of large samples. A mean without such a
    /// test keeps the large-sample error where there is no method, and has no interval where the method fails for it.
    pub(crate) fn add_few_tests(&mut self, found: Option<Result<SmallSample, NoDf>>) {
        let errors = &self.uncertainty.errors;
        let count = [errors.mean.len(), errors.coefficients.len()];
        self.few_tests =
            found.map(|found| found.map(|law| FewTests::of(law, count, &|what| errors.of(what).is_some())));
        let Some(Ok(tests)) = &self.few_tests else { return };
        let all = (0..count[0]).map(Holdable::Mean).chain((0..count[1]).map(Holdable::Coefficient));
        let known: Vec<Holdable> = all.filter(|what| errors.of(*what).is_some()).collect();
        for what in known {
            let own = tests.get(what);
            if let Some(own) = own {
                self.uncertainty.errors.set(what, Some(own.std_error));
            }
            self.intervals.set(what, own.map(|own| own.interval.map(Some)));
        }
    }
}
