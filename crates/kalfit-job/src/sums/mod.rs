//! Fits by sums: `kalfit sums` where tests are, `kalfit join` between such places, and the same for whoever moves sums in another way.

pub(crate) mod error;
mod join;
mod site;
mod theta;

pub use error::SumsError;
pub use join::{JoinJob, JoinedRound, JoinedSums, first, join, of_partitions};
pub use site::{SumsJob, SumsMade, SumsSite, sums};
pub use theta::{SiteSums, Theta};

use crate::failure::Failure;

impl From<SumsError> for Failure {
    fn from(error: SumsError) -> Failure {
        Failure::Sums(Box::new(error))
    }
}
