//! Rows on end that measure the same things, one step each: their lines go to the design many at a time.

use crate::ensemble::Test;
use crate::model::Scope;
use crate::reduce::observe::{Meter, Meters, Observed};
use crate::reduce::subject::{At, Fault};

/// Rows to look at: the first, how many at most, and the length of their steps.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ahead {
    pub(crate) first: usize,
    pub(crate) most: usize,
    pub(crate) dt: f64,
}

impl Meters {
    /// True when which measurements a row has can be told from the measured values alone, and each has a line of its own.
    pub(crate) fn can_follow(&self) -> bool {
        self.pairs.is_empty() && self.meters.iter().all(|meter| meter.filter.is_none())
    }

    /// Takes rows, a step each, that measure what the last step does, by other lines than the row before. Stops before a row that
    /// is not like that, or that something is wrong with. `drive` appends the inputs of a step; where it cannot, it says false and
    /// appends none. Returns how many.
    pub(crate) fn follow(
        &self,
        at: &At<'_>,
        test: &Test,
        ahead: Ahead,
        out: &mut Observed<'_>,
        mut drive: impl FnMut(usize, &mut Vec<f64>) -> bool,
    ) -> usize {
        let Observed { design, data, instances, constants, .. } = out;
        let taken: Vec<&Meter> = instances.last_step().iter().map(|entry| &self.meters[entry.meter]).collect();
        let (width, terms) = (taken.len(), taken.iter().map(|meter| meter.terms.len()).sum());
        let mut many = 0;
        while many < ahead.most {
            let row = ahead.first + many;
            let scope = Scope { numbers: test.numbers(row), texts: test.texts(row), step: ahead.dt, alpha: at.alpha };
            if !self.measures(&taken, scope.numbers) {
                break;
            }
            let before = [design.h.len(), design.noise.len(), data.values.len()];
            let sound = taken.iter().try_for_each(|meter| {
                let (noise, constant) = meter.line(at, &scope, &mut design.h)?;
                design.noise.push(noise);
                data.take(scope.numbers[meter.column], constant);
                Ok::<(), Box<Fault>>(())
            });
            let is_fresh = sound.is_ok() && (differs(&design.h, terms) || differs(&design.noise, width));
            if !is_fresh || !drive(row, &mut data.inputs) {
                design.h.truncate(before[0]);
                design.noise.truncate(before[1]);
                data.values.truncate(before[2]);
                data.sizes.truncate(before[2]);
                break;
            }
            many += 1;
        }
        if many > 0 {
            let row = ahead.first + many - 1;
            let scope = Scope { numbers: test.numbers(row), texts: test.texts(row), step: ahead.dt, alpha: at.alpha };
            let last = taken.iter().map(|meter| at.value(&meter.constant, &scope).expect("the row was sound"));
            constants.clear();
            constants.extend(last);
            instances.follow(ahead.first, many);
            design.follow(many, (width, terms));
        }
        many
    }

    /// True when a row measures these things and no others.
    #[inline(always)]
    fn measures(&self, taken: &[&Meter], numbers: &[f64]) -> bool {
        let mut left = taken;
        self.meters.iter().all(|meter| match left.split_first() {
            Some((first, rest)) if std::ptr::eq(*first, meter) => {
                left = rest;
                numbers[meter.column].is_finite()
            }
            _ => numbers[meter.column].is_nan(),
        })
    }
}

/// True when the last so many numbers differ from as many before them.
#[inline(always)]
fn differs(numbers: &[f64], many: usize) -> bool {
    let (before, last) = numbers.split_at(numbers.len() - many);
    before[before.len() - many..].iter().zip(last).any(|(a, b)| a.to_bits() != b.to_bits())
}
