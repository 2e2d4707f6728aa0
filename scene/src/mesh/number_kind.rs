//! The types of numbers in PLY and VTK files.

use super::cursor::{Cursor, LazyPosition, Order, quoted};
use super::error::MeshError;

/// Type of a number in an array.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum NumberKind {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

impl NumberKind {
    /// By its name in PLY, legacy VTK or VTK's XML, in any capitals.
    pub fn parse(cursor: &Cursor, place: LazyPosition, name: &str) -> Result<Self, MeshError> {
        Ok(match name.to_ascii_lowercase().as_str() {
            "char" | "signed_char" | "int8" | "vtktypeint8" => Self::I8,
            "unsigned_char" | "uchar" | "uint8" | "vtktypeuint8" => Self::U8,
            "short" | "int16" | "vtktypeint16" => Self::I16,
            "unsigned_short" | "ushort" | "uint16" | "vtktypeuint16" => Self::U16,
            "int" | "int32" | "vtktypeint32" => Self::I32,
            "unsigned_int" | "uint" | "uint32" | "vtktypeuint32" => Self::U32,
            // VTK writes `long` with 8 bytes on all current platforms.
            "long" | "long_long" | "int64" | "vtktypeint64" | "vtkidtype" => Self::I64,
            "unsigned_long" | "unsigned_long_long" | "uint64" | "vtktypeuint64" => Self::U64,
            "float" | "float32" | "vtktypefloat32" => Self::F32,
            "double" | "float64" | "vtktypefloat64" => Self::F64,
            _ => {
                let what = format!("data type {}", quoted(name.as_bytes()));
                let supported = "char, short, int, long, int8 to int64, vtktypeint8 to vtktypeint64, their unsigned \
                                 kinds, float, double";
                return Err(cursor.unsupported(place, what, supported));
            }
        })
    }

    pub fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }

    pub fn is_whole(self) -> bool {
        !matches!(self, Self::F32 | Self::F64)
    }

    /// The first number in `bytes`, which hold at least one.
    pub fn number(self, bytes: &[u8], order: Order) -> f64 {
        match self {
            Self::F32 => f32::from_bits(self.bits(bytes, order) as u32).into(),
            Self::F64 => f64::from_bits(self.bits(bytes, order)),
            Self::U64 => self.bits(bytes, order) as f64,
            _ => self.whole(bytes, order) as f64,
        }
    }

    /// The first whole number in `bytes`, which hold at least one; what exceeds the range becomes its end, and a fraction
    /// is cut off.
    pub fn whole(self, bytes: &[u8], order: Order) -> i64 {
        let bits = self.bits(bytes, order);
        match self {
            Self::I8 => (bits as i8).into(),
            Self::I16 => (bits as i16).into(),
            Self::I32 => (bits as i32).into(),
            Self::U64 => i64::try_from(bits).unwrap_or(i64::MAX),
            Self::F32 | Self::F64 => self.number(bytes, order) as i64,
            _ => bits as i64,
        }
    }

    fn bits(self, bytes: &[u8], order: Order) -> u64 {
        let mut raw = [0; 8];
        let width = self.bytes();
        raw[..width].copy_from_slice(&bytes[..width]);
        if order == Order::Big {
            raw[..width].reverse();
        }
        u64::from_le_bytes(raw)
    }
}
