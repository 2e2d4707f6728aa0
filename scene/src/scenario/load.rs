//! From the text of a scenario to plain structures and commands.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Read;
use std::path::Path;
use std::sync::Arc;

use nalgebra::Vector3;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::document::{Params, Source, Step, Table, join, named_in, not_finite_in, shown};
use super::error::ScenarioError;
use super::joints;
use super::mesh_source::{self, LoadedMesh};
use super::tissue_defaults::{completed, doubt};
use super::{
    CONTROLLERS_MAX, ControllerEntry, ENTITIES_MAX, FILE_BYTES_MAX, HANDS_MAX, HandEntry, RATE_HZ,
    SCHEMA_VERSION, Scenario, provenance,
};
use crate::commands::Commands;
use crate::component::{Component, ComponentError};
use crate::components::{Hand, Name, OutOfValidity, Parent, Sources, Tissue, VertexPositions};
use crate::confined_path::{self, Assets};
use crate::document_value::DocumentValue;
use crate::entity::{Entity, EntityAllocator, SCENARIO_SPAWNER, with_entity_names};
use crate::entity_mesh::EntityMesh;
use crate::registry::Registry;
use crate::time::SimTime;
use crate::tissue::tissue;

/// Keys of the document.
pub(super) const ROOT_KEYS: [&str; 10] =
    ["schema", "name", "title", "description", "gravity", "entity", "controller", "hand", "task", "network"];
/// Keys of a controller.
pub(super) const CONTROLLER_KEYS: [&str; 4] = ["name", "kind", "rate_hz", "params"];
/// Keys of a hand.
pub(super) const HAND_KEYS: [&str; 5] = ["name", "entity", "device", "params", "renderer"];

type Names = Arc<BTreeMap<String, Entity>>;

pub(super) fn load(
    file: &Path,
    registry: &Arc<Registry>,
    assets: &Assets,
) -> Result<Scenario, ScenarioError> {
    let io = |source| ScenarioError::Io { file: file.into(), source };
    let invalid = |reason: String| io(std::io::Error::new(std::io::ErrorKind::InvalidData, reason));
    let handle = std::fs::File::open(file).map_err(io)?;
    let metadata = handle.metadata().map_err(io)?;
    if !metadata.is_file() {
        return Err(invalid("not a regular file".into()));
    }
    let mut text = String::new();
    handle.take(FILE_BYTES_MAX + 1).read_to_string(&mut text).map_err(io)?;
    if text.len() as u64 > FILE_BYTES_MAX {
        return Err(invalid(format!("larger than {FILE_BYTES_MAX} bytes")));
    }
    parse(file, text, registry, assets)
}

pub(super) fn parse(
    file: &Path,
    text: String,
    registry: &Arc<Registry>,
    assets: &Assets,
) -> Result<Scenario, ScenarioError> {
    let (mut scenario, source) = outline(file, text)?;
    let document = source.parse()?;
    let root = Table::new(&source, "", document.span(), document.get_ref());
    let folder = file.parent().unwrap_or(Path::new(""));
    check_files(&source, folder, "", document.get_ref())?;
    check_parents(&root)?;
    scenario.meshes = load_meshes(&root, folder, assets, &scenario.names)?;
    commands(&source, &document, registry, &scenario.names, &scenario.meshes)?;
    joints::check(&root, &scenario.names)?;
    Ok(scenario)
}

/// Everything but what the entities are made of.
pub(super) fn outline(file: &Path, text: String) -> Result<(Scenario, Arc<Source>), ScenarioError> {
    let source = Arc::new(Source { file: file.into(), text });
    let document = source.parse()?;
    let root = Table::new(&source, "", document.span(), document.get_ref());
    schema_version(&root)?;
    root.only(&ROOT_KEYS)?;
    let (name, span) = {
        root.require("name")?;
        root.string("name")?.unwrap_or(("", 0..0))
    };
    check_name(&root, "name", name, span)?;
    let names = entity_names(&root)?;
    let scenario = Scenario {
        file: file.into(),
        name: name.to_owned(),
        title: root.string("title")?.map_or(name, |(text, _)| text).to_owned(),
        description: root.string("description")?.map_or("", |(text, _)| text).to_owned(),
        gravity_in_world: gravity(&root)?,
        controllers: controllers(&root, &source, &names)?,
        hands: hands(&root, &source, &names)?,
        task: table_of_another(&root, "task", &source, &names)?,
        network: table_of_another(&root, "network", &source, &names)?,
        names,
        meshes: BTreeMap::new(),
        source: source.clone(),
    };
    Ok((scenario, source))
}

