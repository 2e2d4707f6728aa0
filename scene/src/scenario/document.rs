//! A TOML document with source positions: typed access whose errors give the position.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;

use serde::de::DeserializeOwned;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::error::ScenarioError;
use crate::document_value::DocumentValue;
use crate::entity::{Entity, with_entity_names};
use crate::readable::given;

/// The text of a scenario and its origin.
#[derive(Debug)]
pub(super) struct Source {
    pub file: PathBuf,
    pub text: String,
}

impl Source {
    pub fn error(
        &self,
        span: Range<usize>,
        key: impl Into<String>,
        reason: impl Into<String>,
    ) -> ScenarioError {
        let (line, column) = self.line_and_column(span.start);
        ScenarioError::Invalid {
            file: self.file.clone(),
            line,
            column,
            key: key.into(),
            reason: reason.into(),
        }
    }

    pub fn line_and_column(&self, offset: usize) -> (usize, usize) {
        let mut offset = offset.min(self.text.len());
        while !self.text.is_char_boundary(offset) {
            offset -= 1;
        }
        let before = &self.text[..offset];
        let line_start = before.rfind('\n').map_or(0, |at| at + 1);
        (1 + before.matches('\n').count(), 1 + before[line_start..].chars().count())
    }

    pub fn parse(&self) -> Result<Spanned<DeTable<'_>>, ScenarioError> {
        DeTable::parse(&self.text)
            .map_err(|error| self.error(error.span().unwrap_or(0..0), "", error.message().trim()))
    }
}

/// A table of the document.
#[derive(Clone, Copy)]
pub(super) struct Table<'a> {
    pub source: &'a Source,
    /// Name of the table in messages.
    pub key: &'a str,
    pub span: (usize, usize),
    pub table: &'a DeTable<'a>,
}

impl<'a> Table<'a> {
    pub fn new(source: &'a Source, key: &'a str, span: Range<usize>, table: &'a DeTable<'a>) -> Self {
        Self { source, key, span: (span.start, span.end), table }
    }

    pub fn span(&self) -> Range<usize> {
        self.span.0..self.span.1
    }

    pub fn error(&self, span: Range<usize>, key: &str, reason: impl Into<String>) -> ScenarioError {
        self.source.error(span, join(self.key, key), reason)
    }

    /// Refuses keys that are not in `known`, naming those.
    pub fn only(&self, known: &[&str]) -> Result<(), ScenarioError> {
        let Some(unknown) = self.table.keys().find(|key| !known.contains(&key.get_ref().as_ref())) else {
            return Ok(());
        };
        let reason = format!("unknown key '{}'; there are: {}", shown(unknown.get_ref()), known.join(", "));
        Err(self.error(unknown.span(), "", reason))
    }

    pub fn get(&self, key: &str) -> Option<&'a Spanned<DeValue<'a>>> {
        self.table.get(key)
    }

    pub fn require(&self, key: &str) -> Result<&'a Spanned<DeValue<'a>>, ScenarioError> {
        self.get(key).ok_or_else(|| self.error(self.span(), "", format!("the key '{key}' is missing")))
    }

    pub fn string(&self, key: &str) -> Result<Option<(&'a str, Range<usize>)>, ScenarioError> {
        let Some(value) = self.get(key) else { return Ok(None) };
        match value.get_ref().as_str() {
            Some(text) => Ok(Some((text, value.span()))),
            None => Err(self.wrong_type(key, value, "a string")),
        }
    }

    pub fn wrong_type(&self, key: &str, value: &Spanned<DeValue>, expected: &str) -> ScenarioError {
        let found = value.get_ref().type_str();
        self.error(value.span(), key, format!("{expected} is expected, found {found}"))
    }

    /// The value of a key as any type that can be deserialised; `None` when the key is absent.
    pub fn value<T: DeserializeOwned>(&self, key: &str) -> Result<Option<T>, ScenarioError> {
        let Some(value) = self.get(key) else { return Ok(None) };
        T::deserialize(&DocumentValue::from(value))
            .map(Some)
            .map_err(|error| self.error(error.place().unwrap_or(value.span()), key, error.message().trim()))
    }

