//! What every file of results has, and what none has.

use std::fmt;

use serde::de::{Deserialize, DeserializeSeed, Deserializer, Error, MapAccess, SeqAccess, Visitor};

/// What the number at a key may be.
#[derive(Debug, Clone, Copy, PartialEq)]
enum NumberRule {
    /// Any; whole ones are counts, which are so small that many of them can be added.
    Count,
    /// Any, however large.
    Any,
    /// Between 0 and 1.
    Probability,
}

const MOST: u64 = 1 << 53;

impl NumberRule {
    fn of(key: &str) -> NumberRule {
        match key {
            "seed" => NumberRule::Any,
            key if key.ends_with("p_value") => NumberRule::Probability,
            _ => NumberRule::Count,
        }
    }

    fn check<E: Error>(self, number: f64, shown: impl fmt::Display) -> Result<(), E> {
        let (holds, expected) = match self {
            NumberRule::Any => return Ok(()),
            NumberRule::Count => (number <= MOST as f64, format!("a count of at most {MOST}")),
            NumberRule::Probability => ((0.0..=1.0).contains(&number), "a probability, 0 to 1".to_owned()),
        };
        if holds { Ok(()) } else { Err(E::custom(format!("found {shown}, expected {expected}"))) }
    }
}

/// The schema of results whose numbers are what their keys say.
#[derive(Debug)]
pub(super) struct ResultHead {
    pub(super) schema: Option<String>,
}

impl<'de> Deserialize<'de> for ResultHead {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<ResultHead, D::Error> {
        from.deserialize_map(ResultHeadVisitor)
    }
}

struct ResultHeadVisitor;

impl<'de> Visitor<'de> for ResultHeadVisitor {
    type Value = ResultHead;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the object of a result")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<ResultHead, A::Error> {
        let mut head = ResultHead { schema: None };
        while let Some(key) = map.next_key::<String>()? {
            if key == "schema" {
                head.schema = map.next_value()?;
            } else {
                map.next_value_seed(NumberRule::of(&key))?;
            }
        }
        Ok(head)
    }
}

impl<'de> DeserializeSeed<'de> for NumberRule {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, from: D) -> Result<(), D::Error> {
        from.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for NumberRule {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a value")
    }

    fn visit_bool<E>(self, _: bool) -> Result<(), E> {
        Ok(())
    }

    fn visit_i64<E: Error>(self, number: i64) -> Result<(), E> {
        self.check(number as f64, number)
    }

    fn visit_u64<E: Error>(self, number: u64) -> Result<(), E> {
        self.check(number as f64, number)
    }

    fn visit_f64<E: Error>(self, number: f64) -> Result<(), E> {
        if self == NumberRule::Count { Ok(()) } else { self.check(number, number) }
    }

    fn visit_str<E>(self, _: &str) -> Result<(), E> {
        Ok(())
    }

    fn visit_unit<E>(self) -> Result<(), E> {
        Ok(())
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<(), A::Error> {
        while list.next_element_seed(self)?.is_some() {}
        Ok(())
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
        while let Some(key) = map.next_key::<std::borrow::Cow<'_, str>>()? {
            map.next_value_seed(NumberRule::of(&key))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Option<String>, String> {
        serde_json::from_str::<ResultHead>(text).map(|head| head.schema).map_err(|error| error.to_string())
    }

    #[test]
    fn numbers_are_what_their_keys_say() {
        let sound = r#"{"schema": "s", "seed": 18446744073709551615, "tests": [{"count": 9007199254740992, "p_value": 1,
            "score_p_value": 0.5, "nis_p_value": null, "mean": -1e300}]}"#;
        assert_eq!(read(sound), Ok(Some("s".to_owned())));
        assert_eq!(read(r#"{"a": [[true, "b", null, {}]]}"#), Ok(None));
        for (text, expected) in [
            (
                r#"{"a": {"count": 18446744073709551615}}"#,
                "found 18446744073709551615, expected a count of at most 9007199254740992",
            ),
            (r#"{"p_value": -0.5}"#, "found -0.5, expected a probability, 0 to 1"),
            (r#"{"a": [{"nis_p_value": 2}]}"#, "found 2, expected a probability, 0 to 1"),
            ("[1]", "invalid type: sequence, expected the object of a result"),
        ] {
            let found = read(text).expect_err(text);
            assert!(found.starts_with(expected), "{found}");
        }
    }
}
