use std::time::Instant;

use kalfit::estimate::{Combination, Derivatives, Likelihood};
use kalfit::infer::{self, Choices, DeletionChoice};
use kalfit::model::{CovarianceStructure, MeanStructure};
use kalfit::reduce::{Path, Reduction};
use nalgebra::DMatrix;

use super::fits::{Phases, by, fit};
use super::{Recipe, ensemble};

#[test]
#[ignore]
fn timing() {
    for designs in [10_000, 1] {
        let recipe = Recipe {
            tests: 10_000,
            designs,
            own: vec![6; 5],
            heirs: vec![0; 5],
            observed: 12,
            strength: 1.0,
            noise: 6,
            missing: false,
            regressors: 0,
            root: DMatrix::identity(30, 30),
            path: Path::Information,
        };
        let data = ensemble(&recipe, 1);
        println!("designs {designs}");
        if let Ok(n) = std::env::var("PASSES") {
            let which = if std::env::var("SECOND").is_ok() { Derivatives::Second } else { Derivatives::First };
            let l = Likelihood::of_phases(&data, recipe.ranges(), Combination::Chain);
            for _ in 0..n.parse().unwrap() {
                let t = Instant::now();
                l.at(&[0.0; 30], &DMatrix::identity(30, 30), which);
                println!("{:?}", t.elapsed());
            }
            return;
        }
        let full = |p: usize| (MeanStructure::free(p), CovarianceStructure::full());
        let apart: Vec<Vec<Reduction>> = (0..5)
            .map(|f| {
                data.iter()
                    .map(|r| {
                        let phase = &r.chain.as_ref().unwrap().phases[f];
                        Reduction { data: phase.data.clone(), factor: phase.factor.clone(), chain: None, ..r.clone() }
                    })
                    .collect()
            })
            .collect();
        for (name, which) in [("first", Derivatives::First), ("second", Derivatives::Second)] {
            let l = Likelihood::of_phases(&data, recipe.ranges(), Combination::Chain);
            let t = Instant::now();
            l.at(&[0.0; 30], &DMatrix::identity(30, 30), which);
            let chain = t.elapsed();
            let mut sum = std::time::Duration::ZERO;
            for own in &apart {
                let l = Likelihood::new(own, 6);
                let t = Instant::now();
                l.at(&[0.0; 6], &DMatrix::identity(6, 6), which);
                sum += t.elapsed();
            }
            println!("{name}: chain {chain:?} apart {sum:?}");
        }
        let phases: Phases = (0..5).map(|_| full(6)).collect();
        let t = Instant::now();
        let found = fit(&data, &phases, &by(Combination::Chain));
        println!("fit chain {:?} passes {} {:?}", t.elapsed(), found.passes, found.trace);
        let t = Instant::now();
        infer::infer(&found, &data, Choices { deletion: DeletionChoice::None, ..Choices::default() });
        println!("infer chain {:?}", t.elapsed());
        let (mut fits, mut infers) = (std::time::Duration::ZERO, std::time::Duration::ZERO);
        for own in &apart {
            let t = Instant::now();
            let found = fit(own, &vec![full(6)], &by(Combination::Chain));
            fits += t.elapsed();
            let t = Instant::now();
            infer::infer(&found, own, Choices { deletion: DeletionChoice::None, ..Choices::default() });
            infers += t.elapsed();
        }
        println!("fit apart {fits:?} infer apart {infers:?}");
    }
}
