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

/// A box: its lowest and its highest corner \[m\].
type Bounds = [Vector3<f64>; 2];

fn bounds(places: impl Iterator<Item = Point3<f64>>) -> Option<Bounds> {
    places.map(|at| [at.coords; 2]).reduce(|[low, high], [at, _]| [low.inf(&at), high.sup(&at)])
}

/// The box around each body that can be thrown about: around the nodes of one that has velocities, at the middle of a
/// rigid one.
fn boxes(scene: &Snapshot) -> impl Iterator<Item = (Entity, Bounds)> {
    let nodes = scene.iter::<VertexVelocities>().filter_map(|(body, _)| {
        let world_from_body = scene.world_pose(body);
        let positions = &scene.get::<VertexPositions>(body)?.positions;
        Some((body, bounds(positions.iter().map(|at| world_from_body * at))?))
    });
    let bodies =
        scene.iter::<RigidBody>().map(|(body, _)| (body, [scene.world_pose(body).translation.vector; 2]));
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
    /// Which body went so far, and when.
    pub farthest: String,
    /// Farthest such distance that is not wrong \[m\]: [`REACH`], unless bodies fly about on purpose.
    pub reach_max: f64,
    /// What is wrong, in words.
    pub wrong: BTreeSet<String>,
    around: Option<Bounds>,
    /// Bodies that the box is around. In a live session some come later: with the first ticks of their controllers.
    known: BTreeSet<Entity>,
    /// What stood still at the beginning.
    stood: BTreeSet<String>,
}

impl Bounded {
    /// Begins with the box around all bodies of this scene.
    pub fn around(scene: &Snapshot) -> Self {
        let mut begun = Self {
            speed: 0.0,
            fastest: String::new(),
            reach: 0.0,
            farthest: String::new(),
            reach_max: REACH,
            wrong: BTreeSet::new(),
            around: None,
            known: BTreeSet::new(),
            stood: still(scene),
        };
        begun.measure_reach(scene);
        begun
    }

    /// How far bodies are from the box, which grows by those that are seen for the first time.
    fn measure_reach(&mut self, scene: &Snapshot) {
        for (body, [low, high]) in boxes(scene) {
            if self.known.insert(body) {
                let [l, h] = self.around.unwrap_or([low, high]);
                self.around = Some([l.inf(&low), h.sup(&high)]);
            }
            let [l, h] = self.around.expect("a body was seen");
            let reach = (l - low).max().max((high - h).max());
            if reach > self.reach {
                self.reach = reach;
                self.farthest = format!("{} at {:.3} s", scene.name(body), scene.time().as_secs_f64());
            }
        }
    }

    /// Looks at the scene.
    pub fn look(&mut self, scene: &Snapshot) {
        if let Some((body, speed)) = fastest(scene).filter(|(_, speed)| *speed > self.speed) {
            self.speed = speed;
            self.fastest = format!("{} at {:.3} s", scene.name(body), scene.time().as_secs_f64());
        }
        self.measure_reach(scene);
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
