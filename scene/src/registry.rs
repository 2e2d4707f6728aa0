//! The registry: the components of a session, with functions to create, decode and parse them.

use std::any::TypeId;
use std::collections::{BTreeMap, HashMap};
use std::hash::{BuildHasherDefault, Hasher};
use std::ops::Range;
use std::sync::Arc;

use nalgebra::Point3;
use thiserror::Error;

use crate::column::{Column, ErasedColumn, take};
use crate::commands::Commands;
use crate::component::{Component, ComponentError, RecordPolicy};
use crate::document_value::DocumentValue;
use crate::entity::Entity;
use crate::entity_mesh::EntityMesh;
use crate::puts::{ErasedPuts, Puts};
use crate::soft_body::SoftAbilities;

/// Index of a component in its registry; ordered by NAME, so never by order of registration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ComponentId(pub u16);

/// Decodes a value of a document; errors keep their position.
type PutDocument =
    fn(&mut Commands, Entity, &DocumentValue) -> Result<(), (Option<Range<usize>>, ComponentError)>;

/// Decodes a value from the front of some bytes and returns the rest.
type PutPostcard = for<'a> fn(&mut Commands, Entity, &'a [u8]) -> Result<&'a [u8], ComponentError>;

/// Decodes a value that a check has passed, and tells whether it fits the mesh of its entity.
type FitsDocument = fn(&DocumentValue, &EntityMesh<'_>) -> Result<(), ComponentError>;

/// Decodes a value, and tells where it lays the vertices of its body.
type LaysDocument = fn(&DocumentValue) -> Option<Vec<Point3<f64>>>;

/// Entities that declare a coupling to a body, to which they give impulses.
type NamedBy = fn(&dyn ErasedColumn, &str) -> Vec<Entity>;

/// Registry entry of one component.
#[derive(Clone)]
pub struct ComponentEntry {
    /// Stable name.
    pub name: &'static str,
    /// Short stable key for files and hashes: the first 32 bits of BLAKE3(name).
    pub key: u32,
    /// How a recording keeps its values.
    pub record: RecordPolicy,
    /// JSON schema of the value in a scenario file, if it is allowed there.
    pub schema: fn() -> Option<serde_json::Value>,
    /// Abilities of soft bodies that carry it.
    pub soft_body: Option<SoftAbilities>,
    named_by: Option<NamedBy>,
    fits: Option<FitsDocument>,
    lays: Option<LaysDocument>,
    type_id: TypeId,
    type_name: &'static str,
    pub(crate) new_column: fn() -> Arc<dyn ErasedColumn>,
    pub(crate) new_puts: fn() -> Box<dyn ErasedPuts>,
    put_document: PutDocument,
    put_postcard: PutPostcard,
}

/// Error in a set of components.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum RegistryError {
    /// Two types claim one name.
    #[error("component name '{name}' is claimed by both {first} and {second}")]
    NameTaken {
        /// The name.
        name: &'static str,
        /// The type that already has it.
        first: &'static str,
        /// The type that also claims it.
        second: &'static str,
    },
    /// Two names share a key.
    #[error("component names '{first}' and '{second}' share a key; rename one of them")]
    KeyTaken {
        /// One name.
        first: &'static str,
        /// The other.
        second: &'static str,
    },
    /// More than 65,535 components.
    #[error("too many components")]
    Full,
    /// No such component.
    #[error("unknown component '{name}'; there are: {known}")]
    Unknown {
        /// The requested name.
        name: String,
        /// The known names.
        known: String,
    },
}

/// `TypeId`s are already hashes.
#[derive(Default)]
struct TypeIdHasher(u64);
impl Hasher for TypeIdHasher {
    fn finish(&self) -> u64 {
        self.0
    }
    fn write(&mut self, bytes: &[u8]) {
        for chunk in bytes.chunks(8) {
            let mut word = [0u8; 8];
            word[..chunk.len()].copy_from_slice(chunk);
            self.0 ^= u64::from_le_bytes(word);
        }
    }
    fn write_u64(&mut self, word: u64) {
        self.0 ^= word;
    }
}

/// Collects components before a session starts.
#[derive(Clone, Default)]
pub struct RegistryBuilder {
    entries: BTreeMap<&'static str, ComponentEntry>,
}

/// Adds many components to a [`RegistryBuilder`], as [`RegistryBuilder::register`] adds one, and returns what it returns.
///
/// ```
/// use trocar_scene::{Name, Pose, RegistryBuilder, register_all};
///
/// let mut builder = RegistryBuilder::new();
/// register_all!(&mut builder; Name, Pose)?;
/// assert!(builder.build().by_name("pose").is_ok());
/// # Ok::<(), trocar_scene::RegistryError>(())
/// ```
#[macro_export]
macro_rules! register_all {
    ($builder:expr; $($component:ty),+ $(,)?) => {
        ::core::result::Result::<&mut $crate::RegistryBuilder, $crate::RegistryError>::Ok($builder)
            $(.and_then(|builder| builder.register::<$component>()))+
    };
}

