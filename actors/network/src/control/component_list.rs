//! What components a program knows, so that two programs can say in which they differ.

use std::fmt;

use serde::{Deserialize, Serialize};
use trocar_scene::Registry;

use super::plain_text::PlainText;

/// Most components of a list; those of a program are tens.
pub const COMPONENTS_MAX: usize = 4_096;
/// Most names that a message shows; further ones are counted.
const NAMED_MAX: usize = 8;

/// Names of components and hashes of their schemas, ordered by name.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ComponentList(Vec<ListedComponent>);

/// A component as far as another program needs to know it.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct ListedComponent {
    /// Its stable name.
    pub name: PlainText,
    /// First 64 bits of BLAKE3 of its JSON schema; 0 if it has none.
    pub schema: u64,
}

impl ComponentList {
    /// The components of a registry.
    pub fn of(registry: &Registry) -> Self {
        let listed = registry.iter().map(|(_, entry)| ListedComponent {
            name: PlainText::new(entry.name),
            schema: (entry.schema)().map_or(0, |schema| first_bits(schema.to_string().as_bytes())),
        });
        Self::new(listed.collect())
    }

    /// A list of these.
    pub fn new(mut components: Vec<ListedComponent>) -> Self {
        components.sort();
        Self(components)
    }

    /// The components, by name.
    pub fn components(&self) -> &[ListedComponent] {
        &self.0
    }

    /// BLAKE3 of the list: two programs with the same one can share a scene.
    pub fn digest(&self) -> [u8; 32] {
        let mut hasher = blake3::Hasher::new();
        for component in &self.0 {
            let name = component.name.as_str().as_bytes();
            hasher.update(&(name.len() as u64).to_le_bytes()).update(name);
            hasher.update(&component.schema.to_le_bytes());
        }
        *hasher.finalize().as_bytes()
    }

    /// In what this program's list differs from another's.
    pub fn difference(&self, theirs: &Self) -> ComponentDifference {
        let of = |list: &Self, name: &PlainText| list.0.iter().find(|known| known.name == *name).cloned();
        let mut difference = ComponentDifference::default();
        for ours in &self.0 {
            match of(theirs, &ours.name) {
                None => difference.only_here.push(ours.name.clone()),
                Some(other) if other.schema != ours.schema => difference.changed.push(ours.name.clone()),
                Some(_) => {}
            }
        }
        let only_there = theirs.0.iter().filter(|other| of(self, &other.name).is_none());
        difference.only_there = only_there.map(|other| other.name.clone()).collect();
        difference
    }
}

fn first_bits(bytes: &[u8]) -> u64 {
    let hash = blake3::hash(bytes);
    let first: [u8; 8] = std::array::from_fn(|at| hash.as_bytes()[at]);
    u64::from_le_bytes(first)
}

/// Components in which two programs differ.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ComponentDifference {
    /// Those that the other program lacks.
    pub only_here: Vec<PlainText>,
    /// Those that this program lacks.
    pub only_there: Vec<PlainText>,
    /// Those that both have, with different fields.
    pub changed: Vec<PlainText>,
}

impl fmt::Display for ComponentDifference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut separator = "";
        for (what, names) in [
            ("only this program has", &self.only_here),
            ("only the other one has", &self.only_there),
            ("these have other fields there:", &self.changed),
        ] {
            if names.is_empty() {
                continue;
            }
            write!(f, "{separator}{what}")?;
            for (at, name) in names.iter().take(NAMED_MAX).enumerate() {
                write!(f, "{} {name}", if at == 0 { "" } else { "," })?;
            }
            if names.len() > NAMED_MAX {
                write!(f, " and {} more", names.len() - NAMED_MAX)?;
            }
            separator = "; ";
        }
        if separator.is_empty() { f.write_str("the lists have the same names and fields") } else { Ok(()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn list(components: &[(&str, u64)]) -> ComponentList {
        let listed = components.iter();
        let listed =
            listed.map(|(name, schema)| ListedComponent { name: PlainText::new(name), schema: *schema });
        ComponentList::new(listed.collect())
    }

    #[test]
    fn the_standard_registry_is_listed_by_name_and_equal_to_itself() {
        let standard = ComponentList::of(&Registry::standard());
        assert!(standard.components().len() > 20 && standard.components().len() <= COMPONENTS_MAX);
        assert!(standard.components().is_sorted());
        assert!(standard.components().iter().any(|component| component.schema != 0));
        let again = ComponentList::of(&Registry::standard());
        assert_eq!(standard.digest(), again.digest());
        assert_eq!(standard.difference(&again), ComponentDifference::default());
    }

    #[test]
    fn a_difference_names_what_is_missing_at_which_end_and_what_has_changed() {
        let (ours, theirs) = (
            list(&[("pose", 1), ("suture", 2), ("tissue", 3)]),
            list(&[("laser", 9), ("pose", 1), ("tissue", 4)]),
        );
        assert_ne!(ours.digest(), theirs.digest());
        let text = ours.difference(&theirs).to_string();
        assert_eq!(
            text,
            "only this program has suture; only the other one has laser; these have other fields there: tissue"
        );
        let many: Vec<_> = (0..20).map(|number| (format!("c{number:02}"), 1)).collect();
        let many: Vec<_> = many.iter().map(|(name, schema)| (name.as_str(), *schema)).collect();
        assert!(list(&many).difference(&list(&[])).to_string().ends_with("c07 and 12 more"));
    }
}
