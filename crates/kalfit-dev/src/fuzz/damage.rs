//! Damage: what a slip of the hand, a broken disk or a bad will makes of a file.

use rand::{Rng, RngExt};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};

/// How a file is damaged.
#[derive(Debug, Clone, Copy)]
pub(super) enum DamageKind {
    /// By bytes.
    Bytes,
    /// By bytes, words and lines.
    Text,
    /// By bytes, or by values.
    Json,
    /// By many more rows than it had.
    Rows,
}

/// Bytes of a text that is repeated, at most.
const LONGEST: usize = 1 << 20;

/// Bytes of the largest table of many rows, about: a hundred thousand tests of one row.
const LARGEST_TABLE: f64 = 4e6;

/// Numbers at the edge of something.
const NUMBERS: [&str; 20] = [
    "0",
    "-1",
    "1e308",
    "-1e308",
    "1e-308",
    "5e-324",
    "NaN",
    "inf",
    "-inf",
    "18446744073709551615",
    "9007199254740993",
    "-9223372036854775808",
    "0.5",
    "1e5",
    "1e-12",
    "",
    "2147483648",
    "1e999",
    "0x10",
    "1_000",
];

/// Words that mean something somewhere, or nothing.
const WORDS: [&str; 20] = [
    "\"",
    "[",
    "]",
    "{",
    "}",
    "=",
    ",",
    ";",
    "\n",
    "\r",
    "#",
    "\u{0}",
    "é",
    "(((((((((",
    "if(",
    "exp(exp(exp(9)))",
    "sqrt(-1)",
    "\"\"\"",
    "stationary",
    "true",
];

pub(super) fn damaged(random: &mut ChaCha8Rng, sound: &[u8], damage: DamageKind) -> Vec<u8> {
    let mut bytes = sound.to_vec();
    let times = [1, 1, 1, 1, 2, 4][random.random_range(0..6_usize)];
    for _ in 0..times {
        bytes = match damage {
            DamageKind::Bytes => by_bytes(random, bytes),
            DamageKind::Text if random.random_bool(0.2) => by_bytes(random, bytes),
            DamageKind::Text => by_words(random, &bytes),
            DamageKind::Json if random.random_bool(0.1) => by_bytes(random, bytes),
            DamageKind::Json => by_values(random, bytes),
            DamageKind::Rows => of_many_rows(random, &bytes),
        };
    }
    bytes
}

/// A place in a list of this length, 0 in one without any; more often near its end, where formats keep what counts.
fn place(random: &mut ChaCha8Rng, length: usize) -> usize {
    let last = if random.random_bool(0.5) { length.min(2000) } else { length };
    if last == 0 { 0 } else { length - 1 - random.random_range(0..last) }
}

fn by_bytes(random: &mut ChaCha8Rng, mut bytes: Vec<u8>) -> Vec<u8> {
    let (from, length) = (place(random, bytes.len()), random.random_range(1..64_usize));
    let to = (from + length).min(bytes.len());
    match random.random_range(0..7_u32) {
        0 => drop(bytes.drain(from..to)),
        1 => bytes.truncate(from),
        2 => {
            let again = bytes[from..to].to_vec();
            drop(bytes.splice(from..from, again));
        }
        3 => drop(bytes.splice(from..from, std::iter::repeat_n(random.next_u32() as u8, length))),
        4 if to - from >= 8 => {
            bytes[from..from + 8].copy_from_slice(&(1_u64 << random.random_range(0..64_u32)).to_le_bytes())
        }
        _ => {
            let value =
                *[0, 0x7f, 0x80, 0xff, random.next_u32() as u8].get(random.random_range(0..5_usize)).unwrap_or(&0);
            bytes.get_mut(from).into_iter().for_each(|byte| *byte = value);
        }
    }
    bytes
}

fn by_words(random: &mut ChaCha8Rng, bytes: &[u8]) -> Vec<u8> {
    let text = String::from_utf8_lossy(bytes).into_owned();
    let mut lines: Vec<&str> = text.split_inclusive('\n').collect();
    if lines.is_empty() {
        return bytes.to_vec();
    }
    let at = random.random_range(0..lines.len());
    match random.random_range(0..6_u32) {
        0 => drop(lines.remove(at)),
        1 => lines.insert(at, lines[random.random_range(0..lines.len())]),
        2 => lines.swap(at, random.random_range(0..text.split_inclusive('\n').count())),
        _ => {
            let word = other_word(random, lines[at]);
            lines[at] = &word;
            return lines.concat().into_bytes();
        }
    }
    lines.concat().into_bytes()
}

