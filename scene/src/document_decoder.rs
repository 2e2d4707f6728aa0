//! Decodes any type from a value of a document.
//!
//! One decoder serves TOML and JSON, and it is a small one: whatever a decoder does is compiled once more for each type,
//! and a session has hundreds.

use std::fmt;
use std::ops::Range;

use serde::de::{self, DeserializeSeed, Deserializer, Expected, MapAccess, SeqAccess, Unexpected, Visitor};

use crate::document_value::{DocumentError, DocumentValue, Key, Kind};

impl DocumentValue {
    fn unexpected(&self) -> Unexpected<'_> {
        match &self.kind {
            Kind::Null => Unexpected::Unit,
            Kind::Boolean(value) => Unexpected::Bool(*value),
            Kind::Integer(number) => Unexpected::Signed(*number),
            Kind::Unsigned(number) => Unexpected::Unsigned(*number),
            Kind::Float(number) => Unexpected::Float(*number),
            Kind::Text(text) => Unexpected::Str(text),
            Kind::List(_) => Unexpected::Seq,
            Kind::Table(_) => Unexpected::Map,
            Kind::Date => Unexpected::Other("a date or a time"),
            Kind::Refused(what) => Unexpected::Other(what),
        }
    }

    fn refuse(&self, expected: &dyn Expected) -> DocumentError {
        de::Error::invalid_type(self.unexpected(), expected)
    }

    fn located<T>(&self, result: Result<T, DocumentError>) -> Result<T, DocumentError> {
        result.map_err(|error| error.at(&self.place))
    }

    fn number<'de, V: Visitor<'de>>(&'de self, visitor: V) -> Result<V::Value, DocumentError> {
        self.located(match self.kind {
            Kind::Integer(number) => visitor.visit_i64(number),
            Kind::Unsigned(number) => visitor.visit_u64(number),
            Kind::Float(number) => visitor.visit_f64(number),
            _ => Err(self.refuse(&visitor)),
        })
    }

    fn list<'de, V: Visitor<'de>>(&'de self, visitor: V) -> Result<V::Value, DocumentError> {
        let Kind::List(items) = &self.kind else { return Err(self.refuse(&visitor).at(&self.place)) };
        let mut access = ItemAccess(items.iter());
        let value = visitor.visit_seq(&mut access);
        self.located(value.and_then(|value| access.ended(items.len()).map(|()| value)))
    }

    fn table<'de, V: Visitor<'de>>(&'de self, visitor: V) -> Result<V::Value, DocumentError> {
        let Kind::Table(entries) = &self.kind else { return Err(self.refuse(&visitor).at(&self.place)) };
        self.located(visitor.visit_map(EntryAccess { entries: entries.iter(), value: None }))
    }
}

/// Methods that all do the same.
macro_rules! deserialize_as {
    ($same:ident: $($method:ident)*) => {
        $(fn $method<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, DocumentError> {
            self.$same(visitor)
        })*
    };
}