    /// A number in a range, whose text goes into the message.
    pub fn number(
        &self,
        key: &str,
        range: std::ops::RangeInclusive<f64>,
        valid: &str,
    ) -> Result<Option<f64>, ScenarioError> {
        let Some(value) = self.value::<f64>(key)? else { return Ok(None) };
        if range.contains(&value) {
            return Ok(Some(value));
        }
        let span = self.get(key).map_or(self.span(), Spanned::span);
        Err(self.error(span, key, format!("{} is out of range ({valid})", given(value))))
    }

    /// The tables of an array of tables; a single table is a list of one.
    pub fn tables(&self, key: &str) -> Result<Vec<(Range<usize>, &'a DeTable<'a>)>, ScenarioError> {
        let Some(value) = self.get(key) else { return Ok(Vec::new()) };
        let items = value
            .get_ref()
            .as_array()
            .ok_or_else(|| self.wrong_type(key, value, &format!("an array of tables ([[{key}]])")))?;
        items
            .iter()
            .map(|item| match item.get_ref().as_table() {
                Some(table) => Ok((item.span(), table)),
                None => Err(self.wrong_type(key, item, "a table")),
            })
            .collect()
    }
}

/// The place of the key, or of the text, that a reason names: its first word, a word in quotes, before a colon, or with
/// an underscore, when the value has such a key at any depth (`jaw_force_max: 60 is out of range`). The shallowest one
/// counts, and of a path such as `springs.surface` its last key.
pub(super) fn named_in(value: &Spanned<DeValue<'_>>, reason: &str) -> Option<Range<usize>> {
    let is_part = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '.' || c == '-';
    let mut at = 0;
    while let Some(start) = reason[at..].find(is_part).map(|found| at + found) {
        let end = reason[start..].find(|c| !is_part(c)).map_or(reason.len(), |found| start + found);
        let word = reason[start..end].trim_matches('.');
        let is_quoted = reason[..start].ends_with(['\'', '`', '"']);
        let names = start == 0 || is_quoted || word.contains('_') || reason[end..].starts_with(':');
        if names
            && let Some(place) = key_at(value, word).or_else(|| text_at(value, word).filter(|_| is_quoted))
        {
            return Some(place);
        }
        at = end;
    }
    None
}

/// The place of the value under a key, or a path of keys, at any depth: the shallowest one.
fn key_at(value: &Spanned<DeValue<'_>>, path: &str) -> Option<Range<usize>> {
    let below = |from: &Spanned<DeValue<'_>>| {
        let mut span = None;
        let mut at = from;
        for key in path.split('.') {
            at = at.get_ref().as_table()?.get(key)?;
            span = Some(at.span());
        }
        span
    };
    first_of(value, &below)
}

/// The place of the first number that is not finite, at any depth.
pub(super) fn not_finite_in(value: &Spanned<DeValue<'_>>) -> Option<Range<usize>> {
    first_of(value, &|at| match at.get_ref() {
        DeValue::Float(number) => {
            let text = number.as_str();
            (text.contains("inf") || text.contains("nan")).then(|| at.span())
        }
        _ => None,
    })
}

/// The place of a text, at any depth: the shallowest one.
fn text_at(value: &Spanned<DeValue<'_>>, text: &str) -> Option<Range<usize>> {
    first_of(value, &|at| (at.get_ref().as_str() == Some(text)).then(|| at.span()))
}

