//! What a peer prints: lines of a key and values.

use super::clock::TimeTaken;

/// What a peer found, and how long its fit alone took.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PeerAnswer {
    /// Name and version.
    pub(crate) program: String,
    pub(crate) log_likelihood: f64,
    /// Mean, lower triangle of the covariance by rows, standard deviation of the noise, lower triangles of the covariances
    /// of crossed factors and of units; none where only a value was asked for.
    pub(crate) estimates: Vec<f64>,
    pub(crate) taken: TimeTaken,
}

impl PeerAnswer {
    /// Reads the lines of a peer's script.
    pub(super) fn parse(text: &str) -> Result<PeerAnswer, String> {
        let program = line(text, "version")?.ok_or("no line `version`")?.join(" ");
        let mut estimates = Vec::new();
        for key in ["mean", "covariance", "noise", "groups"] {
            estimates.extend(numbers(text, key)?);
        }
        Ok(PeerAnswer {
            program,
            log_likelihood: number(text, "log_likelihood")?,
            estimates,
            taken: TimeTaken { processor: positive(text, "processor")?, elapsed: positive(text, "elapsed")? },
        })
    }
}

/// The values of a key, if the key is there; it may be there once.
fn line<'a>(text: &'a str, key: &str) -> Result<Option<Vec<&'a str>>, String> {
    let mut found = text.lines().filter_map(|line| {
        let mut words = line.split_whitespace();
        (words.next() == Some(key)).then(|| words.collect())
    });
    let first = found.next();
    match found.next() {
        Some(_) => Err(format!("two lines `{key}`")),
        None => Ok(first),
    }
}

fn numbers(text: &str, key: &str) -> Result<Vec<f64>, String> {
    let parse = |word: &str| match word.parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        _ => Err(format!("`{key}` is `{word}`, expected a number")),
    };
    line(text, key)?.unwrap_or_default().into_iter().map(parse).collect()
}

fn number(text: &str, key: &str) -> Result<f64, String> {
    match numbers(text, key)?[..] {
        [value] => Ok(value),
        ref values => Err(format!("`{key}` has {} values, expected one", values.len())),
    }
}

fn positive(text: &str, key: &str) -> Result<f64, String> {
    let value = number(text, key)?;
    if value > 0.0 { Ok(value) } else { Err(format!("`{key}` is {value}, expected a time")) }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PRINTED: &str = "Loading required package: Matrix
version lme4 1.1.31
log_likelihood -9369.6670594695079
mean 9.98 1.98
covariance 0.97 0.26 0.24
noise 0.49
processor 0.18
elapsed 0.19
";

    #[test]
    fn lines_of_a_peer_are_read_and_others_passed_over() {
        let expected = PeerAnswer {
            program: "lme4 1.1.31".to_owned(),
            log_likelihood: -9_369.667_059_469_508,
            estimates: vec![9.98, 1.98, 0.97, 0.26, 0.24, 0.49],
            taken: TimeTaken { processor: 0.18, elapsed: 0.19 },
        };
        assert_eq!(PeerAnswer::parse(PRINTED), Ok(expected));
    }

    #[test]
    fn a_missing_doubled_or_senseless_line_is_refused_by_its_name() {
        let refused = |from: &str, to: &str| PeerAnswer::parse(&PRINTED.replace(from, to)).unwrap_err();
        assert_eq!(refused("version lme4 1.1.31\n", ""), "no line `version`");
        assert_eq!(refused("processor 0.18\n", ""), "`processor` has 0 values, expected one");
        assert_eq!(refused("elapsed 0.19", "elapsed 0"), "`elapsed` is 0, expected a time");
        assert_eq!(refused("noise 0.49", "noise NA"), "`noise` is `NA`, expected a number");
        assert_eq!(refused("mean 9.98", "mean NaN"), "`mean` is `NaN`, expected a number");
        assert_eq!(refused("noise 0.49", "mean 1"), "two lines `mean`");
    }
}
