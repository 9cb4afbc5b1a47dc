//! Records to summarise, made up so that each says one thing.

use kalfit::record::*;

/// A phase of p states with means 1, 2, …, standard deviations 1, and independent states; all with standard errors.
pub(crate) fn phase(name: &str, states: &[&str]) -> PhaseRecord {
    let p = states.len();
    let square = |on: f64, off: f64| (0..p).map(|i| (0..p).map(|k| if i == k { on } else { off }).collect()).collect();
    let some = |m: Vec<Vec<f64>>| m.into_iter().map(|r: Vec<f64>| r.into_iter().map(Some).collect()).collect();
    PhaseRecord {
        name: name.into(),
        states: states.iter().map(|&s| s.into()).collect(),
        units: vec![None; p],
        mean: MeanRecord {
            few_tests: MeanLawRecord::default(),
            estimate: (0..p).map(|i| 1.0 + i as f64).collect(),
            std_error: vec![Some(0.25); p],
            interval95: vec![None; p],
            fixed: vec![false; p],
            scale: None,
            regression: vec![],
        },
        covariance: CovarianceRecord {
            estimate: square(1.0, 0.0),
            std_error: some(square(0.3, 0.2)),
            interval95: vec![vec![None; p]; p],
            fixed: vec![vec![false; p]; p],
            scale: None,
        },
        std_dev: VectorRecord { estimate: vec![1.0; p], std_error: vec![Some(0.15); p], interval95: vec![None; p] },
        correlation: MatrixRecord {
            estimate: some(square(1.0, 0.0)),
            std_error: (0..p).map(|i| (0..p).map(|k| (i != k).then_some(0.2)).collect()).collect(),
            interval95: vec![vec![None; p]; p],
        },
        boundary: vec![],
        unidentified: vec![],
        observability: vec![],
        weakly_determined: vec![],
        tests: None,
        information: None,
        filter: None,
    }
}

pub(crate) fn record(title: &str, phases: Vec<PhaseRecord>) -> FitRecord {
    FitRecord {
        df_method: None,
        heterogeneity: None,
        schema: "kalfit-fit/1".into(),
        kalfit_version: "0.1.0".into(),
        title: title.into(),
        model_digest: None,
        model: vec![],
        data: DataRecord {
            tests: 18,
            steps: 180,
            observations: 180,
            design_classes: 1,
            square_root_tests: 0,
            files: vec!["data.csv".into()],
        },
        criterion: "ml".into(),
        std_errors: "observed".into(),
        intervals: "wald".into(),
        log_likelihood_kind: "measurements".into(),
        log_likelihood: -875.96967,
        composite_log_likelihood: None,
        free_parameters: 6,
        aic: Some(1763.93934),
        bic: Some(1783.09712),
        converged: true,
        reason: "the optimality conditions hold".into(),
        certificate: CertificateRecord {
            mean: 1e-9,
            covariance: 1e-9,
            null_space: 0.0,
            parameters: 0.0,
            rounding: 1e-13,
        },
        model_check: None,
        misfit: None,
        search: None,
        solver: SolverRecord {
            method: "hybrid".into(),
            solver: "newton".into(),
            phases: "chain".into(),
            iterations: 9,
            filter_passes: 1,
            score_passes: 0,
            trace: vec![-900.0, -875.96967],
            seconds: 0.012,
        },
        phases,
        parameters: vec![],
        estimates: None,
        starts: vec![],
        methods: vec![],
        constraints: vec![],
        tests: tests(&[0.4, 0.7, 0.021, 0.9]),
        group_column: None,
        by_group: vec![],
        levels: vec![],
        crossed: vec![],
        groups: vec![],
        group_test: None,
        notes: vec![],
    }
}

/// Changes each test of a record, given its number.
pub(crate) fn change_tests(record: &mut FitRecord, mut change: impl FnMut(usize, &mut TestRow)) {
    let mut rows: Vec<TestRow> = record.tests.iter().map(TestRow::from).collect();
    rows.iter_mut().enumerate().for_each(|(number, row)| change(number, row));
    record.tests = rows.into_iter().collect();
}

/// Changes one of them.
pub(crate) fn change_test(record: &mut FitRecord, which: usize, mut change: impl FnMut(&mut TestRow)) {
    change_tests(record, |number, test| {
        if number == which {
            change(test);
        }
    });
}

pub(crate) fn tests(p_values: &[f64]) -> TestRecords {
    let test = |(i, &p): (usize, &f64)| TestRow {
        groups: Vec::new(),
        group: None,
        id: format!("{}", 308 + i),
        log_likelihood: -48.0,
        observations: 10,
        steps: Some(10),
        design_class: Some(1),
        phases: vec![],
        distance: Some(-2.0 * p.ln()),
        degrees_of_freedom: 2,
        p_value: Some(p),
        deletion: None,
        innovations: None,
    };
    p_values.iter().enumerate().map(test).collect()
}

