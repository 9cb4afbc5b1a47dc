//! Standard errors, degrees of freedom and tests of combinations l'β of the mean (14.7)-(14.10).

use nalgebra::{DMatrix, DVector};

use crate::small_sample::information::{MeanSums, ThetaLaw};
use crate::small_sample::student::{chi_square_tail, student_quantile, two_sided, upper_tail};
use crate::small_sample::{DfMethod, JointTest, MeanTest, NoJointTest};

/// Part of l in directions of the mean that no test informs, beyond which l has no standard error.
const MAX_OPEN: f64 = 1e-9;
/// Eigenvalues of LCL', scaled to unit diagonal, below this one: the rows of L depend on each other.
const DEPENDENT: f64 = 1e-11;

/// The laws of β̂ and of the estimated θ: C, C_A, C M_a C and V.
#[derive(Debug, Clone)]
pub(super) struct MeanLaw {
    pub(super) method: DfMethod,
    /// C with what the estimates of θ add where the method says so, q × q.
    pub(super) plain: DMatrix<f64>,
    /// C_A of Kenward and Roger, or `plain`.
    pub(super) adjusted: DMatrix<f64>,
    /// C at known θ.
    pub(super) covariance: DMatrix<f64>,
    /// C M_a C of each θ.
    pub(super) slopes: Vec<DMatrix<f64>>,
    pub(super) open: DMatrix<f64>,
    pub(super) theta: ThetaLaw,
}

impl MeanLaw {
    /// `bent` = Σ V_ab M_ab over the coordinates of the mean, by Kenward and Roger.
    pub(super) fn kenward_roger(mean: &MeanSums, theta: ThetaLaw, bent: &DMatrix<f64>) -> MeanLaw {
        let c = &mean.covariance;
        let mut sum = bent * 0.5;
        for (a, slope) in mean.slopes.iter().enumerate() {
            let mut along = DMatrix::zeros(c.nrows(), c.ncols());
            mean.slopes.iter().enumerate().for_each(|(b, other)| along += other * theta.covariance[(a, b)]);
            sum -= slope * c * along;
        }
        let added = c * sum * c;
        let adjusted = c + &added + added.transpose();
        MeanLaw { adjusted, method: DfMethod::KenwardRoger, ..MeanLaw::satterthwaite(mean, theta) }
    }

    /// The law with C itself.
    pub(super) fn satterthwaite(mean: &MeanSums, theta: ThetaLaw) -> MeanLaw {
        let c = &mean.covariance;
        MeanLaw {
            method: DfMethod::Satterthwaite,
            plain: c.clone(),
            adjusted: c.clone(),
            covariance: c.clone(),
            slopes: mean.slopes.iter().map(|slope| c * slope * c).collect(),
            open: mean.open.clone(),
            theta,
        }
    }

    /// The law where θ moves β̂: C + Σ V_ab (Cu_a)(Cu_b)'.
    pub(super) fn moving(mean: &MeanSums, theta: ThetaLaw) -> MeanLaw {
        let mut law = MeanLaw::satterthwaite(mean, theta);
        let moves: Vec<DVector<f64>> = mean.moves.iter().map(|u| &mean.covariance * u).collect();
        for (a, own) in moves.iter().enumerate() {
            for (b, other) in moves.iter().enumerate() {
                law.adjusted.ger(law.theta.covariance[(a, b)], own, other, 1.0);
            }
        }
        law
    }

    /// Whether tests inform l.
    fn informs(&self, l: &DVector<f64>) -> bool {
        (self.open.transpose() * l).amax() <= MAX_OPEN * l.amax() && l.amax() > 0.0
    }

    /// The derivatives g of c = l'Cl by θ: g_a = -l'C M_a C l.
    pub(super) fn slopes_of(&self, l: &DVector<f64>) -> DVector<f64> {
        DVector::from_iterator(self.slopes.len(), self.slopes.iter().map(|slope| -l.dot(&(slope * l))))
    }

    /// ν = 2c²/(g'Vg); infinite where g'Vg is zero.
    pub(super) fn freedom(&self, l: &DVector<f64>) -> Option<f64> {
        let c = l.dot(&(&self.covariance * l));
        let variance = self.theta.variance(&self.slopes_of(l))?;
        let freedom = 2.0 * c * c / variance;
        (c > 0.0 && !freedom.is_nan() && freedom > 0.0).then_some(freedom)
    }

    /// The t test of l'β = 0, and the interval of l'β, given l'β̂ with all constants: `value`.
    pub(super) fn row(&self, l: &DVector<f64>, value: f64) -> Option<MeanTest> {
        if !self.informs(l) {
            return None;
        }
        let error = |c: &DMatrix<f64>| Some(l.dot(&(c * l)).sqrt()).filter(|e| e.is_finite() && *e > 0.0);
        let (std_error, plain) = (error(&self.adjusted)?, error(&self.plain)?);
        let freedom = self.freedom(l)?;
        let half = student_quantile(freedom, 0.975)? * std_error;
        let statistic = value / std_error;
        Some(MeanTest {
            std_error,
            std_error_plain: plain,
            df: Some(freedom).filter(|df| df.is_finite()),
            df_face: None,
            statistic,
            p_value: two_sided(statistic, freedom)?,
            interval: [value - half, value + half],
        })
    }