/// What is found first, breadth first, in a value and all below it.
fn first_of(
    value: &Spanned<DeValue<'_>>,
    find: &dyn Fn(&Spanned<DeValue<'_>>) -> Option<Range<usize>>,
) -> Option<Range<usize>> {
    let mut level = vec![value];
    while !level.is_empty() {
        if let Some(found) = level.iter().find_map(|at| find(at)) {
            return Some(found);
        }
        level = level
            .iter()
            .flat_map(|at| match at.get_ref() {
                DeValue::Table(table) => table.values().collect(),
                DeValue::Array(items) => items.iter().collect(),
                _ => Vec::new(),
            })
            .collect();
    }
    None
}

/// `outer, inner`, or whichever is not empty.
pub(super) fn join(outer: &str, inner: &str) -> String {
    match (outer, inner) {
        (outer, "") => outer.to_owned(),
        ("", inner) => inner.to_owned(),
        (outer, inner) => format!("{outer}, {inner}"),
    }
}

/// Quotes text from the file for a message: short, and without control characters.
pub(super) fn shown(text: &str) -> String {
    let dots = if text.chars().count() > 60 { "…" } else { "" };
    text.chars().take(60).flat_map(char::escape_default).chain(dots.chars()).collect()
}

/// A table of uninterpreted parameters, with its position in the file.
#[derive(Clone, Debug)]
pub struct Params {
    source: Option<Arc<Source>>,
    /// From the root: array and index, or key.
    path: Vec<Step>,
    owner: String,
    names: Arc<BTreeMap<String, Entity>>,
}

#[derive(Clone, Debug)]
pub(super) enum Step {
    Key(String),
    Index(usize),
}

impl Params {
    pub(super) fn new(
        source: &Arc<Source>,
        path: Vec<Step>,
        owner: String,
        names: &Arc<BTreeMap<String, Entity>>,
    ) -> Self {
        Self { source: Some(source.clone()), path, owner, names: names.clone() }
    }

    /// No parameters, for an owner without a file.
    pub fn none(owner: impl Into<String>) -> Self {
        Self { source: None, path: Vec::new(), owner: owner.into(), names: Arc::default() }
    }

    /// Owner of the parameters, for messages.
    pub fn owner(&self) -> &str {
        &self.owner
    }

    /// Interprets the parameters as `T`; entities may be written by name. Without any parameters an empty table
    /// is interpreted, so that defaults apply.
    ///
    /// # Errors
    /// Names the position and the invalid key.
    pub fn parse<T: DeserializeOwned>(&self) -> Result<T, ScenarioError> {
        let value = match &self.source {
            None => None,
            Some(source) => self.find(source.parse()?).ok(),
        };
        let value = value.unwrap_or_else(|| Spanned::new(0..0, DeValue::Table(DeTable::new())));
        let span = value.span();
        with_entity_names(self.names.as_ref().clone(), || T::deserialize(&DocumentValue::from(&value)))
            .map_err(|error| match (&self.source, error.place()) {
                // An absent table has no position: the owner's is used.
                (Some(source), Some(at)) if span != (0..0) => {
                    source.error(at, self.owner.clone(), error.message().trim())
                }
                _ => self.error(error.message().trim()),
            })
    }

    /// The parameters' table, or if absent, the owner's position.
    fn find<'i>(&self, document: Spanned<DeTable<'i>>) -> Result<Spanned<DeValue<'i>>, Range<usize>> {
        let mut value = Spanned::new(document.span(), DeValue::Table(document.into_inner()));
        for step in &self.path {
            let next = match step {
                Step::Key(key) => value.get_ref().get(key.as_str()).cloned(),
                Step::Index(index) => value.get_ref().get(*index).cloned(),
            };
            value = next.ok_or_else(|| value.span())?;
        }
        Ok(value)
    }

    /// An error about these parameters that [`Params::parse`] does not check, such as a range. It stands at the key
    /// that the reason names, if there is one: `seconds: -1 is out of range`.
    pub fn error(&self, reason: impl Into<String>) -> ScenarioError {
        let reason = reason.into();
        match &self.source {
            Some(source) => source.error(self.span(&reason), self.owner.clone(), reason),
            None => ScenarioError::Invalid {
                file: PathBuf::new(),
                line: 0,
                column: 0,
                key: self.owner.clone(),
                reason,
            },
        }
    }

    /// The place of what a reason names, or else of the parameters.
    fn span(&self, reason: &str) -> Range<usize> {
        match self.source.as_ref().and_then(|source| source.parse().ok()) {
            Some(document) => self
                .find(document)
                .map_or_else(|place| place, |value| named_in(&value, reason).unwrap_or_else(|| value.span())),
            None => 0..0,
        }
    }
}
