//! Whole fits in code: the README's examples in Rust, each compiled and run.
//!
//! A model is built by [`Model::builder`](crate::Model::builder), data are [`Columns`](crate::build::Columns),
//! [`fit`](crate::fit()) does the rest. The [`record`](crate::Fit::record) holds what the command line prints; the
//! crate `kalfit-report` turns it into text.
//!
//! # Random coefficients
//!
//! Reaction times of eight people under sleep deprivation: each person has a separate line, and the noise level is
//! unknown.
//!
//! ```
//! use kalfit::build::{Columns, constant, free, measurement, name};
//!
//! let people = [
//!     ("308", [250., 259., 251., 321., 357., 415., 382., 290., 431., 466.]),
//!     ("309", [223., 205., 203., 205., 208., 216., 214., 218., 224., 237.]),
//!     ("330", [322., 300., 284., 285., 286., 298., 280., 318., 305., 354.]),
//!     ("335", [242., 274., 254., 271., 251., 255., 245., 235., 236., 237.]),
//!     ("337", [312., 314., 292., 346., 366., 392., 404., 417., 456., 459.]),
//!     ("349", [236., 230., 239., 255., 251., 270., 282., 308., 336., 352.]),
//!     ("352", [222., 298., 327., 347., 349., 353., 354., 360., 376., 389.]),
//!     ("372", [269., 273., 298., 311., 287., 330., 334., 343., 369., 364.]),
//! ];
//! let days = (0..10).map(f64::from);
//! let tests = people.map(|(id, reaction)| Columns::new(id).numbers("Days", days.clone()).numbers("Reaction", reaction));
//!
//! let model = kalfit::Model::builder("Reaction time under sleep deprivation")
//!     .state(constant("intercept").unit("ms"))
//!     .state(constant("slope").unit("ms/day"))
//!     .measurement(measurement("Reaction", name("intercept") + name("slope") * name("Days"), "sigma"))
//!     .parameter(free("sigma").unit("ms"))
//!     .build()?;
//!
//! let fit = kalfit::fit(&model, &tests)?;
//! assert!(fit.converged());
//! let (slope, sigma) = (fit.mean("slope")?, fit.parameter("sigma")?);
//! assert!((slope.estimate - 10.181).abs() < 1e-3); // ms/day, averaged over people
//! assert!(slope.std_error.is_some_and(|error| (error - 2.856).abs() < 1e-3));
//! assert!((fit.std_dev("slope")?.estimate - 7.671).abs() < 1e-3);
//! assert!((sigma.estimate - 22.994).abs() < 1e-3);
//! assert!(fit.posterior("335")?.mean[1] < 0.0); // one of them grew faster
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Gyros on two bench stations
//!
//! Constants, a drift that starts in its stationary distribution, and the noise of two stations. Here the data are drawn from the model
//! itself: times and inputs are the design, and the measured values of the design do not matter.
//!
//! ```
//! use kalfit::build::{Columns, constant, fixed, gauss_markov, measurement, name, text_is, when};
//! use kalfit::{Alpha, Ensemble, Population};
//! use nalgebra::{DMatrix, DVector};
//!
//! let model = kalfit::Model::builder("Gyros on two bench stations")
//!     .time("hours")
//!     .time_unit("h")
//!     .state(constant("bias").unit("deg/h"))
//!     .state(constant("scale").unit("ppm"))
//!     .state(gauss_markov("drift", 0.5, 0.15).unit("deg/h"))
//!     .measurement(measurement(
//!         "rate",
//!         name("bias") + name("scale") * name("turn") + name("drift"),
//!         when(text_is("station", "A"), "noise_a", "noise_b"),
//!     ))
//!     .parameter(fixed("noise_a", 0.06))
//!     .parameter(fixed("noise_b", 0.1))
//!     .build()?;
//!
//! // the second gyro of each three never turns, and says nothing of the scale factor
//! let designs: Vec<Columns> = (0..30)
//!     .map(|j| {
//!         let steps = 10 + j % 7;
//!         Columns::new(format!("g{j}"))
//!             .numbers("hours", (0..steps).map(|k| 0.1 * k as f64))
//!             .numbers("turn", (0..steps).map(|k| if j % 3 == 1 { 0.0 } else { 0.01 * (k as f64 - 4.0) }))
//!             .every_text("station", if j % 2 == 0 { "A" } else { "B" })
//!             .every_number("rate", 0.0)
//!     })
//!     .collect();
//! let truth = Population {
//!     mean: vec![0.5, 40.0],
//!     coefficients: vec![],
//!     covariance: DMatrix::from_diagonal(&DVector::from_vec(vec![0.64, 625.0])),
//! };
//! let drawn = Ensemble::new(&model, &designs)?.draw(&Alpha::common([0.06, 0.1]), truth, 30, 1)?;
//!
//! let fit = drawn.fit()?;
//! assert!(fit.converged());
//! let bias = fit.mean("bias")?;
//! let error = bias.std_error.expect("the data tell it");
//! assert!((bias.estimate - 0.5).abs() < 3.0 * error, "{bias:?}");
//! assert_eq!(fit.record.data.tests, 30);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Time constants and noise levels
//!
//! Gyros held still: bias, response to acceleration, a random walk from the turn-on value and white noise, both levels unknown.
//!
//! ```
//! use kalfit::build::{Columns, constant, free, measurement, name, random_walk};
//! use kalfit::{Alpha, Ensemble, Population};
//! use nalgebra::{DMatrix, DVector};
//!
//! let model = kalfit::Model::builder("Turn-on bias and g-sensitivity")
//!     .time("t")
//!     .state(constant("bias").unit("deg/s"))
//!     .state(constant("g_x").unit("deg/s/g"))
//!     .state(random_walk("drift", "walk").known(0.0, 0.0)) // from the turn-on value
//!     .measurement(measurement("gyro", name("bias") + name("g_x") * name("accel") + name("drift"), "sigma"))
//!     .parameter(free("sigma").start(0.1).unit("deg/s"))
//!     .parameter(free("walk").unit("deg/s/sqrt(s)")) // a start is worked out from the data
//!     .build()?;
//!
//! let designs: Vec<Columns> = (0..12)
//!     .map(|j| {
//!         Columns::new(format!("run {j}"))
//!             .numbers("t", (0..60).map(f64::from))
//!             .numbers("accel", (0..60).map(|k| [1.0, 0.0, -1.0, 0.5][(k / 15 + j) % 4]))
//!             .every_number("gyro", 0.0)
//!     })
//!     .collect();
//! let truth = Population {
//!     mean: vec![-0.1, 0.05],
//!     coefficients: vec![],
//!     covariance: DMatrix::from_diagonal(&DVector::from_vec(vec![1.0, 0.0025])),
//! };
//! let drawn = Ensemble::new(&model, &designs)?.draw(&Alpha::common([0.03, 0.004]), truth, 12, 5)?;
//!
//! let fit = drawn.fit()?;
//! assert!(fit.converged());
//! let walk = fit.parameter("walk")?;
//! let [low, high] = walk.interval95.expect("the data tell it");
//! assert!(low.is_some_and(|low| low < 0.004) && high.is_some_and(|high| high > 0.004), "{walk:?}");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! A parameter may have a value for each level of a column: `free("sigma").per("lot")`, and then
//! [`parameter_at`](crate::face::Fit::parameter_at)`("sigma", "A")`.
//!
//! # Random-effects meta-analysis
//!
//! Five trials, each with two effects and their known sampling covariance; one row a trial, no time.
//!
//! ```
//! use kalfit::build::{Columns, constant, measurement, name, variance};
//!
//! let trials = [
//!     [0.47, -0.32, 0.0075, 0.0077, 0.003],
//!     [0.20, -0.60, 0.0057, 0.0008, 0.0009],
//!     [0.40, -0.12, 0.0021, 0.0014, 0.0007],
//!     [0.26, -0.31, 0.0029, 0.0015, 0.0009],
//!     [0.56, -0.39, 0.0148, 0.0304, 0.0072],
//! ];
//! let columns = ["y_PD", "y_AL", "v_PD", "v_AL", "c"];
//! let tests: Vec<Columns> = (1..)
//!     .zip(trials)
//!     .map(|(j, row)| columns.iter().zip(row).fold(Columns::new(format!("trial {j}")), |t, (c, x)| t.every_number(*c, x)))
//!     .collect();
//!
//! let model = kalfit::Model::builder("Surgical against non-surgical treatment")
//!     .state(constant("PD").unit("mm"))
//!     .state(constant("AL").unit("mm"))
//!     .measurement(measurement("PD", name("PD"), variance("v_PD")).column("y_PD"))
//!     .measurement(measurement("AL", name("AL"), variance("v_AL")).column("y_AL"))
//!     .noise_covariance("PD", "AL", "c")
//!     .build()?;
//!
//! let fit = kalfit::fit(&model, &tests)?;
//! assert!((fit.log_likelihood() - 5.84).abs() < 0.005);
//! assert!((fit.mean("PD")?.estimate - 0.345).abs() < 5e-4);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Tests in phases
//!
//! A platform is aligned, then flown. A builder is a value, so the parts that both phases share are written once.
//!
//! ```
//! use kalfit::PhasedModel;
//! use kalfit::build::{Columns, measurement, moving, name, phase};
//!
//! let platform = kalfit::Model::builder("A platform, aligned and flown")
//!     .time("t")
//!     .state(moving("velocity_error", 0.00980665 * name("tilt"), 0.01).unit("m/s"))
//!     .state(moving("tilt", 0.0, 0.02).unit("mrad"));
//! let aligned = platform.clone().measurement(measurement("velocity", name("velocity_error"), 0.05));
//! let flown = platform.measurement(measurement("doppler", name("velocity_error"), 0.2));
//! let model = PhasedModel::builder("phase")
//!     .phase(phase("align", &aligned))
//!     .phase(phase("flight", &flown).carry("velocity_error", "velocity_error").carry("tilt", "tilt"))
//!     .build()?;
//!
//! let nan = f64::NAN; // not measured
//! let runs = [(0.02, 0.9), (-0.13, -1.1), (0.31, 0.4), (0.08, 1.6), (-0.22, -0.3), (0.11, 0.2), (-0.05, 1.0)];
//! let tests: Vec<Columns> = (1..)
//!     .zip(runs)
//!     .map(|(j, (v, tilt))| {
//!         let at = |t: f64| v + 0.0098 * tilt * t;
//!         let jump = 0.3 * (f64::from(j) * 2.4).sin(); // what take-off added
//!         Columns::new(format!("r{j}"))
//!             .texts("phase", ["align", "align", "align", "flight", "flight", "flight"])
//!             .numbers("t", [0.0, 50.0, 100.0, 100.0, 150.0, 200.0])
//!             .numbers("velocity", [at(0.0), at(50.0), at(100.0), nan, nan, nan])
//!             .numbers("doppler", [nan, nan, nan, at(100.0) + jump, at(150.0) + jump, at(200.0) + jump])
//!     })
//!     .collect();
//!
//! let fit = kalfit::fit(&model, &tests)?;
//! assert!(fit.converged());
//! assert!((fit.mean("align.tilt")?.estimate - 0.386).abs() < 0.1);
//! assert!(fit.std_dev("flight.velocity_error")?.estimate < 0.5);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Other people's filters, and tests without their measurements
//!
//! Where a Kalman-Schmidt filter of somebody else stands between the measurements and us,
//! `.filter(schmidt(prior).consider(["scale"]))` on a [`phase`](crate::build::phase) declares it, and the fit uses its
//! estimates. Those who hold the measurements can also hand over [reductions](crate::Reduction) in their place:
//!
//! ```
//! use kalfit::build::{Columns, constant, measurement};
//! use kalfit::{Alpha, Ensemble, Options};
//!
//! let model = kalfit::Model::builder("Levels").state(constant("level")).measurement(measurement("y", "level", 0.5)).build()?;
//! let laboratory = |name: &str, all: &[[f64; 3]]| -> Vec<Columns> {
//!     all.iter().enumerate().map(|(j, y)| Columns::new(format!("{name}{j}")).numbers("y", *y)).collect()
//! };
//! let ours = laboratory("a", &[[1.0, 1.4, 0.9], [2.2, 1.9, 2.4], [0.1, 0.4, 0.6]]);
//! let theirs = laboratory("b", &[[1.5, 1.1, 0.8], [3.0, 2.4, 2.7]]);
//!
//! let mut together = Ensemble::new(&model, &ours)?.reduce(&Alpha::default())?;
//! together.append(Ensemble::new(&model, &theirs)?.reduce(&Alpha::default())?); // as they came
//! let fit = kalfit::fit_reductions(&model, together, &Options::default())?;
//!
//! let all = kalfit::fit(&model, &[ours, theirs].concat())?;
//! assert_eq!(fit.estimate.mean, all.estimate.mean); // to the last bit
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # What the numbers are worth
//!
//! [`Options`](crate::Options) ask for profile intervals, restricted likelihood or sandwich standard errors; a
//! hypothesis is the same model with constraints; a plan gives the standard errors that more tests would have;
//! [`observability`](crate::infer::Inference::observability) shows which tests inform which state.
//!
//! ```
//! use kalfit::build::{Columns, constant, measurement, name};
//! use kalfit::estimate::{Criterion, Settings, Silent};
//! use kalfit::infer::{Choices, IntervalKind, likelihood_ratio};
//! use kalfit::plan::plan;
//! use kalfit::{Ensemble, Options};
//!
//! let builder = kalfit::Model::builder("Lines")
//!     .state(constant("start"))
//!     .state(constant("slope"))
//!     .measurement(measurement("y", name("start") + name("slope") * name("t"), 0.1));
//! let model = builder.build()?;
//! let lines = [(1.0, 0.1), (0.2, 0.02), (1.9, 0.21), (0.8, 0.0), (1.1, 0.16), (0.4, 0.11), (1.3, -0.02), (0.6, 0.09)];
//! let tests: Vec<Columns> = (1..)
//!     .zip(lines)
//!     .map(|(j, (start, slope))| {
//!         let t = [0.0, 2.0, 5.0, 9.0];
//!         let wiggle = |t: f64| 0.1 * (t * f64::from(j)).sin();
//!         Columns::new(format!("{j}")).numbers("t", t).numbers("y", t.map(|t| start + slope * t + wiggle(t)))
//!     })
//!     .collect();
//! let ensemble = Ensemble::new(&model, &tests)?;
//! let fit = ensemble.fit()?;
//!
//! // intervals that a likelihood-ratio test does not reject
//! let choices = Choices { intervals: IntervalKind::Profile, ..Choices::default() };
//! let profiled = ensemble.fit_with(&Options { choices, ..Options::default() }, &mut Silent)?;
//! let ends = profiled.std_dev("slope")?.interval95.expect("the data tell it");
//! assert!(matches!(ends, [Some(low), Some(high)] if low < 0.07 && high > 0.07));
//!
//! // restricted maximum likelihood
//! let settings = Settings { criterion: Criterion::Reml, ..Settings::default() };
//! let restricted = ensemble.fit_with(&Options { settings, ..Options::default() }, &mut Silent)?;
//! assert!(restricted.std_dev("slope")?.estimate > fit.std_dev("slope")?.estimate);
//!
//! // is there a slope at all? Both fits are to the same tests
//! let null = kalfit::fit(&builder.fix_mean("slope", 0.0).fix_covariance("slope", "slope", 0.0).build()?, &tests)?;
//! let ratio = likelihood_ratio(&null.estimate, &fit.estimate)?;
//! assert!(ratio.p_value() < 1e-6);
//!
//! // what 32 such tests would give
//! let planned = plan(&fit.reductions, &fit.structure(), &fit.population(), &[8, 32])?;
//! let errors = planned.quantities[0].std_errors.as_ref().expect("the design tells the mean");
//! assert!((errors[0] / errors[1] - 2.0).abs() < 1e-9);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Matrices step by step
//!
//! Users who have the matrices of a Kalman filter give these matrices: see [`fit_matrices`](crate::fit_matrices), with
//! [`StepMatrices`](crate::reduce::StepMatrices) for transition, inputs and noises and [`Plain`](crate::reduce::Plain)
//! for x_0 = a + Aξ + ζ.
