//! Narrow phase of the impulse world: pairs of nearby solids, their contact points, and which of them are movable.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Point3, Vector3};
use trocar_dynamics::instrument::contact::primitive_code;
use trocar_scene::{Entity, Primitive};

use super::bodies::{Body, Solid};
use super::closest_features::{TouchPoint, touch};
use super::detected_contact::DetectedContact;
use super::instrument::Tool;

/// Contact margin: contacts exist before there is any penetration \[m\].
const MARGIN: f64 = 1e-3;
/// Maximum contact points in a step; the deepest are kept.
const MEETINGS_MAX: usize = 4096;
/// Points of the same two bodies nearer than this, with similar directions, are merged \[m\].
const SAME_POINT: f64 = 1e-4;
const SAME_DIRECTION: f64 = 0.95;
/// Anything faster wakes what it touches \[m/s\].
const WAKING_SPEED: f64 = 2e-3;
/// It touches within this gap \[m\].
const WAKING_GAP: f64 = 2e-4;

/// One of the two sides of a contact.
#[derive(Clone, Copy, Debug)]
pub(super) struct ContactSide {
    pub entity: Entity,
    pub name: Primitive,
    pub part: usize,
    /// Its movable body in the solver, if any.
    pub slot: Option<usize>,
    /// Whether it is fixed.
    pub is_fixed: bool,
    /// The point, in the frame of the part \[m\].
    pub local: Point3<f64>,
    friction: f64,
    restitution: f64,
}

/// A point at which two solids are near each other.
#[derive(Clone, Copy, Debug)]
pub(super) struct ContactPoint {
    pub sides: [ContactSide; 2],
    pub point: TouchPoint,
    pub friction: f64,
    pub restitution: f64,
    /// Whether it was detected externally, and is not reported again.
    pub by_others: bool,
    /// Its result: impulse on the second, in world \[N·s\].
    pub impulse: Vector3<f64>,
}

/// Identifies a contact point from step to step.
pub(super) type Key = (Entity, Entity, u64, u64, u64);

impl ContactPoint {
    pub fn key(&self) -> Key {
        let [a, b] = &self.sides;
        let part = |side: &ContactSide| (side.part as u64) << 40 | primitive_code(side.name);
        (a.entity, b.entity, part(a), part(b), u64::from(self.point.feature) << 1 | u64::from(self.by_others))
    }
}

/// A body or a tool that may collide.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Collider {
    Body(Entity),
    Tool(Entity),
}

/// All bodies and tools of a world.
pub(super) struct WorldView<'a> {
    pub bodies: &'a mut BTreeMap<Entity, Body>,
    pub tools: &'a BTreeMap<Entity, Tool>,
    pub found: &'a [DetectedContact],
    /// Pairs that a joint joins: they do not collide. Each ascending; sorted.
    pub joined: &'a [(Entity, Entity)],
    pub step_secs: f64,
}

/// Buffers of a step.
#[derive(Clone, Debug, Default)]
pub(super) struct NarrowPhase {
    pub all: Vec<ContactPoint>,
    order: Vec<(f64, f64, Collider)>,
    points: Vec<TouchPoint>,
    /// Contact points of a pair, with the numbers of their parts.
    near: Vec<(usize, usize, TouchPoint)>,
}