/// The sleep study of lme4, maximum likelihood.
pub(crate) fn sleepstudy() -> FitRecord {
    let mut main = phase("main", &["intercept", "slope"]);
    main.units = vec![Some("ms".into()), Some("ms/day".into())];
    main.mean.estimate = vec![251.405105, 10.467286];
    main.mean.std_error = vec![Some(6.632277), Some(1.502237)];
    main.std_dev.estimate = vec![23.780655, 5.716849];
    main.std_dev.std_error = vec![Some(5.06), Some(1.13)];
    main.covariance.estimate = vec![vec![565.516, 11.055], vec![11.055, 32.682]];
    main.correlation.estimate = vec![vec![Some(1.0), Some(0.08132)], vec![Some(0.08132), Some(1.0)]];
    main.correlation.std_error = vec![vec![None, Some(0.3253)], vec![Some(0.3253), None]];
    let mut record = record("Reaction time under sleep deprivation", vec![main]);
    record.parameters.push(ParameterRecord {
        name: "sigma".into(),
        per: None,
        level: None,
        estimate: 25.591796,
        std_error: Some(1.508),
        interval95: Some([Some(22.8), Some(28.7)]),
        fixed: false,
        at_bound: false,
        unit: Some("ms".into()),
        standing: None,
        note: None,
    });
    record
}

/// Σ of rank 1 of 3 with one variance at zero, and a direction of the mean that nothing was observed of.
pub(crate) fn singular() -> FitRecord {
    let mut main = phase("main", &["bias", "scale", "misalignment"]);
    main.mean.std_error = vec![None, None, Some(0.1)];
    main.std_dev.estimate = vec![1.0, 0.5, 0.0];
    main.std_dev.std_error = vec![None; 3];
    main.covariance.estimate = vec![vec![1.0, 0.5, 0.0], vec![0.5, 0.25, 0.0], vec![0.0; 3]];
    main.correlation.estimate =
        vec![vec![Some(1.0), Some(1.0), None], vec![Some(1.0), Some(1.0), None], vec![None, None, None]];
    main.correlation.std_error = vec![vec![None; 3]; 3];
    main.boundary.push(BoundaryRecord {
        what: "covariance".into(),
        rank: 1,
        of: 3,
        states: ["bias", "scale", "misalignment"].map(String::from).to_vec(),
        zero_variances: vec!["misalignment".into()],
    });
    main.unidentified.push(UnidentifiedRecord {
        what: "mean".into(),
        direction: vec![0.6, -0.8, 0.0],
        elements: vec![],
        tests: vec![],
        reason: String::new(),
        phases: vec![],
    });
    main.unidentified.push(UnidentifiedRecord {
        what: "covariance".into(),
        direction: vec![0.0, 1.0],
        elements: vec!["bias, bias".into(), "bias, scale".into()],
        tests: vec![],
        reason: "`bias` and `scale` are never observed in one test".into(),
        phases: vec![],
    });
    let mut record = record("Static IMU", vec![main]);
    record.data.square_root_tests = 3;
    record.data.design_classes = 4;
    record.notes = vec!["Units of the states span 9 powers of ten; they were scaled.".into()];
    record
}

/// One mean fixed, one state common to all tests, structural zeros, a regression, a scale, levels of a parameter.
pub(crate) fn constrained() -> FitRecord {
    let mut main = phase("main", &["bias", "scale_factor", "temperature_coefficient"]);
    main.mean.fixed[1] = true;
    main.mean.estimate[1] = 0.0;
    main.mean.std_error[1] = None;
    for (i, k) in [(2, 0), (0, 2), (2, 1), (1, 2), (2, 2), (0, 1), (1, 0)] {
        main.covariance.fixed[i][k] = true;
        main.covariance.std_error[i][k] = None;
    }
    main.covariance.estimate[2][2] = 0.0;
    main.std_dev.estimate[2] = 0.0;
    main.std_dev.std_error[2] = None;
    main.mean.scale = Some(ScaleRecord { estimate: 1.0213, std_error: Some(0.0345), interval95: None });
    main.mean.regression.push(RegressionRecord {
        few_tests: CoefficientLawRecord::default(),
        state: "bias".into(),
        column: "temperature".into(),
        estimate: 0.01234,
        std_error: Some(0.0012),
        interval95: None,
    });
    let mut record = record("Gyro bench", vec![main]);
    let constraint = |element: &str, p: f64| ConstraintRecord {
        level: None,
        element: element.into(),
        phase: "main".into(),
        value: 0.0,
        sensitivity: Some(-12.3456),
        score_statistic: Some(7.1),
        p_value: Some(p),
        expected_change: Some(-0.45678),
        likelihood_ratio: (p < 0.02).then_some(6.8),
        likelihood_ratio_p_value: (p < 0.02).then_some(0.009),
        f: None,
        f_df: None,
        f_p_value: None,
    };
    record.constraints = vec![
        constraint("mean[scale_factor]", 0.0077),
        constraint("covariance[scale_factor, bias]", 0.43),
        ConstraintRecord {
            sensitivity: None,
            score_statistic: None,
            p_value: None,
            expected_change: None,
            ..constraint("covariance[temperature_coefficient, temperature_coefficient]", 1.0)
        },
    ];
    let level = |level: &str, estimate: f64, fixed: bool| ParameterRecord {
        name: "sigma_v".into(),
        per: Some("lot".into()),
        level: Some(level.into()),
        estimate,
        std_error: (!fixed).then_some(0.0123),
        interval95: (!fixed).then_some([Some(estimate - 0.024), Some(estimate + 0.024)]),
        fixed,
        at_bound: false,
        unit: None,
        standing: None,
        note: None,
    };
    record.parameters = vec![level("A", 0.7, true), level("B", 0.123456, false)];
    record.parameters.push(ParameterRecord {
        name: "tau".into(),
        per: None,
        level: None,
        std_error: None,
        interval95: None,
        at_bound: true,
        unit: Some("s".into()),
        standing: None,
        note: None,
        ..level("", 1.0, false)
    });
    record.tests = tests(&[0.4, 1e-12, 0.0004, 0.9]);
    record
}
