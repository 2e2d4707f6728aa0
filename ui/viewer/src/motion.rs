//! Snapshot interpolation: bodies that a simulator moves at 10 to 20 Hz are shown in smooth motion.
//!
//! A simulator with a step of 60 ms moves a body every 60 ms; at 60 frames a second the body would jump in every fourth
//! frame. So it is shown one step late, interpolated between two known positions: snapshot interpolation, as in
//! networked games (Bernier, "Latency compensating methods in client/server in-game protocol design and optimization",
//! 2001), with a separate delay for every body. Nothing is extrapolated, so nothing overshoots. A body that changes at
//! least once per frame is shown without delay.

mod track;

use std::collections::BTreeMap;

use trocar_scene::component::Component;
use trocar_scene::{Entity, JawState, Parent, Particles, Pose, Revision, SimTime, Snapshot, VertexPositions};

use track::{Blend, Track};

/// Assumed frame time until it is measured \[s\].
const FRAME_SECS: f64 = 1.0 / 60.0;
/// A longer gap between frames does not count as a frame time \[s\].
const PAUSE_SECS: f64 = 0.25;
/// Motion data older than this is discarded \[s\].
const FORGET_SECS: f64 = 10.0;

/// Interpolates between the snapshots of a viewer; one instance for each viewer. Every snapshot from [`Motion::at`]
/// must be followed ([`Renderer::update`](crate::Renderer::update),
/// [`DrawList::update`](crate::draw_list::DrawList::update)) before the next one is asked for.
#[derive(Default)]
pub struct Motion {
    latest: Option<Snapshot>,
    poses: Tracks<Pose>,
    jaws: Tracks<JawState>,
    vertices: Tracks<VertexPositions>,
    particles: Tracks<Particles>,
    now: f64,
    shown_at: Option<f64>,
    frame_secs: Option<f64>,
    number: u64,
    moving: bool,
    /// Whether a snapshot has arrived since the last frame.
    news: bool,
    /// Whether there was a reason to draw the last frame.
    active: bool,
}

/// The tracks of one kind of component.
struct Tracks<T>(BTreeMap<Entity, Track<T>>);

impl<T> Default for Tracks<T> {
    fn default() -> Self {
        Self(BTreeMap::new())
    }
}

impl Motion {
    /// Without any snapshot.
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes a snapshot that arrived at `now`. The clock may be any that is also used for [`Motion::at`]: that of the
    /// display, or that of the session for a film. Snapshots may arrive at any rate; a repeated one changes nothing. If
    /// time has gone back (a reset, a rewound replay), everything restarts.
    pub fn feed(&mut self, scene: &Snapshot, now: SimTime) {
        let now = now.as_secs_f64();
        let before = self.latest.take().filter(|before| {
            now >= self.now && scene.revision() >= before.revision() && scene.time() >= before.time()
        });
        self.now = now;
        let Some(before) = before else {
            self.forget();
            self.latest = Some(scene.clone());
            return;
        };
        let since = before.revision();
        if scene.revision() > since {
            self.news = true;
            self.poses.feed(&before, scene, since, now);
            self.jaws.feed(&before, scene, since, now);
            self.vertices.feed(&before, scene, since, now);
            self.particles.feed(&before, scene, since, now);
            // A pose relative to a new parent cannot be interpolated with the old one.
            for (entity, _) in scene.iter_changed::<Parent>(since) {
                if before.get::<Parent>(entity) != scene.get::<Parent>(entity) {
                    self.poses.0.remove(&entity);
                }
            }
        }
        self.latest = Some(scene.clone());
    }

    /// The interpolated scene at `now`; `None` before the first snapshot. While nothing moves, the same snapshot again.
    pub fn at(&mut self, now: SimTime) -> Option<Snapshot> {
        let now = now.as_secs_f64();
        // A viewer that draws only on changes must not measure its idle time as frame time.
        let active = std::mem::take(&mut self.news) || self.moving;
        let was_active = std::mem::replace(&mut self.active, active);
        if let Some(before) = self.shown_at
            && was_active
            && active
            && now > before
            && now - before < PAUSE_SECS
        {
            let secs = now - before;
            let known = self.frame_secs.unwrap_or(secs);
            self.frame_secs = Some(known + 0.2 * (secs - known));
        }
        self.shown_at = Some(now);
        let frame_secs = self.frame_secs.unwrap_or(FRAME_SECS);
        let mut scene = self.latest.clone()?;
        let poses = self.poses.at(&scene, now, frame_secs);
        let jaws = self.jaws.at(&scene, now, frame_secs);
        let vertices = self.vertices.at(&scene, now, frame_secs);
        let particles = self.particles.at(&scene, now, frame_secs);
        self.moving = !(poses.is_empty() && jaws.is_empty() && vertices.is_empty() && particles.is_empty());
        self.number += u64::from(self.moving);
        scene.retouch(self.number, poses);
        scene.retouch(self.number, jaws);
        scene.retouch(self.number, vertices);
        scene.retouch(self.number, particles);
        Some(scene)
    }

    /// Whether the last snapshot of [`Motion::at`] had interpolated motion: then the next frame differs, even without a
    /// new snapshot.
    pub fn is_moving(&self) -> bool {
        self.moving
    }

    /// Delay of an entity's displayed pose behind the latest one \[s\].
    pub fn delay_secs(&self, entity: Entity) -> f64 {
        self.poses.0.get(&entity).map_or(0.0, Track::delay_secs)
    }

    fn forget(&mut self) {
        self.poses.0.clear();
        self.jaws.0.clear();
        self.vertices.0.clear();
        self.particles.0.clear();
        self.shown_at = None;
    }
}

impl<T: Component + Blend> Tracks<T> {
    fn feed(&mut self, before: &Snapshot, scene: &Snapshot, since: Revision, now: f64) {
        for (entity, value) in scene.iter_changed::<T>(since) {
            // A new entity has no previous position.
            let Some(last) = before.get::<T>(entity) else { continue };
            self.0.entry(entity).or_insert_with(|| Track::new(last.clone())).push(value.clone(), now);
        }
    }

    /// Interpolated values that replace those in the scene.
    fn at(&mut self, scene: &Snapshot, now: f64, frame_secs: f64) -> Vec<(Entity, T)> {
        self.0
            .retain(|entity, track| scene.get::<T>(*entity).is_some() && !track.has_rested(now, FORGET_SECS));
        let tracks = self.0.iter_mut();
        tracks.filter_map(|(entity, track)| Some((*entity, track.at(now, frame_secs)?))).collect()
    }
}