impl RegistryBuilder {
    /// A builder without components.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a component; adding the same type twice is fine.
    ///
    /// # Errors
    /// When another type has its name.
    pub fn register<T: Component>(&mut self) -> Result<&mut Self, RegistryError> {
        let type_id = TypeId::of::<T>();
        if let Some(entry) = self.entries.get(T::NAME) {
            return if entry.type_id == type_id {
                Ok(self)
            } else {
                Err(RegistryError::NameTaken {
                    name: T::NAME,
                    first: entry.type_name,
                    second: std::any::type_name::<T>(),
                })
            };
        }
        let hash = blake3::hash(T::NAME.as_bytes());
        let key = u32::from_le_bytes([
            hash.as_bytes()[0],
            hash.as_bytes()[1],
            hash.as_bytes()[2],
            hash.as_bytes()[3],
        ]);
        if let Some(other) = self.entries.values().find(|entry| entry.key == key) {
            return Err(RegistryError::KeyTaken { first: other.name, second: T::NAME });
        }
        if self.entries.len() >= usize::from(u16::MAX) {
            return Err(RegistryError::Full);
        }
        self.entries.insert(
            T::NAME,
            ComponentEntry {
                name: T::NAME,
                key,
                record: T::RECORD,
                schema: T::schema,
                soft_body: T::SOFT_BODY,
                named_by: T::PARTNERS.is_some().then_some(named_by::<T> as NamedBy),
                fits: T::FITS.is_some().then_some(fits_document::<T> as FitsDocument),
                lays: T::LAYS.is_some().then_some(lays_document::<T> as LaysDocument),
                type_id,
                type_name: std::any::type_name::<T>(),
                new_column: || Arc::new(Column::<T>::default()),
                new_puts: || Box::new(Puts::<T>::default()),
                put_document: put_document::<T>,
                put_postcard: put_postcard::<T>,
            },
        );
        Ok(self)
    }

    /// Fixes the set.
    pub fn build(self) -> Arc<Registry> {
        let entries: Vec<ComponentEntry> = self.entries.into_values().collect();
        let by_type =
            entries.iter().enumerate().map(|(id, entry)| (entry.type_id, ComponentId(id as u16))).collect();
        let by_key =
            entries.iter().enumerate().map(|(id, entry)| (entry.key, ComponentId(id as u16))).collect();
        let soft_bodies =
            (0..).zip(&entries).filter_map(|(id, entry)| Some((ComponentId(id), entry.soft_body?)));
        let soft_bodies = soft_bodies.collect();
        Arc::new(Registry { entries, by_type, by_key, soft_bodies })
    }
}

fn named_by<T: Component>(column: &dyn ErasedColumn, name: &str) -> Vec<Entity> {
    let column = column.as_any().downcast_ref::<Column<T>>();
    let Some((column, partners)) = column.zip(T::PARTNERS) else { return Vec::new() };
    column.iter().filter(|(_, value)| partners(value).contains(&name)).map(|(entity, _)| entity).collect()
}

fn put_document<T: Component>(
    commands: &mut Commands,
    entity: Entity,
    value: &DocumentValue,
) -> Result<(), (Option<Range<usize>>, ComponentError)> {
    match T::deserialize(value) {
        Ok(value) => put_checked(commands, entity, value).map_err(|error| (None, error)),
        Err(error) => Err((error.place(), malformed(error.message()))),
    }
}

fn fits_document<T: Component>(value: &DocumentValue, mesh: &EntityMesh<'_>) -> Result<(), ComponentError> {
    match (T::FITS, T::deserialize(value)) {
        (Some(fits), Ok(value)) => fits(&value, mesh),
        _ => Ok(()),
    }
}

fn lays_document<T: Component>(value: &DocumentValue) -> Option<Vec<Point3<f64>>> {
    T::LAYS?(&T::deserialize(value).ok()?)
}

fn put_postcard<'a, T: Component>(
    commands: &mut Commands,
    entity: Entity,
    bytes: &'a [u8],
) -> Result<&'a [u8], ComponentError> {
    let (value, rest) = take::<T>(bytes)?;
    put_checked(commands, entity, value)?;
    Ok(rest)
}

fn put_checked<T: Component>(
    commands: &mut Commands,
    entity: Entity,
    value: T,
) -> Result<(), ComponentError> {
    value.check()?;
    commands.put(entity, value);
    Ok(())
}

fn malformed(message: &str) -> ComponentError {
    ComponentError::Malformed(message.trim().to_owned())
}

/// The components of a session.
pub struct Registry {
    entries: Vec<ComponentEntry>,
    by_type: HashMap<TypeId, ComponentId, BuildHasherDefault<TypeIdHasher>>,
    by_key: BTreeMap<u32, ComponentId>,
    soft_bodies: Vec<(ComponentId, SoftAbilities)>,
}

