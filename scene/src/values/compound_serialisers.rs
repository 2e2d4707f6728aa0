//! Lists, maps and structs of a serialiser that does the same everywhere in a value: it goes on with each part.

/// Implements serde's traits of compounds for `&mut WALKER`.
macro_rules! walk_compounds {
    ($walker:ty, $error:ty) => {
        $crate::values::compound_serialisers::walk_compounds! { $walker, $error,
            SerializeSeq { serialize_element() }
            SerializeTuple { serialize_element() }
            SerializeTupleStruct { serialize_field() }
            SerializeTupleVariant { serialize_field() }
            SerializeMap { serialize_key(), serialize_value() }
            SerializeStruct { serialize_field(&'static str) }
            SerializeStructVariant { serialize_field(&'static str) }
        }
    };
    ($walker:ty, $error:ty, $($trait:ident { $($method:ident($($name:ty)?)),* })*) => {
        $(impl serde::ser::$trait for &mut $walker {
            type Ok = ();
            type Error = $error;
            $(fn $method<T: serde::Serialize + ?Sized>(
                &mut self,
                $(_: $name,)?
                value: &T,
            ) -> Result<(), $error> {
                value.serialize(&mut **self)
            })*
            fn end(self) -> Result<(), $error> {
                Ok(())
            }
        })*
    };
}
pub(crate) use walk_compounds;
