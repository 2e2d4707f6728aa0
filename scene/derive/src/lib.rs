//! `#[derive(Component)]`: implements the trait of `trocar-scene` of that name. That trait's documentation describes the
//! attribute; this crate is used through it.

mod attribute;
mod expand;

use proc_macro::TokenStream;

/// Implements the trait `Component`: `#[component(name = "irrigation_bag", check = Self::ranges, schema)]`. The trait's
/// documentation has an example, and lists the keys of the attribute.
#[proc_macro_derive(Component, attributes(component))]
pub fn component(item: TokenStream) -> TokenStream {
    expand::or_error(item.into(), "::trocar_scene").into()
}

/// The same for crates that know `trocar_scene` as `trocar::scene`, from where it has the name `Component`.
#[doc(hidden)]
#[proc_macro_derive(ComponentOfTrocar, attributes(component))]
pub fn component_of_trocar(item: TokenStream) -> TokenStream {
    expand::or_error(item.into(), "::trocar::scene").into()
}
