//! The structure of Σ in η: Σ = FF' with F linear in the solver's coordinates ψ, and linear constraints on Σ.
//!
//! Every structure of the model file has this form. Within a block Σ_b = L_b L_b' with L_b lower triangular in a pivoted
//! order, so that a singular Σ shows as trailing columns that are zero; Σ = βΣ* is F = ψ root(Σ*); Σ = DRD is F = D root(R).
//! Fixed and equal elements that no such form gives are constraints Σ_ab coefficient σ_ab = value. Each phase has its own form;
//! between phases Σ is zero.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

use crate::estimate::classes::Frame;
use crate::estimate::linear::Linear;
use crate::estimate::structure::Structure;
use crate::linalg::elements::Elements;
use crate::linalg::symmetric::{self, pairs};
use crate::model::{Alpha, CovarianceKind, CovarianceStructure, Expression, Scope, StructureError};

/// How the Σ of a phase is built from coordinates. Matrices are those of the phase, states are counted over all phases.
#[derive(Debug, Clone)]
pub(crate) enum Form {
    /// Blocks Σ_b = L_b L_b'.
    Factor(Vec<Vec<usize>>),
    /// Σ = ψ² root root'.
    Scale(DMatrix<f64>),
    /// Σ = D root root' D, D = diag(ψ) over these states.
    StdDevs(DMatrix<f64>, Vec<usize>),
    /// Σ is this.
    Fixed(DMatrix<f64>),
}

/// The structure of the Σ of one phase, in η.
#[derive(Debug, Clone)]
pub(crate) struct Part {
    /// Its states.
    pub(crate) states: Range<usize>,
    pub(crate) form: Form,
    /// Its members are those of a linear covariance structure.
    pub(crate) linear: bool,
    /// Start value from the model.
    pub(crate) start: Option<DMatrix<f64>>,
}

/// Σ coefficient × σ_pair = value.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Constraint {
    pub(crate) terms: Vec<(usize, usize, f64)>,
    pub(crate) value: f64,
}

/// The structure of Σ, in η.
#[derive(Debug, Clone)]
pub(crate) struct CovarianceMap {
    pub(crate) p: usize,
    /// By phase.
    pub(crate) parts: Vec<Part>,
    pub(crate) constraints: Vec<Constraint>,
    /// States whose variance is not held at zero.
    pub(crate) random: Vec<usize>,
    pub(crate) elements: Elements,
}

impl CovarianceMap {
    pub(crate) fn new(structure: &Structure<'_>, frame: &Frame) -> Result<CovarianceMap, StructureError> {
        let ranges = structure.ranges();
        let elements = Elements::new(ranges.clone());
        let mut all = CovarianceMap {
            p: elements.states(),
            parts: Vec::new(),
            constraints: Vec::new(),
            random: Vec::new(),
            elements,
        };
        for (phase, range) in structure.phases.iter().zip(ranges) {
            let own = CovarianceMap::of_phase(phase.covariance, structure.alpha, &frame.part(&range))?;
            all.append(own, range.start);
        }
        Ok(all)
    }

    /// Takes in the structure of a phase whose states begin at `start`.
    fn append(&mut self, phase: CovarianceMap, start: usize) {
        self.parts.extend(phase.parts.into_iter().map(|part| part.moved(start as isize)));
        self.random.extend(phase.random.iter().map(|i| start + i));
        self.constraints.extend(phase.constraints.iter().map(|c| c.moved(start as isize)));
    }

    /// The structure of one phase by itself.
    pub(crate) fn of_part(&self, part: &Part) -> CovarianceMap {
        let states = &part.states;
        let back = -(states.start as isize);
        let own = |c: &&Constraint| c.terms.iter().all(|(i, _, _)| states.contains(i));
        CovarianceMap {
            p: states.len(),
            parts: vec![part.moved(back)],
            constraints: self.constraints.iter().filter(own).map(|c| c.moved(back)).collect(),
            random: self.random.iter().filter(|i| states.contains(i)).map(|i| i - states.start).collect(),
            elements: Elements::single(states.len()),
        }
    }

    /// Blocks Σ_b = L_b L_b' of all phases that have such.
    pub(crate) fn blocks(&self) -> impl Iterator<Item = &Vec<usize>> {
        self.parts.iter().flat_map(|part| match &part.form {
            Form::Factor(blocks) => blocks.as_slice(),
            _ => &[],
        })
    }

