//! θ, the parameters of the covariance of the data: free variances of noise first, then the elements of Σ of each level
//! that may move.

use std::sync::Arc;

use nalgebra::DMatrix;

use kalfit_estimate::{CovarianceMap, FinalState};

use crate::small_sample::effects::CrossedEffects;

/// An element σ_ij of the Σ of a level, by the states of a test; S = `unit` × (e_i e_j' + e_j e_i'), once for i = j, in
/// each block of the matrix that repeats Σ.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SigmaElement {
    pub(super) i: usize,
    pub(super) j: usize,
    /// Factor from the coordinates of the level to those of a test.
    pub(super) unit: f64,
    /// First row of each block with Σ: one for a level, one for each group of a crossed factor.
    pub(super) blocks: Arc<[usize]>,
}

impl SigmaElement {
    /// The positions (row, column) of the element.
    pub(super) fn positions(&self) -> impl Iterator<Item = (usize, usize)> + Clone {
        let (i, j) = (self.i, self.j);
        let of_block = move |&at: &usize| {
            let second = (i != j).then_some((at + j, at + i));
            std::iter::once((at + i, at + j)).chain(second)
        };
        self.blocks.iter().flat_map(of_block)
    }

    /// tr(SX).
    pub(super) fn trace(&self, x: &DMatrix<f64>) -> f64 {
        self.unit * self.positions().map(|(r, c)| x[(c, r)]).sum::<f64>()
    }

    /// tr(S X T Y) with T of another element; X and Y symmetric.
    pub(super) fn trace_with(&self, x: &DMatrix<f64>, other: &SigmaElement, y: &DMatrix<f64>) -> f64 {
        let of = |(r, s): (usize, usize)| other.positions().map(|(t, u)| x[(s, t)] * y[(u, r)]).sum::<f64>();
        self.unit * other.unit * self.positions().map(of).sum::<f64>()
    }

    /// Adds `factor` × S to a matrix.
    pub(super) fn add_to(&self, factor: f64, matrix: &mut DMatrix<f64>) {
        self.positions().for_each(|at| matrix[at] += factor * self.unit);
    }

    /// WSW.
    pub(super) fn within(&self, w: &DMatrix<f64>) -> DMatrix<f64> {
        let mut all = DMatrix::zeros(w.nrows(), w.ncols());
        self.positions().for_each(|(r, c)| all.ger(self.unit, &w.column(r), &w.column(c), 1.0));
        all
    }
}

/// The parameters θ in their order: `noises` variances, then the elements of each level, the level of the tests first and
/// all crossed factors together as the last.
#[derive(Debug, Clone)]
pub(super) struct Theta {
    pub(super) noises: usize,
    pub(super) levels: Vec<Vec<SigmaElement>>,
    /// Directions in which θ may move, θ × directions.
    pub(super) directions: DMatrix<f64>,
    /// Index of each element of θ after the variances among the elements of Σ.
    pub(super) elements: Vec<usize>,
}

impl Theta {
    /// θ at the end of a search; `None` where a standard deviation with given correlations is zero, as Σ is then not
    /// differentiable in the variance.
    pub(super) fn of(state: &FinalState, noises: usize, crossed: Option<&CrossedEffects>) -> Option<Theta> {
        let (problem, root) = (&state.problem, &state.newton_iterate.point.root);
        let map = &problem.covariance;
        let free = map.cone_directions(&map.chart(root));
        if free.columns().any(|column| column.iter().all(|(_, x)| *x == 0.0)) {
            return None;
        }
        let sizes = free.row_sizes();
        let scale = &problem.classes.frame.scale;
        let levels = levels(map, (problem.classes.units.is_some(), crossed), &sizes, scale);
        let elements: Vec<usize> = (0..sizes.len()).filter(|&k| sizes[k] > 0.0).collect();
        let (moving, columns) = (elements.len(), free.ncols());
        let mut directions = DMatrix::zeros(noises + moving, noises + columns);
        directions.view_mut((0, 0), (noises, noises)).fill_with_identity();
        for (c, column) in free.columns().enumerate() {
            for &(row, x) in column {
                if let Ok(place) = elements.binary_search(&row) {
                    directions[(noises + place, noises + c)] = x;
                }
            }
        }
        Some(Theta { noises, levels, directions, elements })
    }

    /// Number of parameters.
    pub(super) fn len(&self) -> usize {
        self.noises + self.levels.iter().map(Vec::len).sum::<usize>()
    }

    /// The index in θ of the first element of a level: all parameters before it move what the level is given.
    pub(super) fn first(&self, level: usize) -> usize {
        self.noises + self.levels[..level].iter().map(Vec::len).sum::<usize>()
    }
}

/// The moving elements of each level; without groups, one level with the states of all phases.
fn levels(
    map: &CovarianceMap,
    (grouped, crossed): (bool, Option<&CrossedEffects>),
    sizes: &[f64],
    scale: &[f64],
) -> Vec<Vec<SigmaElement>> {
    let blocks = map.elements.blocks();
    let nested = crossed.map_or(blocks.len(), |crossed| crossed.first_block());
    let last = if crossed.is_some() { nested + 1 } else { nested };
    let mut levels = vec![Vec::new(); if grouped { last } else { 1 }];
    let once: Arc<[usize]> = Arc::new([0]);
    for (_, (i, j)) in map.elements.all().enumerate().filter(|(k, _)| sizes[*k] > 0.0) {
        let (block, start) = match grouped {
            true => (map.elements.block_of(i), blocks[map.elements.block_of(i)].start),
            false => (0, 0),
        };
        let (own_i, own_j) = (i - start, j - start);
        let unit = scale[i] * scale[j] / (scale[own_i] * scale[own_j]);
        let repeated = crossed.and_then(|crossed| crossed.blocks_of(block));
        let places = repeated.unwrap_or_else(|| Arc::clone(&once));
        levels[block.min(nested)].push(SigmaElement { i: own_i, j: own_j, unit, blocks: places });
    }
    levels
}
