//! The board: notes become components, and components follow the scene.

use std::collections::{BTreeMap, BTreeSet};

use trocar_scene::annotation::SurfaceParts;
use trocar_scene::{
    Access, Commands, Component, Entity, EntitySet, LABELS_MAX, LineMesh, MentorLabel, MentorPointer,
    MentorStroke, PictureFreeze, SECTIONS_MAX, Signature, Snapshot, SurfaceMesh, SurfacePlace,
    TakeOverRequest, TetMesh,
};

use super::sections::{Look, extend};
use crate::control::{Note, NoteKind, NoteRefusal, PlainText, Refusal};
use crate::ticket::PlainName;

/// Most removed entities that wait until a snapshot has them: those of two batches in a row.
const GONE_MAX: usize = 2 * (SECTIONS_MAX + LABELS_MAX);
/// Beyond so many bodies, those without places are forgotten at once, and not with the next cut.
const BODIES_MANY: usize = 32;

/// Who sends a note, as the host knows it.
#[derive(Clone, Copy, Debug)]
pub struct Author<'a> {
    /// Name of the station.
    pub name: &'a PlainName,
    /// Whether it is the host itself.
    pub is_host: bool,
}

/// Turns notes into components of the scene, see [`crate::annotation`].
///
/// It is the only writer of those components, so that it knows them without waiting for a snapshot of what it has just
/// written. [`AnnotationBoard::of`] reads them from a scene, so that one that is built anew goes on.
#[derive(Debug, Default)]
pub struct AnnotationBoard {
    /// By station.
    pointers: BTreeMap<u16, Row<MentorPointer>>,
    /// By station, stroke and section.
    strokes: BTreeMap<(u16, u32, u16), Row<MentorStroke>>,
    /// By station and number.
    labels: BTreeMap<(u16, u32), Row<MentorLabel>>,
    freeze: Option<Row<PictureFreeze>>,
    /// By the hand's entity.
    requests: BTreeMap<Entity, TakeOverRequest>,
    /// The bodies that have places.
    bodies: BTreeMap<Entity, Body>,
    /// Entities to remove as soon as the scene has them.
    gone: Vec<Entity>,
}

/// A body with places.
#[derive(Clone, Debug)]
struct Body {
    parts: SurfaceParts,
    /// Whether all places on it are known to be among these parts.
    is_checked: bool,
}

/// An entity of the board with its only component.
#[derive(Clone, Debug)]
struct Row<T> {
    entity: Entity,
    value: T,
    /// A snapshot has had it.
    is_seen: bool,
}

impl<T: Component> Row<T> {
    fn spawn(value: T, out: &mut Commands) -> Self {
        let entity = out.spawn();
        out.put(entity, value.clone());
        Self { entity, value, is_seen: false }
    }
    fn put(&mut self, value: T, out: &mut Commands) {
        out.put(self.entity, value.clone());
        self.value = value;
    }
    /// Whether it is still there: one that a snapshot has had, and this one has not, somebody else has removed.
    fn follow(&mut self, scene: &Snapshot) -> bool {
        let is_there = scene.get::<T>(self.entity).is_some();
        self.is_seen |= is_there;
        is_there || !self.is_seen
    }
}

impl AnnotationBoard {
    /// With what a scene has.
    pub fn of(scene: &Snapshot) -> Self {
        fn row<T: Component>((entity, value): (Entity, &T)) -> Row<T> {
            Row { entity, value: value.clone(), is_seen: true }
        }
        let mut board = Self::default();
        let strokes = scene.iter::<MentorStroke>().map(row);
        board.strokes = strokes.map(|row| (key(&row.value), row)).collect();
        let labels = scene.iter::<MentorLabel>().map(row);
        board.labels = labels.map(|row| ((row.value.by.station, row.value.label), row)).collect();
        let pointers = scene.iter::<MentorPointer>().map(row);
        board.pointers = pointers.map(|row| (row.value.by.station, row)).collect();
        board.freeze = scene.iter::<PictureFreeze>().map(row).next();
        board.requests =
            scene.iter::<TakeOverRequest>().map(|(hand, request)| (hand, request.clone())).collect();
        let marked: BTreeSet<Entity> = board.marked().collect();
        let body = |entity| Body { parts: SurfaceParts::read(scene, entity), is_checked: false };
        board.bodies = marked.into_iter().map(|entity| (entity, body(entity))).collect();
        board
    }