impl WorldView<'_> {
    fn solid(&self, collider: Collider) -> Option<&Solid> {
        match collider {
            Collider::Body(entity) => self.bodies.get(&entity).map(|body| &body.solid),
            Collider::Tool(entity) => self.tools.get(&entity).map(|tool| &tool.solid),
        }
    }

    /// Whether a joint joins them.
    fn are_joined(&self, a: Entity, b: Entity) -> bool {
        !self.joined.is_empty() && self.joined.binary_search(&(a.min(b), a.max(b))).is_ok()
    }

    /// Whether it may be moving now.
    fn is_awake(&self, collider: Collider) -> bool {
        match collider {
            Collider::Body(entity) => self
                .bodies
                .get(&entity)
                .is_some_and(|body| body.travel.is_some() || body.is_dynamic() && !body.sleeps),
            Collider::Tool(_) => true,
        }
    }

    fn gives_way(&self, collider: Collider) -> bool {
        match collider {
            Collider::Body(entity) => self.bodies.get(&entity).is_some_and(Body::is_dynamic),
            Collider::Tool(_) => true,
        }
    }

    /// Rough upper bound of its velocity \[m/s\].
    fn speed(&self, collider: Collider) -> f64 {
        let (velocity, size) = match collider {
            Collider::Body(entity) => self.bodies.get(&entity).map(|body| (body.velocity, &body.solid)),
            Collider::Tool(entity) => self.tools.get(&entity).map(|tool| (tool.state.velocity, &tool.solid)),
        }
        .map_or_else(Default::default, |(velocity, solid)| (velocity, solid.all.diagonal()));
        velocity.linear.norm() + velocity.angular.norm() * size
    }

    fn pose(&self, entity: Entity) -> Option<Isometry3<f64>> {
        let body = self.bodies.get(&entity).map(|body| body.pose);
        body.or_else(|| self.tools.get(&entity).map(|tool| tool.state.tip_in_world))
    }

    fn contact_side(&self, collider: Collider, part: usize, point: &Point3<f64>) -> Option<ContactSide> {
        let solid = self.solid(collider)?;
        let local = solid.placed.get(part)?.inverse_transform_point(point);
        let name = *solid.names.get(part)?;
        Some(match collider {
            Collider::Body(entity) => {
                let body = self.bodies.get(&entity)?;
                ContactSide {
                    entity,
                    name,
                    part,
                    slot: body.slot.filter(|_| !body.sleeps),
                    is_fixed: !body.is_dynamic(),
                    local,
                    friction: body.component.friction,
                    restitution: body.component.restitution,
                }
            }
            Collider::Tool(entity) => {
                let tool = self.tools.get(&entity)?;
                let friction = tool.instrument.jaw_friction;
                let friction = if tool.jaw_of[part].is_some() { friction } else { friction.min(0.2) };
                ContactSide {
                    entity,
                    name,
                    part,
                    slot: Some(tool.slot),
                    is_fixed: false,
                    local,
                    friction,
                    restitution: 0.0,
                }
            }
        })
    }
}

impl NarrowPhase {
    /// Finds all contacts.
    pub fn detect(&mut self, mut world_view: WorldView<'_>) {
        self.all.clear();
        self.order.clear();
        let bodies = world_view.bodies.iter().map(|(entity, body)| (Collider::Body(*entity), &body.solid));
        let tools = world_view.tools.iter().map(|(entity, tool)| (Collider::Tool(*entity), &tool.solid));
        let solids = bodies.chain(tools).filter(|(_, solid)| !solid.parts.is_empty());
        self.order.extend(solids.map(|(collider, solid)| (solid.all.min.x, solid.all.max.x, collider)));
        self.order.sort_by(|a, b| a.0.total_cmp(&b.0));
        let order = std::mem::take(&mut self.order);
        for (index, (_, until, first)) in order.iter().enumerate() {
            let fast = world_view.speed(*first) * world_view.step_secs;
            for (from, _, second) in &order[index + 1..] {
                if *from > until + MARGIN + 2.0 * fast + 1e-2 {
                    break;
                }
                if !world_view.gives_way(*first) && !world_view.gives_way(*second) {
                    continue;
                }
                if !world_view.is_awake(*first) && !world_view.is_awake(*second) {
                    continue;
                }
                let margin = MARGIN + fast + world_view.speed(*second) * world_view.step_secs;
                self.pair(&mut world_view, *first, *second, margin);
            }
        }
        self.order = order;
        self.others(&world_view);
        if self.all.len() > MEETINGS_MAX {
            self.all.sort_by(|a, b| b.point.depth.total_cmp(&a.point.depth));
            self.all.truncate(MEETINGS_MAX);
        }
        self.all.sort_by_key(ContactPoint::key);
    }

