//! Watches whether contacts are kept: bodies that penetrate each other too deeply, and forces that are too large.
//!
//! Whatever detects or answers a contact, its row of the collision list says between whom, where, how deep and how
//! strong it is. A contact that is not kept is told once, until it has been kept again for a while.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{Point3, Vector3};
use trocar_dynamics::soft_body::grasp::Grips;
use trocar_scene::{
    Activation, Collision, CollisionList, Commands, Entity, Instrument, RigidBody, Shape, SimTime, Snapshot,
    TetMesh, VertexPositions,
};

use crate::summary::{UnkeptContact, UnkeptKind};

/// Name of the event; its subject and object are the pair, its value is the depth \[m\] or the force \[N\].
pub const EVENT: &str = "contact_not_kept";
/// Deepest penetration, as a share of the thickness of the thinner body: its smallest extent, or a shaft's diameter.
pub const DEPTH_SHARE: f64 = 0.75;
/// Largest force of one contact \[N\]. No hand presses an instrument so hard, and no tissue bears it.
pub const FORCE_MAX: f64 = 100.0;
/// A contact that was kept for this long is told anew when it is not kept again.
const KEPT_AGAIN: SimTime = SimTime::from_millis(500);
/// Most contacts that are told one by one; further ones are counted.
pub const TOLD_MAX: usize = 64;

/// Watches the contacts of a session.
#[derive(Clone, Debug, Default)]
pub struct ContactWatch {
    told: Vec<UnkeptContact>,
    count: u64,
    /// When each pair was last found not to keep its contact.
    last: BTreeMap<(Entity, Entity, UnkeptKind), SimTime>,
    /// Thickness of each body that was asked for \[m\]; `None` for sheets and threads, which have none.
    thickness: BTreeMap<Entity, Option<f64>>,
    /// Instruments that were switched on: they burn their way into what they touch.
    active: BTreeSet<Entity>,
    /// Contacts to be told as events.
    untold: Vec<(Entity, Option<Entity>, f64)>,
}

impl ContactWatch {
    /// Looks at the scene at session time `now`.
    pub fn look(&mut self, now: SimTime, scene: &Snapshot) {
        let active = scene.iter::<Activation>().filter(|(_, activation)| activation.level > 0.0);
        self.active.extend(active.map(|(tool, _)| tool));
        for (_, list) in scene.iter::<CollisionList>() {
            for row in &list.collisions {
                self.judge(now, scene, row);
            }
        }
    }

    /// Writes an event for each contact that was found since the last call.
    pub fn tell(&mut self, out: &mut Commands) {
        for (a, b, value) in self.untold.drain(..) {
            out.event(EVENT, a, b, value);
        }
    }

    /// Whether there is anything to tell.
    pub fn has_news(&self) -> bool {
        !self.untold.is_empty()
    }

    /// Forgets what was to be told as events: in a scene without an exercise, such as one that shows how contacts are
    /// detected, bodies may pass through each other on purpose.
    pub fn keep_quiet(&mut self) {
        self.untold.clear();
    }

    /// The contacts that were not kept, in order, and the number of all.
    pub fn found(self) -> (Vec<UnkeptContact>, u64) {
        (self.told, self.count)
    }

    fn judge(&mut self, now: SimTime, scene: &Snapshot, row: &Collision) {
        let pair = (row.a, row.b);
        let force = row.force_in_world.norm();
        let burns = [row.a, row.b].iter().any(|body| self.active.contains(body));
        let is_deep = row.depth > 0.0 && !burns && !is_grasp(scene, row);
        // Sheets and threads have no depth in which another body could be.
        let both = is_deep.then(|| [row.a, row.b].map(|body| self.thickness_of(scene, body)));
        let thickness = both.and_then(|[a, b]| Some(a?.min(b?)));
        let place = row.middle_in_world();
        if let Some(limit) =
            thickness.map(|thickness| DEPTH_SHARE * thickness).filter(|limit| row.depth > *limit)
        {
            self.find(now, scene, UnkeptKind::Penetration, pair, place, (row.depth, limit));
        }
        if force > FORCE_MAX {
            self.find(now, scene, UnkeptKind::Force, pair, place, (force, FORCE_MAX));
        }
    }

    /// Takes in a contact that is not kept.
    fn find(
        &mut self,
        now: SimTime,
        scene: &Snapshot,
        kind: UnkeptKind,
        (a, b): (Entity, Entity),
        at_in_world: Point3<f64>,
        (value, limit): (f64, f64),
    ) {
        let last = self.last.insert((a.min(b), a.max(b), kind), now);
        if last.is_some_and(|last| now < last + KEPT_AGAIN) {
            return;
        }
        self.count += 1;
        self.untold.push((a, Some(b), value));
        if self.told.len() < TOLD_MAX {
            self.told.push(UnkeptContact {
                kind,
                at_secs: now.as_secs_f64(),
                a: scene.name(a),
                b: scene.name(b),
                at_in_world: at_in_world.coords.into(),
                value,
                limit,
            });
        }
    }

    fn thickness_of(&mut self, scene: &Snapshot, body: Entity) -> Option<f64> {
        *self.thickness.entry(body).or_insert_with(|| thickness(scene, body))
    }
}

