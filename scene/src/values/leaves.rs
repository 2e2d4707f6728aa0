//! Leaves of a value: its numbers and texts in the order of serialisation, with a description of what lies between them.
//!
//! [`Leaves::of`] is a serialiser; [`Leaves::encode`] writes the same bytes that postcard writes for the value, so that
//! values can be changed and compared number by number by code that knows no component.

use std::fmt;

use serde::ser::{self, Serialize, Serializer};

use super::compound_serialisers::walk_compounds;
use super::varint;
use crate::component::ComponentError;

/// Kind of a leaf, or of what stands between leaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum LeafKind {
    /// A truth value; 0 or 1.
    Bool,
    /// An unsigned integer of one byte.
    U8,
    /// A signed integer of one byte.
    I8,
    /// A longer unsigned integer.
    Unsigned,
    /// A longer signed integer, sign-extended.
    Signed,
    /// A float of four bytes; its bits are those of the same number in eight bytes.
    F32,
    /// A float of eight bytes.
    F64,
    /// A text or bytes; the leaf is their length.
    Text,
    /// An option without a value: no leaf.
    None,
    /// An option with a value: no leaf.
    Some,
    /// A sequence or a map with that many elements: no leaf.
    Sequence,
    /// The variant of that number: no leaf.
    Variant,
}

impl LeafKind {
    const ALL: [Self; 12] = [
        Self::Bool,
        Self::U8,
        Self::I8,
        Self::Unsigned,
        Self::Signed,
        Self::F32,
        Self::F64,
        Self::Text,
        Self::None,
        Self::Some,
        Self::Sequence,
        Self::Variant,
    ];
    /// The kind of that number.
    pub fn from_number(number: u8) -> Option<Self> {
        Self::ALL.get(usize::from(number)).copied()
    }
    /// Whether it stands for leaves, of which a run may hold several.
    pub fn is_leaf(self) -> bool {
        (self as u8) <= Self::Text as u8
    }
    /// Whether it is a number with a fraction.
    pub fn is_float(self) -> bool {
        matches!(self, Self::F32 | Self::F64)
    }
}

/// Some neighbouring leaves of one kind, or something between leaves with its number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct LeafRun {
    /// The kind.
    pub kind: LeafKind,
    /// How many leaves; the length of a sequence; the number of a variant.
    pub count: u32,
}

/// The leaves of a value.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Leaves {
    /// What the value looks like: values that differ only in their leaves have the same shape.
    pub shape: Vec<LeafRun>,
    /// One word for each leaf.
    pub bits: Vec<u64>,
    /// The bytes of all texts.
    pub text: Vec<u8>,
}

impl Leaves {
    /// Empties them and keeps the capacity.
    pub fn clear(&mut self) {
        self.shape.clear();
        self.bits.clear();
        self.text.clear();
    }

    /// Replaces them by the leaves of a value.
    ///
    /// # Errors
    /// When the value has something that recordings cannot hold, such as an integer of 128 bits.
    pub fn of<T: Serialize + ?Sized>(&mut self, value: &T) -> Result<(), ComponentError> {
        self.clear();
        value.serialize(&mut Walker(self)).map_err(|error| ComponentError::Malformed(error.0))
    }

    /// Appends the value's postcard encoding. Leaves that no value has give bytes that no value has.
    pub fn encode(&self, out: &mut Vec<u8>) {
        let (mut bits, mut text) = (self.bits.iter().copied(), &self.text[..]);
        for run in &self.shape {
            match run.kind {
                LeafKind::None => out.push(0),
                LeafKind::Some => out.push(1),
                LeafKind::Sequence | LeafKind::Variant => varint::write(u64::from(run.count), out),
                kind => {
                    for leaf in bits.by_ref().take(run.count as usize) {
                        encode_leaf(kind, leaf, &mut text, out);
                    }
                }
            }
        }
    }

    /// Rounds every number with a fraction to a whole multiple of `step`, a power of two. Numbers that have no multiple
    /// of it beside them stay.
    pub fn round(&mut self, step: f64) {
        let mut at = 0;
        for run in self.shape.iter().filter(|run| run.kind.is_leaf()) {
            let leaves = &mut self.bits[at..at + run.count as usize];
            at += run.count as usize;
            if run.kind.is_float() {
                for leaf in leaves {
                    *leaf = round_to(f64::from_bits(*leaf), step, run.kind).to_bits();
                }
            }
        }
    }
}

