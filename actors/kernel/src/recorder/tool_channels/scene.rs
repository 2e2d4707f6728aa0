//! `/scene` and `/scene/deforming`: what is to be seen, in the frames of `/tf`.

use std::collections::BTreeSet;

use serde_json::{Value, json};
use trocar_scene::shapes::instrument_surface;
use trocar_scene::{
    Component, Entity, Instrument, Revision, Shape, SimTime, Snapshot, VertexPositions, VisualMaterial,
};

use super::super::format::channel;
use super::cadence::Cadence;
use super::drawing::Drawing;
use super::frames::JAWS;
use super::meshes::{CoarseMesh, has_mesh};
use super::numbers::stamp;
use super::{Message, ToolCache};

/// Least time from one message to the next.
const PERIOD: SimTime = SimTime::from_millis(1_000);
/// Most vertices of a body of a fixed form.
const FIXED_VERTICES_MAX: usize = 2_000;
/// Most vertices of all deforming bodies together, which are told every second.
const DEFORMING_VERTICES_MAX: usize = 500;
/// Fewest of each of them.
const DEFORMING_VERTICES_MIN: usize = 24;
/// Longest text of a message; entities beyond it are left out.
const TEXT_MAX: usize = 1 << 20;
/// Segments around the shaft of an instrument.
const SHAFT_SEGMENTS: usize = 8;

/// A topic: its channel, and the ids of the entities that a viewer has from it.
struct Shown {
    channel: u16,
    ids: BTreeSet<String>,
    /// Whether the last message left something out.
    is_full: bool,
}

impl Shown {
    fn new(channel: u16) -> Self {
        Self { channel, ids: BTreeSet::new(), is_full: false }
    }

    /// Shows these entities, and no others.
    fn show(&mut self, entities: Vec<(String, Value)>, now: SimTime, message: &mut Message<'_>) {
        let mut left = TEXT_MAX;
        let (mut ids, mut kept, mut is_full) = (BTreeSet::new(), Vec::new(), false);
        for (id, entity) in entities {
            let length = entity.to_string().len();
            if length > left {
                if !self.is_full {
                    tracing::warn!("the recording shows viewers no '{id}': too much for one message");
                }
                is_full = true;
                continue;
            }
            left -= length;
            ids.insert(id);
            kept.push(entity);
        }
        let gone = self.ids.difference(&ids).map(|id| json!({"timestamp": stamp(now), "type": 0, "id": id}));
        let deletions: Vec<Value> = gone.collect();
        if !(kept.is_empty() && deletions.is_empty()) {
            message(self.channel, &json!({"deletions": deletions, "entities": kept}));
        }
        (self.ids, self.is_full) = (ids, is_full);
    }
}

/// What has been shown.
pub(super) struct Bodies {
    cadence: Cadence,
    /// A body whose vertices were written after this is a deforming one.
    begun: Revision,
    since: Revision,
    fixed: Vec<Entity>,
    deforming: BTreeSet<Entity>,
    shown_fixed: Shown,
    shown_deforming: Shown,
    is_anew: bool,
}

impl Bodies {
    pub(super) fn new(begun: Revision) -> Self {
        Self {
            cadence: Cadence::new(PERIOD),
            begun,
            since: Revision::ZERO,
            fixed: Vec::new(),
            deforming: BTreeSet::new(),
            shown_fixed: Shown::new(channel::SCENE),
            shown_deforming: Shown::new(channel::SCENE_DEFORMING),
            is_anew: true,
        }
    }

    pub(super) fn begin_anew(&mut self) {
        self.is_anew = true;
        self.cadence.hurry();
    }

