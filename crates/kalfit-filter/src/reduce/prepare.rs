//! Evaluation of a test at α: the design and the data of the test.

use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;

use kalfit_lanes::Isa;

use crate::reduce::cell_mask::CellMask;
use crate::reduce::data::Data;
use crate::reduce::data_memory::DataBuffers;
use crate::reduce::design::{Design, Transition};
use crate::reduce::dynamics::Dynamics;
use crate::reduce::error::ReduceErrorKind;
use crate::reduce::instances::{Instance, Instances};
use crate::reduce::known_steps::KnownSteps;
use crate::reduce::lanes::{DataBlock, DataWorkspace};
use crate::reduce::motion::{Filled, MotionPlan, Moves};
use crate::reduce::observe::{Meters, Observed};
use crate::reduce::order::Order;
use crate::reduce::schedule::GainsWork;
use crate::reduce::shared_store::SharedStore;
use crate::reduce::start::{ModelStart, StartMoments};
use crate::reduce::steps::{GatheredCells, StepSpan, spans};
use crate::reduce::subject::{Coefficient, Fault, ModelAt, Subject, Uses};
use kalfit_model::Test;
use kalfit_model::{Alpha, Model, Scope};

mod alike;
mod opening;
mod replay;
mod skeleton;
mod transition;

use alike::read_cells;
pub use replay::Replay;
pub(crate) use replay::StartCells;
pub use skeleton::Skeleton;
use transition::LastMoves;

/// Largest number of bytes of cached transitions.
const TRANSITION_BYTES: usize = 16 << 20;

/// A model at α, ready to evaluate tests.
#[derive(Debug)]
pub struct Preparer {
    /// The model.
    pub model: Model,
    alpha: Alpha,
    /// Whether each parameter is free; empty where no derivatives are requested.
    free: Vec<bool>,
    /// The motion of the model at α.
    pub dynamics: Dynamics,
    /// The start of the model at α, with states numbered as in the model.
    pub start: ModelStart,
    /// Permutation between the model's order of states and the kernels' order.
    pub order: Order,
    /// How the entries of φ, Q and b follow from coefficients and flows.
    pub plan: MotionPlan,
    pub(crate) meters: Meters,
    /// Columns on which φ, Q, h, R and the selection of values depend: where the cells of these columns repeat, so do
    /// φ, Q, h, R and the selection.
    design_columns: Uses,
    /// Columns on which only known inputs and constants depend.
    input_columns: Uses,
    /// Whether only measured values and times are read from the data.
    only_values: bool,
    /// Whether the dynamics depend only on the length of a step.
    fixed_dynamics: bool,
    /// Whether no transition needs a matrix exponential.
    without_exponentials: bool,
    /// Whether tests can be evaluated column by column: correlated noises of states are the same on every row.
    columnwise: bool,
    /// The law of x_0; `None` where it differs from test to test.
    law: Option<StartMoments>,
    /// Mask of the cells that determine everything but measured values; `None` where whitening mixes values.
    pub(crate) cell_mask: Option<CellMask>,
    transitions: SharedStore<Vec<u64>, Result<Moves, Box<Fault>>>,
    /// Steps of tests, found at other α; `None` where steps are not cached.
    pub(crate) steps: Option<Arc<KnownSteps>>,
    /// Number of transitions computed by matrix exponentials, for all tests.
    pub(crate) computed: AtomicU64,
}

/// Rows, length and motion of one step.
#[derive(Debug, Clone)]
struct StepRows {
    rows: Range<usize>,
    /// The rows from whose cells the dynamics are evaluated.
    source: Range<usize>,
    dt: f64,
    moves: bool,
}

