//! Is what a page shows what a command printed?
//!
//! Counts of work and times differ from machine to machine, so the last line of a fit is compared without its numbers. The last
//! digit of any other number may differ by one. A line `…` stands for any number of lines.

/// What is left out.
pub(crate) const LEFT_OUT: &str = "…";

/// Whether the lines agree.
pub(crate) fn agree(shown: &[String], printed: &[String]) -> bool {
    let (shown, printed) = (worked(shown), worked(printed));
    let mut at = 0;
    let mut anywhere = false;
    for segment in shown.split(|line| line == LEFT_OUT) {
        let last = std::ptr::eq(segment.as_ptr_range().end, shown.as_ptr_range().end);
        let fits = |k: usize| {
            k + segment.len() <= printed.len()
                && segment.iter().zip(&printed[k..]).all(|(a, b)| same(a, b))
                && (!last || segment.is_empty() || k + segment.len() == printed.len())
        };
        let until = if anywhere { printed.len() } else { at };
        let Some(found) = (at..=until).find(|&k| fits(k)) else { return false };
        at = found + segment.len();
        anywhere = true;
    }
    at == printed.len() || shown.last().is_some_and(|line| line == LEFT_OUT)
}

/// What the line on the work done begins with.
const WORK: &str = "Computation: ";

/// Lines without spaces at their ends, the lines on the work done as one, without numbers.
fn worked(lines: &[String]) -> Vec<String> {
    let mut all: Vec<String> = Vec::new();
    let mut inside = false;
    for line in lines {
        let line = line.trim_end();
        let begins = line.starts_with(WORK);
        if inside && !line.is_empty() && line != LEFT_OUT {
            let last = all.last_mut().expect("a line began it");
            last.push(' ');
            last.push_str(line);
        } else {
            inside = begins;
            all.push(line.to_owned());
        }
    }
    all.iter().map(|line| if line.starts_with(WORK) { work(line) } else { line.clone() }).collect()
}

/// The method and the solver, and that work was done.
fn work(line: &str) -> String {
    let named = |part: &&str| !part.contains(|letter: char| letter.is_ascii_digit());
    line.split(", ").filter(named).collect::<Vec<_>>().join(", ")
}

fn same(shown: &str, printed: &str) -> bool {
    let words = |line: &str| line.split_whitespace().map(str::to_owned).collect::<Vec<_>>();
    let (a, b) = (words(shown), words(printed));
    shown == printed || (a.len() == b.len() && a.iter().zip(&b).all(|(a, b)| a == b || close(a, b)))
}

/// Numbers that differ by one in the last digit shown.
fn close(shown: &str, printed: &str) -> bool {
    let bare = |word: &str| word.trim_end_matches([',', '.', ';', ':', ')']).trim_start_matches('(').to_owned();
    let (shown, printed) = (bare(shown), bare(printed));
    let digit = shown.split_once('.').map_or(1.0, |(_, decimals)| {
        let decimals = decimals.split_once('e').map_or(decimals, |(decimals, _)| decimals);
        0.1_f64.powi(i32::try_from(decimals.len()).unwrap_or(i32::MAX))
    });
    let exponent = shown.split_once('e').map_or("0", |(_, exponent)| exponent).parse::<i32>().unwrap_or(0);
    let (Ok(a), Ok(b)) = (shown.parse::<f64>(), printed.parse::<f64>()) else { return false };
    (a - b).abs() <= 1.01 * digit * 10.0_f64.powi(exponent)
}

fn lines(text: &str) -> Vec<String> {
    text.lines().map(str::to_owned).collect()
}

#[test]
fn a_wrong_figure_or_a_missing_line_is_seen() {
    let printed = lines("a 1.25\nb 3\nc\nd");
    assert!(agree(&lines("a 1.25\nb 3\nc\nd"), &printed));
    assert!(agree(&lines("a 1.24\n…\nd"), &printed), "one in the last digit is rounding");
    assert!(agree(&lines("…\nc\n…"), &printed));
    assert!(!agree(&lines("a 1.23\nb 3\nc\nd"), &printed));
    assert!(!agree(&lines("a 1.25\nb 3\nc"), &printed));
    assert!(!agree(&lines("…\nx\n…"), &printed));
    assert!(!agree(&lines("b 3\n…"), &printed));
    assert!(!agree(&[], &printed));
    assert!(agree(
        &lines("Computation: solver newton, 8 passes, 7 ms."),
        &lines("Computation: solver newton, 9 passes,\n1.2 s.")
    ));
    assert!(!agree(
        &lines("Computation: solver newton, 8 passes, 7 ms."),
        &lines("Computation: solver em, 8 passes, 7 ms.")
    ));
}
