//! Writes the implementation.

use proc_macro2::TokenStream;
use quote::{quote, quote_spanned};
use syn::spanned::Spanned;
use syn::{DeriveInput, Error, Path, Result};

use crate::attribute::Settings;

/// The implementation, or the error at its place. `krate` is the path of `trocar_scene` unless the attribute names one.
pub fn or_error(item: TokenStream, krate: &str) -> TokenStream {
    implementation(item, krate).unwrap_or_else(|error| error.to_compile_error())
}

fn implementation(item: TokenStream, krate: &str) -> Result<TokenStream> {
    let item: DeriveInput = syn::parse2(item)?;
    let settings = Settings::read(&item.attrs)?;
    let name = settings.name.ok_or_else(|| {
        Error::new(item.ident.span(), "a component has a name: write #[component(name = \"…\")] as well")
    })?;
    let krate: Path = match settings.krate {
        Some(path) => path,
        None => syn::parse_str(krate)?,
    };
    let record = settings.record.map(|record| {
        quote! { const RECORD: #krate::component::RecordPolicy = #record; }
    });
    let soft_body = settings.soft_body.map(|abilities| {
        quote! {
            const SOFT_BODY: ::core::option::Option<#krate::soft_body::SoftAbilities> =
                ::core::option::Option::Some(#abilities);
        }
    });
    let partners = settings.partners.map(|partners| {
        quote! {
            const PARTNERS: ::core::option::Option<fn(&Self) -> ::std::vec::Vec<&str>> =
                ::core::option::Option::Some(#partners);
        }
    });
    let fits = settings.fits.map(|fits| {
        quote! {
            const FITS: ::core::option::Option<#krate::component::Fits<Self>> =
                ::core::option::Option::Some(#fits);
        }
    });
    let lays = settings.lays.map(|lays| {
        quote! {
            const LAYS: ::core::option::Option<#krate::component::Lays<Self>> =
                ::core::option::Option::Some(#lays);
        }
    });
    // The calls have the places of the paths, so that an error about a function is shown there.
    let check = settings.check.map(|check| {
        let call = quote_spanned! { check.span() => #check(self) };
        quote! {
            fn check(&self) -> ::core::result::Result<(), #krate::component::ComponentError> {
                #krate::finite::check(self)?;
                #call
            }
        }
    });
    let listed = settings.listed.map(|listed| {
        let call = quote_spanned! { listed.span() => #listed(self) };
        quote! {
            fn listed(&self) -> ::core::option::Option<::core::primitive::u64> {
                ::core::option::Option::Some(#call)
            }
        }
    });
    let schema = settings.schema.map(|place| {
        let call = quote_spanned! { place => #krate::component::schema_of::<Self>() };
        quote! {
            fn schema() -> ::core::option::Option<#krate::component::SchemaValue> {
                ::core::option::Option::Some(#call)
            }
        }
    });
    let ident = item.ident;
    let (parameters, arguments, bounds) = item.generics.split_for_impl();
    Ok(quote! {
        #[automatically_derived]
        impl #parameters #krate::component::Component for #ident #arguments #bounds {
            const NAME: &'static ::core::primitive::str = #name;
            #record
            #soft_body
            #partners
            #fits
            #lays
            #check
            #listed
            #schema
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The implementation without white space.
    fn derived(item: TokenStream) -> String {
        let text = implementation(item, "::trocar_scene").expect("a sound type").to_string();
        text.split_whitespace().collect()
    }

    #[test]
    fn a_name_is_enough_and_every_other_key_adds_its_own_item() {
        let plain = derived(quote! {
            #[component(name = "pulse")]
            struct Pulse(f64);
        });
        assert_eq!(
            plain,
            "#[automatically_derived]impl::trocar_scene::component::ComponentforPulse\
             {constNAME:&'static::core::primitive::str=\"pulse\";}"
        );
        let full = derived(quote! {
            #[component(name = NAMES[N], check = Self::ranges, schema)]
            #[component(record = RecordPolicy::Derived, soft_body = Soft { cuts: true, ..Soft::NONE })]
            #[component(partners = partners, listed = Self::count, crate = my::scene)]
            #[component(fits = fits, lays = Self::nodes)]
            enum Pulse<const N: usize> where [(); N]: Sized { A, B }
        });
        for part in [
            "impl<constN:usize>my::scene::component::ComponentforPulse<N>where[();N]:Sized{",
            "constNAME:&'static::core::primitive::str=NAMES[N];",
            "constRECORD:my::scene::component::RecordPolicy=RecordPolicy::Derived;",
            "=::core::option::Option::Some(Soft{cuts:true,..Soft::NONE});",
            "Vec<&str>>=::core::option::Option::Some(partners);",
            "constFITS:::core::option::Option<my::scene::component::Fits<Self>>=::core::option::Option::Some(fits);",
            "constLAYS:::core::option::Option<my::scene::component::Lays<Self>>=::core::option::Option::Some(Self::nodes);",
            "{my::scene::finite::check(self)?;Self::ranges(self)}",
            "{::core::option::Option::Some(Self::count(self))}",
            "{::core::option::Option::Some(my::scene::component::schema_of::<Self>())}",
        ] {
            assert!(full.contains(part), "{part}\n{full}");
        }
    }

    #[test]
    fn a_fault_in_the_attribute_is_named() {
        for (text, message) in [
            ("struct P;", "a component has a name: write #[component(name = \"…\")] as well"),
            ("#[component(nam = \"a\")] struct P;", "unknown key of 'component'; there are: name, check, "),
            ("#[component(name = 3)] struct P;", "a name is a text"),
            ("#[component(name = \"Pulse\")] struct P;", "a name is in lower case: letters, digits and "),
            ("#[component(name = \"a\", name = \"b\")] struct P;", "this key stands here twice"),
            ("#[component(name = \"a\", schema, schema)] struct P;", "this key stands here twice"),
            ("#[component(name = \"a\", schema = of)] struct P;", "'schema' takes no value"),
            ("#[component(name = \"a\", check = \"ranges\")] struct P;", "a path is expected here, such as "),
            ("#[component(name)] struct P;", "expected `=`"),
            ("#[component] struct P;", "expected attribute arguments in parentheses"),
        ] {
            let error = implementation(text.parse().expect("tokens"), "::trocar_scene").expect_err(text);
            assert!(error.to_string().starts_with(message), "{text}: {error}");
        }
    }
}