/// Checked first, so that a file of another version is not checked against the keys of this one.
fn schema_version(root: &Table) -> Result<(), ScenarioError> {
    let value = root.require("schema")?;
    match root.value::<i64>("schema")? {
        Some(SCHEMA_VERSION) => Ok(()),
        other => {
            let found = other.unwrap_or_default();
            let reason =
                format!("version {found} of the format is not known; this program reads {SCHEMA_VERSION}");
            Err(root.error(value.span(), "schema", reason))
        }
    }
}

/// Names are used in files, command lines and thread names.
fn check_name(
    table: &Table,
    key: &str,
    name: &str,
    span: std::ops::Range<usize>,
) -> Result<(), ScenarioError> {
    let valid = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '-' | '_');
    if (1..=64).contains(&name.len()) && name.chars().all(valid) && !name.starts_with(['.', '-']) {
        return Ok(());
    }
    let reason = format!(
        "'{}' is no name: 1 to 64 letters, digits, '.', '-' and '_', beginning with a letter, a digit or '_'",
        shown(name)
    );
    Err(table.error(span, key, reason))
}

fn gravity(root: &Table) -> Result<Vector3<f64>, ScenarioError> {
    let gravity = root.value::<[f64; 3]>("gravity")?.unwrap_or([0.0, 0.0, -9.81]);
    // Written so that a NaN fails.
    if gravity.iter().all(|g| g.abs() <= 100.0) {
        return Ok(gravity.into());
    }
    let span = root.get("gravity").map_or(root.span(), Spanned::span);
    Err(root.error(span, "gravity", format!("{gravity:?} is out of range (-100 to 100 m/s² on each axis)")))
}

/// Strings under a key `file`, at any depth, are paths below the folder of the scenario.
fn check_files(source: &Source, folder: &Path, key: &str, table: &DeTable) -> Result<(), ScenarioError> {
    for (name, value) in table {
        let here = join(key, name.get_ref());
        check_files_in(source, folder, &here, name.get_ref() == "file", value)?;
    }
    Ok(())
}

fn check_files_in(
    source: &Source,
    folder: &Path,
    key: &str,
    is_file: bool,
    value: &Spanned<DeValue>,
) -> Result<(), ScenarioError> {
    match value.get_ref() {
        // Meshes may stand in other folders too, which is checked when they are read.
        DeValue::String(_) if is_file && key == "entity, mesh, file" => Ok(()),
        DeValue::String(path) if is_file => {
            confined_path::below(folder, path).map(|_| ()).map_err(|why| source.error(value.span(), key, why))
        }
        DeValue::Table(table) => check_files(source, folder, key, table),
        DeValue::Array(items) => {
            items.iter().try_for_each(|item| check_files_in(source, folder, key, is_file, item))
        }
        _ => Ok(()),
    }
}

/// Numbers the entities in the order of the file, so that tables can refer forwards.
fn entity_names(root: &Table) -> Result<Names, ScenarioError> {
    let allocator = EntityAllocator::new(0, SCENARIO_SPAWNER);
    let tables = root.tables("entity")?;
    if tables.len() > ENTITIES_MAX {
        let reason = format!("{} entities are more than the limit of {ENTITIES_MAX}", tables.len());
        return Err(root.error(root.span(), "entity", reason));
    }
    let mut names = BTreeMap::new();
    for (span, table) in tables {
        let table = Table::new(root.source, "entity", span, table);
        table.require("name")?;
        let (name, span) = table.string("name")?.unwrap_or(("", table.span()));
        check_name(&table, "name", name, span.clone())?;
        let entity =
            allocator.allocate().ok_or_else(|| table.error(span.clone(), "name", "too many entities"))?;
        if names.insert(name.to_owned(), entity).is_some() {
            return Err(table.error(span, "name", format!("two entities are named '{name}'")));
        }
    }
    Ok(Arc::new(names))
}

