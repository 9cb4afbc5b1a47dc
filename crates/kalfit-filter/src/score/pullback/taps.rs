//! Taps, the coefficients that depend on free values of α; the adjoints of the taps, and dℓ/dα computed from these
//! adjoints.

use crate::reduce::{Coefficient, Fault, ModelAt, ReduceErrorKind, Subject, Uses};
use kalfit_model::Label;
use kalfit_model::{Alpha, EvaluationError, Expression, Scope, Slots, Tape};

/// Gradient of one test: (slot, dℓ/dvalue), each slot at most once, ascending.
pub type Gradient = Vec<(usize, f64)>;

/// Adds one gradient to another.
pub fn add(gradient: &mut Gradient, other: &Gradient) {
    for &(slot, x) in other {
        match gradient.binary_search_by_key(&slot, |&(slot, _)| slot) {
            Ok(at) => gradient[at].1 += x,
            Err(at) => gradient.insert(at, (slot, x)),
        }
    }
}

/// A cell of the data that a coefficient reads.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum CellRead {
    Number(usize),
    Text(usize),
    Step,
}

impl CellRead {
    pub(super) fn bits(self, scope: &Scope<'_>) -> u64 {
        match self {
            CellRead::Number(column) => scope.numbers[column].to_bits(),
            CellRead::Text(column) => scope.texts[column].index() as u64,
            CellRead::Step => scope.step.to_bits(),
        }
    }
}

/// A coefficient that depends on free values.
#[derive(Debug, Clone)]
struct FreeCoefficient {
    expression: Expression,
    subject: Subject,
    reads: Vec<CellRead>,
    /// Index of the first cell of this coefficient in [`Pending::cells`].
    start: usize,
}

/// All coefficients of a model that depend on free values.
#[derive(Debug, Clone, Default)]
pub(super) struct FreeCoefficients {
    taps: Vec<FreeCoefficient>,
    cells: usize,
}

impl FreeCoefficients {
    /// Adds a tap for the coefficient and returns the index of the tap; `None` where the coefficient depends on no free
    /// value.
    pub(super) fn add(&mut self, at: &ModelAt<'_>, coefficient: &Coefficient) -> Option<usize> {
        let (expression, subject) = coefficient.source().filter(|(expression, _)| at.depends(expression))?;
        let reads = reads(expression, at.alpha);
        let start = self.cells;
        self.cells += reads.len();
        self.taps.push(FreeCoefficient { expression: expression.clone(), subject, reads, start });
        Some(self.taps.len() - 1)
    }

    pub(super) fn len(&self) -> usize {
        self.taps.len()
    }

    /// All cells that the coefficients read, sorted, without duplicates.
    pub(super) fn all_reads(&self) -> Vec<CellRead> {
        let mut reads: Vec<CellRead> = self.taps.iter().flat_map(|tap| &tap.reads).copied().collect();
        reads.sort_unstable();
        reads.dedup();
        reads
    }

    /// Cells that a coefficient reads.
    pub(super) fn reads(&self, tap: usize) -> &[CellRead] {
        &self.taps[tap].reads
    }
}

fn reads(expression: &Expression, alpha: &Alpha) -> Vec<CellRead> {
    let mut uses = Uses::default();
    uses.expression(expression, alpha);
    let mut reads: Vec<CellRead> = uses.numbers.into_iter().map(CellRead::Number).collect();
    reads.extend(uses.texts.into_iter().map(CellRead::Text));
    if expression.any(&mut |part| matches!(part, Expression::Step)) {
        reads.push(CellRead::Step);
    }
    reads
}

/// Adjoints that have not gone through the expressions of their coefficients yet. The adjoints of one coefficient on
/// equal cells are summed, and the sum goes through the expression once.
#[derive(Debug, Clone)]
pub(super) struct Pending {
    seeds: Vec<f64>,
    /// For each coefficient, whether a sum is pending.
    has_sum: Vec<bool>,
    cells: Vec<u64>,
    row: Row,
    tape: Tape,
    slot_sums: SlotSums,
}

/// A row of data in which the cells of one coefficient are set.
#[derive(Debug, Clone)]
struct Row {
    numbers: Vec<f64>,
    texts: Vec<Label>,
}

/// Sums by slot, with a list of the few slots that have a sum.
#[derive(Debug, Clone)]
struct SlotSums {
    sums: Vec<f64>,
    touched: Vec<bool>,
    slots: Vec<usize>,
}