    /// The form of the Σ that a state has part in.
    pub(crate) fn form_of(&self, state: usize) -> &Form {
        &self.parts[self.elements.block_of(state)].form
    }

    /// A matrix with these blocks, one for each phase.
    pub(crate) fn assembled(&self, parts: impl IntoIterator<Item = DMatrix<f64>>) -> DMatrix<f64> {
        let mut whole = DMatrix::zeros(self.p, self.p);
        for (part, own) in self.parts.iter().zip(parts) {
            let start = part.states.start;
            whole.view_mut((start, start), own.shape()).copy_from(&own);
        }
        whole
    }

    fn of_phase(
        structure: &CovarianceStructure,
        alpha: &Alpha,
        frame: &Frame,
    ) -> Result<CovarianceMap, StructureError> {
        let p = frame.scale.len();
        let zero = zero_variances(structure, p);
        let linear = match &structure.kind {
            CovarianceKind::Linear { constant, generators } => {
                Some(Linear::new(structure, constant, generators, frame)?)
            }
            _ => None,
        };
        let random: Vec<usize> = match &linear {
            Some(linear) => linear.random(),
            None => (0..p).filter(|&i| !zero[i]).collect(),
        };
        let numbers = |entries: &[Vec<Expression>], what| matrix(entries, alpha, what);
        let form = match &structure.kind {
            CovarianceKind::Full | CovarianceKind::Linear { .. } => Form::Factor(vec![random.clone()]),
            CovarianceKind::Diagonal => Form::Factor(random.iter().map(|&i| vec![i]).collect()),
            CovarianceKind::Blocks(blocks) => Form::Factor(restrict(blocks, &zero)),
            CovarianceKind::Proportional(entries) => {
                let sigma = frame.covariance_in(&numbers(entries, "the matrix of the proportional covariance")?);
                Form::Scale(symmetric::square_root(&sigma))
            }
            CovarianceKind::Correlation(entries) => {
                let root = symmetric::square_root(&numbers(entries, "the correlation matrix")?);
                Form::StdDevs(root, random.clone())
            }
            CovarianceKind::Fixed(entries) => {
                Form::Fixed(frame.covariance_in(&numbers(entries, "the fixed covariance")?))
            }
        };
        let form = match form {
            Form::Factor(blocks) => Form::Factor(split(blocks, &|i, j| match &linear {
                Some(linear) => linear.is_zero(i, j),
                None => is_fixed_zero(structure, i, j),
            })),
            other => other,
        };
        let start = structure.start.as_ref().map(|start| frame.covariance_in(start));
        let part = Part { states: 0..p, form, linear: linear.is_some(), start };
        let elements = Elements::single(p);
        let mut map = CovarianceMap { p, parts: vec![part], constraints: Vec::new(), random, elements };
        map.constraints = match &linear {
            Some(linear) => linear.constraints(&map)?,
            None => constraints(structure, frame, &map),
        };
        Ok(map)
    }

    /// Whether element (i, j) is zero because of the form.
    pub(crate) fn is_structural_zero(&self, i: usize, j: usize) -> bool {
        match self.form_of(i) {
            _ if self.elements.get(i, j).is_none() => true,
            Form::Factor(blocks) => !blocks.iter().any(|b| b.contains(&i) && b.contains(&j)),
            _ => !(self.random.contains(&i) && self.random.contains(&j)),
        }
    }

    /// Sets what the form makes zero to zero.
    pub(crate) fn mask(&self, sigma: &DMatrix<f64>) -> DMatrix<f64> {
        DMatrix::from_fn(self.p, self.p, |i, j| if self.is_structural_zero(i, j) { 0.0 } else { sigma[(i, j)] })
    }

    /// Values of the constraints' left sides minus their right sides.
    pub(crate) fn residual(&self, sigma: &DMatrix<f64>) -> DVector<f64> {
        let left = |c: &Constraint| c.terms.iter().map(|&(i, j, x)| x * sigma[(i, j)]).sum::<f64>();
        DVector::from_iterator(self.constraints.len(), self.constraints.iter().map(|c| left(c) - c.value))
    }