/// One evaluated test, and the work space of all passes over the test.
#[derive(Debug)]
pub struct Workspace {
    /// The design of the test.
    pub design: Design,
    /// The data of the test, in kernel order.
    pub data: Data,
    /// The scalar measurements of the test, in the order of the design.
    pub instances: Instances,
    /// Covariates of the test, one for each regression of the mean.
    pub covariates: Vec<f64>,
    /// Noise covariances (i, j, value) between scalar measurements of the test, collected where measurements are not
    /// whitened; else `None`.
    pub covariances: Option<Vec<(usize, usize, f64)>>,
    pub(crate) gains: GainsWork,
    /// Work space of the data pass of this test alone.
    pub pass: DataWorkspace,
    /// Data of replicates, or of any tests in lanes.
    pub(crate) block: DataBlock,
    pub(crate) scratch: DataWorkspace,
    spans: Vec<StepSpan>,
    /// Index of the first step of each span.
    firsts: Vec<usize>,
    constants: Vec<f64>,
    whole: GatheredCells,
    step: GatheredCells,
    replay: Replay,
    filled: Filled,
    key: Vec<u64>,
    last: Option<LastMoves>,
    /// Unshared transitions whose memory is reused.
    reusable: Vec<Arc<Transition>>,
    /// Where the memory of the data goes afterwards.
    steps: Option<Arc<KnownSteps>>,
}

impl Drop for Workspace {
    fn drop(&mut self) {
        if let Some(steps) = &self.steps {
            let (data, block) = (std::mem::take(&mut self.data), self.block.take_memory());
            steps.memory.give_back(DataBuffers { data, block });
        }
    }
}

impl Workspace {
    /// The rows of each step.
    pub fn step_rows(&self) -> impl Iterator<Item = Range<usize>> {
        self.spans.iter().flat_map(|span| (0..span.count).map(|number| span.step(number)))
    }
}

impl Preparer {
    /// A preparer without derivatives; an error where the model cannot be evaluated at α.
    pub fn new(model: &Model, alpha: &Alpha) -> Result<Preparer, Box<Fault>> {
        Preparer::with_free(model, alpha, Vec::new())
    }

    /// A preparer for derivatives: coefficients that depend on a free parameter are retained even where such a
    /// coefficient is zero at this α. `free`: whether each parameter is free.
    pub(crate) fn with_free(model: &Model, alpha: &Alpha, free: Vec<bool>) -> Result<Preparer, Box<Fault>> {
        Preparer::build(model, alpha, free, false)
    }

    /// A preparer of tests each of which brings a law of the estimated states, as part of a and P0.
    pub(crate) fn of_known_starts(model: &Model, alpha: &Alpha) -> Result<Preparer, Box<Fault>> {
        let mut preparer = Preparer::build(model, alpha, Vec::new(), true)?;
        preparer.order.frame = Arc::new(preparer.order.frame.without_unknowns());
        Ok(preparer)
    }

    fn build(model: &Model, alpha: &Alpha, free: Vec<bool>, has_per_test_law: bool) -> Result<Preparer, Box<Fault>> {
        let at = ModelAt { model, alpha, free: &free };
        let dynamics = Dynamics::new(&at)?;
        let mut start = ModelStart::new(&at, &dynamics)?;
        start.has_per_test_law = has_per_test_law;
        let order = Order::new(&at, &dynamics, &start);
        let meters = Meters::new(&at, &order.place)?;
        let settled = !dynamics.table.varying.iter().any(|(slot, ..)| start.needs(*slot))
            && !dynamics.inputs.varying.iter().any(|(slot, ..)| start.needs_input(*slot));
        let law = if start.fixed && settled {
            let scope = Scope { numbers: &[], texts: &[], step: 0.0, alpha };
            Some(start.law(&at, &scope, &dynamics.table.fixed, &dynamics.inputs.fixed)?)
        } else {
            None
        };
        let (mut design_columns, mut input_columns) = meters.uses(alpha);
        dynamics.table.varying.iter().for_each(|(_, coefficient, _)| design_columns.add(coefficient, alpha));
        dynamics.inputs.varying.iter().for_each(|(_, coefficient, _)| input_columns.add(coefficient, alpha));
        let read_cells = read_cells(&at, (&design_columns, &input_columns), (&dynamics, &start, &meters));
        Ok(Preparer {
            only_values: design_columns.is_empty() && input_columns.is_empty() && meters.can_repeat(),
            design_columns,
            input_columns,
            without_exponentials: dynamics.components.iter().all(|component| component.states.len() == 1),
            columnwise: !dynamics.correlation_varies(),
            fixed_dynamics: dynamics.table.varying.is_empty() && dynamics.inputs.varying.is_empty(),
            model: model.clone(),
            alpha: alpha.clone(),
            free,
            plan: MotionPlan::new(&dynamics, &order),
            dynamics,
            start,
            order,
            meters,
            law,
            cell_mask: read_cells,
            transitions: SharedStore::new(TRANSITION_BYTES),
            steps: None,
            computed: AtomicU64::new(0),
        })
    }