/// A line with one of its words or numbers replaced by another.
fn other_word(random: &mut ChaCha8Rng, line: &str) -> String {
    let is_word = |c: char| c.is_alphanumeric() || "._-".contains(c);
    let mut starts: Vec<usize> = Vec::new();
    let mut before = ' ';
    for (at, c) in line.char_indices() {
        if is_word(c) != is_word(before) || at == 0 {
            starts.push(at);
        }
        before = c;
    }
    if starts.is_empty() {
        return WORDS[random.random_range(0..WORDS.len())].to_owned();
    }
    let k = random.random_range(0..starts.len());
    let end = starts.get(k + 1).copied().unwrap_or(line.len());
    let list: &[&str] = if random.random_bool(0.5) { &NUMBERS } else { &WORDS };
    let word = match random.random_range(0..3_u32) {
        0 => line[starts[random.random_range(0..starts.len())]..]
            .split(|c| !is_word(c))
            .next()
            .unwrap_or_default()
            .to_owned(),
        _ => list[random.random_range(0..list.len())].to_owned(),
    };
    format!("{}{word}{}", &line[..starts[k]], &line[end..])
}

/// A table whose first column names the tests, with rows of its first test again and again: as many tests, as tests of one
/// row, or as one long test whose second column counts. Values of the last column scatter: equal values have no noise, and
/// a likelihood without a bound is another matter than a long table.
fn of_many_rows(random: &mut ChaCha8Rng, sound: &[u8]) -> Vec<u8> {
    let text = String::from_utf8_lossy(sound);
    let mut lines = text.lines();
    let head = lines.next().unwrap_or_default();
    let id = |line: &str| line.split(',').next().unwrap_or_default().to_owned();
    let all: Vec<&str> = lines.collect();
    let first = all.first().map(|line| id(line)).unwrap_or_default();
    let own: Vec<&str> = all.into_iter().take_while(|line| id(line) == first).collect();
    let own = &own[..random.random_range(0..=own.len())];
    let kind = random.random_range(0..3_u32);
    let bytes = 10_f64.powf(random.random_range(2.0..LARGEST_TABLE.log10())) as usize;
    let mut table = format!("{head}\n");
    let mut row = 0_usize;
    while !own.is_empty() && table.len() < bytes {
        let line = own[row % own.len()];
        let rest = line.split_once(',').map_or("", |(_, rest)| rest);
        let scattered = rest.rsplit_once(',').and_then(|(before, last)| Some((before, last.parse::<f64>().ok()?)));
        let rest = match scattered {
            Some((before, last)) => format!("{before},{}", last * random.random_range(0.9..1.1)),
            None => rest.to_owned(),
        };
        let text = match kind {
            0 => format!("{},{rest}\n", row / own.len()),
            1 => format!("{row},{rest}\n"),
            _ => format!("1,{row},{}\n", rest.split_once(',').map_or("", |(_, rest)| rest)),
        };
        table.push_str(&text);
        row += 1;
    }
    table.into_bytes()
}

fn by_values(random: &mut ChaCha8Rng, bytes: Vec<u8>) -> Vec<u8> {
    let Ok(mut whole) = serde_json::from_slice::<Value>(&bytes) else { return by_bytes(random, bytes) };
    let mut at = &mut whole;
    // down to some value, the deeper the likelier
    loop {
        let inner: usize = match at {
            Value::Array(list) => list.len(),
            Value::Object(map) => map.len(),
            _ => 0,
        };
        if inner == 0 || random.random_bool(0.08) {
            break;
        }
        let k = random.random_range(0..inner);
        at = match at {
            Value::Array(list) => &mut list[k],
            Value::Object(map) => map.iter_mut().nth(k).expect("there are so many").1,
            _ => unreachable!("others have nothing in them"),
        };
    }
    let number = NUMBERS[random.random_range(0..NUMBERS.len())];
    let other = match (random.random_range(0..5_u32), &at) {
        (0, _) => Value::Null,
        (1, Value::Array(list)) => Value::Array(list.iter().skip(1).cloned().collect()),
        (2, Value::Array(list)) => Value::Array(list.iter().chain(list).cloned().collect()),
        (1 | 2, Value::String(text)) => {
            json!(text.repeat(random.random_range(0..5000_usize).min(LONGEST / text.len().max(1))))
        }
        (3, _) => [json!([]), json!({}), json!(""), json!(true), json!("x")][random.random_range(0..5_usize)].clone(),
        _ => serde_json::from_str(number).unwrap_or_else(|_| json!(number)),
    };
    *at = other;
    serde_json::to_vec(&whole).unwrap_or(bytes)
}