impl<'de> Deserializer<'de> for &'de DocumentValue {
    type Error = DocumentError;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, DocumentError> {
        match &self.kind {
            Kind::Null => self.located(visitor.visit_unit()),
            Kind::Boolean(value) => self.located(visitor.visit_bool(*value)),
            Kind::Integer(_) | Kind::Unsigned(_) | Kind::Float(_) => self.number(visitor),
            Kind::Text(text) => self.located(visitor.visit_borrowed_str(text)),
            Kind::List(_) => self.list(visitor),
            Kind::Table(_) => self.table(visitor),
            Kind::Date | Kind::Refused(_) => Err(self.refuse(&visitor).at(&self.place)),
        }
    }

    deserialize_as!(number: deserialize_i8 deserialize_i16 deserialize_i32 deserialize_i64 deserialize_i128
        deserialize_u8 deserialize_u16 deserialize_u32 deserialize_u64 deserialize_u128
        deserialize_f32 deserialize_f64);
    deserialize_as!(list: deserialize_seq);
    deserialize_as!(table: deserialize_map);
    deserialize_as!(deserialize_str: deserialize_string deserialize_identifier deserialize_char);
    deserialize_as!(deserialize_any: deserialize_bytes deserialize_byte_buf deserialize_unit);

    fn deserialize_bool<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, DocumentError> {
        self.located(match self.kind {
            Kind::Boolean(value) => visitor.visit_bool(value),
            _ => Err(self.refuse(&visitor)),
        })
    }

    fn deserialize_str<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, DocumentError> {
        self.located(match &self.kind {
            Kind::Text(text) => visitor.visit_borrowed_str(text),
            _ => Err(self.refuse(&visitor)),
        })
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, DocumentError> {
        match self.kind {
            Kind::Null => visitor.visit_none(),
            _ => visitor.visit_some(self),
        }
    }

    fn deserialize_unit_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        visitor: V,
    ) -> Result<V::Value, DocumentError> {
        self.deserialize_any(visitor)
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        visitor: V,
    ) -> Result<V::Value, DocumentError> {
        self.located(visitor.visit_newtype_struct(self))
    }

    fn deserialize_tuple<V: Visitor<'de>>(self, _: usize, visitor: V) -> Result<V::Value, DocumentError> {
        self.list(visitor)
    }

    fn deserialize_tuple_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        _: usize,
        visitor: V,
    ) -> Result<V::Value, DocumentError> {
        self.list(visitor)
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        _: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, DocumentError> {
        self.table(visitor)
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _: &'static str,
        _: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, DocumentError> {
        let variant = match &self.kind {
            Kind::Text(name) => Ok(Variant { name, place: &self.place, content: None }),
            Kind::Table(entries) => match &entries[..] {
                [(key, content)] => {
                    Ok(Variant { name: &key.text, place: &key.place, content: Some(content) })
                }
                several => {
                    Err(de::Error::invalid_length(several.len(), &"a table with one key, the variant"))
                }
            },
            _ => Err(self.refuse(&"a variant's name, or a table with one key, the variant")),
        };
        self.located(variant.and_then(|variant| visitor.visit_enum(variant)))
    }

    fn deserialize_ignored_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, DocumentError> {
        visitor.visit_unit()
    }
}

struct ItemAccess<'de>(std::slice::Iter<'de, DocumentValue>);

impl ItemAccess<'_> {
    /// A list may not be longer than what is decoded from it.
    fn ended(&self, length: usize) -> Result<(), DocumentError> {
        match self.0.len() {
            0 => Ok(()),
            left => Err(de::Error::invalid_length(length, &Items(length - left))),
        }
    }
}

/// A number of items, for a message.
struct Items(usize);

impl Expected for Items {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "a list of {}", self.0)
    }
}

impl<'de> SeqAccess<'de> for &mut ItemAccess<'de> {
    type Error = DocumentError;

    fn next_element_seed<T: DeserializeSeed<'de>>(
        &mut self,
        seed: T,
    ) -> Result<Option<T::Value>, DocumentError> {
        let Some(item) = self.0.next() else { return Ok(None) };
        seed.deserialize(item).map(Some).map_err(|error| error.at(&item.place))
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.0.len())
    }
}

struct EntryAccess<'de> {
    entries: std::slice::Iter<'de, (Key, DocumentValue)>,
    value: Option<&'de DocumentValue>,
}

impl<'de> MapAccess<'de> for EntryAccess<'de> {
    type Error = DocumentError;

    fn next_key_seed<K: DeserializeSeed<'de>>(&mut self, seed: K) -> Result<Option<K::Value>, DocumentError> {
        let Some((key, value)) = self.entries.next() else { return Ok(None) };
        self.value = Some(value);
        seed.deserialize(KeyText(&key.text)).map(Some).map_err(|error| error.at(&key.place))
    }

    fn next_value_seed<V: DeserializeSeed<'de>>(&mut self, seed: V) -> Result<V::Value, DocumentError> {
        match self.value.take() {
            Some(value) => seed.deserialize(value).map_err(|error| error.at(&value.place)),
            None => Err(de::Error::custom("a value is asked for before its key")),
        }
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.entries.len())
    }
}

/// A key: text, which may stand for a number.
#[derive(Clone, Copy)]
struct KeyText<'de>(&'de str);

/// Methods that take the text as a number.
macro_rules! deserialize_parsed {
    ($($method:ident $visit:ident)*) => {
        $(fn $method<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, DocumentError> {
            match self.0.parse() {
                Ok(number) => visitor.$visit(number),
                Err(_) => Err(de::Error::invalid_type(Unexpected::Str(self.0), &visitor)),
            }
        })*
    };
}