impl Pending {
    pub(super) fn new(taps: &FreeCoefficients, at: &ModelAt<'_>, slots: &Slots) -> Pending {
        let count = taps.taps.len();
        Pending {
            seeds: vec![0.0; count],
            has_sum: vec![false; count],
            cells: vec![0; taps.cells],
            row: Row {
                numbers: vec![f64::NAN; at.model.columns.len()],
                texts: vec![Label::MISSING; at.model.text_columns.len()],
            },
            tape: Tape::default(),
            slot_sums: SlotSums { sums: vec![0.0; slots.len()], touched: vec![false; slots.len()], slots: Vec::new() },
        }
    }

    /// Adds `seed` = ∂ℓ/∂coefficient of one row to the pending sum of the coefficient `tap`.
    #[inline]
    pub(super) fn add(
        &mut self,
        context: &Context<'_>,
        tap: usize,
        seed: f64,
        scope: &Scope<'_>,
    ) -> Result<(), Box<Fault>> {
        if seed == 0.0 {
            return Ok(());
        }
        let FreeCoefficient { reads, start, .. } = &context.taps.taps[tap];
        if !reads.is_empty() {
            let known = &self.cells[*start..][..reads.len()];
            let same = self.has_sum[tap] && reads.iter().zip(known).all(|(read, &bits)| read.bits(scope) == bits);
            if !same {
                self.flush(context, tap)?;
                let cells = &mut self.cells[*start..][..reads.len()];
                cells.iter_mut().zip(reads).for_each(|(bits, read)| *bits = read.bits(scope));
            }
        }
        self.has_sum[tap] = true;
        self.seeds[tap] += seed;
        Ok(())
    }

    /// Takes the pending sum of a coefficient through the expression of the coefficient.
    fn flush(&mut self, context: &Context<'_>, tap: usize) -> Result<(), Box<Fault>> {
        let seed = std::mem::take(&mut self.seeds[tap]);
        if !std::mem::take(&mut self.has_sum[tap]) {
            return Ok(());
        }
        let FreeCoefficient { expression, subject, reads, start } = &context.taps.taps[tap];
        let mut step = 0.0;
        for (read, &bits) in reads.iter().zip(&self.cells[*start..]) {
            match *read {
                CellRead::Number(column) => self.row.numbers[column] = f64::from_bits(bits),
                CellRead::Text(column) => self.row.texts[column] = Label::literal(bits as usize),
                CellRead::Step => step = f64::from_bits(bits),
            }
        }
        let Row { numbers, texts } = &self.row;
        let scope = Scope { numbers, texts, step, alpha: context.at.alpha };
        let (slot_sums, mut finite) = (&mut self.slot_sums, true);
        let sink = &mut |parameter: usize, x: f64| {
            if let Some(slot) = context.slots.find(parameter, texts) {
                finite &= x.is_finite();
                slot_sums.add(slot, x);
            }
        };
        let done = expression.differentiate(seed, &scope, &mut self.tape, sink);
        let done = done.and(if finite { Ok(0.0) } else { Err(EvaluationError::NotFinite) });
        context.at.finite(done, *subject).map(|_| ())
    }

    /// Takes all pending sums through the expressions, and returns the gradient.
    pub(super) fn finish(&mut self, context: &Context<'_>) -> Result<Gradient, Box<Fault>> {
        (0..self.seeds.len()).try_for_each(|tap| self.flush(context, tap))?;
        let gradient = self.slot_sums.take();
        match gradient.iter().all(|(_, x)| x.is_finite()) {
            true => Ok(gradient),
            false => Err(Fault::new(Subject::Test, ReduceErrorKind::NotFinite)),
        }
    }

    /// Discards all pending and finished sums.
    pub(super) fn clear(&mut self) {
        self.seeds.fill(0.0);
        self.has_sum.fill(false);
        self.slot_sums.take();
    }
}

/// Model at α, slots and taps for which derivatives are computed.
#[derive(Debug, Clone, Copy)]
pub(super) struct Context<'a> {
    pub(super) at: ModelAt<'a>,
    pub(super) slots: &'a Slots,
    pub(super) taps: &'a FreeCoefficients,
}

impl SlotSums {
    fn add(&mut self, slot: usize, x: f64) {
        if !self.touched[slot] {
            self.touched[slot] = true;
            self.slots.push(slot);
        }
        self.sums[slot] += x;
    }

    fn take(&mut self) -> Gradient {
        self.slots.sort_unstable();
        let (sums, touched) = (&mut self.sums, &mut self.touched);
        let mut take = |slot: usize| {
            touched[slot] = false;
            (slot, std::mem::take(&mut sums[slot]))
        };
        self.slots.drain(..).map(&mut take).collect()
    }
}
