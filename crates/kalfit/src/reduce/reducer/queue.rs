//! Tests with designs of their own that were evaluated and wait for others of the same shape, to be filtered side by side.

use kalfit_lanes::Isa;

use crate::reduce::data::Data;
use crate::reduce::design::Design;
use crate::reduce::instances::Instances;
use crate::reduce::lanes::same_shape;
use crate::reduce::prepare::Workspace;

/// Most lines: one for each shape.
const LINES: usize = 16;

/// A test that was evaluated.
#[derive(Debug)]
pub(crate) struct Own {
    pub(crate) number: usize,
    pub(crate) digest: u128,
    pub(crate) design: Design,
    pub(crate) data: Data,
    pub(crate) covariates: Vec<f64>,
    pub(crate) instances: Instances,
}

/// Lines of tests whose designs have one shape each.
#[derive(Debug, Default)]
pub(crate) struct Queue {
    lines: Vec<Vec<Own>>,
    /// Room that was used before.
    spare: Vec<Own>,
}

impl Queue {
    /// The line in which a test of this design waits.
    pub(crate) fn line_with(&self, digest: u128) -> Option<usize> {
        self.line(|own| own.digest == digest)
    }

    /// A line that is not empty.
    pub(crate) fn any(&self) -> Option<usize> {
        self.line(|_| true)
    }

    fn line(&self, wanted: impl Fn(&Own) -> bool) -> Option<usize> {
        self.lines.iter().position(|line| line.iter().any(&wanted))
    }

    /// Moves a test from the work space to the end of its line. Returns the number of a line that is to be taken now.
    pub(crate) fn push(&mut self, number: usize, digest: u128, work: &mut Workspace) -> Option<usize> {
        let mut own = self.spare.pop().unwrap_or_else(|| Own {
            number,
            digest,
            design: Design::new(work.design.frame.clone()),
            data: Data::default(),
            covariates: Vec::new(),
            instances: Instances::default(),
        });
        (own.number, own.digest) = (number, digest);
        std::mem::swap(&mut own.design, &mut work.design);
        std::mem::swap(&mut own.data, &mut work.data);
        std::mem::swap(&mut own.covariates, &mut work.covariates);
        std::mem::swap(&mut own.instances, &mut work.instances);
        // a shorter test that goes with the longest of a line goes with all
        let fits = |line: &Vec<Own>| {
            let longest = line.iter().max_by_key(|other| other.design.runs.len());
            longest.is_some_and(|longest| same_shape(&longest.design, &own.design))
        };
        let found = self.lines.iter().position(fits).or_else(|| self.lines.iter().position(Vec::is_empty));
        let line = found.unwrap_or_else(|| {
            self.lines.push(Vec::new());
            self.lines.len() - 1
        });
        self.lines[line].push(own);
        if self.lines[line].len() == Isa::best().lanes() {
            return Some(line);
        }
        // the fullest line is the least loss
        let fullest = || (0..self.lines.len()).max_by_key(|&at| self.lines[at].len());
        (self.lines.iter().filter(|line| !line.is_empty()).count() > LINES).then(fullest).flatten()
    }

    /// The tests of a line, which is empty then.
    pub(crate) fn take(&mut self, line: usize) -> Vec<Own> {
        std::mem::take(&mut self.lines[line])
    }

    /// Room that is not needed any more.
    pub(crate) fn give_back(&mut self, own: Vec<Own>) {
        self.spare.extend(own);
    }
}
