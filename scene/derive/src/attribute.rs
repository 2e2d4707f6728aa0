//! Reads `#[component(…)]`.

use proc_macro2::Span;
use syn::meta::ParseNestedMeta;
use syn::spanned::Spanned;
use syn::{Attribute, Error, Expr, ExprLit, Ident, Lit, Path, Result};

/// The keys, as a message lists them.
const KEYS: &str = "name, check, schema, record, soft_body, partners, fits, lays, listed, crate";

/// What the attributes of a type say.
#[derive(Default)]
pub struct Settings {
    pub name: Option<Expr>,
    pub check: Option<Path>,
    /// Where the flag stands.
    pub schema: Option<Span>,
    pub record: Option<Expr>,
    pub soft_body: Option<Expr>,
    pub partners: Option<Path>,
    pub fits: Option<Path>,
    pub lays: Option<Path>,
    pub listed: Option<Path>,
    pub krate: Option<Path>,
}

impl Settings {
    /// Reads all attributes `component` of a type.
    pub fn read(attributes: &[Attribute]) -> Result<Self> {
        let mut settings = Self::default();
        for attribute in attributes.iter().filter(|attribute| attribute.path().is_ident("component")) {
            attribute.parse_nested_meta(|meta| settings.set(&meta))?;
        }
        Ok(settings)
    }

    fn set(&mut self, meta: &ParseNestedMeta) -> Result<()> {
        let key = meta.path.get_ident().map(Ident::to_string).unwrap_or_default();
        match key.as_str() {
            "name" => {
                let name = value(meta)?;
                check_name(&name)?;
                once(&mut self.name, name, meta)
            }
            "check" => once(&mut self.check, path(meta)?, meta),
            "record" => once(&mut self.record, value(meta)?, meta),
            "soft_body" => once(&mut self.soft_body, value(meta)?, meta),
            "partners" => once(&mut self.partners, path(meta)?, meta),
            "fits" => once(&mut self.fits, path(meta)?, meta),
            "lays" => once(&mut self.lays, path(meta)?, meta),
            "listed" => once(&mut self.listed, path(meta)?, meta),
            "crate" => once(&mut self.krate, path(meta)?, meta),
            "schema" if meta.input.peek(syn::Token![=]) => {
                Err(meta.error("'schema' takes no value: the schema is that of the type's JsonSchema"))
            }
            "schema" => once(&mut self.schema, meta.path.span(), meta),
            _ => Err(meta.error(format!("unknown key of 'component'; there are: {KEYS}"))),
        }
    }
}

fn once<T>(place: &mut Option<T>, value: T, meta: &ParseNestedMeta) -> Result<()> {
    match place.replace(value) {
        None => Ok(()),
        Some(_) => Err(meta.error("this key stands here twice")),
    }
}

fn value(meta: &ParseNestedMeta) -> Result<Expr> {
    meta.value()?.parse()
}

/// The path of a function or a module.
fn path(meta: &ParseNestedMeta) -> Result<Path> {
    let value = meta.value()?;
    value.parse().map_err(|error| Error::new(error.span(), "a path is expected here, such as Self::ranges"))
}

/// A literal name must be one that fits into files and messages.
fn check_name(name: &Expr) -> Result<()> {
    let text = match name {
        Expr::Lit(ExprLit { lit: Lit::Str(text), .. }) => text.value(),
        Expr::Lit(_) => return Err(Error::new(name.span(), "a name is a text")),
        _ => return Ok(()),
    };
    let is_plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
    if text.starts_with(|c: char| c.is_ascii_lowercase()) && text.chars().all(is_plain) {
        return Ok(());
    }
    Err(Error::new(name.span(), "a name is in lower case: letters, digits and underscores, a letter first"))
}
