//! Values taken apart by code that knows no component: their numbers checked, listed, and written.

mod compound_serialisers;
pub mod finite;
pub mod leaves;
pub mod varint;