/// Whether the row tells a grasp: its depth is how far the held vertices were drawn.
fn is_grasp(scene: &Snapshot, row: &Collision) -> bool {
    let holds = |body: Entity, tool: Entity| {
        let grips = scene.get::<Grips>(body);
        grips.is_some_and(|grips| grips.picks.picks.iter().any(|pick| pick.instrument == tool.to_bits()))
    };
    holds(row.b, row.a) || holds(row.a, row.b)
}

/// Thickness of a body at its thinnest \[m\]; `None` for sheets, threads, and what has no shape.
fn thickness(scene: &Snapshot, body: Entity) -> Option<f64> {
    if let Some(instrument) = scene.get::<Instrument>(body) {
        return Some(2.0 * instrument.shaft_radius);
    }
    if let Some(shape) = scene.get::<Shape>(body) {
        return Some(match shape {
            Shape::Box { half_extents: [x, y, z] } => 2.0 * x.min(*y).min(*z),
            Shape::Sphere { radius } | Shape::Capsule { radius, .. } => 2.0 * radius,
            Shape::Cylinder { radius, half_height } => 2.0 * radius.min(*half_height),
            Shape::Torus { tube_radius, .. } => 2.0 * tube_radius,
            Shape::PegBoard { thickness, peg_radius, .. } => thickness.min(2.0 * peg_radius),
        });
    }
    let has_volume = scene.get::<TetMesh>(body).is_some() || scene.get::<RigidBody>(body).is_some();
    let positions = &scene.get::<VertexPositions>(body).filter(|_| has_volume)?.positions;
    let none = [Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY)];
    let [low, high] =
        positions.iter().fold(none, |[low, high], at| [low.inf(&at.coords), high.sup(&at.coords)]);
    Some((high - low).min()).filter(|thickness| *thickness > 0.0 && thickness.is_finite())
}

#[cfg(test)]
mod tests {
    use trocar_scene::{Detection, EntityAllocator, Name, Primitive, RegistryBuilder, Store};

    use super::*;

    /// Two balls of a radius of 10 and 20 mm, in contact at a place.
    fn balls(depth: f64, force: f64) -> Snapshot {
        let mut builder = RegistryBuilder::new();
        trocar_scene::components::register(&mut builder).expect("distinct names");
        let mut store = Store::new(builder.build());
        let mut out = Commands::new(store.view().registry().clone(), EntityAllocator::new(0, 0));
        let [a, b] = [("small", 0.010), ("large", 0.020)].map(|(name, radius)| {
            let ball = out.spawn();
            out.put(ball, Name(name.into()));
            out.put(ball, Shape::Sphere { radius });
            ball
        });
        let row = Collision {
            a,
            primitive_a: Primitive::Shaft,
            b,
            primitive_b: Primitive::Shaft,
            points_in_world: [Point3::new(0.001, 0.002, 0.003); 2],
            normal_in_world: Vector3::z(),
            depth,
            force_in_world: Vector3::z() * force,
            velocity_constraint: 0.0,
            method: Detection::Simulator,
            detected_at: SimTime::ZERO,
        };
        out.contribute(CollisionList { collisions: vec![row], penetration_max: depth });
        out.seal();
        store.apply(&mut out, SimTime::ZERO);
        store.snapshot()
    }

    fn found(depth: f64, force: f64) -> Vec<UnkeptContact> {
        let mut watch = ContactWatch::default();
        watch.look(SimTime::ZERO, &balls(depth, force));
        let news = watch.has_news();
        let (told, count) = watch.found();
        assert_eq!((told.len() as u64, !told.is_empty()), (count, news));
        told
    }

    #[test]
    fn a_contact_that_is_too_deep_or_too_strong_is_told_with_its_pair_and_place() {
        assert_eq!(found(0.0149, 99.0), []);
        assert_eq!(found(-0.5, 0.0), [], "bodies that are apart");
        let [deep] = &found(0.0151, 1.0)[..] else { panic!("three quarters of the smaller ball are 15 mm") };
        assert_eq!(
            deep.to_string(),
            "small and large: 15.1 mm deep at 0.00 s at [1.0, 2.0, 3.0] mm; at most 15.0 mm is kept"
        );
        let [strong] = &found(0.001, 150.0)[..] else { panic!("more than 100 N") };
        assert_eq!((strong.kind, strong.value), (UnkeptKind::Force, 150.0));
        assert_eq!(found(0.016, 150.0).len(), 2);
    }

    #[test]
    fn it_is_told_once_and_anew_when_it_was_kept_meanwhile() {
        let (kept, deep) = (balls(0.0, 0.0), balls(0.016, 0.0));
        let mut watch = ContactWatch::default();
        for tick in 0..100 {
            watch.look(SimTime::from_millis(10 * tick), &deep);
        }
        watch.look(SimTime::from_millis(1_100), &kept);
        watch.look(SimTime::from_millis(2_000), &deep);
        assert_eq!(watch.found().1, 2);
    }

    #[test]
    fn no_more_contacts_are_told_than_the_limit_and_all_are_counted() {
        let deep = balls(0.016, 0.0);
        let mut watch = ContactWatch::default();
        for second in 0..200 {
            watch.look(SimTime::from_millis(1_000 * second), &deep);
        }
        let (told, count) = watch.found();
        assert_eq!((told.len(), count), (TOLD_MAX, 200));
    }
}