    /// The largest residual beside the elements that it is about: a large variance elsewhere excuses nothing.
    pub(crate) fn relative_residual(&self, sigma: &DMatrix<f64>, residual: &DVector<f64>) -> f64 {
        let size = |c: &Constraint| {
            let spread = |i: usize, j: usize| (sigma[(i, i)] * sigma[(j, j)]).max(0.0).sqrt();
            c.value.abs() + c.terms.iter().map(|&(i, j, x)| x.abs() * spread(i, j)).sum::<f64>()
        };
        let relative = self.constraints.iter().zip(residual.iter()).map(|(c, r)| r.abs() / (1.0 + size(c)));
        relative.fold(0.0, f64::max)
    }

    /// Number of free covariance quantities, as declared.
    pub(crate) fn declared(&self) -> usize {
        let of_form = |part: &Part| match &part.form {
            Form::Factor(blocks) => blocks.iter().map(|b| pairs(b.len())).sum(),
            Form::Scale(_) => 1,
            Form::StdDevs(_, states) => states.len(),
            Form::Fixed(_) => 0,
        };
        self.parts.iter().map(of_form).sum::<usize>() - self.constraints.len()
    }

    /// Directions in which Σ may move, elements × directions: the free elements where Σ is linear in them, else along ψ.
    pub(crate) fn free_directions(&self, chart: &Chart) -> DMatrix<f64> {
        self.directions(chart, false)
    }

    /// The same, where Σ = βΣ* along β: dΣ/dψ vanishes at Σ = 0, and yet β > 0 is a direction.
    pub(crate) fn cone_directions(&self, chart: &Chart) -> DMatrix<f64> {
        self.directions(chart, true)
    }

    fn directions(&self, chart: &Chart, by_scale: bool) -> DMatrix<f64> {
        let count = self.elements.count();
        let along = chart.jacobian_at(&chart.root);
        let mut columns: Vec<DVector<f64>> = Vec::new();
        for part in &self.parts {
            if let (true, Form::Scale(star)) = (by_scale, &part.form) {
                let star = part.placed(&(star * star.transpose()), self.p);
                columns.push(DVector::from_iterator(count, self.elements.all().map(|at| star[at])));
            } else if let Form::Factor(_) = part.form {
                let own = |&&(i, j): &&(usize, usize)| part.states.contains(&i) && !self.is_structural_zero(i, j);
                let all: Vec<(usize, usize)> = self.elements.all().collect();
                let unit = |&(i, j): &(usize, usize)| {
                    let mut unit = DVector::zeros(count);
                    unit[self.elements.index(i, j)] = 1.0;
                    unit
                };
                columns.extend(all.iter().filter(own).map(unit));
            } else {
                let own = |k: &usize| chart.coordinates[*k].iter().any(|(i, _, _)| part.states.contains(i));
                columns.extend((0..chart.coordinates.len()).filter(own).map(|k| along.column(k).clone_owned()));
            }
        }
        let all = match columns.is_empty() {
            true => DMatrix::zeros(count, 0),
            false => DMatrix::from_columns(&columns),
        };
        if self.constraints.is_empty() {
            return all;
        }
        let normals = crate::estimate::local::normals(&self.constraints, &self.elements) * &all;
        let (values, vectors) = symmetric::eigen(&(normals.transpose() * &normals));
        let null: Vec<usize> = (0..values.len()).filter(|&k| values[k] < 1e-12).collect();
        all * vectors.select_columns(&null)
    }

    /// Coordinates ψ near Σ = FF', as derivatives of F.
    pub(crate) fn chart(&self, root: &DMatrix<f64>) -> Chart {
        let elements = self.elements.clone();
        let mut chart = Chart { root: root.clone(), coordinates: Vec::new(), bounded: Vec::new(), elements };
        for part in &self.parts {
            let (start, end) = (part.states.start, part.states.end);
            match &part.form {
                Form::Factor(blocks) => factor_chart(blocks, root, &part.states, &mut chart),
                Form::Scale(star) => {
                    let entries = (start..end).flat_map(|i| (start..end).map(move |c| (i, c)));
                    let entries = entries.map(|(i, c)| (i, c, star[(i - start, c - start)])).collect();
                    chart.coordinates.push(entries);
                    chart.bounded.push(None);
                }
                Form::StdDevs(correlation, states) => {
                    for &i in states {
                        let row = (start..end).map(|c| (i, c, correlation[(i - start, c - start)])).collect();
                        chart.coordinates.push(row);
                        let own = root.view((start, start), (end - start, end - start)).clone_owned();
                        chart.bounded.push(Some(std_dev(&own, correlation, i - start)));
                    }
                }
                Form::Fixed(_) => {}
            }
        }
        chart
    }

