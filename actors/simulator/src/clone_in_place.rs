//! `clone_from` for states copied in every step, reusing their lists.

/// Implements `Clone` for a struct with these fields. The derived one reallocates every list in `clone_from`.
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
