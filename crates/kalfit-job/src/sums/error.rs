//! Why sums cannot be made, or not be put together.

use kalfit::shards::ShardError;

use crate::results::ResultError;

/// Why sums cannot be made, or not be put together.
#[derive(Debug, thiserror::Error)]
pub enum SumsError {
    /// A file that is no such results.
    #[error(transparent)]
    Result(#[from] ResultError),
    /// The model, or what was asked.
    #[error(transparent)]
    Shard(#[from] ShardError),
    /// Another version of the program: its sums may be other numbers.
    #[error("`{file}` was made by kalfit {found}, and this is kalfit {own}")]
    Version {
        /// The file.
        file: String,
        /// Its version.
        found: String,
        /// This one.
        own: &'static str,
    },
    /// Another model file.
    #[error("`{file}` was made with another version of `{model}`")]
    Model {
        /// The file.
        file: String,
        /// The model.
        model: String,
    },
    /// Another value of a parameter.
    #[error("`{file}` was made at {parameter} = {there}, and here it is {here}")]
    Value {
        /// The file.
        file: String,
        /// The parameter.
        parameter: String,
        /// Its value in the file.
        there: String,
        /// Its value here.
        here: String,
    },
    /// A parameter that is free in one place and not in the other.
    #[error("`{parameter}` is free in one of `{file}` and the model, and has a value in the other")]
    Free {
        /// The file.
        file: String,
        /// The parameter.
        parameter: String,
    },
    /// Sums of another round.
    #[error("`{file}` has the sums of round {}, and `{first}` those of round {}", found + 1, expected + 1)]
    Round {
        /// The file.
        file: String,
        /// Its round.
        found: usize,
        /// The first file.
        first: String,
        /// The round of that.
        expected: usize,
    },
    /// Sums of the same round of another fit.
    #[error("`{file}` and `{first}` are not of the same fit: they were asked for different sums in round {round}")]
    Fit {
        /// The file.
        file: String,
        /// The first file.
        first: String,
        /// The round.
        round: usize,
    },
    /// The same sums twice.
    #[error("`{file}` and `{first}` hold the same sums")]
    Twice {
        /// The file.
        file: String,
        /// The first one.
        first: String,
    },
    /// Groups that are not in one place.
    #[error(
        "`{file}` and `{first}` both have tests of {found} of the groups of {level}, expected all tests of a group in one place"
    )]
    Groups {
        /// The file.
        file: String,
        /// The first file.
        first: String,
        /// How many groups both have.
        found: usize,
        /// The outermost level and the crossed factors, in words.
        level: String,
    },
    /// Not all places are there, or not all of their tests.
    #[error("found {found_tests} tests in {found} files, expected {tests} in {places} as in the rounds before")]
    Places {
        /// Files now.
        found: usize,
        /// Their tests.
        found_tests: usize,
        /// Files before.
        places: usize,
        /// Their tests.
        tests: usize,
    },
    /// Answers that are not of one length.
    #[error("the sums of `{file}` are not those that were asked for")]
    Answers {
        /// The file.
        file: String,
    },
    /// An answer that no tests give.
    #[error("the sums of `{file}` cannot come from tests: {why}")]
    Impossible {
        /// The file.
        file: String,
        /// What contradicts that.
        why: &'static str,
    },
    /// A search that has no end.
    #[error("the search has not ended in {rounds} rounds: the sums of some place do not follow from one set of tests")]
    Rounds {
        /// Rounds so far.
        rounds: usize,
    },
    /// Fewer tests than a place tells of.
    #[error("there are {found} tests, and sums of fewer than {least} are not told")]
    Few {
        /// Tests.
        found: usize,
        /// The fewest that are told of.
        least: usize,
    },
}

impl SumsError {
    pub(crate) fn hint(&self) -> Option<&str> {
        match self {
            SumsError::Result(_) => None,
            SumsError::Shard(error) => error.hint(),
            SumsError::Version { .. } => Some("use the same version in every place"),
            SumsError::Model { .. } => Some("use the same model file in every place, byte for byte"),
            SumsError::Value { .. } | SumsError::Free { .. } => {
                Some("give `--set` the same values in every place and round")
            }
            SumsError::Round { .. } | SumsError::Fit { .. } => {
                Some("make the sums of every place anew, `--at` the newest theta.json")
            }
            SumsError::Twice { .. } => Some("name the file of each place once"),
            SumsError::Groups { .. } => {
                Some("move each of these groups to one place, or rename them if they are different groups of one name")
            }
            SumsError::Places { .. } => Some("every place takes part in every round, with the same tests"),
            SumsError::Answers { .. } => Some("make them anew"),
            SumsError::Impossible { .. } => Some("ask that place to make them anew"),
            SumsError::Rounds { .. } => Some(
                "begin anew, and see that no place changes its data between rounds; leave out one place after the other to find which",
            ),
            SumsError::Few { .. } => {
                Some("`--at-least` asks for that; more tests, or another agreement between the places")
            }
        }
    }
}