impl Registry {
    /// The standard components, and no others.
    ///
    /// # Panics
    /// Never: their names are distinct, which a test holds.
    pub fn standard() -> Arc<Self> {
        let mut builder = RegistryBuilder::new();
        crate::components::register(&mut builder).expect("the names of this crate's components are distinct");
        builder.build()
    }
    /// How many components there are.
    pub fn len(&self) -> usize {
        self.entries.len()
    }
    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }
    /// The id of a type.
    #[inline]
    pub fn id<T: Component>(&self) -> Option<ComponentId> {
        self.by_type.get(&TypeId::of::<T>()).copied()
    }
    /// The id of a name.
    ///
    /// # Errors
    /// [`RegistryError::Unknown`] with the valid names.
    pub fn by_name(&self, name: &str) -> Result<ComponentId, RegistryError> {
        self.entries.binary_search_by_key(&name, |entry| entry.name).map(|id| ComponentId(id as u16)).map_err(
            |_| RegistryError::Unknown {
                name: name.to_owned(),
                known: self.entries.iter().map(|entry| entry.name).collect::<Vec<_>>().join(", "),
            },
        )
    }
    /// The id of a key found in a file.
    pub fn by_key(&self, key: u32) -> Option<ComponentId> {
        self.by_key.get(&key).copied()
    }
    /// The id of a key; an error if it is unknown.
    pub(crate) fn require_key(&self, key: u32) -> Result<ComponentId, ComponentError> {
        self.by_key(key).ok_or_else(|| malformed(&format!("unknown component key {key:#010x}")))
    }
    /// Entry of a component.
    ///
    /// # Panics
    /// When the id is of another registry.
    pub fn entry(&self, id: ComponentId) -> &ComponentEntry {
        &self.entries[usize::from(id.0)]
    }
    /// Every component, ordered by NAME.
    pub fn iter(&self) -> impl Iterator<Item = (ComponentId, &ComponentEntry)> {
        self.entries.iter().enumerate().map(|(id, entry)| (ComponentId(id as u16), entry))
    }
    /// Components of soft-body methods, ordered by NAME, with the abilities of their bodies.
    pub fn soft_bodies(&self) -> &[(ComponentId, SoftAbilities)] {
        &self.soft_bodies
    }
    /// Names of those whose bodies have an ability.
    pub fn soft_bodies_that(&self, can: impl Fn(&SoftAbilities) -> bool) -> Vec<&'static str> {
        let those = self.soft_bodies.iter().filter(|(_, of)| can(of));
        those.map(|(id, _)| self.entry(*id).name).collect()
    }
    /// Names of the components that declare couplings to other bodies.
    pub fn components_with_partners(&self) -> Vec<&'static str> {
        self.entries.iter().filter(|entry| entry.named_by.is_some()).map(|entry| entry.name).collect()
    }
    /// Entities of a column that declare a coupling to a body.
    pub(crate) fn named_by(&self, id: ComponentId, column: &dyn ErasedColumn, name: &str) -> Vec<Entity> {
        self.entry(id).named_by.map_or_else(Vec::new, |named_by| named_by(column, name))
    }
    /// Decodes a value of a document as the named component and puts it.
    ///
    /// # Errors
    /// When the value is malformed (with its place in the document, as a range of bytes) or refused by the
    /// component's check (without).
    pub fn put_document(
        &self,
        id: ComponentId,
        commands: &mut Commands,
        entity: Entity,
        value: &DocumentValue,
    ) -> Result<(), (Option<Range<usize>>, ComponentError)> {
        (self.entry(id).put_document)(commands, entity, value)
    }
    /// Whether a value of a document, which [`Self::put_document`] has taken, fits the mesh of its entity.
    ///
    /// # Errors
    /// When it refers to parts of a mesh that are not there.
    pub fn fits_document(
        &self,
        id: ComponentId,
        value: &DocumentValue,
        mesh: &EntityMesh<'_>,
    ) -> Result<(), ComponentError> {
        self.entry(id).fits.map_or(Ok(()), |fits| fits(value, mesh))
    }
    /// Where a component lays the vertices of its body \[m\], if it does.
    pub fn lays_document(&self, id: ComponentId, value: &DocumentValue) -> Option<Vec<Point3<f64>>> {
        self.entry(id).lays?(value)
    }
    /// Decodes a JSON value as the named component, which may stand in a scenario file, and puts it.
    ///
    /// # Errors
    /// When the value is malformed or refused by the component's check.
    pub fn put_json(
        &self,
        id: ComponentId,
        commands: &mut Commands,
        entity: Entity,
        value: &serde_json::Value,
    ) -> Result<(), ComponentError> {
        self.put_document(id, commands, entity, &value.into()).map_err(|(_, error)| error)
    }
    /// Decodes a value from the front of `bytes`, puts it, and returns the rest.
    ///
    /// # Errors
    /// When the bytes are malformed or the value is refused by the component's check.
    pub fn put_postcard<'a>(
        &self,
        id: ComponentId,
        commands: &mut Commands,
        entity: Entity,
        bytes: &'a [u8],
    ) -> Result<&'a [u8], ComponentError> {
        (self.entry(id).put_postcard)(commands, entity, bytes)
    }
}
