//! Formatting of numbers in sentences.

/// Numbers from `LARGE` up, and below `SMALL`, are written with an exponent, which is easier to read than zeros.
const LARGE: f64 = 1e7;
const SMALL: f64 = 1e-4;

/// The number `x` with `digits` significant digits and no trailing zeros; `unknown` where `x` is not finite.
pub fn plain(x: f64, digits: usize) -> String {
    if !x.is_finite() {
        return "unknown".to_owned();
    }
    if x == 0.0 {
        return "0".to_owned();
    }
    let shown = format!("{x:.*e}", digits.max(1) - 1);
    let (mantissa, power) = shown.split_once('e').expect("the e format has an exponent");
    if !(SMALL..LARGE).contains(&x.abs()) {
        return format!("{}e{power}", without_idle_zeros(mantissa));
    }
    let decimals = digits.max(1) as i32 - 1 - power.parse::<i32>().expect("an exponent is a number");
    without_idle_zeros(&format!("{x:.*}", usize::try_from(decimals).unwrap_or(0))).to_owned()
}

fn without_idle_zeros(number: &str) -> &str {
    if number.contains('.') { number.trim_end_matches('0').trim_end_matches('.') } else { number }
}
