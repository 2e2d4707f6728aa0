//! Whether bodies stay bounded: how fast they are, how far they go, what stands still, and what hands feel.

use std::collections::BTreeSet;

use nalgebra::{Point3, Vector3};
use trocar_scene::{
    DeviceForce, DeviceInfo, Entity, Frozen, Hand, HeatFrozen, LocalContactModel, RigidBody, Snapshot,
    Velocity, VertexPositions, VertexVelocities,
};

/// Fastest speed of a node or body \[m/s\]. A hand in the shipped scenes moves at less than 0.2 m/s.
pub const SPEED_MAX: f64 = 5.0;
/// Farthest distance of a node or body from the box around all of them at the beginning \[m\].
pub const REACH: f64 = 0.10;
/// Age of an instrument's contact model above which no force comes from it \[s\].
pub const MODEL_AGE_MAX: f64 = 1.0;

/// All that can be thrown about: the nodes of bodies that have velocities, and rigid bodies.
fn places(scene: &Snapshot) -> impl Iterator<Item = Point3<f64>> {
    let nodes = scene.iter::<VertexVelocities>().flat_map(|(body, _)| {
        let world_from_body = scene.world_pose(body);
        let positions = scene.get::<VertexPositions>(body).map(|of| of.positions.clone()).unwrap_or_default();
        positions.iter().map(|at| world_from_body * at).collect::<Vec<_>>()
    });
    let bodies =
        scene.iter::<RigidBody>().map(|(body, _)| Point3::from(scene.world_pose(body).translation.vector));
    nodes.chain(bodies)
}

/// The body with the fastest node, and its speed \[m/s\].
fn fastest(scene: &Snapshot) -> Option<(Entity, f64)> {
    let nodes = scene.iter::<VertexVelocities>().map(|(body, of)| {
        let speeds = of.velocities.iter().map(Vector3::norm);
        (body, speeds.fold(0.0, f64::max))
    });
    let bodies = scene
        .iter::<RigidBody>()
        .filter_map(|(body, _)| Some((body, scene.get::<Velocity>(body)?.linear.norm())));
    nodes.chain(bodies).max_by(|(_, a), (_, b)| a.total_cmp(b))
}

fn bounds(scene: &Snapshot) -> Option<[Vector3<f64>; 2]> {
    places(scene).map(|at| [at.coords; 2]).reduce(|[low, high], [at, _]| [low.inf(&at), high.sup(&at)])
}

/// Bodies that stand still because their solver could not go on.
fn still(scene: &Snapshot) -> BTreeSet<String> {
    let frozen =
        scene.iter::<Frozen>().map(|(body, frozen)| format!("{}: {}", scene.name(body), frozen.reason));
    let heat =
        scene.iter::<HeatFrozen>().map(|(body, frozen)| format!("{}: {}", scene.name(body), frozen.reason));
    frozen.chain(heat).collect()
}

/// What a session shows: its fastest node, how far a node left the box around all, and what is wrong.
pub struct Bounded {
    /// Speed of the fastest node or body \[m/s\].
    pub speed: f64,
    /// Which body that was, and when.
    pub fastest: String,
    /// Farthest distance of a node from the box \[m\].
    pub reach: f64,
    /// Farthest such distance that is not wrong \[m\]: [`REACH`], unless bodies fly about on purpose.
    pub reach_max: f64,
    /// What is wrong, in words.
    pub wrong: BTreeSet<String>,
    around: Option<[Vector3<f64>; 2]>,
    /// What stood still at the beginning.
    stood: BTreeSet<String>,
}

impl Bounded {
    /// Begins with the box around all bodies of this scene.
    pub fn around(scene: &Snapshot) -> Self {
        let (around, stood) = (bounds(scene), still(scene));
        Self {
            speed: 0.0,
            fastest: String::new(),
            reach: 0.0,
            reach_max: REACH,
            wrong: BTreeSet::new(),
            around,
            stood,
        }
    }

    /// Looks at the scene.
    pub fn look(&mut self, scene: &Snapshot) {
        if let Some((body, speed)) = fastest(scene).filter(|(_, speed)| *speed > self.speed) {
            self.speed = speed;
            self.fastest = format!("{} at {:.3} s", scene.name(body), scene.time().as_secs_f64());
        }
        if let (Some([low, high]), Some([l, h])) = (self.around, bounds(scene)) {
            self.reach = self.reach.max((low - l).max()).max((h - high).max());
        }
        self.wrong.extend(still(scene).difference(&self.stood).cloned());
        for (hand, force) in scene.iter::<DeviceForce>() {
            let most = scene.get::<DeviceInfo>(hand).map_or(f64::INFINITY, |info| info.max_force);
            let felt = force.force.norm();
            if felt > most * (1.0 + 1e-9) {
                self.wrong.insert(format!("{}: a force above its limit of {most} N", scene.name(hand)));
            }
            let instrument = scene.get::<Hand>(hand).map(|hand| hand.instrument);
            let model = instrument.and_then(|of| scene.get::<LocalContactModel>(of));
            let age = model.map_or(0.0, |model| force.at.as_secs_f64() - model.at.as_secs_f64());
            if age > MODEL_AGE_MAX && felt > 0.05 * most {
                self.wrong
                    .insert(format!("{}: a force by a model of an age of {age:.1} s", scene.name(hand)));
            }
        }
        if self.speed > SPEED_MAX {
            self.wrong.insert(format!("a node is faster than {SPEED_MAX} m/s"));
        }
        if self.reach > self.reach_max {
            self.wrong.insert(format!("a node is more than {} m outside", self.reach_max));
        }
    }
}