    /// What its controller reads and writes.
    #[must_use]
    pub fn access(access: Access) -> Access {
        access
            .reads::<SurfaceMesh>()
            .reads::<TetMesh>()
            .reads::<LineMesh>()
            .spawns()
            .writes::<MentorPointer>(EntitySet::Own)
            .writes::<MentorStroke>(EntitySet::Own)
            .writes::<MentorLabel>(EntitySet::Own)
            .writes::<PictureFreeze>(EntitySet::Own)
            .writes::<TakeOverRequest>(EntitySet::All)
    }

    /// Shows a note, whose author's role allows it. Nothing is changed if it is refused.
    ///
    /// # Errors
    /// [`Refusal`], in words for the station.
    pub fn apply(
        &mut self,
        note: &Note,
        author: Author<'_>,
        scene: &Snapshot,
        out: &mut Commands,
    ) -> Result<(), Refusal> {
        let Note { station, at, .. } = *note;
        let by = Signature { station, name: author.name.as_str().to_owned(), at };
        match &note.what {
            NoteKind::Pointer(place) => self.point(*place, by, scene, out),
            NoteKind::Stroke { stroke, colour, width, places } => {
                let look = Look { colour: *colour, width: *width };
                self.draw((*stroke, look), &by, places, scene, out)
            }
            NoteKind::Erase { stroke } => {
                self.erase(|(of, number, _)| (of, number) == (station, *stroke));
                Ok(())
            }
            NoteKind::Label { label, place, text } => self.label(*label, *place, text, by, scene, out),
            NoteKind::Unlabel { label } => {
                self.unlabel(|own| own == (station, *label));
                Ok(())
            }
            NoteKind::Freeze(true) => match &self.freeze {
                Some(frozen) if frozen.value.by.station != station => {
                    let by = PlainText::new(&frozen.value.by.name);
                    Err(NoteRefusal::Frozen { by }.into())
                }
                Some(_) => Ok(()),
                None => {
                    self.freeze = Some(Row::spawn(PictureFreeze { by }, out));
                    Ok(())
                }
            },
            NoteKind::Freeze(false) => {
                self.gone.extend(self.freeze.take().map(|row| row.entity));
                Ok(())
            }
            // Who serves a hand the session changes: Self::show_requests.
            NoteKind::TakeOver { .. } => Ok(()),
            NoteKind::Clear { station: whose } => {
                if *whose != Some(station) && !author.is_host {
                    return Err(NoteRefusal::NotOwn.into());
                }
                let is_meant = |of: u16| whose.is_none_or(|whose| whose == of);
                self.erase(|(of, ..)| is_meant(of));
                self.unlabel(|(of, _)| is_meant(of));
                Ok(())
            }
        }
    }

    /// Shows the requests for instruments as the session has them, at the entities of their hands.
    pub fn show_requests(
        &mut self,
        requests: impl Iterator<Item = (Entity, TakeOverRequest)>,
        scene: &Snapshot,
        out: &mut Commands,
    ) {
        let wished: BTreeMap<Entity, TakeOverRequest> =
            requests.filter(|(hand, _)| scene.contains(*hand)).collect();
        self.requests.retain(|hand, _| scene.contains(*hand));
        for hand in self.requests.keys().filter(|hand| !wished.contains_key(hand)) {
            out.remove::<TakeOverRequest>(*hand);
        }
        for (hand, request) in
            wished.iter().filter(|(hand, request)| self.requests.get(hand) != Some(request))
        {
            out.put(*hand, request.clone());
        }
        self.requests = wished;
    }

