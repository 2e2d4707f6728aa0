//! What moves at 10 to 20 Hz is shown as if it moved all the time.
//!
//! A simulator that takes 60 ms for a step gives a body a new place every 60 ms; shown at 60 frames a second it would
//! jump in every fourth. So it is shown one step late, on the way between the two places that are known: snapshot
//! interpolation, as networked games do it (Bernier, "Latency compensating methods in client/server in-game protocol
//! design and optimization", 2001), with a delay of its own for every body. Nothing is guessed, so nothing overshoots.
//! What changes at least as often as it is shown is shown as it is, without delay.

mod track;

use std::collections::BTreeMap;

use trocar_scene::component::Component;
use trocar_scene::{Entity, JawState, Parent, Particles, Pose, Revision, SimTime, Snapshot, VertexPositions};

use track::{Blend, Track};

/// What a frame takes until it has been measured \[s\].
const FRAME_SECS: f64 = 1.0 / 60.0;
/// A pause between frames that says nothing of their rate \[s\].
const PAUSE_SECS: f64 = 0.25;
/// After so long nothing is known of how something moved \[s\].
const FORGET_SECS: f64 = 10.0;

/// What is between the snapshots that a viewer gets. One for each viewer: every snapshot that [`Motion::at`] gives has to
/// be followed ([`Renderer::update`](crate::Renderer::update), [`Stage::update`](crate::draw_list::Stage::update)) before the
/// next one is asked for.
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
    /// Whether something has come since the last frame.
    news: bool,
    /// Whether there was a reason to draw the last frame.
    active: bool,
}

/// All that moves of one kind.
struct Tracks<T>(BTreeMap<Entity, Track<T>>);

impl<T> Default for Tracks<T> {
    fn default() -> Self {
        Self(BTreeMap::new())
    }
}

impl Motion {
    /// Of nothing yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes a snapshot that came at `now`. The clock may be any that is also used for [`Motion::at`]: that of the
    /// display, or that of the session when a film is made. Snapshots may come at any rate; the same one again is no news.
    /// When time has gone back (a reset, a replay that was wound back), everything begins anew.
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
            // A pose below another parent has nothing to do with the one before.
            for (entity, _) in scene.iter_changed::<Parent>(since) {
                if before.get::<Parent>(entity) != scene.get::<Parent>(entity) {
                    self.poses.0.remove(&entity);
                }
            }
        }
        self.latest = Some(scene.clone());
    }

    /// The scene as it is to be shown at `now`; `None` before anything has come. While nothing moves, the same again.
    pub fn at(&mut self, now: SimTime) -> Option<Snapshot> {
        let now = now.as_secs_f64();
        // Whoever draws only when there is something new does not draw more slowly for it.
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

    /// Whether something was on its way in what [`Motion::at`] gave last: then the next frame shows something else, also
    /// when no news comes.
    pub fn is_moving(&self) -> bool {
        self.moving
    }

    /// How long what is shown of an entity's pose lags behind what is known \[s\].
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
            // What has just come into being has not come from anywhere.
            let Some(last) = before.get::<T>(entity) else { continue };
            self.0.entry(entity).or_insert_with(|| Track::new(last.clone())).push(value.clone(), now);
        }
    }

    /// Values that are shown in the place of those in the scene.
    fn at(&mut self, scene: &Snapshot, now: f64, frame_secs: f64) -> Vec<(Entity, T)> {
        self.0
            .retain(|entity, track| scene.get::<T>(*entity).is_some() && !track.has_rested(now, FORGET_SECS));
        let tracks = self.0.iter_mut();
        tracks.filter_map(|(entity, track)| Some((*entity, track.at(now, frame_secs)?))).collect()
    }
}