    /// The model and α, from which coefficients are evaluated.
    pub fn at(&self) -> ModelAt<'_> {
        ModelAt { model: &self.model, alpha: &self.alpha, free: &self.free }
    }

    /// Whether a measurement whose noise is zero at this α can have noise at other free values.
    pub(crate) fn has_free_noise(&self, test: &Test, Instance { meter, row }: Instance) -> bool {
        let (at, other) = (self.at(), self.alpha.at_other_values(&self.free));
        let scope = Scope { numbers: test.numbers(row), texts: test.texts(row), step: f64::NAN, alpha: &other };
        let moves = |noise: &Coefficient| match noise.source() {
            Some((expression, _)) if at.depends(expression) => expression.evaluate(&scope) != Ok(0.0),
            _ => false,
        };
        let own = self.meters.parts().nth(meter).map(|(noise, ..)| noise);
        own.into_iter().chain(self.meters.pairs()).any(moves)
    }

    /// Whether tests can be evaluated column by column.
    pub(crate) fn has_columns(&self) -> bool {
        self.columnwise
    }

    /// The law of x_0; `None` where it differs from test to test.
    pub(crate) fn law(&self) -> Option<&StartMoments> {
        self.law.as_ref()
    }

    /// An empty work space for tests of this model.
    pub fn workspace(&self) -> Workspace {
        let DataBuffers { data, block } = self.steps.as_ref().map(|steps| steps.memory.take()).unwrap_or_default();
        Workspace {
            design: Design::new(self.order.frame.clone()),
            data,
            instances: Instances::default(),
            firsts: Vec::new(),
            constants: Vec::new(),
            covariates: Vec::new(),
            covariances: None,
            gains: GainsWork::default(),
            pass: DataWorkspace::default(),
            block: DataBlock::with_memory(Isa::best().into(), block),
            scratch: DataWorkspace::default(),
            spans: Vec::new(),
            whole: GatheredCells::default(),
            step: GatheredCells::default(),
            replay: Replay::default(),
            filled: Filled::default(),
            key: Vec::new(),
            last: None,
            reusable: Vec::new(),
            steps: self.steps.clone(),
        }
    }

    /// Evaluates a test into the work space.
    pub fn prepare(&self, test: &Test, work: &mut Workspace) -> Result<(), Box<Fault>> {
        let at = self.at();
        if test.rows() == 0 {
            return Err(Fault::new(Subject::Test, ReduceErrorKind::NoRows));
        }
        work.clear_design();
        work.data.clear();
        work.instances.clear();
        work.covariances.iter_mut().for_each(Vec::clear);
        work.whole.gather(&at, test, 0..test.rows(), (&self.start.uses, true))?;
        let scope =
            Scope { numbers: &work.whole.numbers, texts: &work.whole.texts, step: f64::NAN, alpha: &self.alpha };
        let initial = self.start.initial_time.as_ref().map(|time| at.value(time, &scope)).transpose()?;
        self.spans(test, initial, &mut work.spans)?;
        work.firsts.clear();
        let mut first = 0;
        for span in &work.spans {
            work.firsts.push(first);
            first += span.count;
        }
        self.covariates(&at, work)?;
        self.write_start(&at, test, work)?;
        let mut source = 0..0; // rows of the step before
        for at_span in 0..work.spans.len() {
            let span = work.spans[at_span].clone();
            source = self.span(&at, test, (&span, source), work)?;
        }
        work.design.complete();
        Ok(())
    }

    /// Writes the steps of a test to `out`; `initial` is the time of x_0. Where no state ever moves, no transition
    /// leads to a step.
    fn spans(&self, test: &Test, initial: Option<f64>, out: &mut Vec<StepSpan>) -> Result<(), Box<Fault>> {
        if let Some(known) = self.steps.as_ref().and_then(|steps| steps.of(test, initial)) {
            out.clone_from(&known);
            return Ok(());
        }
        spans(&self.at(), test, initial, out)?;
        if self.plan.is_still() {
            out.iter_mut().for_each(|span| span.moves = false);
        }
        self.steps.iter().for_each(|steps| steps.keep(test, initial, out));
        Ok(())
    }

    /// Evaluates the steps of a span. `source`: rows of the step before. Returns the rows of the last step.
    fn span(
        &self,
        at: &ModelAt<'_>,
        test: &Test,
        (span, mut source): (&StepSpan, Range<usize>),
        work: &mut Workspace,
    ) -> Result<Range<usize>, Box<Fault>> {
        let (height, mut repeats, mut number) = (span.height(), 0, 0);
        while number < span.count {
            let first = span.rows.start + number * height;
            let rows = first..first + height;
            if source.is_empty() || !self.clock_previous() {
                source = rows.clone();
            }
            let moment = StepRows { rows: rows.clone(), source, dt: span.dt, moves: span.moves };
            let again = number > 0 && self.design_columns.repeat(test, &rows);
            repeats = if again { repeats + 1 } else { 0 };
            // where inputs are read from the row before, that row must repeat too
            let enough = repeats > usize::from(self.clock_previous());
            if !(enough && self.meters.can_repeat() && self.repeat(at, test, &moment, work)?) {
                self.step(at, test, &moment, work)?;
            }
            source = rows;
            number += 1;
            if self.only_values && height == 1 && number < span.count {
                number += self.repeat_values(test, source.end, span.count - number, work);
            }
        }
        Ok(source)
    }

    /// Appends the one-row steps that follow and equal the last step except for values, where only values are read from
    /// the data. Returns the number of steps appended.
    fn repeat_values(&self, test: &Test, first: usize, most: usize, work: &mut Workspace) -> usize {
        let Workspace { design, data, instances, covariances, constants, .. } = &mut *work;
        let mut observed = Observed { design, data, instances, covariances: covariances.as_mut(), constants };
        let appended = self.meters.repeat_values(test, first, most, &mut observed);
        work.design.repeat(appended);
        let driven = self.order.frame.driven.len();
        for _ in 0..appended * usize::from(driven > 0) {
            let last = work.data.inputs.len() - driven;
            work.data.inputs.extend_from_within(last..);
        }
        appended
    }

    /// Whether the coefficients of a step are read from the row before the step instead of the rows of the step.
    pub(crate) fn clock_previous(&self) -> bool {
        self.model.clock.previous_inputs
    }

    /// Evaluates a step in full.
    fn step(&self, at: &ModelAt<'_>, test: &Test, moment: &StepRows, work: &mut Workspace) -> Result<(), Box<Fault>> {
        if moment.moves {
            self.transition(at, test, moment, work)?;
        }
        let Workspace { design, data, instances, covariances, constants, last, .. } = &mut *work;
        let mut observed = Observed { design, data, instances, covariances: covariances.as_mut(), constants };
        self.meters.observe(at, test, (moment.rows.clone(), moment.dt), &mut observed)?;
        let transition = last.as_ref().filter(|_| moment.moves).map(|last| &last.moves().transition);
        design.join_step(transition);
        Ok(())
    }

    /// Appends a step whose φ, Q, h, R are those of the step before. Returns false and changes nothing where the step
    /// has other measurements.
    fn repeat(
        &self,
        at: &ModelAt<'_>,
        test: &Test,
        moment: &StepRows,
        work: &mut Workspace,
    ) -> Result<bool, Box<Fault>> {
        let (driven, height) = (self.order.frame.driven.len(), moment.rows.len());
        let driven_on = !self.input_columns.is_empty();
        let fresh = driven_on && !self.input_columns.repeat(test, &moment.rows);
        // the row before may be the first row with such cells, so that the inputs are new
        let fresh_inputs = fresh || (driven_on && self.clock_previous());
        let inputs = work.data.inputs.len();
        if driven > 0 && moment.moves {
            if fresh_inputs {
                self.evaluate(at, test, moment, work, Preparer::inputs)?;
                let last = work.last.as_ref().expect("a step that repeats has had a transition");
                self.plan.inputs(last.moves(), &work.replay.inputs, &mut work.data.inputs);
            } else {
                work.data.inputs.extend_from_within(inputs - driven..);
            }
        }
        let Workspace { design, data, instances, covariances, constants, .. } = &mut *work;
        let mut observed = Observed { design, data, instances, covariances: covariances.as_mut(), constants };
        let is_repeated =
            self.meters.repeat(at, test, ((moment.rows.start, height), moment.dt), fresh, &mut observed)?;
        if is_repeated {
            work.design.repeat(1);
        } else {
            work.data.inputs.truncate(inputs);
        }
        Ok(is_repeated)
    }

    /// Writes a and P0 of a test into the work space.
    fn write_start(&self, at: &ModelAt<'_>, test: &Test, work: &mut Workspace) -> Result<(), Box<Fault>> {
        let own;
        let law = match &self.law {
            Some(law) => law,
            None => {
                let dt = work.spans[0].dt;
                if self.start.has_stationary_states() {
                    let rows = work.spans[0].step(0);
                    let moment = StepRows { source: rows.clone(), rows, dt, moves: true };
                    self.evaluate(at, test, &moment, work, Preparer::stationary_coefficients)?;
                }
                let scope =
                    Scope { numbers: &work.whole.numbers, texts: &work.whole.texts, step: dt, alpha: &self.alpha };
                own = self
                    .start
                    .law(at, &scope, &work.replay.values, &work.replay.inputs)
                    .map_err(|fault| fault.on(0))?;
                &own
            }
        };
        let r = self.order.frame.r;
        work.data.start.resize(law.mean.len(), 0.0);
        for (state, &mean) in law.mean.iter().enumerate() {
            work.data.start[self.order.place[state]] = mean;
        }
        for &(i, j, value) in &law.covariance {
            let (i, j) = (self.order.place[i], self.order.place[j]);
            // A variance of zero may belong to a state that noise never reaches.
            if value != 0.0 {
                work.design.variance[i.max(j) * r + i.min(j)] += value;
            }
        }
        Ok(())
    }

    /// Evaluates the part of the dynamics that `wanted` computes, on one step.
    fn evaluate(
        &self,
        at: &ModelAt<'_>,
        test: &Test,
        moment: &StepRows,
        work: &mut Workspace,
        wanted: impl FnOnce(&Preparer, &Scope<'_>, &mut Replay) -> Result<(), Box<Fault>>,
    ) -> Result<(), Box<Fault>> {
        let scope = self.motion_scope(at, test, moment, &mut work.step)?;
        wanted(self, &scope, &mut work.replay).map_err(|fault| fault.on(moment.source.start))
    }

    /// The scope in which the dynamics of a step are evaluated. `cells`: work space for steps of several rows.
    fn motion_scope<'a>(
        &'a self,
        at: &ModelAt<'_>,
        test: &'a Test,
        moment: &StepRows,
        cells: &'a mut GatheredCells,
    ) -> Result<Scope<'a>, Box<Fault>> {
        let (numbers, texts) = if moment.source.len() == 1 {
            (test.numbers(moment.source.start), test.texts(moment.source.start))
        } else {
            cells.gather(at, test, moment.source.clone(), (&self.dynamics.uses, false))?;
            (&*cells.numbers, &*cells.texts)
        };
        Ok(Scope { numbers, texts, step: moment.dt, alpha: &self.alpha })
    }
}
