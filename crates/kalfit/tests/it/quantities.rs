//! Quantities of a record, one by one.

use kalfit::build::{Columns, constant, fixed, free, measurement, name};
use kalfit::{FitRecord, Model};

/// y = a + b x, with `b` the same in all tests, and `hidden` never seen.
fn record() -> FitRecord {
    let model = Model::builder("lines")
        .state(constant("a").unit("m"))
        .state(constant("b"))
        .state(constant("hidden"))
        .measurement(measurement(
            "y",
            name("a") + name("b") * name("x") + 0.0 * name("hidden"),
            name("sigma") * name("two"),
        ))
        .parameter(free("sigma"))
        .parameter(fixed("two", 2.0));
    let test = |j: usize| {
        let wave = |k: usize| ((k * 7919 + 13) % 101) as f64 / 50.0 - 1.0;
        let (x, y) = (0..9)
            .map(|k| (k as f64, 5.0 * wave(j) + 0.5 * k as f64 + wave(31 * j + k)))
            .unzip::<f64, f64, Vec<_>, Vec<_>>();
        Columns::new(format!("{j}")).numbers("x", x).numbers("y", y)
    };
    let tests: Vec<Columns> = (0..8).map(test).collect();
    kalfit::fit(&model.build().expect("a model"), &tests).expect("a fit").record
}

#[test]
fn each_number_is_there_once_with_what_is_known_of_it() {
    let record = record();
    let all = record.quantities();
    let of = |name: &str| {
        let mut found = all.iter().filter(|own| own.name == name);
        let own = found.next().unwrap_or_else(|| panic!("no {name}"));
        assert!(found.next().is_none(), "{name} twice");
        own
    };
    // three of means and of spreads, six covariances, three correlations, two parameters
    assert_eq!(all.len(), 3 + 3 + 6 + 3 + 2);
    let phase = &record.phases[0];
    assert_eq!(
        (of("mean[a]").estimate, of("mean[a]").std_error),
        (Some(phase.mean.estimate[0]), phase.mean.std_error[0])
    );
    assert_eq!(of("mean[a]").unit.as_deref(), Some("m"));
    assert_eq!(of("covariance[a, b]").estimate, Some(phase.covariance.estimate[0][1]));
    assert_eq!(of("sigma").estimate, Some(record.parameters[0].estimate));
    assert_eq!((of("sigma").status.as_str(), of("two").status.as_str()), ("estimated", "fixed"));
    assert_eq!(of("mean[a]").status, "estimated");
    for name in ["mean[hidden]", "std_dev[hidden]", "covariance[hidden, hidden]"] {
        assert_eq!(of(name).status, "not identified", "{name}: {:?}", of(name));
    }
    for own in &all {
        let known = ["estimated", "fixed", "at zero", "on the boundary", "not identified", "undefined"];
        assert!(known.contains(&own.status.as_str()), "{own:?}");
        assert!(own.status != "fixed" || own.std_error.is_none(), "{own:?}");
    }
}