impl<'de> Deserializer<'de> for KeyText<'de> {
    type Error = DocumentError;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, DocumentError> {
        visitor.visit_borrowed_str(self.0)
    }

    deserialize_parsed!(deserialize_bool visit_bool
        deserialize_i8 visit_i8 deserialize_i16 visit_i16 deserialize_i32 visit_i32 deserialize_i64 visit_i64
        deserialize_u8 visit_u8 deserialize_u16 visit_u16 deserialize_u32 visit_u32 deserialize_u64 visit_u64);

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, DocumentError> {
        visitor.visit_some(self)
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        visitor: V,
    ) -> Result<V::Value, DocumentError> {
        visitor.visit_newtype_struct(self)
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _: &'static str,
        _: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, DocumentError> {
        visitor.visit_enum(Variant { name: self.0, place: &(0..0), content: None })
    }

    serde::forward_to_deserialize_any! {
        i128 u128 f32 f64 char str string bytes byte_buf unit unit_struct seq tuple tuple_struct map struct identifier
        ignored_any
    }
}

/// A variant of an enumeration: its name, and what it holds.
struct Variant<'de, 'place> {
    name: &'de str,
    place: &'place Range<usize>,
    content: Option<&'de DocumentValue>,
}

impl<'de> Variant<'de, '_> {
    fn content(&self, expected: &str) -> Result<&'de DocumentValue, DocumentError> {
        self.content.ok_or_else(|| de::Error::custom(format!("the variant '{}' needs {expected}", self.name)))
    }
}

impl<'de> de::EnumAccess<'de> for Variant<'de, '_> {
    type Error = DocumentError;
    type Variant = Self;

    fn variant_seed<V: DeserializeSeed<'de>>(self, seed: V) -> Result<(V::Value, Self), DocumentError> {
        let which = seed.deserialize(KeyText(self.name)).map_err(|error| error.at(self.place))?;
        Ok((which, self))
    }
}

impl<'de> de::VariantAccess<'de> for Variant<'de, '_> {
    type Error = DocumentError;

    fn unit_variant(self) -> Result<(), DocumentError> {
        match self.content {
            None => Ok(()),
            Some(_) => Err(de::Error::custom(format!("the variant '{}' holds nothing", self.name))),
        }
    }

