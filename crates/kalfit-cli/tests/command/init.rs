//! Starter models: what is written runs as it is.

use crate::folder::{Folder, shown};
use insta::assert_snapshot;
use kalfit::FitRecord;

const TEMPLATES: [&str; 8] = [
    "random-coefficients",
    "meta-analysis",
    "gyro-bench",
    "static-imu",
    "two-phase",
    "levels",
    "six-position",
    "moderators",
];

/// A starter model in a folder of its own.
fn begun(template: &str) -> Folder {
    let folder = Folder::new(&[]);
    let output = folder.run(&format!("init {template}"));
    assert!(output.status.success(), "{}", shown(&output));
    folder
}

fn text(folder: &Folder, name: &str) -> String {
    std::fs::read_to_string(folder.path(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
}

/// Fits, and reads what was written.
fn fit(folder: &Folder, model: &str, data: &str, options: &str) -> FitRecord {
    let output = folder.run(&format!("fit {model} {data} --quiet --out fit.json {options}"));
    assert!(output.status.success(), "{model}: {}", shown(&output));
    serde_json::from_str(&text(folder, "fit.json")).expect("fit.json is a record")
}

#[test]
fn the_command_that_is_shown_works_word_for_word_and_converges() {
    for template in TEMPLATES {
        let folder = Folder::new(&[]);
        let told = shown(&folder.run(&format!("init {template} its/folder")));
        let next = told.lines().rev().find_map(|line| line.strip_prefix("  kalfit ")).expect("a command is shown");
        let output = folder.run(next);
        assert_eq!(output.status.code(), Some(0), "{template}: {}", shown(&output));
        assert!(shown(&output).contains("Converged"), "{template}: {}", shown(&output));
        assert!(!shown(&output).contains("boundary"), "{template}: its first fit is a plain one");
    }
}

#[test]
fn what_was_written_is_said_and_what_to_type_next() {
    let folder = Folder::new(&[]);
    assert_snapshot!(shown(&folder.run("init gyro-bench")), @"
    exit 0
    ----- stdout
    ----- stderr
    Wrote gyro-bench.toml: the model, with comments
    Wrote gyro-bench.csv: 28 gyros on two stations, drawn
    Wrote kalfit-model.schema.json: the keys of model files, for editors

    Next:
      kalfit fit gyro-bench.toml gyro-bench.csv
    ");
    assert_snapshot!(shown(&folder.run("init static-imu bench/static")), @"
    exit 0
    ----- stdout
    ----- stderr
    Wrote bench/static/static-imu.toml: the model, with comments
    Wrote bench/static/static-imu.csv: 24 gyros in six positions, drawn
    Wrote bench/static/kalfit-model.schema.json: the keys of model files, for editors

    Next:
      kalfit fit bench/static/static-imu.toml bench/static/static-imu.csv
    ");
    assert_snapshot!(shown(&folder.run("init two-phase --quiet")), @"
    exit 0
    ----- stdout
    ----- stderr
    ");
    let mut names: Vec<String> = folder.contents().into_iter().map(|(path, _)| path).collect();
    names.iter_mut().for_each(|path| *path = path.rsplit('/').next().expect("it has a name").to_owned());
    assert_eq!(
        names,
        [
            "bench",
            "d.csv",
            "gyro-bench.csv",
            "gyro-bench.toml",
            "kalfit-model.schema.json",
            "m.toml",
            "two-phase.csv",
            "two-phase.toml"
        ]
    );
}

#[test]
fn templates_are_listed_with_a_line_each() {
    let folder = Folder::new(&[]);
    let told = shown(&folder.run("init"));
    assert!(told.starts_with("exit 0"), "{told}");
    for template in TEMPLATES {
        assert!(told.lines().any(|line| line.trim_start().starts_with(template)), "{template}: {told}");
    }
}

/// The schema has the keys of every template; a model beside which it stands names it.
#[test]
fn a_schema_stands_beside_the_model() {
    let folder = begun("levels");
    assert!(text(&folder, "levels.toml").starts_with("#:schema kalfit-model.schema.json\n"));
    let schema = text(&folder, "kalfit-model.schema.json");
    let printed = folder.run("schema");
    assert_eq!(String::from_utf8_lossy(&printed.stdout), schema);
    let schema: serde_json::Value = serde_json::from_str(&schema).expect("the schema is JSON");
    assert_eq!(schema["properties"]["data"]["properties"]["levels"]["items"]["type"], "string");
    let again = folder.run("init moderators");
    assert!(!shown(&again).contains("schema"), "a schema that stands there is not written again");
}

#[test]
fn names_that_a_shell_would_split_are_quoted() {
    let folder = Folder::new(&[]);
    let told = shown(&folder.command("init meta-analysis").arg("my trials").output().expect("it runs"));
    assert!(told.contains("  kalfit fit 'my trials/meta-analysis.toml' 'my trials/meta-analysis.csv'\n"), "{told}");
}

#[test]
fn files_that_exist_are_left_alone_and_then_nothing_is_written() {
    for name in ["gyro-bench.toml", "gyro-bench.csv"] {
        let folder = Folder::new(&[(name, b"mine")]);
        let before = folder.contents();
        let output = folder.run("init gyro-bench");
        assert_eq!(folder.contents(), before, "{name}");
        let expected = "exit 2\n----- stdout\n----- stderr\nerror: `[file]` exists, and would be replaced\n\n\
            hint: name another folder, `kalfit init TEMPLATE DIR`, or move the file away\n";
        assert_eq!(shown(&output).replace(name, "[file]"), expected);
    }
}

#[test]
fn a_folder_that_cannot_be_is_refused() {
    let folder = Folder::new(&[]);
    let before = folder.contents();
    assert_snapshot!(shown(&folder.run("init gyro-bench d.csv")), @"
    exit 2
    ----- stdout
    ----- stderr
    error: `d.csv` is not a folder

    hint: name a folder, which is made if need be
    ");
    let under = shown(&folder.run("init gyro-bench d.csv/under"));
    assert!(under.starts_with("exit 2") && under.contains("error: cannot make the folder `d.csv/under`"), "{under}");
    assert_eq!(folder.contents(), before);
}

#[test]
fn templates_that_are_not_known_are_refused_with_the_list_and_the_nearest() {
    let folder = Folder::new(&[]);
    assert_snapshot!(shown(&folder.run("init gyro-bnech")), @"
    exit 2
    ----- stdout
    ----- stderr
    error: invalid value 'gyro-bnech' for '[TEMPLATE]'
      [possible values: random-coefficients, meta-analysis, gyro-bench, static-imu, two-phase, levels, six-position, moderators]

      tip: a similar value exists: 'gyro-bench'

    For more information, try '--help'.
    ");
    assert_snapshot!(shown(&folder.run("init")), @"
    exit 0
    ----- stdout
    Templates: a model with comments and data, ready to run

      random-coefficients  A line for each of 18 people: random intercepts and slopes
      meta-analysis        Five trials of two outcomes with known sampling errors
      gyro-bench           28 gyros on two stations: bias, scale factor, g-sensitivity
      static-imu           24 gyros held still: bias, g-sensitivity, and free drift and noise
      two-phase            An inertial platform, aligned and then flown
      levels               Twelve gyros run again and again on two stations: spread from gyro to gyro and from run to run
      six-position         Twelve accelerometer triads in six positions at five temperatures, switched on again at each
      moderators           Thirteen trials with known sampling errors, and what their effect depends on

    Next:
      kalfit init TEMPLATE [DIR]
    ----- stderr
    ");
}

#[test]
fn what_the_comments_propose_works() {
    for template in TEMPLATES {
        let folder = begun(template);
        let (model, data) = (format!("{template}.toml"), format!("{template}.csv"));
        let whole = text(&folder, &model);
        let (_, proposals) = whole.split_once("# Things to try:\n#\n").expect("something is proposed");
        let proposals: Vec<&str> = proposals.split("\n#\n").collect();
        assert!(proposals.len() > 1, "{template}");
        for proposal in proposals {
            let plain = proposal
                .lines()
                .map(|line| line.trim_start_matches('#').strip_prefix(' ').unwrap_or("").to_owned() + "\n");
            let plain: String = plain.collect();
            if let Some(command) = plain.strip_prefix("  kalfit fit …") {
                let options: Vec<&str> = command.split_whitespace().take(2).collect();
                assert!(fit(&folder, &model, &data, &options.join(" ")).converged, "{template}: {proposal}");
            } else {
                folder.write("changed.toml", format!("{whole}\n{plain}").as_bytes());
                assert!(fit(&folder, "changed.toml", &data, "").converged, "{template}: {proposal}");
            }
        }
    }
}

#[test]
fn templates_with_an_example_in_the_repository_have_its_data_and_its_answer() {
    for (template, example) in [
        ("random-coefficients", "random-coefficients/sleepstudy"),
        ("meta-analysis", "meta-analysis/berkey1998"),
        ("gyro-bench", "gyro-bench/bench"),
        ("two-phase", "two-phase/platform"),
    ] {
        let folder = begun(template);
        folder.copy(&format!("../../examples/{example}.toml"));
        folder.copy(&format!("../../examples/{example}.csv"));
        let stem = example.rsplit('/').next().expect("it has a name");
        let data = format!("{template}.csv");
        assert!(
            text(&folder, &data) == text(&folder, &format!("{stem}.csv")),
            "{template}: the data have drifted apart"
        );
        let own = fit(&folder, &format!("{template}.toml"), &data, "");
        let other = fit(&folder, &format!("{stem}.toml"), &data, "");
        assert_eq!(own.log_likelihood.to_bits(), other.log_likelihood.to_bits(), "{template}");
        assert_eq!(own.free_parameters, other.free_parameters, "{template}");
    }
}

#[test]
fn the_static_bench_gives_back_what_its_data_were_drawn_from() {
    let record = fit(&begun("static-imu"), "static-imu.toml", "static-imu.csv", "");
    let within =
        |found: f64, error: f64, truth: f64| assert!((found - truth).abs() < 3.0 * error, "{found} ± {error}, {truth}");
    for (parameter, truth) in record.parameters.iter().zip([0.4, 2.0]) {
        within(parameter.estimate, parameter.std_error.expect("it is inside its range"), truth);
    }
    let mean = &record.phases[0].mean;
    for (i, truth) in [2.0, 0.6, 0.0, -0.3].into_iter().enumerate() {
        within(mean.estimate[i], mean.std_error[i].expect("it is identified"), truth);
    }
}