    /// A station has left: its pointer goes, and a picture that it has frozen goes on. Its strokes and labels stay.
    pub fn leave(&mut self, station: u16) {
        self.gone.extend(self.pointers.remove(&station).map(|row| row.entity));
        if self.freeze.as_ref().is_some_and(|row| row.value.by.station == station) {
            self.gone.extend(self.freeze.take().map(|row| row.entity));
        }
    }

    /// Follows the scene: what is on tissue that is cut away, or on a body that is gone, goes too. Once a tick, after the
    /// notes of that tick; it also carries out what they removed.
    pub fn follow(&mut self, scene: &Snapshot, out: &mut Commands) {
        self.pointers.retain(|_, row| row.follow(scene));
        self.strokes.retain(|_, row| row.follow(scene));
        self.labels.retain(|_, row| row.follow(scene));
        if self.freeze.as_mut().is_some_and(|row| !row.follow(scene)) {
            self.freeze = None;
        }
        if self.look_at_bodies(scene) {
            self.keep_what_is_there(scene, out);
        }
        if self.bodies.len() > BODIES_MANY {
            self.forget_bodies();
        }
        let mut wait = Vec::new();
        for entity in self.gone.drain(..) {
            if scene.contains(entity) {
                out.despawn(entity);
            } else {
                wait.push(entity);
            }
        }
        wait.truncate(GONE_MAX);
        self.gone = wait;
    }

    fn point(
        &mut self,
        place: Option<SurfacePlace>,
        by: Signature,
        scene: &Snapshot,
        out: &mut Commands,
    ) -> Result<(), Refusal> {
        let station = by.station;
        let Some(place) = place else {
            self.gone.extend(self.pointers.remove(&station).map(|row| row.entity));
            return Ok(());
        };
        if !self.is_there(&place, scene) {
            return Err(NoteRefusal::NoSurface.into());
        }
        let pointer = MentorPointer { by, place };
        match self.pointers.get_mut(&station) {
            Some(row) => row.put(pointer, out),
            None => {
                self.pointers.insert(station, Row::spawn(pointer, out));
            }
        }
        Ok(())
    }

    fn draw(
        &mut self,
        stroke: (u32, Look),
        by: &Signature,
        places: &[SurfacePlace],
        scene: &Snapshot,
        out: &mut Commands,
    ) -> Result<(), Refusal> {
        let there: Vec<Option<SurfacePlace>> =
            places.iter().map(|place| self.is_there(place, scene).then_some(*place)).collect();
        if there.iter().all(Option::is_none) {
            return Err(NoteRefusal::NoSurface.into());
        }
        let (station, number) = (by.station, stroke.0);
        let own = (station, number, 0)..=(station, number, u16::MAX);
        let last = self.strokes.range(own).next_back().map(|(_, row)| &row.value);
        let changed = extend(last, stroke, by, there);
        let fresh = changed.iter().filter(|section| !self.strokes.contains_key(&key(section))).count();
        if self.strokes.len() + fresh > SECTIONS_MAX {
            return Err(NoteRefusal::StrokesFull { most: SECTIONS_MAX as u16 }.into());
        }
        for section in changed {
            match self.strokes.get_mut(&key(&section)) {
                Some(row) => row.put(section, out),
                None => {
                    self.strokes.insert(key(&section), Row::spawn(section, out));
                }
            }
        }
        Ok(())
    }