fn round_to(value: f64, step: f64, kind: LeafKind) -> f64 {
    // Adding zero turns −0 into 0, which is a multiple like any other.
    let rounded = (value / step).round() * step + 0.0;
    let is_held = kind == LeafKind::F64 || f64::from(rounded as f32).to_bits() == rounded.to_bits();
    if rounded.is_finite() && is_held { rounded } else { value }
}

fn encode_leaf(kind: LeafKind, leaf: u64, text: &mut &[u8], out: &mut Vec<u8>) {
    match kind {
        LeafKind::Bool | LeafKind::U8 | LeafKind::I8 => out.push(leaf as u8),
        LeafKind::Unsigned => varint::write(leaf, out),
        LeafKind::Signed => varint::write(varint::zigzag(leaf as i64), out),
        LeafKind::F32 => out.extend_from_slice(&(f64::from_bits(leaf) as f32).to_le_bytes()),
        LeafKind::F64 => out.extend_from_slice(&leaf.to_le_bytes()),
        _ => {
            varint::write(leaf, out);
            let length = usize::try_from(leaf).unwrap_or(usize::MAX).min(text.len());
            let (this, rest) = text.split_at(length);
            out.extend_from_slice(this);
            *text = rest;
        }
    }
}

/// A value that has no leaves of these kinds.
#[derive(Debug)]
struct Unsuitable(String);

impl fmt::Display for Unsuitable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}
impl std::error::Error for Unsuitable {}
impl ser::Error for Unsuitable {
    fn custom<T: fmt::Display>(message: T) -> Self {
        Self(message.to_string())
    }
}

/// Writes the leaves of a value.
struct Walker<'a>(&'a mut Leaves);

impl Walker<'_> {
    fn leaf(&mut self, kind: LeafKind, bits: u64) -> Result<(), Unsuitable> {
        self.0.bits.push(bits);
        match self.0.shape.last_mut() {
            Some(run) if run.kind == kind && run.count < u32::MAX => run.count += 1,
            _ => self.0.shape.push(LeafRun { kind, count: 1 }),
        }
        Ok(())
    }

    fn between(&mut self, kind: LeafKind, count: usize) -> Result<&mut Self, Unsuitable> {
        let count = u32::try_from(count).map_err(|_| Unsuitable("a list that is too long".to_owned()))?;
        self.0.shape.push(LeafRun { kind, count });
        Ok(self)
    }

    fn text(&mut self, bytes: &[u8]) -> Result<(), Unsuitable> {
        self.0.text.extend_from_slice(bytes);
        self.leaf(LeafKind::Text, bytes.len() as u64)
    }
}

macro_rules! leaves {
    ($($method:ident: $type:ty => $kind:ident, $bits:expr;)*) => {
        $(fn $method(self, value: $type) -> Result<(), Unsuitable> {
            let bits: fn($type) -> u64 = $bits;
            self.leaf(LeafKind::$kind, bits(value))
        })*
    };
}