    /// Shows what has changed.
    pub(super) fn tell(
        &mut self,
        cache: &mut ToolCache,
        scene: &Snapshot,
        now: SimTime,
        message: &mut Message<'_>,
    ) {
        if !self.cadence.is_due(now) {
            return;
        }
        let moved = scene.iter_changed::<VertexPositions>(self.begun).map(|(entity, _)| entity);
        self.deforming = moved.filter(|entity| has_mesh(scene, *entity)).collect();
        let fixed: BTreeSet<Entity> = scene
            .iter::<Shape>()
            .map(|(entity, _)| entity)
            .chain(scene.iter::<Instrument>().map(|(entity, _)| entity))
            .chain(scene.iter::<VertexPositions>().map(|(entity, _)| entity).filter(|e| has_mesh(scene, *e)))
            .filter(|entity| !self.deforming.contains(entity))
            .collect();
        let fixed: Vec<Entity> = fixed.into_iter().collect();
        if self.is_anew || fixed != self.fixed || self.looks_changed(scene, &fixed) {
            let entities = fixed.iter().flat_map(|entity| drawn(cache, scene, *entity, now)).collect();
            self.shown_fixed.show(entities, now, message);
            self.fixed = fixed;
        }
        let deforms = scene.iter_changed::<VertexPositions>(self.since).next().is_some();
        if self.is_anew || deforms || (self.deforming.is_empty() && !self.shown_deforming.ids.is_empty()) {
            let entities = self.deforming(cache, scene, now);
            self.shown_deforming.show(entities, now, message);
        }
        self.is_anew = false;
        self.since = scene.revision();
    }

    /// Whether the form or the colour of one of these has changed.
    fn looks_changed(&self, scene: &Snapshot, fixed: &[Entity]) -> bool {
        fn any<T: Component>(scene: &Snapshot, since: Revision, of: &[Entity]) -> bool {
            scene.iter_changed::<T>(since).any(|(entity, _)| of.binary_search(&entity).is_ok())
        }
        any::<Shape>(scene, self.since, fixed)
            || any::<Instrument>(scene, self.since, fixed)
            || any::<VisualMaterial>(scene, self.since, fixed)
    }

    fn deforming(&self, cache: &mut ToolCache, scene: &Snapshot, now: SimTime) -> Vec<(String, Value)> {
        let vertices =
            |entity: &Entity| scene.get::<VertexPositions>(*entity).map_or(0, |v| v.positions.len());
        let all: usize = self.deforming.iter().map(vertices).sum();
        let mut shown = Vec::new();
        for entity in &self.deforming {
            let share = DEFORMING_VERTICES_MAX * vertices(entity) / all.max(1);
            shown.extend(mesh(cache, scene, *entity, share.max(DEFORMING_VERTICES_MIN), now));
        }
        shown
    }
}

/// An entity of a fixed form, and the jaws of an instrument.
fn drawn(cache: &mut ToolCache, scene: &Snapshot, entity: Entity, now: SimTime) -> Vec<(String, Value)> {
    let name = cache.names.name(scene, entity).to_owned();
    let frame = cache.names.frame(scene, Some(entity)).to_owned();
    let material = scene.get::<VisualMaterial>(entity);
    if let Some(shape) = scene.get::<Shape>(entity) {
        let mut drawing = Drawing::new(material);
        drawing.shape(shape);
        return vec![(name.clone(), drawing.entity(&name, &frame, now))];
    }
    let Some(instrument) = scene.get::<Instrument>(entity) else {
        return mesh(cache, scene, entity, FIXED_VERTICES_MAX, now).into_iter().collect();
    };
    let Ok(surface) = instrument_surface(instrument, SHAFT_SEGMENTS) else { return Vec::new() };
    let whole = |surface| {
        let mut drawing = Drawing::new(material);
        drawing.surface(surface);
        drawing
    };
    let mut parts = vec![(name.clone(), whole(&surface.shaft).entity(&name, &frame, now))];
    for ((_, jaw), surface) in JAWS.into_iter().zip([&surface.jaw_a, &surface.jaw_b]) {
        if let Some(surface) = surface {
            let id = format!("{name}/{jaw}");
            let entity = whole(surface).entity(&id, &id, now);
            parts.push((id, entity));
        }
    }
    parts
}

/// A body with a mesh, drawn with at most `most` vertices.
fn mesh(
    cache: &mut ToolCache,
    scene: &Snapshot,
    entity: Entity,
    most: usize,
    now: SimTime,
) -> Option<(String, Value)> {
    let mesh = cache.meshes.of(scene, entity, most)?;
    let positions = &scene.get::<VertexPositions>(entity)?.positions;
    let mut drawing = Drawing::new(scene.get::<VisualMaterial>(entity));
    match &mesh {
        CoarseMesh::Surface(surface) => drawing.coarse(surface, positions),
        CoarseMesh::Line(line, radius) => drawing.thread(line, *radius, positions),
    }
    let name = cache.names.name(scene, entity).to_owned();
    let drawn = drawing.entity(&name, cache.names.frame(scene, Some(entity)), now);
    Some((name, drawn))
}