    fn label(
        &mut self,
        label: u32,
        place: SurfacePlace,
        text: &PlainText,
        by: Signature,
        scene: &Snapshot,
        out: &mut Commands,
    ) -> Result<(), Refusal> {
        let text = text.as_str().trim().to_owned();
        if text.is_empty() {
            return Err(NoteRefusal::NoText.into());
        }
        if !self.is_there(&place, scene) {
            return Err(NoteRefusal::NoSurface.into());
        }
        let key = (by.station, label);
        let value = MentorLabel { by, label, place, text };
        if let Some(row) = self.labels.get_mut(&key) {
            row.put(value, out);
            return Ok(());
        }
        if self.labels.len() >= LABELS_MAX {
            return Err(NoteRefusal::LabelsFull { most: LABELS_MAX as u16 }.into());
        }
        self.labels.insert(key, Row::spawn(value, out));
        Ok(())
    }

    fn erase(&mut self, is_meant: impl Fn((u16, u32, u16)) -> bool) {
        let erased = self.strokes.extract_if(.., |key, _| is_meant(*key));
        self.gone.extend(erased.map(|(_, row)| row.entity));
    }

    fn unlabel(&mut self, is_meant: impl Fn((u16, u32)) -> bool) {
        let taken = self.labels.extract_if(.., |key, _| is_meant(*key));
        self.gone.extend(taken.map(|(_, row)| row.entity));
    }

    /// Whether the scene has a place; its body is looked at from then on.
    fn is_there(&mut self, place: &SurfacePlace, scene: &Snapshot) -> bool {
        if !scene.contains(place.entity) {
            return false;
        }
        let read = || SurfaceParts::read(scene, place.entity);
        let body =
            self.bodies.entry(place.entity).or_insert_with(|| Body { parts: read(), is_checked: true });
        if !body.parts.is_of(scene) {
            *body = Body { parts: read(), is_checked: false };
        }
        body.parts.has(place)
    }

    /// Reads the parts of bodies that have others than before. Whether there is a body whose places have to be checked.
    fn look_at_bodies(&mut self, scene: &Snapshot) -> bool {
        let mut is_due = false;
        for (entity, body) in &mut self.bodies {
            if !body.parts.is_of(scene) {
                *body = Body { parts: SurfaceParts::read(scene, *entity), is_checked: false };
            }
            is_due |= !body.is_checked || !scene.contains(*entity);
        }
        is_due
    }

    fn keep_what_is_there(&mut self, scene: &Snapshot, out: &mut Commands) {
        let Self { pointers, strokes, labels, bodies, gone, .. } = self;
        let is_there = |place: &SurfacePlace| match bodies.get(&place.entity) {
            Some(body) => scene.contains(place.entity) && (body.is_checked || body.parts.has(place)),
            None => false,
        };
        let lost = pointers.extract_if(.., |_, row| !is_there(&row.value.place));
        gone.extend(lost.map(|(_, row)| row.entity));
        let lost = labels.extract_if(.., |_, row| !is_there(&row.value.place));
        gone.extend(lost.map(|(_, row)| row.entity));
        strokes.retain(|_, row| {
            if row.value.places.iter().all(is_there) {
                return true;
            }
            match row.value.keeping(is_there) {
                Some(rest) => row.put(rest, out),
                None => {
                    gone.push(row.entity);
                    return false;
                }
            }
            true
        });
        bodies.values_mut().for_each(|body| body.is_checked = true);
        self.forget_bodies();
    }

    fn forget_bodies(&mut self) {
        let marked: BTreeSet<Entity> = self.marked().collect();
        self.bodies.retain(|entity, _| marked.contains(entity));
    }

    /// Entities that have places, some more than once.
    fn marked(&self) -> impl Iterator<Item = Entity> {
        let strokes = self.strokes.values().flat_map(|row| row.value.places.iter());
        let labels = self.labels.values().map(|row| &row.value.place);
        let pointers = self.pointers.values().map(|row| &row.value.place);
        strokes.chain(labels).chain(pointers).map(|place| place.entity)
    }
}

fn key(stroke: &MentorStroke) -> (u16, u32, u16) {
    (stroke.by.station, stroke.stroke, stroke.section)
}