/// A chain of parents must end.
fn check_parents(root: &Table) -> Result<(), ScenarioError> {
    let mut parents = BTreeMap::new();
    for (_, table) in root.tables("entity")? {
        let name = table.get("name").and_then(|value| value.get_ref().as_str());
        let parent = table.get(Parent::NAME);
        if let (Some(name), Some(parent)) = (name, parent)
            && let Some(of) = parent.get_ref().as_str()
        {
            parents.insert(name, (of, parent.span()));
        }
    }
    // Names whose chain is known to end, so that every link is followed only once.
    let mut ends = BTreeSet::new();
    for start in parents.keys() {
        let mut chain = BTreeSet::new();
        let mut current = *start;
        while let Some((next, span)) = parents.get(current)
            && !ends.contains(current)
        {
            if !chain.insert(current) {
                let key = format!("entity '{current}', parent");
                return Err(root.source.error(span.clone(), key, "its parents form a cycle"));
            }
            current = next;
        }
        ends.extend(chain);
    }
    Ok(())
}

fn load_meshes(
    root: &Table,
    folder: &Path,
    assets: &Assets,
    names: &Names,
) -> Result<BTreeMap<Entity, LoadedMesh>, ScenarioError> {
    let mut meshes = BTreeMap::new();
    for (span, table) in root.tables("entity")? {
        let name = table.get("name").and_then(|value| value.get_ref().as_str()).unwrap_or_default();
        let key = format!("entity '{name}'");
        let entity_table = Table::new(root.source, &key, span, table);
        let Some(value) = entity_table.get("mesh") else { continue };
        if let Some((_, beside)) = mesh_source::PROVIDED.iter().find_map(|p| table.get_key_value(*p)) {
            let reason = format!("a mesh file provides {} already", mesh_source::PROVIDED.join(", "));
            return Err(entity_table.error(beside.span(), "mesh", reason));
        }
        let inner = match value.get_ref().as_table() {
            Some(inner) => inner,
            None => return Err(entity_table.wrong_type("mesh", value, "a table with a file")),
        };
        let is_tissue = entity_table.get(Tissue::NAME).is_some();
        let mesh_key = join(&key, "mesh");
        let mesh_table = Table::new(root.source, &mesh_key, value.span(), inner);
        let mesh = mesh_source::load(folder, assets, &mesh_table, value, is_tissue)?;
        meshes
            .insert(names.get(name).copied().unwrap_or_else(|| Entity::of_writer(0, SCENARIO_SPAWNER)), mesh);
    }
    Ok(meshes)
}

pub(super) fn commands(
    source: &Source,
    document: &Spanned<DeTable<'_>>,
    registry: &Arc<Registry>,
    names: &Names,
    meshes: &BTreeMap<Entity, LoadedMesh>,
) -> Result<Commands, ScenarioError> {
    let root = Table::new(source, "", document.span(), document.get_ref());
    let mut commands = Commands::new(registry.clone(), EntityAllocator::new(0, SCENARIO_SPAWNER));
    with_entity_names(names.as_ref().clone(), || {
        for (span, table) in root.tables("entity")? {
            let entity = commands.spawn();
            put_entity(&Table::new(source, "entity", span, table), entity, registry, meshes, &mut commands)?;
        }
        Ok(())
    })?;
    match commands.error() {
        None => Ok(commands),
        Some(error) => Err(source.error(document.span(), "entity", error.to_string())),
    }
}

