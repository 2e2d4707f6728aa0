//! States that are copied in every step: into lists that are there already.

/// Implements `Clone` for a struct of these fields. What can be derived makes every list anew on `clone_from`.
macro_rules! clones_in_place {
    ($state:ident { $($field:ident),+ $(,)? }) => {
        impl Clone for $state {
            fn clone(&self) -> Self {
                Self { $($field: Clone::clone(&self.$field)),+ }
            }

            fn clone_from(&mut self, from: &Self) {
                $(Clone::clone_from(&mut self.$field, &from.$field);)+
            }
        }
    };
}

pub(crate) use clones_in_place;
