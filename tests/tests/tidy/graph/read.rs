//! Parses a file into the definitions, imports and paths of its modules.

use std::collections::{BTreeMap, BTreeSet};

use proc_macro2::{TokenStream, TokenTree};
use syn::visit::{self, Visit};
use syn::{Attribute, Expr, ImplItem, Item, ItemMod, ItemUse, Lit, Macro, Meta, Stmt, TraitItem, UseTree};

/// A module, in a file of its own or inline.
#[derive(Debug, Default)]
pub struct Module {
    /// Its file.
    pub file: String,
    /// Its parent module.
    pub parent: Option<usize>,
    /// Its child modules.
    pub children: BTreeMap<String, usize>,
    /// Names that it defines.
    pub items: BTreeSet<String>,
    /// Imports of single names.
    pub imports: Vec<Import>,
    /// Glob imports.
    pub globs: Vec<Import>,
    /// Paths in its code.
    pub paths: BTreeSet<Vec<String>>,
}

/// An import of one name, or a glob.
#[derive(Debug)]
pub struct Import {
    /// Its local name. Empty for a glob.
    pub name: String,
    pub path: Vec<String>,
    pub public: bool,
}

/// Parses a file and the modules that it declares.
pub fn file(
    modules: &mut Vec<Module>,
    name: &str,
    parent: Option<usize>,
    source: &dyn Fn(&str) -> Option<String>,
) -> usize {
    let text = source(name).unwrap_or_else(|| panic!("{name} does not exist"));
    let parsed = syn::parse_file(&text).unwrap_or_else(|error| panic!("{name}: {error}"));
    let (folder, stem) = name.rsplit_once('/').unwrap_or(("", name));
    let stem = stem.strip_suffix(".rs").unwrap_or(stem);
    let below = match (parent, stem) {
        (None, _) | (_, "mod") => folder.to_owned(),
        _ => format!("{folder}/{stem}"),
    };
    let id = modules.len();
    modules.push(Module { file: name.to_owned(), parent, ..Module::default() });
    items(modules, id, &parsed.items, &below, source);
    id
}

/// Adds the items of a module. `below` is the folder of its child modules.
fn items(
    modules: &mut Vec<Module>,
    id: usize,
    items: &[Item],
    below: &str,
    source: &dyn Fn(&str) -> Option<String>,
) {
    for item in items {
        let mut reader = Reader { module: &mut modules[id], nested: Vec::new() };
        reader.visit_item(item);
        for nested in reader.nested {
            let name = nested.ident.to_string();
            let child = match &nested.content {
                Some((_, content)) => {
                    let child = modules.len();
                    let file = modules[id].file.clone();
                    modules.push(Module { file, parent: Some(id), ..Module::default() });
                    self::items(modules, child, content, &format!("{below}/{name}"), source);
                    child
                }
                None => file(modules, &declared(nested, &modules[id].file, below, source), Some(id), source),
            };
            modules[id].children.insert(name, child);
        }
    }
}

/// The file of a declared module.
fn declared(module: &ItemMod, file: &str, below: &str, source: &dyn Fn(&str) -> Option<String>) -> String {
    let path = module.attrs.iter().find_map(|attribute| match &attribute.meta {
        Meta::NameValue(pair) if pair.path.is_ident("path") => match &pair.value {
            Expr::Lit(literal) => match &literal.lit {
                Lit::Str(path) => Some(path.value()),
                _ => None,
            },
            _ => None,
        },
        _ => None,
    });
    if let Some(path) = path {
        return format!("{}/{path}", super::parent(file));
    }
    let name = module.ident.to_string();
    let (flat, folder) = (format!("{below}/{name}.rs"), format!("{below}/{name}/mod.rs"));
    if source(&flat).is_some() { flat } else { folder }
}

struct Reader<'a, 'ast> {
    module: &'a mut Module,
    nested: Vec<&'ast ItemMod>,
}