fn put_entity(
    table: &Table,
    entity: Entity,
    registry: &Registry,
    meshes: &BTreeMap<Entity, LoadedMesh>,
    commands: &mut Commands,
) -> Result<(), ScenarioError> {
    let name = table.string(Name::NAME)?.map_or("", |(text, _)| text);
    let key = format!("entity '{name}'");
    let table = Table { key: &key, ..*table };
    let tissue = table.string(Tissue::NAME)?.and_then(|(name, _)| tissue(name));
    // An unreadable parent is refused later, when it is put.
    let sources = table.value::<Sources>(Sources::NAME).ok().flatten().unwrap_or_default();
    let given = |name: &String| table.get(name).is_some();
    let sources_span = || table.get(Sources::NAME).map_or(table.span(), Spanned::span);
    if let Some(name) = sources.0.keys().find(|name| !given(name)) {
        let reason = format!("the entity has no '{}'", shown(name));
        return Err(table.error(sources_span(), Sources::NAME, reason));
    }
    for (component, value) in table.table {
        let component_name = component.get_ref().as_ref();
        if component_name == "mesh" {
            continue;
        }
        let id = registry.by_name(component_name).map_err(|_| {
            let known: Vec<&str> =
                registry.iter().filter(|(_, e)| (e.schema)().is_some()).map(|(_, e)| e.name).collect();
            let reason = format!(
                "unknown component '{}'; there are: mesh, {}",
                shown(component_name),
                known.join(", ")
            );
            table.error(component.span(), "", reason)
        })?;
        let mut text = String::new();
        let completed = match tissue {
            Some(tissue) => completed(tissue, (registry.entry(id).schema)().as_ref(), value, &mut text),
            None => value.clone(),
        };
        let of_source = provenance::doubt(&sources, component_name, &completed)
            .map_err(|reason| table.error(sources_span(), Sources::NAME, reason))?;
        let of_tissue = tissue.and_then(|tissue| doubt(tissue, component_name, &completed));
        if let Some(reason) = of_tissue.or(of_source) {
            commands.put(entity, OutOfValidity { reason, since: SimTime::ZERO });
        }
        registry.put_document(id, commands, entity, &DocumentValue::from(&completed)).map_err(
            |(span, error)| {
                let reason = super::reason(&error);
                let found = match &error {
                    ComponentError::NotFinite { .. } => not_finite_in(value),
                    _ => named_in(value, &reason),
                };
                let span = span.or(found).unwrap_or(value.span());
                table.error(span, component_name, reason)
            },
        )?;
    }
    let mesh = meshes.get(&entity);
    if let Some(mesh) = mesh {
        mesh.put(commands, entity);
    }
    check_fit(&table, registry, mesh)
}

/// Refuses components that refer to parts of the entity's mesh which are not there.
fn check_fit(table: &Table, registry: &Registry, mesh: Option<&LoadedMesh>) -> Result<(), ScenarioError> {
    let mut components = Vec::new();
    for (name, value) in table.table {
        if let Ok(id) = registry.by_name(name.get_ref()) {
            components.push((id, name.get_ref(), value.span(), DocumentValue::from(value)));
        }
    }
    let laid = components.iter().find_map(|(id, .., value)| registry.lays_document(*id, value));
    let declared = match (&laid, mesh) {
        (None, None) => table.value::<VertexPositions>(VertexPositions::NAME)?,
        _ => None,
    };
    let of_mesh = mesh.map(|mesh| EntityMesh {
        vertices: &mesh.positions.positions,
        tets: mesh.tets.as_ref().map_or(&[], |tets| &tets.tets),
        regions: mesh.regions.as_ref().map(|regions| &regions.names[..]),
    });
    let bare = laid.as_deref().or(declared.as_ref().map(|declared| &declared.positions[..]));
    let bare = bare.map(|vertices| EntityMesh { vertices, ..EntityMesh::default() });
    let Some(mesh) = laid.as_ref().and(bare).or(of_mesh).or(bare) else { return Ok(()) };
    for (id, name, span, value) in components {
        registry
            .fits_document(id, &value, &mesh)
            .map_err(|error| table.error(span, name, error.to_string()))?;
    }
    Ok(())
}

fn controllers(
    root: &Table,
    source: &Arc<Source>,
    names: &Names,
) -> Result<Vec<ControllerEntry>, ScenarioError> {
    let mut controllers: Vec<ControllerEntry> = Vec::new();
    for (index, (span, table)) in root.tables("controller")?.into_iter().enumerate() {
        let table = Table::new(root.source, "controller", span, table);
        if index >= CONTROLLERS_MAX {
            return Err(table.error(table.span(), "", format!("more than {CONTROLLERS_MAX} controllers")));
        }
        let name = unique_name(&table, controllers.iter().map(|other| other.name.as_str()))?;
        let key = format!("controller '{name}'");
        let table = Table { key: &key, ..table };
        table.only(&CONTROLLER_KEYS)?;
        table.require("kind")?;
        let (kind, kind_span) = table.string("kind")?.unwrap_or(("", table.span()));
        check_name(&table, "kind", kind, kind_span)?;
        table.require("rate_hz")?;
        let rate_hz = table.number("rate_hz", RATE_HZ, "1 to 10000 Hz")?.unwrap_or(1.0);
        let params = params(&table, source, names, &["controller"], index, "params")?;
        controllers.push(ControllerEntry { name: name.to_owned(), kind: kind.to_owned(), rate_hz, params });
    }
    Ok(controllers)
}