impl Serializer for &mut Walker<'_> {
    type Ok = ();
    type Error = Unsuitable;
    type SerializeSeq = Self;
    type SerializeTuple = Self;
    type SerializeTupleStruct = Self;
    type SerializeTupleVariant = Self;
    type SerializeMap = Self;
    type SerializeStruct = Self;
    type SerializeStructVariant = Self;

    leaves! {
        serialize_bool: bool => Bool, u64::from;
        serialize_u8: u8 => U8, u64::from;
        serialize_u16: u16 => Unsigned, u64::from;
        serialize_u32: u32 => Unsigned, u64::from;
        serialize_u64: u64 => Unsigned, |value| value;
        serialize_i8: i8 => I8, |value| i64::from(value) as u64;
        serialize_i16: i16 => Signed, |value| i64::from(value) as u64;
        serialize_i32: i32 => Signed, |value| i64::from(value) as u64;
        serialize_i64: i64 => Signed, |value| value as u64;
        serialize_f32: f32 => F32, |value| f64::from(value).to_bits();
        serialize_f64: f64 => F64, f64::to_bits;
    }
    fn serialize_char(self, value: char) -> Result<(), Unsuitable> {
        self.text(value.encode_utf8(&mut [0; 4]).as_bytes())
    }
    fn serialize_str(self, value: &str) -> Result<(), Unsuitable> {
        self.text(value.as_bytes())
    }
    fn serialize_bytes(self, value: &[u8]) -> Result<(), Unsuitable> {
        self.text(value)
    }
    fn serialize_none(self) -> Result<(), Unsuitable> {
        self.between(LeafKind::None, 0).map(drop)
    }
    fn serialize_some<T: Serialize + ?Sized>(self, value: &T) -> Result<(), Unsuitable> {
        value.serialize(self.between(LeafKind::Some, 0)?)
    }
    fn serialize_unit(self) -> Result<(), Unsuitable> {
        Ok(())
    }
    fn serialize_unit_struct(self, _: &'static str) -> Result<(), Unsuitable> {
        Ok(())
    }
    fn serialize_unit_variant(self, _: &'static str, number: u32, _: &'static str) -> Result<(), Unsuitable> {
        self.between(LeafKind::Variant, number as usize).map(drop)
    }
    fn serialize_newtype_struct<T: Serialize + ?Sized>(
        self,
        _: &'static str,
        value: &T,
    ) -> Result<(), Unsuitable> {
        value.serialize(self)
    }
    fn serialize_newtype_variant<T: Serialize + ?Sized>(
        self,
        _: &'static str,
        number: u32,
        _: &'static str,
        value: &T,
    ) -> Result<(), Unsuitable> {
        value.serialize(self.between(LeafKind::Variant, number as usize)?)
    }
    fn serialize_seq(self, length: Option<usize>) -> Result<Self, Unsuitable> {
        let unknown = || Unsuitable("a list whose length is not known before".to_owned());
        self.between(LeafKind::Sequence, length.ok_or_else(unknown)?)
    }
    fn serialize_tuple(self, _: usize) -> Result<Self, Unsuitable> {
        Ok(self)
    }
    fn serialize_tuple_struct(self, _: &'static str, _: usize) -> Result<Self, Unsuitable> {
        Ok(self)
    }
    fn serialize_tuple_variant(
        self,
        _: &'static str,
        number: u32,
        _: &'static str,
        _: usize,
    ) -> Result<Self, Unsuitable> {
        self.between(LeafKind::Variant, number as usize)
    }
    fn serialize_map(self, length: Option<usize>) -> Result<Self, Unsuitable> {
        self.serialize_seq(length)
    }
    fn serialize_struct(self, _: &'static str, _: usize) -> Result<Self, Unsuitable> {
        Ok(self)
    }
    fn serialize_struct_variant(
        self,
        _: &'static str,
        number: u32,
        _: &'static str,
        _: usize,
    ) -> Result<Self, Unsuitable> {
        self.between(LeafKind::Variant, number as usize)
    }
    fn is_human_readable(&self) -> bool {
        false
    }
}

walk_compounds!(Walker<'_>, Unsuitable);

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use serde::Serialize;

    use super::*;

    #[derive(Serialize)]
    enum Choice {
        Unit,
        New(f32),
        Tuple(i64, char),
        Struct { a: Option<u16>, b: Option<()> },
    }

    fn leaves(value: &impl Serialize) -> Leaves {
        let mut leaves = Leaves::default();
        leaves.of(value).expect("it can be recorded");
        leaves
    }

    #[test]
    fn leaves_give_the_bytes_of_postcard() {
        fn check(value: &impl Serialize) {
            let mut out = Vec::new();
            leaves(value).encode(&mut out);
            assert_eq!(out, postcard::to_stdvec(value).expect("it encodes"));
        }
        check(&(true, 200_u8, -3_i8, 60_000_u16, -60_000_i32, u64::MAX, i64::MIN));
        check(&(1.5_f32, f64::MIN_POSITIVE, -0.0_f64, "naïve", 'é', ()));
        check(&[Choice::Unit, Choice::New(-2.5), Choice::Tuple(-7, 'x')]);
        check(&vec![Choice::Struct { a: Some(5), b: None }, Choice::Struct { a: None, b: Some(()) }]);
        check(&BTreeMap::from([("a", vec![1.0, 2.0]), ("b", vec![])]));
    }

    #[test]
    fn equal_kinds_make_one_run() {
        let leaves = leaves(&vec![[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
        let run = |kind, count| LeafRun { kind, count };
        assert_eq!(leaves.shape, [run(LeafKind::Sequence, 2), run(LeafKind::F64, 6)]);
        assert_eq!(leaves.bits[5], 6.0_f64.to_bits());
    }

    #[test]
    fn rounding_is_to_multiples_and_leaves_the_rest() {
        let mut leaves = leaves(&(0.3, -0.01, 1e300, 7_u32, 0.3_f32, "0.3"));
        leaves.round(0.125);
        let numbers: Vec<f64> = leaves.bits[..3].iter().map(|bits| f64::from_bits(*bits)).collect();
        assert_eq!(numbers, [0.25, 0.0, 1e300]);
        assert_eq!(leaves.bits[1], 0, "no negative zero");
        assert_eq!((leaves.bits[3], leaves.bits[4], leaves.bits[5]), (7, 0.25_f64.to_bits(), 3));
    }
}
