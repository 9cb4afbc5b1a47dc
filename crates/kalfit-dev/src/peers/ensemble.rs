//! Ensembles drawn with fixed seeds, the same in every run on every machine.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use rand::RngExt;

use super::peer::scripts;
use super::whole::{KalfitCommand, path};
use crate::seed::{SEED, random};

/// What is fitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum PeerStudy {
    /// Intercept and slope of each test, ten rows at inputs of its own, noise of unknown level.
    Regression,
    /// Two effects of each test, one row with sampling variances and covariance of its own.
    Meta,
    /// Intercept and slope of each test, of each unit with ten tests, and of each of fifty stations that the tests meet at
    /// random; four rows at inputs of their own, noise of unknown level.
    Crossed,
}

/// Rows of a test of the regression.
pub(super) const ROWS: usize = 10;
/// Rows of a test on a station.
const STATION_ROWS: usize = 4;
/// Tests of a unit.
const UNIT_TESTS: usize = 10;
/// Number of stations.
const STATIONS: usize = 50;

impl PeerStudy {
    pub(super) fn name(self) -> &'static str {
        match self {
            PeerStudy::Regression => "regression",
            PeerStudy::Meta => "meta",
            PeerStudy::Crossed => "crossed",
        }
    }

    /// The model file that kalfit fits.
    pub(super) fn model(self) -> PathBuf {
        scripts().join(format!("{}.toml", self.name()))
    }

    pub(super) fn rows(self) -> usize {
        match self {
            PeerStudy::Regression => ROWS,
            PeerStudy::Meta => 1,
            PeerStudy::Crossed => STATION_ROWS,
        }
    }

    /// Inputs and variances; what is measured is drawn from the truth.
    fn design(self, tests: usize) -> String {
        let mut rng = random();
        let mut text = match self {
            PeerStudy::Regression => "test,x,y\n",
            PeerStudy::Meta => "test,y_a,y_b,v_a,v_b,c_ab\n",
            PeerStudy::Crossed => "unit,test,station,x,y\n",
        }
        .to_owned();
        for test in 1..=tests {
            match self {
                PeerStudy::Regression => {
                    for _ in 0..ROWS {
                        let x: f64 = rng.random_range(0.0..1.0);
                        writeln!(text, "{test},{x:.4},0").expect("a string takes all");
                    }
                }
                PeerStudy::Meta => {
                    let [a, b] = [(); 2].map(|()| rng.random_range(0.005..0.03_f64));
                    let covariance = rng.random_range(0.2..0.7) * (a * b).sqrt();
                    writeln!(text, "{test},0,0,{a:.6},{b:.6},{covariance:.6}").expect("a string takes all");
                }
                PeerStudy::Crossed => {
                    let (unit, station) = ((test - 1) / UNIT_TESTS, rng.random_range(0..STATIONS));
                    for _ in 0..STATION_ROWS {
                        let x: f64 = rng.random_range(-1.0..1.0);
                        writeln!(text, "u{unit},{test},s{station},{x:.4},0").expect("a string takes all");
                    }
                }
            }
        }
        text
    }

    /// The data as a CSV and as a Parquet file, the same numbers in both.
    pub(super) fn draw(self, tests: usize, kalfit: &KalfitCommand) -> Result<[PathBuf; 2], String> {
        let file = |end: &str| kalfit.folder.join(format!("{}-{tests}.{end}", self.name()));
        let design = kalfit.folder.join("design.csv");
        write(&design, &self.design(tests))?;
        let truth = scripts().join(format!("{}-truth.toml", self.name()));
        let [csv, parquet] = ["csv", "parquet"].map(file);
        for out in [&csv, &parquet] {
            let (model, truth, design, out) = (self.model(), path(&truth)?, path(&design)?, path(out)?);
            let seed = SEED.to_string();
            let model = path(&model)?;
            kalfit.run(&["simulate", model, "--from", truth, "--design", design, "--seed", &seed, "--out", out])?;
        }
        Ok([csv, parquet])
    }
}

/// Writes a file.
pub(super) fn write(file: &Path, text: &str) -> Result<(), String> {
    std::fs::write(file, text).map_err(|error| format!("{}: {error}", file.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [PeerStudy; 3] = [PeerStudy::Regression, PeerStudy::Meta, PeerStudy::Crossed];

    #[test]
    fn a_design_has_every_row_of_every_test_and_is_the_same_again() {
        for study in ALL {
            let text = study.design(30);
            assert_eq!(text.lines().count(), 1 + 30 * study.rows(), "{study:?}");
            assert_eq!(text, study.design(30), "{study:?}");
        }
    }

    #[test]
    fn the_models_and_the_truths_are_sound_and_of_one_form() {
        for study in ALL {
            let fitted = kalfit_spec::Spec::load(&study.model()).unwrap();
            let truth = kalfit_spec::Spec::load(&scripts().join(format!("{}-truth.toml", study.name()))).unwrap();
            assert_eq!(fitted.layout, truth.layout, "{study:?}");
        }
    }
}
