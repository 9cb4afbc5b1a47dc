use super::*;
use kalfit_model::ChainPhase;

fn test(number: usize) -> Reduction {
    let phase =
        ChainPhase { own: 1, constant: 0.5, data: vec![1.0], factor: vec![2.0], path: Path::Information, link: None };
    Reduction {
        test: format!("t{number}"),
        constant: number as f64,
        residual: (number > 1).then_some(0.1),
        data: vec![0.5; 2],
        factor: vec![number as f64; 3],
        covariates: vec![0.25],
        steps: number,
        observations: 7,
        path: if number == 2 { Path::SquareRoot } else { Path::Information },
        design: number as u128,
        chain: (number % 3 == 1).then(|| Box::new(Chain { phases: vec![phase] })),
        exact: (number % 4 == 2)
            .then(|| Box::new(ExactRows { coefficients: vec![1.0, number as f64], values: vec![0.5] })),
    }
}

#[test]
fn rows_are_what_was_put_there() {
    let all: Vec<Reduction> = (0..8).map(test).collect();
    let reductions = Reductions::from(all.clone());
    for split in 0..=all.len() {
        let part = |tests: &[Reduction]| tests.iter().cloned().collect::<Reductions>();
        let (mut first, second) = (part(&all[..split]), part(&all[split..]));
        assert_eq!(Reductions::joined(vec![first.clone(), second.clone()]), reductions, "joined at {split}");
        first.append(second);
        assert_eq!(first, reductions, "appended at {split}");
    }
    let back: Vec<Reduction> = reductions.iter().map(Reduction::from).collect();
    assert_eq!(back, all);
    let picked = reductions.select(&[5, 1, 1]);
    assert!(picked.iter().eq([5, 1, 1].map(|number| reductions.get(number))));
    assert!(reductions.iter().rev().eq((0..8).rev().map(|number| reductions.get(number))));
}

#[test]
fn clones_have_the_stamp_and_changes_renew_it() {
    let one = Reductions::from(vec![test(1), test(2)]);
    let stamp = one.stamp();
    assert_ne!(Reductions::from(vec![test(1), test(2)]).stamp(), stamp, "others that are equal");
    let changes: [&dyn Fn(&mut Reductions); 4] = [
        &|reductions| *reductions.get_mut(1).constant += 1.0,
        &|reductions| reductions.push(test(3)),
        &|reductions| reductions.append(Reductions::from(vec![test(3)])),
        &|reductions| *reductions = std::mem::take(reductions).with_covariates(&[]),
    ];
    for (number, change) in changes.iter().enumerate() {
        let mut other = one.clone();
        assert_eq!(other.stamp(), stamp);
        change(&mut other);
        assert_ne!(other.stamp(), stamp, "change {number}");
    }
    assert_eq!(one.stamp(), stamp);
}