    /// The F test of Lβ̂ - b = `distance` (rows of L are those of `l`).
    pub(super) fn joint(&self, l: &DMatrix<f64>, distance: &DVector<f64>) -> Result<JointTest, NoJointTest> {
        let k = l.nrows();
        if l.row_iter().any(|row| !self.informs(&row.transpose())) {
            return Err(NoJointTest::Unidentified);
        }
        let plain = l * &self.covariance * l.transpose();
        if kalfit_algebra::symmetric::scaled_range(&plain).0 < DEPENDENT {
            return Err(NoJointTest::Dependent);
        }
        match (self.method, k) {
            (_, 1) => self.single(&l.row(0).transpose(), distance[0]),
            (DfMethod::KenwardRoger, _) => self.kenward_roger_joint(l, &plain, distance),
            (DfMethod::Satterthwaite, _) => self.fai_cornelius(l, distance),
        }
    }

    fn single(&self, l: &DVector<f64>, distance: f64) -> Result<JointTest, NoJointTest> {
        let row = self.row(l, distance).ok_or(NoJointTest::Unidentified)?;
        let value = row.statistic * row.statistic;
        Ok(JointTest { value, df_num: 1, df_den: row.df, scale: 1.0, p_value: row.p_value, method: self.method })
    }

    /// (14.9)
    fn kenward_roger_joint(
        &self,
        l: &DMatrix<f64>,
        plain: &DMatrix<f64>,
        distance: &DVector<f64>,
    ) -> Result<JointTest, NoJointTest> {
        let k = l.nrows() as f64;
        let inverse = plain.clone().cholesky().ok_or(NoJointTest::Dependent)?.inverse();
        let theta = l.transpose() * inverse * l;
        let turned: Vec<DMatrix<f64>> = self.slopes.iter().map(|slope| &theta * slope).collect();
        let traces = DVector::from_iterator(turned.len(), turned.iter().map(|one| one.trace()));
        let first = self.theta.variance(&traces).ok_or(NoJointTest::Unidentified)?;
        let mut second = 0.0;
        for (a, own) in turned.iter().enumerate() {
            let other =
                |(b, other): (usize, &DMatrix<f64>)| self.theta.covariance[(a, b)] * own.dot(&other.transpose());
            second += turned.iter().enumerate().map(other).sum::<f64>();
        }
        let wald = self.wald(l, distance)? / k;
        if second <= 0.0 {
            let p = chi_square_tail(wald * k, l.nrows());
            let found =
                JointTest { value: wald, df_num: l.nrows(), df_den: None, scale: 1.0, p_value: p, method: self.method };
            return Ok(found);
        }
        let b = (first + 6.0 * second) / (2.0 * k);
        let g = ((k + 1.0) * first - (k + 4.0) * second) / ((k + 2.0) * second);
        let d = 3.0 * k + 2.0 * (1.0 - g);
        let (c1, c2, c3) = (g / d, (k - g) / d, (k + 2.0 - g) / d);
        let mean = 1.0 / (1.0 - second / k);
        let variance = 2.0 / k * (1.0 + c1 * b) / ((1.0 - c2 * b).powi(2) * (1.0 - c3 * b));
        let m = 4.0 + (k + 2.0) / (k * variance / (2.0 * mean * mean) - 1.0);
        if !(second < k && m.is_finite() && m > 2.0) {
            return Err(NoJointTest::TooFew);
        }
        let scale = m / (mean * (m - 2.0));
        let value = scale * wald;
        let p_value = upper_tail(value, k, m).ok_or(NoJointTest::TooFew)?;
        Ok(JointTest { value, df_num: l.nrows(), df_den: Some(m), scale, p_value, method: self.method })
    }

    /// (Lβ̂ - b)'(LC_AL')⁻¹(Lβ̂ - b).
    fn wald(&self, l: &DMatrix<f64>, distance: &DVector<f64>) -> Result<f64, NoJointTest> {
        let covariance = l * &self.adjusted * l.transpose();
        let factor = covariance.cholesky().ok_or(NoJointTest::TooFew)?;
        Ok(distance.dot(&factor.solve(distance)))
    }

    /// (14.10)
    fn fai_cornelius(&self, l: &DMatrix<f64>, distance: &DVector<f64>) -> Result<JointTest, NoJointTest> {
        let k = l.nrows();
        let (values, vectors) = kalfit_algebra::symmetric::eigen(&(l * &self.adjusted * l.transpose()));
        let (mut sum, mut expected, mut least) = (0.0, 0.0, f64::INFINITY);
        for (c, &value) in values.iter().enumerate() {
            let own = l.transpose() * vectors.column(c);
            let freedom = self.freedom(&own).ok_or(NoJointTest::Unidentified)?;
            sum += vectors.column(c).dot(distance).powi(2) / value;
            expected += if freedom.is_finite() { freedom / (freedom - 2.0) } else { 1.0 };
            least = least.min(freedom);
        }
        let rows = k as f64;
        let m = if least <= 2.0 { 2.0 } else { 2.0 * expected / (expected - rows) };
        let value = sum / rows;
        let (df_den, p_value) = match m.is_finite() {
            true => (Some(m), upper_tail(value, rows, m)),
            false => (None, Some(chi_square_tail(sum, k))),
        };
        let p_value = p_value.ok_or(NoJointTest::TooFew)?;
        Ok(JointTest { value, df_num: k, df_den, scale: 1.0, p_value, method: self.method })
    }
}
