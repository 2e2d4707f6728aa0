//! A value of a document that a person has written, TOML or JSON, with its place in the text. Components and parameters
//! are decoded from it, by `document_decoder.rs`.

use std::fmt;
use std::ops::Range;

use serde::de;
use toml::Spanned;
use toml::de::{DeInteger, DeValue};

/// A value and its place in the text.
#[derive(Clone, Debug)]
pub struct DocumentValue {
    pub(crate) place: Range<usize>,
    pub(crate) kind: Kind,
}

/// What a value is.
#[derive(Clone, Debug)]
pub(crate) enum Kind {
    /// JSON's `null`.
    Null,
    Boolean(bool),
    Integer(i64),
    /// Above the largest signed integer.
    Unsigned(u64),
    Float(f64),
    Text(String),
    List(Vec<DocumentValue>),
    Table(Vec<(Key, DocumentValue)>),
    /// TOML's dates and times.
    Date,
    /// A number without a representation, and why.
    Refused(&'static str),
}

/// A key and its place in the text.
#[derive(Clone, Debug)]
pub(crate) struct Key {
    pub place: Range<usize>,
    pub text: String,
}

/// Why a value is not what is wanted.
#[derive(Debug)]
pub struct DocumentError(Box<Located>);

#[derive(Debug)]
struct Located {
    message: String,
    place: Option<Range<usize>>,
}

impl DocumentError {
    /// What is wrong.
    pub fn message(&self) -> &str {
        &self.0.message
    }
    /// Where, as a range of bytes of the text.
    pub fn place(&self) -> Option<Range<usize>> {
        self.0.place.clone()
    }
    /// The innermost place is kept.
    pub(crate) fn at(mut self, place: &Range<usize>) -> Self {
        self.0.place.get_or_insert_with(|| place.clone());
        self
    }
}

impl fmt::Display for DocumentError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0.message)
    }
}

impl std::error::Error for DocumentError {}

impl de::Error for DocumentError {
    fn custom<T: fmt::Display>(message: T) -> Self {
        Self(Box::new(Located { message: message.to_string(), place: None }))
    }
}

fn integer(number: &DeInteger<'_>) -> Kind {
    let (text, radix) = (number.as_str(), number.radix());
    let signed = i64::from_str_radix(text, radix).map(Kind::Integer);
    let unsigned = || u64::from_str_radix(text, radix).map(Kind::Unsigned);
    signed.or_else(|_| unsigned()).unwrap_or(Kind::Refused("an integer of more than 64 bits"))
}

/// `inf` and `nan` may be written; a number that is too large to be one may not.
fn float(text: &str) -> Kind {
    match text.parse::<f64>() {
        Ok(number) if number.is_finite() || text.contains("inf") || text.contains("nan") => {
            Kind::Float(number)
        }
        _ => Kind::Refused("a number above the largest of 64 bits"),
    }
}

impl From<&Spanned<DeValue<'_>>> for DocumentValue {
    fn from(value: &Spanned<DeValue<'_>>) -> Self {
        let kind = match value.get_ref() {
            DeValue::String(text) => Kind::Text(text.as_ref().to_owned()),
            DeValue::Integer(number) => integer(number),
            DeValue::Float(number) => float(number.as_str()),
            DeValue::Boolean(value) => Kind::Boolean(*value),
            DeValue::Datetime(_) => Kind::Date,
            DeValue::Array(items) => Kind::List(items.iter().map(Self::from).collect()),
            DeValue::Table(table) => {
                let entry = |(key, value): (&Spanned<_>, _)| {
                    let key: &Spanned<std::borrow::Cow<'_, str>> = key;
                    let text = key.get_ref().as_ref().to_owned();
                    (Key { place: key.span(), text }, Self::from(value))
                };
                Kind::Table(table.iter().map(entry).collect())
            }
        };
        Self { place: value.span(), kind }
    }
}

/// An object's keys whose value is `null` are left out: an absent value is written so, too.
impl From<&serde_json::Value> for DocumentValue {
    fn from(value: &serde_json::Value) -> Self {
        use serde_json::Value;
        let kind = match value {
            Value::Null => Kind::Null,
            Value::Bool(value) => Kind::Boolean(*value),
            Value::Number(number) => {
                let signed = number.as_i64().map(Kind::Integer);
                let unsigned = || number.as_u64().map(Kind::Unsigned);
                let float = || number.as_f64().map(Kind::Float);
                signed.or_else(unsigned).or_else(float).unwrap_or(Kind::Refused("a number out of range"))
            }
            Value::String(text) => Kind::Text(text.clone()),
            Value::Array(items) => Kind::List(items.iter().map(Self::from).collect()),
            Value::Object(fields) => {
                let given = fields.iter().filter(|(_, value)| !value.is_null());
                let entry =
                    |(key, value): (&String, _)| (Key { place: 0..0, text: key.clone() }, Self::from(value));
                Kind::Table(given.map(entry).collect())
            }
        };
        Self { place: 0..0, kind }
    }
}