impl<'ast> Reader<'_, 'ast> {
    fn define(&mut self, item: &Item) {
        let name = match item {
            Item::Const(item) => &item.ident,
            Item::Enum(item) => &item.ident,
            Item::Fn(item) => &item.sig.ident,
            Item::Static(item) => &item.ident,
            Item::Struct(item) => &item.ident,
            Item::Trait(item) => &item.ident,
            Item::TraitAlias(item) => &item.ident,
            Item::Type(item) => &item.ident,
            Item::Union(item) => &item.ident,
            Item::Macro(item) => match &item.ident {
                Some(name) => name,
                None => return self.define_by_macro(item.mac.tokens.clone()),
            },
            _ => return,
        };
        self.module.items.insert(name.to_string());
    }

    /// A macro in item position defines the items in its tokens: `component! { pub struct Pose { … } }`.
    fn define_by_macro(&mut self, tokens: TokenStream) {
        const MAKERS: [&str; 8] = ["struct", "enum", "fn", "trait", "type", "const", "static", "union"];
        let mut maker = false;
        for token in tokens {
            if let (true, TokenTree::Ident(name)) = (maker, &token) {
                self.module.items.insert(name.to_string());
            }
            maker = matches!(&token, TokenTree::Ident(word) if MAKERS.iter().any(|maker| word == maker));
        }
    }

    fn import(&mut self, item: &ItemUse) {
        let public = !matches!(item.vis, syn::Visibility::Inherited);
        let mut path = if item.leading_colon.is_some() { vec![String::new()] } else { Vec::new() };
        self.import_tree(&item.tree, &mut path, public);
    }

    fn import_tree(&mut self, tree: &UseTree, path: &mut Vec<String>, public: bool) {
        let depth = path.len();
        match tree {
            UseTree::Path(tree) => {
                path.push(tree.ident.to_string());
                self.import_tree(&tree.tree, path, public);
            }
            UseTree::Group(group) => {
                group.items.iter().for_each(|tree| self.import_tree(tree, path, public));
            }
            UseTree::Glob(_) => {
                let (name, path) = (String::new(), path.clone());
                self.module.globs.push(Import { name, path, public });
            }
            UseTree::Name(name) => self.import_name(path, &name.ident.to_string(), None, public),
            UseTree::Rename(name) => {
                let new = name.rename.to_string();
                self.import_name(path, &name.ident.to_string(), Some(new), public);
            }
        }
        path.truncate(depth);
    }

    fn import_name(&mut self, above: &[String], name: &str, new: Option<String>, public: bool) {
        let mut path = above.to_vec();
        if name != "self" {
            path.push(name.to_owned());
        }
        let name = new.unwrap_or_else(|| path.last().cloned().unwrap_or_default());
        self.module.imports.push(Import { name, path, public });
    }

    /// Paths within a macro's tokens, which `syn` does not parse.
    fn name_tokens(&mut self, tokens: TokenStream) {
        let mut path: Vec<String> = Vec::new();
        let mut colons = 0;
        for token in tokens {
            match token {
                TokenTree::Ident(word) => {
                    if colons != 2 {
                        self.name(std::mem::take(&mut path));
                    }
                    path.push(word.to_string());
                    colons = 0;
                }
                TokenTree::Punct(mark) if mark.as_char() == ':' => colons += 1,
                TokenTree::Group(group) => {
                    self.name(std::mem::take(&mut path));
                    self.name_tokens(group.stream());
                    colons = 0;
                }
                _ => {
                    self.name(std::mem::take(&mut path));
                    colons = 0;
                }
            }
        }
        self.name(path);
    }

    fn name(&mut self, path: Vec<String>) {
        if !path.is_empty() {
            self.module.paths.insert(path);
        }
    }
}

impl<'ast> Visit<'ast> for Reader<'_, 'ast> {
    fn visit_item(&mut self, item: &'ast Item) {
        if attributes(item).is_some_and(for_tests) {
            return;
        }
        self.define(item);
        visit::visit_item(self, item);
    }

    fn visit_item_mod(&mut self, item: &'ast ItemMod) {
        self.nested.push(item);
    }

    fn visit_item_use(&mut self, item: &'ast ItemUse) {
        self.import(item);
    }

    fn visit_impl_item(&mut self, item: &'ast ImplItem) {
        let attributes = match item {
            ImplItem::Const(item) => &item.attrs,
            ImplItem::Fn(item) => &item.attrs,
            ImplItem::Type(item) => &item.attrs,
            _ => return visit::visit_impl_item(self, item),
        };
        if !for_tests(attributes) {
            visit::visit_impl_item(self, item);
        }
    }

    fn visit_trait_item(&mut self, item: &'ast TraitItem) {
        if !matches!(item, TraitItem::Fn(item) if for_tests(&item.attrs)) {
            visit::visit_trait_item(self, item);
        }
    }

    fn visit_stmt(&mut self, statement: &'ast Stmt) {
        if !matches!(statement, Stmt::Local(local) if for_tests(&local.attrs)) {
            visit::visit_stmt(self, statement);
        }
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        let mut names: Vec<String> = path.segments.iter().map(|part| part.ident.to_string()).collect();
        if path.leading_colon.is_some() {
            names.insert(0, String::new());
        }
        self.name(names);
        visit::visit_path(self, path);
    }

    fn visit_macro(&mut self, call: &'ast Macro) {
        self.visit_path(&call.path);
        self.name_tokens(call.tokens.clone());
    }

    fn visit_attribute(&mut self, _: &'ast Attribute) {}
}

fn attributes(item: &Item) -> Option<&[Attribute]> {
    Some(match item {
        Item::Const(item) => &item.attrs,
        Item::Enum(item) => &item.attrs,
        Item::ExternCrate(item) => &item.attrs,
        Item::Fn(item) => &item.attrs,
        Item::ForeignMod(item) => &item.attrs,
        Item::Impl(item) => &item.attrs,
        Item::Macro(item) => &item.attrs,
        Item::Mod(item) => &item.attrs,
        Item::Static(item) => &item.attrs,
        Item::Struct(item) => &item.attrs,
        Item::Trait(item) => &item.attrs,
        Item::TraitAlias(item) => &item.attrs,
        Item::Type(item) => &item.attrs,
        Item::Union(item) => &item.attrs,
        Item::Use(item) => &item.attrs,
        _ => return None,
    })
}

/// Whether something exists in tests only: `#[cfg(test)]` or `#[cfg(all(test, …))]`.
fn for_tests(attributes: &[Attribute]) -> bool {
    attributes.iter().any(|attribute| match &attribute.meta {
        Meta::List(list) if list.path.is_ident("cfg") => {
            let condition: String = list.tokens.to_string().split_whitespace().collect();
            condition == "test" || (condition.starts_with("all(") && has_word(&condition, "test"))
        }
        _ => false,
    })
}

fn has_word(text: &str, word: &str) -> bool {
    text.split(|c: char| !c.is_alphanumeric() && c != '_').any(|part| part == word)
}