    fn newtype_variant_seed<T: DeserializeSeed<'de>>(self, seed: T) -> Result<T::Value, DocumentError> {
        seed.deserialize(self.content("a value")?)
    }

    fn tuple_variant<V: Visitor<'de>>(self, _: usize, visitor: V) -> Result<V::Value, DocumentError> {
        self.content("a list")?.list(visitor)
    }

    /// A key that no field has is refused, whatever the type says of unknown fields.
    fn struct_variant<V: Visitor<'de>>(
        self,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, DocumentError> {
        let content = self.content("a table")?;
        if let Kind::Table(entries) = &content.kind
            && let Some((key, _)) = entries.iter().find(|(key, _)| !fields.contains(&key.text.as_str()))
        {
            let error: DocumentError = de::Error::unknown_field(&key.text, fields);
            return Err(error.at(&key.place));
        }
        content.table(visitor)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use serde::Deserialize;
    use serde_json::json;
    use toml::Spanned;
    use toml::de::{DeTable, DeValue};

    use super::*;

    #[derive(Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Everything {
        number: f64,
        count: u16,
        #[serde(default)]
        maybe: Option<i32>,
        place: [f64; 3],
        pair: (bool, String),
        names: BTreeMap<u32, String>,
        kinds: Vec<Shape>,
        big: u64,
    }

    #[derive(Debug, PartialEq, Deserialize)]
    #[serde(rename_all = "snake_case")]
    enum Shape {
        Point,
        Ball(f64),
        Between(f64, f64),
        Block { size: [f64; 2] },
    }

    const SOUND: &str = r#"
        number = 3
        count = 0x10
        place = [1, 2.5, -1e-3]
        pair = [true, "ü"]
        names = { 1 = "one", 20 = "twenty" }
        kinds = ["point", { ball = 2 }, { between = [1, 2] }, { block = { size = [1, 2] } }]
        big = 9223372036854775809
    "#;

    fn value(text: &str) -> DocumentValue {
        let document = DeTable::parse(text).unwrap_or_else(|error| panic!("{text}: {error}"));
        let (place, table) = (document.span(), document.into_inner());
        DocumentValue::from(&Spanned::new(place, DeValue::Table(table)))
    }

    #[test]
    fn a_type_is_decoded_alike_from_both_notations() {
        let wanted = Everything {
            number: 3.0,
            count: 16,
            maybe: None,
            place: [1.0, 2.5, -1e-3],
            pair: (true, "ü".to_owned()),
            names: BTreeMap::from([(1, "one".to_owned()), (20, "twenty".to_owned())]),
            kinds: vec![
                Shape::Point,
                Shape::Ball(2.0),
                Shape::Between(1.0, 2.0),
                Shape::Block { size: [1.0, 2.0] },
            ],
            big: 9_223_372_036_854_775_809,
        };
        assert_eq!(Everything::deserialize(&value(SOUND)).expect("sound"), wanted);
        let json = json!({
            "number": 3, "count": 16, "maybe": null, "place": [1, 2.5, -1e-3], "pair": [true, "ü"],
            "names": { "1": "one", "20": "twenty" },
            "kinds": ["point", { "ball": 2 }, { "between": [1, 2] }, { "block": { "size": [1, 2] } }],
            "big": 9_223_372_036_854_775_809_u64,
        });
        assert_eq!(Everything::deserialize(&DocumentValue::from(&json)).expect("sound"), wanted);
    }

    #[test]
    fn a_fault_is_told_with_its_place() {
        for (from, to, at, message) in [
            ("number = 3", "number = \"3\"", "\"3\"", "invalid type: string \"3\", expected f64"),
            ("count = 0x10", "count = 70000", "70000", "invalid value: integer `70000`, expected u16"),
            ("2.5, -1e-3]", "2.5]", "[1, 2.5]", "invalid length 2, expected an array of length 3"),
            ("-1e-3]", "3, 4]", "[1, 2.5, 3, 4]", "invalid length 4, expected a list of 3"),
            ("-1e-3]", "1e999]", "1e999", "a number above the largest of 64 bits, expected f64"),
            ("20 = ", "x = ", "x", "invalid type: string \"x\", expected u32"),
            ("big =", "bigger =", "bigger", "unknown field `bigger`, expected one of `number`"),
            ("\"point\"", "\"cone\"", "\"cone\"", "unknown variant `cone`, expected one of `point`"),
            ("\"point\"", "7", "7", "expected a variant's name, or a table with one key"),
            ("\"point\"", "{ point = 1 }", "{ point = 1 }", "the variant 'point' holds nothing"),
            ("\"point\"", "\"ball\"", "\"ball\"", "the variant 'ball' needs a value"),
            ("{ size =", "{ sizes =", "sizes", "unknown field `sizes`, expected `size`"),
            ("{ ball = 2 }", "{ ball = 2, point = 1 }", "{ ball = 2, point = 1 }", "invalid length 2"),
            ("9223372036854775809", "99999999999999999999", "99999999999999999999", "more than 64 bits"),
            ("number = 3", "number = 1979-05-27", "1979-05-27", "a date or a time, expected f64"),
        ] {
            let text = SOUND.replacen(from, to, 1);
            let error = Everything::deserialize(&value(&text)).expect_err("a fault");
            assert!(error.message().contains(message), "{to}: {error}");
            assert_eq!(error.place().map(|place| &text[place]), Some(at), "{to}: {error}");
        }
        let missing = Everything::deserialize(&value("number = 3")).expect_err("a fault");
        assert_eq!(missing.message(), "missing field `count`");
    }

    #[test]
    fn every_json_value_comes_back() {
        let all_letters: String = (0..0x3000).filter_map(char::from_u32).collect();
        for value in [
            json!(true),
            json!(-3),
            json!(i64::MIN),
            json!(u64::MAX),
            json!([0.1, -1e-300, 1e21, f64::MAX, f64::MIN_POSITIVE, 2.0, -0.0, null]),
            json!(all_letters),
            json!({ "": { "a b": [], "\"": {} }, "ü.x": [[1], ["two", { "three": 3.5 }]] }),
        ] {
            let through = serde_json::Value::deserialize(&DocumentValue::from(&value));
            assert_eq!(through.expect("a value"), value);
        }
        let given = json!({ "a": null, "b": { "c": null, "d": 1 } });
        let through = serde_json::Value::deserialize(&DocumentValue::from(&given));
        assert_eq!(through.expect("a value"), json!({ "b": { "d": 1 } }));
    }
}