    /// A root F of the structure's own shape from any Σ that is nearly of the structure.
    pub(crate) fn root_of(&self, sigma: &DMatrix<f64>) -> DMatrix<f64> {
        let mut root = DMatrix::zeros(self.p, self.p);
        for part in &self.parts {
            let start = part.states.start;
            let mut whole = |own: DMatrix<f64>| root.view_mut((start, start), own.shape()).copy_from(&own);
            match &part.form {
                Form::Factor(blocks) => {
                    for block in blocks {
                        let own = symmetric::square_root(&sub(sigma, block));
                        place(&mut root, block, &own);
                    }
                }
                Form::Scale(star) => {
                    let star_trace: f64 = star.norm_squared();
                    let trace: f64 = part.states.clone().map(|i| sigma[(i, i)]).sum();
                    whole(star * (trace.max(0.0) / star_trace.max(f64::MIN_POSITIVE)).sqrt());
                }
                Form::StdDevs(correlation, states) => {
                    let sd = |i| if states.contains(&i) { sigma[(i, i)].max(0.0).sqrt() } else { 0.0 };
                    let n = part.states.len();
                    whole(DMatrix::from_fn(n, n, |i, c| sd(start + i) * correlation[(i, c)]));
                }
                Form::Fixed(known) => whole(symmetric::square_root(known)),
            }
        }
        root
    }
}

impl Part {
    /// Its block of a matrix.
    pub(crate) fn of(&self, matrix: &DMatrix<f64>) -> DMatrix<f64> {
        let (start, n) = (self.states.start, self.states.len());
        matrix.view((start, start), (n, n)).clone_owned()
    }

    /// A matrix of its own in the place of its block, zero elsewhere.
    pub(crate) fn placed(&self, own: &DMatrix<f64>, p: usize) -> DMatrix<f64> {
        let mut whole = DMatrix::zeros(p, p);
        whole.view_mut((self.states.start, self.states.start), own.shape()).copy_from(own);
        whole
    }

    /// The same for states that are counted from elsewhere.
    fn moved(&self, by: isize) -> Part {
        let at = |i: usize| i.strict_add_signed(by);
        let form = match &self.form {
            Form::Factor(blocks) => {
                Form::Factor(blocks.iter().map(|block| block.iter().map(|&i| at(i)).collect()).collect())
            }
            Form::StdDevs(root, states) => Form::StdDevs(root.clone(), states.iter().map(|&i| at(i)).collect()),
            other => other.clone(),
        };
        Part { states: at(self.states.start)..at(self.states.end), form, ..self.clone() }
    }
}

impl Constraint {
    fn moved(&self, by: isize) -> Constraint {
        let at = |i: usize| i.strict_add_signed(by);
        Constraint { terms: self.terms.iter().map(|&(i, j, x)| (at(i), at(j), x)).collect(), ..self.clone() }
    }
}

/// ψ_i of row i of DR^½, with its sign: a standard deviation that rounding made negative counts as zero.
fn std_dev(root: &DMatrix<f64>, correlation: &DMatrix<f64>, i: usize) -> f64 {
    let unit = correlation.row(i).norm_squared();
    if unit > 0.0 { (root.row(i).dot(&correlation.row(i)) / unit).max(0.0) } else { 0.0 }
}

/// Coordinates ψ around a root F: F(ψ + s) = F + Σ s_k F_k, each F_k given by its entries (row, column, value).
#[derive(Debug, Clone)]
pub(crate) struct Chart {
    pub(crate) root: DMatrix<f64>,
    pub(crate) coordinates: Vec<Vec<(usize, usize, f64)>>,
    /// Values of coordinates that cannot be negative (standard deviations); `None` for others.
    pub(crate) bounded: Vec<Option<f64>>,
    /// The elements of Σ.
    pub(crate) elements: Elements,
}

