//! Starter models with their data. The data of most are those of `examples/`, and a test holds the copies to them.

use clap::ValueEnum;

/// What `kalfit init` can write.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Template {
    /// A line for each of 18 people: random intercepts and slopes
    RandomCoefficients,
    /// Five trials of two outcomes with known sampling errors
    MetaAnalysis,
    /// 28 gyros on two stations: bias, scale factor, g-sensitivity
    GyroBench,
    /// 24 gyros held still: bias, g-sensitivity, and free drift and noise
    StaticImu,
    /// An inertial platform, aligned and then flown
    TwoPhase,
    /// Twelve gyros run again and again on two stations: spread from gyro to gyro and from run to run
    Levels,
    /// Twelve accelerometer triads in six positions at five temperatures, switched on again at each
    SixPosition,
    /// Thirteen trials with known sampling errors, and what their effect depends on
    Moderators,
}

/// The text of both files of a template.
macro_rules! files {
    ($name:literal) => {
        [
            (concat!($name, ".toml"), include_str!(concat!("../templates/", $name, ".toml"))),
            (concat!($name, ".csv"), include_str!(concat!("../templates/", $name, ".csv"))),
        ]
    };
}

impl Template {
    /// All templates by name, each with a line.
    pub(crate) fn list() -> String {
        let all: Vec<_> = Template::value_variants().iter().filter_map(Template::to_possible_value).collect();
        let width = all.iter().map(|one| one.get_name().len()).max().unwrap_or_default();
        let line = |one: &clap::builder::PossibleValue| {
            let help = one.get_help().map(ToString::to_string).unwrap_or_default();
            format!("  {:width$}  {help}\n", one.get_name())
        };
        let lines: String = all.iter().map(line).collect();
        format!(
            "Templates: a model with comments and data, ready to run\n\n{lines}\nNext:\n  kalfit init TEMPLATE [DIR]\n"
        )
    }

    /// Name and text of the model, then of the data.
    pub(crate) fn files(self) -> [(&'static str, &'static str); 2] {
        match self {
            Template::RandomCoefficients => files!("random-coefficients"),
            Template::MetaAnalysis => files!("meta-analysis"),
            Template::GyroBench => files!("gyro-bench"),
            Template::StaticImu => files!("static-imu"),
            Template::TwoPhase => files!("two-phase"),
            Template::Levels => files!("levels"),
            Template::SixPosition => files!("six-position"),
            Template::Moderators => files!("moderators"),
        }
    }

    /// What is in the data file, in words.
    pub(crate) fn data_in_words(self) -> &'static str {
        match self {
            Template::RandomCoefficients => "18 people over ten days",
            Template::MetaAnalysis => "five trials",
            Template::GyroBench => "28 gyros on two stations, drawn",
            Template::StaticImu => "24 gyros in six positions, drawn",
            Template::TwoPhase => "24 alignments and 20 flights, drawn",
            Template::Levels => "12 gyros, each run four to six times, drawn",
            Template::SixPosition => "12 triads at five temperatures, drawn",
            Template::Moderators => "thirteen trials",
        }
    }
}
