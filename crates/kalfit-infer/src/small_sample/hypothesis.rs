//! The F test of a hypothesis on means: the combinations of means that the hypothesis fixes within a model.

use nalgebra::{DMatrix, DVector};

use crate::ratio::regressions;
use crate::small_sample::{JointTest, NoJointTest, SmallSample};
use kalfit_algebra::symmetric;
use kalfit_estimate::Estimate;

impl SmallSample {
    /// The F test of a hypothesis about the mean alone; `own` is the estimate of this inference and `null` a fit, by any
    /// criterion, of the hypothesis, whose means lie within those of the model.
    ///
    /// # Errors
    /// Why there is no such test.
    pub fn f_test(&self, own: &Estimate, null: &Estimate) -> Result<JointTest, NoJointTest> {
        let (outer, inner) = (&own.state.problem, &null.state.problem);
        let places = regressions(&null.state.structure(), &own.state.structure()).ok_or(NoJointTest::Unidentified)?;
        let (frame, other) = (&outer.classes.frame, &inner.classes.frame);
        let p = frame.scale.len();
        if other.scale.len() != p {
            return Err(NoJointTest::Unidentified);
        }
        // the means of the hypothesis in the coordinates of the model: a point, and directions
        let (a, fixed) = (outer.mean.jacobian(), inner.mean.basis.ncols());
        let ratio = |i: usize| other.scale[i] / frame.scale[i];
        let mut directions = DMatrix::zeros(a.nrows(), fixed + places.len());
        let basis = DMatrix::from_fn(p, fixed, |i, c| inner.mean.basis[(i, c)] * ratio(i));
        directions.view_mut((0, 0), (p, fixed)).copy_from(&basis);
        places.iter().enumerate().for_each(|(c, &place)| directions[(p + place, fixed + c)] = 1.0);
        let allowed = a.transpose() * outer.mean.centring.centred(&directions);
        let sized = |mut columns: DMatrix<f64>| {
            columns.column_iter_mut().for_each(|mut column| {
                let norm = column.norm();
                column.unscale_mut(if norm > 0.0 { norm } else { 1.0 });
            });
            columns
        };
        let allowed = sized(allowed);
        let projector = &allowed * symmetric::pseudo_inverse(&(allowed.transpose() * &allowed)) * allowed.transpose();
        let (values, vectors) = symmetric::eigen(&projector);
        let fixed_by: Vec<usize> = (0..values.len()).filter(|&k| values[k] < 0.5).collect();
        let l = vectors.select_columns(&fixed_by).transpose();
        if l.nrows() == 0 {
            return Err(NoJointTest::Unidentified);
        }
        let mut off = DVector::zeros(a.nrows());
        for i in 0..p {
            let held = other.centre[i] + other.scale[i] * inner.mean.offset[i];
            off[i] = (own.mean[i] - held) / frame.scale[i];
        }
        for (c, scale) in outer.mean.coefficient_scale.iter().enumerate() {
            off[p + c] = own.coefficients[c] * scale;
        }
        outer.mean.centring.centre(off.as_mut_slice());
        self.law.joint(&l, &(&l * (a.transpose() * off)))
    }
}
