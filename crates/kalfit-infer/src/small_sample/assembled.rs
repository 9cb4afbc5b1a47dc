//! Small-sample inference put together: tests, units and θ from an estimate, then the laws of θ and of the mean.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use crate::small_sample::border::Border;
use crate::small_sample::differences::VarianceSlopes;
use crate::small_sample::effects::CrossedEffects;
use crate::small_sample::exported::user_theta;
use crate::small_sample::face::Face;
use crate::small_sample::forest::{Forest, Leaf};
use crate::small_sample::information::{self, MeanSums, ThetaLaw};
use crate::small_sample::mean_law::MeanLaw;
use crate::small_sample::pass::Pass;
use crate::small_sample::theta::Theta;
use crate::small_sample::{DfChoice, NoDf, SmallSample};
use kalfit_estimate::{Estimate, FinalState, Stop};
use kalfit_filter::reduce::Reductions;

/// Multiplications beyond which small-sample inference is left out.
const MOST_MULTIPLICATIONS: f64 = 1e10;

/// The laws at a maximum of the restricted likelihood, or why there are none.
pub(super) fn small_sample(
    estimate: &Estimate,
    reductions: &Reductions,
    choice: DfChoice,
    noise: &dyn Fn() -> Result<Option<VarianceSlopes>, NoDf>,
) -> Result<SmallSample, NoDf> {
    let state = &estimate.state;
    if estimate.stop != Stop::Certified {
        return Err(NoDf::NotCertified);
    }
    if reductions.remote().is_some() {
        return Err(NoDf::Remote);
    }
    if reductions.has_exact() {
        return Err(NoDf::Exact);
    }
    let noise = noise()?;
    let noises = noise.as_ref().map_or(0, VarianceSlopes::len);
    let p = state.structure().reduced_dimension();
    let effects = estimate.grouping().and_then(|grouping| CrossedEffects::of(grouping, p));
    let theta = Theta::of(state, noises, effects.as_ref()).ok_or(NoDf::ZeroDeviation)?;
    let moves = noise.as_ref().is_some_and(|noise| !noise.variances.linear);
    let roots = roots(state, p, effects.as_ref());
    let border = Border::of(&state.problem, p, effects, moves);
    let forest = forest(state, reductions, &border, noise.as_ref()).ok_or(NoDf::Parameters)?;
    if multiplications(&forest, &theta) > MOST_MULTIPLICATIONS {
        return Err(NoDf::Size);
    }
    let pass = Pass::of(&forest, &theta, &roots).ok_or(NoDf::NotFinite)?;
    let totals = pass.totals().ok_or(NoDf::NotFinite)?;
    let mean = MeanSums::of(&totals, pass.first_mean(), border.means());
    let law = law(&pass, &mean, (choice, moves))?;
    let (units, mean_map) = (state.problem.mean_units(), &state.problem.mean);
    let jacobian = mean_map.centring.uncentred(&mean_map.jacobian());
    let by_user = DMatrix::from_fn(jacobian.nrows(), jacobian.ncols(), |i, c| jacobian[(i, c)] * units[i]);
    let variances = noise.as_ref().map(|noise| &noise.variances);
    let face = Face::of(state, &theta, variances);
    let user_theta = user_theta(state, &theta, variances);
    let estimates = estimate.mean.iter().chain(&estimate.coefficients).copied();
    let estimates = DVector::from_iterator(jacobian.nrows(), estimates);
    Ok(SmallSample { law, face, from_user: by_user.transpose(), estimates, means: estimate.mean.len(), user_theta })
}

fn law(pass: &Pass<'_>, mean: &MeanSums, (choice, moves): (DfChoice, bool)) -> Result<MeanLaw, NoDf> {
    if moves {
        let information = information::observed(pass, mean).ok_or(NoDf::NotFinite)?;
        return Ok(MeanLaw::moving(mean, ThetaLaw::of(pass, &information).ok_or(NoDf::Parameters)?));
    }
    let information = information::expected(pass, mean).ok_or(NoDf::NotFinite)?;
    let theta = ThetaLaw::of(pass, &information).ok_or(NoDf::NotFinite)?;
    if choice == DfChoice::Satterthwaite {
        return Ok(MeanLaw::satterthwaite(mean, theta));
    }
    let bent = pass.contracted(&theta.covariance).ok_or(NoDf::NotFinite)?;
    let (first, q) = (pass.first_mean(), mean.covariance.nrows());
    Ok(MeanLaw::kenward_roger(mean, theta, &bent.view((first, first), (q, q)).into_owned()))
}

/// The tests, and the units that they form.
fn forest(
    state: &FinalState,
    reductions: &Reductions,
    border: &Border<'_>,
    noise: Option<&VarianceSlopes>,
) -> Option<Forest> {
    let plain = |j: usize| {
        let k = border.of_test(reductions, j)?;
        Some(Leaf { k, slopes: Vec::new(), curvatures: Vec::new(), log_curvatures: Vec::new() })
    };
    let leaves: Option<Vec<Leaf>> = match noise {
        None => (0..reductions.len()).map(plain).collect(),
        Some(noise) => (0..reductions.len()).map(|j| noise.leaf(border, reductions, j)).collect(),
    };
    let grouping = state.problem.classes.units.as_ref().map(|units| Arc::clone(&units.grouping));
    let numbers: Vec<usize> = match &grouping {
        Some(grouping) => (0..reductions.len()).map(|j| grouping.number(reductions.id(j))).collect::<Option<_>>()?,
        None => Vec::new(),
    };
    let forest = Forest::of(leaves?, grouping.as_deref().map(|grouping| (grouping, &numbers[..])));
    Some(Forest { crossed: border.effects(), ..forest })
}

/// F of each level, p × its columns that are not zero, then that of all effects of crossed factors.
fn roots(state: &FinalState, p: usize, effects: Option<&CrossedEffects>) -> Vec<DMatrix<f64>> {
    let (root, scale) = (&state.newton_iterate.point.root, &state.problem.classes.frame.scale);
    let levels = root.nrows() / p.max(1);
    let of = |level: usize| {
        let start = level * p;
        let own = root.rows(start, p);
        let columns: Vec<usize> = (0..root.ncols()).filter(|&c| own.column(c).iter().any(|x| *x != 0.0)).collect();
        DMatrix::from_fn(p, columns.len(), |i, c| own[(i, columns[c])] * scale[start + i] / scale[i])
    };
    let mut roots: Vec<DMatrix<f64>> = (0..levels).map(of).collect();
    if let Some(effects) = effects {
        let of_factors = roots.split_off(effects.first_block());
        roots.push(effects.root(&of_factors));
    }
    roots
}

/// Multiplications of all passes, roughly.
fn multiplications(forest: &Forest, theta: &Theta) -> f64 {
    let width = forest.width() as f64;
    let of_level = |level: usize| {
        let (below, own) = (theta.first(level) as f64, theta.levels[level].len() as f64);
        (own + below * (3.0 * width + below)) * width * width + 8.0 * own * (own + below)
    };
    let of_factors = if forest.crossed > 0 { of_level(forest.levels.len() + 1) } else { 0.0 };
    let of_levels = forest.evaluations().into_iter().enumerate().map(|(level, count)| count as f64 * of_level(level));
    of_levels.sum::<f64>() + of_factors
}
