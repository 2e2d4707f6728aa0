//! Finite check: a serialiser that visits every number of a value and writes nothing.

use std::fmt;

use serde::ser::{self, Serialize, Serializer};

use super::compound_serialisers::walk_compounds;
use crate::component::ComponentError;

/// Refuses a value that contains a NaN or an infinity anywhere. Allocates nothing.
///
/// # Errors
/// [`ComponentError::NotFinite`] with the position of the first such number.
pub fn check<T: Serialize + ?Sized>(value: &T) -> Result<(), ComponentError> {
    let mut walker = Walker { index: 0 };
    value.serialize(&mut walker).map_err(|found| match found {
        Found::NotFinite(index) => ComponentError::NotFinite { index },
        Found::Unserialisable => ComponentError::Malformed("the value cannot be serialised".into()),
    })
}

struct Walker {
    index: usize,
}

#[derive(Debug)]
enum Found {
    NotFinite(usize),
    Unserialisable,
}

impl fmt::Display for Found {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{self:?}")
    }
}
impl std::error::Error for Found {}
impl ser::Error for Found {
    fn custom<T: fmt::Display>(_: T) -> Self {
        Found::Unserialisable
    }
}

impl Walker {
    fn number(&mut self, finite: bool) -> Result<(), Found> {
        let index = self.index;
        self.index += 1;
        if finite { Ok(()) } else { Err(Found::NotFinite(index)) }
    }
}

macro_rules! accept {
    ($($method:ident: $type:ty),* $(,)?) => {
        $(fn $method(self, _: $type) -> Result<(), Found> { Ok(()) })*
    };
}

impl Serializer for &mut Walker {
    type Ok = ();
    type Error = Found;
    type SerializeSeq = Self;
    type SerializeTuple = Self;
    type SerializeTupleStruct = Self;
    type SerializeTupleVariant = Self;
    type SerializeMap = Self;
    type SerializeStruct = Self;
    type SerializeStructVariant = Self;

    accept! {
        serialize_bool: bool, serialize_char: char, serialize_str: &str, serialize_bytes: &[u8],
    }
    // Integers count as numbers too, so that the index a user reads does not depend on their kind.
    fn serialize_i8(self, _: i8) -> Result<(), Found> {
        self.number(true)
    }
    fn serialize_i16(self, _: i16) -> Result<(), Found> {
        self.number(true)
    }
    fn serialize_i32(self, _: i32) -> Result<(), Found> {
        self.number(true)
    }
    fn serialize_i64(self, _: i64) -> Result<(), Found> {
        self.number(true)
    }
    fn serialize_u8(self, _: u8) -> Result<(), Found> {
        self.number(true)
    }
    fn serialize_u16(self, _: u16) -> Result<(), Found> {
        self.number(true)
    }
    fn serialize_u32(self, _: u32) -> Result<(), Found> {
        self.number(true)
    }
    fn serialize_u64(self, _: u64) -> Result<(), Found> {
        self.number(true)
    }
    fn serialize_f32(self, value: f32) -> Result<(), Found> {
        self.number(value.is_finite())
    }
    fn serialize_f64(self, value: f64) -> Result<(), Found> {
        self.number(value.is_finite())
    }
    fn serialize_none(self) -> Result<(), Found> {
        Ok(())
    }
    fn serialize_some<T: Serialize + ?Sized>(self, value: &T) -> Result<(), Found> {
        value.serialize(self)
    }
    fn serialize_unit(self) -> Result<(), Found> {
        Ok(())
    }
    fn serialize_unit_struct(self, _: &'static str) -> Result<(), Found> {
        Ok(())
    }
    fn serialize_unit_variant(self, _: &'static str, _: u32, _: &'static str) -> Result<(), Found> {
        Ok(())
    }
    fn serialize_newtype_struct<T: Serialize + ?Sized>(
        self,
        _: &'static str,
        value: &T,
    ) -> Result<(), Found> {
        value.serialize(self)
    }
    fn serialize_newtype_variant<T: Serialize + ?Sized>(
        self,
        _: &'static str,
        _: u32,
        _: &'static str,
        value: &T,
    ) -> Result<(), Found> {
        value.serialize(self)
    }
    fn serialize_seq(self, _: Option<usize>) -> Result<Self, Found> {
        Ok(self)
    }
    fn serialize_tuple(self, _: usize) -> Result<Self, Found> {
        Ok(self)
    }
    fn serialize_tuple_struct(self, _: &'static str, _: usize) -> Result<Self, Found> {
        Ok(self)
    }
    fn serialize_tuple_variant(
        self,
        _: &'static str,
        _: u32,
        _: &'static str,
        _: usize,
    ) -> Result<Self, Found> {
        Ok(self)
    }
    fn serialize_map(self, _: Option<usize>) -> Result<Self, Found> {
        Ok(self)
    }
    fn serialize_struct(self, _: &'static str, _: usize) -> Result<Self, Found> {
        Ok(self)
    }
    fn serialize_struct_variant(
        self,
        _: &'static str,
        _: u32,
        _: &'static str,
        _: usize,
    ) -> Result<Self, Found> {
        Ok(self)
    }
    fn is_human_readable(&self) -> bool {
        false
    }
    fn collect_str<T: fmt::Display + ?Sized>(self, _: &T) -> Result<(), Found> {
        Ok(())
    }
}

walk_compounds!(Walker, Found);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_position_of_a_bad_number_is_named() {
        assert!(check(&(1.0, [2.0, 3.0], "text", Some(4u8))).is_ok());
        assert_eq!(check(&[1.0, f64::NAN]), Err(ComponentError::NotFinite { index: 1 }));
        assert_eq!(check(&(7u32, f32::INFINITY)), Err(ComponentError::NotFinite { index: 1 }));
    }
}