fn hands(root: &Table, source: &Arc<Source>, names: &Names) -> Result<Vec<HandEntry>, ScenarioError> {
    let mut hands: Vec<HandEntry> = Vec::new();
    for (index, (span, table)) in root.tables("hand")?.into_iter().enumerate() {
        let table = Table::new(root.source, "hand", span, table);
        if index >= HANDS_MAX {
            return Err(table.error(table.span(), "", format!("more than {HANDS_MAX} hands")));
        }
        let name = unique_name(&table, hands.iter().map(|other| other.name.as_str()))?;
        let key = format!("hand '{name}'");
        let table = Table { key: &key, ..table };
        table.only(&HAND_KEYS)?;
        let (entity_name, entity_span) = table
            .string("entity")?
            .map_or((format!("hand.{name}"), table.span()), |(text, span)| (text.to_owned(), span));
        let entity = hand_entity(root, names, &entity_name)
            .map_err(|why| table.error(entity_span.clone(), "entity", why))?;
        if hands.iter().any(|other| other.entity == entity) {
            let reason = format!("two hands refer to entity '{}'", shown(&entity_name));
            return Err(table.error(entity_span, "entity", reason));
        }
        let (device, device_span) = table.string("device")?.unwrap_or(("virtual", table.span()));
        if device.is_empty() || device.len() > 1024 {
            return Err(table.error(device_span, "device", "a device is named, such as \"virtual\""));
        }
        hands.push(HandEntry {
            name: name.to_owned(),
            entity,
            device: device.to_owned(),
            params: params(&table, source, names, &["hand"], index, "params")?,
            renderer: params(&table, source, names, &["hand"], index, "renderer")?,
        });
    }
    Ok(hands)
}

/// The entity of a hand, which must have a `hand` component.
fn hand_entity(root: &Table, names: &Names, name: &str) -> Result<Entity, String> {
    let tables = root.tables("entity").unwrap_or_default();
    let with_hand: Vec<&str> = tables
        .iter()
        .filter(|(_, table)| table.get(Hand::NAME).is_some())
        .filter_map(|(_, table)| table.get("name")?.get_ref().as_str())
        .collect();
    match names.get(name) {
        Some(entity) if with_hand.contains(&name) => Ok(*entity),
        _ => Err(format!(
            "'{}' is no entity with a {} component; there are: {}",
            shown(name),
            Hand::NAME,
            with_hand.join(", ")
        )),
    }
}

fn unique_name<'a>(
    table: &Table<'a>,
    mut taken: impl Iterator<Item = &'a str>,
) -> Result<&'a str, ScenarioError> {
    table.require("name")?;
    let (name, span) = table.string("name")?.unwrap_or(("", table.span()));
    check_name(table, "name", name, span.clone())?;
    if taken.any(|other| other == name) {
        return Err(table.error(span, "name", format!("the name '{name}' is taken already")));
    }
    Ok(name)
}

fn params(
    table: &Table,
    source: &Arc<Source>,
    names: &Names,
    array: &[&str; 1],
    index: usize,
    key: &str,
) -> Result<Params, ScenarioError> {
    if let Some(value) = table.get(key).filter(|value| !value.get_ref().is_table()) {
        return Err(table.wrong_type(key, value, "a table"));
    }
    let path = vec![Step::Key(array[0].to_owned()), Step::Index(index), Step::Key(key.to_owned())];
    Ok(Params::new(source, path, join(table.key, key), names))
}

/// A table of the document that other code interprets.
fn table_of_another(
    root: &Table,
    key: &str,
    source: &Arc<Source>,
    names: &Names,
) -> Result<Params, ScenarioError> {
    if let Some(value) = root.get(key).filter(|value| !value.get_ref().is_table()) {
        return Err(root.wrong_type(key, value, "a table"));
    }
    Ok(Params::new(source, vec![Step::Key(key.to_owned())], key.to_owned(), names))
}
