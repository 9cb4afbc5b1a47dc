//! Published data that lme4 distributes, as reductions at unit noise, with figures of lmerTest 3.1-3 and pbkrtest 0.5.2
//! for the same models: degrees of freedom and standard errors have the 6 to 8 digits of lme4's optimum.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use crate::small_sample::forest::{Forest, Leaf};
use crate::small_sample::information::{self, MeanSums, ThetaLaw};
use crate::small_sample::mean_law::MeanLaw;
use crate::small_sample::pass::Pass;
use crate::small_sample::theta::{SigmaElement, Theta};
use crate::small_sample::{DfMethod, JointTest};
use kalfit_fixtures::near;
use kalfit_model::{Grouping, Label};

/// A test: name of its unit, number of measurements n, z'z, H'z and H'H of p states, packed.
type Test<'a> = (&'a str, f64, f64, &'a [f64], &'a [f64]);

/// Both laws of the means at known estimates (Σ of each level packed, the tests first; variance of noise).
fn laws(tests: &[Test<'_>], sigmas: &[&[f64]], noise: f64) -> [MeanLaw; 2] {
    let p = tests[0].3.len();
    let own: Vec<SigmaElement> =
        (0..p).flat_map(|i| (0..=i).map(move |j| SigmaElement { i, j, unit: 1.0, blocks: Arc::new([0]) })).collect();
    let n = 1 + own.len() * sigmas.len();
    let theta = Theta {
        noises: 1,
        levels: vec![own; sigmas.len()],
        directions: DMatrix::identity(n, n),
        elements: (0..n - 1).collect(),
    };
    let root = |packed: &&[f64]| {
        let sigma = DMatrix::from_fn(p, p, |i, j| packed[kalfit_algebra::symmetric::pair(i, j)]);
        kalfit_algebra::symmetric::square_root(&sigma)
    };
    let roots: Vec<DMatrix<f64>> = sigmas.iter().map(root).collect();
    let paths = tests.iter().enumerate().map(|(j, test)| {
        let unit = test.0.bytes().map(usize::from).sum::<usize>();
        (j.to_string(), vec![Label::literal(unit)])
    });
    let paths: Vec<(String, Vec<Label>)> = paths.collect();
    let grouping = Grouping::from_paths(1, paths.iter().map(|(id, path)| (id.as_str(), path.clone())));
    let numbers: Vec<usize> = (0..tests.len()).collect();
    let grouped = (sigmas.len() > 1).then_some((&grouping, &numbers[..]));
    let forest = Forest::of(tests.iter().map(|test| leaf(test, noise)).collect(), grouped);
    let pass = Pass::of(&forest, &theta, &roots).expect("finite");
    let mean = MeanSums::of(&pass.totals().expect("finite"), p, p);
    let law = ThetaLaw::of(&pass, &information::expected(&pass, &mean).expect("finite")).expect("a law");
    let bent = pass.contracted(&law.covariance).expect("finite").view((p, p), (p, p)).into_owned();
    let observed = ThetaLaw::of(&pass, &information::observed(&pass, &mean).expect("finite")).expect("a law");
    [MeanLaw::kenward_roger(&mean, law, &bent), MeanLaw::satterthwaite(&mean, observed)]
}

/// The bordered test with X = I and the data.
fn leaf(&(_, count, squares, y, information): &Test<'_>, noise: f64) -> Leaf {
    let p = y.len();
    let plain = DMatrix::from_fn(2 * p + 1, 2 * p + 1, |i, j| match (i == 2 * p, j == 2 * p) {
        (true, true) => squares,
        (true, false) => y[j % p],
        (false, true) => y[i % p],
        (false, false) => information[kalfit_algebra::symmetric::pair(i % p, j % p)],
    });
    Leaf {
        slopes: vec![&plain * -noise.powi(-2)],
        curvatures: vec![&plain * (2.0 * noise.powi(-3))],
        k: plain / noise,
        log_curvatures: vec![-count / (noise * noise)],
    }
}

/// Degrees of freedom and standard error of the mean of one state.
fn checked(law: &MeanLaw, (i, value): (usize, f64), (df, std_error): (f64, f64), tolerance: f64) {
    let l = DVector::from_fn(law.plain.nrows(), |k, _| f64::from(u8::from(k == i)));
    let row = law.row(&l, value).expect("a row");
    near::relative("degrees of freedom", row.df.expect("some"), df, tolerance);
    near::relative("standard error", row.std_error, std_error, tolerance);
}

const DYESTUFF: [Test<'static>; 6] = [
    ("A", 5.0, 11341025.0, &[7525.0], &[5.0]),
    ("B", 5.0, 11678350.0, &[7640.0], &[5.0]),
    ("C", 5.0, 12236250.0, &[7820.0], &[5.0]),
    ("D", 5.0, 11238900.0, &[7490.0], &[5.0]),
    ("E", 5.0, 12810000.0, &[8000.0], &[5.0]),
    ("F", 5.0, 10808350.0, &[7350.0], &[5.0]),
];

const DYESTUFF2: [Test<'static>; 6] = [
    ("A", 5.0, 229.325332, &[31.134], &[5.0]),
    ("B", 5.0, 210.351808, &[23.28], &[5.0]),
    ("C", 5.0, 385.397108, &[37.606], &[5.0]),
    ("D", 5.0, 189.798656, &[28.424], &[5.0]),
    ("E", 5.0, 242.243604, &[30.398], &[5.0]),
    ("F", 5.0, 106.237172, &[19.126], &[5.0]),
];

const PASTES: [Test<'static>; 26] = [
    ("A", 2.0, 7862.6, &[125.4], &[2.0]),
    ("A", 1.0, 3881.29, &[62.3], &[1.0]),
    ("A", 2.0, 7912.9, &[125.8], &[2.0]),
    ("B", 2.0, 7369.96, &[121.4], &[2.0]),
    ("B", 2.0, 7202.42, &[120.0], &[2.0]),
    ("C", 2.0, 6751.94, &[116.2], &[2.0]),
    ("C", 2.0, 8064.82, &[127.0], &[2.0]),
    ("D", 2.0, 6671.57, &[115.5], &[2.0]),
    ("D", 2.0, 8346.34, &[129.2], &[2.0]),
    ("E", 2.0, 6072.02, &[110.2], &[2.0]),
    ("E", 2.0, 5929.73, &[108.9], &[2.0]),
    ("E", 2.0, 6763.69, &[116.3], &[2.0]),
    ("F", 2.0, 8231.57, &[128.3], &[2.0]),
    ("F", 1.0, 3375.61, &[58.1], &[1.0]),
    ("F", 2.0, 7260.25, &[120.5], &[2.0]),
    ("G", 2.0, 7825.01, &[125.1], &[2.0]),
    ("G", 2.0, 7166.69, &[119.7], &[2.0]),
    ("H", 2.0, 7033.0, &[118.6], &[2.0]),
    ("H", 2.0, 8607.04, &[131.2], &[2.0]),
    ("H", 2.0, 8307.85, &[128.9], &[2.0]),
    ("I", 2.0, 6006.08, &[109.6], &[2.0]),
    ("I", 2.0, 8192.0, &[128.0], &[2.0]),
    ("I", 2.0, 6555.53, &[114.5], &[2.0]),
    ("J", 2.0, 6915.38, &[117.6], &[2.0]),
    ("J", 1.0, 3504.64, &[59.2], &[1.0]),
    ("J", 2.0, 6672.77, &[115.5], &[2.0]),
];

const SLEEP: [Test<'static>; 9] = [
    ("308", 10.0, 1227899.20131285, &[3421.3383, 17191.6103], &[10.0, 45.0, 285.0]),
    ("309", 3.0, 132944.42615169, &[630.9775, 611.2214], &[3.0, 3.0, 5.0]),
    ("310", 2.0, 77387.45906205, &[393.3861, 194.3322], &[2.0, 1.0, 1.0]),
    ("330", 6.0, 525742.49055359, &[1774.3151, 4354.6289], &[6.0, 15.0, 55.0]),
    ("331", 10.0, 964186.12728095, &[3094.3605, 14359.0688], &[10.0, 45.0, 285.0]),
    ("332", 1.0, 55159.50143236, &[234.8606, 0.0], &[1.0, 0.0, 0.0]),
    ("333", 4.0, 330895.70769934, &[1149.9764, 1742.5227], &[4.0, 6.0, 14.0]),
    ("334", 2.0, 146763.06970505, &[541.6743, 276.2012], &[2.0, 1.0, 1.0]),
    ("335", 10.0, 627072.62830634, &[2500.7004, 11015.4665], &[10.0, 45.0, 285.0]),
];

#[test]
fn one_level_of_equal_tests() {
    let [kr, observed] = laws(&DYESTUFF, &[&[1764.05]], 2451.25);
    checked(&kr, (0, 1527.5), (5.0, 19.383412152), 1e-8);
    checked(&observed, (0, 1527.5), (5.0, 19.383412152), 1e-7);
}

#[test]
fn a_variance_that_is_estimated_as_zero() {
    let [kr, _] = laws(&DYESTUFF2, &[&[0.0]], 13.806309627586202);
    checked(&kr, (0, 5.6656), (5.0, 0.67838803123), 1e-8);
}

#[test]
fn two_levels_of_unequal_tests() {
    let [kr, observed] = laws(&PASTES, &[&[7.915677362432375], &[2.1014273894694973]], 0.6507838921546404);
    checked(&kr, (0, 60.27632281955), (8.839905055971, 0.7333631469368805), 1e-8);
    checked(&observed, (0, 60.27632281955), (10.123212621906, 0.7301157866716804), 1e-6);
}

#[test]
fn two_states_of_unequal_tests() {
    let [kr, observed] =
        laws(&SLEEP, &[&[1003.8787466855318, -74.75140688939946, 94.60012743129079]], 736.5275735549582);
    checked(&kr, (0, 254.62869468213), (7.809782970221, 12.625916508667), 1e-8);
    checked(&kr, (1, 5.608264801110), (4.355193794395, 5.312450863977), 1e-8);
    checked(&observed, (0, 254.62869468213), (7.097930943813, 12.475575317239), 1e-7);
    checked(&observed, (1, 5.608264801110), (5.687454359838, 4.718873233460), 1e-7);
    let (both, distance) =
        (DMatrix::identity(2, 2), DVector::from_column_slice(&[254.62869468213242, 5.608264801109666]));
    let of = |law: &MeanLaw| law.joint(&both, &distance).expect("an F test");
    let JointTest { value, df_num, df_den, scale, p_value, method } = of(&kr);
    assert_eq!((df_num, method), (2, DfMethod::KenwardRoger));
    near::relative("F", value, 204.55985219678905, 1e-7);
    near::relative("denominator", df_den.expect("some"), 4.877318717298055, 1e-7);
    near::relative("scale", scale, 0.8379519806151665, 1e-8);
    near::relative("p", p_value, 1.978220101082086e-5, 1e-6);
    let JointTest { value, df_den, p_value, .. } = of(&observed);
    near::relative("F of Fai and Cornelius", value, 247.42267827000603, 1e-7);
    near::relative("denominator", df_den.expect("some"), 4.50954006177058, 1e-6);
    near::relative("p", p_value, 2.4582460081843675e-5, 1e-5);
}