    fn pair(&mut self, world_view: &mut WorldView<'_>, first: Collider, second: Collider, margin: f64) {
        // Canonical: names of parts do not depend on position.
        let rank = |collider: Collider| match collider {
            Collider::Body(entity) | Collider::Tool(entity) => entity,
        };
        let (first, second) = if rank(first) <= rank(second) { (first, second) } else { (second, first) };
        if world_view.are_joined(rank(first), rank(second)) {
            return;
        }
        let (Some(a), Some(b)) = (world_view.solid(first), world_view.solid(second)) else { return };
        if a.all.is_apart(&b.all, margin) {
            return;
        }
        let begin = self.all.len();
        let mut wakes = false;
        let mut near = std::mem::take(&mut self.near);
        near.clear();
        for (i, (part, pose)) in a.parts.iter().zip(&a.placed).enumerate() {
            if a.bounds[i].is_apart(&b.all, margin) {
                continue;
            }
            for (j, (other, place)) in b.parts.iter().zip(&b.placed).enumerate() {
                if a.bounds[i].is_apart(&b.bounds[j], margin) {
                    continue;
                }
                self.points.clear();
                touch((part, pose), (other, place), margin, &mut self.points);
                near.extend(self.points.iter().map(|point| (i, j, *point)));
            }
        }
        for &(i, j, point) in &near {
            let is_same = |contact_point: &ContactPoint| {
                (contact_point.point.points[0] - point.points[0]).norm_squared() < SAME_POINT * SAME_POINT
                    && contact_point.point.normal.dot(&point.normal) > SAME_DIRECTION
            };
            if let Some(same) = self.all[begin..].iter_mut().find(|contact_point| is_same(contact_point)) {
                if point.depth <= same.point.depth {
                    continue;
                }
                // The deeper one is kept, under the key of the first.
                same.point.depth = point.depth;
                continue;
            }
            let sides = [
                world_view.contact_side(first, i, &point.points[0]),
                world_view.contact_side(second, j, &point.points[1]),
            ];
            let [Some(one), Some(other)] = sides else { continue };
            wakes |= point.depth > -WAKING_GAP;
            self.all.push(ContactPoint {
                sides: [one, other],
                point,
                friction: (one.friction * other.friction).sqrt(),
                restitution: (one.restitution * other.restitution).sqrt(),
                by_others: false,
                impulse: Vector3::zeros(),
            });
        }
        self.near = near;
        if wakes {
            self.wake(world_view, [first, second], begin);
        }
    }

    /// Wakes a sleeping body that something moving touches.
    fn wake(&mut self, world_view: &mut WorldView<'_>, things: [Collider; 2], begin: usize) {
        for (side, other) in [(0, 1), (1, 0)] {
            let Collider::Body(entity) = things[side] else { continue };
            let is_pushed = match things[other] {
                Collider::Tool(_) => true,
                collider @ Collider::Body(_) => world_view.speed(collider) > WAKING_SPEED,
            };
            let Some(body) = world_view.bodies.get_mut(&entity) else { continue };
            if body.sleeps && is_pushed {
                body.sleeps = false;
                body.still_secs = 0.0;
                for contact_point in &mut self.all[begin..] {
                    contact_point.sides[side].slot = body.slot;
                }
            }
        }
    }

    /// Adds externally detected contacts at their present position.
    fn others(&mut self, world_view: &WorldView<'_>) {
        for (index, found) in world_view.found.iter().enumerate() {
            let pose = |entity: Entity| world_view.pose(entity).unwrap_or_else(Isometry3::identity);
            let (points, normal, depth) = found.now(found.entities.map(pose));
            let [a, b] = found.entities;
            if depth < -MARGIN || world_view.are_joined(a, b) {
                continue;
            }
            let contact_side = |side: usize| {
                let entity = found.entities[side];
                let body = world_view.bodies.get(&entity);
                let tool = world_view.tools.get(&entity);
                ContactSide {
                    entity,
                    name: Primitive::Shape(index as u32),
                    part: 0,
                    slot: body.and_then(|body| body.slot).or(tool.map(|tool| tool.slot)),
                    is_fixed: body.is_none_or(|body| !body.is_dynamic()) && tool.is_none(),
                    local: points[side],
                    // A side without a value takes the other's.
                    friction: body.map_or(f64::NAN, |body| body.component.friction),
                    restitution: body.map_or(0.0, |body| body.component.restitution),
                }
            };
            let sides = [contact_side(0), contact_side(1)];
            let friction = match sides.map(|side| side.friction) {
                [a, b] if a.is_nan() => {
                    if b.is_nan() {
                        0.0
                    } else {
                        b
                    }
                }
                [a, b] if b.is_nan() => a,
                [a, b] => (a * b).sqrt(),
            };
            let restitution = (sides[0].restitution * sides[1].restitution).sqrt();
            let point = TouchPoint { points, normal, depth, feature: 0 };
            let impulse = Vector3::zeros();
            self.all.push(ContactPoint { sides, point, friction, restitution, by_others: true, impulse });
        }
    }
}
