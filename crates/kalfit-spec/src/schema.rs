//! The JSON Schema of model files, made from the keys that the parser accepts: editors complete and check with it.

use serde_json::{Map, Value, json};

use crate::keys::{self, Key, Takes};

/// The JSON Schema of a model file, with a line feed at its end.
pub fn schema() -> String {
    let mut root = table(keys::ROOT);
    let head = [
        ("$schema", json!("http://json-schema.org/draft-07/schema#")),
        ("title", json!("kalfit model file")),
        ("description", json!("Tests of a linear state-space model whose initial state differs from test to test.")),
    ];
    let Value::Object(own) = &mut root else { unreachable!("a table is an object") };
    own.extend(head.map(|(key, value)| (key.to_owned(), value)));
    let mut text = serde_json::to_string_pretty(&root).expect("a schema has only texts");
    text.push('\n');
    text
}

/// A table with these keys and no other.
fn table(keys: &[Key]) -> Value {
    let property = |key: &Key| {
        let mut value = takes(key.takes);
        if let Value::Object(own) = &mut value {
            own.insert("description".to_owned(), json!(key.text));
        }
        (key.name.to_owned(), value)
    };
    let properties: Map<String, Value> = keys.iter().map(property).collect();
    json!({ "type": "object", "additionalProperties": false, "properties": properties })
}

fn takes(takes: Takes) -> Value {
    let list = |items: Value| json!({ "type": "array", "items": items });
    let by_name = |value: Value| json!({ "type": "object", "additionalProperties": value });
    let (text, number) = (json!({ "type": "string" }), json!({ "type": "number" }));
    let expression = json!({ "type": ["number", "string"] });
    match takes {
        Takes::Text => text,
        Takes::Number => number,
        Takes::Truth => json!({ "type": "boolean" }),
        Takes::Expression | Takes::NumberOrColumn => expression,
        Takes::Word(words) => json!({ "enum": words }),
        Takes::Texts => list(text),
        Takes::TextLists => list(list(text)),
        Takes::Numbers => by_name(number),
        Takes::Expressions => by_name(expression),
        Takes::TextsByName => by_name(list(text)),
        Takes::TextByName => by_name(text),
        Takes::Matrix => list(list(expression)),
        Takes::NumberMatrix => list(list(number)),
        Takes::Start => json!({ "anyOf": [{ "enum": ["estimated", "stationary"] }, table(keys::START)] }),
        Takes::Table(own) => table(own),
        Takes::Tables(own) => by_name(table(own)),
        Takes::Parameters(own) => by_name(json!({ "anyOf": [number, table(own)] })),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_schema_has_every_key_once_with_a_sentence() {
        let schema: Value = serde_json::from_str(&schema()).expect("it is JSON");
        let state = &schema["properties"]["states"]["additionalProperties"];
        assert_eq!(state["additionalProperties"], false);
        let all = [keys::ROOT, keys::DATA, keys::STATE, keys::MEAN, keys::COVARIANCE_IN_GROUPS, keys::PHASE];
        for key in all.into_iter().flatten() {
            assert!(key.text.ends_with('.'), "{}: {}", key.name, key.text);
        }
        for keys in all {
            let mut names = keys::names(keys);
            names.sort_unstable();
            names.dedup();
            assert_eq!(names.len(), keys.len());
        }
    }
}