impl Chart {
    /// dσ_pair / dψ, elements × coordinates, at a root that may have moved on from this chart's.
    pub(crate) fn jacobian_at(&self, root: &DMatrix<f64>) -> DMatrix<f64> {
        let elements = &self.elements;
        let mut jacobian = DMatrix::zeros(elements.count(), self.coordinates.len());
        for (k, entries) in self.coordinates.iter().enumerate() {
            for &(i, c, x) in entries {
                for j in elements.blocks()[elements.block_of(i)].clone() {
                    jacobian[(elements.index(i, j), k)] += x * root[(j, c)] * if i == j { 2.0 } else { 1.0 };
                }
            }
        }
        jacobian
    }

    /// tr(G ∂²Σ/∂ψ_k∂ψ_l) = 2 tr(G F_k F_l'), coordinates × coordinates.
    pub(crate) fn second_order(&self, score: &DMatrix<f64>) -> DMatrix<f64> {
        let n = self.coordinates.len();
        DMatrix::from_fn(n, n, |k, l| {
            let mut sum = 0.0;
            for &(i, c, x) in &self.coordinates[k] {
                for &(j, d, y) in &self.coordinates[l] {
                    if c == d {
                        sum += score[(i, j)] * x * y;
                    }
                }
            }
            2.0 * sum
        })
    }

    /// F after a step in ψ; bounded coordinates stop at zero.
    pub(crate) fn moved(&self, step: &[f64]) -> DMatrix<f64> {
        let mut root = self.root.clone();
        for (k, entries) in self.coordinates.iter().enumerate() {
            for &(i, c, x) in entries {
                match self.bounded[k] {
                    // written anew, so that zero is exactly zero and no rounding goes below
                    Some(value) => root[(i, c)] = (value + step[k]).max(0.0) * x,
                    None => root[(i, c)] += step[k] * x,
                }
            }
        }
        root
    }
}

/// Lower-triangular coordinates in a pivoted order, after turning F (which leaves FF' alone) into that shape.
fn factor_chart(blocks: &[Vec<usize>], root: &DMatrix<f64>, states: &Range<usize>, chart: &mut Chart) {
    let (start, p) = (states.start, states.len());
    chart.root.view_mut((start, start), (p, p)).fill(0.0);
    for block in blocks {
        let own = DMatrix::from_fn(block.len(), p, |i, c| root[(block[i], start + c)]);
        let order = pivot_order(&own);
        let rows = DMatrix::from_fn(own.ncols(), own.nrows(), |c, i| own[(order[i], c)]);
        let upper = rows.qr().r(); // own[order] = (QR)' so that own own' = R'R in that order
        for (place, &i) in order.iter().enumerate() {
            for c in 0..=place {
                let value = if c < upper.nrows() { upper[(c, place)] } else { 0.0 };
                chart.root[(block[i], block[c])] = value;
                chart.coordinates.push(vec![(block[i], block[c], 1.0)]);
                chart.bounded.push(None);
            }
        }
    }
}

/// Rows in the order of a Cholesky decomposition with pivoting: largest remaining norm first.
fn pivot_order(rows: &DMatrix<f64>) -> Vec<usize> {
    let mut left = rows.clone();
    let mut order: Vec<usize> = Vec::new();
    while order.len() < rows.nrows() {
        let norm = |i: &usize| left.row(*i).norm_squared();
        let rest = (0..rows.nrows()).filter(|i| !order.contains(i));
        let next = rest.max_by(|a, b| norm(a).total_cmp(&norm(b)).then(b.cmp(a))).expect("a row remains");
        order.push(next);
        let pivot = left.row(next).clone_owned();
        let size = pivot.norm_squared();
        if size > 0.0 {
            for i in 0..left.nrows() {
                let along = left.row(i).dot(&pivot) / size;
                let reduced = left.row(i) - &pivot * along;
                left.set_row(i, &reduced);
            }
        }
    }
    order
}

pub(crate) fn zero_variances(structure: &CovarianceStructure, p: usize) -> Vec<bool> {
    let mut zero = vec![false; p];
    for element in &structure.fixed {
        if element.i == element.j && element.value == 0.0 {
            zero[element.i] = true;
        }
    }
    zero
}

/// Evaluates a matrix of expressions in parameters, and checks that it is positive semidefinite.
fn matrix(entries: &[Vec<Expression>], alpha: &Alpha, what: &str) -> Result<DMatrix<f64>, StructureError> {
    let p = entries.len();
    let scope = Scope { numbers: &[], texts: &[], step: 0.0, alpha };
    let mut values = DMatrix::zeros(p, p);
    for i in 0..p {
        for j in 0..p {
            values[(i, j)] = entries[i][j].evaluate(&scope).map_err(|source| StructureError::Entry {
                what: what.to_owned(),
                row: i,
                column: j,
                source,
            })?;
        }
    }
    if !symmetric::is_semidefinite(&values) {
        let (values, _) = symmetric::eigen(&values);
        let (least, largest) = (values[0], values[p - 1]);
        return Err(StructureError::NotSemidefinite { what: what.to_owned(), least, largest });
    }
    Ok(values)
}

fn restrict(blocks: &[Vec<usize>], zero: &[bool]) -> Vec<Vec<usize>> {
    let kept = blocks.iter().map(|b| b.iter().copied().filter(|&i| !zero[i]).collect::<Vec<_>>());
    kept.filter(|b| !b.is_empty()).collect()
}

fn is_fixed_zero(structure: &CovarianceStructure, i: usize, j: usize) -> bool {
    structure.fixed.iter().any(|e| e.value == 0.0 && (e.i, e.j) == (i.max(j), i.min(j)) && i != j)
}

/// Splits blocks into the connected components that zeros leave.
fn split(blocks: Vec<Vec<usize>>, is_zero: &dyn Fn(usize, usize) -> bool) -> Vec<Vec<usize>> {
    let mut result = Vec::new();
    for block in blocks {
        let mut left = block;
        while !left.is_empty() {
            let mut component = vec![left.remove(0)];
            let mut at = 0;
            while at < component.len() {
                let from = component[at];
                let (joined, rest): (Vec<usize>, Vec<usize>) = left.iter().partition(|&&j| !is_zero(from, j));
                component.extend(joined);
                left = rest;
                at += 1;
            }
            component.sort_unstable();
            result.push(component);
        }
    }
    result
}

/// Fixed and equal elements that the form does not give by itself, in η, scaled to coefficients of order one.
fn constraints(structure: &CovarianceStructure, frame: &Frame, map: &CovarianceMap) -> Vec<Constraint> {
    if !matches!(map.parts[0].form, Form::Factor(_)) {
        return Vec::new();
    }
    let unit = |i: usize, j: usize| frame.scale[i] * frame.scale[j];
    let free = |i: usize, j: usize| !map.is_structural_zero(i, j);
    let mut constraints = Vec::new();
    for element in structure.fixed.iter().filter(|e| free(e.i, e.j)) {
        let value = element.value / unit(element.i, element.j);
        constraints.push(Constraint { terms: vec![(element.i, element.j, 1.0)], value });
    }
    for group in &structure.equal {
        let (i, j) = group[0];
        for &(k, l) in &group[1..] {
            let size = unit(i, j).max(unit(k, l));
            let terms = vec![(i, j, unit(i, j) / size), (k, l, -unit(k, l) / size)];
            constraints.push(Constraint { terms, value: 0.0 });
        }
    }
    constraints
}

/// The rows and columns of a block.
pub(crate) fn sub(matrix: &DMatrix<f64>, block: &[usize]) -> DMatrix<f64> {
    DMatrix::from_fn(block.len(), block.len(), |i, j| matrix[(block[i], block[j])])
}

/// Writes a block's matrix into its rows and columns.
pub(crate) fn place(into: &mut DMatrix<f64>, block: &[usize], own: &DMatrix<f64>) {
    for i in 0..block.len() {
        for j in 0..block.len() {
            into[(block[i], block[j])] = own[(i, j)];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_standard_deviation_stops_at_exactly_zero() {
        let correlation = DMatrix::from_row_slice(1, 3, &[0.1_f64.sqrt(), 0.3_f64.sqrt(), 0.6_f64.sqrt()]);
        let entries: Vec<_> = (0..3).map(|c| (0, c, correlation[(0, c)])).collect();
        let chart = Chart {
            root: &correlation * 0.3,
            coordinates: vec![entries],
            bounded: vec![Some(std_dev(&(&correlation * 0.3), &correlation, 0))],
            elements: Elements::single(1),
        };
        assert_eq!(chart.moved(&[-5.0]), DMatrix::zeros(1, 3));
        let below = std_dev(&(&correlation * -1e-17), &correlation, 0);
        assert_eq!(below, 0.0, "a standard deviation below zero would turn the signs of the correlations");
    }
}
